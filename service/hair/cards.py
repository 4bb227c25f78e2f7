"""Hair cards: ribbons along the locks of a groom, with textures drawn from its own strands.

::

    Groom --k-means by whole polyline--> bundles --middle line, spread, outwards--> ribbons
    Groom --strands by the hairline--> single hairs        scalp with roots on it --> cap
    ribbons, hairs, cap --what their strands look like--> atlas --> three meshes

One mesh is cut out by alpha (``hair``): ribbons, and beneath them fewer and denser ones that close slits. Two are
blended, so that the hairline is soft: single hairs (``hair_edge``), and the shade of roots on the scalp (``hair_cap``).
What a ribbon cannot follow, waves and coils above all, its texture shows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64, Int32, Int64
from service.geometry.mesh import face_normals, unit
from service.geometry.nearest import Nearest
from service.hair.atlas import BODY, CAP_CELL, DENSE, SAMPLES, SINGLE, STRIPS, Atlas, Strokes, cell_corners, draw_atlas
from service.hair.groom import Groom
from service.hair.scalp import CELL_M, LOW, Field, Scalp, length_of
from service.hair.style import WAVES
from service.levels import QualityName
from service.materials.material import Material, OwnMap
from service.materials.part import MeshPart

HAIR, CAP = "hair", "hair_cap"
PARTS = (HAIR, "hair_edge", CAP)
"""Names of the meshes of a head of hair, in their order."""


@dataclass(frozen=True)
class Budget:
    """What hair may cost: triangles of all meshes, and texels of the atlas's side."""

    triangles: int
    atlas: int


BUDGETS: Mapping[QualityName, Budget] = {
    "draft": Budget(20_000, 1024), "standard": Budget(60_000, 2048), "high": Budget(120_000, 2048),
    "reference": Budget(120_000, 4096),
}  # fmt: skip
SHARES = {"body": 0.72, "inner": 0.14, "single": 0.14}
"""Of the triangles that the cap leaves: ribbons, what closes slits below them, single hairs."""
ROW_M = 0.028
"""Length of a ribbon's quads."""
FIRST_ROW_M, MOST_UNEVEN = 0.02, 1.6
"""Length of the first quad, and the power by which rows lie closer at the root, at most."""
ROWS = (3, 14)
"""Fewest and most quads of a ribbon."""
FLAT, TIGHT_MM, ROWS_A_TURN, MOST_WOUND = 0.7, 12.0, 4, 24
"""Flatness of a wave from which on it is in the texture of ribbons alone, and pitch of coils up to which they are: few
ribbons of whole locks would make spikes of an afro; quads along one turn of other curls, and most of a ribbon that
winds."""
WHOLE = 3.0
"""How much more bundles of curls differ by their locks than by their place in these."""
TINTS = 8
"""Places along a strand at which it has its colours."""
SPREAD = 2.1
"""Half a ribbon's width over the standard deviation of its strands' offsets: 1.73 would be the width of evenly spread
strands; the rest is overlap with the neighbours."""
PRIOR = 2.0
"""Strands that the usual spread counts for: most bundles have only a few."""
NARROWEST_M, WIDEST_M = 0.0008, 0.011
"""Half widths."""
SLENDER = 0.045
"""Half width over length up to which a ribbon is taken for a lock and not for a shard."""
LONGER = 0.05
"""Share of its length by which a ribbon reaches beyond its mean tip, for the strands that are longer."""
BEFORE_M = 0.002
"""How far before its first roots a ribbon begins within the scalp, so that those that part overlap."""
OFF_M = 0.0025
"""Least distance of a ribbon from the skin beyond its roots: its quads are straight where the head is round."""
ROLL = 0.1
"""How much ribbons of one place are turned against each other: enough to break up a sheet."""
INNER_M, INNER_WIDER = 0.0018, 2.2
"""Distance of the inner ribbons below those that they back, and how much wider they are than the locks in them."""
EDGE_SHARE = 0.42
"""Distance to the middle of a root's nearest roots, over their mean distance, from which on it is on the hairline."""
COPIES = 3
"""Single hairs for each strand on the hairline."""
HAIR_M = 0.0007
"""Half width of the ribbon of a single hair; its texture shows one to three."""
ROOTS_ROUND, THIN_M = 16, 0.012
"""Roots whose mean distance tells how densely hair grows at a place, and the distance from which on it is bare."""
FULL = (1.35, 2.2)
"""That distance, over the usual one, up to which roots cover the scalp, and from which on they do not."""
CAP_M = 0.0007
"""Height of the cap over the scalp."""
CUTOFF = 0.35
"""Alpha below which a texel of hair is cut off: under one half, as mip levels thin out cards."""
RAGGED_M, RAGGED = 0.03, (0.12, 0.5)
"""Length over which a ribbon's strands end, and the least and largest share of the ribbon that this may be."""
BEGINS, SOFT_M = 0.06, 0.01
"""Most of a ribbon over which its strands begin behind the hairline, and the length over which they do."""
HAIRLINE = 44
"""Cell from which on cells of ribbons show those of the hairline."""
IOR = 1.55
"""Of human hair (Marschner et al. 2003, table 1)."""
SPECULAR = 0.5
"""Share of what a strand mirrors that leaves a body of hair: its neighbours hide the rest."""
ROUGHNESS = 0.45
ANISOTROPY = 0.75
"""Strength as in glTF: how much wider a highlight is across strands than along them."""


