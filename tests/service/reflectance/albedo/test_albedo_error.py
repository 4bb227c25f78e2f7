"""How sure the albedo is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from service.errors import ModelFault
from service.reflectance.albedo.albedo_error import CLUES, LEAST, MOST, ErrorModel, clues, error_model
from service.reflectance.albedo.albedo_prior import AlbedoPrior

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
