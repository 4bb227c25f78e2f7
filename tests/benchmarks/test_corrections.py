"""Corrections on trial: photos, sitters, scores, verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

pytest.importorskip("torch")

from benchmarks.corrections import sitters
from benchmarks.corrections.__main__ import own_cases, verdict
from benchmarks.corrections.photos import (
    FACE_LEVEL,
    Lens,
    Photo,
    develop,
    encoded,
)
from benchmarks.corrections.score import Judge, Score
from benchmarks.corrections.sitters import BORDER, whole_skin
from benchmarks.corrections.trial import ALL, Effect, Verdicts, tried
from benchmarks.heads import TexturedHead, at_places, places_of, subdivided
from benchmarks.metrics import View, at_chart
from benchmarks.render import Exposure, Shot
from service.colour import LUMA, linear_to_srgb, srgb_to_linear
from service.geometry.camera import Camera
from service.geometry.chart import Chart
from service.stage_cache import StageCache
from tests.toyhead import CENTRE, EYE_RADIUS, EYE_X, sphere_head

STEPS = np.linspace(0.02, 3.0, 64, dtype=np.float32)
RAMP = np.tile(STEPS[None, :, None], (64, 1, 3)) * np.array([1.0, 0.8, 0.6], np.float32)
FACE = np.ones(RAMP.shape[:2], bool)


def linear(pixels: np.ndarray) -> np.ndarray:
    return srgb_to_linear(pixels.astype(np.float32) / 255)


def test_exposure_is_the_faces_whatever_the_lamp_and_stops_are_powers_of_two() -> None:
    usual, brighter = develop(RAMP, FACE, Lens()), develop(RAMP * 7, FACE, Lens())
    np.testing.assert_array_equal(usual, brighter)
    level = np.quantile(linear(usual) @ LUMA, 0.9)
    assert level == pytest.approx(FACE_LEVEL, rel=0.02)
    dim = develop(RAMP, FACE, Lens(stops=-2))
    middle = linear(usual)[0, 30], linear(dim)[0, 30]
    np.testing.assert_allclose(middle[0] / middle[1], 4, rtol=0.05)


def test_a_bend_changes_the_hue_of_shades_and_not_of_white() -> None:
    bent = develop(np.full((8, 8, 3), 1.0, np.float32) * RAMP[:8, :8] ** 0, FACE[:8, :8], Lens(stops=3))
    assert (bent == 255).all()
    grey = np.tile(np.linspace(0.01, 1, 64, dtype=np.float32)[None, :, None], (4, 1, 3))
    film = develop(grey, np.ones((4, 64), bool), Lens(bend=(0.8, 1.0, 1.25))).astype(int)
    assert (film[0, 5:40, 0] > film[0, 5:40, 1]).all()
    assert (film[0, 5:40, 1] > film[0, 5:40, 2]).all()


def test_warm_light_cuts_blue_off_and_a_ceiling_blows_one_channel() -> None:
    warm = develop(RAMP, FACE, Lens(balance=(1.25, 0.8, 0.1)))
    assert (warm[0, :, 2] <= 14).sum() > 5
    blown, plain = develop(RAMP, FACE, Lens(ceiling=(0.6, 1, 1))), develop(RAMP, FACE, Lens())
    assert (blown[..., 0] == 255).sum() > (plain[..., 0] == 255).sum()
    np.testing.assert_array_equal(blown[..., 1:], plain[..., 1:])


@pytest.mark.parametrize(
    ("camera", "start"), [(Lens(size=32, noise=3.0, jpeg=40), b"\xff\xd8"), (Lens(), b"\x89P")]
)
def test_files_are_what_the_camera_writes(camera: Lens, start: bytes) -> None:
    pixels = develop(RAMP, FACE, camera)
    data = encoded(pixels, camera)
    assert data.startswith(start)
    read = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert read is not None and read.shape == ((32, 32, 3) if camera.size else (64, 64, 3))
    np.testing.assert_array_equal(pixels, develop(RAMP, FACE, camera), err_msg="the same photo each time")


pytest.importorskip("torch")
pytest.importorskip("skimage")


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


def test_true_normals_score_far_higher_than_tilted_ones() -> None:
    photo, avatar, _ = seen()
    judge = Judge.of(photo, avatar)
    flat = np.zeros((64, 96, 2), np.int16)
    tilted = flat + np.int16(6000)
    made: Any = [SimpleNamespace(specular_normal=bumps) for bumps in (flat, tilted)]
    scores = [
        judge.relief(cast(Any, SimpleNamespace(head=avatar.head, fit=avatar.fit, reflectance=one)))
        for one in made
    ]
    assert scores[0] > 35 > 25 > scores[1]


def test_heads_that_share_nothing_are_an_error() -> None:
    photo, avatar, _ = seen()
    photo.truth.skin[:] = False
    with pytest.raises(ValueError, match="toy"):
        Judge.of(photo, avatar)


pytest.importorskip("torch")


BLACK = (0.01, 0.01, 0.01)


def face() -> TexturedHead:
    """A ball of a head, fine enough to paint on, and fair."""
    toy = sphere_head()
    skin = toy.triangles[toy.triangle_part == toy.part_names.index("skin")]
    vertices, triangles = subdivided(toy.mean.astype(np.float64), skin.astype(np.int64), 3)
    eyes = np.array([[EYE_X, 0, 0], [-EYE_X, 0, 0]])
    return TexturedHead("toy", vertices, triangles, np.full((len(vertices), 3), 0.5), eyes, EYE_RADIUS)


def landmarks() -> np.ndarray:
    """(68, 3) of a round face: only those that are drawn by have to be right."""
    points = np.zeros((68, 3))
    turn = np.linspace(-1.5, 1.5, 17)
    points[:17, :2] = np.stack([0.07 * np.sin(turn), -0.02 - 0.06 * np.cos(turn)], 1)
    points[17:22, :2] = np.stack([np.linspace(-0.05, -0.012, 5), np.full(5, 0.025)], 1)
    points[22:27, :2] = np.stack([np.linspace(0.012, 0.05, 5), np.full(5, 0.025)], 1)
    points[31, :2], points[35, :2] = (-0.012, -0.03), (0.012, -0.03)
    lips = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    points[48:60, :2] = np.stack([-0.02 * np.cos(lips), -0.05 + 0.007 * np.sin(lips)], 1)
    return points


def test_brows_lie_over_the_eyes_and_a_beard_below_the_nose_round_the_lips() -> None:
    head, rng = face(), np.random.default_rng(0)
    browed = sitters.painted(head, sitters.brows(landmarks(), rng), BLACK)
    dark = browed.colours[:, 0] < 0.3
    assert dark.sum() > 20
    where = browed.vertices[dark]
    assert (np.abs(where[:, 1] - 0.0215) < 0.012).all() and (np.abs(where[:, 0]) < 0.06).all()
    assert (where[:, 2] > CENTRE[2]).all(), "the back of the head has brows"
    bearded = sitters.painted(head, sitters.beard(landmarks(), rng), BLACK)
    dark = bearded.colours[:, 0] < 0.3
    assert dark.sum() > 100 and (bearded.vertices[dark, 1] < -0.02).all()
    lips = (
        (np.abs(head.vertices[:, 0]) < 0.01)
        & (np.abs(head.vertices[:, 1] + 0.05) < 0.004)
        & (head.vertices[:, 2] > -0.04)
    )
    assert lips.any() and not dark[lips].any()
    assert (head.colours == 0.5).all(), "the head itself was painted"


def test_glasses_stand_before_the_eyes_and_a_cap_over_the_skull() -> None:
    head = face()
    rims = np.concatenate([one.vertices for one in sitters.glasses(head)])
    assert np.abs(rims[:, 0]).max() < np.abs(head.vertices[:, 0]).max()
    near = rims[np.abs(rims[:, 2] - rims[:, 2].max()) < 0.01]
    assert near[:, 2].min() > head.eyes[:, 2].max() + head.eye_radius
    for eye in head.eyes:
        assert np.linalg.norm(near[:, :2] - eye[:2], axis=1).min() > 0.01, "a rim crosses the pupil"
    shell, brim = sitters.cap(head)
    used = shell.vertices
    assert len(np.unique(shell.triangles)) == len(used), "vertices of the face that it does not cover count as worn"
    radius = np.linalg.norm(used - CENTRE, axis=1)
    np.testing.assert_allclose(radius, 0.09 + sitters.CAP_M, atol=0.002)
    assert used[:, 1].min() > 0 and brim.vertices[:, 2].max() > head.vertices[:, 2].max()


def test_a_face_without_a_head_gets_one_of_its_tone() -> None:
    rest = np.full((256, 256, 3), 0.2)
    painted = np.zeros((512, 512, 3))
    painted[100:400, 100:400] = [0.6, 0.4, 0.3]
    whole = whole_skin(painted, rest)
    assert whole.shape == painted.shape
    np.testing.assert_allclose(whole[250, 250], [0.6, 0.4, 0.3])
    np.testing.assert_allclose(whole[10, 10], [0.6, 0.4, 0.3], atol=1e-6)
    assert np.abs(np.diff(whole, axis=0)).max() < 2 / BORDER


def test_coordinates_carried_for_colours_find_the_texture_again() -> None:
    from benchmarks.heads import Skin

    rng = np.random.default_rng(1)
    texture = rng.uniform(size=(32, 32, 3))
    uv = rng.uniform(0.05, 0.95, (40, 2))
    skin = Skin(np.zeros((40, 3)), np.arange(39).reshape(13, 3), uv, texture)
    _, _, colours = skin.dense(0)
    _, _, places = places_of(skin, 2048).dense(0)
    np.testing.assert_allclose(places[:, :2], uv, atol=1 / 2048)
    off = np.abs(np.mod(uv * 32, 1) - 0.5).max(1) > 0.47  # a texel's edge: either neighbour will do
    np.testing.assert_array_equal(at_places(texture, places)[~off], colours[~off])


pytest.importorskip("torch")


MAPS = (96, 64)


@dataclass(frozen=True)
class Rule:
    name: str
    adds: float
    cases: tuple[str, ...] = ()
    mends: str = "A sentence."


@dataclass
class Toy:
    """Rules that add a constant to an albedo of 0.5; the truth has 0.6."""

    registry: Sequence[Any]
    told: bool = True
    runs: list[tuple[str, ...]] = field(default_factory=list)

    def make(self, data: bytes, without: Sequence[str], stages: StageCache) -> Any:
        self.runs.append(tuple(without))
        value = stages.get_or_compute(
            "diffuse_albedo", lambda: 0.5 + sum(one.adds for one in self.registry if one.name not in without)
        )
        albedo = np.full((*MAPS[::-1], 3), round(65535 * value), np.uint16)
        confidence = np.full(MAPS[::-1], 255, np.uint8)
        confidence[:, : MAPS[0] // 2] = 0
        return SimpleNamespace(
            head=sphere_head(),
            reflectance=SimpleNamespace(diffuse_albedo=albedo, size=MAPS),
            texture=SimpleNamespace(confidence=confidence, warnings=("little-seen",)),
            fit=SimpleNamespace(warnings=()),
        )

    def changed(self, avatar: Any) -> dict[str, int]:
        return {rule.name: int(rule.adds != 0) for rule in self.registry} if self.told else {}


class Scorer:
    """Decibels are a hundredth of the error, upside down."""

    def score(self, albedo: np.ndarray) -> Score:
        error = abs(float(albedo.mean()) - 0.6)
        return Score(-100 * error, -200 * error, 10 * error, float("nan"))

    def flat(self) -> Score:
        return self.score(np.full((2, 2, 3), 0.55))


GOOD, BAD, IDLE = Rule("good", 0.1, ("hard",)), Rule("bad", 0.02), Rule("idle", 0.0)


def verdicts(toy: Toy, groups: tuple[str, ...] = ("hard",)) -> Verdicts:
    return tried("photo", groups, b"", toy, lambda avatar: Scorer())  # type: ignore[arg-type, return-value]


def test_gains_are_with_the_rule_less_without_it() -> None:
    toy = Toy((GOOD, BAD, IDLE))
    found = verdicts(toy)
    assert found.score is not None and found.score.best == pytest.approx(-2, abs=0.01)
    gains = {name: effect.gain.best for name, effect in found.effects.items() if effect.gain is not None}
    # 0.62 with all; 0.52 without the good one, 0.60 without the bad one, 0.50 without any.
    assert gains == pytest.approx({"good": 6.0, "bad": -2.0, "idle": 0.0, ALL: 8.0}, abs=0.01)
    assert found.effects["bad"].gain is not None and found.effects["bad"].gain.delta_e == pytest.approx(-0.2, abs=0.01)
    assert found.warnings == ("little-seen",)


def test_texels_are_counted_on_skin_and_on_seen_skin() -> None:
    found = verdicts(Toy((GOOD,)))
    assert found.effects["good"].changed == 1 and found.effects["good"].changed_seen == 1
    tiny = verdicts(Toy((Rule("tiny", 0.9 / 255),)))
    assert tiny.effects["tiny"].changed == 0


def effect(best: float, raw: float = 0.0, unseen: float = float("nan")) -> Effect:
    return Effect(0.5, 0.25, 0.01, 1.0, Score(best, raw, 0.0, unseen))


def test_a_verdict_wants_a_tenth_of_a_decibel_on_the_rules_own_cases() -> None:
    assert verdict([effect(0.3), effect(-0.05)]) == "yes"
    assert verdict([effect(0.05, raw=0.3)]) == "brightness"
    assert verdict([effect(0.05, unseen=0.2), effect(0.0)]) == "unseen skin"
    assert verdict([effect(0.09)]) == "no"
    assert verdict([]) == "no"
    hard, soft = (Verdicts(name, (name,), None, None, {}) for name in ("hard", "soft"))
    good, idle = (cast(Any, one) for one in (GOOD, IDLE))
    assert own_cases(good, [hard, soft]) == [hard] and own_cases(idle, [hard, soft]) == [hard, soft]
