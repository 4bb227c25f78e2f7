"""Lips that touch: the neutral mouth closes along one curve, in every identity.

The lips of the base mesh end in two edges that nearly meet, so a neutral face shows a straight slit. One closed row of
vertices round the opening (the contact row) is put onto a common curve, the seam: the vertices of the upper lip lie on
the polyline of the lower lip's. The seam is a linear function of the mesh, so that the lips also touch in every
identity, and under every unit that leaves a person's lips closed. Units that open the lips keep them apart;
``mouthClose`` takes back the opening of ``jawOpen`` exactly.

Topology and chart do not change, and only vertices within some rows of the seam move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from models.head.bases import Bases
from models.head.quads import Quads, columns, halves, rows_round
from service.errors import ModelFault

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

CONTACT = 2
"""Rows of the lips outside their innermost one at which they touch: the foremost that both lips have near z = 27 mm."""

OPENERS = (
    "jawOpen", "mouthFunnel", "mouthLowerDownLeft", "mouthLowerDownRight", "mouthUpperUpLeft", "mouthUpperUpRight",
)  # fmt: skip
"""Units that part the lips in Apple's reference; ``tongueOut`` does so by way of ``jawOpen``."""

LED_BY_UPPER = {"mouthShrugUpper": 1.0, "mouthShrugLower": 0.0}
"""Share of the upper lip in the motion of the seam, where it is not one half: a shrugging lip pushes the other one."""

BOW_MM = ((0.0, -0.65), (3.0, -0.5), (5.7, -0.2), (11.2, 0.75), (16.0, 0.65), (20.2, 0.0), (25.0, -0.4))
"""Pairs of distance from the midline and height added to the seam: the tubercle of the upper lip hangs down in the
middle, to both sides the seam rises (the shape of a cupid's bow)."""

SINK_M = 3e-5
"""How far the upper lip goes below the seam; where edges only meet, rounding leaves cracks."""

INNER = (1.0, 1.0, 0.7, 0.4, 0.15)
OUTER = (0.6, 0.3, 0.1, 0.0, 0.0, 0.0, 0.0)
"""Shares of the contact row's move that the rows behind it (from the nearest one on) and before it take."""

ROUND_OUTER = (0.95, 0.85, 0.7, 0.5, 0.3, 0.15, 0.05)
"""The same of the moves of some millimetres that make an opening round, or push a lip, which reach farther."""

ROUND = {"jawOpen": (1.0, 0.75), "mouthFunnel": (0.78, 0.85)}
"""Openings made round at the corners: half their width as a share of the mouth's, and the exponent e of their height
(1 - (x / half width)^2)^e; an ellipse has 0.5, the base mesh's jawOpen 1, and its mouthFunnel comes to a point."""

LOWER_SHARE = 0.6
"""Share of the lower lip in that."""

FREE_INNER, FREE_OUTER = (0.2, 0.5), (0.2, 0.55, 0.85)
"""Shares of their own motion relative to the contact row that the two rows behind it keep in identities and in units
that leave the lips closed, and the three before it: with more the lips would pierce each other beside the seam."""

OPENS = (0.02, 0.25)
"""Share of a unit's largest opening up to which the lips go together, and from which on they move on their own."""

MILDER = {"mouthPucker": 0.75, "mouthRollUpper": 0.5, "mouthRollLower": 0.7, "mouthShrugLower": 0.8}
"""Factor on units that would pull the lips through the teeth, by 9.6 mm and 4.6 mm, or through each other."""

CLEAR_MM = {"inner": ((0.30, 0.9), (0.45, 1.3)), "outer": ((0.8, 1.6), (0.8, 1.6))}
"""Least distance from the seam's height of the first and second row behind it and before it, of the upper lip and of
the lower; near the corners the rows before it lie closer, and stay."""

TONGUE_JAW = 0.34
"""Share of ``jawOpen`` in ``tongueOut``: the lower lip and the lower teeth make way for the tongue."""


