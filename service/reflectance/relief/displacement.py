"""Displacement: specular normals integrated to heights in millimetres.

A tangent-space normal (x, y, z) has slopes -x/z along u and -y/z across it; the chart's metric turns these into changes
of height per texel. Only relief finer than ``COARSEST_MM`` is kept: coarser shape belongs to the mesh, and errors of
the integration are coarse.

Islands are integrated independently, so that heights at both sides of the chart's seams differ, where the chart is cut
but the surface is not. Each side is moved by half of the difference, fading out over ``REACH_MM``.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, Bool, Float32, Float64, Int64, UInt16
from service.geometry.chart import Chart, chart_points
from service.head.model import HeadModel
from service.image_filters import by_strips, shrunk, stretched_to, strips
from service.manifest import Integration
from service.reflectance.planes import read_window
from service.reflectance.reflectance_maps import MID, MOST_ACROSS, SCALE_MM, STEEPEST_Z, unpack_normals
from service.reflectance.relief.integration import MOST_STEPS, TOLERANCE, divergence, solve

COARSEST_MM = 6.0
"""Standard deviation, on the surface, of the Gaussian that separates coarse shape from relief."""

MOST_MM = 1.0
"""Largest height, above or below the mesh."""

LENGTH_SLACK = 0.2
"""Largest difference from 1 of the length of a usable normal."""

_COARSE_WIDTH = 384
"""Width of the map on which coarse shape is computed, texels."""

_RIDGE = 1e-3
"""Added to the variance of positions (1 away from borders), so that a plane in a strip one texel wide has slope 0."""

_SIGMAS = (1.0, 1.5, 2.25, 3.4, 5.0, 7.6, 11.4, 17.0, 26.0)
"""Standard deviations, in texels, of the Gaussians between which is interpolated."""


NARROW = 5.0
"""Standard deviation, in texels, up to twice of which planes are fitted on the map itself."""


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


def displacement(normals: npt.NDArray[np.int16], steps: Steps, mask: Bool) -> tuple[Float32, Integration]:
    """Heights (H, W) float32 in mm, positive outwards, of relief finer than ``COARSEST_MM``, within +-``MOST_MM``.

    Args:
        normals: (H, W, 2) int16 codes of x and y, +Y up.
        steps: of the same chart, at any size.
        mask: (H, W) bool, texels of the surface; heights elsewhere are 0.
    """
    right, down, usable = _differences(normals, steps, mask)
    texels = int(mask.sum())
    ignored = 1 - int(usable.sum()) / texels if texels else 0.0
    sources = divergence(right, down, usable)
    del right, down  # frees 100 MB each for a map of 6144 x 4096
    solved = solve(sources, usable, tolerance=TOLERANCE, most_steps=MOST_STEPS)
    del sources
    height = solved.height
    height -= coarse_part(height, usable, steps)
    _fill_holes(height, usable, mask)
    np.clip(height, -MOST_MM, MOST_MM, out=height)
    height *= mask
    return height, Integration(solved.steps, round(solved.residual, 9), round(ignored, 9))


def slopes(normals: Float32) -> tuple[Float32, Float32, Bool]:
    """Slopes (h, w) float32 of normals (h, w, 3) along x and y, and (h, w) bool, which normals are usable.

    Slopes are limited to 80 degrees. Normals that are not finite, or whose length differs from 1 by more than
    ``LENGTH_SLACK``, are not usable and count as flat.
    """
    x, y, z = np.moveaxis(normals, 2, 0)
    length = np.sqrt(x * x + y * y + z * z)
    usable = np.abs(length - 1) <= LENGTH_SLACK  # False where it is NaN
    inverse = 1 / np.where(usable, length, 1)
    x, y = (np.where(usable, part, 0) * -inverse for part in (x, y))
    flat = np.sqrt(x * x + y * y)
    # No steeper than the steepest, whose z is the least.
    scale = np.minimum(1, MOST_ACROSS / np.maximum(flat, MOST_ACROSS)) / np.maximum(z * inverse, STEEPEST_Z)
    scale = np.where(usable, scale, 0).astype(np.float32)
    return x * scale, y * scale, usable


def coarse_part(height: Float32, mask: Bool, steps: Steps) -> Float32:
    """(H, W) mm, heights smoothed by a Gaussian of ``COARSEST_MM`` on the surface, within the mask.

    At each texel a plane is fitted with the Gaussian as weight. A weighted mean would not do: at a border it averages
    one side only, so that any slope would leave a rim. The Gaussian's width in texels varies over the chart; the result
    is interpolated between a few fixed widths.
    """
    width = min(_COARSE_WIDTH, height.shape[1])
    size = (width, max(width * height.shape[0] // height.shape[1], 1))
    weight = shrunk(mask.astype(np.float32), size)
    total = shrunk(height, size)  # 0 outside the mask
    mm = shrunk(steps.texel_mm(), size) * (steps.width / size[0])
    sigma = COARSEST_MM / np.maximum(mm, 1e-3)
    level = np.interp(np.log(sigma), np.log(_SIGMAS), np.arange(len(_SIGMAS))).astype(np.float32)
    smooth = np.zeros(total.shape, np.float32)
    for index, width_px in enumerate(_SIGMAS):
        share = np.maximum(1 - np.abs(level - index), 0)
        if share.any():
            smooth += share * _wide_planes(total, weight, width_px)
    return np.asarray(stretched_to(smooth, height.shape[::-1]) * mask, np.float32)


def _wide_planes(total: Float32, weight: Float32, sigma: float) -> Float32:
    """The same as :func:`_local_planes`, fitted on means over squares where that is wide enough."""
    step = 2 ** max(int(np.log2(sigma / NARROW)), 0)
    if step == 1:
        return _local_planes(total, weight, sigma)
    tall, wide = total.shape
    # One square more on each side, so that planes go on beyond the border.
    around = (step, step - tall % -step, step, step - wide % -step)
    padded = [cv2.copyMakeBorder(part, *around, cv2.BORDER_CONSTANT) for part in (total, weight)]
    size = (padded[0].shape[1], padded[0].shape[0])
    small = [shrunk(part, (size[0] // step, size[1] // step)) for part in padded]
    return stretched_to(_local_planes(small[0], small[1], sigma / step), size)[step : step + tall, step : step + wide]


def _local_planes(total: Float32, weight: Float32, sigma: float) -> Float32:
    """(h, w) value at each texel of the plane fitted to the heights around it by weighted least squares.

    Moments are taken about that texel: about the map's corner, large numbers would cancel.

    Args:
        total: (h, w) height times weight.
        weight: (h, w) >= 0.
        sigma: standard deviation in texels of the Gaussian that multiplies the weights.
    """
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


def encode_heights(height: Float32) -> UInt16:
    """(H, W) uint16 codes of heights in mm; see ``MID`` and ``SCALE_MM``."""
    codes = np.zeros(height.shape, np.uint16)

    def encode(strip: slice) -> None:
        codes[strip] = np.clip(np.rint(height[strip] * np.float32(1 / SCALE_MM)) + MID, 0, 65535)

    by_strips(len(height), encode)
    return codes


def _differences(normals: npt.NDArray[np.int16], steps: Steps, mask: Bool) -> tuple[Float32, Float32, Bool]:
    """(H, W) change of height in mm per texel to the right and per texel down, and (H, W) bool, where it is known."""
    height, width = mask.shape
    right, down, usable = np.zeros(mask.shape, np.float32), np.zeros(mask.shape, np.float32), mask.copy()
    to_texel = np.float32(steps.width / width)

    def fill(band: slice) -> None:
        planes = read_window((steps.along, steps.lean, steps.across), (width, height), band)
        along, lean, across = np.moveaxis(planes * to_texel, 2, 0)
        slope_x, slope_y, sound = slopes(unpack_normals(normals[band]))
        right[band] = slope_x * along
        down[band] = -(slope_x * lean + slope_y * across)
        usable[band] &= sound & (along > 0) & (across > 0)

    by_strips(height, fill)
    return right, down, usable


def pad_heights(height: Float32, surface: Bool, outside: Bool) -> None:
    """Extend heights by three texels a round, in place, where ``outside`` is True, so that filters meet no edge."""
    known = surface
    for _ in range(3):
        known = _fill_holes(height, known, known | outside)


def _fill_holes(height: Float32, known: Bool, mask: Bool) -> Bool:
    """Set unknown texels of the mask to the mean of known ones within three texels, in place; the known ones after
    that.

    Texels without a known one so close stay 0.
    """
    missing = mask & ~known
    if not missing.any():
        return known
    found, side, none = known.copy(), (7, 7), cv2.BORDER_CONSTANT

    def fill(strip: slice) -> None:
        rows = slice(max(strip.start - 3, 0), strip.stop + 3)
        inner, hole = slice(strip.start - rows.start, strip.stop - rows.start), missing[strip]
        total = cv2.boxFilter(height[rows] * known[rows], -1, side, normalize=False, borderType=none)[inner]
        count = cv2.boxFilter(known[rows].astype(np.uint8), -1, side, normalize=False, borderType=none)[inner]
        height[strip][hole] = total[hole] / np.maximum(count[hole], 1)  # count is at most 49
        found[strip] |= hole & (count > 0)

    by_strips(len(height), fill)
    return found


REACH_MM = 3.0
"""Distance from a seam, on the surface, over which the correction fades out."""

INSET = 0.75
"""Distance from the seam to the texel at which a side's height is read, texels."""


