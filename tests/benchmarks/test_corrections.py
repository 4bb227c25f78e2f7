"""How far an albedo is from the truth: the scores of corrections on trial."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("skimage")

from benchmarks.corrections.photos import Photo
from benchmarks.corrections.score import Judge
from benchmarks.heads import TexturedHead
from benchmarks.metrics import View, at_chart
from benchmarks.render import Exposure, Shot
from service.colour import linear_to_srgb, srgb_to_linear
from service.geometry.camera import Camera
from service.geometry.chart import Chart
from tests.toyhead import EYE_RADIUS, EYE_X, sphere_head

pytestmark = pytest.mark.train


def linear(pixels: np.ndarray) -> np.ndarray:
    return srgb_to_linear(pixels.astype(np.float32) / 255)

SIZE = 160


def smooth_map(width: int = 96) -> np.ndarray:
    """(h, w, 3) linear colours that change over the chart."""
    v, u = np.mgrid[0 : width * 2 // 3, 0:width] / width
    return 0.2 + 0.15 * np.stack([np.sin(9 * u), np.sin(8 * v), np.cos(7 * (u + v))], -1)


def seen(photo_size: int = SIZE) -> tuple[Photo, Any, np.ndarray]:
    """A photo of the toy head, an avatar that fits it exactly from a picture of a size, and the true map, coded."""
    toy, truth = sphere_head(), smooth_map()
    focal = 1.6 * photo_size
    middle = np.full(2, photo_size / 2)
    camera = Camera(photo_size, photo_size, focal, middle, np.diag([1.0, -1, -1]), np.array([0, 0, 0.5]))
    fit = SimpleNamespace(camera=camera, vertices=toy.mean.astype(np.float32))
    view = View.of(fit, toy, (SIZE, SIZE), SIZE / photo_size)  # type: ignore[arg-type]
    albedo = view.of_map(truth).astype(np.float32)
    normal = view.points - [0, 0, -0.08]
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    exposure = Exposure(albedo, albedo, view.points.astype(np.float32), normal.astype(np.float32), view.skin)
    chart = Chart.build(toy, 384, 256)
    own = chart.inner_part == toy.part_names.index("skin")
    colours = at_chart(truth, chart.inside(np.concatenate([toy.uv, toy.uv], 1), on_chart=True)[own][:, :2])
    eyes = np.array([[EYE_X, 0, 0], [-EYE_X, 0, 0]])
    head = TexturedHead(
        "toy", chart.inside(toy.mean)[own].astype(float), np.zeros((0, 3), int), colours, eyes, EYE_RADIUS
    )
    confidence = np.full((64, 96), 255, np.uint8)
    confidence[:, :40] = 0
    avatar = SimpleNamespace(
        head=toy,
        fit=fit,
        photo=SimpleNamespace(size=(photo_size, photo_size)),
        texture=SimpleNamespace(confidence=confidence),
    )
    return Photo("toy", (), b"", exposure, head, Shot(0, "soft", 0.5, 30, SIZE)), avatar, coded(truth)


def coded(linear: np.ndarray) -> np.ndarray:
    return linear_to_srgb(np.clip(linear, 0, 1).astype(np.float32)).astype(np.float64)


@pytest.mark.parametrize("photo_size", [SIZE, SIZE // 2])
def test_the_true_albedo_scores_far_higher_than_anything_else(photo_size: int) -> None:
    photo, avatar, truth = seen(photo_size)
    judge = Judge.of(photo, avatar)
    assert len(judge.truth) > 1000 and len(judge.unseen_truth) > 1000
    perfect, flat = judge.score(truth), judge.flat()
    assert perfect.best > 45 and perfect.raw > 45 and perfect.delta_e < 0.5 and perfect.unseen > 40
    assert flat.best < 25 and flat.delta_e > 5
    moved = judge.score(np.roll(truth, 6, 1))
    assert moved.best < perfect.best - 10 and moved.unseen < perfect.unseen - 10


def test_a_gain_is_forgiven_once_and_a_hue_is_not() -> None:
    photo, avatar, truth = seen()
    judge = Judge.of(photo, avatar)
    linear = srgb_to_linear(truth.astype(np.float32)).astype(np.float64)
    darker, bluer = judge.score(coded(0.6 * linear)), judge.score(coded(linear * [0.8, 0.8, 1.2]))
    assert darker.best > 40 and darker.raw < 25
    assert bluer.best < 28
    assert darker.delta_e > 5 and bluer.delta_e > 5


def test_an_error_where_nobody_sees_it_costs_there_only() -> None:
    photo, avatar, truth = seen()
    judge = Judge.of(photo, avatar)
    wrong = truth.copy()
    wrong[:, :36] = 0.9  # of the part without confidence
    before, after = judge.score(truth), judge.score(wrong)
    assert after.unseen < before.unseen - 10


def test_heads_that_share_nothing_are_an_error() -> None:
    photo, avatar, _ = seen()
    photo.truth.skin[:] = False
    with pytest.raises(ValueError, match="toy"):
        Judge.of(photo, avatar)
