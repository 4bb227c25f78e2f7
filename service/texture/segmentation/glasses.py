"""Frames of glasses: thin dark lines round the eyes that are connected across the bridge of the nose.

In the maps they would look like tattoos in the albedo and scars in the normals. The head's mesh has no glasses, so the
skin under them is inpainted.
"""

from __future__ import annotations

import numpy as np

from service.arrays import Bool, Float32, Int64, UInt8
from service.colour import luma, srgb_to_linear
from service.geometry.chart import Chart
from service.ledger import Constant, Correction
from service.texture.segmentation.zones import Zones
from service.texture.unwrap import Unwrapped

WIDEST_M = 0.008
"""Largest width of a line, which is darker than what lies on both sides of it."""

DARK, CLEARLY_DARK, BRIDGE_DARK = 0.3, 0.45, 0.6
"""Contrasts, in natural logarithms of luma, of a line with its sides: smallest of any part of a frame, of the median of
a piece that is not connected to the bridge, and of the bridge. On the nose, bare skin has 0.1 to 0.4 in hard and soft
light (48 photos), two frames had 1.6 and 2.1."""

BLACK = 0.004
"""Linear luma added before the logarithm, so that differences between darker values do not count."""

BRIDGE_M = (0.006, 0.014, -0.006, 0.010)
"""Of the bridge: half width of the strip in the middle of the nose that it crosses, distance that it reaches to both
sides, and its lowest and highest height above the eyes. Joined brows lie higher, the shadow of the nose lower."""

LENS_M = (-0.028, 0.024, 0.044)
"""Of the rims of the lenses: lowest and highest height above the eyes, and largest horizontal distance from an eye."""

TEMPLE_M = 0.014
"""Largest height above or below the eyes of the temples, the arms of the glasses."""

HALO_M = 0.0016
"""Radius by which the found lines are dilated: the photo's blur and sharpening widen a frame."""

GAP_M = 0.002
"""Largest gap in a line, for example a glint."""

LEAST_EXTENT_M, BELOW_M = 0.012, 0.004
"""A piece that is not connected to the bridge is part of the frame only if it has at least this extent, is
``CLEARLY_DARK``, and either lies below this height above the eyes (a rim) or is a temple; else it may be a brow."""

LEVEL, BESIDE_M = 0.35, 0.015
"""Of a temple: largest share of the height in its extent, and smallest distance of its median outside the eyes."""


def frames(chart: Chart, unwrapped: Unwrapped, zones: Zones) -> Bool:
    """(N,) bool: texels where the photo shows the frame of glasses instead of skin; all False where no bridge is found.

    Args:
        chart: of the head; one without two eyes has no glasses.
        unwrapped: the photo on the chart's inner texels.
        zones: of the same texels. Lids, brows and lips never count as frames: lashes and brows are dark lines, too.
    """
    import cv2

    none = np.zeros(len(unwrapped.weight), bool)
    eyes = _eyes(chart)
    shown = (unwrapped.weight > 0) & zones.skin
    if eyes is None or not shown.any():
        return none
    middle, level, apart = eyes
    texel_m = _texel_m(chart, zones)
    place = chart.inside(chart.head.mean) - np.array([middle, level, 0], np.float32)
    aside, above = np.abs(place[:, 0]), place[:, 1]
    lens = (above > LENS_M[0]) & (above < LENS_M[1]) & (np.abs(aside - apart) < LENS_M[2]) & (zones.face > 0.5)
    temple = (np.abs(above) < TEMPLE_M) & (aside > apart)
    near = shown & (zones.features < 0.5) & (zones.scalp < 0.5) & (lens | temple)
    line = np.where(near, _lines(chart, unwrapped.colour, shown, WIDEST_M / texel_m), np.float32(0))

    count, patch = _connected(chart, line > DARK, GAP_M / texel_m)
    texels = [np.flatnonzero((patch == index) & (line > DARK)) for index in range(count)]
    bridges = [index for index in range(1, count) if _is_bridge(place[texels[index]], line[texels[index]])]
    if not bridges:
        return none
    rest = [i for i in range(1, count) if i not in bridges and _is_piece(place[texels[i]], line[texels[i]], apart)]
    found = np.zeros((len(none), 1), np.float32)
    found[np.concatenate([texels[index] for index in bridges + rest])] = 1
    wide = np.asarray(cv2.dilate(chart.spread(found)[..., 0], _disk(2 * HALO_M / texel_m))).ravel()[chart.texels] > 0
    return np.asarray(wide & shown & (zones.features < 0.5))


