"""What rho and sigma read relief from: shaded grey, and how far its fine detail was drawn by super-resolution.

**Shaded grey** is the grey texture divided by the smooth light, with its fine shading kept. A crease is visible by its
shading. delta removes that, as it should, and the albedo then shows relief by colour alone. So the networks of the
normals read the texture divided by the smooth light of the whole chart, as in their training
(``models.training.normals.shaded``).

**Drawn detail.** The detail that zeta draws is the light stage's skin, whose colour follows its height: its pores are
dark and deep. On skin that a photo shows they hardly have to do with each other (``models.training.real_skins``). So
the networks of the normals are told which they look at, as in their training (``models.training.normals``), and draw
the relief that belongs to drawn pores, but none from a photo's own pigment.

**Beyond what the photo shows** coarse variation of grey is no relief. Where the photo's skin ends it shades off at the
silhouette, mixes with hair or collar, and inpainting begins, in which light was guessed. A network that knows creases
reads a groove along all of that line. So beyond the outline of the seen skin what is coarser than ``GRAIN`` is
continued from inside, and within ``BORDER`` of it all that is coarser than a texel of ``GEOMETRY_SIZE``; finer detail
stays on both sides. Holes in the seen skin, the openings of eyes and mouth, are no border of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from service.arrays import Float32
from service.colour import FULL_CODE, LUMA, Codes
from service.image_filters import blurred, by_strips, shrunk, stretched_to
from service.manifest import Octave
from service.reflectance.albedo.light_corrections import continued
from service.reflectance.planes import Planes, read_window
from service.reflectance.relief.shade_update import RELIEF
from service.reflectance.subject import GEOMETRY_SIZE
from service.runtime.network_registry import CONTEXT, LIT, REGISTRY, SHADED_GREY

READERS = frozenset(one.stage for one in REGISTRY if SHADED_GREY in one.channels)
"""Stages that read shaded grey."""

GAMMA = 2.2
"""Power law instead of the exact sRGB curve: its error is as smooth as the light, and only detail matters."""

MOST_LIGHT = 4.0
"""Largest magnitude of the natural logarithm of the light that is divided by."""

def shaded_grey(planes: Planes, albedo: Codes) -> Codes:
    """(H, W) codes of the grey texture, sRGB-coded, divided by its smooth light.

    Args:
        planes: with ``texture_grey`` and ``CONTEXT``.
        albedo: (H, W, 3) codes; its luma is the result where the channels ``CONTEXT`` do not exist.
    """
    width, height = planes.size
    result = np.zeros((height, width), np.uint16)
    light_known = all(name in planes.channels for name in CONTEXT)
    read, columns = planes.read(["texture_grey", *CONTEXT] if light_known else []), np.arange(width)

    def divide(rows: slice) -> None:
        if light_known:
            grey, *logs = read(np.r_[rows], columns)
            strength = sum(share * one for share, one in zip(LUMA, logs, strict=True))
            strength = np.nan_to_num(np.clip(strength, -MOST_LIGHT, MOST_LIGHT))
            coded = (grey * np.float32(0.5) + np.float32(0.5)) * np.exp(strength * np.float32(-1 / GAMMA))
        else:
            coded = albedo[rows] @ (LUMA / np.float32(FULL_CODE))
        result[rows] = np.rint(np.clip(coded, 0, 1) * np.float32(FULL_CODE)).astype(np.uint16)

    by_strips(height, divide)
    return result


def drawn_detail(seen: Float32 | None, octaves: Sequence[Octave], strength: float) -> Float32:
    """(h, w) float32 in [-1, 1] at ``GEOMETRY_SIZE``: values of the channel.

    Octaves count by the power of relief that skin has in them.

    Args:
        seen: (H, W) in [0, 1], how far texels show the photo; None: there is no photo.
        octaves: what the photo tells of each, finest first; none where nothing of it was brought onto the map.
        strength: in [0, 1], of the detail that super-resolution drew; 0 where it did not run.
    """
    power = np.square(RELIEF[-len(octaves) :] if octaves else RELIEF)
    shares = np.array([octave.share for octave in octaves][: len(power)] or [0.0])
    told = float(np.clip((shares * power[: len(shares)]).sum() / power[: len(shares)].sum(), 0, 1))
    shown = np.zeros((1, 1), np.float32) if seen is None else np.clip(np.nan_to_num(seen), 0, 1)
    across = stretched_to(np.asarray(shown, np.float32), GEOMETRY_SIZE)
    return np.asarray(2 * np.clip(strength, 0, 1) * (1 - told * across) - 1, np.float32)


BORDER = 5
"""Width of the border, texels of ``GEOMETRY_SIZE``: 5 mm."""
SOFT = 2.0
"""Standard deviation over which the photo fades in, the same texels."""
GRAIN = 2.5
"""Standard deviation of what counts as coarse in inpainted skin, the same texels."""
SEEN = 0.9
"""Share of lit skin from which on a texel is seen."""


def zones(lit: Float32) -> tuple[Float32, Float32]:
    """(h, w) float32 in [0, 1]: 1 on seen skin inside the border; 1 on inpainted skin outside it. Both fall to 0.

    Args:
        lit: (h, w) in [0, 1], share of lit skin.
    """
    _, label = cv2.connectedComponents((lit <= SEEN).astype(np.uint8), connectivity=4)
    rim = np.unique(np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]]))
    outside = np.isin(label, rim[rim > 0]).astype(np.uint8)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * BORDER + 1, 2 * BORDER + 1))

    def within(mask: np.ndarray) -> Float32:
        core = cv2.erode(mask.astype(np.float32), kernel)
        return np.asarray(np.clip(2 * blurred(core, SOFT) - 1, 0, 1), np.float32)  # 0 from the core's edge on

    return within(1 - outside), within(outside)


def without_border(grey: Codes, planes: Planes) -> Codes:
    """The grey skin that rho and sigma read, changed in place: continued beyond the skin that is seen.

    Args:
        grey: (H, W) codes (``service.reflectance.relief.normal_inputs``).
        planes: with ``LIT``, or the grey stays as it is; so it does where no skin or all of it is seen.
    """
    if LIT not in planes.channels:
        return grey
    height, width = grey.shape
    inside, outside = zones(planes.shrunk([LIT], GEOMETRY_SIZE)[0])
    if not (inside > SEEN).any() or inside.min() > SEEN:
        return grey
    small = shrunk(grey, GEOMETRY_SIZE)
    both = blurred(np.dstack([small * outside, outside]), GRAIN)
    grain = small - both[..., 0] / np.maximum(both[..., 1], np.float32(1e-3))
    smooth = continued(small[None], inside)[0] + outside * grain
    change = (1 - inside) * (smooth - small)

    def add(rows: slice) -> None:
        more = read_window([change], (width, height), rows)[..., 0]
        grey[rows] = np.rint(np.clip(grey[rows] + more, 0, FULL_CODE))

    by_strips(height, add)
    return grey