@dataclass(frozen=True)
class Seams:
    """Pairs of texels (N,), as flat indices of a map, at the same point on either side of a seam."""

    one: Int64
    other: Int64

    @classmethod
    def of(cls, head: HeadModel, part: int, mask: Bool) -> Seams:
        """Pairs along all seams of part ``part``, at most a texel apart; both texels are within ``mask``."""
        tall, wide = mask.shape
        ends, inner = _seam_edges(head, part, chart_points(head, wide, tall))
        length = np.sqrt(((ends[:, :, 1] - ends[:, :, 0]) ** 2).sum(2)).max(1)
        count = np.ceil(length).astype(np.int64) + 1
        edge = np.repeat(np.arange(len(count)), count)
        first = np.cumsum(count) - count
        along = ((np.arange(len(edge)) - first[edge] + 0.5) / count[edge])[:, None, None]
        point = ends[edge, :, 0] * (1 - along) + ends[edge, :, 1] * along
        inwards = inner[edge] - point
        distance = np.sqrt((inwards * inwards).sum(2, keepdims=True))
        point = point + inwards * np.minimum(INSET / np.maximum(distance, 1e-9), 1.0)
        column, row = np.moveaxis(np.floor(point).astype(np.int64), 2, 0)
        inside = (column >= 0) & (column < wide) & (row >= 0) & (row < tall)
        flat = np.where(inside, row * wide + column, 0)
        good = (inside & mask.ravel()[flat]).all(1)
        return cls(flat[good, 0], flat[good, 1])


