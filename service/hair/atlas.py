"""The atlas of hair: cells in which strands are drawn, each with its colour from root to tip.

A cell shows a ribbon, root at its low end. Four pictures share the cells: colour with the share that hair covers as
alpha, normals, the direction across the strands, and where along its strand, on which strand and how deep a texel lies.
Transparent texels have the colour of the nearest hair, so that mip levels get no dark border; and alpha is coverage, so
that its mean over a cell stays what it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from service.arrays import AnyInt, Float32, Int32, Int64, UInt8
from service.colour import linear_to_srgb
from service.geometry.mesh import unit

SAMPLES = 64
"""Places along a strand at which it may turn."""
COLUMNS, LINES = 16, 4
"""Cells beside and above each other."""
STRIPS = 8
"""Single hairs in one cell."""
BODY, DENSE = 55, 6
"""Cells of ribbons, the first ones, and after them those of what closes the slits below them."""
CAP_CELL, SINGLE = BODY + DENSE, COLUMNS * LINES
"""Cell of the scalp, and the first of ``2 * STRIPS`` strips of cells with single hairs, numbered on."""
MARGIN = 0.03
"""Of a cell's width and, a quarter of it, of its height: nothing is drawn there, so that neighbours do not bleed in."""
SUBTEXELS = 4
"""Samples across a texel."""
STROKES = 64
"""Strands drawn in a cell of ribbons."""
THICKNESS = 1.45
"""Texels of a strand's width, at its root."""
TAPER = 0.16
"""Share of its length over which a strand gets thin."""
COLOUR_STEP = 4
"""Codes between two colours: strands differ by far more, and files are a quarter smaller."""
TILT = 0.3
"""Standard deviation of the slope by which strands are turned about themselves."""


