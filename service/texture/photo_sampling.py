"""Read the photo at the texels of a map, strip by strip.

Where a texel is smaller than a pixel, pixels are interpolated bicubically; where it covers several, it reads between
two levels of a pyramid of halved photos, averaged in linear light (Williams 1983), by its longer side: what is seen at
a grazing angle is rather blurred than aliased.

Octaves of detail on a chart are those of a Laplacian pyramid (Burt and Adelson 1983), counted in texels of the full
map: octave k has periods of ``2^(k+1)`` to ``2^(k+2)`` texels. An image is worked on in strips with so much around them
that any strips give what the whole gives. Down it goes by means, up bicubically: the usual kernel of five passes half
of an octave into the next, so that made-up pores would lie over the photo's spots.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from service.arrays import Bool, Float32, UInt8
from service.colour import bytes_to_linear, linear_to_srgb, to_bytes
from service.face.fit.fit import Fit
from service.geometry.camera import NEAREST_M
from service.geometry.chart import Chart, chart_points, solve_affine
from service.head.model import HeadModel
from service.image_filters import marked_columns, shrunk, strips
from service.photo.photo import Photo

T = TypeVar("T")

SIZE = (768, 512)
"""Chart on which places are drawn; between its texels they are interpolated, as triangles are several texels wide."""


@dataclass(frozen=True)
class Places:
    """Of a chart of ``SIZE``, (h, w, ...) float32, continued beyond the islands.

    Attributes:
        pixel: (h, w, 2) photo pixels x, y, centres at +0.5.
        finest, coarsest: (h, w) photo pixels along the chart's direction in which they lie closest, and in which they
            lie farthest apart, per texel of this chart: the singular values of the Jacobian d pixel / d texel. 0 where
            the surface lies behind the camera or has no area.
        texel_mm: (h, w) side in mm of a square as large as the texel.
    """

    pixel: Float32
    finest: Float32
    coarsest: Float32
    texel_mm: Float32

    @classmethod
    def of(cls, head: HeadModel, fit: Fit) -> Places:
        """Places of a fitted head."""
        chart = Chart.build(head, *SIZE)
        before = fit.camera.to_camera(fit.vertices)[:, 2] > NEAREST_M
        pixels = np.where(before[:, None], fit.camera.project(fit.vertices), 0.0)
        flat = chart_points(head, *SIZE)[head.triangle_uv]
        du, dv = solve_affine(flat, pixels[head.triangles])
        values = np.linalg.svd(np.stack([du, dv], -1), compute_uv=False)
        values[~before[head.triangles].all(1)] = 0.0
        e, f, g = np.moveaxis(chart.metric(fit.vertices), 2, 0)
        side = np.sqrt(np.sqrt(np.maximum(e * g - f * f, 0)))
        drawn = chart.gather(values)
        position = fit.camera.project(chart.inside(fit.vertices).astype(np.float64))
        ahead = fit.camera.to_camera(chart.inside(fit.vertices).astype(np.float64))[:, 2] > NEAREST_M
        pixel = chart.spread(np.where(ahead[:, None], position, 0.0))
        planes = np.concatenate([pixel, drawn, side[..., None]], -1).astype(np.float32)
        whole = chart.fill_outside(planes)
        return cls(*(np.ascontiguousarray(whole[..., part]) for part in (slice(0, 2), 2, 3, 4)))

    @property
    def per_mm(self) -> Float32:
        """(h, w) photo pixels per millimetre of the surface, geometric mean of both directions; 0 without area."""
        area = np.sqrt(self.finest * self.coarsest)
        sound = self.texel_mm > 1e-6
        return np.asarray(np.where(sound, area / np.where(sound, self.texel_mm, 1), 0), np.float32)


MARGIN = 8
"""Pixels around what is read, for interpolation."""
ROWS = 1024
"""Rows of the photo that are halved at a time."""


@dataclass(frozen=True)
class Reader:
    """The photo as texels read it.

    Attributes:
        levels: (h, w, 3) uint8 sRGB of the rectangle around the head, each half of the one before.
        corner: (2,) x and y of that rectangle in the photo.
        places: of the head in the photo.
        size: (width, height) of the map whose texels are read.
    """

    levels: tuple[UInt8, ...]
    corner: Float32
    places: Places
    size: tuple[int, int]

    @classmethod
    def of(cls, photo: Photo, places: Places, size: tuple[int, int]) -> Reader:
        """A reader for a map of ``size``; as many levels are made as its texels need."""
        ratio = places.finest.shape[1] / size[0]
        largest = float(places.finest.max(initial=0.0)) * ratio
        count = int(np.ceil(np.log2(max(largest, 1.0))))
        grid = 2**count  # so that the levels' pixels are those of the whole photo
        pixel = places.pixel.reshape(-1, 2)
        last = np.maximum(np.array(photo.size) // grid - 1, 0)
        low = np.clip(pixel.min(0) // grid - MARGIN, 0, last).astype(int) * grid
        high = np.clip((pixel.max(0) // grid + MARGIN) * grid, low + 1, photo.size).astype(int)
        levels = [photo.pixels[low[1] : high[1], low[0] : high[0]]]
        # Shortest side of a level of the pyramid, pixels.
        while len(levels) <= count and min(levels[-1].shape[:2]) >= 2 * 16:
            levels.append(halved(levels[-1]))
        return cls(tuple(levels), low.astype(np.float32), places, size)

    def rows(self, first: int, last: int, columns: tuple[int, int] | None = None) -> Float32:
        """(last - first, W, 3) sRGB-coded in [0, 1] of these rows; pixels beyond the photo's border repeat it."""
        begin, end = columns or (0, self.size[0])
        window = (first, last, begin, end)
        x, y = (
            stretched(np.ascontiguousarray(self.places.pixel[..., k]), self.size, window) - self.corner[k]
            for k in (0, 1)
        )
        ratio = self.places.finest.shape[1] / self.size[0]
        level = np.log2(np.maximum(stretched(self.places.finest, self.size, window) * np.float32(ratio), 1))
        level = np.minimum(level, len(self.levels) - 1)
        low = np.floor(level)
        result = np.zeros((*level.shape, 3), np.float32)
        for index in range(int(low.max(initial=-1)) + 1):
            chosen = low == index
            if not chosen.any():
                continue
            share = (level - np.float32(index))[..., None]
            here = _read(self.levels[index], 2.0**index, x, y, chosen, cubic=index == 0)
            if (share[chosen] > 0).any():
                above = _read(self.levels[index + 1], 2.0 ** (index + 1), x, y, chosen, cubic=False)
                here += share * (above - here)
            if chosen.all():
                result = here
            else:
                np.copyto(result, here, where=chosen[..., None])
        return np.clip(result, 0, 1, out=result)


