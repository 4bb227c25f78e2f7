"""A beard of strands: where the photo shows one, as long and in the colour that it shows, moving with the face.

::

    parts that were read --see--> how much of it grows where, how far it hangs --grow--> Groom --cards--> meshes

Hair of the face has its own way: down the cheeks, aside from under the nose, forward from the chin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Int64
from service.colour import bytes_to_linear, luma, srgb_to_linear
from service.face.fit.fit import Fit
from service.face.reading.part_labels import BEARD, OTHER, SKIN
from service.face.reading.reader import Reading, middles, parts_at_pixels
from service.geometry.mesh import unit, vertex_normals
from service.geometry.nearest import Nearest
from service.geometry.raster import interpolate
from service.geometry.remesh import split_in_four
from service.hair.cards import Budget, hair_parts
from service.hair.find_hair import USUAL_SKIN, painted
from service.hair.groom import Groom, wandering
from service.hair.guides import CLEARANCE_M, DOWN
from service.hair.reading import CELLS, HairReading
from service.hair.scalp import EDGE, Roots, Scalp
from service.hair.shape import seen_share
from service.hair.sight import Sight
from service.hair.style import Style
from service.head.model import HeadModel
from service.head.regions import vertex_mask
from service.image_filters import blurred, ramp
from service.levels import QualityName
from service.materials.part import MeshPart, targets_of
from service.photo.photo import Photo
from service.robust import smoothstep

NAME = "beard"
"""Of its first mesh, with which the names of the others begin."""
BUDGETS: dict[QualityName, Budget] = {
    "draft": Budget(10_000, 512), "standard": Budget(24_000, 1024), "high": Budget(48_000, 1024),
    "reference": Budget(48_000, 2048),
}  # fmt: skip
FULL_BEARD = 1.2
"""Strands of a beard on all of the skin where one can grow over those of a full head: it is denser."""
SURE, FULL = 0.6, 0.15
"""Probability of beard from which on a cell tells of it, and the least share of the zone that such cells are: a third
of it where the beard hangs."""
DARKER, FULLER = 0.68, 0.4
"""A beard is no brighter than this over the skin beside it, or covers more of its zone than that, or hangs: else it is
shade, or stubble, which the skin's texture shows."""
LEAST_SHARE = 0.02
"""Least share of the skin where a beard can grow that has one."""
HANGS_M = 0.02
"""How far below the chin hair is seen from which on a beard is long."""
REACHES, FEWEST = 0.42, 8
"""Probability of beard on the corner of the jaw from which on it reaches the ears, and fewest vertices that tell."""
BESIDE_CELLS = 7.0
"""Standard deviation of the blur that tells the skin beside a cell: 17 mm."""
GOES_ON_M, ROUND_JAW = 0.16, 12
"""Distance at which a beard has ended that goes on along the unseen jaw, and vertices that tell how it does."""
NECK_M, JAW_RISES = -0.113, 0.25
"""Height in the head's frame below which no beard grows under the chin, and how much higher that is further back."""
SPLITS = 2
"""Of the head's triangles, which are coarser than what the photo tells."""
POINTS = 14
"""Of a strand."""


@dataclass(frozen=True)
class Beard:
    """A beard on a head.

    Attributes:
        groom: strands on the fitted head at rest, in the photo's light until it is taken off.
        skin: of the face, on which it grows as far as :attr:`Scalp.grows` says.
        share: of the skin on which a beard can grow, in (0, 1].
    """

    groom: Groom
    skin: Scalp
    share: float


@dataclass(frozen=True)
class Seen:
    """What a photo tells of a beard.

    Attributes:
        skin: as :attr:`Beard.skin`.
        share: of the skin on which a beard can grow, in (0, 1].
        sight: the beard in the photo, and what lies beside it.
        read: the same as a reading of hair.
        hangs_m: how far it reaches below the chin.
    """

    skin: Scalp
    share: float
    sight: Sight
    read: HairReading
    hangs_m: float


def grow_beard(
    photo: Photo, head: HeadModel, fit: Fit, reading: Reading | None, scalp: Scalp | None, strands: int, seed: int
) -> Beard | None:
    """The beard of a photo; None where none is seen, or the head does not say where one grows.

    Args:
        photo: that was fitted.
        head: the model; its regions ``beard``, ``chin`` and ``scalp`` say where hair grows.
        fit: camera and vertices.
        reading: of the photo's parts.
        scalp: of the fitted head at rest; None to make it.
        strands: of a full head of hair.
        seed: of all that is random.
    """
    if reading is None or not {"beard", "chin", "scalp"} <= set(head.region_names):
        return None
    seen = _seen(photo, head, fit, reading, scalp)
    return None if seen is None else Beard(_groom(seen, photo, fit, strands, seed), seen.skin, seen.share)


