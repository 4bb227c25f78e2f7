"""What hides a light: depth maps of the head's own points as seen from the light (Williams 1978).

The head is a dense set of points on its triangles. Splatting points needs no rasteriser, runs the same on CPU and GPU,
and allows any projection, so a light may stand anywhere, even on the skin.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from service.scene.shading import HORIZON

_BIAS_MM = 0.6
_SOFT_MM = 0.8
_CELLS = 1.5  # a point of the nearest four cells is at most this far away
_STEEPEST = 8.0
_GOLDEN = math.pi * (3.0 - math.sqrt(5.0))


def surface_points(
    vertices_mm: npt.NDArray[np.floating], triangles: npt.NDArray[np.integer], spacing_mm: float
) -> npt.NDArray[np.float32]:
    """(N, 3) float32 points on all triangles, nowhere further apart than ``spacing_mm``; triangles without area too."""
    corners = np.asarray(vertices_mm, np.float64)[triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, 1), axis=2).max(1)
    steps = np.clip(np.ceil(edges / spacing_mm), 1, 256).astype(int)
    points = []
    for n in np.unique(steps):
        i, j = np.divmod(np.arange((n + 1) ** 2), n + 1)
        keep = i + j <= n
        weights = np.stack([i, j, n - i - j], 1)[keep] / n
        points.append(np.einsum("kc,tcd->tkd", weights, corners[steps == n]).reshape(-1, 3))
    return np.concatenate(points).astype(np.float32) if points else np.zeros((0, 3), np.float32)


@dataclass(frozen=True)
class Points:
    """Texels whose light is asked for: position (3, N) in mm and unit normal (3, N) of the smooth surface, float32."""

    position: Tensor
    normal: Tensor


def _axes(towards: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit vectors orthogonal to a unit vector and to each other."""
    axis = torch.zeros_like(towards)
    axis[int(towards.abs().argmin())] = 1.0
    right = torch.linalg.cross(axis, towards)
    right = right / right.norm()
    return right, torch.linalg.cross(towards, right)


def _splat(plane: Tensor, height: Tensor, low: Tensor, cell: Tensor, size: int) -> Tensor:
    """(size, size) greatest height over each cell, -inf where there is no point."""
    index = ((plane - low[:, None]) / cell).floor().long().clamp(0, size - 1)
    depth = torch.full((size * size,), -math.inf, device=plane.device)
    return depth.scatter_reduce(0, index[1] * size + index[0], height, "amax").view(size, size)


def _lit(depth: Tensor, plane: Tensor, height: Tensor, slack: Tensor, low: Tensor, cell: Tensor) -> Tensor:
    """(N,) share of light, bilinear between the verdicts of the four nearest cells (percentage-closer filtering)."""
    size = depth.shape[0]
    at = (plane - low[:, None]) / cell - 0.5
    corner = at.floor()
    fx, fy = at - corner
    x0, y0 = corner.long()
    flat = depth.view(-1)
    total = torch.zeros_like(height)
    for dx, wx in ((0, 1.0 - fx), (1, fx)):
        for dy, wy in ((0, 1.0 - fy), (1, fy)):
            index = (y0 + dy).clamp(0, size - 1) * size + (x0 + dx).clamp(0, size - 1)
            above = flat[index] - height - slack
            total = total + wx * wy * (1.0 - (above / _SOFT_MM).clamp(0.0, 1.0))
    return total


def lit_from_direction(occluders: Tensor, spacing_mm: float, points: Points, direction: Tensor) -> Tensor:
    """(N,) share in [0, 1] of parallel light from a unit ``direction`` that reaches each point; 0 behind the horizon.

    Args:
        occluders: (M, 3) float32 mm.
        spacing_mm: how far apart they are, about.
        points: where.
        direction: (3,) towards the light.
    """
    right, up = _axes(direction)
    frame = torch.stack([right, up])
    plane, height = frame @ occluders.T, occluders @ direction
    low = plane.amin(1)
    cell = torch.as_tensor(1.6 * spacing_mm, device=plane.device)
    size = int(((plane.amax(1) - low).max() / cell).ceil().clamp(1, 2048)) + 1
    depth = _splat(plane, height, low, cell, size)
    cosine = direction @ points.normal
    slack = _BIAS_MM + _CELLS * cell * _tangent(cosine)
    lit = _lit(depth, frame @ points.position, direction @ points.position, slack, low, cell)
    return torch.where(cosine > 0.0, lit, 0.0)


