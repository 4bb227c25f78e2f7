"""The photo's own detail on a map: octave by octave, as much of it as the photo truly holds there.

Photo and map are split into octaves (``service.texture.photo_sampling``) down to the scale of the texture of 576 x 384;
what is coarser stays the map's. In each octave and texel

    result = g p + h z,    g = seen sqrt(w) min(4 H^2, 1),    h^2 Z = (1 - t) (P - g^2 E),
    P = t w E / H^2 + (1 - t) Z

with the photo's octave p and the map's own z, which super-resolution made up. H^2 is the share of the power that blur
and spacing of the pixels leave (``Sharpness``), E the power of p and Z that of z around the texel, N that of the noise
of sensor and compression, and w = 1 - N / E. So p keeps the power of its signal (spectral subtraction, Boll 1979), and
z fills up to the power P of this skin as far as the photo does not tell; t = seen H^2 S / (H^2 S + N), Wiener's share
with S the larger of w E / H^2 and Z, is what it tells, and P the photo's power or the usual one by that. Both sides of
a border have equal grain. In the two coarsest octaves, which the map took from the photo as well, h = 1 - g.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from service.arrays import AnyFloat, Float32, UInt8
from service.colour import FULL_CODE, Codes, linear_to_srgb, luma, srgb_to_linear
from service.face.fit.fit import Fit
from service.geometry.chart import Chart
from service.head.model import HeadModel
from service.head.regions import vertex_mask
from service.image_filters import blurred, least, most, shrunk, stretched_to
from service.levels import TEXTURE_SIZE
from service.manifest import Detail, Octave
from service.map_registry import SEEN
from service.photo.photo import Photo
from service.texture.photo_sampling import (
    STRIP,
    Places,
    Reader,
    Strip,
    change_strips,
    joined_octaves,
    octave_strips,
    split_octaves,
    stretched,
)
from service.texture.texture import PhotoTexture, Texture

AROUND, KERNEL = 1.5, (11, 11)
"""Standard deviation, texels of an octave's own level, of the neighbourhood over which its power is measured; and where
that ends."""
FACE_BORDER = 8
"""Pixels around the face that its sharpness is measured on."""
SOFT = 2.0
"""Standard deviation, texels of the texture, over which the photo's share fades out."""
REGIONS = ("forehead", "nose", "cheek_left", "cheek_right", "lips", "chin", "ear_left", "ear_right", "neck")
SHOWN_SIZE = (288, 192)
LEAST_SEEN = 0.01
"""Opacity of the photo below which a texel's detail is left alone."""
WHITE, BLACK = 252 / 255, 2 / 255
"""sRGB-coded values beyond which a channel is clipped."""
SIZES = (576, 1152, 2304, 4608, 6144)
"""Widths of a texture that follows the photo's resolution."""


