"""Maps of the head's shape: normals in object and tangent space, and depth."""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, Float32, Float64
from service.geometry.chart import Chart
from service.geometry.mesh_field import laplacian, smooth_fit
from service.geometry.normals import normalise, vertex_normals

OVERALL_SMOOTHNESS = 12.0
"""Weight of the smoothness term that turns the head's normals into those of its overall form."""

LEAST_Z = 0.05
"""Smallest z of a tangent-space normal before normalisation. In folds (ears, lids) the surface can be turned by more
than a right angle from the overall form, which a tangent-space map cannot represent."""


def shape_normals(chart: Chart, vertices: AnyFloat) -> tuple[Float32, Float32]:
    """Unit normals (H, W, 3) float32 of a head (V, 3) in object space, and in the tangent space of its overall form.

    In the tangent frame of the surface itself, a smooth surface's normals are (0, 0, 1) everywhere. The frame is
    therefore that of normals smoothed over the mesh (``OVERALL_SMOOTHNESS``), so that the map shows nose, lips and
    eye sockets: +Y up, z >= ``LEAST_Z`` before normalisation.
    """
    normal = vertex_normals(vertices, chart.head.triangles)
    frame = chart.frame(vertices, overall_normals(chart, normal))
    exact = chart.normals(vertices)
    axes = (frame.tangent, frame.bitangent, frame.normal)
    local = np.stack([np.einsum("hwi,hwi->hw", exact, axis) for axis in axes], -1)
    local[..., 2] = np.maximum(local[..., 2], LEAST_Z)
    local /= np.sqrt(np.einsum("hwi,hwi->hw", local, local))[..., None]
    return chart.fill_outside(exact), chart.fill_outside(local)


def overall_normals(chart: Chart, normal: AnyFloat) -> Float64:
    """(V, 3) unit normals smoothed over the mesh; where opposite ones cancel, the original."""
    edges = laplacian(chart.head.triangles, len(normal))
    smooth = smooth_fit(edges, normal, np.ones(len(normal)), OVERALL_SMOOTHNESS, np.zeros(3), 1e-6)
    length = np.sqrt((smooth * smooth).sum(1, keepdims=True))
    return np.where(length > 0.05, normalise(smooth), normal)


def depth_map(chart: Chart, vertices: AnyFloat) -> Float32:
    """(H, W) float32 metres: z of each texel in head space, extended beyond the islands."""
    depth = chart.interpolate(np.asarray(vertices)[:, 2])[..., 0]
    return chart.fill_outside(depth)
