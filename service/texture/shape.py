"""Shape as maps: normals of the fitted head in object and tangent space, and depth."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.geometry.chart import Chart
from service.geometry.mesh_field import laplacian, smooth_fit
from service.geometry.normals import normalise, vertex_normals

Float = npt.NDArray[np.float32]

OVERALL_SMOOTHNESS = 12.0
"""Weight of likeness between neighbours that turns the head's normals into those of its overall form."""

LEAST_Z = 0.05
"""Folds (ear, lids) can turn by more than a right angle from the overall form; a tangent-space map cannot show that."""


def shape_normals(chart: Chart, vertices: npt.NDArray[np.floating]) -> tuple[Float, Float]:
    """Normals (H, W, 3) float32 of a head (V, 3) in object space, and in the tangent space of its overall form.

    In the frame of the surface itself a smooth surface's normals are (0, 0, 1) everywhere and say nothing. The frame is
    therefore that of normals smoothed over the mesh (``OVERALL_SMOOTHNESS``), so the map shows nose, lips and
    eye sockets as a tangent-space map shows bumps: +Y up, z >= ``LEAST_Z`` before normalisation.
    """
    normal = vertex_normals(vertices, chart.head.triangles)
    frame = chart.frame(vertices, overall_normals(chart, normal))
    exact = chart.normals(vertices)
    axes = (frame.tangent, frame.bitangent, frame.normal)
    local = np.stack([np.einsum("hwi,hwi->hw", exact, axis) for axis in axes], -1)
    local[..., 2] = np.maximum(local[..., 2], LEAST_Z)
    local /= np.sqrt(np.einsum("hwi,hwi->hw", local, local))[..., None]
    return chart.fill_outside(exact), chart.fill_outside(local)


def overall_normals(chart: Chart, normal: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """(V, 3) unit normals smoothed over neighbours; where opposite ones cancel, the original."""
    edges = laplacian(chart.head.triangles, len(normal))
    smooth = smooth_fit(edges, normal, np.ones(len(normal)), OVERALL_SMOOTHNESS, np.zeros(3), 1e-6)
    length = np.sqrt((smooth * smooth).sum(1, keepdims=True))
    return np.where(length > 0.05, normalise(smooth), normal)


def depth_map(chart: Chart, vertices: npt.NDArray[np.floating]) -> Float:
    """(H, W) float32 metres: z of each texel in head space, continued beyond the islands."""
    depth = chart.interpolate(np.asarray(vertices)[:, 2])[..., 0]
    return chart.fill_outside(depth)
