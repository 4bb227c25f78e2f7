"""Frames of glasses: thin dark lines round the eyes that hang together over the root of the nose.

Painted on the skin they would be tattoos in the albedo and scars in the normals. A mesh of a head has no glasses, so
the skin under them is made up from what lies beside.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.colour import luma, srgb_to_linear
from service.geometry.chart import Chart
from service.ledger import Correction
from service.texture.segmentation.zones import Zones
from service.texture.unwrap import Unwrapped

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

WIDEST_M = 0.008
"""What is darker than both of its sides and no wider than this is a line."""
DARK, CLEARLY, SURELY = 0.3, 0.45, 0.6
"""Logarithms by which a line is darker than its sides: as part of a frame, in the median of a piece that stands alone,
and over the nose. There bare skin has 0.1 to 0.4 in hard light and soft (48 photos), two frames had 1.6 and 2.1."""
BLACK = 0.004
"""Linear luma from which down darkness is not told."""
BRIDGE_M = (0.006, 0.014, -0.006, 0.010)
"""The bridge lies over the middle of the nose, goes this far to both sides, and lies between these heights above the
eyes: brows that grow together lie above, the shadow of the nose below."""
LENS_M = (-0.028, 0.024, 0.044)
"""Frames lie between these heights above the eyes, and no further from them sideways; temples go on beyond."""
TEMPLE_M = 0.014
"""Heights above and below the eyes between which temples run."""
HALO_M = 0.0016
"""Blur and sharpening of the photo by which a frame is wider than its dark line."""
GAP_M = 0.002
"""Glints that a line may have."""
LEAST_EXTENT_M, BELOW_M = 0.012, 0.004
"""What does not hang together with the bridge is at least as long, ``CLEARLY`` dark, and a rim below that
height above the eyes, or a temple: level, and beside the eyes. Anything else may be a brow."""
LEVEL, BESIDE_M = 0.35, 0.015
"""A temple's extent in height over that in all; how far outside of the eyes its middle lies."""


def frames(chart: Chart, unwrapped: Unwrapped, zones: Zones) -> Mask:
    """(N,) bool: texels where the photo shows the frame of glasses instead of skin; none where no bridge is seen.

    Args:
        chart: of the head; one without two eyes has no glasses.
        unwrapped: the photo on the chart's inner texels.
        zones: of the same texels. Lids, brows and lips are never taken for frames: lashes and brows are dark lines too.
    """
    import cv2

    none = np.zeros(len(unwrapped.weight), bool)
    eyes = _eyes(chart)
    shown = (unwrapped.weight > 0) & zones.skin
    if eyes is None or not shown.any():
        return none
    middle, level, apart = eyes
    texel = _texel_m(chart, zones)
    place = chart.inside(chart.head.mean) - np.array([middle, level, 0], np.float32)
    aside, above = np.abs(place[:, 0]), place[:, 1]
    lens = (above > LENS_M[0]) & (above < LENS_M[1]) & (np.abs(aside - apart) < LENS_M[2]) & (zones.face > 0.5)
    temple = (np.abs(above) < TEMPLE_M) & (aside > apart)
    near = shown & (zones.features < 0.5) & (zones.scalp < 0.5) & (lens | temple)
    line = np.where(near, _lines(chart, unwrapped.colour, shown, WIDEST_M / texel), np.float32(0))

    count, patch = _hang_together(chart, line > DARK, GAP_M / texel)
    own = [np.flatnonzero((patch == index) & (line > DARK)) for index in range(count)]
    bridges = [index for index in range(1, count) if _is_bridge(place[own[index]], line[own[index]])]
    if not bridges:
        return none
    rest = [i for i in range(1, count) if i not in bridges and _is_piece(place[own[i]], line[own[i]], apart)]
    found = np.zeros((len(none), 1), np.float32)
    found[np.concatenate([own[index] for index in bridges + rest])] = 1
    wide = np.asarray(cv2.dilate(chart.spread(found)[..., 0], _disk(2 * HALO_M / texel))).ravel()[chart.texels] > 0
    return np.asarray(wide & shown & (zones.features < 0.5))


