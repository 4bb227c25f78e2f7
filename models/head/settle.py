"""Eyes, teeth and tongue of the base mesh, put to the size and place that a person's have.

MakeHuman's eyeballs measure 30 mm across and break through the lids; its teeth stand 5 mm behind the lips in an arch
72 mm wide, its tongue reaches above them, so that a smile shows the tongue. All that is done is linear in the vertices
and touches these parts only; it comes after the statistics and the chart, neither of which changes.

The builder does it to every new head. ``python -m models.head.settle FILE`` does it to a head file of before, because a
rebuild on another machine differs by rounding, which the chart's optimisation enlarges to some texels, and networks are
trained on one chart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from models.head.bases import Bases
from models.head.crop import EYE_PARTS, PART_NAMES
from models.head.digest import change_file
from models.head.eyes import RINGS_DEG, affine_weights, sphere
from service.errors import ModelFault
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

EYE_RADIUS_M = 0.012
"""Of an adult, nearly the same in all (Bekerman et al. 2014: 24.2 mm across)."""
SETTLED_RINGS_DEG = (4.5, 9.1, 13.5, 17.5, 21.5, 25.5, 29.2, 33.5, 40.0, 51.0, 66.0, 84.0, 105.0, 129.0, 155.0)
"""Polar angles of the rings after it: the iris gets seven of them and twice the area in the chart; ring 2 is the rim of
the pupil, ring 7 the limbus."""
LIMBUS_DEG = 29.2
"""An iris of 11.7 mm across."""


@dataclass(frozen=True)
class Move:
    """Scale about a height on the midline, then shift: (3,) factors, the height in metres, (3,) metres."""

    scale: tuple[float, float, float]
    height: float
    shift: tuple[float, float, float]

    def __call__(self, points: Float) -> Float:
        """(N, 3) moved."""
        base = np.array([0.0, self.height, 0.0])
        return np.asarray((points - base) * self.scale + base + self.shift)


MOVES = {
    "teeth_upper": Move((0.86, 1.0, 1.0), 0.0, (0.0, -0.0032, 0.0030)),
    "teeth_lower": Move((0.84, 1.0, 1.0), 0.0, (0.0, -0.0006, 0.0010)),
    "tongue": Move((0.88, 0.8, 1.0), -0.084, (0.0, -0.0025, -0.0020)),
}
"""The edge of the upper teeth ends 2.5 mm below the upper lip at rest, the lower ones bite 2 mm above it and behind,
and the tongue lies below both."""
OUT = (-0.025, 0.005)
"""Depth (z, metres) from which the tongue begins to rise again when it is put out, and from which on it does wholly: it
has to pass over the lower teeth, as before."""


def settle(
    bases: Bases, members: dict[str, Int], regions: dict[str, Float], expression_names: tuple[str, ...]
) -> Bases:
    """The bases with eyes, teeth and tongue in their places; all other vertices keep theirs to the bit.

    Args:
        bases: as they come out of the statistics.
        members: vertices of each part by name.
        regions: (V,) masks by name, with "mouth_inner" and "lip_upper".
        expression_names: of the units, E of them, with "jawOpen" and "tongueOut".
    """
    mean, identity, expression = bases.mean.copy(), bases.identity.copy(), bases.expression.copy()
    for name in EYE_PARTS:
        ball = members[name]
        weights = eye_weights(mean[ball])
        for field in (mean[None], identity, expression):
            field[:, ball] = np.einsum("ij,kjc->kic", weights, field[:, ball])
    drop = -bases.expression[expression_names.index("jawOpen")][:, 1]
    lip, lining = upper_lip(bases.mean, regions, drop, members["teeth_upper"])
    wanted = 0.5 * (identity[:, lip].mean(1) + identity[:, lining].mean(1))
    follow = (wanted - identity[:, members["teeth_upper"]].mean(1)) * [0.0, 1.0, 1.0]
    put_out = expression[expression_names.index("tongueOut")]
    for name, move in MOVES.items():
        own = members[name]
        mean[own] = move(bases.mean[own])
        identity[:, own] += follow[:, None]
        if name == "tongue":
            share = np.clip((bases.mean[own, 2] - OUT[0]) / (OUT[1] - OUT[0]), 0.0, 1.0)
            put_out[own] += share[:, None] * (bases.mean[own] - mean[own]) * [0.0, 1.0, 1.0]
    return Bases(mean, identity, expression)


def part_members(polygons: Int, part: npt.NDArray[np.integer]) -> dict[str, Int]:
    """Vertices of each part, ascending."""
    corners = [polygons[part == number] for number in range(len(PART_NAMES))]
    return {name: np.unique(table[table >= 0]) for name, table in zip(PART_NAMES, corners, strict=True)}


def eye_weights(ball: Float) -> Float:
    """(N, N) weights that turn an eyeball with the old rings into one of ``EYE_RADIUS_M`` with the new ones.

    They reproduce affine maps, so the new ball turns and grows with the old one.

    Args:
        ball: (N, 3) metres, the mean eyeball in the order of :func:`models.head.eyes.sphere`.

    Raises:
        ModelFault: the ball has the new size already, so its rings are the new ones.
    """
    old, _ = sphere(RINGS_DEG)
    new, _ = sphere(SETTLED_RINGS_DEG)
    radius = float(np.linalg.norm(ball - affine_weights(old, np.zeros((1, 3))) @ ball, axis=1).mean())
    if radius < 1.1 * EYE_RADIUS_M:
        raise ModelFault(f"the eyeballs have a radius of {1e3 * radius:.1f} mm: this head is settled already")
    return affine_weights(old, EYE_RADIUS_M / radius * new)


def upper_lip(mean: Float, regions: dict[str, Float], jaw_drop: Float, upper_teeth: Int) -> tuple[Mask, Mask]:
    """(V,) vertices of the upper lip, and of its inside before the teeth, both near the midline.

    The teeth follow them from head to head; MakeHuman's sliders would move lips and teeth apart.
    """
    still = (jaw_drop < 0.25 * jaw_drop.max()) & (np.abs(mean[:, 0]) < 0.012)
    before = mean[:, 2] > mean[upper_teeth, 2].max()
    return np.asarray(still & (regions["lip_upper"] > 0.5)), np.asarray(still & before & (regions["mouth_inner"] > 0.5))


def settled(head: HeadModel) -> HeadModel:
    """A head of our own topology with its parts settled; its skin, chart, landmarks and regions stay.

    Raises:
        ModelFault: it is settled already.
    """
    members = part_members(head.polygons.astype(np.int64), head.polygon_part)
    old = Bases.of(head)
    regions = dict(zip(head.region_names, head.regions.astype(np.float64), strict=True))
    new = settle(old, members, regions, head.expression_names)
    mean, *halves = (np.asarray(basis, np.float32) for basis in (new.mean, new.identity, new.expression))
    identity, expression = (half.astype(np.float16).astype(np.float32) for half in halves)
    return replace(head, mean=mean, identity=identity, expression=expression)


def main() -> None:
    """Command line."""
    change_file(__doc__, settled)


if __name__ == "__main__":
    main()
