"""Lids that close: at ``eyeBlink`` 1 the upper lid lies on the lower one, and neither pierces the eyeball.

In the base mesh a blink carries the upper lid three millimetres past the lower one, in a wave that droops at the outer
corner, and sockets and lids pass through the ball. Here the upper edge ends on the lower edge, which rises a little
itself; skin near the ball keeps outside it. How far open the lids are differs less between identities than before
(it is an expression rather than a shape), so that the same blink closes all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from models.head.bases import Bases
from models.head.heads import some_heads
from models.head.quads import Quads, columns, halves, rows_round

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

CONTACT = 1
"""Row of the lids, counted from the socket, at which they meet."""

OVERLAP_M, BEFORE_M = 0.0007, 0.0006
"""How far the edge of the upper lid goes below the lower one's, and before it, at 1; identities differ by 0.2 mm."""

RISE_M, CORNER_SHARE = 0.0010, 0.3
"""Rise of the lower lid in the middle, and share that its motion in the base mesh keeps, which drags the corners."""

FREE_IDENTITY = 0.3
"""Share of the variation of the opening between identities that stays: 0.2 mm of 0.75."""

INNER = (1.0, 0.6, 0.2)
OUTER = (1.0, 1.0, 1.0, 0.8, 0.55, 0.3, 0.1)
"""Shares of the contact row's change that rows behind it and before it take, the nearest first."""

FLATTEN_M = (0.0003, 0.0008, 0.0012, 0.0012, 0.0009, 0.0005, 0.0002)
"""How far the upper lid's rows before the contact row go back at 1, so that the lid lies on the ball."""

CLEAR_M, CORNEA_M = 0.00015, 0.0012
"""Distance of the skin from the ball, and what is added before the cornea, which bulges."""

CORNEA_DEG = (38.0, 60.0)
"""Angles from the line of sight up to which all of it is added, and from which on none is: an eye turns by 30."""

NEAR_M = (0.0016, 0.0050)
"""Distance from the ball up to which skin keeps its distance in all identities, and from which on it is free."""


@dataclass(frozen=True)
class Lids:
    """Rows of vertices about one eye's opening, R columns.

    Attributes:
        contact: (R,) vertices at which the lids meet.
        inner: (R, 3) vertices behind each one, the nearest first.
        outer: (R, 7) vertices before each one.
        upper: (R,) True on the upper lid, False on the lower one and at the corners.
        across: (R, R) from the contact row to the lower edge at the same place along the opening.
    """

    contact: Int
    inner: Int
    outer: Int
    upper: npt.NDArray[np.bool_]
    across: Float

    def add(self, field: Float, move: Float) -> None:
        """Add a move (R, 3) of the contact row to offsets (V, 3), and shares of it to the rows beside it."""
        total, weight = np.zeros_like(field), np.zeros(len(field))
        for rows, shares in ((self.contact[:, None], (1.0,)), (self.inner, INNER), (self.outer, OUTER)):
            for k, share in enumerate(shares):
                np.add.at(total, rows[:, k], share * move)
                np.add.at(weight, rows[:, k], 1.0)
        field += total / np.maximum(weight, 1.0)[:, None]

    def alike(self, component: Float) -> Float:
        """(V, 3) offsets of an identity, with less of what opens the lids."""
        row = component[self.contact]
        half = 0.5 * (1 - FREE_IDENTITY) * (self.across @ row - row)
        half[~self.upper] = 0.0
        # The other half moves the lower lid the other way.
        share = np.where(self.upper[:, None], self.across, 0.0)
        below = share.T @ half / np.maximum(share.sum(0), 1e-9)[:, None]
        out = component.copy()
        self.add(out, np.where(self.upper[:, None], half, -np.where(self.upper[:, None], 0.0, below)))
        return out

    def blink(self, mean: Float, unit: Float) -> Float:
        """(V, 3) offsets of ``eyeBlink``, on this side, after which the lids meet."""
        at, own = mean[self.contact], unit[self.contact]
        middle, half = 0.5 * (at[:, 0].max() + at[:, 0].min()), 0.5 * np.ptp(at[:, 0])
        profile = np.clip(1 - ((at[:, 0] - middle) / half) ** 2, 0.0, 1.0)
        lower = CORNER_SHARE * own + np.stack([0 * profile, RISE_M * profile, 0 * profile], 1)
        end = self.across @ (at + lower)
        end[:, 1] -= OVERLAP_M * np.sqrt(profile)
        end[:, 2] += BEFORE_M * np.sqrt(profile)
        move = np.where(self.upper[:, None], end - at, lower)
        # Beyond the edge the lid moves as it did, by as much less as the edge does.
        size = np.clip(-move[:, 1] / np.maximum(-own[:, 1], 1e-4), CORNER_SHARE, 1.0)
        size = np.where(self.upper, size, CORNER_SHARE)
        out = unit.copy()
        for rows, shares in ((self.inner, INNER), (self.outer, OUTER)):
            for k, share in enumerate(shares):
                out[rows[:, k]] = (1 - share * (1 - size))[:, None] * unit[rows[:, k]]
        out[self.contact] = size[:, None] * own
        self.add(out, move - size[:, None] * own)
        for k, back in enumerate(FLATTEN_M):
            out[self.outer[self.upper, k], 2] -= back * np.sqrt(profile[self.upper])
        return out


