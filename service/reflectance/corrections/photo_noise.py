"""What noise and compression leave in a small photo, which is no relief.

Where a pixel of the photo is as large as the finest wrinkles, most of what its skin shows at that scale is the
compression's blocks, and a network that knows creases makes folds of it. How strong it is shows on the skin itself:
noise lies everywhere, creases on few places. So detail between a texel of the texture and a cell of the smooth light is
weighed by how far it exceeds what there is of it all over (Wiener's filter). Pores are finer and stay, as they are made
up; photos in which a wrinkle has several pixels stay as they are.
"""

from __future__ import annotations

import numpy as np

from service.arrays import Float32
from service.colour import FULL_CODE, Codes
from service.ledger import SEEN_CHANGE, Constant, Correction, Ledger
from service.reflectance.planes import Planes
from service.reflectance.subject import COVERED, GEOMETRY_SIZE, LIT
from service.reflectance.texels import interpolated

FINE_MM, COARSE_MM = 0.35, 0.65
"""Size of a photo's pixel on the face up to which nothing is done, and from which all is."""
BAND = 6.0
"""Standard deviation of what counts as smooth, texels of ``GEOMETRY_SIZE``: 3 mm."""
NEAR = 2.5
"""The same of the neighbourhood over which strength is measured."""
NOISE = 1.6
"""Strength, over that of the usual detail, up to which all of it is noise."""
LEAST_SKIN = 200
"""Texels of lit, bare skin with fewer of which the usual detail is not known."""
STRIP = 256
"""Rows of the full map at a time."""


def excess(grey: Float32, skin: Float32) -> Float32:
    """(h, w) float32 that detail of a grey map (h, w) has more than creases do, to be subtracted; finite for any input.

    Args:
        grey: sRGB-coded, in [0, 1].
        skin: (h, w) in [0, 1], lit and bare, from which the strength of the noise is taken.
    """
    import cv2

    sound = np.nan_to_num(np.asarray(grey, np.float32), nan=0.0, posinf=1.0, neginf=0.0)
    known = skin > 0.9
    if known.sum() < LEAST_SKIN:
        return np.zeros_like(sound)
    weight = np.maximum(np.asarray(skin, np.float32), np.float32(1e-3))
    both = np.asarray(cv2.GaussianBlur(np.dstack([sound * weight, weight]), (0, 0), BAND), np.float32)
    smooth = both[..., 0] / np.maximum(both[..., 1], np.float32(1e-6))
    detail = (sound - smooth) / np.maximum(smooth, np.float32(0.02))
    usual = 1.4826 * float(np.median(np.abs(detail[known])))
    energy = np.asarray(cv2.GaussianBlur(np.minimum(detail * detail, 1), (0, 0), NEAR), np.float32)
    share = np.minimum((NOISE * usual) ** 2 / np.maximum(energy, np.float32(1e-9)), 1)
    return np.asarray(share * (sound - smooth) * skin, np.float32)


def without_noise(grey: Codes, planes: Planes, pixel_mm: float | None, ledger: Ledger | None = None) -> Codes:
    """The grey skin that rho and sigma read, changed in place: without the noise of a small photo.

    Args:
        grey: (H, W) codes (``service.reflectance.fine_shade``).
        planes: with ``LIT`` and ``COVERED``, or the grey stays as it is.
        pixel_mm: of the face, a pixel of the photo; None: not known, and the grey stays as it is.
        ledger: told how many texels of ``GEOMETRY_SIZE`` change.
    """
    import cv2

    amount = 0.0 if pixel_mm is None else float(np.clip((pixel_mm - FINE_MM) / (COARSE_MM - FINE_MM), 0, 1))
    if not amount > 0 or not {LIT, COVERED} <= set(planes.channels):
        return grey
    height, width = grey.shape
    lit, covered = planes.shrunk([LIT, COVERED], GEOMETRY_SIZE)
    small = np.asarray(cv2.resize(grey, GEOMETRY_SIZE, interpolation=cv2.INTER_AREA), np.float32)
    small *= np.float32(1 / FULL_CODE)
    noise = np.float32(amount * FULL_CODE) * excess(small, np.clip(lit * (1 - covered), 0, 1))
    if ledger is not None:
        ledger.count(PHOTO_NOISE, int((np.abs(noise) > SEEN_CHANGE * FULL_CODE).sum()), noise.size)
    columns = np.arange(width)
    for top in range(0, height, STRIP):
        rows = np.arange(top, min(top + STRIP, height))
        less = interpolated(noise, (width, height), rows, columns)
        strip = grey[rows[0] : rows[-1] + 1]
        strip[:] = np.rint(np.clip(strip - less, 0, FULL_CODE)).astype(grey.dtype)
    return grey


PHOTO_NOISE = Correction(
    name="photo-noise",
    mends="Compression blocks of a small photo come out as relief.",
    source="relief",
    constants={
        "pixel": Constant((FINE_MM, COARSE_MM), "mm on the face: none, all of it", "width of the finest wrinkles"),
        "noise": Constant(NOISE, "times the usual detail", "photos with JPEG blocks"),
    },
    cases=("small",),
)
