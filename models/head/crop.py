"""Which vertices and polygons of the body make the head, and how its vertices follow from the body's.

Everything that is done to the geometry (crop, finer eyeballs) is linear, so it is one sparse matrix: applied to the
base mesh it gives the template, applied to a target it gives that target's offset on our head.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sparse

from models.head.eyes import eyeball
from models.head.source import BaseMesh
from service.errors import ModelFault

Int = npt.NDArray[np.int64]

NECK_FRONT = 1524
"""Body vertex on the front midline through which the neck is cut, along the edge loop that runs above the shoulders."""

PART_GROUPS: dict[str, tuple[str, ...]] = {
    "eye_left": ("helper-l-eye",),
    "eye_right": ("helper-r-eye",),
    "teeth_upper": ("helper-upper-teeth",),
    "teeth_lower": ("helper-lower-teeth",),
    "tongue": ("helper-tongue",),
    "lashes": ("helper-l-eyelashes-1", "helper-l-eyelashes-2", "helper-r-eyelashes-1", "helper-r-eyelashes-2"),
}
PART_NAMES = ("skin", *PART_GROUPS)
EYE_PARTS = ("eye_left", "eye_right")


@dataclass(frozen=True)
class Crop:
    """The head as a linear function of the body.

    Attributes:
        operator: (V, 19158) sparse; ``operator @ body`` are the head's vertices in the body's unit.
        polygons: (Q, 4) vertex indices, counter-clockwise from outside; the split into corners 0, 1, 2 and 0, 2, 3 is
        the
            same on both sides.
        part: (Q,) uint8 index into PART_NAMES.
        mirror: (V,) partner of each vertex.
        body_index: (V,) vertex of the body for skin vertices, -1 for made ones.
        neck: (N,) vertices of the cut through the neck, in order.
    """

    operator: sparse.csr_matrix
    polygons: Int
    part: npt.NDArray[np.uint8]
    mirror: Int
    body_index: Int
    neck: Int


def edge_loop(quads: Int, first: int, second: int) -> Int:
    """Walk straight ahead through four-valent vertices from an edge until the loop closes.

    Raises:
        ModelFault: the walk meets a vertex with another number of edges.
    """
    neighbours: dict[int, set[int]] = defaultdict(set)
    faces: dict[frozenset[int], set[int]] = defaultdict(set)
    for f, quad in enumerate(quads.tolist()):
        for k in range(4):
            a, b = quad[k], quad[(k + 1) % 4]
            neighbours[a].add(b)
            neighbours[b].add(a)
            faces[frozenset((a, b))].add(f)
    loop = [first, second]
    while True:
        a, b = loop[-2], loop[-1]
        ahead = [c for c in neighbours[b] if c != a and not faces[frozenset((b, c))] & faces[frozenset((a, b))]]
        if len(neighbours[b]) != 4 or len(ahead) != 1:
            raise ModelFault(f"the edge loop from vertex {first} ends at vertex {b}: is this the hm08 base mesh?")
        if ahead[0] == first:
            return np.array(loop)
        loop.append(ahead[0])


def _neck_loop(base: BaseMesh, body: Int) -> Int:
    beside = {int(q[(k + s) % 4]) for q in body for k in range(4) if q[k] == NECK_FRONT for s in (1, 3)}
    for second in sorted(beside, key=lambda v: -base.vertices[v, 0]):
        if base.vertices[second, 0] > 1e-3:
            return edge_loop(body, NECK_FRONT, second)
    raise ModelFault(f"no edge leaves vertex {NECK_FRONT} to the side: is this the hm08 base mesh?")


def _skin_quads(base: BaseMesh, body: Int, neck: Int) -> Int:
    """Body quads on the head's side of the neck loop."""
    count = len(base.vertices)
    wall = np.zeros(count, bool)
    wall[neck] = True
    edges = np.concatenate([body[:, [k, (k + 1) % 4]] for k in range(4)])
    edges = edges[~wall[edges].any(1)]
    graph = sparse.coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
    label = sparse.csgraph.connected_components(graph, directed=False)[1]
    top = int(np.argmax(np.where(np.arange(count) <= body.max(), base.vertices[:, 1], -np.inf)))
    inside = (label == label[top]) | wall
    return body[inside[body].all(1)]