def close(
    bases: Bases, quads: Int, balls: dict[str, Int], regions: dict[str, Float], expression_names: tuple[str, ...]
) -> Bases:
    """The bases with lids that close, and skin that keeps outside the eyeballs.

    Args:
        bases: with the eyeballs in their size.
        quads: (Q, 4) of the skin.
        balls: vertices of each eyeball by side, "left" and "right".
        regions: (V,) masks by name.
        expression_names: the 52 units of ARKit, in any order.
    """
    mean, identity, expression = bases.mean.copy(), bases.identity.copy(), bases.expression.copy()
    heads = some_heads(identity)
    skin, local = np.unique(quads, return_inverse=True)
    local = local.reshape(quads.shape)
    edges = np.concatenate([local[:, [0, 1]], local[:, [1, 2]], local[:, [0, 2]], local[:, [1, 3]]])
    for side, ball in balls.items():
        lids = find_lids(bases.mean, quads, regions, side)
        identity = np.stack([lids.alike(component) for component in identity])
        globe = Globe.of(bases.mean[ball])
        mean[skin] += globe.outwards(mean[skin], edges)
        blink = expression_names.index(f"eyeBlink{side.capitalize()}")
        expression[blink] = lids.blink(mean, expression[blink])
        # A lid that is far from the ball when open is near it when closed.
        places = [mean[skin] + share * expression[blink, skin] for share in (0.0, 0.5, 1.0)]
        near = np.max([globe.near(place) for place in places], axis=0)
        ray = globe.rays(mean[skin])
        for component in identity:
            own = component[ball]
            growth = ((own - own.mean(0)) * globe.rays(bases.mean[ball])).sum(1).mean()
            apart = ((component[skin] - own.mean(0)) * ray).sum(1) - growth
            component[skin] -= (near * apart)[:, None] * ray
        for name, unit in zip(expression_names, expression, strict=True):
            if name.startswith("eyeLook") and name.lower().endswith(side):
                unit[ball] = globe.turned(mean[ball], unit[ball])
            # A straight way to the closed lid leads through the ball: half way counts as well.
            for share in (0.5, 1.0, 0.5):
                unit[skin] += globe.outwards(mean[skin] + share * unit[skin], edges) / share
        # Rigid in the mean, the same motions are a little off in other heads, so the worst of some decides.
        spread = [np.einsum("k,kvc->vc", head, identity) for head in heads]
        globes = [Globe.of((bases.mean + other)[ball]) for other in spread]

        def lack(moved: Float, spread: list[Float] = spread, globes: list[Globe] = globes) -> Float:
            each = [one.outwards((moved + other)[skin], edges) for one, other in zip(globes, spread, strict=True)]
            worst = np.linalg.norm(each, axis=2).argmax(0)
            return np.asarray(each)[worst, np.arange(len(skin))]

        mean[skin] += lack(mean)
        for unit in expression:
            for share in (1.0, 0.5):
                unit[skin] += lack(mean + share * unit) / share
    return Bases(mean, identity, expression)