@dataclass(frozen=True)
class Lips:
    """Rows of vertices about the opening, of R columns round it from the middle of the lower lip to the left.

    Attributes:
        contact: (R,) vertices of the contact row.
        inner: (R, 5) vertices behind each one, the nearest first.
        outer: (R, 7) vertices before each one.
        upper: (R,) True for columns of the upper lip.
        seam: (2, R, R) matrices from the contact row to the seam, for the seam led by the lower lip and by the upper.
    """

    contact: Int
    inner: Int
    outer: Int
    upper: npt.NDArray[np.bool_]
    seam: Float

    def onto_seam(self, row: Float, lead: float = 0.5) -> Float:
        """(R, 3) values of the seam from those of the contact row; ``lead`` is the upper lip's share in it."""
        return np.asarray(((1 - lead) * self.seam[0] + lead * self.seam[1]) @ row)

    def sealed(self, field: Float, lead: float = 0.5, outer: tuple[float, ...] = OUTER) -> Float:
        """(V, 3) offsets under which lips that touch go on touching."""
        out = field.copy()
        row = field[self.contact]
        seam = self.onto_seam(row, lead)
        self._spread(out, seam - row, outer)
        for rows, frees in ((self.inner, FREE_INNER), (self.outer, FREE_OUTER)):
            for k, free in enumerate(frees):
                out[rows[:, k]] += (free - 1) * (field[rows[:, k]] - row)
        return out

    def parted(self, field: Float) -> Float:
        """(V, 3) offsets that part the lips; where they do not, or would move through each other, they go together."""
        opening = self.opening(field)
        low, high = (share * max(float(opening.max()), 1e-9) for share in OPENS)
        ramp = np.clip((opening - low) / (high - low), 0.0, 1.0)
        apart = self.seam[0] @ (ramp * ramp * (3 - 2 * ramp))
        weight = np.ones(len(field))
        for rows in (self.contact[:, None], self.inner, self.outer):
            for k in range(rows.shape[1]):
                weight[rows[:, k]] = apart
        closed = self.sealed(field)
        return np.asarray(closed + weight[:, None] * (field - closed))

    def opening(self, field: Float) -> Float:
        """(R,) height by which offsets (V, 3) part the lips, at each vertex of the contact row."""
        height = field[self.contact, 1]
        lower, upper = (seam @ height for seam in self.seam)
        return np.asarray(np.where(self.upper, height, upper) - np.where(self.upper, lower, height))

    def rounded(self, field: Float, mean: Float, width: float, exponent: float) -> Float:
        """(V, 3) offsets that part the lips, with an opening of the height told at :data:`ROUND`."""
        out = field.copy()
        x, opening = np.abs(mean[self.contact, 0]), self.opening(field)
        wanted = opening.max() * np.maximum(1 - (x / (width * x.max())) ** 2, 0.0) ** exponent
        more = self.seam[0] @ (wanted - opening)
        change = np.zeros((len(x), 3))
        change[:, 1] = more * np.where(self.upper, 1 - LOWER_SHARE, -LOWER_SHARE)
        change[np.argmax(x * np.sign(mean[self.contact, 0]))] = change[np.argmin(mean[self.contact, 0])] = 0.0
        self._spread(out, change, ROUND_OUTER)
        return out

    def shaped(self, mean: Float) -> Float:
        """(V, 3) the mean head with its lips on the seam."""
        out = mean.copy()
        row = mean[self.contact]
        seam = self.onto_seam(row)
        bow = 1e-3 * np.interp(1e3 * np.abs(seam[:, 0]), *np.array(BOW_MM).T)
        # The bow, too, has to be straight between the vertices of the lower lip.
        seam[:, 1] += self.seam[0] @ bow
        self._spread(out, seam - row)
        out[self.contact[self.upper], 1] -= SINK_M
        side = np.where(self.upper, 1.0, -1.0)
        # Towards the corners the lips taper.
        taper = np.clip((np.abs(seam[:, 0]).max() - np.abs(seam[:, 0])) / 0.0035, 0.0, 1.0)
        for rows, (upper, lower), share in (
            (self.inner, CLEAR_MM["inner"], 1.0), (self.outer, CLEAR_MM["outer"], taper),
        ):  # fmt: skip
            for k in (0, 1):
                clear = 1e-3 * np.where(self.upper, upper[k], lower[k]) * share
                own = out[rows[:, k], 1]
                wanted = side * np.maximum(side * own, side * seam[:, 1] + clear)
                out[rows[:, k], 1] = np.where(share > 0, wanted, own)
        return out

    def _spread(self, field: Float, move: Float, outer: tuple[float, ...] = OUTER) -> None:
        """Add a move (R, 3) of the contact row to a field, and shares of it to the rows beside it."""
        total, weight = np.zeros_like(field), np.zeros(len(field))
        groups = ((self.contact[:, None], (1.0,)), (self.inner, INNER), (self.outer, outer))
        for vertices, shares in groups:
            for k, share in enumerate(shares):
                np.add.at(total, vertices[:, k], share * move)
                np.add.at(weight, vertices[:, k], 1.0)
        # Columns that end in the same vertex share it.
        field += total / np.maximum(weight, 1.0)[:, None]


