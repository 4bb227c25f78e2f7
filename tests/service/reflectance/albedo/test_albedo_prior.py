"""The albedo of a whole head from what is seen of it.

How sure the albedo is.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from service.errors import ModelFault
from service.geometry.chart import Chart
from service.head.files import load_head
from service.head.regions import vertex_mask
from service.reflectance.albedo.albedo_prior import (
    CLUES,
    FILE,
    LEAST,
    MOST,
    AlbedoPrior,
    ErrorModel,
    albedo_prior,
    clues,
    error_model,
)
from service.reflectance.albedo.corrections import as_seen_skin, continued

H, W = 16, 24


def toy(noise: float = 0.1) -> AlbedoPrior:
    """One component: the right half becomes brighter as the left one does, twice as much."""
    component = np.full((1, 3, H, W), 0.5, np.float32)
    component[..., W // 2 :] = 1.0
    return AlbedoPrior(np.full((3, H, W), -1.0, np.float32), component, noise, np.ones((H, W), np.float32))


def test_a_file_that_is_none_is_said(tmp_path: Path) -> None:
    with pytest.raises(ModelFault, match=r"prior\.npz"):
        AlbedoPrior.read(tmp_path / "prior.npz")
    path = tmp_path / "prior.npz"
    np.savez(path, mean=np.zeros((3, 2, 2)), components=np.zeros((1, 3, 4, 4)), inside=np.ones((2, 2)), noise=1.0)
    with pytest.raises(ModelFault, match="islands"):
        AlbedoPrior.read(path)


def test_unseen_skin_gets_what_goes_with_the_seen_and_no_step() -> None:
    """Half a chart in even light; the rest was inpainted in grey: its albedo follows the component."""
    prior, lit = toy(1e-3), np.zeros((H, W), np.float32)
    lit[:, : W // 2] = 1
    albedo = np.full((3, H, W), -1.0 + 0.5 * 0.6, np.float32)
    albedo[..., W // 2 :] = -1.0 + 0.6
    texture = np.exp(albedo)
    texture[..., W // 2 :] = 0.2
    light = np.zeros((3, H, W), np.float32)
    made = np.log(texture) - as_seen_skin(continued(light, lit), texture, light, lit, 1 - lit, lit, prior)
    far = slice(W - 4, W)
    assert made[..., far] == pytest.approx(albedo[..., far], abs=0.03)
    alone = np.log(texture) - as_seen_skin(continued(light, lit), texture, light, lit, 1 - lit, lit)
    assert np.abs(alone[..., far] - albedo[..., far]).mean() > 0.2


def test_the_prior_in_the_box_is_of_the_head_in_the_box() -> None:
    """Lips are redder than cheeks in everybody, and one seen cheek tells a tone: dark stays dark all over."""
    head, prior = load_head(None), albedo_prior(bearded=True)
    chart = Chart.build(head, 288, 192)
    assert prior.is_of(chart.mask.astype(np.float32))
    lips, cheek, ear = (
        chart.interpolate(vertex_mask(head, n))[..., 0] > 0.5 for n in ("lips", "cheek_left", "ear_right")
    )
    scalp, forehead = (chart.interpolate(vertex_mask(head, n))[..., 0] > 0.9 for n in ("scalp", "forehead"))
    for level in (-3.0, -0.9):
        seen = np.full((3, 192, 288), level, np.float32) + np.array([0.25, 0.0, -0.2], np.float32)[:, None, None]
        made = prior.complete(seen, cheek.astype(np.float32))
        redness = made[0] - made[1]
        assert redness[lips].mean() > redness[cheek].mean()
        assert made[:, ear].mean() == pytest.approx(level, abs=0.5)
        assert made[:, scalp].mean(1) == pytest.approx(made[:, forehead].mean(1), abs=0.12), "a crown without stubble"
    assert FILE.is_file()


def test_lids_are_darker_than_cheeks_where_no_photo_tells() -> None:
    """As in all published maps; the stage's are as bright, and unseen rims of lids shone under dark lashes."""
    head, chart = load_head(None), Chart.build(load_head(None), 288, 192)
    lids, cheeks = (chart.interpolate(vertex_mask(head, *names))[..., 0] > 0.5
                    for names in (("eyelid_left", "eyelid_right"), ("cheek_left", "cheek_right")))  # fmt: skip
    for bearded in (True, False):
        made = albedo_prior(bearded).complete(np.zeros((3, 192, 288), np.float32), np.zeros((192, 288), np.float32))
        assert -0.7 < made[:, lids].mean() - made[:, cheeks].mean() < -0.15


