"""Where a photo shows the head's own surface, and where that is skin whose light can be measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float32
from service.face.reading.parts import BEARD, BROW, CLOTH, GLASSES, HAT, LIP, OTHER, SKIN
from service.texture.inpainting.inpaint import opacity
from service.texture.segmentation.covered import ramp
from service.texture.segmentation.zones import Zones
from service.texture.unwrap import Unwrapped

SURFACE = (SKIN, BROW, BEARD, LIP)
"""Parts that lie on the skin and have its light on them; brows, beards and lips belong to the albedo."""

COVERED = 0.2
"""Share of the face that is shown from which on things before it are worth a warning."""

FRAME = 0.003
"""The same for glasses."""


@dataclass(frozen=True)
class Segmentation:
    """Of the inner texels of a chart.

    Attributes:
        seen: (N,) float32 opacity in [0, 1] of the photo where it shows the head's own surface.
        lit: (N,) float32 in [0, 1], 1 where that is skin, brow, beard or lip: there the light can be measured.
        colour: (3,) float32 sRGB, median of the face's bare skin; None where none is seen.
        face: (N,) bool, texels of the face's lit skin that are seen well.
    """

    seen: Float32
    lit: Float32
    colour: Float32 | None
    face: Bool


def segment(unwrapped: Unwrapped, parts: Float32, zones: Zones) -> Segmentation:
    """Tell the head's own surface from all else.

    Args:
        unwrapped: the photo on the chart, its weight less where something hides the head.
        parts: (N, 13) as ``service.texture.segmentation.covered.parts_at`` gives them.
        zones: of the same texels.
    """
    lit = 1 - ramp(1 - parts[:, list(SURFACE)].sum(1))
    face = (zones.face > 0.5) & zones.skin & (unwrapped.weight > 0.25) & (lit > 0.5)
    bare = face & (parts[:, SKIN] > 0.5)
    colour = np.median(unwrapped.colour[bare], 0).astype(np.float32) if bare.any() else None
    seen = opacity(unwrapped.weight) * (1 - zones.hidden)
    return Segmentation(np.asarray(seen, np.float32), lit, colour, face)


def worn_before(parts: Float32, shown: Float32, zones: Zones) -> tuple[str, ...]:
    """Warnings of what is worn before the face: ``glasses-removed``, ``face-covered``.

    Args:
        parts: (N, 13).
        shown: (N,) weight of the photo, before anything was found to hide the head.
        zones: of the same texels.
    """
    face = (shown > 0.25) & (zones.face > 0.5) & zones.skin
    found = ramp(np.stack([parts[:, GLASSES], parts[:, [HAT, CLOTH, OTHER]].sum(1)])) > 0.5
    shares = found[:, face].mean(1) if face.any() else np.zeros(2)
    return tuple(
        name for name, share, least in zip(("glasses-removed", "face-covered"), shares, (FRAME, COVERED), strict=True)
        if share > least
    )  # fmt: skip