@dataclass(frozen=True)
class OwnDetail:
    """A photo's detail on its head.

    Attributes:
        photo: upright.
        places: of the head in it.
        sharpness: of the photo at the face.
        seen: (h, w) float32 in [0, 1], of the texture's size: how far texels show the photo.
        pixels_per_mm: of the photo on the surface, by region of the head, where the photo shows it.
        gain: (h, w, 3) float32 natural logarithm of linear RGB, of the texture's light over the photo's; None: it is
            the same.
        others: of further photos, each seen where the texture is from it.
    """

    photo: Photo
    places: Places
    sharpness: Sharpness
    seen: Float32
    pixels_per_mm: Mapping[str, float]
    gain: Float32 | None = None
    others: tuple[OwnDetail, ...] = ()

    @classmethod
    def of_all(cls, photos: Sequence[tuple[Photo, Fit]], head: HeadModel, texture: Texture) -> OwnDetail:
        """Measure photos, each where the texture is from it; of one photo :meth:`of`."""
        if not texture.photos:
            return cls.of(photos[0][0], head, photos[0][1], texture)
        first, *others = (
            cls.of(photo, head, fit, texture, own) for (photo, fit), own in zip(photos, texture.photos, strict=True)
        )
        return replace(first, others=tuple(one for one in others if float(one.seen.max(initial=0.0)) > LEAST_SEEN))

    @classmethod
    def of(
        cls, photo: Photo, head: HeadModel, fit: Fit, texture: Texture, own: PhotoTexture | None = None
    ) -> OwnDetail:
        """Measure the photo where the texture shows it; ``own``: what the texture has of it, where there are others."""
        places = Places.of(head, fit)
        code = texture.confidence.astype(np.float32)
        shown = np.asarray(np.clip((code - SEEN) / np.float32(255 - SEEN), 0, 1) * texture.mask, np.float32)
        if own is not None:
            shown *= np.minimum(own.share, own.seen) * np.float32(1 / 255)
        reach = 2 * round(SOFT) + 1
        core = np.asarray(cv2.erode(shown, np.ones((reach, reach), np.uint8)), np.float32)
        seen = np.minimum(shown, blurred(core, SOFT))
        return cls(
            photo, places, measure_sharpness(_face(photo, places, seen), photo.steps), seen,
            _per_mm(places, head, seen), None if own is None else own.gain,
        )  # fmt: skip

    @property
    def all_seen(self) -> Float32:
        """(h, w) float32 in [0, 1]: how far texels show any of the photos."""
        return np.asarray(np.max([self.seen, *(one.seen for one in self.others)], 0), np.float32)

    def texture_size(self, most: int = SIZES[-1]) -> tuple[int, int]:
        """(width, height) of a texture that loses nothing of what the photo holds on most of the seen skin.

        Args:
            most: width that it must not exceed.
        """
        size = self.places.finest.shape[::-1]
        seen = stretched_to(self.seen, size) > 0.5
        if not seen.any():
            return TEXTURE_SIZE
        pixels = np.sqrt(self.places.finest * self.places.coarsest)[seen]
        # Quantile over the seen skin of the photo's pixels per texel that decides the size.
        width = float(np.quantile(pixels, 0.9)) * size[0] * min(2 * self.sharpness.finest, 1.0)
        width = max(width, *(one.texture_size(most)[0] for one in self.others)) if self.others else width
        fitting = [one for one in SIZES if one <= most] or [min(SIZES[0], most)]
        chosen = next((one for one in fitting if one >= width), fitting[-1])
        return chosen, chosen * 2 // 3

    def onto(self, codes: Codes) -> Detail:
        """Bring the photo's detail onto a map, in place; nothing coarser than the texture's texels changes.

        Args:
            codes: (H, W, 3) sRGB-coded colours of the head in the photo's light, 65535 = 1.

        Returns:
            What was done; without octaves where the map is no larger than the texture.
        """
        height, width = codes.shape[:2]
        count = octaves_of(width)
        if not count:
            return self._told(())
        found, areas = [], []
        for one in (self, *self.others):
            work = _DetailedMap(one, (width, height), count)
            change_strips(codes, octave_strips(codes, one.seen > LEAST_SEEN, count), work.changed, work.count)
            found.append(work.octaves())
            areas.append(float(one.seen.sum()))
        return self._told(_together(found, areas))

    def _told(self, octaves: tuple[Octave, ...]) -> Detail:
        blur, noise = round(self.sharpness.blur, 3), round(self.sharpness.noise, 5)
        return Detail(list(octaves), blur, noise, dict(self.pixels_per_mm))


def _together(found: Sequence[tuple[Octave, ...]], areas: Sequence[float]) -> tuple[Octave, ...]:
    """Octaves of photos by the skin that is seen of each."""
    total = max(sum(areas), 1e-6)
    shares = np.array([[one.share for one in octaves] for octaves in found]) * np.array(areas)[:, None] / total
    return tuple(replace(one, share=round(float(share), 4)) for one, share in zip(found[0], shares.sum(0), strict=True))


def own_texture_of(texture: Texture, own: OwnDetail, size: tuple[int, int]) -> UInt8 | None:
    """(H, W, 3) sRGB texture of another size, with the photo's own detail; None where it would be the same.

    Args:
        texture: of the photo.
        own: the photo's detail.
        size: (width, height), 3:2; what the photo does not resolve is smooth.
    """
    across = texture.texture.shape[1]
    if size[0] == across:
        return None
    if size[0] < across:
        return np.asarray(cv2.resize(texture.texture, size, interpolation=cv2.INTER_AREA), np.uint8)
    codes = cv2.resize(texture.texture.astype(np.uint16) * np.uint16(257), size, interpolation=cv2.INTER_CUBIC)
    own.onto(np.asarray(codes, np.uint16))
    result = np.zeros(codes.shape, np.uint8)
    for top in range(0, len(codes), STRIP):
        result[top : top + STRIP] = np.rint(codes[top : top + STRIP] * np.float32(255 / FULL_CODE))
    return result