def _tangent(cosine: Tensor) -> Tensor:
    c = cosine.clamp(1e-3, 1.0)
    return ((1.0 - c * c).clamp(min=0.0).sqrt() / c).clamp(max=_STEEPEST)


def _around(offset: Tensor, right: Tensor, up: Tensor, towards: Tensor) -> tuple[Tensor, Tensor]:
    """(2, N) angles about ``towards`` (azimuthal equidistant) and (N,) distances of offsets (3, N) from a light."""
    distance = offset.square().sum(0).sqrt().clamp(min=1e-6)
    x, y, z = right @ offset, up @ offset, towards @ offset
    across = (x * x + y * y).sqrt()
    angle = torch.atan2(across, z) / across.clamp(min=1e-9)
    return torch.stack([x * angle, y * angle]), distance


def lit_from_point(occluders: Tensor, spacing_mm: float, points: Points, light_mm: Tensor) -> Tensor:
    """(N,) share in [0, 1] of the light of a point at (3,) mm that reaches each of ``points``."""
    centre = 0.5 * (occluders.amin(0) + occluders.amax(0))
    towards = centre - light_mm
    reach = towards.norm()
    towards = towards / reach if float(reach) > 1e-3 else torch.tensor([0.0, 0.0, -1.0], device=occluders.device)
    right, up = _axes(towards)
    plane, distance = _around((occluders - light_mm).T, right, up, towards)
    low = plane.amin(1)
    extent = (plane.amax(1) - low).max()
    # Cells as wide as the points are apart where most of the head is; what is much nearer to the light has its own.
    typical = distance.median().clamp(min=10.0)
    cell = (1.6 * spacing_mm / typical).clamp(min=1e-7)
    size = int((extent / cell).ceil().clamp(1, 2048)) + 1
    depth = _splat(plane, -distance, low, cell, size)
    offset = points.position - light_mm[:, None]
    at, far = _around(offset, right, up, towards)
    cosine = -(offset * points.normal).sum(0) / far
    slack = _BIAS_MM + _CELLS * cell * far * _tangent(cosine)
    lit = _lit(depth, at, -far, slack, low, cell)
    # Points outside the frame of the depth map have nothing before them.
    outside = ((at < low[:, None]) | (at > low[:, None] + cell * size)).any(0)
    lit = torch.where(outside, 1.0, lit)
    # Relief may tilt towards a light just below the smooth horizon, not to one far below it.
    return lit * ((cosine + HORIZON) / HORIZON).clamp(0.0, 1.0)


def lit_from_ball(
    occluders: Tensor, spacing_mm: float, points: Points, light_mm: Tensor, radius_mm: float, samples: int
) -> Tensor:
    """(N,) share of the light of a ball: mean over points on its disc as seen from the head (sunflower pattern)."""
    if radius_mm <= 0.0 or samples <= 1:
        return lit_from_point(occluders, spacing_mm, points, light_mm)
    towards = 0.5 * (occluders.amin(0) + occluders.amax(0)) - light_mm
    distance = towards.norm().clamp(min=1e-3)
    right, up = _axes(towards / distance)
    radius = min(radius_mm, 0.9 * float(distance))
    total = torch.zeros_like(points.position[0])
    for k in range(samples):
        r, angle = radius * math.sqrt((k + 0.5) / samples), k * _GOLDEN
        at = light_mm + (right * math.cos(angle) + up * math.sin(angle)) * r
        total = total + lit_from_point(occluders, spacing_mm, points, at)
    return total / samples
