"""Folds that the photo's expression makes: where they are, and maps without them and of them alone.

Skin that an expression compresses gets folds that run across the compression (wrinkle maps of performance capture use
the same measure: Oat 2007; Bickel et al. 2008). So the strain between the neutral and the fitted mesh tells what relief
in the photo is the expression's and not the person's.

The strain is the finite one of the surface on the chart. With J the Jacobian of a surface over the chart and the
neutral tangent frame (t along u, b across it), the right Cauchy-Green tensor of the motion is C = J0^-T (J^T J) J0^-1;
its eigenvalues are the squares of the principal stretches (Ogden, Non-Linear Elastic Deformations, 2.2).

Of the relief only what is as coarse as a fold and slopes in the direction of the compression, by its structure tensor,
is taken: pores are finer, shape is coarser, and lines that run along the compression are the person's. Where nothing is
compressed no texel changes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, Bool, Float32, Int64, UInt8, UInt16
from service.face.fit.fit import Fit
from service.geometry.chart import Chart
from service.head.regions import vertex_mask
from service.image_filters import blurred, each_around, most, shrunk
from service.reflectance.planes import read_window
from service.reflectance.reflectance_maps import Wrinkle, pack_slopes, unpack_normals
from service.robust import smoothstep


@dataclass(frozen=True)
class Strain:
    """Symmetric (...) float32 components of C in the neutral tangent frame: x along u, y up across it; 1, 0, 1 where
    nothing moves or the chart has no area.
    """

    xx: Float32
    xy: Float32
    yy: Float32

    @classmethod
    def of(cls, neutral: Float32, moved: Float32) -> Strain:
        """From first fundamental forms (..., 3) of the same chart, as ``Chart.metric`` gives them."""
        e0, f0, g0 = np.moveaxis(neutral.astype(np.float64), -1, 0)
        e, f, g = np.moveaxis(moved.astype(np.float64), -1, 0)
        along = np.sqrt(np.maximum(e0, 0))
        sound = along > 1e-6
        a = np.where(sound, along, 1)
        lean = np.where(sound, f0 / a, 0)
        square = g0 - lean * lean
        sound &= square > 1e-12
        c = np.sqrt(np.where(sound, square, 1))
        parts = (e / a**2, (f - e * lean / a) / (a * c), (g - 2 * lean * f / a + lean**2 * e / a**2) / c**2)
        still = (1.0, 0.0, 1.0)
        xx, xy, yy = (np.where(sound, part, rest).astype(np.float32) for part, rest in zip(parts, still, strict=True))
        return cls(xx, xy, yy)

    def smallest(self) -> tuple[Float32, Float32]:
        """(h, w) smallest principal stretch, and (h, w, 2) float32 unit direction of it; x where all are alike."""
        half, middle = (self.xx - self.yy) / 2, (self.xx + self.yy) / 2
        radius = np.hypot(half, self.xy)
        angle = np.where(radius > 1e-9, np.arctan2(self.xy, half) / 2 + np.pi / 2, 0.0)
        stretch = np.sqrt(np.maximum(middle - radius, 0))
        return stretch.astype(np.float32), np.stack([np.cos(angle), np.sin(angle)], -1).astype(np.float32)

    def along(self, direction: Float32) -> Float32:
        """(...) stretch of lines in directions (..., 2), unit vectors of the neutral frame."""
        x, y = np.moveaxis(direction, -1, 0)
        return np.asarray(np.sqrt(np.maximum(self.xx * x * x + 2 * self.xy * x * y + self.yy * y * y, 0)), np.float32)


GROUPS: dict[str, tuple[str, ...]] = {
    "brows": ("browDown", "browInnerUp", "browOuterUp"),
    "eyes": ("eyeSquint", "eyeBlink", "eyeWide", "eyeLook"),
    "smile": ("mouthSmile", "cheekSquint", "mouthDimple", "mouthStretch", "noseSneer", "mouthUpperUp", "cheekPuff"),
    "mouth": ("mouth", "jaw", "tongueOut"),
}
"""Maps, and how the names of their units begin; a unit belongs to the first that fits."""

COMPRESSED = (0.04, 0.12)
"""Compression, 1 less the smallest principal stretch, up to which skin folds no more than at rest, and from which on
its folds are the expression's."""

LEAST_WEIGHT = 0.05
"""Units that the photo shows less of fold nothing."""