def octaves_of(width: int) -> int:
    """Octaves of a map of this width that the texture of 576 x 384 does not hold, or holds in part: its own two finest
    are weakened by averaging and interpolation.
    """
    finer = np.log2(width / TEXTURE_SIZE[0])
    return 0 if finer < 0.5 else round(finer) + 2


def _per_mm(places: Places, head: HeadModel, seen: Float32) -> dict[str, float]:
    """Median pixels per millimetre of each of ``REGIONS`` of which the photo shows enough."""
    chart = Chart.build(head, *SHOWN_SIZE)
    dense = stretched_to(places.per_mm, SHOWN_SIZE)
    shown = stretched_to(seen, SHOWN_SIZE) > 0.5
    found = {}
    for name in REGIONS:
        inside = shown & (chart.interpolate(vertex_mask(head, name))[..., 0] > 0.5)
        # Texels of that size with fewer of which a region is not reported.
        if int(inside.sum()) >= 20:
            found[name] = round(float(np.median(dense[inside])), 3)
    return found


def _face(photo: Photo, places: Places, seen: Float32) -> UInt8:
    """The part of the photo that most seen texels lie in."""
    shown = stretched_to(seen, places.finest.shape[::-1]) > 0.5
    if not shown.any():
        return photo.pixels[:0, :0]
    low, high = (np.quantile(places.pixel[shown], q, axis=0) for q in (0.02, 0.98))
    left, top = (max(int(v) - FACE_BORDER, 0) for v in low)
    right, bottom = (int(v) + FACE_BORDER for v in high)
    return photo.pixels[top:bottom, left:right]


def _clipped(photo: Float32) -> Float32:
    """(h, w) in [0, 1]: where a photo (h, w, 3) is white or black in all channels, which tells of no detail."""
    lost = (least(photo) > WHITE) | (most(photo) < BLACK)
    # Standard deviation, texels of the map, over which the photo's share fades out towards clipped skin.
    return blurred(lost.astype(np.float32), 4.0)