def test_the_edge_of_a_shadow_above_the_eyes_tells_no_brows() -> None:
    """Shade that is left at the edge of what is seen under a cap was likeliest the rim of thick black brows."""
    head, prior = load_head(None), albedo_prior(bearded=False)
    chart = Chart.build(head, 288, 192)
    brows, cheeks = (chart.interpolate(vertex_mask(head, a, b))[..., 0] > 0.5
                     for a, b in (("brow_left", "brow_right"), ("cheek_left", "cheek_right")))  # fmt: skip
    rows = np.arange(192)[:, None] * np.ones((1, 288), np.int64)
    lowest = int(rows[brows].max())
    lit = np.asarray((chart.mask & (rows > lowest - 2)).astype(np.float32))
    truth = prior.complete(np.zeros((3, 192, 288), np.float32), 0 * lit)
    shade = -2 * np.clip((lowest + 4 - rows) / 6, 0, 1).astype(np.float32)
    light, texture = np.stack([0.6 * shade] * 3), np.exp(truth + shade)
    made = np.log(texture) - as_seen_skin(continued(light, lit), texture, light, lit, 1 - lit, lit, prior)

    def darker(albedo: np.ndarray) -> float:
        return float(albedo[:, brows].mean() - albedo[:, cheeks].mean())

    assert darker(made) == pytest.approx(darker(truth), abs=0.45)


SHAPE = (24, 36)


def plain(**changed: object) -> np.ndarray:
    """Clues of an evenly lit, wholly seen chart, but for ``changed``."""
    usual: dict[str, object] = {
        "light": np.zeros((3, *SHAPE), np.float32), "texture": np.full((3, *SHAPE), 0.3, np.float32),
        "seen": np.ones(SHAPE, np.float32), "lids": np.zeros(SHAPE, np.float32),
        "apart": np.full(SHAPE, 0.1, np.float32), "white_seen": True,
    }  # fmt: skip
    return clues(**{**usual, **changed})  # type: ignore[arg-type]


def half(value: float, other: float) -> np.ndarray:
    plane = np.full(SHAPE, value, np.float32)
    plane[:, SHAPE[1] // 2 :] = other
    return plane


def _few_shaded() -> np.ndarray:
    """Log light of a chart of which an eighth lies in shade."""
    plane = half(0.2, 0.2)
    plane[:, -4:] = -1.5
    return plane


@pytest.mark.parametrize(("name", "changed"), [
    ("unseen", {"seen": half(1, 0)}),
    ("apart", {"apart": half(0.1, 0.6)}),
    ("shade", {"light": np.stack([_few_shaded()] * 3)}),
    ("clipped", {"texture": np.stack([half(0.3, 1.0)] * 3)}),
    ("dim", {"texture": np.stack([half(0.3, 0.01)] * 3)}),
    ("lids", {"lids": half(0, 1)}),
])  # fmt: skip
def test_each_clue_is_more_where_there_is_more_of_it(name: str, changed: dict[str, object]) -> None:
    plane = plain(**changed)[CLUES.index(name)]
    assert plane[:, -4:].mean() > plane[:, :4].mean() + 0.05, name


def test_degenerate_charts_have_finite_errors_within_the_range() -> None:
    for changed in ({"seen": np.zeros(SHAPE, np.float32)}, {"texture": np.zeros((3, *SHAPE), np.float32)},
                    {"apart": None}, {"light": np.full((3, *SHAPE), -9.0, np.float32)}):  # fmt: skip
        stated = error_model().stated(plain(**changed))
        assert np.isfinite(stated).all() and stated.min() >= LEAST and stated.max() <= MOST


def test_a_file_that_lacks_a_weight_is_refused(tmp_path: Path) -> None:
    for content in ("{", json.dumps({"weights": {"always": 1.0}}), json.dumps({"weights": dict.fromkeys(CLUES, None)}),
                    '{"weights": ' + json.dumps(dict.fromkeys(CLUES, float("inf"))) + "}"):  # fmt: skip
        (tmp_path / "error.json").write_text(content, "utf-8")
        with pytest.raises(ModelFault, match=r"error\.json"):
            ErrorModel.read(tmp_path / "error.json")


def test_the_posterior_is_that_of_a_gaussian_worked_out_by_hand() -> None:
    """One component of length 2 on one texel, seen in three channels with noise 0.5: 1 / (1 / 4 + 3 / 0.25)."""
    prior = AlbedoPrior(
        np.zeros((3, 1, 1), np.float32), np.full((1, 3, 1, 1), 2.0, np.float32), 0.5, np.ones((1, 1), np.float32)
    )
    found = float(prior.apart(np.ones((1, 1), np.float32))[0, 0])
    assert found == pytest.approx((1 / (1 / 4 + 3 / 0.25)) ** 0.5, rel=1e-5)
