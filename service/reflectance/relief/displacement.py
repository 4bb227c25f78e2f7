"""Displacement: specular normals integrated to heights in millimetres.

A tangent-space normal (x, y, z) tilts against the surface by -x/z per mm along u and -y/z per mm across; the chart's
metric turns that into a change per texel. Only relief finer than ``COARSEST_MM`` is kept: coarser shape is the mesh's,
and errors of integration are coarse.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.geometry.chart import Chart
from service.reflectance.normals import STEEPEST_Z
from service.reflectance.relief.cliffs import cliff_part
from service.reflectance.relief.integrate import MOST_STEPS, TOLERANCE, divergence, solve
from service.reflectance.result import MID, SCALE_MM, Integration, unpack_normals
from service.reflectance.texels import interpolated

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

COARSEST_MM = 6.0
MOST_MM = 1.0

LENGTH_SLACK = 0.2
"""A normal whose length is off 1 by more is not believed."""

_BAND = 256
_COARSE_WIDTH = 768
_RIDGE = 1e-3
"""Added to the variance of places (1 where there is no border), so that a strip one texel wide has a slope of 0."""
_SIGMAS = (1.0, 1.5, 2.25, 3.4, 5.0, 7.6, 11.4, 17.0, 26.0)


@dataclass(frozen=True)
class Steps:
    """How far a texel reaches on the surface, (h, w) float32 mm per texel of the whole map of ``width`` texels.

    With t the unit tangent along u and b across it: a step right is ``along`` t, one up is ``lean`` t + ``across`` b.
    """

    along: Float
    lean: Float
    across: Float
    width: int

    @classmethod
    def of(cls, chart: Chart, vertices: npt.NDArray[np.floating]) -> Steps:
        """Steps of a head (V, 3) metres; 0 where the chart or the surface has no area."""
        e, f, g = np.moveaxis(chart.metric(vertices), 2, 0)
        along = np.sqrt(np.maximum(e, 0))
        sound = along > 1e-6
        lean = np.where(sound, f / np.where(sound, along, 1), 0)
        across = np.sqrt(np.maximum(g - lean * lean, 0))
        along, lean, across = (chart.fill_outside(np.asarray(part, np.float32)) for part in (along, lean, across))
        return cls(along, lean, across, chart.width)

    def texel_mm(self) -> Float:
        """(h, w) side of a square of a texel's area."""
        return np.asarray(np.sqrt(self.along * self.across), np.float32)


def displacement(
    normals: npt.NDArray[np.int16],
    steps: Steps,
    mask: Mask,
    *,
    tolerance: float = TOLERANCE,
    most_steps: int = MOST_STEPS,
    keep_cliffs: bool = False,
) -> tuple[Float, Integration]:
    """Heights (H, W) float32 in mm, positive outwards, of relief finer than ``COARSEST_MM``, within +-``MOST_MM``.

    Args:
        normals: (H, W, 2) int16 codes of x and y, +Y up.
        steps: of the same chart, any size.
        mask: (H, W) bool, texels that belong to the surface; heights elsewhere are 0.
        tolerance: of the solver.
        most_steps: of the solver.
        keep_cliffs: whether equations on cliffs may be given up, see ``service.reflectance.relief.cliffs``.
    """
    right, down, usable = _differences(normals, steps, mask)
    asked = int(mask.sum())
    ignored = 1 - int(usable.sum()) / asked if asked else 0.0
    sources = divergence(right, down, usable)
    if not keep_cliffs:
        right = down = sources  # a map of 6144 x 4096 takes 100 MB
    solved = solve(sources, usable, tolerance=tolerance, most_steps=most_steps)
    del sources
    height, cut = solved.height, None
    if keep_cliffs:
        texel_mm = steps.texel_mm() * np.float32(steps.width / mask.shape[1])
        gained, cut = cliff_part(right, down, usable, texel_mm)
        height += gained
        del gained
    del right, down
    height -= coarse_part(height, usable, steps)
    _fill_holes(height, usable, mask)
    np.clip(height, -MOST_MM, MOST_MM, out=height)
    height *= mask
    return height, Integration(solved.steps, solved.residual, ignored, cut)


def slopes(normals: Float) -> tuple[Float, Float, Mask]:
    """Slope along t and along b (h, w) float32 of normals (h, w, 3), and which of them are to be believed.

    Normals steeper than 80 degrees count as 80. Those that are not finite, of length 0, or of a length off 1 by more
    than ``LENGTH_SLACK`` are taken as flat and not believed.
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


def coarse_part(height: Float, mask: Mask, steps: Steps) -> Float:
    """(H, W) heights smoothed by a Gaussian of ``COARSEST_MM`` on the surface, within the mask.

    The value is that of a plane fitted with the Gaussian as weight, not of the mean: at a border a mean comes from one
    side only, and any slope would leave a rim. The width of the Gaussian in texels differs over the chart; it is
    interpolated between a few fixed ones.
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


def _local_planes(total: Float, weight: Float, sigma: float) -> Float:
    """(h, w) value at each texel of the plane that fits the heights around it.

    All moments are about that texel: about the map's corner they would be differences of large numbers.

    Args:
        total: (h, w) height times weight.
        weight: (h, w) >= 0.
        sigma: of the Gaussian that the weights are multiplied with, in texels.
    """
    import cv2

    place = np.arange(-round(4 * sigma), round(4 * sigma) + 1) / sigma
    gauss = np.exp(-0.5 * place * place)
    kernels = [(gauss / gauss.sum() * place**power).astype(np.float32) for power in range(3)]

    def around(values: Float, x: int, y: int) -> Float:
        """Sum over the neighbourhood of values times x and y to some power."""
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


def encode(height: Float) -> npt.NDArray[np.uint16]:
    """(H, W) uint16 codes of heights in mm; see ``MID`` and ``SCALE_MM``."""
    return np.asarray(np.clip(np.rint(height * np.float32(1 / SCALE_MM)) + MID, 0, 65535), np.uint16)


def decode(codes: npt.NDArray[np.uint16]) -> Float:
    """Heights in mm of codes, to 25 nm."""
    return (codes.astype(np.float32) - MID) * np.float32(SCALE_MM)


def _differences(normals: npt.NDArray[np.int16], steps: Steps, mask: Mask) -> tuple[Float, Float, Mask]:
    """Change of height in mm per texel to the right and per texel down, and the texels where it is known."""
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
        s, t, believed = slopes(unpack_normals(normals[band]))
        right[band] = s * along
        down[band] = -(s * lean + t * across)
        usable[band] &= believed & (along > 0) & (across > 0)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(fill, range(0, height, _BAND)))
    return right, down, usable


def continue_beyond(height: Float, surface: Mask, outside: Mask, rounds: int = 3) -> None:
    """Let heights go on for three texels a round where ``outside`` is True, so that filtering meets no edge there."""
    known = surface
    for _ in range(rounds):
        known = _fill_holes(height, known, known | outside)


def _fill_holes(height: Float, known: Mask, mask: Mask) -> Mask:
    """Give texels of the mask without a height the mean of those within three texels; which have one then.

    Others stay 0. ``height`` is changed in place.
    """
    import cv2

    missing = mask & ~known
    if not missing.any():
        return known
    total = np.asarray(cv2.boxFilter(height * known, -1, (7, 7), normalize=False, borderType=cv2.BORDER_CONSTANT))
    weight = known.astype(np.float32)
    count = np.asarray(cv2.boxFilter(weight, -1, (7, 7), normalize=False, borderType=cv2.BORDER_CONSTANT))
    height[missing] = total[missing] / np.maximum(count[missing], 1)
    return known | (missing & (count > 0.5))
