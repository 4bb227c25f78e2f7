"""Walking on a mesh of quads: rows of vertices round an opening of the face, and columns across them."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import numpy.typing as npt

from service.errors import ModelFault

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


def rows_round(quads: Int, inside: Mask, allowed: Mask, count: int) -> list[set[int]]:
    """``count`` rows of allowed vertices round an opening, each beside the one before, the first beside the inside.

    Args:
        quads: (Q, 4) of the skin.
        inside: (V,) vertices inside the opening.
        allowed: (V,) vertices of its edges.
        count: of rows.
    """
    rows: list[set[int]] = []
    taken = inside.copy()
    while len(rows) < count:
        reached = np.unique(quads[taken[quads].any(1)])
        rows.append({int(v) for v in reached[allowed[reached] & ~taken[reached]]})
        taken[reached] = True
    return rows


def halves(x: Float) -> tuple[list[int], Mask]:
    """Of a ring's x (R,): indices of both corners, ascending, and (R,) which vertices lie between them."""
    corners = sorted((int(np.argmax(x)), int(np.argmin(x))))
    between = np.zeros(len(x), bool)
    between[corners[0] + 1 : corners[1]] = True
    return corners, between


def columns(mesh: Quads, ring: list[int], behind: set[int], inner: int, outer: int) -> tuple[Int, Int]:
    """(R, inner) vertices behind each one of a ring and (R, outer) before it, the nearest first.

    Args:
        mesh: the skin.
        ring: R vertices in order.
        behind: those of the row behind it.
        inner: length of a column behind the ring.
        outer: before it.

    Raises:
        ModelFault: a vertex of the ring has not one neighbour in the row behind, or a column ends early.
    """
    found: tuple[list[list[int]], list[list[int]]] = ([], [])
    for vertex in ring:
        near = [n for n in mesh.beside[vertex] if n in behind]
        if len(near) != 1:
            raise ModelFault(f"vertex {vertex} of an opening has {len(near)} neighbours in the row behind; wanted 1")
        found[0].append(mesh.walk(vertex, near[0], inner))
        found[1].append(mesh.walk(vertex, mesh.ahead(near[0], vertex), outer))
    return np.array(found[0]), np.array(found[1])


class Quads:
    """Neighbours in a mesh of quads."""

    def __init__(self, quads: Int) -> None:
        self.beside: dict[int, set[int]] = defaultdict(set)
        self.faces: dict[frozenset[int], set[int]] = defaultdict(set)
        for number, quad in enumerate(quads.tolist()):
            for k in range(4):
                a, b = quad[k], quad[(k + 1) % 4]
                self.beside[a].add(b)
                self.beside[b].add(a)
                self.faces[frozenset((a, b))].add(number)

    def ahead(self, a: int, b: int) -> int:
        """The vertex straight on from an edge."""
        met = self.faces[frozenset((a, b))]
        found = [c for c in self.beside[b] if c != a and not self.faces[frozenset((b, c))] & met]
        if len(found) != 1:
            raise ModelFault(f"no edge goes straight on from {a} to {b}: is this the hm08 base mesh?")
        return found[0]

    def walk(self, start: int, second: int, count: int) -> list[int]:
        """``count`` vertices straight on from an edge, its second end first."""
        path = [start, second]
        while len(path) <= count:
            path.append(self.ahead(path[-2], path[-1]))
        return path[1:]

    def cycle(self, members: set[int], mean: Float) -> list[int]:
        """The members in order round the opening, from the lowest in the middle of its width towards +x."""
        near = {v: [n for n in self.beside[v] if n in members] for v in members}
        if any(len(n) != 2 for n in near.values()):
            raise ModelFault("a row of vertices is no closed curve: is this the hm08 base mesh?")
        middle = 0.5 * (min(mean[v, 0] for v in members) + max(mean[v, 0] for v in members))
        low = [v for v in members if mean[v, 1] < np.mean([mean[w, 1] for w in members])]
        start = min(low, key=lambda v: (round(abs(mean[v, 0] - middle), 7), mean[v, 1]))
        path = [start, max(near[start], key=lambda v: float(mean[v, 0]))]
        while True:
            after = next(n for n in near[path[-1]] if n != path[-2])
            if after == start:
                return path
            path.append(after)
