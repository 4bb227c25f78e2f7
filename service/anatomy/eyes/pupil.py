"""The size of the pupils, where a photo resolves them: the circle across which luminance rises most.

That is the integro-differential operator of Daugman (1993, "High confidence visual recognition of persons by a test of
statistical independence"), with the median round the circle in place of the mean: lamps that the cornea mirrors cover
less than half of it. A brown iris in dim light is as dark as its pupil, and blur fills small pupils with iris: then
nothing is told.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.anatomy.eyes.eyeball import IRIS_RADIUS_M
from service.anatomy.eyes.iris import Iris, filled
from service.arrays import Float64, UInt8
from service.colour import bytes_to_linear, luma

LEAST_RADIUS_PX = 10.0
"""Radius of an iris in pixels from which on its pupil is looked for."""
SHARES = (0.18, 0.6)
"""Smallest and largest radius of a pupil, in iris radii, 2.1 to 7 mm wide; the largest rise at one of the two is of
something else."""
STEP, AZIMUTHS = 0.02, 48
"""Step between radii, in iris radii, and number of samples round a circle."""
APART, BAND = 0.04, 0.14
"""The luminance on either side of a circle is the mean from the first to the second distance from it."""
OFFSETS = (-0.12, -0.06, 0.0, 0.06, 0.12)
"""Places of the pupil's centre that are tried, across and down, in iris radii: it lies a little off the iris's."""
LEAST_SEEN = 0.4
"""Share of a circle that has to lie between the lids."""
MARGIN = 0.12
"""Distance in iris radii that samples keep from the rim of the lids, which shade the eye."""
DARKEST = 0.002
"""Linear luminance below which differences are noise."""
FLOOR = 0.25
"""What is added to luminances, as a share of their median, before those on the two sides of circles are divided: by
ratios alone a blurred edge lies within the pupil, by differences a faint one is lost beside brightness."""
LEAST_RISE = 0.5
"""Smallest difference of the logarithm of luminance on the two sides of a pupil's edge."""
MOST_APART = 0.12
"""Largest difference between a person's two pupils, in iris radii; more, and at least one of them is a mistake."""


def pupil_radius(pixels: UInt8, irises: Sequence[Iris]) -> float | None:
    """Radius of the pupils in metres, the mean of both eyes; None where they do not both tell, and alike.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        irises: those that were found in it.
    """
    found = [share for iris in irises if (share := _share(pixels, iris)) is not None]
    if len(found) < 2 or max(found) - min(found) > MOST_APART:
        return None
    return IRIS_RADIUS_M * float(np.mean(found))


def _share(pixels: UInt8, iris: Iris) -> float | None:
    """Radius of one pupil in iris radii."""
    if not iris.radius >= LEAST_RADIUS_PX or not np.isfinite(iris.rim).all():
        return None
    radii = np.arange(SHARES[0] - BAND, SHARES[1] + BAND + 0.5 * STEP, STEP)
    dy, dx = (part.ravel() for part in np.meshgrid(OFFSETS, OFFSETS, indexing="ij"))
    profile = _profiles(pixels, iris, np.stack([dx, dy], 1), radii)
    first, last = (int(np.rint(width / STEP)) for width in (APART, BAND))
    count = last - first + 1
    means = np.stack([profile[:, k : k + count].mean(1) for k in range(len(radii) - count + 1)], 1)
    within, beyond = means[:, : -last - first], means[:, last + first :]
    floor = max(FLOOR * float(np.nanmedian(profile)), DARKEST) if np.isfinite(profile).any() else 1.0
    rise = np.nan_to_num(np.log((beyond + floor) / (within + floor)), nan=-np.inf)
    best = np.unravel_index(int(np.argmax(rise)), rise.shape)
    contrast = np.log((beyond[best] + DARKEST) / (within[best] + DARKEST))
    if best[1] in (0, rise.shape[1] - 1) or not contrast >= LEAST_RISE:
        return None
    return float(SHARES[0] + STEP * int(best[1]))


def _profiles(pixels: UInt8, iris: Iris, offsets: Float64, radii: Float64) -> Float64:
    """(O, R) median of linear luminance on circles about centres (O, 2), in iris radii; nan where unseen."""
    import cv2

    reach = int(np.ceil((radii.max() + max(OFFSETS)) * iris.radius)) + 3
    corner = np.floor(iris.centre).astype(int) - reach
    size = 2 * reach + 1
    patch = np.zeros((size, size, 3), np.uint8)
    low, high = np.maximum(corner, 0), np.minimum(corner + size, pixels.shape[1::-1])
    if (high <= low).any():
        return np.full((len(offsets), len(radii)), np.nan)
    rows, columns = (slice(low[k] - corner[k], high[k] - corner[k]) for k in (1, 0))
    patch[rows, columns] = pixels[low[1] : high[1], low[0] : high[0]]
    inside = np.zeros((size, size), np.uint8)
    inside[rows, columns] = filled(iris.rim - corner - 0.5, (size, size))[rows, columns]
    deep = cv2.distanceTransform(inside, cv2.DIST_L2, 3)
    levels = np.ascontiguousarray(luma(bytes_to_linear(patch)))
    angle = np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS)
    ring = np.stack([np.cos(angle), np.sin(angle)], 1)
    at = iris.centre + iris.radius * (offsets[:, None, None] + radii[:, None, None] * ring)  # (O, R, A, 2)
    x, y = (np.asarray((at[..., k] - corner[k] - 0.5).reshape(-1, AZIMUTHS), np.float32) for k in (0, 1))
    read, depth = (np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR)) for image in (levels, np.asarray(deep)))
    seen = depth > MARGIN * iris.radius
    enough = seen.mean(1) >= LEAST_SEEN
    middle = np.full(len(read), np.nan)
    middle[enough] = np.nanmedian(np.where(seen[enough], read[enough], np.nan), axis=1)
    return middle.reshape(len(offsets), len(radii))