def _is_bridge(place: Float, line: Float) -> bool:
    """Whether a patch of lines goes over the middle of the nose.

    Args:
        place: (n, 3) metres aside of and above the middle of the eyes, and to the front.
        line: (n,) logarithms.
    """
    half, reach, low, high = BRIDGE_M
    sure = place[line > SURELY]
    over = (np.abs(sure[:, 0]) < half) & (sure[:, 1] > low) & (sure[:, 1] < high)
    return bool(over.any() and sure[:, 0].min() < -reach and sure[:, 0].max() > reach)


def _is_piece(place: Float, line: Float, apart: float) -> bool:
    """Whether a patch of lines that does not hang together with the bridge is a rim or a temple, and no brow."""
    if not len(line) or np.median(line) <= CLEARLY:
        return False
    extent = np.ptp(place, axis=0)
    length = float(np.linalg.norm(extent))
    below = bool(place[:, 1].max() < BELOW_M)
    temple = extent[1] < LEVEL * length and float(np.median(np.abs(place[:, 0]))) > apart + BESIDE_M
    return length > LEAST_EXTENT_M and (below or bool(temple))


def _eyes(chart: Chart) -> tuple[float, float, float] | None:
    """Middle of both eyes of the mean head, x and y in metres, and how far each lies beside it; None without eyes."""
    head = chart.head
    centres = []
    for index, name in enumerate(head.part_names):
        own = head.triangles[head.triangle_part == index]
        if name.startswith("eye") and len(own):
            centres.append(head.mean[np.unique(own)].mean(0))
    if len(centres) != 2:
        return None
    middle = np.mean(centres, 0)
    return float(middle[0]), float(middle[1]), float(abs(centres[0][0] - middle[0]))


def _texel_m(chart: Chart, zones: Zones) -> float:
    """Side of a texel of the face, metres."""
    metric = chart.metric(chart.head.mean).reshape(-1, 3)[chart.texels]
    area = np.sqrt(np.maximum(metric[:, 0] * metric[:, 2] - metric[:, 1] ** 2, 0))
    face = (zones.face > 0.5) & zones.skin & (area > 0)
    return float(np.sqrt(np.median(area[face]))) * 1e-3 if face.any() else 1e-3


def _lines(chart: Chart, colour: Float, shown: Mask, widest: float) -> Float:
    """(N,) logarithm by which texels are darker than what lies on both sides within ``widest`` texels, from 0 up."""
    import cv2

    level = np.log(np.maximum(luma(srgb_to_linear(colour)), 0) + np.float32(BLACK))
    usual = np.float32(np.median(level[shown]))
    plane = chart.spread(np.where(shown, level, usual)[:, None], float(usual))[..., 0]
    deeper = np.asarray(cv2.morphologyEx(plane, cv2.MORPH_CLOSE, _disk(widest))) - plane
    return np.asarray(np.where(shown, deeper.ravel()[chart.texels], 0), np.float32)


def _hang_together(chart: Chart, chosen: Mask, gap: float) -> tuple[int, npt.NDArray[np.int64]]:
    """Number of patches with the background's, 0; and the patch of each texel (N,). Gaps as wide as ``gap`` join."""
    import cv2

    plane = chart.spread(chosen.astype(np.float32)[:, None])[..., 0]
    count, label = cv2.connectedComponents((np.asarray(cv2.dilate(plane, _disk(gap))) > 0).astype(np.uint8))
    return count, np.asarray(label, np.int64).ravel()[chart.texels]


def _disk(diameter: float) -> npt.NDArray[np.uint8]:
    """Structuring element of an odd number of texels, 3 at least."""
    import cv2

    side = 2 * max(round(diameter / 2), 1) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)), np.uint8)


GLASSES = Correction(
    name="glasses",
    mends="Frames of glasses are painted on the skin.",
    source="texture",
    cases=("glasses",),
)