def join(height: Float32, seams: Seams, mask: Bool, texel_mm: Float32) -> None:
    """Make heights equal at both sides of seams; texels further than ``REACH_MM`` from one are unchanged.

    Args:
        height: (H, W) float32 mm, contiguous, changed in place.
        seams: pairs of texels of that map.
        mask: (H, W) bool; only texels in the same connected component of it as their side of the seam are changed.
        texel_mm: (h, w) side of a texel of the (H, W) map, on the same chart at any size.
    """
    if not len(seams.one):
        return
    flat = height.reshape(-1)
    half = 0.5 * (flat[seams.other] - flat[seams.one])
    seeds, of_seed = np.unique(np.concatenate([seams.one, seams.other]), return_inverse=True)
    total = np.bincount(of_seed, np.concatenate([half, -half]), len(seeds))
    value = (total / np.bincount(of_seed, minlength=len(seeds))).astype(np.float32)
    near, distance, source = _nearest_seeds(seeds, mask, REACH_MM / max(float(texel_mm.min()), 1e-3))
    region = np.asarray(cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1]).ravel()
    same = region[near] == region[seeds[source]]
    del region
    row, column = near // mask.shape[1], near % mask.shape[1]
    scale = np.array(texel_mm.shape) / mask.shape
    mm = texel_mm[(row * scale[0]).astype(int), (column * scale[1]).astype(int)] * distance
    fade = 0.5 * (1 + np.cos(np.pi * np.minimum(mm / REACH_MM, 1.0)))
    flat[near] += np.where(same, value[source] * fade, 0).astype(np.float32)


