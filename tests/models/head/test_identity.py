"""PCA of sampled heads, eyeballs, macro weights."""

from __future__ import annotations

import numpy as np
import pytest

from models.head.eyes import affine_weights, eyeball, sphere
from models.head.identity import FLIP, align, identity_basis
from models.head.macro import Person, hats, macro_names, macro_weights


def test_alignment_undoes_a_rigid_motion_and_never_mirrors() -> None:
    random = np.random.default_rng(0)
    target = random.normal(size=(40, 3))
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    weight = random.uniform(0.1, 1, 40)
    np.testing.assert_allclose(align(target @ turn.T + [1, 2, 3], target, weight), target, atol=1e-12)
    mirrored = align(target * FLIP, target, weight)
    assert np.linalg.norm(mirrored - target) > 1.0  # a reflection cannot be undone by a rotation


def test_basis_recovers_a_known_population() -> None:
    random = np.random.default_rng(1)
    mirror = np.concatenate([np.arange(10, 20), np.arange(10)])
    mean = random.normal(size=(20, 3))
    mean = 0.5 * (mean + mean[mirror] * FLIP)
    even, odd = random.normal(size=(2, 20, 3))
    even, odd = even + even[mirror] * FLIP, 0.3 * (odd - odd[mirror] * FLIP)
    heads = (
        mean
        + np.einsum("n,vc->nvc", random.normal(size=300), even)
        + np.einsum("n,vc->nvc", random.normal(size=300), odd)
    )
    basis = identity_basis(heads.astype(np.float32), mirror, np.ones(20), 2)
    np.testing.assert_allclose(basis.mean, mean, atol=0.5)
    for found, true in zip(basis.components, (even, odd), strict=True):
        cosine = (found * true).sum() / np.linalg.norm(found) / np.linalg.norm(true)
        assert abs(cosine) > 0.999
        assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(true), rel=0.15)
    assert basis.share.sum() == pytest.approx(1.0, abs=1e-3)


def test_eyeball_follows_every_affine_map() -> None:
    coarse = sphere()[0][::5] * 1.4 + [3, 1, 2]
    weights, polygons = eyeball(coarse)
    fine = weights @ coarse
    np.testing.assert_allclose(np.linalg.norm(fine - [3, 1, 2], axis=1), 1.4, atol=1e-9)
    shear = np.array([[1.1, 0.2, 0], [0, 0.9, 0.1], [0.1, 0, 1.2]])
    np.testing.assert_allclose(weights @ (coarse @ shear + 5), fine @ shear + 5, atol=1e-9)
    assert polygons[:, :3].min() >= 0
    np.testing.assert_allclose(affine_weights(coarse, coarse[:3]) @ coarse, coarse[:3], atol=1e-9)


def test_macro_weights_are_a_partition() -> None:
    person = Person(np.array([0.2, 0.3, 0.5]), 0.3, 0.8, 0.1, 0.65)
    weights = macro_weights(person)
    assert len(weights) == len(macro_names())
    assert weights[:18].sum() == pytest.approx(1.0)
    assert weights[18:].sum() == pytest.approx(1.0)
    np.testing.assert_allclose(hats(0.25, 3), [0.5, 0.5, 0.0])
    np.testing.assert_allclose(hats(7.0, 3), [0.0, 0.0, 1.0])