def find_lids(mean: Float, quads: Int, regions: dict[str, Float], side: str) -> Lids:
    """The rows of the left or right eye's lids.

    Raises:
        ModelFault: the mesh has no closed rows of vertices round the opening.
    """
    mesh = Quads(quads)
    socket = (regions["eye_socket"] > 0.5) & ((mean[:, 0] > 0) == (side == "left"))
    allowed = np.maximum(regions[f"eyelid_upper_{side}"], regions[f"eyelid_lower_{side}"]) > 0.5
    rows = rows_round(quads, socket, allowed, CONTACT + 1)
    ring = mesh.cycle(rows[CONTACT], mean)
    inner, outer = columns(mesh, ring, rows[CONTACT - 1], len(INNER), len(OUTER))
    contact = np.array(ring)
    x = mean[contact, 0]
    _, upper = halves(x)
    edge = np.flatnonzero(~upper)
    edge = edge[np.argsort(x[edge])]
    across = np.eye(len(ring))
    for i in np.flatnonzero(upper):
        k = int(np.clip(np.searchsorted(x[edge], x[i]), 1, len(edge) - 1))
        share = np.clip((x[i] - x[edge[k - 1]]) / max(x[edge[k]] - x[edge[k - 1]], 1e-9), 0.0, 1.0)
        across[i] = 0.0
        across[i, edge[k - 1]], across[i, edge[k]] = 1 - share, share
    return Lids(contact, inner, outer, upper, across)


@dataclass(frozen=True)
class Globe:
    """An eyeball: centre (3,) and radius in metres."""

    centre: Float
    radius: float

    @classmethod
    def of(cls, points: Float) -> Globe:
        """The sphere that fits points (N, 3) best."""
        system = np.c_[2 * points, np.ones(len(points))]
        fit = np.linalg.lstsq(system, (points**2).sum(1), rcond=None)[0]
        return cls(fit[:3], float(np.sqrt(fit[3] + fit[:3] @ fit[:3])))

    def rays(self, points: Float) -> Float:
        """(N, 3) unit directions from the centre."""
        ray = points - self.centre
        return np.asarray(ray / np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-9))

    def surface(self, points: Float) -> Float:
        """(N,) least distance of skin from the centre in the direction of points (N, 3)."""
        angle = np.degrees(np.arccos(np.clip(self.rays(points)[:, 2], -1.0, 1.0)))
        return np.asarray(self.radius + CLEAR_M + CORNEA_M * _fall(angle, *CORNEA_DEG))

    def outwards(self, points: Float, edges: Int) -> Float:
        """(N, 3) moves of points (N, 3) that are too near, or inside, onto :meth:`surface`; zero for the others.

        The middles of edges (M, 2) count as well: both ends go out with them.
        """
        lack = np.maximum(self.surface(points) - np.linalg.norm(points - self.centre, axis=1), 0.0)
        middle = points[edges].mean(1)
        inside = self.radius - np.linalg.norm(middle - self.centre, axis=1) + CLEAR_M
        deep = np.flatnonzero(inside > 0)
        for end in (0, 1):
            np.maximum.at(lack, edges[deep, end], inside[deep])
        return np.asarray(lack[:, None] * self.rays(points))

    def turned(self, points: Float, offsets: Float) -> Float:
        """(N, 3) offsets that turn the ball about its centre as offsets (N, 3) do, which also push and squeeze it."""
        from_centre, after = points - self.centre, points + offsets
        u, _, vt = np.linalg.svd((points - points.mean(0)).T @ (after - after.mean(0)))
        return np.asarray(from_centre @ (u @ vt) - from_centre)

    def near(self, points: Float) -> Float:
        """(N,) in [0, 1]: 1 for points at the surface, 0 for those far from it."""
        return _fall(np.linalg.norm(points - self.centre, axis=1) - self.surface(points), *NEAR_M)


def _fall(value: Float, low: float, high: float) -> Float:
    """(N,) smooth ramp from 1 at ``low`` to 0 at ``high``."""
    t = np.clip((high - value) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t))