def _is_bridge(place: Float32, line: Float32) -> bool:
    """Whether a connected patch of lines crosses the middle of the nose.

    Args:
        place: (n, 3) metres: to the subject's left of the middle between the eyes, above it, and to the front.
        line: (n,) contrasts in natural logarithms.
    """
    half, reach, low, high = BRIDGE_M
    sure = place[line > BRIDGE_DARK]
    over = (np.abs(sure[:, 0]) < half) & (sure[:, 1] > low) & (sure[:, 1] < high)
    return bool(over.any() and sure[:, 0].min() < -reach and sure[:, 0].max() > reach)


def _is_piece(place: Float32, line: Float32, apart: float) -> bool:
    """Whether a patch of lines that is not connected to the bridge is a rim or a temple, and not a brow.

    Args:
        place: (n, 3) metres, as of :func:`_is_bridge`.
        line: (n,) contrasts.
        apart: metres from the middle between the eyes to each.
    """
    if not len(line) or np.median(line) <= CLEARLY_DARK:
        return False
    extent = np.ptp(place, axis=0)
    length = float(np.linalg.norm(extent))
    below = bool(place[:, 1].max() < BELOW_M)
    temple = extent[1] < LEVEL * length and float(np.median(np.abs(place[:, 0]))) > apart + BESIDE_M
    return length > LEAST_EXTENT_M and (below or bool(temple))


def _eyes(chart: Chart) -> tuple[float, float, float] | None:
    """Middle between the mean head's eyes, x and y in metres, and each eye's distance from it; None without two
    eyes.
    """
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
    """Median side of a texel of the face, metres."""
    metric = chart.metric(chart.head.mean).reshape(-1, 3)[chart.texels]
    area = np.sqrt(np.maximum(metric[:, 0] * metric[:, 2] - metric[:, 1] ** 2, 0))
    face = (zones.face > 0.5) & zones.skin & (area > 0)
    return float(np.sqrt(np.median(area[face]))) * 1e-3 if face.any() else 1e-3


def _lines(chart: Chart, colour: Float32, shown: Bool, widest: float) -> Float32:
    """(N,) >= 0: logarithm by which texels are darker than both sides of a line up to ``widest`` texels wide."""
    import cv2

    log_luma = np.log(np.maximum(luma(srgb_to_linear(colour)), 0) + np.float32(BLACK))
    typical = np.float32(np.median(log_luma[shown]))
    plane = chart.spread(np.where(shown, log_luma, typical)[:, None], float(typical))[..., 0]
    deeper = np.asarray(cv2.morphologyEx(plane, cv2.MORPH_CLOSE, _disk(widest))) - plane
    return np.asarray(np.where(shown, deeper.ravel()[chart.texels], 0), np.float32)


def _connected(chart: Chart, chosen: Bool, gap: float) -> tuple[int, Int64]:
    """Connected patches, across gaps of up to ``gap`` texels: their number with the background, and each texel's (N,).

    The background is patch 0.
    """
    import cv2

    plane = chart.spread(chosen.astype(np.float32)[:, None])[..., 0]
    count, label = cv2.connectedComponents((np.asarray(cv2.dilate(plane, _disk(gap))) > 0).astype(np.uint8))
    return count, np.asarray(label, np.int64).ravel()[chart.texels]


def _disk(diameter: float) -> UInt8:
    """Elliptic structuring element, of an odd number of texels, at least 3."""
    import cv2

    side = 2 * max(round(diameter / 2), 1) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)), np.uint8)


GLASSES = Correction(
    name="glasses",
    mends="Frames of glasses are painted on the skin.",
    source="texture",
    constants={
        "bridge contrast": Constant(BRIDGE_DARK, "log luma", "48 photos without: 0.4 at most; two frames: 1.6, 2.1"),
        "line width": Constant(WIDEST_M, "m", "frames of the same photos"),
    },
    cases=("glasses",),
)