NEVER = (
    "brow_left", "brow_right", "lips", "eyelid_left", "eyelid_right", "mouth_inner", "eye_socket", "scalp", "ear_left",
    "ear_right", "neck",
)  # fmt: skip
"""Regions whose lines are there at rest too, or that no one sees."""

REACH = 9
"""Texels of the chart, 5 mm of the face, by which folds lie beside the compressed skin: the nasolabial fold runs
between cheek and lip, and the mesh, which has no fold, compresses both."""

DIRECTIONS = 4
"""Among which compression is told."""

ALIKE = (0.25, 0.6)
"""Squares of the cosine between compression and slope, from none to all of which the slope is a fold's: 60 and 39
degrees; a mesh of centimetres tells the direction no better."""

SMOOTH = 2.5
"""Standard deviation, in texels of the chart, by which strain is smoothed: it is constant on each polygon."""


@dataclass(frozen=True)
class Creases:
    """Folds of an expression on a chart of (h, w) texels.

    Attributes:
        weights: (DIRECTIONS, h, w) float32 in [0, 1], how much of the relief that slopes in direction k pi / DIRECTIONS
            of the tangent frame, +Y up, is the expression's.
        group: (h, w) uint8, index into :data:`GROUPS` of the units that compress most there.
        units: weights in the photo of the units of each group that folds anything.
    """

    weights: Float32
    group: UInt8
    units: Mapping[str, Mapping[str, float]]

    @classmethod
    def of(cls, chart: Chart, fit: Fit) -> Creases | None:
        """The folds of a fit; None where its expression compresses no visible skin enough.

        Args:
            chart: of the fit's head.
            fit: of the photo.
        """
        head = chart.head
        shown = {
            name: float(value)
            for name, value in zip(head.expression_names, fit.expression, strict=True)
            if abs(value) >= LEAST_WEIGHT
        }
        if not shown:
            return None
        neutral = _smoothed(chart, fit.neutral)
        stretch, across = Strain.of(neutral, _smoothed(chart, fit.vertices)).smallest()
        foldable = _foldable(chart)
        weights = _spread(np.asarray(smoothstep(1 - stretch, *COMPRESSED) * foldable), across) * foldable
        if not weights.any():
            return None
        parts: dict[str, dict[str, float]] = {name: {} for name in GROUPS}
        for unit, weight in shown.items():  # those that belong to no group, as of imported heads, are the mouth's
            parts[next((name for name, starts in GROUPS.items() if unit.startswith(starts)), "mouth")][unit] = weight
        # Interpolated weights reach a texel further.
        folded = cv2.dilate(np.asarray(weights.max(0) > 0, np.uint8), np.ones((3, 3), np.uint8)) > 0
        shares = [_compression(chart, fit.neutral, neutral, across, folded, units) for units in parts.values()]
        group = np.zeros(folded.shape, np.uint8)
        group[folded] = np.argmax(shares, 0)
        there = set(np.unique(group[weights.max(0) > 0]).tolist())
        units = {name: parts[name] for index, name in enumerate(GROUPS) if index in there}
        return cls(weights, group, units)


def _compression(
    chart: Chart, rest: AnyFloat, neutral: Float32, across: Float32, folded: Bool, units: Mapping[str, float]
) -> Float32:
    """(n,) compression across the folds by some units alone, at the texels that are ``folded`` (h, w)."""
    if not units:
        return np.full(int(folded.sum()), -np.inf, np.float32)
    offsets = chart.head.expression[[chart.head.expression_names.index(unit) for unit in units]]
    moved = rest + np.einsum("k,kvc->vc", np.array(list(units.values())), offsets.astype(np.float64))
    strain = Strain.of(neutral[folded], _smoothed(chart, moved)[folded])
    return np.asarray(1 - strain.along(across[folded]), np.float32)


