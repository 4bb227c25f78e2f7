"""Formulas of light: spherical harmonics up to degree 2, and networks written by ``export.light`` with their tables.

The harmonics are those of an environment, and of the light on a face (Ramamoorthi and Hanrahan 2001).
"""

from __future__ import annotations

import functools

import numpy as np

from service.arrays import AnyFloat, Float32, Float64
from service.geometry.mesh import normalise
from service.light.environment import GOLDEN_ANGLE, pixel_directions, pixel_solid_angles
from service.light.scene import PointLight
from service.robust import geman_mcclure
from service.runtime.sessions import MODELS, Session, load_session

COSINE_LOBE = np.repeat([np.pi, 2.0 * np.pi / 3.0, np.pi / 4.0], [1, 3, 5])
"""(9,) factors of each coefficient when radiance is turned into irradiance."""


_C0, _C1, _C2 = 0.5 / np.sqrt(np.pi), np.sqrt(0.75 / np.pi), np.sqrt(3.75 / np.pi)
_C20, _C22 = 0.25 * np.sqrt(5 / np.pi), np.sqrt(0.9375 / np.pi)
"""Normalisation of the orders that share one: band 0, band 1, (2,-2) (2,-1) (2,1), (2,0), (2,2)."""


def basis(directions: AnyFloat) -> Float64:
    """(..., 9) values at unit directions (..., 3), in the order (0,0), (1,-1), (1,0), (1,1), (2,-2) ... (2,2).

    The polar axis of the functions is z.
    """
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    first = [np.full_like(x, _C0), _C1 * y, _C1 * z, _C1 * x]
    second = [_C2 * x * y, _C2 * y * z, _C20 * (3.0 * z * z - 1.0), _C2 * x * z, _C22 * (x * x - y * y)]
    return np.moveaxis(np.stack(first + second), 0, -1)


def gradient(directions: Float64, coefficients: Float64) -> Float64:
    """(N, 3) derivative of ``basis(d) @ coefficients`` by d, for directions (N, 3) and coefficients (9,)."""
    x, y, z = directions.T
    c = coefficients
    along_x = _C1 * c[3] + _C2 * (y * c[4] + z * c[7]) + 2 * _C22 * x * c[8]
    along_y = _C1 * c[1] + _C2 * (x * c[4] + z * c[5]) - 2 * _C22 * y * c[8]
    along_z = _C1 * c[2] + _C2 * (y * c[5] + x * c[7]) + 6 * _C20 * z * c[6]
    return np.stack([along_x, along_y, along_z], 1)


def project(radiance: AnyFloat) -> Float64:
    """(9, 3) coefficients of a latitude-longitude image (H, W, 3) of linear radiance."""
    height, width = radiance.shape[:2]
    weighted = basis(pixel_directions(height, width)) * pixel_solid_angles(height, width)[..., None]
    return np.asarray(np.einsum("hwk,hwc->kc", weighted, np.asarray(radiance, np.float64)))


def irradiance(coefficients: AnyFloat, normals: AnyFloat) -> Float64:
    """(..., 3) irradiance >= 0 on surfaces with unit normals (..., 3), without occlusion.

    Truncation at degree 2 rings for hard light; negative values are clipped to 0.
    """
    values = basis(normals) @ (COSINE_LOBE[:, None] * np.asarray(coefficients, np.float64))
    return np.asarray(np.maximum(values, 0.0))


LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear R, G, B (ITU-R BT.709) in float64; ``service.colour.LUMA`` is float32."""

BAND_GAIN = COSINE_LOBE / np.pi
"""Clamped-cosine transfer A_l / pi of the bands 0, 1, 2."""


def sh_basis(normals: Float64) -> Float64:
    """(N, 3) unit normals -> (N, 9) irradiance basis: harmonics times A_l / pi, so that ``basis @ light`` is E / pi."""
    return np.asarray(basis(normals) * BAND_GAIN, np.float64)


def estimate_light(normals: Float64, colours: Float64, weights: Float64) -> Float64 | None:
    """Estimate the light from skin colours (N, 3), linear RGB in [0, 1], up to the skin's unknown mean albedo.

    Ridge regression with robust weights: brows, lips and cast shadows are outliers of a one-albedo model. The light is
    in the frame of the unit normals (N, 3): (9, 3) coefficients scaled so that E / pi has a mean luminance of one over
    the skin; None where fewer than 30 points have weight or the skin is black.
    """
    used = (weights > 0) & np.isfinite(colours).all(1) & np.isfinite(normals).all(1)
    if int(used.sum()) < 30:
        return None
    rows, colour, weight = sh_basis(normals[used]), colours[used], weights[used]
    robust: Float64 = np.ones(len(weight))
    light: Float64 = np.zeros((9, 3))
    for _ in range(4):
        w = (weight * robust)[:, None]
        gram = rows.T @ (w * rows)
        # Ridge over the trace of the normal matrix: half the sphere of normals is never visible, so it is near
        # singular.
        gram += np.eye(9) * max(1e-3 * float(np.trace(gram)), 1e-12)
        light = np.asarray(np.linalg.solve(gram, rows.T @ (w * colour)), np.float64)
        residual = np.abs(colour - rows @ light).mean(1)
        spread = max(1.4826 * float(np.median(residual)), 1e-4)
        robust = geman_mcclure(residual, 2.5 * spread)
    mean = float(weight @ ((rows @ light) @ LUMINANCE) / weight.sum())
    if not np.isfinite(light).all() or mean < 1e-4:
        return None
    return np.asarray(light / mean)


FOLDER = MODELS.parent / "light"

PIECE = 1 << 17
"""Points per run: some tens of intermediate planes then take tens of megabytes."""


class Graphs:
    """Runs graphs by name, each on so many compute threads."""

    def __init__(self, threads: int = 2) -> None:
        self._threads = threads

    def run(self, name: str, **inputs: AnyFloat) -> Float32:
        """The first output of one graph.

        ModelFault: the graph is missing, changed, or refuses the inputs. NumericFault: an input or the result is not
        finite.
        """
        arrays = {key: np.ascontiguousarray(value, np.float32) for key, value in inputs.items()}
        return np.asarray(session(name, self._threads).run(arrays)[0], np.float32)

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

        ``name`` is ``lit_from_direction`` or ``lit_from_point`` (mm). Occluders are (3, M) mm, ``spacing_mm`` apart;
        points (6, N) positions in mm and smooth unit normals.
        """
        cells = _cells(name, occluders, spacing_mm, towards)
        # Depth of empty cells.
        blank = np.full((cells, cells), -1e30, np.float32)
        axis = "direction" if name == "lit_from_direction" else "light_mm"
        one = np.asarray(spacing_mm, np.float32)
        return self.run(name, occluders=occluders, points=points, spacing_mm=one, blank=blank, **{axis: towards})


@functools.lru_cache(maxsize=16)
def session(name: str, threads: int) -> Session:
    """A graph, kept once it is loaded; raises as :func:`service.runtime.sessions.load_session`."""
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


MOST_FLESH = 0.9
"""Largest albedo of what stands around; with 1 light would never leave a closed mouth."""


def with_flesh(irradiance: Float32, openness: Float32, albedo: Float32, radiosity: Float32) -> tuple[Float32, Float32]:
    """Irradiance with what flesh sends from where no sky is seen, and the radiosity of that flesh.

    Flesh near a point that sees little of the sky lies deep itself, and receives what the point does (Stewart and
    Langer 1997, eq. 12); near one that sees much it is the skin around the recess. Between them the share of the latter
    is the square root of the openness: the geometric mean of the point's and that of the open.

    Args:
        irradiance: (3, ...) linear, of sky and lamps.
        openness: (...) ambient occlusion in [0, 1], 1 = open.
        albedo: (3, ...) of the flesh.
        radiosity: (3, ...) of the skin around the recess.
    """
    hidden, outer = 1 - openness, np.sqrt(openness)
    inner = np.minimum(albedo, MOST_FLESH) * (1 - outer)
    total = (irradiance + hidden * outer * radiosity) / (1 - hidden * inner)
    return np.asarray(total, np.float32), np.asarray(outer * radiosity + inner * total, np.float32)


def disc_of(light: PointLight, centre_m: Float64) -> Float64:
    """(S, 3) metres, points on a lamp's disc that faces the head's middle (3,), S = 1 to 16 (sunflower pattern)."""
    at = np.asarray(light.position_m, np.float64)
    towards = np.asarray(centre_m, np.float64) - at
    distance = max(float(np.linalg.norm(towards)), 1e-3)
    # Angular radius as seen from the head below which a lamp counts as a point.
    if light.radius_m / distance < 0.002:
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
