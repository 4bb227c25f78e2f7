"""What a photo tells of somebody's hair: where it is, which way it runs, and what kind it is, each with its doubt.

::

    photo, reading --region_of--> square with all of the hair --filters, network--> HairReading

The square is wider than the crops of ``service.face.reading.reader``, as hair may reach to the shoulders.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from service.arrays import Float32, Float64, UInt8
from service.face.reading.part_labels import HAIR, HAT, OTHER
from service.face.reading.reader import AROUND_ABOVE, AROUND_FILL, Reading, middles, parts_at_pixels
from service.face.region import Region
from service.geometry.sampling import sample_at
from service.hair.kinds import CURLS as CURLS
from service.hair.kinds import FRINGES as FRINGES
from service.hair.kinds import GATHERED as GATHERED
from service.hair.kinds import KINDS as KINDS
from service.hair.kinds import LENGTH_ENDS_M as LENGTH_ENDS_M
from service.hair.kinds import LENGTHS as LENGTHS
from service.hair.kinds import PARTINGS as PARTINGS
from service.image_filters import blurred, ramp

SIDE, CELLS = 224, 112
"""Pixels along the square as it is read, and cells of what is said of it."""
FILL, BELOW = 0.40, 0.05
"""Longer side of the landmarks' bounding box over the square's, and how far its middle lies below theirs, over its
side: about 0.44 m, from above the crown to below the shoulders."""

@dataclass(frozen=True)
class HairReading:
    """Hair of one photo, on the cells of a square; H = W = ``CELLS``, row 0 = top.

    Attributes:
        region: the square in the photo; it stands upright on the face.
        mask: (H, W) float32 in [0, 1]: share of the cell that hair covers, or its probability.
        known: (H, W) float32 in [0, 1]: 0 beside the photo and where a hat or a hand hides whether there is hair.
        direction: (H, W, 2) float32 unit vectors from root to tip in the square's own axes, x right, y down.
        certainty: (H, W) float32 in [0, 1] of the direction; 0 without hair.
        kinds: probability of each choice of ``service.hair.kinds.KINDS``, by name; those of a kind sum to 1.
        ends_m: height of the lowest ends in the head's frame, metres (Y up, 0 between the eyes), and its standard
            deviation.
    """

    region: Region
    mask: Float32
    known: Float32
    direction: Float32
    certainty: Float32
    kinds: Mapping[str, Mapping[str, float]]
    ends_m: tuple[float, float]

    @property
    def cells(self) -> Float64:
        """(H * W, 2) photo pixels of the middles of the cells, row by row."""
        return middles(self.region, CELLS)

    @property
    def visible(self) -> float:
        """Share of the square in which it can be seen whether there is hair, in [0, 1]."""
        return float(self.known.mean())

    def likeliest(self, kind: str) -> tuple[str, float]:
        """The likeliest choice of one of ``service.hair.kinds.KINDS``, and its probability."""
        return max(self.kinds[kind].items(), key=lambda item: item[1])

    def mask_at(self, at: Float64) -> Float32:
        """(N,) float32 of the mask at photo pixels (N, 2); 0 beside the square."""
        cells = self.region.to_crop(at, CELLS).astype(np.float32)
        values = np.asarray(sample_at(self.mask, cells[:, 0] - 0.5, cells[:, 1] - 0.5)[:, 0], np.float32)
        inside = ((cells >= 0) & (cells <= CELLS)).all(1)
        return np.where(inside, values, np.float32(0))


def region_of(reading: Reading) -> Region:
    """The square with all of the hair, by the crops that were read of the face."""
    wide = reading.region if reading.around is None else reading.around.region
    fill, above = (AROUND_FILL, AROUND_ABOVE) if reading.around is not None else _NARROW
    side = wide.side * fill / FILL
    down = BELOW * side - above * wide.side
    turn = np.array([-np.sin(wide.angle), np.cos(wide.angle)])
    return Region(wide.x + float(turn[0]) * down, wide.y + float(turn[1]) * down, side, wide.angle)


_NARROW = (0.64, 0.03)
"""``FILL`` and ``ABOVE`` of the reader's narrow crop."""


def read_hair(pixels: UInt8, reading: Reading) -> HairReading:
    """Read the hair in an (H, W, 3) uint8 sRGB photo whose face was read."""
    region = region_of(reading)
    at = middles(region, CELLS)
    parts = parts_at_pixels(reading, at, strands=True).reshape(CELLS, CELLS, -1)
    height, width = pixels.shape[:2]
    inside = ((at >= 0) & (at < [width, height])).all(1).reshape(CELLS, CELLS)
    known = np.asarray(inside * (1 - ramp(parts[..., HAT] + parts[..., OTHER], (0.15, 0.45))), np.float32)
    mask = np.asarray(np.clip(parts[..., HAIR], 0, 1) * inside, np.float32)
    crop = region.cut(pixels, SIDE)
    direction, certainty = orientation(crop, mask)
    ends = _ends(mask * known)
    return HairReading(region, mask, known, direction, certainty, _guessed(ends), (ends, 0.05))