def _read(image: UInt8, scale: float, x: Float32, y: Float32, chosen: np.ndarray, *, cubic: bool) -> Float32:
    """(h, w, 3) values of a level in [0, 1] at pixels of level 0; of the level only what ``chosen`` reads."""
    across, down = x / np.float32(scale) - np.float32(0.5), y / np.float32(scale) - np.float32(0.5)
    height, width = image.shape[:2]
    place = []
    for at, most in ((down, height), (across, width)):
        inside = np.clip(at[chosen], 0, most - 1)
        low, high = max(int(inside.min()) - MARGIN, 0), min(int(inside.max()) + MARGIN, most)
        place.append(slice(low, max(high, low + 1)))
    part = image[place[0], place[1]].astype(np.float32) * np.float32(1 / 255)
    way = cv2.INTER_CUBIC if cubic else cv2.INTER_LINEAR
    across, down = across - np.float32(place[1].start), down - np.float32(place[0].start)
    return np.asarray(cv2.remap(part, across, down, way, borderMode=cv2.BORDER_REPLICATE), np.float32)


def stretched(plane: Float32, size: tuple[int, int], window: tuple[int, int, int, int]) -> Float32:
    """(rows, columns) float32 of a plane (h, w) of a chart at some texels of a larger map, bilinear.

    Args:
        plane: on the chart.
        size: (width, height) of the map.
        window: first row, row after the last, first column, column after the last.
    """
    first, last, begin, end = window
    down, across = plane.shape[0] / size[1], plane.shape[1] / size[0]
    top = max(int(first * down) - 2, 0)
    part = plane[top : min(int(np.ceil(last * down)) + 2, plane.shape[0])]
    matrix = np.array([[across, 0, (begin + 0.5) * across - 0.5], [0, down, (first + 0.5) * down - 0.5 - top]])
    way = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(part, matrix, (end - begin, last - first), flags=way, borderMode=cv2.BORDER_REPLICATE),
        np.float32,
    )


