"""The iris between the lids: how much each place in an eye looks like one.

The landmark network gives the rim of the lids only. Inside it the iris is the disc of known size (11.7 mm in every
adult) that is darkest against its surroundings in red, where blue irises are as dark as brown ones and lids as bright
as sclera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

RADIUS_PX = 12
"""Radius of the iris in the patch in which it is sought; REACH is the patch's half side in radii."""
REACH = 4
HALF = RADIUS_PX * REACH
LEAST_RADIUS_PX = 2.0
"""Irises smaller than this in the photo are not to be told from lashes."""
RING = (1.1, 1.6)
LEAST_DISC, LEAST_RING = 0.35, 0.06
"""Share of disc and ring that has to lie between the lids."""
LEAST_CONTRAST = 0.22
"""Of ring and disc, as a share of the range of values between the lids."""
OFF_CENTRE = (0.02, 0.60)
"""Contrast that one radius away from the middle of the opening has to be worth, from corner to corner and across: lids
hide the iris above and below and shade it, so its height is known less well; and they move with it."""

ASIDE = 0.1
"""Contrast that one radius away from where the other eye looks has to be worth."""


@dataclass(frozen=True)
class Iris:
    """An iris in the photo.

    Attributes:
        centre: (2,) photo pixels.
        radius: photo pixels.
        rim: (16, 2) photo pixels round the opening between the lids, in order.
        contrast: how much darker it is than what surrounds it, in [0, 1].
    """

    centre: Array
    radius: float
    rim: Array
    contrast: float


@dataclass(frozen=True)
class Search:
    """One eye, searched.

    Attributes:
        contrast: (n, n) in [-1, 1] with the iris centred at each pixel of a patch about the opening; -1 where too
            little of it would be seen.
        merit: the same less what being off the middle costs; minus infinity outside the opening.
        middle: (2,) photo pixels of the patch's centre.
        radius: of the iris, photo pixels.
        rim: (16, 2) photo pixels.
    """

    contrast: Image
    merit: Image
    middle: Array
    radius: float
    rim: Array

    def to_patch(self, pixels: Array) -> Array:
        """Columns and rows of the patch (N, 2) of photo pixels (N, 2)."""
        return np.asarray((pixels - self.middle) * (RADIUS_PX / self.radius) + HALF)

    def best(self, near: Array | None = None, within: float = np.inf) -> Iris | None:
        """The likeliest iris; of those within so many radii of a photo pixel (2,), nearer ones before others.

        None where nothing has ``LEAST_CONTRAST``.
        """
        merit = self.merit
        if near is not None:
            y, x = np.indices(merit.shape, np.float32)
            away = np.hypot(*(np.stack([x, y], 2) - self.to_patch(near[None])[0]).transpose(2, 0, 1)) / RADIUS_PX
            merit = np.where(away <= within, merit - np.float32(ASIDE) * away.astype(np.float32) ** 2, -np.inf)
        row, column = np.unravel_index(int(np.argmax(merit)), merit.shape)
        found = float(self.contrast[row, column])
        if not (np.isfinite(merit[row, column]) and found > LEAST_CONTRAST):
            return None
        centre = self.middle + (np.array([column, row]) - HALF) * (self.radius / RADIUS_PX)
        return Iris(centre, self.radius, self.rim, min(found, 1.0))

    def spread(self, within: float) -> Image:
        """(n, n) >= 0: merit of the best place within so many radii of each pixel, nearer ones before others."""
        from scipy.ndimage import grey_dilation

        reach = int(within * RADIUS_PX)
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1] / RADIUS_PX
        away = np.hypot(x, y)
        cost = np.where(away <= within, -ASIDE * away**2, -9.0)
        return np.asarray(grey_dilation(np.maximum(self.merit, 0), structure=cost, mode="constant"), np.float32)


def search(pixels: npt.NDArray[np.uint8], rim: Array, radius_px: float) -> Search | None:
    """Look for an iris of known size inside the lids.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        rim: (N, 2) pixels round the opening between the lids, in order, from one corner.
        radius_px: of the iris.

    Returns:
        None where the iris would be too small, the eye is closed or lies at the border, or has no contrast.
    """
    import cv2

    if not np.isfinite(rim).all() or not radius_px >= LEAST_RADIUS_PX:
        return None
    scale = RADIUS_PX / radius_px
    middle = 0.5 * (rim.min(0) + rim.max(0))
    reach = (HALF + 1) / scale + 2
    if (middle < reach).any() or (middle > np.array(pixels.shape[1::-1]) - reach).any():
        return None
    corner = np.floor(middle - reach).astype(int)
    end = np.ceil(middle + reach).astype(int)
    near = cv2.GaussianBlur(pixels[corner[1] : end[1], corner[0] : end[0]], (0, 0), max(0.15 * radius_px, 0.3))
    # Pixel centres are at one half in the photo and at whole numbers in OpenCV and in the patch.
    at = middle - corner - 0.5
    matrix = np.array([[scale, 0, HALF - scale * at[0]], [0, scale, HALF - scale * at[1]]])
    size = (2 * HALF + 1, 2 * HALF + 1)
    patch = cv2.warpAffine(near, matrix, size)
    mask = np.zeros(size[::-1], np.uint8)
    corners = (rim - middle) * scale + HALF
    cv2.fillPoly(mask, [np.rint(corners * 16).astype(np.int32)], 1, shift=4)
    inside = mask > 0
    if inside.sum() < RADIUS_PX**2:
        return None
    red = patch[..., 0].astype(np.float32)
    low, high = np.percentile(red[inside], [3, 90])
    if high - low < 8:
        return None
    value = np.clip((red - low) / (high - low), 0.0, 1.0)
    score = _contrast(value, inside.astype(np.float32))
    y, x = np.indices(score.shape, np.float32)
    along = (rim[len(rim) // 2] - rim[0]) / max(float(np.linalg.norm(rim[len(rim) // 2] - rim[0])), 1e-9)
    aside, above = ((x - HALF) * along[0] + (y - HALF) * along[1], (y - HALF) * along[0] - (x - HALF) * along[1])
    off = (aside**2 * OFF_CENTRE[0] + above**2 * OFF_CENTRE[1]) / RADIUS_PX**2
    return Search(score, np.where(inside, score - off, -np.inf).astype(np.float32), middle, float(radius_px), rim)


def _contrast(value: Image, inside: Image) -> Image:
    """Mean of the ring less mean of the disc about each pixel, counting what is inside; -1 where that is too little."""
    import cv2

    reach = int(np.ceil(RING[1] * RADIUS_PX))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    distance = np.hypot(x, y) / RADIUS_PX
    means, enough = [], np.ones(value.shape, bool)
    for kernel, least in ((distance <= 0.95, LEAST_DISC), ((distance >= RING[0]) & (distance <= RING[1]), LEAST_RING)):
        k = kernel.astype(np.float32)
        count = cv2.filter2D(inside, cv2.CV_32F, k, borderType=cv2.BORDER_CONSTANT)
        total = cv2.filter2D(value * inside, cv2.CV_32F, k, borderType=cv2.BORDER_CONSTANT)
        means.append(total / np.maximum(count, 1.0))
        enough &= count >= least * k.sum()
    return np.where(enough, means[1] - means[0], np.float32(-1)).astype(np.float32)
