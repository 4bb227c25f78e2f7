"""The diffuse albedo after its network: as the told light leaves it, under the shadow of hair's roots, padded outside
the chart's islands, and closed at the chart's seam at the back of the head.

delta's result there is arbitrary, as it was never trained on these texels, and the networks that read the albedo would
take the step at an island's border for a crease. So skin is padded from inside, as in the texture. So is what is drawn
on eyes and teeth: a renderer that filters the map mixes in texels beside an island, and a pale line would divide the
teeth.
"""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np

from service.arrays import Float32, UInt8
from service.colour import FULL_CODE, Codes, srgb_to_linear
from service.geometry.chart import NO_PART, chart_points, nearest_inside
from service.geometry.raster import rasterise
from service.head.model import HeadModel
from service.image_filters import blurred, by_strips, each_around, shrunk
from service.reflectance.albedo.albedo_prior import DARKEST
from service.reflectance.planes import read_window
from service.reflectance.subject import Subject, margin

BORDER = 6
"""Texels of any map along the skin's border that delta makes up to an eighth darker, with what lies beyond in sight:
a line at the collar and along the chart's seams."""


Values = TypeVar("Values", Codes, Float32)


def pad_skin(albedo: Values, subject: Subject) -> Values:
    """The albedo, changed in place: texels at most ``BORDER`` within the skin's islands, and outside all islands where
    the nearest is skin, take the colour of the skin farther inside.

    Args:
        albedo: (H, W, 3) codes, or anything else that delta tells.
        subject: whose chart it is; the albedo stays as it is where that shows no skin.
    """
    height, width = albedo.shape[:2]
    chart, skin = subject.chart, subject.head.part_names.index("skin")
    reach = -(-BORDER * chart.width // width)
    inside = cv2.erode((chart.part == skin).astype(np.uint8), np.ones((2 * reach + 1,) * 2, np.uint8)) > 0
    if not np.any(inside):
        return albedo
    small = shrunk(albedo, (chart.width, chart.height))
    colour = small.reshape(-1, 3)[nearest_inside(np.asarray(inside)).ravel()].reshape(small.shape)
    beside_skin = chart.part.ravel()[nearest_inside(chart.mask)] == skin
    planes = np.concatenate([np.moveaxis(colour, 2, 0), beside_skin.reshape(1, *inside.shape).astype(np.float32)])
    islands = subject.islands((width, height))
    outside = cv2.dilate((islands == NO_PART).astype(np.uint8), np.ones((2 * BORDER + 1,) * 2, np.uint8)) > 0
    outside &= (islands == NO_PART) | (islands == skin)

    def fill(strip: slice) -> None:
        chosen = outside[strip]
        if chosen.any():
            found = read_window(planes, (width, height), strip)
            chosen &= found[..., 3] > 0.999
            values = found[chosen, :3]
            albedo[strip][chosen] = values if albedo.dtype.kind == "f" else np.rint(values)

    by_strips(height, fill)
    return albedo


SEAM, ALONG = 30.0, 10.0
"""Texels of a chart of 576 within which both sides of the seam come together, and over which that is smoothed."""


def close_seam(albedo: Codes, subject: Subject) -> Codes:
    """The albedo, changed in place: both sides of the chart's seam have one tone at the back of the head.

    delta does not know that they touch: a line divided the nape where hair leaves it bare.

    Args:
        albedo: (H, W, 3) codes.
        subject: whose chart it is; on one without a seam whose sides are mirror images the albedo stays as it is.
    """
    head, chart, part = subject.head, subject.chart, subject.head.part_names.index("skin")
    size = (chart.width, chart.height)
    skin = head.triangle_part == part
    pairs = np.unique(np.stack([head.triangles[skin].ravel(), head.triangle_uv[skin].ravel()], 1), axis=0)
    first = np.flatnonzero(pairs[1:, 0] == pairs[:-1, 0])
    here, there = head.uv[pairs[first, 1]], head.uv[pairs[first + 1, 1]]
    mirrored = np.abs(here * [-1, 1] + [1, 0] - there).max(1, initial=0) < 1e-3
    if not mirrored.any():
        return albedo
    seam = np.minimum(here[mirrored, 0], there[mirrored, 0])
    at = np.stack([(1 - here[mirrored, 1]) * size[1], seam * size[0]]).astype(int)
    row, column = np.minimum(at, [[size[1] - 1], [size[0] - 1]])
    small = shrunk(albedo, size).astype(np.float32)
    weight, step = np.zeros(size[::-1], np.float32), np.zeros((*size[::-1], 3), np.float32)
    weight[row, column] = 1
    step[row, column] = 0.5 * (small[row, size[0] - 1 - column] - small[row, column])
    away = cv2.distanceTransform((weight == 0).astype(np.uint8), cv2.DIST_L2, 5) * (576 / size[0])
    soft = blurred(np.dstack([step, weight]), 2 * ALONG * size[0] / 576)
    field = soft[..., :3] / np.maximum(soft[..., 3:], 1e-6) * np.exp(-np.square(away / SEAM))[..., None]
    field = np.asarray(np.moveaxis(field - field[:, ::-1], 2, 0), np.float32)
    own = subject.islands(albedo.shape[1::-1])
    width, most = albedo.shape[1], int(FULL_CODE)
    reach = round(3 * SEAM * width / 576)
    for beside in (slice(0, reach), slice(width - reach, width)):

        def add(strip: slice, beside: slice = beside) -> None:
            chosen = np.isin(own[strip, beside], (NO_PART, part))[..., None]
            change = read_window(field, albedo.shape[1::-1], strip, beside) * chosen
            moved = np.rint(np.clip(albedo[strip, beside] + change, 0, most))
            albedo[strip, beside] = moved.astype(albedo.dtype)

        by_strips(albedo.shape[0], add)
    return albedo


def part_island(
    head: HeadModel, part: int, size: tuple[int, int], reach: int
) -> tuple[tuple[slice, slice], UInt8] | None:
    """Rows and columns of a map (width, height) up to ``reach`` texels around a part's island, and there (h, w) 1
    within it; None where the map has no texel of it.
    """
    at = chart_points(head, *size)[head.triangle_uv[head.triangle_part == part]].reshape(-1, 2)
    if not len(at):
        return None
    low = np.maximum(np.floor(at.min(0)).astype(int) - reach, 0)
    high = np.minimum(np.ceil(at.max(0)).astype(int) + 1 + reach, size)
    if (high <= low).any():
        return None
    raster = rasterise(at - low, np.zeros(len(at)), np.arange(len(at)).reshape(-1, 3), *map(int, high - low))
    box = slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))
    return (box, raster.mask.astype(np.uint8)) if raster.mask.any() else None