def _seen(photo: Photo, head: HeadModel, fit: Fit, reading: Reading, scalp: Scalp | None) -> Seen | None:
    region, at = reading.region, middles(reading.region, CELLS)
    parts = parts_at_pixels(reading, at).reshape(CELLS, CELLS, -1)
    height, width = photo.pixels.shape[:2]
    inside = np.asarray(((at >= 0) & (at < [width, height])).all(1).reshape(CELLS, CELLS), np.float32)
    mask = np.asarray(parts[..., BEARD] * inside, np.float32)
    none, way = np.zeros_like(mask), np.zeros((CELLS, CELLS, 2), np.float32)
    read = HairReading(region, mask, np.asarray(inside * (1 - parts[..., OTHER])), none, way, none, {}, (0.0, 0.0))
    sight = Sight.of(read, fit, head)
    # What hangs before the neck is taken for hair of the neck.
    zone = head.region("beard") * (head.mean[:, 1] > NECK_M + JAW_RISES * np.maximum(-head.mean[:, 2] - 0.01, 0))
    normals = vertex_normals(fit.neutral, head.triangles)
    ahead = unit(fit.camera.centre - fit.vertices)
    shown, seen = sight.read(mask, fit.vertices)
    seen &= (vertex_normals(fit.vertices, head.triangles) * ahead).sum(1) > 0.3
    own = (zone > 0.5) & seen
    sure = float((shown[own] > SURE).mean()) if own.any() else 0.0
    hangs, (beside, told) = _below_chin(head, fit, reading), _over_skin(photo, parts, sight)
    told &= mask > SURE
    usual = float(np.median(beside[told])) if told.any() else 1.0
    if sure < FULL * (0.3 if hangs > HANGS_M else 1.0) or (hangs < HANGS_M and sure < FULLER and usual > DARKER):
        return None
    # A moustache, and what is round the mouth in long beards, which the reader misses, is as dark as the rest.
    depth = 1 - usual
    as_dark = ramp(1 - beside, (0.25 * depth, 0.65 * depth)) if usual < DARKER else none
    missed = zone if hangs > HANGS_M else _under_nose(head)
    sides = _sideburns(head, shown, seen)
    both = np.maximum(zone, sides)
    most = np.maximum(shown, missed * sight.read(as_dark, fit.vertices)[0])
    most = np.where(seen, most, np.where(seen[head.mirror], most[head.mirror], 0))
    other = _along_jaw(head, most, seen | seen[head.mirror], both)
    of_skin = head.triangle_part == head.part_names.index("skin")
    triangles, uv = head.triangles[of_skin], head.uv[head.triangle_uv[of_skin]]
    kept = (both[triangles] > 0.02).all(1)
    columns = np.column_stack([fit.neutral, fit.vertices, normals, both, missed, sides, seen, other])
    corners = np.concatenate([columns[triangles[kept]], uv[kept]], 2)  # each of its own, as the chart has seams
    rows, places = corners.reshape(-1, corners.shape[2]), np.arange(3 * len(corners)).reshape(-1, 3)
    for _ in range(SPLITS):
        rows, places = split_in_four(rows, places, np.ones(len(places), np.bool_))
    fine = rows[places].astype(np.float32)
    neutral, posed, normal = (fine[..., k : k + 3] for k in (0, 3, 6))
    both, missed, sides, seen, other = np.moveaxis(fine[..., 9:14], 2, 0)
    shown = np.maximum(sight.read(mask, posed)[0], missed * sight.read(as_dark, posed)[0])
    shown = np.where(seen > 0.99, shown, other)  # an unseen side is as the other
    grows = ramp(np.maximum(shown, sides), (0.2, 0.7)) * ramp(both, (0.1, 0.5))
    skin = replace(
        scalp or Scalp.of(head, fit.neutral), corners=neutral, normals=unit(normal), grows=grows, uv=fine[..., 14:]
    )
    whole = float((skin.area * both.mean(1)).sum())
    if float(skin.area[(grows > EDGE).all(1)].sum()) < LEAST_SHARE * whole:  # on so little roots are hard to place
        return None
    return Seen(skin, min(float((skin.area * grows.mean(1)).sum()) / whole, 1.0), sight, read, hangs)


