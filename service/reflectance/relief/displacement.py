"""Displacement: specular normals integrated to heights in millimetres.

A tangent-space normal (x, y, z) has slopes -x/z along u and -y/z across it; the chart's metric turns these into changes
of height per texel. Only relief finer than ``COARSEST_MM`` is kept: coarser shape belongs to the mesh, and errors of
the integration are coarse.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, Bool, Float32, UInt16
from service.geometry.chart import Chart
from service.reflectance.normals import STEEPEST_Z
from service.reflectance.relief.cliffs import cliff_part
from service.reflectance.relief.integrate import MOST_STEPS, TOLERANCE, divergence, solve
from service.reflectance.result import MID, SCALE_MM, Integration, unpack_normals
from service.reflectance.texels import interpolated

COARSEST_MM = 6.0
"""Standard deviation, on the surface, of the Gaussian that separates coarse shape from relief."""

MOST_MM = 1.0
"""Largest height, above or below the mesh."""

LENGTH_SLACK = 0.2
"""Largest difference from 1 of the length of a usable normal."""

_BAND = 256
"""Rows of the full map at a time."""

_COARSE_WIDTH = 768
"""Width of the map on which coarse shape is computed, texels."""

_RIDGE = 1e-3
"""Added to the variance of positions (1 away from borders), so that a plane in a strip one texel wide has slope 0."""

_SIGMAS = (1.0, 1.5, 2.25, 3.4, 5.0, 7.6, 11.4, 17.0, 26.0)
"""Standard deviations, in texels, of the Gaussians between which is interpolated."""


@dataclass(frozen=True)
class Steps:
    """Extent of a texel on the surface, (h, w) float32 mm per texel of a map of ``width`` texels.

    With the unit tangent t along u and b across it in the surface, one texel to the right is ``along`` t and one up is
    ``lean`` t + ``across`` b: the columns of the chart's Jacobian.
    """

    along: Float32
    lean: Float32
    across: Float32
    width: int

    @classmethod
    def of(cls, chart: Chart, vertices: AnyFloat) -> Steps:
        """From the vertices (V, 3) of a head in metres; 0 where the chart or the surface has no area."""
        e, f, g = np.moveaxis(chart.metric(vertices), 2, 0)
        along = np.sqrt(np.maximum(e, 0))
        sound = along > 1e-6
        lean = np.where(sound, f / np.where(sound, along, 1), 0)
        across = np.sqrt(np.maximum(g - lean * lean, 0))
        along, lean, across = (chart.fill_outside(np.asarray(part, np.float32)) for part in (along, lean, across))
        return cls(along, lean, across, chart.width)

    def texel_mm(self) -> Float32:
        """(h, w) mm, side of a square with a texel's area."""
        return np.asarray(np.sqrt(self.along * self.across), np.float32)


def displacement(
    normals: npt.NDArray[np.int16],
    steps: Steps,
    mask: Bool,
    *,
    tolerance: float = TOLERANCE,
    most_steps: int = MOST_STEPS,
    keep_cliffs: bool = False,
) -> tuple[Float32, Integration]:
    """Heights (H, W) float32 in mm, positive outwards, of relief finer than ``COARSEST_MM``, within +-``MOST_MM``.

    Args:
        normals: (H, W, 2) int16 codes of x and y, +Y up.
        steps: of the same chart, at any size.
        mask: (H, W) bool, texels of the surface; heights elsewhere are 0.
        tolerance: relative residual at which the solver stops.
        most_steps: of the solver.
        keep_cliffs: whether equations across cliffs may be given up, see ``service.reflectance.relief.cliffs``.
    """
    right, down, usable = _differences(normals, steps, mask)
    texels = int(mask.sum())
    ignored = 1 - int(usable.sum()) / texels if texels else 0.0
    sources = divergence(right, down, usable)
    if not keep_cliffs:
        right = down = sources  # frees the slopes: 100 MB each for a map of 6144 x 4096
    solved = solve(sources, usable, tolerance=tolerance, most_steps=most_steps)
    del sources
    height, cut = solved.height, None
    if keep_cliffs:
        texel_mm = steps.texel_mm() * np.float32(steps.width / mask.shape[1])
        difference, cut = cliff_part(right, down, usable, texel_mm)
        height += difference
        del difference
    del right, down
    height -= coarse_part(height, usable, steps)
    _fill_holes(height, usable, mask)
    np.clip(height, -MOST_MM, MOST_MM, out=height)
    height *= mask
    return height, Integration(solved.steps, solved.residual, ignored, cut)


def slopes(normals: Float32) -> tuple[Float32, Float32, Bool]:
    """Slopes (h, w) float32 of normals (h, w, 3) along x and y, and (h, w) bool, which normals are usable.

    Slopes are limited to 80 degrees. Normals that are not finite, or whose length differs from 1 by more than
    ``LENGTH_SLACK``, are not usable and count as flat.
    """
    clean = np.where(np.isfinite(normals), normals, 0).astype(np.float32)
    length = np.sqrt(np.einsum("yxi,yxi->yx", clean, clean))
    usable = np.isfinite(normals).all(-1) & (np.abs(length - 1) <= LENGTH_SLACK)
    unit = clean / np.maximum(length, 1e-6)[..., None]
    flat = np.hypot(unit[..., 0], unit[..., 1])
    z = np.maximum(unit[..., 2], STEEPEST_Z)
    most = np.float32(np.sqrt(1 - STEEPEST_Z**2))
    shorter = np.where(flat > most, most / np.maximum(flat, most), 1)
    along, across = (np.where(usable, -unit[..., axis] * shorter / z, 0).astype(np.float32) for axis in (0, 1))
    return along, across, usable


