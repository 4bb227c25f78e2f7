"""Spherical-harmonic light against a numerical integral, and on faces that say nothing about light."""

import numpy as np
import pytest

from service.geometry.mesh import normalise
from service.light.formulas import BAND_GAIN, estimate_light, gradient, sh_basis

RNG = np.random.default_rng(5)


def sphere(n: int) -> np.ndarray:
    v = RNG.normal(size=(n, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def test_irradiance_of_a_smooth_sky_agrees_with_monte_carlo() -> None:
    """E(n) / pi of a band-limited environment, integrated by brute force: a wrong constant in any band shows."""
    light = RNG.normal(size=(9, 3)) * 0.1
    light[0] = 2.0
    directions = sphere(400_000)
    radiance = (sh_basis(directions) / np.array([1.0, *[2 / 3] * 3, *[1 / 4] * 5])) @ light
    for n in sphere(5):
        cosine = np.maximum(directions @ n, 0)
        irradiance = 4 * np.pi * (radiance * cosine[:, None]).mean(0)
        np.testing.assert_allclose(sh_basis(n[None])[0] @ light, irradiance / np.pi, rtol=0.02)


def test_recovers_light_in_spite_of_outliers() -> None:
    normals = sphere(3000)
    normals = normals[normals[:, 2] > 0.2]
    truth = np.zeros((9, 3))
    truth[0], truth[2], truth[3] = 2.5, 0.8, [0.5, 0.4, 0.3]
    colours = sh_basis(normals) @ truth * 0.4
    colours[: len(colours) // 10] *= 0.1
    found = estimate_light(normals, colours, np.ones(len(normals)))
    assert found is not None
    expected = sh_basis(normals) @ truth
    got = sh_basis(normals) @ found
    factor = (expected * got).sum() / (got**2).sum()
    assert np.abs(factor * got - expected).mean() < 0.05 * expected.mean()


@pytest.mark.parametrize("colour", [0.0, np.nan])
def test_black_or_broken_skin_has_no_light(colour: float) -> None:
    """Dividing by the mean of a black face would give infinite light."""
    assert estimate_light(sphere(500), np.full((500, 3), colour), np.ones(500)) is None


def test_one_normal_only_stays_finite() -> None:
    """All normals equal: the normal equations have rank one."""
    light = estimate_light(np.tile([0.0, 0, 1], (200, 1)), np.full((200, 3), 0.4), np.ones(200))
    assert light is not None and np.isfinite(light).all()


def test_gradient_of_spherical_harmonics() -> None:
    random = np.random.default_rng(9)
    n = normalise(random.normal(size=(20, 3)))
    light = random.normal(size=9)
    numeric = [((sh_basis(n + e) - sh_basis(n - e)) @ light) / 2e-6 for e in np.eye(3) * 1e-6]
    np.testing.assert_allclose(gradient(n, BAND_GAIN * light), np.stack(numeric, 1), atol=1e-6)