def _along_jaw(head: HeadModel, shown: Float32, seen: Bool, zone: Float32) -> Float32:
    """(V,) as ``shown``, and where neither side is seen of the ``zone`` (V,) as on the nearest skin that is."""
    known, lacking = np.flatnonzero(seen & (zone > 0.1)), np.flatnonzero(~seen & (zone > 0.1))
    if not len(known) or not len(lacking):
        return shown
    away, near = Nearest(head.mean[known])(head.mean[lacking], ROUND_JAW)
    on = shown.copy()
    on[lacking] = shown[known[near]].mean(1) * ramp(-away.mean(1), (-GOES_ON_M, 0.0))
    return on


def _under_nose(head: HeadModel) -> Float32:
    """(V,) 1 where a moustache grows, 0 elsewhere."""
    x, y, z = np.abs(head.mean[:, 0]), head.mean[:, 1], head.mean[:, 2]
    return np.asarray((head.region("beard") > 0.5) & (y > -0.063) & (y < -0.053) & (x < 0.035) & (z > 0), np.float32)


def _sideburns(head: HeadModel, shown: Float32, seen: Bool) -> Float32:
    """(V,) 1 before the ears of a beard that reaches them, by how far it is shown (V,) where the photo shows the head.

    It goes on to the hair; the reader misses that.
    """
    x, y, z = np.abs(head.mean[:, 0]), head.mean[:, 1], head.mean[:, 2]
    ear = np.maximum(vertex_mask(head, "ear_left"), vertex_mask(head, "ear_right"))
    beside = (x > 0.05) & (ear < 0.5)
    jaw = beside & (z < -0.015) & (y > -0.085) & (y < -0.05) & (head.region("beard") > 0.5) & seen
    strip = beside & (z > -0.075) & (z < -0.04) & (y > -0.06) & (y < 0.025)
    reaches = int(jaw.sum()) >= FEWEST and float(shown[jaw].mean()) > REACHES
    return np.asarray(strip & reaches, np.float32)


def _below_chin(head: HeadModel, fit: Fit, reading: Reading) -> float:
    """How far below the chin beard is read, metres: the median of some columns, 0.2 at most."""
    chin = np.flatnonzero(head.region("chin") > 0.5)
    lowest = fit.vertices[chin[np.argmin(head.mean[chin, 1])]]
    reach = np.arange(0, 0.2, 0.002)
    columns = lowest + np.array([[x, 0, 0] for x in np.linspace(-0.015, 0.015, 7)])
    points = columns[:, None] + reach[:, None] * np.array([0, -1, 0.15])
    flat = fit.camera.project(points.reshape(-1, 3))
    shown = parts_at_pixels(reading, flat)[:, BEARD].reshape(len(columns), -1) > 0.4
    first = np.where(shown.all(1), len(reach) - 1, shown.argmin(1))
    return float(np.median(reach[first]))


def _over_skin(photo: Photo, parts: Float32, sight: Sight) -> tuple[Float32, Bool]:
    """(C, C) luminance of cells over that of the skin beside them, and whether there is any; 1 where there is none."""
    bright = luma(bytes_to_linear(sight.region.cut(photo.pixels, CELLS)))
    skin = np.asarray(parts[..., SKIN] > SURE, np.float32)
    summed = blurred(np.stack([skin * bright, skin], -1).astype(np.float32), BESIDE_CELLS)
    told = summed[..., 1] > 0.03
    beside = summed[..., 0] / np.maximum(summed[..., 1], 1e-6)
    return np.asarray(np.where(told, bright / np.maximum(beside, 1e-4), 1), np.float32), told


def _groom(seen: Seen, photo: Photo, fit: Fit, strands: int, seed: int) -> Groom:
    rng = np.random.default_rng([seed, 0xBEA])
    roots = seen.skin.roots(max(int(FULL_BEARD * seen.share * strands), 1), rng, least=EDGE)
    roots = roots.chosen(rng.random(len(roots)) < roots.edge**0.5)  # it thins out, and has no line
    short = float(np.clip(0.003 + 0.35 * seen.hangs_m, 0.003, 0.016))
    ahead = smoothstep(roots.position[:, 1], -0.075, -0.095) * smoothstep(roots.position[:, 2], -0.03, 0.0)
    length = short + ahead * max(seen.hangs_m - short, 0.0)
    length *= (0.5 + 0.5 * roots.edge) * np.exp(0.15 * np.clip(rng.normal(0, 1, len(roots)), -2, 2))
    points = _grown(roots, np.asarray(length, np.float32), seen.skin, rng)
    frizz = float(np.clip(60 * seen.hangs_m, 0.3, 2.0))
    usual = 1000 * short
    style = Style(NAME, usual, usual, usual, usual, frizz_mm=frizz, flyaways=0.03)
    points = wandering(style, points, rng)
    lock = np.zeros(len(points), np.int32)
    shown = seen_share(points, seen.sight)
    person = USUAL_SKIN if fit.cheek is None else np.asarray(srgb_to_linear(fit.cheek), np.float32)
    colour = painted(photo, seen.read, seen.sight, points, shown, person, seed)
    return Groom(style, points, roots.uv, lock, colour)


