"""Grey skin, from which relief is read, beyond what the photo shows: coarse variation there is no relief.

Where the photo's skin ends it shades off at the silhouette, mixes with hair or collar, and inpainting begins, in which
light was guessed. A network that knows creases reads a groove along all of that line. So beyond the outline of the seen
skin what is coarser than ``GRAIN`` is continued from inside, and within ``BORDER`` of it all that is coarser than a
texel of ``GEOMETRY_SIZE``; finer detail stays on both sides. Holes in the seen skin, the openings of eyes and mouth,
are no border of it.
"""

from __future__ import annotations

import numpy as np

from service.arrays import Float32
from service.colour import FULL_CODE, Codes
from service.reflectance.corrections.unseen_light import continued
from service.reflectance.planes import Planes
from service.reflectance.subject import GEOMETRY_SIZE, LIT
from service.reflectance.texels import interpolated

BORDER = 5
"""Width of the border, texels of ``GEOMETRY_SIZE``: 5 mm."""
SOFT = 2.0
"""Standard deviation over which the photo fades in, the same texels."""
GRAIN = 2.5
"""Standard deviation of what counts as coarse in inpainted skin, the same texels."""
SEEN = 0.9
"""Share of lit skin from which on a texel is seen."""
STRIP = 256
"""Rows of the full map at a time."""


def zones(lit: Float32) -> tuple[Float32, Float32]:
    """(h, w) float32 in [0, 1]: 1 on seen skin inside the border; 1 on inpainted skin outside it. Both fall to 0.

    Args:
        lit: (h, w) in [0, 1], share of lit skin.
    """
    import cv2

    _, label = cv2.connectedComponents((lit <= SEEN).astype(np.uint8), connectivity=4)
    rim = np.unique(np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]]))
    outside = np.isin(label, rim[rim > 0]).astype(np.uint8)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * BORDER + 1, 2 * BORDER + 1))

    def within(mask: np.ndarray) -> Float32:
        core = cv2.erode(mask.astype(np.float32), kernel)
        soft = cv2.GaussianBlur(core, (0, 0), SOFT)
        return np.asarray(np.clip(2 * soft - 1, 0, 1), np.float32)  # 0 from the core's edge on

    return within(1 - outside), within(outside)


def without_border(grey: Codes, planes: Planes) -> Codes:
    """The grey skin that rho and sigma read, changed in place: continued beyond the skin that is seen.

    Args:
        grey: (H, W) codes (``service.reflectance.fine_shade``).
        planes: with ``LIT``, or the grey stays as it is; so it does where no skin or all of it is seen.
    """
    import cv2

    if LIT not in planes.channels:
        return grey
    height, width = grey.shape
    inside, outside = zones(planes.shrunk([LIT], GEOMETRY_SIZE)[0])
    if not (inside > SEEN).any() or inside.min() > SEEN:
        return grey
    small = np.asarray(cv2.resize(grey, GEOMETRY_SIZE, interpolation=cv2.INTER_AREA), np.float32)
    both = np.asarray(cv2.GaussianBlur(np.dstack([small * outside, outside]), (0, 0), GRAIN), np.float32)
    grain = small - both[..., 0] / np.maximum(both[..., 1], np.float32(1e-3))
    smooth = continued(small[None], inside)[0] + outside * grain
    change, columns = (1 - inside) * (smooth - small), np.arange(width)
    for top in range(0, height, STRIP):
        rows = np.arange(top, min(top + STRIP, height))
        strip = grey[rows[0] : rows[-1] + 1]
        strip[:] = np.rint(np.clip(strip + interpolated(change, (width, height), rows, columns), 0, FULL_CODE))
    return grey