def cell_corners(cell: AnyInt) -> tuple[Float32, Float32]:
    """Lower left and upper right texture coordinates (..., 2) of cells, without their margins.

    The last two cells hold the strips of single hairs.
    """
    cell = np.asarray(cell)
    strip = np.maximum(cell - SINGLE, 0)
    at = np.where(cell < SINGLE, cell, SINGLE - 2 + strip // STRIPS)
    size = np.array([1 / COLUMNS, 1 / LINES])
    low = np.stack([at % COLUMNS, LINES - 1 - at // COLUMNS], -1) * size
    wide = np.where(cell[..., None] < SINGLE, size, size / [STRIPS, 1])
    low = low + (strip % STRIPS / STRIPS * size[0])[..., None] * [1, 0]
    inset = MARGIN * np.array([1, 0.25]) * wide
    return (low + inset).astype(np.float32), (low + wide - inset).astype(np.float32)


@dataclass(frozen=True)
class Strokes:
    """Strands as they are drawn, Q of them; later ones lie over earlier ones.

    Attributes:
        cell: (Q,) where.
        way: (Q, T) float32 sideways place from root to tip, 0 and 1 at the sides of the cell.
        begin, end: (Q,) float32 along the cell, in [0, 1].
        thick: (Q,) float32 width over ``THICKNESS``.
        colour: (Q, C, 3) float32 linear RGB, from root to tip.
        slope: (Q,) float32 width of the ribbon over its length, which turns drawn directions into real ones.
    """

    cell: Int64
    way: Float32
    begin: Float32
    end: Float32
    thick: Float32
    colour: Float32
    slope: Float32

    @classmethod
    def filling(
        cls, cell: int, offset: Float32, ends: Float32, colour: Float32, size: tuple[float, float], density: float,
        ragged: tuple[float, float], rng: np.random.Generator,
    ) -> Strokes:  # fmt: skip
        """A cell full of strands, drawn from some (M, T) with their ends (M,) and colours (M, C, 3).

        Args:
            cell: where.
            offset: sideways places in half widths.
            ends: along the cell.
            colour: linear.
            size: width and length of the ribbon, metres.
            density: 1 for ``STROKES`` strands.
            ragged: shares of the length over which they begin and end.
            rng: chooses.
        """
        count = round(STROKES * density)
        chosen = rng.integers(0, len(offset), count)
        apart = rng.uniform(-1, 1, count).astype(np.float32)
        bend = rng.normal(0, 0.06, (count, 1)) * np.linspace(0, 1, offset.shape[1]) ** 2
        own = offset[chosen] - offset[chosen].mean(1, keepdims=True)
        # Strands of a lock run alike; where they lie in it is spread evenly, thinner at the sides.
        wide = np.clip(1 - 1.2 * own.std(), 0.3, 1)
        inner = wide * np.sign(apart) * np.abs(apart) ** (1.25 if density < 2 else 0.9)
        way = inner[:, None] + own + bend
        way = 0.97 * way / (1 + way**6) ** (1 / 6)
        begin = rng.uniform(0, ragged[0], count)
        # Strands at the sides are shorter, so that a ribbon ends in a point and not in a line.
        loss = ragged[1] * (0.45 * rng.beta(1.1, 2.0, count) + 0.55 * np.abs(apart) ** 1.5)
        end = np.clip(ends[chosen] - loss, begin + 0.1, 1.0)
        thick = rng.uniform(0.75, 1.3, count) * (1.0 if density < 2 else 1.2)
        f = np.float32
        return cls(
            np.full(count, cell, np.int64), (0.5 + 0.5 * way).astype(f), begin.astype(f), end.astype(f),
            thick.astype(f), colour[chosen], np.full(count, size[0] / max(size[1], 1e-6), f),
        )  # fmt: skip

    @classmethod
    def single(cls, cell: int, colour: Float32, rng: np.random.Generator) -> Strokes:
        """One to three hairs in a strip, in colours (3, C, 3)."""
        count = int(rng.integers(1, 4))
        wander = np.cumsum(np.cumsum(rng.normal(0, 0.006, (count, SAMPLES)), 1), 1)
        way = np.clip(rng.uniform(0.3, 0.7, (count, 1)) + wander - wander.mean(1, keepdims=True), 0.1, 0.9)
        f = np.float32
        return cls(
            np.full(count, cell, np.int64), way.astype(f), rng.uniform(0, 0.06, count).astype(f),
            rng.uniform(0.7, 1.0, count).astype(f), rng.uniform(0.8, 1.1, count).astype(f), colour[:count],
            np.full(count, 0.01, f),
        )  # fmt: skip

    @classmethod
    def joined(cls, several: Sequence[Strokes]) -> Strokes:
        """All of them, in their order."""
        names = cls.__dataclass_fields__
        return cls(*(np.concatenate([getattr(one, name) for one in several]) for name in names))


@dataclass(frozen=True)
class Atlas:
    """Pictures of the cells, row 0 at v = 1.

    Attributes:
        colour: (n, n, 4) uint8 sRGB with straight alpha.
        normal: (n / 2, n / 2, 3) uint8, tangent space, coded 128 + 127 n.
        direction: (n / 4, n / 4, 3) uint8 as glTF's anisotropy texture: direction across strands as 127.5 (1 + d) in
            red and green, strength in blue.
        strands: (n / 2, n / 2, 3) uint8: along the strand from root to tip, which strand, how deep (255 on top).
    """

    colour: UInt8
    normal: UInt8
    direction: UInt8
    strands: UInt8


def draw_atlas(strokes: Strokes, side: int, roots: Float32, rng: np.random.Generator) -> Atlas:
    """Draw strands.

    Args:
        strokes: what is drawn.
        side: texels, a power of two.
        roots: (3,) linear RGB of the cap.
        rng: turns strands about themselves.
    """
    which, along = _painted(strokes, side)
    samples_across = [which[:, first::SUBTEXELS] for first in range(SUBTEXELS)]
    shown = np.sum([one >= 0 for one in samples_across], 0, np.uint8)
    top = np.maximum.reduce(samples_across)
    at = np.flatnonzero(top >= 0)
    stroke, t = top.ravel()[at], along[at // side]
    samples = strokes.colour.shape[1]
    place = np.clip(t * (samples - 1), 0, samples - 1.001)
    low = place.astype(int)
    part = (place - low).astype(np.float32)[:, None]
    coded = linear_to_srgb(strokes.colour).reshape(-1, 3)
    first = stroke * samples + low
    colour = coded.take(first, 0) * (1 - part) + coded.take(first + 1, 0) * part
    steps = (COLOUR_STEP * np.rint((255 // COLOUR_STEP) * np.clip(colour, 0, 1))).astype(np.uint8)
    nearest = _nearest(top >= 0)
    pixels = np.dstack([steps[nearest], np.rint(shown * np.float32(255 / SUBTEXELS)).astype(np.uint8)])
    which_strand = np.arange(len(strokes.cell))
    codes = np.stack([which_strand * 97 % 251, np.rint(which_strand % 64 * (255 / 63))], 1).astype(np.uint8)
    half = nearest[::2, ::2]
    strands = np.dstack([np.rint(255 * np.clip(t, 0, 1)).astype(np.uint8)[half], codes[stroke[half]]])
    turned = np.clip(rng.normal(0, TILT, len(strokes.cell)), -0.7, 0.7).astype(np.float32)
    lean = np.clip(rng.normal(0, 0.10, len(strokes.cell)), -0.25, 0.25).astype(np.float32)
    places = strokes.way.shape[1] - 1
    bent = np.minimum((t * places).astype(int).clip(0), places - 1)
    run = (strokes.way[stroke, bent + 1] - strokes.way[stroke, bent]) * places * strokes.slope[stroke]
    size = np.sqrt(1 + run * run)
    _paint_cap(pixels, linear_to_srgb(roots), rng)

    def averaged(values: Float32, step: int, usual: Float32) -> Float32:
        """Unit vectors of what is shown, as means over ``step`` texels of a side; ``usual`` where nothing is."""
        image = np.zeros((side, side, len(usual)), np.float32)
        texel = f"V{4 * len(usual)}"  # moved as one thing: a quarter of the time of so many numbers
        image.view(texel).ravel()[at] = values.view(texel)[:, 0]
        small = cv2.resize(image, (side // step, side // step), interpolation=cv2.INTER_AREA) + usual
        return unit(small)

    upright = np.array([0, 0, 2e-3], np.float32)
    normal = averaged(np.stack([turned[stroke], lean[stroke], np.ones_like(run)], 1), 2, upright)
    across = averaged(np.stack([1 / size, -run / size], 1), 4, upright[[2, 0]])
    direction = np.dstack([np.rint(127.5 * (1 + across)), np.full(across.shape[:2], 255)]).astype(np.uint8)
    return Atlas(pixels, np.rint(128 + 127 * normal).astype(np.uint8), direction, strands)


def _painted(strokes: Strokes, side: int) -> tuple[Int32, Float32]:
    """(side, side * SUBTEXELS) number of the stroke on top of each sample, -1 for none; (side,) place of each row."""
    height = side // LINES
    low, high = cell_corners(strokes.cell)
    bottom, top = (1 - low[:, 1]) * side, (1 - high[:, 1]) * side
    picture = np.full(side * side * SUBTEXELS, -1, np.int32)
    inner = bottom[0] - top[0]
    # All cells have rows at the same places within them.
    row = np.arange(height, dtype=np.float32)
    t = (height - (height - inner) / 2 - row - 0.5) / inner
    weights = _cubic(np.clip(t, 0, 1), strokes.way.shape[1])
    scale = THICKNESS * side / 2048 if side > 2048 else THICKNESS
    for first in range(0, len(strokes.cell), 256):
        some = slice(first, first + 256)
        way = strokes.way[some] @ weights
        x = (low[some, :1] + way * (high[some, :1] - low[some, :1])) * side
        drawn = (t >= strokes.begin[some, None]) & (t <= strokes.end[some, None])
        thin = np.clip((strokes.end[some, None] - t) / TAPER, 0.0, 1.0)
        half = 0.5 * scale * strokes.thick[some, None] * (0.3 + 0.7 * thin)
        beside = np.concatenate([x[:, 1:], x[:, -1:]], 1)
        left, right = np.minimum(x, beside) - half, np.maximum(x, beside) + half
        start = np.ceil(SUBTEXELS * left - 0.5).astype(np.int64)
        wide = np.clip(np.ceil(SUBTEXELS * right - 0.5).astype(np.int64) - start, 0, 24 * SUBTEXELS)
        wide = np.where(drawn, wide, 0)
        line = (np.rint(top[some] - (height - inner) / 2).astype(np.int64))[:, None] + row.astype(np.int64)[None]
        base = np.clip(line, 0, side - 1) * side * SUBTEXELS + np.clip(start, 0, side * SUBTEXELS - 1)
        count = wide.ravel()
        order = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
        number = np.repeat(np.arange(first, first + len(way), dtype=np.int32), wide.sum(1))
        picture[np.minimum(np.repeat(base.ravel(), count) + order, len(picture) - 1)] = number
    return picture.reshape(side, side * SUBTEXELS), np.tile(t, LINES).astype(np.float32)


def _cubic(t: Float32, samples: int) -> Float32:
    """(samples, T) weights of even samples at places t (T,) in [0, 1]: a cubic through them (Catmull and Rom 1974)."""
    place = t * (samples - 1)
    index = np.minimum(place.astype(int), samples - 2)
    x = place - index
    weight = (
        -0.5 * x + x**2 - 0.5 * x**3, 1 - 2.5 * x**2 + 1.5 * x**3, 0.5 * x + 2 * x**2 - 1.5 * x**3, 0.5 * (x**3 - x**2),
    )  # fmt: skip
    made = np.zeros((samples, len(t)), np.float32)
    for step, one in enumerate(weight):
        np.add.at(made, (np.clip(index + step - 1, 0, samples - 1), np.arange(len(t))), one.astype(np.float32))
    return made


def _nearest(shown: np.ndarray) -> Int64:
    """(n, n) for each texel the number, row by row, of the nearest one that is shown."""
    hidden = (~shown).astype(np.uint8)
    _, label = cv2.distanceTransformWithLabels(hidden, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    known = np.flatnonzero(shown)
    number = np.zeros(int(label.max()) + 1, np.int64)
    number[label.ravel()[known]] = np.arange(len(known))
    return np.asarray(number[label])


def _paint_cap(pixels: UInt8, colour: Float32, rng: np.random.Generator) -> None:
    """Roots as dots, denser from the cell's low end, where none grow, to its high end."""
    width, height = len(pixels) // COLUMNS, len(pixels) // LINES
    left, top = CAP_CELL % COLUMNS * width, CAP_CELL // COLUMNS * height
    right, bottom = left + width, top + height
    share = np.clip(np.linspace(1, 0, bottom - top), 0, 1)[:, None] ** 1.4
    grain = cv2.GaussianBlur(rng.random((bottom - top, right - left)).astype(np.float32), (3, 3), 0.8)
    grain = (grain - grain.mean()) / max(float(grain.std()), 1e-6)
    # Where hair is full nothing shows between roots: all of it reads one row of the cell.
    alpha = np.clip(0.96 * share + 0.5 * grain * share * (1 - share), 0, 1)
    pixels[top:bottom, left:right, :3] = np.rint(255 * np.clip(0.95 * colour, 0, 1)).astype(np.uint8)
    pixels[top:bottom, left:right, 3] = np.rint(255 * alpha).astype(np.uint8)