def _spread(weight: Float32, across: Float32) -> Float32:
    """(DIRECTIONS, h, w) the largest weight, of compression in about each direction, within ``REACH``."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * REACH + 1, 2 * REACH + 1))
    found = []
    for k in range(DIRECTIONS):
        angle = k * np.pi / DIRECTIONS
        cosine = across[..., 0] * np.float32(np.cos(angle)) + across[..., 1] * np.float32(np.sin(angle))
        alike = np.clip((cosine**2 - ALIKE[0]) / (ALIKE[1] - ALIKE[0]), 0, 1)
        found.append(cv2.GaussianBlur(cv2.dilate(weight * alike, disc), (0, 0), SMOOTH))
    return np.asarray(found, np.float32)


def _smoothed(chart: Chart, vertices: AnyFloat) -> Float32:
    return blurred(chart.fill_outside(chart.metric(vertices)), SMOOTH)


def _foldable(chart: Chart) -> Float32:
    """(h, w) in [0, 1]: visible skin of the face."""
    skin = np.asarray(chart.part == chart.head.part_names.index("skin"), np.float32)
    never = np.clip(2 * chart.interpolate(vertex_mask(chart.head, *NEVER))[..., 0], 0, 1)
    return np.asarray(cv2.GaussianBlur(skin * (1 - never), (0, 0), SMOOTH) * skin, np.float32)


WIDTH = 1536
"""Most texels of a line of the maps on which folds are found and of wrinkle maps, 3.75 to a mm of the face; they have
at most half of those of other maps."""

FINEST, COARSEST = 1.0, 20.0
"""Standard deviations in texels of ``WIDTH``, 0.25 mm and 5 mm, of the Gaussians between which relief is a fold's."""

LINE = (0.15, 0.45)
"""Coherence of the structure tensor, from none to all of which relief is a line: pores and moles have no direction."""

AROUND = 4.0
"""Standard deviation in texels of ``WIDTH``, 1 mm, of the Gaussian of the structure tensor."""

LEAST_SLOPE = 1e-3
"""A wrinkle map that is nowhere steeper is none."""


def folds_in(codes: npt.NDArray[np.int16], creases: Creases) -> Float32:
    """(h, w, 2) slopes of an expression's folds, to the right and up, on a map at most ``WIDTH`` wide; 0 elsewhere.

    Args:
        codes: (H, W, 2) x and y of tangent-space normals times ``NORMAL_ONE``, +Y up.
        creases: where they are.
    """
    x, y = _slopes(codes)
    share = _share(creases, x, y)
    return np.moveaxis(np.stack([share * x, share * y]), 0, -1)


