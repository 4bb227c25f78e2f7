"""What rho and sigma read relief from, and what the photo's shade tells of their normals.

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

**The shade that the photo shows** corrects the normals: rho's guess is the prior, the shading equation the measurement.
Light from a direction tells what no network knows that is not told of the light: a slope towards it is brighter. In an
octave of periods, with rho's normal n = (x, y) in tangent space, whose error has the variance r^2 each, and the octave
s of the logarithm of the skin's brightness,

    s = g . n + p,    g = d log E / d n,    n' = n + r^2 g (s - g . n) / (r^2 |g|^2 + p^2)

E is the irradiance of the fitted light (``service.reflectance.subject``) and p the standard deviation of the
octave of log albedo: pigment is noise here. This is one update of Kalman's filter (1960); linear shape from shading
(Pentland 1990) is its case without prior and pigment. Across the light nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from service.arrays import Float32
from service.colour import FULL_CODE, LUMA, Codes
from service.image_filters import blurred, by_strips, shrunk, stretched_to
from service.manifest import Octave
from service.reflectance.albedo.corrections import continued
from service.reflectance.planes import Planes, read_window
from service.reflectance.reflectance_maps import NORMAL_ONE, pack_normals
from service.reflectance.subject import GEOMETRY_SIZE
from service.runtime.network_registry import CONTEXT, COVERED, LIT, REGISTRY, SHADED_GREY
from service.texture.photo_sampling import (
    Strip,
    change_strips,
    joined_octaves,
    octave_strips,
    split_octaves,
    stretched,
)

READERS = frozenset(one.stage for one in REGISTRY if SHADED_GREY in one.channels)
"""Stages that read shaded grey."""

GAMMA = 2.2
"""Power law instead of the exact sRGB curve: its error is as smooth as the light, and only detail matters."""

MOST_LIGHT = 4.0
"""Largest magnitude of the natural logarithm of the light that is divided by."""


def shaded_grey(planes: Planes) -> Codes:
    """(H, W) codes of the grey texture, sRGB-coded, divided by its smooth light.

    Args:
        planes: with ``texture_grey`` and ``CONTEXT``.
    """
    width, height = planes.size
    result = np.zeros((height, width), np.uint16)
    read, columns = planes.read(["texture_grey", *CONTEXT]), np.arange(width)

    def divide(rows: slice) -> None:
        grey, *logs = read(np.r_[rows], columns)
        strength = sum(share * one for share, one in zip(LUMA, logs, strict=True))
        strength = np.nan_to_num(np.clip(strength, -MOST_LIGHT, MOST_LIGHT))
        coded = (grey * np.float32(0.5) + np.float32(0.5)) * np.exp(strength * np.float32(-1 / GAMMA))
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


PIGMENT = (0.0193, 0.0211, 0.0235, 0.0243, 0.0289)
"""Standard deviation of log albedo, octave by octave from periods of 2 to 4 texels of ``FULL_WIDTH`` on; measured by
models.lightstage.octaves, as is the next."""
RELIEF = (0.0371, 0.0550, 0.0419, 0.0250, 0.0169)
"""Standard deviation of x and of y of specular normals."""
UNTOLD = 0.98
"""Share of that by which rho errs: sqrt(1 - c^2) with its correlation c of 0.2 (docs/training.md)."""
FULL_WIDTH = 6144
LEAST = 0.02
"""Coded brightness below which logarithms stop."""


def updated(
    normal: Float32, shade: Float32, slope: Sequence[Float32 | float], error: float, pigment: float,
    trust: Float32 | float = 1.0,
) -> Float32:  # fmt: skip
    """(h, w, 2) what the update adds to an octave of x and y; 0 where light has no direction.

    Args:
        normal: (h, w, 2) octave of the guessed x and y.
        shade: (h, w) octave of the logarithm of brightness.
        slope: g along x and along y, (h, w) each or one number.
        error: standard deviation r of each component of ``normal``.
        pigment: standard deviation p, > 0.
        trust: share of it to add, (h, w) or one number.
    """
    x, y = slope
    gain = shade - x * normal[..., 0] - y * normal[..., 1]
    gain *= trust * error**2
    gain /= error**2 * (x * x + y * y) + pigment**2
    return np.asarray(cv2.merge([gain * x, gain * y]), np.float32)


def bare(seen: Float32, planes: Planes) -> Float32:
    """(h, w) float32 in [0, 1] at ``GEOMETRY_SIZE``: how far the photo shows skin there with nothing over it.

    Args:
        seen: (H, W) in [0, 1], how far texels show the photo.
        planes: with ``COVERED``, or all of it counts as bare.
    """
    shown = np.clip(stretched_to(seen, GEOMETRY_SIZE), 0, 1)
    over = planes.shrunk([COVERED], GEOMETRY_SIZE)[0] if COVERED in planes.channels else np.float32(0)
    return np.asarray(shown * (1 - np.clip(over, 0, 1)), np.float32)


def with_shade(normals: npt.NDArray[np.int16], grey: Codes, slope: Float32, trust: Float32,
               shares: tuple[float, ...]) -> npt.NDArray[np.int16]:  # fmt: skip
    """(H, W, 2) codes of normals, changed in place, with what the shade of seen skin tells.

    Args:
        normals: codes of rho's normals.
        grey: (H, W) codes of skin without its smooth light.
        slope: (h, w, 2) g, of any size.
        trust: (h, w) in [0, 1] where ``grey`` is bare skin in the photo's light; smooth, of any size.
        shares: what the photo tells of each octave of this map, finest first (``service.texture.photo_detail``).
    """
    height, width = normals.shape[:2]
    first = max(round(np.log2(FULL_WIDTH / width)), 0)
    weights = [UNTOLD * one for one in RELIEF[first:]]
    octaves = min(len(weights), len(shares))
    if not octaves or not (trust > 0).any():
        return normals
    planes = [np.ascontiguousarray(plane) for plane in (slope[..., 0], slope[..., 1], trust)]

    def changed(one: Strip) -> tuple[npt.NDArray[np.int16], None]:
        bent = one.before * np.float32(1 / NORMAL_ONE)
        coded = one.of(grey) * np.float32(1 / FULL_CODE)
        bands, _ = split_octaves(np.log(np.maximum(coded, np.float32(LEAST))) * np.float32(GAMMA), octaves)
        guess, _ = split_octaves(bent, octaves)
        x, y, trusted = (stretched(plane, (width, height), one.window) for plane in planes)
        there = trusted[one.inside] > 0
        change = []
        for index, (shade, normal) in enumerate(zip(bands, guess, strict=True)):
            x, y, trusted = (shrunk(plane, normal.shape[1::-1]) for plane in (x, y, trusted))
            told = trusted * np.float32(shares[index])
            change.append(updated(normal, shade, (x, y), weights[index], PIGMENT[first + index], told))
        better = (bent + joined_octaves(change))[one.inside]
        x, y = better[..., 0], better[..., 1]
        codes = pack_normals(x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0)))
        return np.where(there[..., None], codes, one.before[one.inside]), None

    change_strips(normals, octave_strips(normals, trust > 0, octaves), changed)
    return normals
