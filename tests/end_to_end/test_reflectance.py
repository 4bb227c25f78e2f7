"""The pipeline with networks: toys of the same channels, so that it takes seconds wherever the real ones are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from service import pipeline
from service.archive.pack import archive_members
from service.budget import OVER_BUDGET
from service.errors import ModelFault
from service.map_registry import MAP_NAMES
from service.options import Options
from service.runtime.networks import Engine
from tests.end_to_end.command import ROOT
from tests.end_to_end.conftest import Pixels, png
from tests.service.reflectance.toys import toy_folder

ASKED = Options(maps=MAP_NAMES, size=(192, 128), quality="high")


@pytest.fixture
def toys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The toy networks in place of the real ones."""
    folder = toy_folder(tmp_path)
    for module in ("service.pipeline", "service.budget"):
        monkeypatch.setattr(f"{module}.choose_engine", lambda *_, **__: Engine(threads=1, folder=folder))
    return folder


def test_from_photo_to_archive(toys: Path, portrait: Pixels) -> None:
    told: list[tuple[str, float]] = []
    avatar = pipeline.make_avatar(png(portrait), ASKED, lambda *now: told.append(now))
    members = archive_members(avatar)
    manifest = json.loads(members["manifest.json"])
    jsonschema.validate(manifest, json.loads((ROOT / "docs" / "manifest.schema.json").read_text("utf-8")))
    assert [entry["role"] for entry in manifest["maps"]] == [
        "diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "displacement",
        "wrinkle_brows", "wrinkle_eyes", "wrinkle_smile", "wrinkle_mouth",
        "roughness", "cavity", "thickness", "albedo_error", "texture", "confidence", "shape_normal",
    ]  # fmt: skip
    sizes = {entry["role"]: (entry["width"], entry["height"]) for entry in manifest["maps"]}
    half = {role for role in sizes if role.startswith("wrinkle")} | {"roughness", "cavity", "thickness"}
    assert sizes == {role: (96, 64) if role in half else (192, 128) for role in sizes}
    assert "mesh/head_fine.obj" in members and manifest["displacement"] == {"scale_mm": 5e-5, "mid": 32768}
    assert manifest["reflectance"]["fallbacks"][0] == "texture-resampled", "192 texels are too few to enlarge for"
    shares = [share for _, share in told]
    assert shares == sorted(shares) and shares[-1] < 1
    stages = list(dict.fromkeys(name for name, _ in told))
    assert stages[-5:] == ["diffuse_albedo", "specular_albedo", "specular_normal", "diffuse_normal", "displacement"]
    assert set(stages) <= set(avatar.timings_s)


def test_a_map_that_is_not_asked_for_is_not_computed(toys: Path, portrait: Pixels) -> None:
    for name in ("psi", "rho", "sigma", "zeta_body", "zeta_tail"):
        (toys / f"{name}.onnx").unlink()
    asked = Options(maps=("diffuse_albedo",), size=(192, 128))
    avatar = pipeline.make_avatar(png(portrait), asked)
    assert avatar.reflectance is not None and avatar.reflectance.specular_normal is None


def test_swapped_weights_are_refused_by_hash(toys: Path, portrait: Pixels) -> None:
    (toys / "delta.onnx").write_bytes((toys / "rho.onnx").read_bytes())
    with pytest.raises(ModelFault, match=r"delta\.onnx: sha256"):
        pipeline.make_avatar(png(portrait), ASKED)


@pytest.mark.parametrize(("seconds", "level", "warned"), [(1e-3, "draft", True), (1e6, "reference", False)])
def test_a_budget_picks_the_level(
    seconds: float, level: str, warned: bool, toys: Path, portrait: Pixels, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = Options(maps=("diffuse_albedo",), size=(192, 128), budget=seconds)
    avatar = pipeline.make_avatar(png(portrait), asked)
    assert avatar.options["quality"] == level
    assert (OVER_BUDGET in avatar.all_warnings()) == warned


@pytest.mark.parametrize("colour", ["black", "white", "flat", "saturated"])
def test_hard_textures_come_through(colour: str, toys: Path, portrait: Pixels, plain: Any) -> None:
    """The texture stage's result replaced by an extreme one; every number of the result is finite and in range."""
    from dataclasses import replace

    from service.reflectance.reflectance import make_reflectance
    from service.reflectance.subject import Subject

    fill = {"black": 0, "white": 255, "flat": 97}
    texture = plain.texture.texture
    texture = (texture > 127).astype(np.uint8) * 255 if colour == "saturated" else np.full_like(texture, fill[colour])
    subject, plan = Subject.of(plain.head, plain.fit.vertices), replace(ASKED, quality="draft").plan()
    made = make_reflectance(texture, subject, plan, (192, 128), Engine(threads=1, folder=toys))
    assert made.displacement is not None and made.specular_normal is not None
    assert np.abs(made.displacement.astype(int) - 32768).max() <= 20000
    across = np.linalg.norm(made.specular_normal.astype(float), axis=2) / 32767
    assert across.max() < 0.99
