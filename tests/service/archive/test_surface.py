"""Masked cards are lit as the body that they make up, in every pose; other parts by their own surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.archive.surfaces import vertex_normals
from service.materials.material import Material
from service.materials.part import MeshPart, part_normals
from tests.service.archive.toys import toy_part


def ball_of_cards(seed: int = 4) -> tuple[MeshPart, np.ndarray]:
    """Cards at all angles on a ball, half of them wound inwards."""
    rng = np.random.default_rng(seed)
    away = rng.normal(size=(300, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    points = (0.1 * away[:, None] + rng.normal(0, 0.004, (300, 3, 3))).reshape(-1, 3).astype(np.float32)
    faces = np.arange(900).reshape(-1, 3).astype(np.int32)
    part = toy_part(vertices=points, neutral=points, faces=faces, uv=np.zeros((900, 2), np.float32), targets={})
    return part, np.repeat(away, 3, 0)


def test_cards_have_the_normals_of_their_body() -> None:
    part, away = ball_of_cards()
    normals = part_normals(part, part.neutral, part.faces)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    own = np.einsum("ni,ni->n", vertex_normals(part.neutral, part.faces), away)
    assert (own < 0).mean() > 0.3 and np.einsum("ni,ni->n", normals, away).min() > 0.4
    both = part_normals(part, np.stack([part.neutral, part.neutral + 1]), part.faces)
    np.testing.assert_allclose(both[0], normals, atol=1e-6)
    np.testing.assert_allclose(both[1], normals, atol=1e-4)