SMOOTHED_CELLS = 1.6
"""Standard deviation over which directions are averaged, cells."""


def orientation(crop: UInt8, mask: Float32) -> tuple[Float32, Float32]:
    """Directions of strands by the structure tensor, roots up, and how certain they are.

    The eigenvector of the smaller eigenvalue of the smoothed outer product of the gradient (Bigun and Granlund 1987)
    runs along the strands; coherence, the difference of the eigenvalues over their sum, is its certainty.

    Args:
        crop: (S, S, 3) uint8 sRGB, the square.
        mask: (H, W) float32 in [0, 1], share of hair; S is a multiple of H.

    Returns:
        (H, W, 2) float32 unit vectors, x right, y down, and (H, W) float32 in [0, 1], 0 without hair.
    """
    side = len(mask)
    grey = cv2.cvtColor(crop, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255
    grey = np.log(grey + np.float32(0.03))  # locks in the shade have as much structure as lit ones
    dx, dy = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=3), cv2.Sobel(grey, cv2.CV_32F, 0, 1, ksize=3)
    tensor = np.stack([dx * dx, dx * dy, dy * dy], -1)
    tensor = cv2.resize(tensor, (side, side), interpolation=cv2.INTER_AREA)
    inner = cv2.erode(mask, np.ones((3, 3), np.uint8))[..., None]  # the outline of the hair is no strand
    weight = np.maximum(blurred(inner, SMOOTHED_CELLS)[..., None], 1e-4)
    xx, xy, yy = np.moveaxis(blurred(tensor * inner, SMOOTHED_CELLS) / weight, -1, 0)
    along = 0.5 * np.arctan2(2 * xy, xx - yy) + np.pi / 2
    direction = np.stack([np.cos(along), np.sin(along)], -1).astype(np.float32)
    apart = np.hypot(xx - yy, 2 * xy)
    coherence = apart / np.maximum(xx + yy, 1e-6) * ramp(xx + yy, (1e-4, 2e-3))
    away = _from_crown(mask)
    direction *= np.where((direction * away).sum(-1, keepdims=True) < 0, np.float32(-1), np.float32(1))
    return direction, np.asarray(np.clip(coherence, 0, 1) * mask, np.float32)


def _from_crown(mask: Float32) -> Float32:
    """(H, W, 2) from the top of the head, where most strands begin, to each cell."""
    side = len(mask)
    y, x = np.mgrid[:side, :side].astype(np.float32)
    crown = np.array([0.5, 0.22], np.float32) * side
    return np.stack([x - crown[0], y - crown[1]], -1)


def _ends(mask: Float32) -> float:
    """Height in metres of the lowest hair, in the head's frame of a face of usual size."""
    rows = mask.sum(1)
    share = np.cumsum(rows[::-1])[::-1] / max(float(rows.sum()), 1e-6)
    lowest = int(np.flatnonzero(share > 0.02).max(initial=0)) + 1
    return height_of(lowest / len(mask))


FACE_M = 0.178
"""Usual height of the landmarks' bounding box, and below, how far its middle lies below the point between the eyes."""
FACE_MIDDLE_M = -0.026


def height_of(row: float) -> float:
    """Height in the head's frame, metres, of a row (share of the square's height from the top) for a usual face."""
    return FACE_MIDDLE_M - (row - 0.5 + BELOW) * FACE_M / FILL


def _guessed(ends: float) -> dict[str, dict[str, float]]:
    """Probabilities of the kinds by how far the hair reaches; all else as frequent as it is among people."""
    low = np.array([0.02, *LENGTH_ENDS_M, -0.40])
    middle = 0.5 * (low[:-1] + low[1:])
    close = np.exp(-np.abs(ends - middle) / 0.03)
    share = np.concatenate([[0.3 * close[0]], close])
    length = {name: float(p) for name, p in zip(LENGTHS, share / share.sum(), strict=True)}
    return {
        "length": length, "gathered": {"none": 0.75, "half": 0.05, "tied": 0.17, "plaits": 0.03},
        "parting": {"none": 0.4, "left": 0.25, "middle": 0.2, "right": 0.15}, "fringe": {"no": 0.75, "yes": 0.25},
        "curl": {"straight": 0.55, "wavy": 0.25, "curly": 0.1, "coily": 0.1},
    }  # fmt: skip