def hair_parts(groom: Groom, scalp: Scalp, budget: Budget, seed: int = 0, name: str = HAIR) -> tuple[MeshPart, ...]:
    """The meshes of a head of hair, or of a beard, which stand still.

    Args:
        groom: strands on the head at rest.
        scalp: of that head.
        budget: triangles and texels; the triangles are not exceeded.
        seed: of ribbons' turns and of what the atlas shows.
        name: of the first mesh, with which the names of the others begin.

    Returns:
        As ``PARTS`` names them; a beard has no cap, as the skin shows its roots. Nothing where no strand grows. Faces
        are in order from the skin outwards.
    """
    if not len(groom):
        return ()
    rng = np.random.default_rng([seed, 0xCA4D])
    body = body_of(groom.strands, scalp)
    colours = groom.colour.linear(TINTS)
    edge = on_hairline(groom.strands[:, 0])
    cap = _cap(groom, scalp) if name == HAIR else None
    left = max(budget.triangles - (0 if cap is None else len(cap[3])), 0)
    wanted = {kind: int(share * left) for kind, share in SHARES.items()}
    length = float(np.median(length_of(groom.strands)))
    wave = WAVES[groom.style.curl]
    turns = 1000 * length / wave.pitch_mm if wave.flat < FLAT and wave.pitch_mm > TIGHT_MM else 0.0
    rows = _rows(length, len(groom), wanted["body"], turns)
    inner_rows = max(ROWS[0], rows // 2)
    at, inner_at, hair_at = (places(length, count) for count in (rows, inner_rows, min(rows, 6)))
    lock = groom.lock.astype(np.int64) if turns else None
    ribbons = Ribbons.along(groom.strands, at, wanted["body"] // (2 * rows), body, scalp, rng, lock)
    inner = Ribbons.along(groom.strands, inner_at, wanted["inner"] // (2 * inner_rows), body, scalp, rng)
    inner = inner.backing(body, scalp, inner.holding(edge))
    hairs = _single_hairs(groom, edge, hair_at, wanted["single"], body, rng)
    front = ribbons.holding(edge)
    strokes, *of = _drawn(groom, colours, ribbons, front, inner, hairs, rng)
    atlas = draw_atlas(strokes, budget.atlas, colours[:, 0].mean(0), rng)
    return _parts(name, ribbons, inner, hairs, cap, of, atlas, body)


def _rows(length: float, strands: int, triangles: int, turns: float) -> int:
    """Quads of a ribbon: by its length, and more where the strands are too few for as many ribbons as may be drawn, or
    wind so many ``turns``.
    """
    few, most = ROWS
    even = np.clip(np.ceil(max(length / ROW_M, triangles / strands)), few, most)
    return int(max(even, min(np.ceil(ROWS_A_TURN * turns), MOST_WOUND)))


def body_of(strands: Float32, scalp: Scalp) -> Field:
    """Blurred share of cells on the scalp's grid that hair (N, P, 3) or the head fills: downhill is out of the hair."""
    distance = scalp.distance.values
    shape = distance.shape
    cell = np.rint((strands.reshape(-1, 3) - np.array(LOW, np.float32)) / np.float32(CELL_M)).astype(np.int64)
    cell = np.clip(cell, 0, np.array(shape) - 1)
    count = np.bincount(np.ravel_multi_index(tuple(cell.T), shape), minlength=int(np.prod(shape))).reshape(shape)
    usual = max(float(np.median(count[count > 0])), 1.0)
    solid = np.where(distance < 0, 1.0, 1 - np.exp(-count / usual))
    for _ in shape:  # along the first axis, which then becomes the last
        flat = solid.reshape(len(solid), -1).astype(np.float32)
        soft = cv2.GaussianBlur(flat, (1, 17), 0, sigmaY=2.0, borderType=cv2.BORDER_REPLICATE)
        solid = np.moveaxis(soft.reshape(solid.shape), 0, -1)
    return Field(np.ascontiguousarray(solid))


@dataclass(frozen=True)
class Ribbons:
    """Ribbons, K of them with S quads each.

    Attributes:
        line: (K, S + 1, 3) float32 metres, their middle lines from root to tip.
        across: (K, S + 1, 3) float32 unit, from one side to the other.
        half: (K, S + 1) float32 metres, half their widths.
        label: (N,) int64, the ribbon of each strand.
        at: (S + 1,) where rows lie along a ribbon, 0 its root and 1 its tip.
    """

    line: Float32
    across: Float32
    half: Float32
    label: Int64
    at: Float64

    @classmethod
    def along(
        cls, strands: Float32, at: Float64, count: int, body: Field, scalp: Scalp, rng: np.random.Generator,
        lock: Int64 | None = None,
    ) -> Ribbons:  # fmt: skip
        """At most ``count`` ribbons with rows ``at`` (S + 1,) along the bundles of strands (N, P, 3).

        Where strands wind, ``lock`` (N,) says which wind alike: others' turns would cancel out.
        """
        coarse = _sampled(strands, np.linspace(0, 1, 8))
        # Where they begin and end tells bundles apart more than where they run.
        weight = np.array([1.4, 1, 1, 1, 1, 1, 1, 1.2], np.float32)[:, None]
        described = (coarse * weight).reshape(len(strands), -1)
        if lock is not None:
            of_lock = _means(lock, described, int(lock.max()) + 1)[lock]
            described = np.concatenate([WHOLE * of_lock, described - of_lock], 1)
        label = kmeans(described, min(count, max(len(strands) // 2, 1)), 4, rng)
        number = np.bincount(label).astype(np.float32)
        own = _sampled(strands, at)
        line = _means(label, own, len(number))
        step = line[:, -1] - line[:, -2]
        line[:, -1] += step * np.float32(LONGER / (1 - at[-2]))
        # Half of a bundle's roots lie before their middle: without this, bare scalp shows along partings and whorls.
        first = unit(line[:, 1] - line[:, 0])
        before = ((own[:, 0] - line[label, 0]) * first[label]).sum(1, keepdims=True)
        reach = np.sqrt(3 * _means(label, before**2, len(number)))
        line[:, 0] -= first * (reach + BEFORE_M * ~on_hairline(line[:, 0])[:, None])
        line[:, 1:] = scalp.over_ears.pushed(line[:, 1:], OFF_M, 2 * OFF_M)
        line[:, 0] -= (scalp.outside(line[:, 0]) - 2 * CAP_M)[:, None] * scalp.outwards(line[:, 0])
        across = facing(line, unit(-body.slope(line)), rng)
        offset = ((own - line[label]) * across[label]).sum(2)
        squares = _means(label, offset[..., None] ** 2, len(number))[..., 0]
        usual = np.average(squares, axis=0, weights=number)
        spread = np.sqrt((number[:, None] * squares + PRIOR * usual) / (number[:, None] + PRIOR))
        slender = SLENDER * length_of(line)[:, None] + NARROWEST_M
        half = np.clip(SPREAD * spread, NARROWEST_M, np.minimum(WIDEST_M, slender))
        half = np.maximum(half, 0.6 * half.max(1, keepdims=True))
        return cls(line, across, half.astype(np.float32), label, at)

    def holding(self, chosen: Bool) -> Bool:
        """(K,) whether any of the chosen strands (N,) is among a ribbon's."""
        return np.asarray(np.bincount(self.label, chosen, len(self.line)) > 0)

    def backing(self, body: Field, scalp: Scalp, front: Bool) -> Ribbons:
        """These ribbons as an inner layer: wider, a little deeper, but out of the head, and behind the hairline: those
        that begin there are ``front`` (K,).
        """
        before = np.minimum(0.5 * SOFT_M / np.maximum(self.length, 1e-6), 0.5) * front
        rows = self.line.shape[1] - 1
        at = self.row(before[:, None] + (1 - before)[:, None] * self.at)
        low, own = np.minimum(at.astype(int), rows - 1), np.arange(len(at))[:, None]
        part = (at - low)[..., None].astype(np.float32)
        line = self.line[own, low] * (1 - part) + self.line[own, low + 1] * part
        line = line - np.float32(INNER_M) * unit(-body.slope(line))
        line[:, 1:] = scalp.pushed(line[:, 1:], 0.0009, 2 * INNER_M)
        return Ribbons(line, self.across, np.minimum(INNER_WIDER * self.half, WIDEST_M), self.label, self.at)

    def row(self, along: Float64) -> Float64:
        """Places along ribbons, in [0, 1], as rows."""
        return np.interp(along, self.at, np.arange(len(self.at)))

    def offsets(self, strands: Float32) -> Float32:
        """(N, SAMPLES) sideways place of strands (N, P, 3) on their ribbons, in half widths."""
        at = self.row(np.linspace(0, 1, SAMPLES))
        own = _between(strands, np.linspace(0, strands.shape[1] - 1, SAMPLES))
        line, across = _between(self.line, at), unit(_between(self.across, at))
        half = _between(self.half[..., None], at)[..., 0]
        apart = ((own - line[self.label]) * across[self.label]).sum(2)
        return np.asarray(apart / half[self.label], np.float32)

    def ends(self, strands: Float32) -> Float32:
        """(N,) where strands end along their ribbon, 1 at its end."""
        last = self.line[:, -1] - self.line[:, -2]
        back = ((strands[:, -1] - self.line[self.label, -1]) * unit(last)[self.label]).sum(1)
        back /= self.length[self.label]
        return np.asarray(np.clip(1 + back, 0.55, 1.0), np.float32)

    @property
    def length(self) -> Float32:
        """(K,) metres."""
        return length_of(self.line)


def facing(line: Float32, outwards: Float32, rng: np.random.Generator) -> Float32:
    """(K, S + 1, 3) unit vectors across lines (K, S + 1, 3), so that ribbons face outwards, each a little rolled.

    Where a line runs straight outwards, as on an afro, its roll alone says which way it faces.
    """
    along = unit(np.gradient(line, axis=1))
    flat = np.cross(along, outwards)
    chance = rng.normal(0, 1, (len(line), 1, 3)).astype(np.float32)
    chance = unit(np.where((chance * outwards.mean(1, keepdims=True)).sum(2, keepdims=True) < 0, -chance, chance))
    across = flat + ROLL * np.cross(along, chance)
    for _ in range(2):  # ribbons do not turn within a quad
        across[:, 1:-1] = 0.25 * across[:, :-2] + 0.5 * across[:, 1:-1] + 0.25 * across[:, 2:]
    across -= along * (across * along).sum(2, keepdims=True)
    return unit(across)


def on_hairline(roots: Float32) -> Bool:
    """(N,) whether roots (N, 3) lie on the border of those: their neighbours are all on one side."""
    apart, near = Nearest(roots)(roots, 24)
    offset = np.linalg.norm(roots[near].mean(1) - roots, axis=1)
    return np.asarray(offset > EDGE_SHARE * np.maximum(apart.mean(1), 1e-6))


def kmeans(rows: Float32, count: int, rounds: int, rng: np.random.Generator) -> Int64:
    """(N,) cluster of each of rows (N, D), at most ``count``, none of them empty (Lloyd 1982)."""
    centre = rows[np.sort(rng.choice(len(rows), min(count, len(rows)), replace=False))]
    for _ in range(rounds):
        label = _nearest(rows, centre)
        number = np.bincount(label, minlength=len(centre))
        sums = _means(label, rows, len(centre))
        centre = np.where(number[:, None] > 0, sums, centre)
    return np.asarray(np.unique(_nearest(rows, centre), return_inverse=True)[1], np.int64)


def _nearest(rows: Float32, centre: Float32) -> Int64:
    size, twice = np.square(centre).sum(1), 2 * centre.T
    # So few rows at a time that their products stay in the processor's cache.
    products = (rows[first : first + 256] @ twice for first in range(0, len(rows), 256))
    return np.concatenate([np.subtract(size, product, out=product).argmin(1) for product in products])


def _means(label: Int64, values: Float32, count: int) -> Float32:
    """(count, ...) mean of values (N, ...) by label; 0 where there is none."""
    from scipy.sparse import csr_matrix

    flat = values.reshape(len(values), -1)
    sums = csr_matrix((np.ones(len(label), np.float32), (label, np.arange(len(label)))), (count, len(label))) @ flat
    number = np.maximum(np.bincount(label, minlength=count), 1)
    return np.asarray(sums / number[:, None], np.float32).reshape(count, *values.shape[1:])


def places(length: float, rows: int) -> Float64:
    """(rows + 1,) where rows of ribbons of a length in metres lie, in [0, 1]: closer where they leave the skin.

    There long ribbons lie on a round head, and a quad's middle would lie within it.
    """
    power = np.log(FIRST_ROW_M / max(length, FIRST_ROW_M)) / np.log(1 / max(rows, 2))
    return np.asarray(np.linspace(0, 1, rows + 1) ** np.clip(power, 1.0, MOST_UNEVEN))


def _sampled(lines: Float32, along: Float64) -> Float32:
    """(N, R, 3) rows of lines (N, P, 3) at places (R,) in [0, 1]: means over as much as a row stands for."""
    from scipy.sparse import csr_matrix

    points = lines.shape[1]
    at = ((points - 1) * along)[:, None]
    # The window gets narrower towards root and tip, where the line has to be met.
    wide = np.minimum(np.maximum(np.gradient(at[:, 0])[:, None], 1.0), np.minimum(at, points - 1 - at) + 1.0)
    weight = np.maximum(1 - np.abs(np.arange(points)[None] - at) / wide, 0)
    weight /= weight.sum(1, keepdims=True)
    # Most weights are 0.
    made = csr_matrix(weight.astype(np.float32)) @ np.moveaxis(lines, 1, 0).reshape(points, -1)
    return np.ascontiguousarray(np.moveaxis(made.reshape(len(along), -1, 3), 1, 0))


def _between(lines: Float32, at: AnyFloat) -> Float32:
    """Lines (N, P, C) at places along them, in points."""
    low = np.minimum(at.astype(int), max(lines.shape[1] - 2, 0))
    part = (at - low).astype(np.float32)[None, :, None]
    return np.asarray(lines[:, low] * (1 - part) + lines[:, np.minimum(low + 1, lines.shape[1] - 1)] * part, np.float32)


def _single_hairs(groom: Groom, edge: Bool, at: Float64, budget: int, body: Field, rng: np.random.Generator) -> Ribbons:
    """Narrow ribbons along strands: those of the hairline several times, and some of what is seen of the rest."""
    most = max(budget // (2 * (len(at) - 1)), 1)
    own = np.flatnonzero(edge)
    chosen = np.repeat(own, COPIES)
    chosen = chosen if len(chosen) <= 0.7 * most else rng.choice(chosen, int(0.7 * most), replace=False)
    rest = rng.choice(len(groom), min(most - len(chosen), len(groom)), replace=False)
    chosen = np.concatenate([chosen, rest])
    line = _sampled(groom.strands[chosen], at)
    shift = rng.normal(0, 0.0009, (len(chosen), 1, 3)).astype(np.float32)
    out = unit(-body.slope(line[:, 0]))[:, None]
    shift -= out * (shift * out).sum(2, keepdims=True)
    line = line + shift * (1 + 0.8 * at).astype(np.float32)[None, :, None]
    across = facing(line, unit(-body.slope(line)), rng)
    half = np.full(line.shape[:2], HAIR_M, np.float32)
    return Ribbons(np.asarray(line, np.float32), across, half, chosen.astype(np.int64), at)


def _drawn(
    groom: Groom, colours: Float32, ribbons: Ribbons, front: Bool, inner: Ribbons, hairs: Ribbons,
    rng: np.random.Generator,
) -> tuple[Strokes, Int64, Int64, Int64]:  # fmt: skip
    """What the atlas shows, and the cell of each ribbon, inner ribbon and single hair.

    Ribbons whose strands are alike in place, width and colour share a cell; it is drawn from the strands of the ribbon
    in the middle of them, and of those nearest to it. Those of the hairline, ``front`` (K,), have cells of their own,
    in which hairs begin one behind the other.
    """
    offset, ends = ribbons.offsets(groom.strands), ribbons.ends(groom.strands)
    count = len(ribbons.line)
    way = _means(ribbons.label, offset, count)
    spread = np.sqrt(_means(ribbons.label, (offset - way[ribbons.label]) ** 2, count))
    tints = np.sqrt(colours[:, ::2]).reshape(len(colours), -1)
    tint = _means(ribbons.label, tints, count)
    wide = np.log(ribbons.half.mean(1) / ribbons.half.mean())[:, None]
    even = _means(ribbons.label, ends[:, None], count)
    wavy, tight = way.std(1, keepdims=True), spread.mean(1, keepdims=True)
    described = np.concatenate([2 * wavy, tight, 5.0 * tint, 0.5 * wide, 3.0 * even], 1).astype(np.float32)
    of_ribbon = np.zeros(count, np.int64)
    for some, first, last in ((~front, 0, HAIRLINE), (front, HAIRLINE, BODY)):
        if some.any():
            of_ribbon[some] = first + kmeans(described[some], last - first, 6, rng)
    made: list[Strokes] = []
    for cell in np.unique(of_ribbon):
        own = np.flatnonzero(of_ribbon == cell)
        apart = np.square(described[own] - described[own].mean(0)).sum(1)
        near = own[np.argsort(apart, kind="stable")[:10]]
        strands = _alike(groom, ribbons.label, near)
        size = float(2 * ribbons.half[near].mean()), float(ribbons.length[near].mean())
        shown = offset[strands], ends[strands], colours[strands]
        begins = min(SOFT_M / max(size[1], 1e-6), 0.5 if cell >= HAIRLINE else BEGINS)
        made.append(Strokes.filling(cell, *shown, size, 1.0, (begins, _ragged(size[1])), rng))
    # The inner ribbons and the single hairs differ in colour alone.
    places = _means(inner.label, tints, len(inner.line))
    of_inner = BODY + kmeans(places, DENSE, 5, rng)
    for cell in np.unique(of_inner):
        strands = np.flatnonzero(np.isin(inner.label, np.flatnonzero(of_inner == cell)))
        strands = rng.choice(strands, min(len(strands), 200), replace=False)
        size = float(2 * inner.half.mean()), float(inner.length.mean())
        shown = offset[strands], ends[strands], colours[strands]
        made.append(Strokes.filling(cell, *shown, size, 2.6, (0.01, _ragged(size[1])), rng))
    of_hair = SINGLE + kmeans(tints[hairs.label], 2 * STRIPS, 5, rng)
    for cell in np.unique(of_hair):
        strands = hairs.label[of_hair == cell]
        made.append(Strokes.single(cell, colours[rng.choice(strands, 3)], rng))
    return Strokes.joined(made), of_ribbon, of_inner, of_hair


def _ragged(length: float) -> float:
    """Share of a ribbon of a length in metres over which its strands end."""
    return float(np.clip(RAGGED_M / max(length, 1e-6), *RAGGED))


def _alike(groom: Groom, label: Int64, near: Int64) -> Int64:
    """Strands of the ribbons ``near``; of curls those of the first one's lock alone, which share their phase."""
    if WAVES[groom.style.curl].radius_mm == 0:
        return np.flatnonzero(np.isin(label, near))
    for ribbon in near:
        lock = np.bincount(groom.lock[label == ribbon]).argmax()
        own = np.flatnonzero(groom.lock == lock)
        if len(own) >= 4:
            return own
    return np.flatnonzero(label == near[0])


def _cap(groom: Groom, scalp: Scalp) -> tuple[Float32, Float32, Float32, Int32]:
    """Vertices (V, 3), unit normals (V, 3), share of roots (V,) and triangles (T, 3) over the scalp with hair."""
    corners = scalp.corners.reshape(-1, 3)
    _, first, same = np.unique(np.round(corners, 6), axis=0, return_index=True, return_inverse=True)
    points, normals = corners[first], scalp.normals.reshape(-1, 3)[first]
    # Strands that fill the hairline share their roots: they make no denser hair than there is elsewhere.
    roots = np.unique(np.round(groom.strands[:, 0], 4), axis=0)
    mean = Nearest(roots)(points, ROOTS_ROUND)[0].mean(1)
    usual = float(np.quantile(mean[mean < THIN_M], 0.7)) if (mean < THIN_M).any() else THIN_M
    thick, thin = FULL
    cover = np.clip((thin - mean / max(usual, 1e-4)) / (thin - thick), 0, 1)
    faces = same.reshape(-1, 3).astype(np.int32)
    faces = faces[(cover[faces] > 0.02).any(1)]
    return (points + np.float32(CAP_M) * normals).astype(np.float32), normals, cover.astype(np.float32), faces


def _parts(
    name: str, ribbons: Ribbons, inner: Ribbons, hairs: Ribbons, cap: tuple[Float32, Float32, Float32, Int32] | None,
    cells: Sequence[Int64], atlas: Atlas, body: Field,
) -> tuple[MeshPart, ...]:  # fmt: skip
    hair = Material(
        name, colour_map=OwnMap(name, atlas.colour), normal_map=OwnMap(f"{name}_normal", atlas.normal),
        anisotropy_map=OwnMap(f"{name}_direction", atlas.direction),
        strand_map=OwnMap(f"{name}_strands", atlas.strands),
        alpha="mask", cutoff=CUTOFF, double_sided=True, roughness=ROUGHNESS, ior=IOR, specular=SPECULAR,
        anisotropy=ANISOTROPY,
    )  # fmt: skip
    of_ribbon, of_inner, of_hair = cells
    body_mesh = _joined([_mesh(inner, of_inner, body), _mesh(ribbons, of_ribbon, body)])
    edge = replace(hair, name=f"{name}_edge", alpha="blend")
    made = [_part(name, body_mesh, hair), _part(edge.name, _mesh(hairs, of_hair, body), edge)]
    if cap is not None and len(cap[3]):
        skin, upright, cover, triangles = cap
        low, high = cell_corners(np.array(CAP_CELL))
        turn = np.arctan2(skin[:, 0], skin[:, 2] + 0.07)
        place = np.stack([low[0] + (high[0] - low[0]) * np.abs(turn) / np.pi, low[1] + (high[1] - low[1]) * cover], 1)
        # Skin with roots in it does not shine.
        dull = replace(edge, name=CAP, specular=0.0)
        made.append(_part(CAP, (skin, upright, place.astype(np.float32), triangles), dull))
    return tuple(made)


def _part(name: str, mesh: Mesh, material: Material) -> MeshPart:
    points, normals, uv, faces = mesh
    return MeshPart(name, points, points, faces, uv, material, normals=normals)


Mesh = tuple[Float32, Float32, Float32, Int32]
"""Vertices, normals, texture coordinates and triangles."""


def _mesh(ribbons: Ribbons, cell: Int64, body: Field) -> Mesh:
    """Ribbons as triangles, from the skin outwards; root at the low end of a cell."""
    count, rows = ribbons.line.shape[0], ribbons.line.shape[1]
    side = ribbons.half[..., None] * ribbons.across
    points = np.stack([ribbons.line - side, ribbons.line + side], 2)
    low, high = cell_corners(cell)
    along = ribbons.at.astype(np.float32)
    u = np.stack([low[:, 0], high[:, 0]], 1)[:, None].repeat(rows, 1)
    v = (low[:, 1:] + (high - low)[:, 1:] * along)[..., None].repeat(2, 2)
    quad = (2 * np.arange(rows - 1)[:, None, None] + np.array([[0, 1, 3], [0, 3, 2]])).reshape(-1, 3)
    order = np.argsort(body.read(ribbons.line[:, rows // 2]), kind="stable")[::-1]
    faces = (2 * rows * order.astype(np.int32)[:, None, None] + quad[None]).reshape(-1, 3)
    normals = np.repeat(_lit(ribbons, body)[:, :, None], 2, 2)
    # A little of the ribbon's own roundness, so that bundles are told apart.
    normals = unit(normals + np.stack([-0.16 * ribbons.across, 0.16 * ribbons.across], 2))
    uv = np.stack([u, v], 3).reshape(count * rows * 2, 2).astype(np.float32)
    points, normals = points.reshape(-1, 3).astype(np.float32), normals.reshape(-1, 3).astype(np.float32)
    # Path tracers turn round a normal that is on the other side of a face than its front; the face gets black.
    turned = (face_normals(points, faces) * normals[faces].sum(1)).sum(1) < 0
    faces = np.where(turned[:, None], faces[:, ::-1], faces)
    return points, normals, uv, np.ascontiguousarray(faces, np.int32)


def _lit(ribbons: Ribbons, body: Field) -> Float32:
    """(K, S + 1, 3) unit normals of the body of hair, upright on the strands."""
    along = unit(np.gradient(ribbons.line, axis=1))
    out = unit(-body.slope(ribbons.line))
    upright = unit(np.cross(ribbons.across, along))
    # On ribbons that stand out of the body, like those of an afro, the body's normal is along the strand.
    return unit(out - 0.5 * along * (out * along).sum(2, keepdims=True) + 0.15 * upright)


def _joined(meshes: list[Mesh]) -> Mesh:
    before = np.cumsum([0, *(len(mesh[0]) for mesh in meshes)])
    points, normals, uv = (np.concatenate([mesh[k] for mesh in meshes]) for k in range(3))
    faces = np.concatenate([mesh[3] + np.int32(start) for mesh, start in zip(meshes, before, strict=False)])
    return points, normals, uv, faces