def seal(bases: Bases, quads: Int, regions: dict[str, Float], expression_names: tuple[str, ...]) -> Bases:
    """The bases with lips that touch.

    Args:
        bases: with teeth and tongue in their places.
        quads: (Q, 4) of the skin.
        regions: (V,) masks by name, with "mouth_inner" and "lips".
        expression_names: the 52 units of ARKit, in any order.
    """
    jaw = expression_names.index("jawOpen")
    lips = find_lips(bases.mean, quads, regions)
    identity = np.stack([lips.sealed(component) for component in bases.identity])
    expression = bases.expression.copy()
    for index, name in enumerate(expression_names):
        if name in OPENERS:
            expression[index] = lips.parted(bases.expression[index])
            if name in ROUND:
                expression[index] = lips.parted(lips.rounded(expression[index], bases.mean, *ROUND[name]))
        elif name not in ("mouthClose", "tongueOut"):
            milder = MILDER.get(name, 1.0) * bases.expression[index]
            reach = ROUND_OUTER if name in LED_BY_UPPER else OUTER
            expression[index] = lips.sealed(milder, LED_BY_UPPER.get(name, 0.5), reach)
    close, out = (expression_names.index(name) for name in ("mouthClose", "tongueOut"))
    together = bases.expression[jaw] + bases.expression[close]
    expression[close] = lips.sealed(together) - expression[jaw]
    skin = np.unique(quads)
    expression[out][skin] = lips.sealed(bases.expression[out])[skin] + TONGUE_JAW * expression[jaw][skin]
    return Bases(lips.shaped(bases.mean), identity, expression)


def find_lips(mean: Float, quads: Int, regions: dict[str, Float]) -> Lips:
    """The rows of the lips.

    Args:
        mean: (V, 3) metres.
        quads: (Q, 4) of the skin.
        regions: (V,) masks by name.

    Raises:
        ModelFault: the mesh has no closed rows of vertices round the opening.
    """
    mesh = Quads(quads)
    rows = rows_round(quads, regions["mouth_inner"] > 0.5, regions["lips"] > 0.25, CONTACT + 1)
    ring = mesh.cycle(rows[CONTACT], mean)
    inner, outer = columns(mesh, ring, rows[CONTACT - 1], len(INNER), len(OUTER))
    contact = np.array(ring)
    corners, upper = halves(mean[contact, 0])
    # Where the lips touch, the rows before them tell which one is the upper lip.
    if mean[outer[upper, 1], 1].mean() < mean[outer[~upper, 1], 1].mean():
        upper = ~upper
        upper[corners] = False
    return Lips(contact, inner, outer, upper, _seam(mean[contact], upper, corners))


def _seam(row: Float, upper: npt.NDArray[np.bool_], corners: list[int]) -> Float:
    """(2, R, R) of :class:`Lips`: the lower lip's vertices and corners are the nodes, each with its upper partner."""
    count = len(row)
    nodes = [i for i in range(count) if not upper[i]]
    uppers = np.flatnonzero(upper)
    partner = {i: i if i in corners else int(uppers[np.argmin(np.abs(row[uppers, 0] - row[i, 0]))]) for i in nodes}
    if len(set(partner.values())) != len(nodes):
        raise ModelFault("two vertices of the lower lip have the same partner on the upper lip")
    nodes.sort(key=lambda i: row[i, 0])
    place = {partner[i]: k for k, i in enumerate(nodes)}
    out = np.zeros((2, count, count))
    for lead in (0, 1):
        rows = [np.eye(count)[partner[i] if lead else i] for i in nodes]
        for k, i in enumerate(nodes):
            out[lead, i] = out[lead, partner[i]] = rows[k]
        for j in uppers[~np.isin(uppers, list(place))]:
            k = int(np.searchsorted([row[partner[i], 0] for i in nodes], row[j, 0]))
            a, b = (row[partner[nodes[n]], 0] for n in (k - 1, k))
            share = (row[j, 0] - a) / (b - a)
            out[lead, j] = (1 - share) * rows[k - 1] + share * rows[k]
    return out