def _mirror_split(quads: Int, vertices: npt.NDArray[np.float64], mirror: Int) -> Int:
    """Start each quad of the left side at the corner whose diagonal bends least and copy that choice to the right."""
    left = quads[vertices[quads, 0].mean(1) > 0]
    right = {tuple(sorted(q)) for q in quads[vertices[quads, 0].mean(1) <= 0].tolist()}
    corners = vertices[left]

    def bend(order: list[int]) -> npt.NDArray[np.float64]:
        a, b, c, d = (corners[:, k] for k in order)
        n1, n2 = np.cross(b - a, c - a), np.cross(c - a, d - a)
        size = np.linalg.norm(n1, axis=1) * np.linalg.norm(n2, axis=1)
        return np.asarray((n1 * n2).sum(1) / np.maximum(size, 1e-12))

    turn = bend([1, 2, 3, 0]) > bend([0, 1, 2, 3]) + 1e-9
    left = np.where(turn[:, None], left[:, [1, 2, 3, 0]], left)
    mirrored = mirror[left][:, [0, 3, 2, 1]]
    if {tuple(sorted(q)) for q in mirrored.tolist()} != right:
        raise ModelFault("the base mesh is not symmetric: polygons and mirror table disagree")
    return np.concatenate([left, mirrored])


def _reverse(polygons: Int) -> Int:
    """Turn polygons inside out, keeping the first corner and the padding of triangles."""
    padded = polygons[:, 3:] < 0
    return np.where(padded, polygons[:, [0, 2, 1, 3]], polygons[:, [0, 3, 2, 1]])


def crop_head(base: BaseMesh) -> Crop:
    """Cut the head with its neck from the body and collect eyes, teeth, tongue and lashes.

    Raises:
        ModelFault: the base mesh is not the one that this program knows.
    """
    body = base.quads[base.groups == "body"]
    neck = _neck_loop(base, body)
    blocks: list[sparse.csr_matrix] = []
    parts: list[npt.NDArray[np.uint8]] = []
    polygons: list[Int] = []
    mirrors: list[Int] = []
    body_index: list[Int] = []
    offset = 0
    for number, name in enumerate(PART_NAMES):
        quads = _skin_quads(base, body, neck) if number == 0 else base.quads[np.isin(base.groups, PART_GROUPS[name])]
        if name == "eye_right":  # the mirror image of the left one, vertex by vertex
            count = blocks[-1].shape[0]
            blocks.append(blocks[-1][:, base.mirror])
            polygons.append(_reverse(np.where(polygons[-1] < 0, -1, polygons[-1] + count)))
            mirrors[-1] = np.arange(offset, offset + count)
            mirrors.append(np.arange(offset - count, offset))
            index = np.full(count, -1)
        else:
            used = np.unique(quads)
            block, local = sparse.identity(len(base.vertices), format="csr")[used], np.searchsorted(used, quads)
            index = used if number == 0 else np.full(len(used), -1)
            if name == "eye_left":
                weights, local = eyeball(base.vertices[used])
                block, index = sparse.csr_matrix(weights) @ block, np.full(len(weights), -1)
                mirrors.append(np.zeros(0, np.int64))
            else:
                partner = np.searchsorted(used, base.mirror[used])
                local = _mirror_split(local, base.vertices[used], partner)
                mirrors.append(partner + offset)
            blocks.append(block)
            polygons.append(np.where(local < 0, -1, local + offset))
        body_index.append(index)
        parts.append(np.full(len(polygons[-1]), number, np.uint8))
        offset += blocks[-1].shape[0]
    place = {int(v): i for i, v in enumerate(body_index[0])}
    return Crop(
        operator=sparse.vstack(blocks).tocsr(),
        polygons=np.concatenate(polygons),
        part=np.concatenate(parts),
        mirror=np.concatenate(mirrors),
        body_index=np.concatenate(body_index),
        neck=np.array([place[int(v)] for v in neck]),
    )
