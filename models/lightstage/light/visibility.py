"""What hides a light: depth maps of the head's own points as seen from the light (Williams 1978).

The head is a dense set of points on its triangles. Splatting points needs no rasteriser, runs the same on CPU and GPU,
and allows any projection, so a light may stand anywhere, even on the skin.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from models.lightstage.light.sampling import dot
from service.light.shading import HORIZON

_BIAS_MM = 0.6
_SOFT_MM = 0.8
_CELLS = 1.5  # a point of the nearest four cells is at most this far away
_STEEPEST = 8.0


@dataclass(frozen=True)
class Points:
    """Texels whose light is asked for: position (3, N) in mm and unit normal (3, N) of the smooth surface, float32."""

    position: Tensor
    normal: Tensor


def _axes(towards: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit vectors orthogonal to a unit vector and to each other."""
    axis = (torch.arange(3, device=towards.device) == towards.abs().argmin()).to(towards.dtype)
    right = torch.linalg.cross(axis, towards)
    right = right / right.norm()
    return right, torch.linalg.cross(towards, right)


@dataclass(frozen=True)
class View:
    """Occluders as a light sees them, before they are drawn.

    Attributes:
        plane: (2, M) where they lie across the line of sight; ``height`` (M,) how near to the light.
        low: (2,) least of ``plane``; ``cell`` () width of a cell of the depth map, in the unit of ``plane``.
        size: () int64 cells a side that the depth map needs.
    """

    plane: Tensor
    height: Tensor
    low: Tensor
    cell: Tensor
    size: Tensor

    @classmethod
    def of(cls, plane: Tensor, height: Tensor, cell: Tensor) -> View:
        """Place the depth map about the occluders."""
        low = plane.amin(1)
        size = ((plane.amax(1) - low).max() / cell).ceil().clamp(1, 2048).long() + 1
        return cls(plane, height, low, cell, size)

    def blank(self) -> Tensor:
        """A depth map of just the size that is needed, in which there is nothing."""
        return torch.full((int(self.size), int(self.size)), -math.inf, device=self.plane.device)

    def depth(self, blank: Tensor) -> Tensor:
        """(S, S) greatest height over each cell, -inf where there is none; ``blank`` has at least ``size`` cells."""
        at = ((self.plane - self.low[:, None]) / self.cell).floor().long()
        at = torch.minimum(at.clamp(min=0), self.size - 1)
        index = at[1] * blank.shape[1] + at[0]
        return blank.reshape(-1).scatter_reduce(0, index, self.height, "amax").view(blank.shape)

    def lit(self, blank: Tensor, plane: Tensor, height: Tensor, slack: Tensor) -> Tensor:
        """(N,) share of light, bilinear between the verdicts of four cells (percentage-closer filtering)."""
        depth = self.depth(blank).reshape(-1)
        at = (plane - self.low[:, None]) / self.cell - 0.5
        corner = at.floor()
        fx, fy = at - corner
        x0, y0 = corner.long()
        total = torch.zeros_like(height)
        for dx, wx in ((0, 1.0 - fx), (1, fx)):
            for dy, wy in ((0, 1.0 - fy), (1, fy)):
                row = torch.minimum((y0 + dy).clamp(min=0), self.size - 1)
                column = torch.minimum((x0 + dx).clamp(min=0), self.size - 1)
                above = depth[row * blank.shape[1] + column] - height - slack
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
    view = along(occluders, spacing_mm, direction)
    return reached_from_direction(view, view.blank(), points, direction)


def along(occluders: Tensor, spacing_mm: float | Tensor, direction: Tensor) -> View:
    """Occluders as seen against a unit ``direction``."""
    cell = torch.as_tensor(1.6 * spacing_mm, device=occluders.device, dtype=occluders.dtype)
    return View.of(_across(occluders.T, *_axes(direction)), dot(direction, occluders.T), cell)


