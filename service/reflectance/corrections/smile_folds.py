"""Deep folds beside nose and mouth, whose shade de-lighting leaves: black lines in the albedo of a broad smile.

The networks have seen faces at rest. The fold that a smile makes is darker than any crease of theirs and passes for
pigment; in another light it would be dark twice. Pigment that is so dark and so long and thin lies nowhere on cheeks.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.colour import FULL_CODE, Codes, bytes_to_linear, linear_to_srgb, luma, srgb_to_linear
from service.geometry.chart import Chart
from service.ledger import Correction, Ledger, changed_texels
from service.reflectance.subject import GEOMETRY_SIZE, Subject
from service.reflectance.texels import interpolated

Float = npt.NDArray[np.float32]

NOSE_WINGS, CORNERS = (129, 358), (61, 291)
"""Landmarks beside the wings of the nose, and of the corners of the mouth."""
BESIDE, ABOVE_M, BELOW_M = (0.75, 1.9), 0.010, 0.018
"""Where folds are: from the middle outwards in units of the mouth's half width, and from above the wings of the nose
down to below the corners of the mouth, metres."""
DARK = 0.5
"""Natural logarithm by which the albedo of a fold is below that of the skin around, at least."""
AROUND = 41
"""Texels (odd) over which the median of the skin around is taken: 22 mm."""
LONG, WIDE = 14, 10.0
"""Texels up and down that a fold has at least, and across at most, in the mean: 8 and 5.5 mm. A mole is shorter, a
beard is wider."""
KEPT, SLOPE = 0.3, 0.3
"""Logarithm up to which a line stays as dark as it is, and what is left of the rest: folded skin is a little darker."""
DARKEST = 1e-3
STRIP = 512
"""Rows of the full map at a time."""


def fold_zone(chart: Chart) -> npt.NDArray[np.bool_]:
    """(h, w) where folds beside nose and mouth may lie, by the mean head's landmarks."""
    head = chart.head
    corners = head.triangles[head.landmark_triangle]
    points = np.einsum("nk,nki->ni", head.landmark_barycentric, head.mean[corners])
    wings, ends = points[list(NOSE_WINGS)], points[list(CORNERS)]
    half = float(np.abs(ends[:, 0] - ends[:, 0].mean()).mean())
    place = chart.interpolate(head.mean.astype(np.float32))
    aside = np.abs(place[..., 0] - ends[:, 0].mean())
    high = (place[..., 1] < wings[:, 1].max() + ABOVE_M) & (place[..., 1] > ends[:, 1].min() - BELOW_M)
    front = place[..., 2] > ends[:, 2].min() - half
    skin = chart.part == head.part_names.index("skin")
    return np.asarray(skin & high & front & (aside > BESIDE[0] * half) & (aside < BESIDE[1] * half))


def folds(albedo: Float, zone: npt.NDArray[np.bool_]) -> Float:
    """(h, w) float32 >= 0, natural logarithm by which folds are to be brightened; 0 elsewhere, finite for any input.

    Args:
        albedo: (h, w, 3) linear, on a chart of ``GEOMETRY_SIZE``.
        zone: (h, w) where they are sought.
    """
    import cv2

    logs = np.log(np.maximum(np.nan_to_num(luma(albedo)), np.float32(DARKEST)))
    span = np.float32(-np.log(DARKEST))
    codes = np.clip(np.rint(255 * (1 + logs / span)), 0, 255).astype(np.uint8)
    around = np.asarray(cv2.medianBlur(codes, AROUND), np.float32) * (span / 255) - span
    below = logs - around
    count, label, stats, _ = cv2.connectedComponentsWithStats((zone & (below < -DARK)).astype(np.uint8))
    tall, area = stats[:, cv2.CC_STAT_HEIGHT], stats[:, cv2.CC_STAT_AREA]
    chosen = (tall >= LONG) & (area <= WIDE * tall)
    chosen[0] = False
    if not chosen[:count].any():
        return np.zeros_like(logs)
    # Their faint borders too, so that no bright core lies between two dark lines.
    near = cv2.dilate(chosen[label].astype(np.uint8), np.ones((5, 5), np.uint8)).astype(np.float32)
    soft = np.asarray(cv2.GaussianBlur(near, (0, 0), 1.0), np.float32)
    return np.asarray(soft * np.maximum(-below - np.float32(KEPT), 0) * np.float32(1 - SLOPE), np.float32)


def without_folds(albedo: Codes, subject: Subject, ledger: Ledger | None = None) -> Codes:
    """The albedo, changed in place: folds beside nose and mouth are about as bright and coloured as the skin around.

    Args:
        albedo: (H, W, 3) codes of sRGB.
        subject: whose chart it is.
        ledger: told how many texels of the small map change.
    """
    import cv2

    height, width = albedo.shape[:2]
    shrunk = np.asarray(cv2.resize(albedo, GEOMETRY_SIZE, interpolation=cv2.INTER_AREA), np.float32)
    small = shrunk * np.float32(1 / FULL_CODE)
    linear_small = srgb_to_linear(small)
    lift = folds(linear_small, fold_zone(subject.chart))
    if ledger is not None:
        ledger.count(SMILE_FOLDS, *changed_texels(linear_small, linear_small * np.exp(lift)[..., None]))
    codes = np.asarray(cv2.medianBlur(np.rint(small * 255).astype(np.uint8), AROUND))
    skin = bytes_to_linear(codes)
    ratios = np.asarray(skin / np.maximum(luma(skin), np.float32(DARKEST))[..., None], np.float32)
    planes = [lift, *np.moveaxis(ratios, 2, 0)]
    touched = np.flatnonzero(lift.any(0))
    if not len(touched):
        return albedo
    scale = width / lift.shape[1]
    columns = np.arange(int(max(touched[0] - 1, 0) * scale), min(int((touched[-1] + 2) * scale), width))
    for top in range(0, height, STRIP):
        rows = np.arange(top, min(top + STRIP, height))
        more, *hue = (interpolated(plane, (width, height), rows, columns) for plane in planes)
        chosen = more > 1e-3
        if not chosen.any():
            continue
        place = (slice(top, top + len(rows)), slice(int(columns[0]), int(columns[-1]) + 1))
        share = np.exp(more[chosen])[:, None]
        linear = srgb_to_linear(albedo[place][chosen] * np.float32(1 / FULL_CODE)) * share
        # What is brightened much was too dark to have told a hue.
        plain = luma(linear)[:, None] * np.stack([plane[chosen] for plane in hue], 1)
        lifted = np.clip(plain + (linear - plain) / share, 0, 1)
        albedo[place][chosen] = np.rint(linear_to_srgb(lifted) * FULL_CODE).astype(albedo.dtype)
    return albedo


SMILE_FOLDS = Correction(
    name="smile-folds",
    mends="The deep folds of a smile stay in the albedo as black lines.",
    source="albedo",
    cases=("smile",),
)
