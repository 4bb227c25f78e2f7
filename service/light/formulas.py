"""Formulas of light: networks written by ``export.light``, and the tables, lamps and constants that go with them."""

from __future__ import annotations

import functools

import numpy as np

from service.arrays import AnyFloat, Float32, Float64
from service.geometry.normals import normalise
from service.light.environment import GOLDEN_ANGLE
from service.light.scene import PointLight
from service.runtime.sessions import MODELS, Session, load_session

FOLDER = MODELS.parent / "light"

PIECE = 1 << 17
"""Points per run: some tens of intermediate planes then take tens of megabytes."""

_NOTHING = -1e30
"""Depth of empty cells."""


class Graphs:
    """Runs graphs by name.

    Args:
        threads: compute threads of each.
    """

    def __init__(self, threads: int = 2) -> None:
        self._threads = threads

    def run(self, name: str, **inputs: AnyFloat) -> Float32:
        """The first output of one graph.

        Raises:
            ModelFault: the graph is missing, changed, or refuses the inputs.
            NumericFault: an input or the result is not finite.
        """
        arrays = {key: np.ascontiguousarray(value, np.float32) for key, value in inputs.items()}
        return np.asarray(_session(name, self._threads).run(arrays)[0], np.float32)

    def at_points(self, name: str, points: dict[str, Float32], **fixed: AnyFloat) -> Float32:
        """(C, N) or (N,) of a graph whose ``points`` are (C, N) or (N,), in pieces; raises as :meth:`run`."""
        count = next(iter(points.values())).shape[-1]
        parts = []
        for first in range(0, count, PIECE):
            # Graphs take maps (C, h, w), so points are passed as a map of one row.
            rows = {key: value[..., None, first : first + PIECE] for key, value in points.items()}
            parts.append(self.run(name, **rows, **fixed)[..., 0, :])
        if parts:
            return np.concatenate(parts, -1)
        width = 3 if name in ("irradiance", "reflection") or name.startswith("highlight") else 0
        return np.zeros((width, 0) if width else 0, np.float32)

    def lit(self, name: str, occluders: Float32, spacing_mm: float, points: Float32, towards: Float32) -> Float32:
        """(N,) share of light in [0, 1] from a direction or a point (3,), see ``models.lightstage.light.graphs``.

        Args:
            name: ``lit_from_direction`` or ``lit_from_point``.
            occluders: (3, M) mm.
            spacing_mm: how far apart they are.
            points: (6, N) position in mm and smooth unit normal.
            towards: direction, or position in mm.
        """
        cells = _cells(name, occluders, spacing_mm, towards)
        blank = np.full((cells, cells), _NOTHING, np.float32)
        axis = "direction" if name == "lit_from_direction" else "light_mm"
        one = np.asarray(spacing_mm, np.float32)
        return self.run(name, occluders=occluders, points=points, spacing_mm=one, blank=blank, **{axis: towards})


@functools.lru_cache(maxsize=16)
def _session(name: str, threads: int) -> Session:
    return load_session(name, threads, FOLDER, in_order=True)


def lamp_numbers(light: PointLight) -> dict[str, Float32]:
    """A lamp as inputs of the graphs."""
    numbers = {"at": light.position_m, "intensity": light.intensity, "radius": light.radius_m}
    return {name: np.asarray(value, np.float32) for name, value in numbers.items()}


def _cells(name: str, occluders: Float32, spacing_mm: float, towards: Float32) -> int:
    """Side of the depth map in cells, an upper bound of what the graph uses; at most 2049."""
    diagonal = float(np.linalg.norm(occluders.max(1) - occluders.min(1)))
    if name == "lit_from_direction":
        return min(int(np.ceil(diagonal / (1.6 * spacing_mm))), 2048) + 2
    distance = np.linalg.norm(occluders - towards[:, None], axis=0)
    if float(distance.min()) < 0.5 * diagonal:
        return 2049  # so near that the head may fill any angle
    angle = 2.0 * np.arctan(0.5 * diagonal / float(distance.min())) * 1.5
    return min(int(np.ceil(angle * float(np.median(distance)) * 1.01 / (1.6 * spacing_mm))), 2047) + 2


F0_SCALE = 0.04
"""Reflectance at normal incidence of specular albedo 1 (glTF's default)."""

SMALLEST_ALPHA = 0.03
"""GGX alpha below which lobes are not made narrower."""


def mirror_weights(reflected: Float64, alpha: Float64, directions: Float64) -> Float64:
    """(K, D) weights, sum 1, of the radiance of D directions in the reflection at K rough points."""
    cosine = np.clip(reflected @ directions.T, -1.0, 1.0)
    d = 1.0 - 0.5 * (1.0 + cosine) * (1.0 - np.clip(alpha, 0.08, 1.0)[:, None] ** 2)
    weight = np.maximum(cosine, 0.0) / (d * d)
    return np.asarray(weight / np.maximum(weight.sum(1, keepdims=True), 1e-12))


def mirror_openness(openness: Float64, n_v: Float64, alpha: Float64) -> Float64:
    """Specular occlusion in [0, 1] of a lobe from ambient occlusion (Lagarde and de Rousiers 2014)."""
    power = np.exp2(-16.0 * np.sqrt(np.clip(alpha, SMALLEST_ALPHA, 1.0)) - 1.0)
    return np.asarray(np.clip(np.maximum(n_v + openness, 0.0) ** power - 1.0 + openness, 0.0, 1.0))


SHARP_RAD = 0.002
"""Angular radius as seen from the head below which a lamp counts as a point."""


def disc_of(light: PointLight, centre_m: Float64) -> Float64:
    """(S, 3) metres, points on the disc that faces the head, S = 1 to 16 (sunflower pattern).

    Args:
        light: the lamp.
        centre_m: (3,) middle of the head.
    """
    at = np.asarray(light.position_m, np.float64)
    towards = np.asarray(centre_m, np.float64) - at
    distance = max(float(np.linalg.norm(towards)), 1e-3)
    if light.radius_m / distance < SHARP_RAD:
        return at[None]
    axis = normalise(towards)
    right = np.cross(np.eye(3)[int(np.abs(axis).argmin())], axis)
    right /= np.linalg.norm(right)
    up = np.cross(axis, right)
    count = int(min(16, 6 + 60 * light.radius_m / distance))
    # A lamp that reaches into the head would put samples on the head's far side.
    radius = min(light.radius_m, 0.9 * distance) * np.sqrt((np.arange(count) + 0.5) / count)
    angle = np.arange(count) * GOLDEN_ANGLE
    return np.asarray(at + radius[:, None] * (np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up))
