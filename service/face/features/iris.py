"""Where the photo shows the irises between the lids.

The landmark network gives the rim of the lids only. Inside it the iris is the disc of known size (11.7 mm in every
adult) that is darkest against its surroundings in the red channel, where blue irises are as dark as brown ones and lids
as bright as sclera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float32, Float64, UInt8
from service.face.features.rims import filled

MARGIN = 0.12
"""Distance in iris radii that pixels keep from the rim of the lids, which shade the eye."""

RADIUS_PX = 12
"""Radius of the iris in the resampled patch in which it is sought, pixels."""

HALF = 4 * RADIUS_PX
"""Half the side of that patch, pixels."""

CONTRAST_RING = (1.1, 1.6)
"""Inner and outer radius of the ring that the disc is compared with, in iris radii."""

LEAST_DISC, LEAST_RING = 0.35, 0.06
"""Share of the disc and of the ring that has to lie between the lids."""

LEAST_CONTRAST = 0.22
"""Smallest difference between ring and disc, as a share of the range of red between the lids."""

CENTRE_COST = (0.02, 0.60)
"""Cost, in contrast, of lying one radius off the usual place, growing with the square: along the line through the
corners, from the middle of the opening, and across it, from ``ABOVE_LOWER``. Across it is larger: lids hide and shade
the iris above and below, so its height is known less well, and they move with it."""

ABOVE_LOWER, OPENED, RAISED = 0.9, 1.7, 0.4
"""Usual height of the iris above the lower lid, in radii: 5 to 5.5 mm (margin reflex distance 2) of 5.85; height of an
open eye, likewise; and how much of what an eye lacks of it the lower lid has come up, as it does in a smile. The upper
lid rests on the iris, now more, now less: sought in the middle of the opening, irises were found too low, and people
who look into the camera looked at its feet."""

EXPECTED_COST = 0.1
"""Cost, in contrast, of lying one radius off the expected place, growing with the square."""


@dataclass(frozen=True)
class Iris:
    """An iris in the photo.

    Attributes:
        centre: (2,) photo pixels.
        radius: photo pixels.
        rim: (16, 2) photo pixels round the opening between the lids, in order.
        contrast: how much darker it is than its surroundings, in [0, 1].
    """

    centre: Float64
    radius: float
    rim: Float64
    contrast: float


@dataclass(frozen=True)
class Search:
    """What the search found in one eye.

    Attributes:
        contrast: (n, n) float32 in [-1, 1] of an iris centred at each pixel of a patch about the opening; -1 where too
            little of it would lie between the lids.
        merit: (n, n) float32 contrast less the cost of lying off the usual place; minus infinity outside the opening.
        middle: (2,) photo pixels of the patch's centre.
        radius: of the iris, photo pixels.
        rim: (16, 2) photo pixels.
    """

    contrast: Float32
    merit: Float32
    middle: Float64
    radius: float
    rim: Float64

    def to_patch(self, pixels: Float64) -> Float64:
        """(N, 2) columns and rows in the patch of photo pixels (N, 2)."""
        return np.asarray((pixels - self.middle) * (RADIUS_PX / self.radius) + HALF)

    def best(self, near: Float64 | None = None, within: float = np.inf) -> Iris | None:
        """The iris of the largest merit, or None where its contrast is not above ``LEAST_CONTRAST``.

        Args:
            near: (2,) photo pixel where it is expected; distance from it costs merit. None: anywhere.
            within: largest distance from ``near``, in iris radii.
        """
        merit = self.merit
        if near is not None:
            y, x = np.indices(merit.shape, np.float32)
            away = np.hypot(*(np.stack([x, y], 2) - self.to_patch(near[None])[0]).transpose(2, 0, 1)) / RADIUS_PX
            merit = np.where(away <= within, merit - np.float32(EXPECTED_COST) * away.astype(np.float32) ** 2, -np.inf)
        row, column = np.unravel_index(int(np.argmax(merit)), merit.shape)
        found = float(self.contrast[row, column])
        if not (np.isfinite(merit[row, column]) and found > LEAST_CONTRAST):
            return None
        centre = self.middle + (np.array([column, row]) - HALF) * (self.radius / RADIUS_PX)
        return Iris(centre, self.radius, self.rim, min(found, 1.0))

    def spread(self, within: float) -> Float32:
        """(n, n) >= 0: largest merit within so many iris radii of each pixel, less the cost of the distance."""
        reach, (rows, columns) = int(within * RADIUS_PX), self.merit.shape
        merit = np.pad(np.maximum(self.merit, 0).astype(np.float32), reach)
        most = np.zeros((rows, columns), np.float32)
        for y, x in np.ndindex(2 * reach + 1, 2 * reach + 1):
            away = float(np.hypot(y - reach, x - reach)) / RADIUS_PX
            if away <= within:
                most = np.maximum(most, merit[y : y + rows, x : x + columns] - np.float32(EXPECTED_COST * away**2))
        return most


def search(pixels: UInt8, rim: Float64, radius_px: float) -> Search | None:
    """Look for an iris of known size inside the lids.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        rim: (N, 2) pixels round the opening between the lids, in order, from one corner, the lower lid first.
        radius_px: of the iris, photo pixels.

    Returns:
        None where the iris would be too small, or the eye is closed, lies at the photo's border or has no contrast.
    """
    import cv2

    # Radius in photo pixels below which an iris cannot be told from lashes.
    if not np.isfinite(rim).all() or not radius_px >= 2.0:
        return None
    scale = RADIUS_PX / radius_px
    middle = 0.5 * (rim.min(0) + rim.max(0))
    reach = (HALF + 1) / scale + 2
    if (middle < reach).any() or (middle > np.array(pixels.shape[1::-1]) - reach).any():
        return None
    corner = np.floor(middle - reach).astype(int)
    end = np.ceil(middle + reach).astype(int)
    near = cv2.GaussianBlur(pixels[corner[1] : end[1], corner[0] : end[0]], (0, 0), max(0.15 * radius_px, 0.3))
    # Pixel centres lie at halves in photo coordinates, at integers in OpenCV's and in the patch.
    at = middle - corner - 0.5
    matrix = np.array([[scale, 0, HALF - scale * at[0]], [0, scale, HALF - scale * at[1]]])
    size = (2 * HALF + 1, 2 * HALF + 1)
    patch = cv2.warpAffine(near, matrix, size)
    inside = filled((rim - middle) * scale + HALF, size[::-1]) > 0
    if inside.sum() < RADIUS_PX**2:
        return None
    red = patch[..., 0].astype(np.float32)
    low, high = np.percentile(red[inside], [3, 90])
    if high - low < 8:
        return None
    value = np.clip((red - low) / (high - low), 0.0, 1.0)
    score = _contrast(value, inside.astype(np.float32))
    return Search(score, _merit(score, inside, (rim - middle) * scale), middle, float(radius_px), rim)


def _merit(score: Float32, inside: Bool, rim: Float64) -> Float32:
    """(n, n) contrast less ``CENTRE_COST``; ``rim`` (N, 2) in pixels of the patch, from its centre."""
    half = len(rim) // 2
    across = rim[half] - rim[0]
    along = across / max(float(np.linalg.norm(across)), 1e-9)
    down = np.array([-along[1], along[0]])
    down *= np.sign(float((rim[1:half].mean(0) - rim[half + 1 :].mean(0)) @ down)) or 1.0
    lowest, highest = float((rim[1:half] @ down).max()), float((rim[half + 1 :] @ down).min())
    lacking = max(OPENED - (lowest - highest) / RADIUS_PX, 0.0)
    y, x = np.indices(score.shape, np.float32) - np.float32(HALF)
    aside = (x * along[0] + y * along[1]) / RADIUS_PX
    above = (lowest - (x * down[0] + y * down[1])) / RADIUS_PX
    off = CENTRE_COST[0] * aside**2 + CENTRE_COST[1] * (above - ABOVE_LOWER + RAISED * lacking) ** 2
    return np.where(inside, score - off, -np.inf).astype(np.float32)


def _contrast(value: Float32, inside: Float32) -> Float32:
    """Mean of the ring less mean of the disc about each pixel, over pixels inside; -1 where there are too few."""
    import cv2

    reach = int(np.ceil(CONTRAST_RING[1] * RADIUS_PX))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    distance = np.hypot(x, y) / RADIUS_PX
    means, enough = [], np.ones(value.shape, bool)
    ring = (distance >= CONTRAST_RING[0]) & (distance <= CONTRAST_RING[1])
    for kernel, least in ((distance <= 0.95, LEAST_DISC), (ring, LEAST_RING)):
        k = kernel.astype(np.float32)
        count = cv2.filter2D(inside, cv2.CV_32F, k, borderType=cv2.BORDER_CONSTANT)
        total = cv2.filter2D(value * inside, cv2.CV_32F, k, borderType=cv2.BORDER_CONSTANT)
        means.append(total / np.maximum(count, 1.0))
        enough &= count >= least * k.sum()
    return np.where(enough, means[1] - means[0], np.float32(-1)).astype(np.float32)
