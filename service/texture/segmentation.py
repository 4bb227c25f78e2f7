"""Where on the chart a photo shows the head's own surface, and where that is skin whose light can be measured.

What hides the head makes texels unseen, whatever their colour. The reader's parts are probabilities of cells of about
two millimetres: soft edges stay soft on the chart.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from service.arrays import Bool, Float32
from service.face.fit.result import Fit
from service.face.reading.part_labels import (
    BACKGROUND,
    BEARD,
    BROW,
    CLOTH,
    GLASSES,
    HAIR,
    HAT,
    IRIS,
    LIP,
    MOUTH,
    OTHER,
    PARTS,
    SCLERA,
    SKIN,
)
from service.face.reading.reader import Reading, parts_at_pixels
from service.geometry.chart import Chart
from service.head.regions import vertex_mask
from service.image_filters import blurred
from service.robust import smoothstep
from service.texture.inpainting import opacity
from service.texture.unwrap import Unwrapped


@dataclass(frozen=True)
class Zones:
    """Masks at the inner texels (N,), in the order of ``chart.texels``: float32 in [0, 1] except ``skin``.

    Attributes:
        skin: bool, texel of the part "skin".
        face: the face proper, where hair and make-up are part of the likeness.
        scalp: where hair is expected.
        neck: below the jaw.
        mouth: the inside of the mouth.
        hidden: inside of the mouth and of the eye sockets.
    """

    skin: Bool
    face: Float32
    scalp: Float32
    neck: Float32
    mouth: Float32
    hidden: Float32

    @classmethod
    def of(cls, chart: Chart) -> Zones:
        """Interpolate the head's region masks to the texels of the chart."""
        head = chart.head
        rows = [
            vertex_mask(head, "face"),
            vertex_mask(head, "scalp"),
            vertex_mask(head, "neck"),
            vertex_mask(head, "mouth_inner"),
            vertex_mask(head, "mouth_inner", "eye_socket"),
        ]
        skin = chart.part.ravel()[chart.texels] == head.part_names.index("skin")
        return cls(skin, *np.ascontiguousarray(chart.inside(np.stack(rows, 1)).T))


BEFORE = (BACKGROUND, GLASSES, HAT, CLOTH, OTHER)
"""Parts that are never the head's own surface; hair is its own only on the scalp."""
RAMP = (0.25, 0.55)
"""Probability up to which a texel counts as seen, and from which on as hidden."""
SHADOW = 0.009
"""Width of the shadow of hair on the forehead, over the chart's width: 4 mm."""
STRANDS = (0.08, 0.3)
"""The same for hair alone: single strands before the forehead would be left as streaks."""
CERTAIN = (0.5, 0.9)
"""The same for eyes and mouth in place of skin: the rims of lids and lips lie in cells that they share with these."""


def parts_at(reading: Reading, fit: Fit, unwrapped: Unwrapped) -> Float32:
    """(N, 13) float32 probabilities of the parts at each texel; 0 where the photo does not show it.

    Beyond the crops, where nothing was read, all counts as background.

    Args:
        reading: of the photo that was fitted.
        fit: camera of the photo.
        unwrapped: the photo on the chart's inner texels.
    """
    result = np.zeros((len(unwrapped.weight), reading.parts.shape[-1]), np.float32)
    shown = np.flatnonzero(unwrapped.weight > 0)
    result[shown] = parts_at_pixels(reading, fit.camera.project(unwrapped.position[shown]), strands=True)
    return result


def parts_of_face(chart: Chart, unwrapped: Unwrapped, zones: Zones) -> Float32:
    """(N, 13) float32 as :func:`parts_at`, where nothing was read: the face shows itself, all else is hidden.

    Hair, collars and walls lie beside the face; what is before it cannot be told.
    """
    result = np.zeros((len(unwrapped.weight), len(PARTS)), np.float32)
    result[:, SKIN], result[:, OTHER] = zones.face, 1 - zones.face
    names = np.array(chart.head.part_names)[chart.inner_part]
    for part, own in ((SCLERA, np.char.startswith(names, "eye")), (MOUTH, np.char.startswith(names, "teeth"))):
        result[own] = 0
        result[own, part] = 1
    return result * (unwrapped.weight > 0)[:, None]


def covered(parts: Float32, zones: Zones, *, bald: bool = False) -> Float32:
    """(N,) float32 in [0, 1], 1 where the photo shows something before the head.

    Args:
        parts: (N, 13) as :func:`parts_at` gives them.
        zones: of the same texels.
        bald: hair hides the scalp too, as it is a mesh of its own.
    """
    share = parts[:, list(BEFORE)].sum(1)
    if not bald:
        return smoothstep(share + parts[:, HAIR] * (1 - zones.scalp), *RAMP)
    return np.maximum(smoothstep(share + parts[:, HAIR], *RAMP), smoothstep(parts[:, HAIR], *STRANDS))


def shows_opening(parts: Float32, zones: Zones) -> Float32:
    """(N,) float32 in [0, 1], 1 on skin in whose place the photo shows an eye or the inside of the mouth.

    Lids and lips of the fitted head are never exactly where the photo's are: an iris on a lid would stay there.
    """
    return np.asarray(smoothstep(parts[:, [SCLERA, IRIS, MOUTH]].sum(1), *CERTAIN) * zones.skin, np.float32)


def grown(chart: Chart, hidden: Float32) -> Float32:
    """(N,) float32 what hides the head, larger by ``SHADOW``: hair throws a shadow on the skin before it."""
    reach = max(round(SHADOW * chart.width), 1)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
    image = cv2.dilate(chart.spread(hidden[:, None])[..., 0], kernel)
    soft = blurred(image, reach / 2)
    return np.maximum(soft.ravel()[chart.texels], hidden)


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
        parts: (N, 13) as ``service.texture.segmentation.parts_at`` gives them.
        zones: of the same texels.
    """
    # Beards and brows look like shade to who measures light: theirs is that of the skin beside them.
    smooth = 1 - grown(chart, smoothstep(parts[:, [BEARD, BROW]].sum(1), *RAMP))
    lit = np.asarray(smooth * (1 - smoothstep(1 - parts[:, list(SURFACE)].sum(1), *RAMP)), np.float32)
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
        "face-covered": (smoothstep(face[:, [HAT, CLOTH, OTHER]].sum(1), *RAMP) > 0.5).mean() > COVERED,
    }
    return tuple(name for name, true in worn.items() if true)