def coarse_part(height: Float32, mask: Bool, steps: Steps) -> Float32:
    """(H, W) mm, heights smoothed by a Gaussian of ``COARSEST_MM`` on the surface, within the mask.

    At each texel a plane is fitted with the Gaussian as weight. A weighted mean would not do: at a border it averages
    one side only, so that any slope would leave a rim. The Gaussian's width in texels varies over the chart; the result
    is interpolated between a few fixed widths.
    """
    import cv2

    width = min(_COARSE_WIDTH, height.shape[1])
    size = (width, max(width * height.shape[0] // height.shape[1], 1))
    weight = np.asarray(cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)
    total = np.asarray(cv2.resize(height, size, interpolation=cv2.INTER_AREA), np.float32)  # 0 outside the mask
    mm = np.asarray(cv2.resize(steps.texel_mm(), size, interpolation=cv2.INTER_AREA)) * (steps.width / size[0])
    sigma = COARSEST_MM / np.maximum(mm, 1e-3)
    level = np.interp(np.log(sigma), np.log(_SIGMAS), np.arange(len(_SIGMAS))).astype(np.float32)
    smooth = np.zeros(total.shape, np.float32)
    for index, width_px in enumerate(_SIGMAS):
        share = np.maximum(1 - np.abs(level - index), 0)
        if share.any():
            smooth += share * _local_planes(total, weight, width_px)
    result = np.asarray(cv2.resize(smooth, height.shape[::-1], interpolation=cv2.INTER_LINEAR))
    return np.asarray(result * mask, np.float32)


def _local_planes(total: Float32, weight: Float32, sigma: float) -> Float32:
    """(h, w) value at each texel of the plane fitted to the heights around it by weighted least squares.

    Moments are taken about that texel: about the map's corner, large numbers would cancel.

    Args:
        total: (h, w) height times weight.
        weight: (h, w) >= 0.
        sigma: standard deviation in texels of the Gaussian that multiplies the weights.
    """
    import cv2

    place = np.arange(-round(4 * sigma), round(4 * sigma) + 1) / sigma
    gauss = np.exp(-0.5 * place * place)
    kernels = [(gauss / gauss.sum() * place**power).astype(np.float32) for power in range(3)]

    def around(values: Float32, x: int, y: int) -> Float32:
        """Gaussian-weighted sum over the neighbourhood of values times dx^x dy^y."""
        return np.asarray(cv2.sepFilter2D(values, -1, kernels[x], kernels[y], borderType=cv2.BORDER_CONSTANT))

    mass = np.maximum(around(weight, 0, 0), 1e-9)
    mx, my, mh = around(weight, 1, 0) / mass, around(weight, 0, 1) / mass, around(total, 0, 0) / mass
    xx = around(weight, 2, 0) / mass - mx * mx + _RIDGE
    yy = around(weight, 0, 2) / mass - my * my + _RIDGE
    xy = around(weight, 1, 1) / mass - mx * my
    xh, yh = around(total, 1, 0) / mass - mx * mh, around(total, 0, 1) / mass - my * mh
    determinant = xx * yy - xy * xy
    along, down = (yy * xh - xy * yh) / determinant, (xx * yh - xy * xh) / determinant
    return np.asarray(mh - along * mx - down * my, np.float32)


def encode(height: Float32) -> UInt16:
    """(H, W) uint16 codes of heights in mm; see ``MID`` and ``SCALE_MM``."""
    return np.asarray(np.clip(np.rint(height * np.float32(1 / SCALE_MM)) + MID, 0, 65535), np.uint16)


def decode(codes: UInt16) -> Float32:
    """(H, W) float32 mm, heights of codes; rounding errors are at most 25 nm."""
    return (codes.astype(np.float32) - MID) * np.float32(SCALE_MM)


def _differences(normals: npt.NDArray[np.int16], steps: Steps, mask: Bool) -> tuple[Float32, Float32, Bool]:
    """(H, W) change of height in mm per texel to the right and per texel down, and (H, W) bool, where it is known."""
    height, width = mask.shape
    right, down, usable = np.zeros(mask.shape, np.float32), np.zeros(mask.shape, np.float32), mask.copy()
    columns = np.arange(width)
    to_texel = np.float32(steps.width / width)

    def fill(first: int) -> None:
        band = slice(first, min(first + _BAND, height))
        rows = np.arange(band.start, band.stop)
        along, lean, across = (
            interpolated(part, (width, height), rows, columns) * to_texel
            for part in (steps.along, steps.lean, steps.across)
        )
        slope_x, slope_y, sound = slopes(unpack_normals(normals[band]))
        right[band] = slope_x * along
        down[band] = -(slope_x * lean + slope_y * across)
        usable[band] &= sound & (along > 0) & (across > 0)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(fill, range(0, height, _BAND)))
    return right, down, usable


def pad_heights(height: Float32, surface: Bool, outside: Bool, rounds: int = 3) -> None:
    """Extend heights by three texels a round, in place, where ``outside`` is True, so that filters meet no edge."""
    known = surface
    for _ in range(rounds):
        known = _fill_holes(height, known, known | outside)


def _fill_holes(height: Float32, known: Bool, mask: Bool) -> Bool:
    """Set unknown texels of the mask to the mean of known ones within three texels, in place; the known ones after
    that.

    Texels without a known one so close stay 0.
    """
    import cv2

    missing = mask & ~known
    if not missing.any():
        return known
    side, none = (7, 7), cv2.BORDER_CONSTANT
    total = np.asarray(cv2.boxFilter(height * known, -1, side, normalize=False, borderType=none))
    count = np.asarray(cv2.boxFilter(known.astype(np.uint8), -1, side, normalize=False, borderType=none))  # at most 49
    height[missing] = total[missing] / np.maximum(count[missing], 1)
    return known | (missing & (count > 0))
