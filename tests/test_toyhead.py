"""The toy head keeps the promises that tests built on it rely on."""

from __future__ import annotations

import numpy as np

from service.geometry.normals import face_normals
from tests.toyhead import CENTRE, RADIUS, sphere_head


def test_every_triangle_faces_outward_on_the_chart_and_in_space() -> None:
    head = sphere_head()
    uv = head.uv[head.triangle_uv].astype(float)
    d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    assert (d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1] > 0).all()
    skin = head.triangle_part == 0
    normals = face_normals(head.mean, head.triangles[skin])
    outward = head.mean[head.triangles[skin]].mean(1) - CENTRE
    assert (np.einsum("ti,ti->t", normals, outward) > 0).all()


def test_mirror_is_exact_and_its_own_inverse() -> None:
    head = sphere_head()
    assert np.array_equal(head.mirror[head.mirror], np.arange(len(head.mean)))
    assert np.allclose(head.mean[head.mirror], head.mean * [-1, 1, 1], atol=1e-7)


def test_skin_lies_on_the_sphere_and_indices_are_valid() -> None:
    head = sphere_head()
    skin = np.unique(head.triangles[head.triangle_part == 0])
    assert np.allclose(np.linalg.norm(head.mean[skin] - CENTRE, axis=1), RADIUS, atol=1e-6)
    assert head.triangles.max() == len(head.mean) - 1
    assert head.triangle_uv.max() == len(head.uv) - 1
    assert ((head.uv >= 0) & (head.uv <= 1)).all()
    assert head.landmark_triangle.shape == (468,)
    assert (head.triangle_part[head.landmark_triangle] == 0).all()