def wrinkles_of(fold: Float32, creases: Creases) -> tuple[Wrinkle, ...]:
    """The folds of :func:`folds_in` of each group of units as normals of their own."""
    group = cv2.resize(creases.group, fold.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    wrinkles = []
    for name, units in creases.units.items():
        here = group == list(GROUPS).index(name)
        own = [np.where(here, slope, np.float32(0)) for slope in np.moveaxis(fold, 2, 0)]
        if max(float(np.abs(slope).max()) for slope in own) > LEAST_SLOPE:
            wrinkles.append(Wrinkle(name, units, pack_slopes(-own[0], -own[1])))
    return tuple(wrinkles)


AGES = {"auto": 1.0, "none": 0.0, "younger": 0.5, "older": 1.6, "old": 2.4}
"""Factors on the depth of wrinkles, by the name of the option."""


def aged(codes: npt.NDArray[np.int16], chart: Chart, depth: float) -> npt.NDArray[np.int16]:
    """Normals (H, W, 2) int16 whose lines on the face, as coarse as folds, are ``depth`` times as deep; pores stay.

    Args:
        codes: x and y of tangent-space normals times ``NORMAL_ONE``, +Y up.
        chart: of the head.
        depth: 0 takes them off, 1 changes nothing.
    """
    if depth == 1:
        return codes
    x, y = _slopes(codes)
    weight = np.asarray(cv2.resize(_foldable(chart), x.shape[::-1]), np.float32)
    there = np.flatnonzero(weight)
    weight.ravel()[there] *= np.float32(1 - depth) * _lines(x, y, there)[0]
    return unfolded(codes.copy(), weight[..., None] * np.stack([x, y], -1))


def _slopes(codes: npt.NDArray[np.int16]) -> tuple[Float32, Float32]:
    """(h, w) each: slopes to the right and up of relief as coarse as a fold, on the maps where folds are found."""
    x, y, z = np.moveaxis(unpack_normals(shrunk(codes, _small(codes.shape))), 2, 0)
    return _band(-x / np.maximum(z, 0.05)), _band(-y / np.maximum(z, 0.05))


def unfolded_albedo(albedo: UInt16, creases: Creases) -> UInt16:
    """sRGB-coded albedo (H, W, 3) uint16 without the dark lines of an expression's folds.

    Each channel gets what it lacks to its surroundings. A gain would turn what is nearly black, as a cast shadow that
    lies along a fold, into its own hue: bright red.
    """
    size = _small(albedo.shape)
    small = shrunk(albedo, size)
    line = _band(np.log(np.maximum(small @ np.full(3, 1 / 3, np.float32), 1.0)))
    right, down = cv2.Sobel(line, cv2.CV_32F, 1, 0), cv2.Sobel(line, cv2.CV_32F, 0, 1)
    share = _share(creases, np.asarray(right, np.float32), -np.asarray(down, np.float32))
    lacks = [np.asarray(share * np.maximum(-_band(small[..., k]), 0), np.float32) for k in range(3)]
    out = albedo.copy()

    def lighten(rows: slice, columns: slice) -> None:
        part = read_window(lacks, albedo.shape[1::-1], rows, columns)
        out[rows, columns] = np.minimum(np.rint(albedo[rows, columns] + np.maximum(part, 0)), 65535)

    each_around(np.maximum.reduce(lacks) > 1, albedo.shape, lighten)
    return out


def _small(shape: tuple[int, ...]) -> tuple[int, int]:
    """(width, height) of the maps on which folds are found."""
    width = min(max(shape[1] // 2, 1), WIDTH)
    return width, max(width * shape[0] // shape[1], 1)


def _lines(x: Float32, y: Float32, there: Int64) -> tuple[Float32, Float32]:
    """(n,) each, at texels ``there`` of relief with slopes (h, w) to the right and up: how far it is a line, in [0, 1],
    and the direction in which that slopes, radians within half a turn.

    The direction of lines is that of the larger eigenvector of the structure tensor, their coherence the difference of
    its eigenvalues over their sum (Bigun and Granlund 1987).
    """
    wide = AROUND * x.shape[1] / WIDTH
    xx, yy, xy = (blurred(one, wide).ravel()[there] for one in (x * x, y * y, x * y))
    coherence = np.hypot(xx - yy, 2 * xy) / np.maximum(xx + yy, 1e-12)
    line = np.clip((coherence - LINE[0]) / (LINE[1] - LINE[0]), 0, 1)
    return np.asarray(line, np.float32), np.asarray(np.arctan2(2 * xy, xx - yy) / 2, np.float32)


def _share(creases: Creases, x: Float32, y: Float32) -> Float32:
    """(h, w) in [0, 1], how much of relief with slopes (h, w) to the right and up is the expression's."""
    size = x.shape[1::-1]
    there = np.flatnonzero(np.asarray(cv2.resize(creases.weights.max(0), size)) > 0)
    line, direction = _lines(x, y, there)
    # Tent functions of the direction, with a period of pi.
    place = direction * (DIRECTIONS / np.pi) % DIRECTIONS
    total = np.zeros_like(line)
    for k, weight in enumerate(creases.weights):
        apart = np.abs(place - k)
        own = np.asarray(cv2.resize(weight, size)).ravel()[there]
        total += np.maximum(1 - np.minimum(apart, DIRECTIONS - apart), 0) * own
    share = np.zeros(x.shape, np.float32)
    share.ravel()[there] = total * line
    return share


def _band(plane: Float32) -> Float32:
    plane, texels = np.asarray(plane, np.float32), plane.shape[1] / WIDTH
    return blurred(plane, FINEST * texels) - blurred(plane, COARSEST * texels)


def unfolded(codes: npt.NDArray[np.int16], fold: Float32) -> npt.NDArray[np.int16]:
    """(H, W, 2) int16 normals, changed in place, less the slopes (h, w, 2) of :func:`folds_in`; texels without any stay
    as they are.
    """

    def unfold(rows: slice, columns: slice) -> None:
        own = codes[rows, columns]
        x, y, z = np.moveaxis(unpack_normals(own), 2, 0)
        less = read_window(np.moveaxis(fold, 2, 0), codes.shape[1::-1], rows, columns)
        z = np.maximum(z, np.float32(0.05))
        changed = pack_slopes(x / z + less[..., 0], y / z + less[..., 1])
        codes[rows, columns] = np.where(most(np.abs(less))[..., None] > 0, changed, own)

    each_around(most(np.abs(fold)) > 0, codes.shape, unfold)
    return codes
