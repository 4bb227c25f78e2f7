"""PCA of sampled heads, eyeballs, macro weights."""

from __future__ import annotations

import numpy as np
import pytest

from models.head.identity import FLIP, align, identity_basis


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