def _areas(index: int, share: Float32, area: Float32, inside: tuple[slice, slice]) -> tuple[float, float]:
    """Area inside a strip of which the photo tells an octave, and all of it, in texels of the map."""
    weight, scale = shrunk(area, share.shape[1::-1]).astype(np.float64), 2**index
    own = tuple(slice(part.start // scale, part.stop // scale) for part in inside)
    return float((share[own] * weight[own]).sum()) * scale**2, float(weight[own].sum()) * scale**2


class _DetailedMap:
    """One map that gets a photo's detail."""

    def __init__(self, own: OwnDetail, size: tuple[int, int], octaves: int) -> None:
        self._own, self._size, self._octaves = own, size, octaves
        self._reader = Reader.of(own.photo, own.places, size)
        self._power = np.zeros(octaves)
        self._area = 0.0

    def changed(self, one: Strip) -> tuple[Codes, list[tuple[float, float]]]:
        """New codes of a strip; and of each octave, what of the seen skin's area the photo tells, and that area."""
        map_ = one.before.astype(np.float32) * np.float32(1 / FULL_CODE)
        seen = np.clip(stretched(self._own.seen, self._size, one.window), 0, 1)
        photo = self._reader.rows(one.window[0], one.window[1], one.window[2:])
        seen *= 1 - _clipped(photo)
        if self._own.gain is not None:
            planes = [stretched(np.ascontiguousarray(self._own.gain[..., k]), self._size, one.window) for k in range(3)]
            photo = linear_to_srgb(np.clip(srgb_to_linear(photo) * np.exp(np.stack(planes, -1)), 0, 1))
        np.copyto(photo, map_, where=(seen <= 0)[..., None])
        ours, _ = split_octaves(photo, self._octaves)
        del photo  # these planes are the peak of a run's memory
        theirs, _ = split_octaves(map_, self._octaves)
        pixels = stretched(self._own.places.coarsest, self._size, one.window)
        pixels = pixels * np.float32(self._own.places.coarsest.shape[1] / self._size[0])
        side = stretched(self._own.places.texel_mm, self._size, one.window)
        told = []
        for index in range(self._octaves):
            p, z = ours[index], theirs.pop(0)
            share, gain, rest = self._shares(index, p, z, seen, pixels)
            p *= cv2.merge([gain] * 3)  # what changes, in its place
            z *= cv2.merge([rest - 1] * 3)
            p += z
            told.append(_areas(index, share, seen * side * side, one.inside))
        new = map_[one.inside] + joined_octaves(ours)[one.inside]
        np.clip(new, 0, 1, out=new)
        new *= np.float32(FULL_CODE)
        return np.asarray(np.rint(new, out=new), np.uint16), told

    def _shares(self, index: int, band: Float32, made_up: Float32, seen: Float32,
                pixels: Float32) -> tuple[Float32, Float32, Float32]:  # fmt: skip
        """(h, w) what the photo tells of an octave, t; gains of the photo, g, and of what is made up, h."""
        size = band.shape[1::-1]

        def power(octave: Float32) -> Float32:
            grey = luma(octave)
            return np.asarray(cv2.GaussianBlur(grey * grey, KERNEL, AROUND), np.float32)

        here, tiny = shrunk(seen, size), np.float32(1e-10)
        lowest = np.float32(1 / 2 ** (index + 2)) / np.maximum(shrunk(pixels, size), np.float32(1e-4))
        left = self._own.sharpness.resolved(np.sqrt(np.float32(2)) * lowest)
        noise = self._own.sharpness.noise_power(lowest)
        # Least usual strength of an octave of skin, standard deviation of sRGB-coded luma.
        found, usual = power(band), np.maximum(power(made_up), 0.003**2)
        signal = np.maximum(1 - noise / np.maximum(found, tiny), 0)
        own = signal * found / np.maximum(left, LEAST_LEFT)
        gain = here * np.sqrt(signal) * np.minimum(4 * left, 1)
        strong = left * np.maximum(usual, own)
        told = here * strong / np.maximum(strong + noise, tiny)
        if index >= self._octaves - 2:
            return told, gain, 1 - gain
        missing = np.maximum(told * own + (1 - told) * usual - gain * gain * found, 0)
        return told, gain, np.sqrt(np.clip((1 - told) * missing / usual, 0, 1))

    def count(self, told: list[tuple[float, float]]) -> None:
        """Add what was done to a strip."""
        self._power += [power for power, _ in told]
        self._area += told[0][1]

    def octaves(self) -> tuple[Octave, ...]:
        """What was done."""
        texel = self._texel_mm()
        share = np.clip(self._power / self._area if self._area > 0 else self._power, 0, 1)
        periods = [round(texel * 2 ** (k + 1), 3) for k in range(self._octaves + 1)]
        return tuple(
            Octave(short, long, round(float(one), 4))
            for short, long, one in zip(periods[:-1], periods[1:], share, strict=True)
        )

    def _texel_mm(self) -> float:
        """Median side of a texel of this map on the seen skin."""
        side = self._own.places.texel_mm
        shown = stretched_to(self._own.seen, side.shape[::-1]) > 0.5
        return float(np.median(side[shown])) * side.shape[1] / self._size[0] if shown.any() else 0.0


SECOND_BLUR = 1.0
"""Standard deviation t, pixels."""
LEAST_BLUR = 0.35
"""Standard deviation of a pixel's own area and of the best lens, pixels."""
UNKNOWN_BLUR = 2.0
"""Where there are too few edges to tell."""
LEAST_LEFT = 0.1
"""Share of the power left by the blur below which detail counts as lost."""
QUIET = 1 / 255 / np.sqrt(12)
"""Noise of the rounding to 8 bits."""


@dataclass(frozen=True)
class Sharpness:
    """How sharp a photo is about its face.

    Attributes:
        blur: standard deviation of the point spread function, pixels.
        noise: standard deviation of sRGB-coded luma per pixel, taken as white.
        steps: (8, 8) JPEG quantisation steps of luma over 255, row = vertical frequency; None: not a JPEG.
    """

    blur: float
    noise: float
    steps: Float32 | None = None

    def resolved(self, frequency: AnyFloat) -> Float32:
        """Share of the power of detail that is left at frequencies in cycles per pixel, 0 beyond 0.5."""
        left = np.exp(-((2 * np.pi * self.blur * frequency) ** 2))
        return np.asarray(np.where(frequency < 0.5, left, 0), np.float32)

    @property
    def finest(self) -> float:
        """Highest frequency of which the blur leaves ``LEAST_LEFT`` of the power, cycles per pixel, at most 0.5."""
        return min(float(np.sqrt(-np.log(LEAST_LEFT))) / (2 * np.pi * max(self.blur, 1e-3)), 0.5)

    def noise_power(self, frequency: AnyFloat) -> Float32:
        """Variance of noise and quantisation in the octave that begins at ``frequency``, cycles per pixel."""
        begin, end = np.minimum(frequency, 0.5), np.minimum(2 * frequency, 0.5)
        area = np.pi * (end**2 - begin**2)
        white = self.noise**2 * np.minimum(area, 1)
        if self.steps is None:
            return np.asarray(white, np.float32)
        middle = np.clip(np.rint(16 * np.sqrt(2) * begin), 0, 7).astype(int)
        diagonal = self.steps[middle, middle]
        # A coefficient of an orthonormal 8 x 8 transform has the variance of one pixel: power adds over the octave.
        return np.asarray(white + diagonal**2 / 12 * np.minimum(area, 1), np.float32)


def measure_sharpness(face: UInt8, steps: Float32 | None = None) -> Sharpness:
    """Sharpness of a crop (h, w, 3) sRGB that holds the face; a crop too small to tell counts as blurred.

    Blur: a second blur of known width weakens the gradient of a sharp edge more than that of a soft one; at an edge of
    standard deviation s, by sqrt(1 + t^2 / s^2) for a blur t (Zhuo and Sim 2011). The sharpest edges of a face, lashes,
    brows, the lines of lids and lips, tell what lens, motion, enlargement and denoising left. Noise: the response to a
    kernel that neither planes nor straight edges excite (Immerkaer 1996), its median over the face. JPEG: the file's
    own steps.
    """
    if min(face.shape[:2]) < 16:
        return Sharpness(UNKNOWN_BLUR, 0.01, steps)
    grey = luma(face.astype(np.float32)) * np.float32(1 / 255)
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    noise = 1.4826 * float(np.median(np.abs(cv2.filter2D(grey, -1, kernel)))) / 6
    noise = max(noise, QUIET)
    steep = _gradient(grey)
    softer = _gradient(blurred(grey, SECOND_BLUR))
    # Ridges of the gradient: beside them the second blur brings in what the first had not.
    peak = softer >= np.asarray(cv2.dilate(softer, np.ones((3, 3), np.uint8)))
    # 0.01: share of the face's pixels, those of the steepest gradients, that count as edges.
    # 6.0: gradients below so many times the noise's are no edges.
    least = max(float(np.quantile(softer, 1 - 0.01)), 6.0 * noise * 0.2)
    chosen = peak & (softer >= least)
    # Edges with fewer of which the blur is not known.
    if int(chosen.sum()) < 20:
        return Sharpness(UNKNOWN_BLUR, noise, steps)
    ratio = steep[chosen] / np.maximum(softer[chosen], 1e-9)
    blur = SECOND_BLUR / np.sqrt(np.maximum(ratio**2 - 1, 1e-3))
    # Quantile of the edges' blur that counts as the photo's: edges of a face may be soft themselves.
    found = max(float(np.quantile(blur, 0.10)), LEAST_BLUR)
    # Blur, pixels, from which on it is measured at half the size.
    if found > 1.5 and min(face.shape[:2]) >= 64:  # far wider than the second blur, it hardly tells: look at half size
        half = np.asarray(cv2.resize(face, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)
        coarser = measure_sharpness(half).blur
        found = found if coarser == UNKNOWN_BLUR else max(found, 2 * coarser)
    return Sharpness(found, noise, steps)


def _gradient(grey: Float32) -> Float32:
    """(h, w) magnitude of central differences."""
    kernel = np.array([[-0.5, 0, 0.5]], np.float32)
    across, down = cv2.filter2D(grey, -1, kernel), cv2.filter2D(grey, -1, kernel.T)
    return np.asarray(np.sqrt(across * across + down * down), np.float32)