LIFT = 0.45
"""How far strands stand up from the skin where they begin."""


def _combed(roots: Roots) -> Float32:
    """(N, 3) unit directions in which strands lie on the skin."""
    x, y, z = roots.position.T
    under_nose = smoothstep(y, -0.068, -0.062) * smoothstep(np.abs(x), 0.034, 0.024) * smoothstep(z, 0.0, 0.015)
    below = smoothstep(y, -0.075, -0.1)
    inwards = -0.25 * below * np.clip(x / 0.05, -1, 1)
    down = np.stack([inwards, -np.ones_like(x), 0.25 + 0.3 * below], 1)
    aside = np.stack([np.clip(x / 0.006, -1, 1), np.full_like(x, -0.7), np.full_like(x, 0.1)], 1)
    wish = unit(down + under_nose[:, None] * (aside - down))
    return unit(wish - roots.normal * (wish * roots.normal).sum(1, keepdims=True))


def _grown(roots: Roots, length: Float32, skin: Scalp, rng: np.random.Generator) -> Float32:
    """(N, POINTS, 3) strands, which leave the skin and bend down by their weight the more the longer they are."""
    step = (length / (POINTS - 1))[:, None]
    stray = rng.normal(0, 0.22, (len(roots), 3))
    heading = unit(LIFT * roots.normal + _combed(roots) + stray)
    place, points = roots.position, [roots.position]
    for k in range(1, POINTS):
        gone = k * step
        heading = unit(heading + np.clip(gone / 0.05, 0, 1) * 0.5 * DOWN)
        rise = np.minimum(0.3 * gone[:, 0], 0.012) + 0.2 * CLEARANCE_M
        tried = skin.pushed((place + step * heading).astype(np.float32), rise.astype(np.float32), 0.004)
        heading = unit(tried - place)
        place = np.asarray(place + step * heading, np.float32)
        points.append(place)
    return np.stack(points, 1)


LEAST_M = 0.0004
"""Least movement of a vertex that is told: of thousands, all others would be most of the files."""
NEIGHBOURS = 3
"""Vertices of the head that a strand follows, by the inverse distance of its root."""


def beard_cards(
    beard: Beard | None, head: HeadModel, fit: Fit, quality: QualityName, seed: int
) -> tuple[MeshPart, ...]:
    """Meshes of a beard, which follow the face as the skin does from which their strands grow; none without one.

    Args:
        beard: on the fitted head at rest.
        head: topology and units.
        fit: vertices at rest and in the photo's expression.
        quality: says how many triangles and texels.
        seed: of all that is random.
    """
    if beard is None:
        return ()
    groom = beard.groom
    # Vertices beside those on which it grows may lie on the other lip.
    own = np.flatnonzero(head.region("beard") > 0.02)
    rest = np.asarray(fit.neutral, np.float32)[own]
    apart, near = Nearest(rest)(groom.strands[:, 0], NEIGHBOURS)
    share = 1 / np.maximum(apart, 1e-4)
    share /= share.sum(1, keepdims=True)
    points = groom.strands.shape[1]
    lines = Nearest(groom.strands.reshape(-1, 3))
    made = []
    most = BUDGETS[quality]
    budget = replace(most, triangles=int(most.triangles * beard.share))
    for part in hair_parts(groom, beard.skin, budget, seed, NAME):
        strand = lines.one(part.neutral)[1] // points
        follow, weight = own[near[strand]], share[strand]

        def moved(offsets: AnyFloat, follow: Int64 = follow, weight: Float32 = weight) -> Float32:
            return np.asarray(interpolate(np.asarray(offsets, np.float32), follow, weight), np.float32)

        vertices = part.neutral + moved(fit.vertices - fit.neutral)
        made.append(replace(part, vertices=vertices, targets=targets_of(head, moved, LEAST_M)))
    return tuple(made)