def _nearest_seeds(seeds: Int64, mask: Bool, reach: float) -> tuple[Int64, Float32, Int64]:
    """Texels (N,) of a mask less than ``reach`` texels from a seed, their distance (N,), and their seeds' number (N,).

    A few rows at a time, with as many around as count: whole planes would take three times 100 MB.
    """
    rows, columns = np.divmod(seeds, mask.shape[1])
    around, found = int(np.ceil(reach)) + 1, []
    for strip in strips(len(mask), max(256, around)):
        top, bottom = max(strip.start - around, 0), min(strip.stop + around, len(mask))
        here = np.flatnonzero((rows >= top) & (rows < bottom))
        if not len(here):
            continue
        empty = np.ones((bottom - top, mask.shape[1]), np.uint8)
        empty[rows[here] - top, columns[here]] = 0
        inside = slice(strip.start - top, strip.stop - top)
        planes = cv2.distanceTransformWithLabels(empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
        apart, label = (np.asarray(plane) for plane in planes)
        owner = np.zeros(int(label.max()) + 1, np.int64)
        owner[label[rows[here] - top, columns[here]]] = here
        apart, label = np.asarray(apart[inside].ravel(), np.float32), label[inside].ravel()
        near = np.flatnonzero(mask[strip].ravel() & (apart < reach))
        found.append((near + strip.start * mask.shape[1], apart[near], owner[label[near]]))
    texels, away, owners = zip(*found, strict=True)
    return np.concatenate(texels), np.concatenate(away), np.concatenate(owners)


def _seam_edges(head: HeadModel, part: int, points: Float64) -> tuple[Float64, Float64]:
    """Edges whose two triangles are separate on the chart.

    Returns:
        (N, 2, 2, 2) positions in texels by side, end and axis, with ends in the same order at both sides; and
        (N, 2, 2) those of the third corner of each side's triangle.
    """
    chosen = head.triangle_part == part
    vertices, places = head.triangles[chosen].astype(np.int64), head.triangle_uv[chosen].astype(np.int64)
    start = np.concatenate([np.stack([vertices[:, i], places[:, i]], 1) for i in range(3)])
    stop = np.concatenate([np.stack([vertices[:, (i + 1) % 3], places[:, (i + 1) % 3]], 1) for i in range(3)])
    third = np.concatenate([places[:, (i + 2) % 3] for i in range(3)])
    swap = start[:, 0] > stop[:, 0]
    low, high = np.where(swap[:, None], stop, start), np.where(swap[:, None], start, stop)
    key = low[:, 0] * (int(vertices.max(initial=0)) + 1) + high[:, 0]
    order = np.argsort(key, kind="stable")
    _, first, count = np.unique(key[order], return_index=True, return_counts=True)
    pairs = order[first[count == 2][:, None] + np.arange(2)]
    apart = (low[pairs[:, 0], 1] != low[pairs[:, 1], 1]) | (high[pairs[:, 0], 1] != high[pairs[:, 1], 1])
    pairs = pairs[apart]
    ends = np.stack([points[low[pairs, 1]], points[high[pairs, 1]]], 2)
    return ends, points[third[pairs]]
