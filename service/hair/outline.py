"""Strands moved to the outline of the photo's hair, along rays from the middle of the head."""

from __future__ import annotations

import numpy as np

from service.arrays import Float32, Float64
from service.hair.reading import CELLS
from service.hair.scalp import CENTRE, Scalp, length_of
from service.hair.sight import Sight
from service.robust import smoothstep

RAYS = 72
"""Directions in the picture, from the middle of the head, in which outlines are compared."""
SMOOTH_RAYS, BESIDE_RAYS, UNTOLD = 1.6, 8.0, 0.3
"""Standard deviation, in rays, of the smoothing of their difference, and of that for rays of which the photo tells
nothing; rays that weigh as much as none."""
FARTHEST_M = (0.03, 0.045)
"""How far the outline is moved at most, inwards and outwards."""
INWARDS = 0.8
"""Share of its distance from the skin by which a strand comes nearer at most."""
STANDS = 0.5
"""Share of its length by which a strand is moved outwards at most."""
SIDEWAYS_DEG = (140.0, 165.0)
"""Angle from upwards up to which outlines are matched, and from which on not at all: below lies the neck."""
ANGLE_DEG = np.minimum(np.arange(RAYS), RAYS - np.arange(RAYS)) * (360 / RAYS)
"""Of each ray from upwards."""
TOP_DEG = 100.0
"""Angle from upwards up to which the outline is that of the skull's hair: the back is as full as it is there."""


def to_outline(strands: Float32, sight: Sight, skin: Scalp) -> Float32:
    """Strands (N, P, 3) moved along the rays from the middle of the head to the outline of the photo's hair."""
    mask = sight.drawn(strands).mask
    frame = _rays(sight)
    if frame is None or not len(strands):
        return strands
    centre, upwards, scale, cells_per_m = frame
    difference, reach = _differences(centre, upwards, scale, mask, sight)
    if not difference.any():
        return strands
    at, depth = sight.project(strands)
    away = at - centre
    length = np.linalg.norm(away, axis=-1)
    turn = np.mod(np.arctan2(away[..., 1], away[..., 0]) - upwards, 2 * np.pi) / (2 * np.pi) * RAYS
    own, outer = (np.interp(turn, np.arange(RAYS + 1), np.append(row, row[0])) for row in (difference, reach))
    share = np.clip(length / np.maximum(outer, 1e-6), 0, 1.1) ** 2
    # Roots stay on the skin; hair that is off it moves.
    height = np.maximum(skin.outside(strands), 0)
    loose = np.clip(height / 0.006, 0, 1)
    # A head that was fitted larger than the photo's would swallow its hair.
    # What stands farther off the head than it is long would be a spike.
    gone = np.linspace(0, 1, strands.shape[1]) * length_of(strands)[:, None]
    own = np.clip(own, -INWARDS * height * scale, STANDS * gone * scale)
    direction = away / np.maximum(length, 1e-6)[..., None]
    flat = np.einsum("npk,ck->npc", direction * (own * share * loose)[..., None], np.linalg.inv(cells_per_m))
    # What a photo from the front does not tell, the back of the head, is as full as the sides.
    deep = depth - sight.project(CENTRE)[1]
    low = smoothstep(strands[..., 1], -0.11, 0.02)
    behind = np.clip(deep / 0.1, 0, 1) ** 2 * loose * low * float(difference[ANGLE_DEG < TOP_DEG].mean()) / scale
    offset = np.einsum("npk,kc->npc", np.concatenate([flat, behind[..., None]], -1), sight.camera.rotation)
    return np.asarray(strands + offset, np.float32)


def _rays(sight: Sight) -> tuple[Float64, float, float, Float64] | None:
    """Middle of the head in cells, the angle of upwards, cells a metre, and the same of both axes of the camera."""

    def at(point: Float64) -> Float64:
        return np.asarray(sight.project(point[None])[0][0], np.float64)

    middle = CENTRE.astype(np.float64)
    centre = at(middle)
    cells_per_m = np.stack([(at(middle + 0.01 * axis) - centre) / 0.01 for axis in sight.camera.rotation[:2]], 1)
    area = abs(float(np.linalg.det(cells_per_m)))
    if not area > 1e-6:
        return None
    up = at(middle + np.array([0.0, 0.05, 0.0])) - centre
    return centre, float(np.arctan2(up[1], up[0])), float(np.sqrt(area)), cells_per_m


def _reaches(
    centre: Float64, upwards: float, scale: float, mask: Float32, sight: Sight
) -> tuple[Float64, Float64, Float64]:
    """(RAYS,) cells up to which the photo's hair and a silhouette reach, and how far the two can be compared."""
    radii = np.arange(1.0, 0.26 * scale, 0.5)
    angles = upwards + np.arange(RAYS) * 2 * np.pi / RAYS
    x, y = (centre[k] + np.outer(way, radii) for k, way in enumerate((np.cos(angles), np.sin(angles))))
    inside = (x >= 0) & (y >= 0) & (x < CELLS) & (y < CELLS)
    at = np.clip(y, 0, CELLS - 1).astype(int), np.clip(x, 0, CELLS - 1).astype(int)
    hair, style = (sight.hair[at] > 0.5) & inside, (mask[at] > 0.5) & inside
    ends = [np.where(one.any(1), radii[one.shape[1] - 1 - np.argmax(one[:, ::-1], 1)], 0.0) for one in (hair, style)]
    # Hair that goes on beyond the photo, or behind something, does not tell where it ends.
    beyond, rows = np.minimum(np.searchsorted(radii, ends[0] + 2.0), len(radii) - 1), np.arange(RAYS)
    sure = (sight.known[at] > 0.5)[rows, beyond] & inside[rows, beyond]
    sideways = np.clip((SIDEWAYS_DEG[1] - ANGLE_DEG) / (SIDEWAYS_DEG[1] - SIDEWAYS_DEG[0]), 0, 1)
    trust = sure * (ends[0] > 0) * (ends[1] > 0) * sideways
    return ends[0], ends[1], np.asarray(trust, np.float64)


def _differences(centre: Float64, upwards: float, scale: float, mask: Float32, sight: Sight) -> tuple[Float64, Float64]:
    """(RAYS,) cells by which the photo's hair reaches beyond the groom's, smoothed, and how far the groom's reaches."""
    hair, style, trust = _reaches(centre, upwards, scale, mask, sight)
    difference = np.clip(hair - style, -FARTHEST_M[0] * scale, FARTHEST_M[1] * scale)

    def smoothed(rays: float, untold: Float64) -> Float64:
        kernel = np.fft.rfft(np.exp(-0.5 * (ANGLE_DEG * (RAYS / 360) / rays) ** 2))
        summed, weight = (np.fft.irfft(np.fft.rfft(row) * kernel, RAYS) for row in (trust * difference, trust))
        return np.asarray((summed + UNTOLD * untold) / (np.maximum(weight, 0) + UNTOLD))

    # What the photo's edge cuts off comes in as the outline beside it does: sides alone that did would leave a cone.
    inwards = np.minimum(smoothed(BESIDE_RAYS, np.zeros(RAYS)), 0)
    beside = np.where(ANGLE_DEG < TOP_DEG, inwards, 0.0)
    return smoothed(SMOOTH_RAYS, beside), np.maximum(style, 1.0)