def pad_parts(albedo: Codes, subject: Subject) -> Codes:
    """The albedo, changed in place: texels beside the islands of eyes and teeth take the colour of the nearest inside.

    Args:
        albedo: (H, W, 3) codes.
        subject: whose chart it is.
    """
    height, width = albedo.shape[:2]
    names, reach = subject.head.part_names, margin(width) + 1
    islands = subject.islands((width, height))
    for index, name in enumerate(names):
        at = part_island(subject.head, index, (width, height), reach) if name.startswith(("eye", "teeth")) else None
        if at is None:
            continue
        box, inside = at
        near = np.asarray(cv2.distanceTransform(1 - inside, cv2.DIST_L2, 5)) <= reach
        beside = (inside == 0) & near & np.isin(islands[box], (NO_PART, index))
        albedo[box][beside] = albedo[box].reshape(-1, 3)[nearest_inside(inside > 0)[beside]]
    return albedo


CODED_POWER, CODED_LIFT = 1 / 2.4, 0.055 * FULL_CODE
"""Of the sRGB curve above its toe: a factor on linear values is its power on codes that are lifted by so much."""
LEAST_CHANGE = 1e-3
"""Share of a code; strips and columns of the map in which nothing changes by more stay as they are."""


def scaled(albedo: Codes, factor: Float32) -> Codes:
    """The albedo, changed in place; below the curve's toe, a linear 0.003, what is made darker comes out darker still.

    Args:
        albedo: (H, W, 3) sRGB codes.
        factor: (3, h, w) positive, on linear albedo, interpolated.
    """
    powers = np.power(factor, np.float32(CODED_POWER))

    def scale(rows: slice, columns: slice) -> None:
        power, part = read_window(powers, albedo.shape[1::-1], rows, columns), albedo[rows, columns]
        lifted = (part + np.float32(CODED_LIFT)) * power - np.float32(CODED_LIFT)
        part[:] = np.rint(np.clip(lifted, 0, FULL_CODE))

    each_around(np.abs(powers - 1).max(0) > LEAST_CHANGE, albedo.shape, scale)
    return albedo


FINER = 2.0
"""Standard deviation of what is finer than the told light is believed for, texels of the context: 3 mm."""
BARELY = 0.05
"""Share of such skin around with less of which its surroundings tell little."""


def as_told(albedo: Codes, told: Float32, weight: Float32) -> tuple[Codes, Float32]:
    """The albedo, changed in place, and the (3, h, w) factors on it: what is wider than ``FINER`` is as the told light
    leaves it, detail stays the network's.

    Args:
        albedo: (H, W, 3) codes.
        told: (3, h, w) natural logarithm of the texture less the light.
        weight: (h, w) in [0, 1], where that light is to be believed; where it is 0 the albedo stays.
    """
    ours = srgb_to_linear(shrunk(albedo, told.shape[:0:-1]) * np.float32(1 / FULL_CODE))
    off = (np.moveaxis(told, 0, 2) - np.log(np.maximum(ours, np.float32(DARKEST)))) * weight[..., None]
    share = weight / np.maximum(blurred(weight, FINER), np.float32(BARELY))
    factor = np.ascontiguousarray(np.moveaxis(np.exp(blurred(off, FINER) * share[..., None]), 2, 0), np.float32)
    return scaled(albedo, factor), factor
