"""What the benchmark measures is what the program makes: the same head, told the same of its light."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from service.archive.avatar import Avatar
from service.bench.sample_head import SampleHead, from_photo
from service.bench.stages import measure_stage
from service.bench.variants import Whole, reference
from service.bench.whole import make_whole
from service.colour import Codes
from service.reflectance.reflectance import make_reflectance
from service.reflectance.reflectance_plan import ReflectancePlan
from service.reflectance.subject import Subject
from service.runtime.networks import Engine
from tests.service.archive.toys import toy_avatar
from tests.service.reflectance.toys import toy_models
from tests.service.runtime.toynets import write_models

WIDTH, SIDE = 768, 1536


@pytest.fixture(scope="module")
def engine(tmp_path_factory: pytest.TempPathFactory) -> Engine:
    models = {name: net for name, net in toy_models().items() if name.startswith("delta")}
    return Engine(threads=1, folder=write_models(tmp_path_factory.mktemp("models"), models))


@pytest.fixture
def avatar(monkeypatch: pytest.MonkeyPatch) -> Avatar:
    """What the pipeline makes of any photo here: a head of which the photo shows some skin, with an eye's white."""
    plain = toy_avatar()
    lit = np.zeros((64, 96), np.uint8)
    lit[24:40, 30:66] = 255
    # Smooth, so that it hardly matters whether the light is read off the texture or off the enlarged one.
    colour = np.asarray(cv2.GaussianBlur(np.where(lit > 0, 60, 230).astype(np.uint8), (0, 0), 3), np.uint8)
    parts = np.full((*lit.shape, 3), 200, np.uint8)
    texture = replace(
        plain.texture, texture=np.repeat(colour[..., None], 3, 2), confidence=lit, lit_skin=lit, parts=parts
    )
    fit = replace(plain.fit, eye_light=np.array([0.5, 0.45, 0.4]))
    made = replace(plain, fit=fit, texture=texture)
    monkeypatch.setattr("service.pipeline.make_avatar", lambda *_, **__: made)
    return made


def product(avatar: Avatar, engine: Engine) -> Codes:
    """The diffuse albedo that the pipeline makes of the head."""
    subject = Subject.in_photo(avatar.head, avatar.fit, avatar.texture)
    plan = ReflectancePlan.of(["diffuse_albedo"], super_resolution=False)
    made = make_reflectance(avatar.texture.texture, subject, plan, (WIDTH, WIDTH * 2 // 3), engine)
    assert made.diffuse_albedo is not None
    return made.diffuse_albedo


def test_the_stage_takes_the_light_of_the_photo(
    avatar: Avatar, engine: Engine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Light that is found on hair and made-up parts would be measured as if it were to be believed there."""
    # The stage is the network; what becomes of highlights afterwards is the whole's.
    monkeypatch.setattr("service.reflectance.reflectance.without_highlights", lambda albedo, *_: albedo)
    from_photo(b"", None, SIDE, tmp_path)
    measure_stage(replace(reference("delta"), width=WIDTH), engine, tmp_path, tmp_path / "delta.npy", 0)
    window = SampleHead.load(tmp_path).window
    subject = Subject.in_photo(avatar.head, avatar.fit, avatar.texture)
    skin = window.of(subject.skin((WIDTH, WIDTH * 2 // 3))) == 255
    inside = np.zeros_like(skin)
    inside[32:-32, 32:-32] = True  # where the window ends, its texture is resampled without its neighbours
    difference = np.abs(np.load(tmp_path / "delta.npy").astype(int) - window.of(product(avatar, engine)))
    assert (skin & inside).sum() > 5000
    assert difference[skin & inside].max() <= 20


def test_the_whole_is_the_product(
    avatar: Avatar, engine: Engine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Maps of ``avatarme bench`` equal those of ``avatarme make``."""

    def written(avatar: Avatar, target: Path, **_: Any) -> None:
        target.write_bytes(b"zip")

    monkeypatch.setattr("service.archive.pack.write_archive", written)
    from_photo(b"", None, SIDE, tmp_path)
    make_whole(Whole("toy", "draft", engine, WIDTH), b"", tmp_path, tmp_path / "maps.npz")
    with np.load(tmp_path / "maps.npz") as maps:
        expected = SampleHead.load(tmp_path).window.of(product(avatar, engine))
        np.testing.assert_array_equal(maps["diffuse_albedo"], expected)
