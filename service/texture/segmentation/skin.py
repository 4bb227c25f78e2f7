"""Where a photo shows the head's own surface, and where that is skin whose light can be measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float32
from service.face.reading.parts import BEARD, BROW, CLOTH, GLASSES, HAT, LIP, OTHER, SKIN
from service.geometry.chart import Chart
from service.texture.inpainting.inpaint import opacity
from service.texture.segmentation.covered import grown, ramp
from service.texture.segmentation.zones import Zones
from service.texture.unwrap import Unwrapped

SURFACE = (SKIN, BROW, BEARD, LIP)
"""Parts that lie on the skin: all of them are seen, and belong to the albedo."""


SURE_NECK = 0.9
"""Least probability of skin or beard at which the neck is taken from the photo."""

COVERED = 0.2
"""Share of the face from which on a hat, a mask or a hand before it is worth a warning."""

FRAME = (0.1, 0.07)
"""Probability of glasses, and share of the face with more, from which on glasses are worn: 0.12 and 0.15 on two photos
with them, 0.04 at most on 27 without. Frames are thinner than the reader's cells."""


@dataclass(frozen=True)
class Segmentation:
    """Of the inner texels of a chart.

    Attributes:
        seen: (N,) float32 opacity in [0, 1] of the photo where it shows the head's own surface.
        lit: (N,) float32 in [0, 1], 1 where that is skin or lip: there the light can be measured.
        colour: (3,) float32 sRGB, median of the face's bare skin; None where none is seen.
        face: (N,) bool, texels of the face's lit skin that are seen well.
    """

    seen: Float32
    lit: Float32
    colour: Float32 | None
    face: Bool


def segment(chart: Chart, unwrapped: Unwrapped, parts: Float32, zones: Zones) -> Segmentation:
    """Tell the head's own surface from all else.

    Args:
        chart: of the head.
        unwrapped: the photo on it, its weight less where something hides the head.
        parts: (N, 13) as ``service.texture.segmentation.covered.parts_at`` gives them.
        zones: of the same texels.
    """
    # Beards and brows look like shade to who measures light: theirs is that of the skin beside them.
    smooth = 1 - grown(chart, ramp(parts[:, [BEARD, BROW]].sum(1)))
    lit = np.asarray(smooth * (1 - ramp(1 - parts[:, list(SURFACE)].sum(1))), np.float32)
    face = (zones.face > 0.5) & zones.skin & (unwrapped.weight > 0.25) & (lit > 0.5)
    colour = np.median(unwrapped.colour[face], 0).astype(np.float32) if face.any() else None
    doubt = zones.neck * (parts[:, [SKIN, BEARD]].sum(1) < SURE_NECK)  # collars take the neck's shape
    seen = opacity(unwrapped.weight) * (1 - zones.hidden) * (1 - doubt)
    return Segmentation(np.asarray(seen, np.float32), lit, colour, face)


def worn_before(parts: Float32, weight: Float32, zones: Zones) -> tuple[str, ...]:
    """Warnings of what is worn before the face: ``glasses-removed``, ``face-covered``.

    Args:
        parts: (N, 13), see :func:`segment`.
        weight: (N,) of the photo at the texels, before anything was found to hide the head.
        zones: of the same texels.
    """
    face = parts[(weight > 0.25) & (zones.face > 0.5) & zones.skin]
    if not len(face):
        return ()
    worn = {
        "glasses-removed": (face[:, GLASSES] > FRAME[0]).mean() > FRAME[1],
        "face-covered": (ramp(face[:, [HAT, CLOTH, OTHER]].sum(1)) > 0.5).mean() > COVERED,
    }
    return tuple(name for name, true in worn.items() if true)
