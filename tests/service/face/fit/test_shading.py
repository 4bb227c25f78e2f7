"""The derivatives behind the shading term, against finite differences."""

import numpy as np

from service.face.fit.shading import normal_derivative
from service.geometry.normals import normalise
from service.light.harmonics import BAND_GAIN, gradient, sh_basis

RNG = np.random.default_rng(9)


def test_gradient_of_spherical_harmonics() -> None:
    n = normalise(RNG.normal(size=(20, 3)))
    light = RNG.normal(size=9)
    numeric = [((sh_basis(n + e) - sh_basis(n - e)) @ light) / 2e-6 for e in np.eye(3) * 1e-6]
    np.testing.assert_allclose(gradient(n, BAND_GAIN * light), np.stack(numeric, 1), atol=1e-6)


def test_derivative_of_normals() -> None:
    """A fan of triangles around one vertex; a second vertex has no area at all and must not give NaN."""
    ring = np.array([[np.cos(t), np.sin(t), 0.1 * np.sin(3 * t)] for t in np.linspace(0, 2 * np.pi, 6, endpoint=False)])
    vertices = np.vstack([[0.0, 0, 0.3], ring, [[5.0, 5, 5]] * 3])
    triangles = np.array([[0, 1 + i, 1 + (i + 1) % 6] for i in range(6)] + [[7, 8, 9]], np.int32)
    modes = RNG.normal(size=(4, len(vertices), 3)).astype(np.float32)
    modes[:, 7:] = 0

    def normal(v: np.ndarray) -> np.ndarray:
        p = v[triangles[:6]]
        return normalise(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]).sum(0))

    found = normal_derivative(vertices, modes, triangles, np.array([0, 7]))
    numeric = [(normal(vertices + 1e-6 * m) - normal(vertices - 1e-6 * m)) / 2e-6 for m in modes.astype(float)]
    np.testing.assert_allclose(found[0], np.stack(numeric, 1), atol=1e-5)
    assert not found[1].any()
