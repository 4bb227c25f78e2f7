"""What a photo shows of somebody's hair, on cells of a square that holds all of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float32
from service.colour import bytes_to_linear
from service.face.reading.parts import BEARD, BROW, HAIR, HAT, IRIS, OTHER, SCLERA, SKIN
from service.face.reading.reader import PART_CELLS, Reading, middles
from service.face.reading.sampled import parts_at_pixels
from service.face.region import Region
from service.photo.photo import Photo

CELLS = 176
"""Cells along the square: as large as those of the reader's narrow crop, about two millimetres."""
EDGE_CELLS = 3.0
"""Cells from the edge of the photo that tell nothing: what is black beyond it counts in them, too."""
RAMP = (0.15, 0.45)
"""Probability up to which a cell shows no hair, and from which on it does: the reader is unsure at soft edges."""


@dataclass(frozen=True)
class Seen:
    """Of each cell of a square in the photo; (C, C) float32 in [0, 1] but for ``pixels`` and ``inside``.

    Attributes:
        region: the square.
        pixels: (C, C, 3) float32 linear RGB, the photo.
        hair, skin, brow: 1 where it shows that; brows lie on the skin and count as such, too.
        known: 0 beside the photo and where something hides whether there is hair.
        inside: bool, whether the cell lies well in the photo.
    """

    region: Region
    pixels: Float32
    hair: Float32
    skin: Float32
    brow: Float32
    known: Float32
    inside: Bool

    @classmethod
    def of(cls, photo: Photo, reading: Reading) -> Seen:
        """The narrow crop of the reader where that reaches, and the wider one around it."""
        region = reading.region if reading.around is None else reading.around.region
        count = PART_CELLS if reading.around is None else CELLS
        at = middles(region, count)
        parts = parts_at_pixels(reading, at).reshape(count, count, -1)
        margin = EDGE_CELLS * region.side / count
        inside = ((at >= margin) & (at < np.array(photo.size) - margin)).all(1).reshape(count, count)
        hidden = ramp(_sum(parts, HAT, OTHER))
        hair = ramp(_sum(parts, HAIR))
        return cls(
            region,
            bytes_to_linear(region.cut(photo.pixels, count)),
            hair,
            ramp(_sum(parts, SKIN, BROW, BEARD, SCLERA, IRIS)),
            _sum(parts, BROW),
            np.asarray(inside * (1 - hidden), np.float32),
            np.asarray(inside),
        )


def ramp(share: Float32) -> Float32:
    """``RAMP`` as a share in [0, 1]."""
    return np.asarray(np.clip((share - RAMP[0]) / (RAMP[1] - RAMP[0]), 0, 1), np.float32)


def _sum(parts: Float32, *kinds: int) -> Float32:
    return np.asarray(np.clip(parts[..., list(kinds)].sum(-1), 0, 1), np.float32)