def reached_from_direction(view: View, blank: Tensor, points: Points, direction: Tensor) -> Tensor:
    """(N,) as ``lit_from_direction``, with the view of :func:`along` and a depth map to draw it into."""
    cosine = dot(direction, points.normal)
    slack = _BIAS_MM + _CELLS * view.cell * _tangent(cosine)
    place = points.position
    lit = view.lit(blank, _across(place, *_axes(direction)), dot(direction, place), slack)
    return torch.where(cosine > 0.0, lit, torch.zeros_like(lit))


def _across(points: Tensor, right: Tensor, up: Tensor) -> Tensor:
    """(2, N) of points (3, N); not a matrix product, which runtimes are slow at for so few rows."""
    return torch.stack([dot(right, points), dot(up, points)])


def _tangent(cosine: Tensor) -> Tensor:
    c = cosine.clamp(1e-3, 1.0)
    return ((1.0 - c * c).clamp(min=0.0).sqrt() / c).clamp(max=_STEEPEST)


def _around(offset: Tensor, right: Tensor, up: Tensor, towards: Tensor) -> tuple[Tensor, Tensor]:
    """(2, N) angles about ``towards`` (azimuthal equidistant) and (N,) distances of offsets (3, N) from a light."""
    distance = offset.square().sum(0).sqrt().clamp(min=1e-6)
    x, y, z = dot(right, offset), dot(up, offset), dot(towards, offset)
    across = (x * x + y * y).sqrt()
    angle = torch.atan2(across, z) / across.clamp(min=1e-9)
    return torch.stack([x * angle, y * angle]), distance


def lit_from_point(occluders: Tensor, spacing_mm: float, points: Points, light_mm: Tensor) -> Tensor:
    """(N,) share in [0, 1] of the light of a point at (3,) mm that reaches each of ``points``."""
    view = around(occluders, spacing_mm, light_mm)
    return reached_from_point(view, view.blank(), occluders, points, light_mm)


def _line_of_sight(occluders: Tensor, light_mm: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Right, up and forward of a light that looks at the middle of the occluders; at -z from within them."""
    towards = 0.5 * (occluders.amin(0) + occluders.amax(0)) - light_mm
    reach = towards.norm()
    back = -(torch.arange(3, device=occluders.device) == 2).to(towards.dtype)
    towards = torch.where(reach > 1e-3, towards / reach.clamp(min=1e-3), back)
    return (*_axes(towards), towards)


def around(occluders: Tensor, spacing_mm: float | Tensor, light_mm: Tensor) -> View:
    """Occluders as seen from a point at (3,) mm, in angles."""
    plane, distance = _around((occluders - light_mm).T, *_line_of_sight(occluders, light_mm))
    # Cells as wide as the points are apart where most of the head is; what is much nearer to the light has its own.
    middle = distance.sort().values[(distance.shape[0] - 1) // 2]
    return View.of(plane, -distance, (1.6 * spacing_mm / middle.clamp(min=10.0)).clamp(min=1e-7))


def reached_from_point(view: View, blank: Tensor, occluders: Tensor, points: Points, light_mm: Tensor) -> Tensor:
    """(N,) as ``lit_from_point``, with the view of :func:`around` and a depth map to draw it into."""
    offset = points.position - light_mm[:, None]
    at, far = _around(offset, *_line_of_sight(occluders, light_mm))
    cosine = -(offset * points.normal).sum(0) / far
    slack = _BIAS_MM + _CELLS * view.cell * far * _tangent(cosine)
    lit = view.lit(blank, at, -far, slack)
    # Points outside the frame of the depth map have nothing before them.
    low = view.low[:, None]
    outside = ((at < low) | (at > low + view.cell * view.size)).any(0)
    lit = torch.where(outside, torch.ones_like(lit), lit)
    # Relief may tilt towards a light just below the smooth horizon, not to one far below it.
    return lit * ((cosine + HORIZON) / HORIZON).clamp(0.0, 1.0)