def halved(image: UInt8) -> UInt8:
    """(h // 2, w // 2, 3) sRGB of (h, w, 3): means of 2 x 2 pixels in linear light."""
    height, width = image.shape[0] // 2, image.shape[1] // 2
    result = np.zeros((height, width, 3), np.uint8)
    for top in range(0, height, ROWS // 2):
        part = bytes_to_linear(image[2 * top : 2 * min(top + ROWS // 2, height), : 2 * width])
        part = part[: part.shape[0] // 2 * 2]
        mean = shrunk(part, (width, part.shape[0] // 2))
        result[top : top + len(mean)] = to_bytes(linear_to_srgb(mean))
    return result


STRIP, ACROSS = 768, 1536
"""Rows of a map that are changed at a time, and most columns: with all around them and two at once 0.4 of a
gigabyte."""


def halo(octaves: int) -> int:
    """Texels around a strip, a multiple of the coarsest level's texel."""
    # Texels of the rest that a strip needs around it: two to enlarge it; halves of ten for the power around a texel of
    # the coarsest octave, and of four to join all; a half for the blur of what is clipped.
    return 7 * int(2**octaves)


def down(image: Float32) -> Float32:
    """(h / 2, w / 2, ...) means of 2 x 2 texels; h and w even."""
    size = (image.shape[1] // 2, image.shape[0] // 2)
    return shrunk(image, size)


def up(image: Float32, shape: tuple[int, int]) -> Float32:
    """Bicubic interpolation to (h, w) texels, twice as many."""
    return np.asarray(cv2.resize(image, shape[::-1], interpolation=cv2.INTER_CUBIC), np.float32)


def split_octaves(image: Float32, octaves: int) -> tuple[list[Float32], Float32]:
    """Octaves of an image (h, w) or (h, w, C), finest first, each at its own level's size; and the rest.

    Both sides have to be multiples of ``2^octaves``.
    """
    bands, rest = [], image
    for _ in range(octaves):
        smaller = down(rest)
        band = up(smaller, rest.shape[:2])
        bands.append(np.subtract(rest, band, out=band))
        rest = smaller
    return bands, rest


def joined_octaves(bands: Sequence[Float32]) -> Float32:
    """The image of one or more octaves, inverse of :func:`split_octaves` but for its rest, which counts as 0."""
    result = bands[-1].copy()
    for band in reversed(bands[:-1]):
        result = up(result, band.shape[:2])
        result += band
    return result


@dataclass(frozen=True)
class Strip:
    """A part of a map that is changed octave by octave, with as much around it as that needs.

    Attributes:
        place: rows and columns of the map that may change.
        inside: the same within ``before``.
        window: first row, row after the last, first column and column after the last of ``before`` on the map; its
            border lies beyond the map's where that is no multiple of the coarsest texel.
        before: the map there as it was before any strip was changed, continued beyond its border.
    """

    place: tuple[slice, slice]
    inside: tuple[slice, slice]
    window: tuple[int, int, int, int]
    before: npt.NDArray[Any]

    def of(self, other: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """The same part of another map of the same size, which does not change."""
        top, bottom, left, right = self.window
        part = other[top:bottom, left:right]
        more = [(0, bottom - top - part.shape[0]), (0, right - left - part.shape[1])]
        return np.pad(part, [*more, *[(0, 0)] * (other.ndim - 2)], "edge")


def octave_strips(values: npt.NDArray[Any], marked: Bool, octaves: int) -> Iterator[Strip]:
    """Parts of a map (H, W, C) to be changed in place, one after the other, where coarser marks (h, w) lie."""
    height, width = values.shape[:2]
    reach, grid = halo(octaves), 2**octaves
    above: npt.NDArray[Any] | None = None  # the last rows before the strip, as they were
    for rows in strips(height, STRIP):
        kept = values[max(rows.stop - reach, 0) : rows.stop].copy()
        columns = marked_columns(marked, (width, height), rows, grid)
        if columns is not None:
            top, left = max(rows.start - reach, 0), max(columns[0] - reach, 0)
            part = values[top : rows.stop + reach, left : columns[1] + reach].copy()
            if above is not None:
                part[: rows.start - top] = above[len(above) - (rows.start - top) :, left : columns[1] + reach]
            part = np.pad(part, ((0, -part.shape[0] % grid), (0, -part.shape[1] % grid), (0, 0)), "edge")
            count = -(-(columns[1] - columns[0]) // ACROSS)
            step = -(-(columns[1] - columns[0]) // (count * grid)) * grid
            for begin in range(*columns, step):
                end = min(begin + step, columns[1])
                first, last = max(begin - reach, left), min(end + reach, left + part.shape[1])
                yield Strip(
                    (rows, slice(begin, end)),
                    (slice(rows.start - top, rows.stop - top), slice(begin - first, end - first)),
                    (top, top + part.shape[0], first, last),
                    part[:, first - left : last - left],
                )
        above = kept


def change_strips(
    values: npt.NDArray[Any],
    strips_: Iterator[Strip],
    changed: Callable[[Strip], tuple[npt.NDArray[Any], T]],
    told: Callable[[T], None] = lambda more: None,
) -> None:
    """Change the strips of a map in place, two at a time.

    Args:
        values: the map.
        strips_: of :func:`octave_strips`.
        changed: new values of a strip's place, and what else there is to tell; it runs in two threads.
        told: takes that, in the order of the strips.
    """
    waiting: deque[tuple[Strip, Future[tuple[npt.NDArray[Any], T]]]] = deque()

    def finish() -> None:
        strip, made = waiting.popleft()
        values[strip.place], more = made.result()
        told(more)

    with ThreadPoolExecutor(2) as pool:
        for one in strips_:
            waiting.append((one, pool.submit(changed, one)))
            if len(waiting) > 2:
                finish()
        while waiting:
            finish()
