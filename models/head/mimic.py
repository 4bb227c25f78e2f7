"""A blink, a smile and a pucker without the folds and the faintness of the base mesh: ``models.head.mimic FILE``.

- The blink unrolls the upper lid (``blink.py``).
- The smile of the base mesh moves the corner of the mouth by a centimetre and the cheek beside it hardly at all, so
  that the skin between folds over itself into a hook. Here the way is handed on over the cheek by a thin plate (the
  biharmonic equation on the mesh), between the lips, which move as they did, and the skin around.
- The pucker draws the corners of the mouth as far in as people do, and the lips forward.

The builder does it to every new head; ``python -m models.head.mimic FILE`` to a head file of before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array, csc_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from models.head.bases import Bases
from models.head.blink import unrolled
from models.head.digest import change_file
from models.head.lids import find_lids
from models.head.lips import Lips, find_lips
from models.head.quads import Quads
from models.head.regions import smooth
from models.head.settle import part_members
from service.errors import ModelFault
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

CHEEK_M = (0.008, 0.045)
"""Distance from the corner of the mouth up to which skin is free in a smile, and from which on it moves as it did."""
PLATE = 1.5
"""Weight of the plate's bending against a vertex that keeps its motion."""
HELD = 50.0
"""Weight of lips and lining, which keep theirs."""

NARROWER = 0.195
"""Share of the mouth's width that a pucker takes beyond the base mesh's: corners 52.7 mm apart end 38 mm apart."""
FORWARD_M = (0.0021, 0.0035)
"""How far lips go forward beyond it, in their middle and at the corners."""
ROUND_M = (0.015, 0.055)
"""Distance from the lips up to which skin goes wholly with them, and from which on it stays."""
GATHERED = 0.86
"""Share of the corners' neutral distance in a pucker of before: less means that the head is changed already."""


def laplacian(triangles: Int, count: int) -> csc_array:
    """(V, V) of a mesh: a vertex less the mean of its neighbours; 0 for vertices of other parts."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    pairs = np.unique(np.sort(pairs, 1), axis=0)
    rows, columns = np.r_[pairs[:, 0], pairs[:, 1]], np.r_[pairs[:, 1], pairs[:, 0]]
    near = coo_array((np.ones(len(rows)), (rows, columns)), shape=(count, count)).tocsc()
    degree = np.asarray(near.sum(1)).ravel()
    return csc_array(diags_array((degree > 0) * 1.0) - diags_array(1 / np.maximum(degree, 1)) @ near)


def smiling(mean: Float, unit: Float, side: float, lips: Lips, triangles: Int, regions: Mapping[str, Float]) -> Float:
    """(V, 3) offsets of ``mouthSmile`` that bend the cheek as little as they may.

    Args:
        mean: (V, 3) metres.
        unit: (V, 3).
        side: 1 for the left corner of the mouth, -1 for the right one.
        lips: rows round the mouth.
        triangles: (T, 3) of the skin.
        regions: (V,) masks by name, with "mouth_inner" and "nose".
    """
    row = mean[lips.contact]
    corner = row[np.argmax(side * row[:, 0])]
    keep = smooth(np.linalg.norm(mean - corner, axis=1), *CHEEK_M)
    keep[regions["nose"] > 0.3] = 1.0
    keep[regions["mouth_inner"] > 0.25] = HELD
    for rows in (lips.contact[:, None], lips.inner, lips.outer[:, :2]):
        keep[rows] = HELD
    bends = laplacian(triangles, len(mean))
    system = csc_array(diags_array(keep + 1e-9) + PLATE * (bends.T @ bends))
    skin, out = np.unique(triangles), unit.copy()
    out[skin] = splu(system).solve(keep[:, None] * unit)[skin]
    return lips.sealed(out)


def puckered(mean: Float, unit: Float, lips: Lips, skin: Int, nose: Float) -> Float:
    """(V, 3) offsets of ``mouthPucker`` that gather the lips.

    Args:
        mean: (V, 3) metres.
        unit: (V, 3).
        lips: rows round the mouth.
        skin: its vertices.
        nose: (V,) in [0, 1], what stays.

    Raises:
        ModelFault: the unit gathers them already.
    """
    at = mean + unit
    wide = np.ptp(at[lips.contact, 0])
    if wide < GATHERED * np.ptp(mean[lips.contact, 0]):
        raise ModelFault(f"mouthPucker leaves the mouth {1e3 * wide:.1f} mm wide: this head's lips gather already")
    half = 0.5 * wide
    share = (1 - smooth(cKDTree(at[lips.contact]).query(at)[0], *ROUND_M)) * (1 - nose)
    outwards = np.clip(at[:, 0] / half, -1.0, 1.0)
    out = unit.copy()
    out[skin, 0] -= (NARROWER * share * half * outwards)[skin]
    out[skin, 2] += (share * (FORWARD_M[0] + (FORWARD_M[1] - FORWARD_M[0]) * outwards**2))[skin]
    return lips.sealed(out)


def mended(bases: Bases, head: HeadModel) -> Bases:
    """The bases of a head of our topology with these units; ``head`` tells its polygons and regions.

    Raises:
        ModelFault: they are so already.
    """
    quads, names = head.polygons[head.polygon_part == 0].astype(np.int64), head.expression_names
    triangles = head.triangles[head.triangle_part == 0].astype(np.int64)
    members = part_members(head.polygons.astype(np.int64), head.polygon_part)
    regions = dict(zip(head.region_names, head.regions.astype(np.float64), strict=True))
    mean, expression = bases.mean, bases.expression.copy()
    lips, mesh = find_lips(mean, quads, regions), Quads(quads)
    pucker = names.index("mouthPucker")
    expression[pucker] = puckered(mean, expression[pucker], lips, np.unique(triangles), regions["nose"])
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        blink, smile = (names.index(stem + side) for stem in ("eyeBlink", "mouthSmile"))
        lids = find_lids(mean, quads, regions, side.lower())
        expression[blink] = unrolled(mean, expression[blink], lids, members[f"eye_{side.lower()}"], mesh)
        expression[smile] = smiling(mean, expression[smile], sign, lips, triangles, regions)
    return Bases(mean, bases.identity, expression)


def changed(head: HeadModel) -> HeadModel:
    """A head of our own topology with such units; all else stays to the bit."""
    expression = mended(Bases.of(head), head).expression
    return replace(head, expression=expression.astype(np.float16).astype(np.float32))


def main() -> None:
    """Command line."""
    change_file(__doc__, changed)


if __name__ == "__main__":
    main()
