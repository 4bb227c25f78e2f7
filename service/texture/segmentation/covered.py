"""The reader's parts on the chart: what hides the head in the photo makes texels unseen, whatever their colour.

Parts are probabilities of cells of about two millimetres: soft edges stay soft on the chart.
"""

from __future__ import annotations

import numpy as np

from service.arrays import Float32
from service.face.fit.result import Fit
from service.face.reading.parts import BACKGROUND, CLOTH, GLASSES, HAIR, HAT, IRIS, MOUTH, OTHER, PARTS, SCLERA, SKIN
from service.face.reading.reader import Reading
from service.face.reading.sampled import parts_at_pixels
from service.geometry.chart import Chart
from service.texture.segmentation.zones import Zones
from service.texture.unwrap import Unwrapped

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
        return ramp(share + parts[:, HAIR] * (1 - zones.scalp))
    return np.maximum(ramp(share + parts[:, HAIR]), ramp(parts[:, HAIR], STRANDS))


def opened(parts: Float32, zones: Zones) -> Float32:
    """(N,) float32 in [0, 1], 1 on skin in whose place the photo shows an eye or the inside of the mouth.

    Lids and lips of the fitted head are never exactly where the photo's are: an iris on a lid would stay there.
    """
    return np.asarray(ramp(parts[:, [SCLERA, IRIS, MOUTH]].sum(1), CERTAIN) * zones.skin, np.float32)


def grown(chart: Chart, hidden: Float32) -> Float32:
    """(N,) float32 what hides the head, larger by ``SHADOW``: hair throws a shadow on the skin before it."""
    import cv2

    reach = max(round(SHADOW * chart.width), 1)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
    image = cv2.dilate(chart.spread(hidden[:, None])[..., 0], kernel)
    soft = np.asarray(cv2.GaussianBlur(image, (0, 0), reach / 2), np.float32)
    return np.maximum(soft.ravel()[chart.texels], hidden)


def ramp(share: Float32, between: tuple[float, float] = RAMP) -> Float32:
    """Smooth step of probabilities of any shape, from 0 at the first of ``between`` to 1 at the second."""
    t = np.clip((share - between[0]) / (between[1] - between[0]), 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t), np.float32)
