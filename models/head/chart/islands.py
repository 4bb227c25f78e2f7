"""Cut the left half of the head into discs: the pieces that are laid flat one by one and then mirrored."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sparse

from models.head.crop import PART_NAMES, Crop
from models.head.source import BaseMesh
from service.errors import ModelFault

Int = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Island:
    """One connected piece of the left half.

    Attributes:
        name: "face" (all of the skin that is seen), "mouth", "socket", "teeth_upper", "teeth_lower", "tongue",
        "lashes_0" ... polygons: indices of the head's polygons (left half).
    """

    name: str
    polygons: Int


def left_polygons(crop: Crop, template: npt.NDArray[np.float64]) -> Int:
    """Indices of the polygons on the subject's left (x > 0)."""
    corner = np.where(crop.polygons < 0, crop.polygons[:, :1], crop.polygons)
    return np.flatnonzero(template[corner, 0].mean(1) > 0)


def components(corners: Int) -> Int:
    """(Q,) label of the connected component of each of (Q, 4) polygons (shared indices connect)."""
    corners = np.where(corners < 0, corners[:, :1], corners)
    first = np.repeat(corners[:, 0], 3)
    other = corners[:, 1:].ravel()
    size = int(corners.max()) + 1
    graph = sparse.coo_matrix((np.ones(len(first)), (first, other)), shape=(size, size))
    label = sparse.csgraph.connected_components(graph, directed=False)[1]
    return np.asarray(np.unique(label[corners[:, 0]], return_inverse=True)[1])


def skin_kind(base: BaseMesh, crop: Crop) -> Int:
    """(Q,) 0 seen skin, 1 mouth lining, 2 eye socket, -1 other parts; after the islands of MakeHuman's own chart.

    Raises:
        ModelFault: the base mesh's own chart is not the known one.
    """
    table = {tuple(sorted(q)): k for k, q in enumerate(base.quads.tolist())}
    skin = np.flatnonzero(crop.part == 0)
    rows = np.array([table[tuple(sorted(q))] for q in crop.body_index[crop.polygons[skin]].tolist()])
    label = components(base.quads_uv[rows])
    centre = np.array(
        [base.vertices[base.quads[rows[label == k]]].reshape(-1, 3).mean(0) for k in range(label.max() + 1)]
    )
    count = np.bincount(label)
    largest = int(np.argmax(count))
    kind = np.zeros(label.max() + 1, np.int64)
    for k in range(len(kind)):
        if k != largest and centre[k, 2] > centre[largest, 2]:  # the neck, further back, is a piece of its own
            kind[k] = 2 if abs(centre[k, 0]) > 0.1 else 1
    if sorted(kind.tolist()).count(2) != 2 or sorted(kind.tolist()).count(1) != 1:
        raise ModelFault("the base mesh's chart has no mouth lining and two eye sockets: is this hm08?")
    out = np.full(len(crop.polygons), -1)
    out[skin] = kind[label]
    return out


def cut(base: BaseMesh, crop: Crop, template: npt.NDArray[np.float64]) -> list[Island]:
    """All islands of the left half except the eyeball, whose chart is given by a formula."""
    left = left_polygons(crop, template)
    kind = skin_kind(base, crop)
    out = [Island(name, left[kind[left] == k]) for k, name in enumerate(("face", "mouth", "socket"))]
    for number, name in enumerate(PART_NAMES):
        if name == "skin" or name.startswith("eye"):
            continue
        members = left[crop.part[left] == number]
        label = components(crop.polygons[members])
        pieces = label.max() + 1
        out += [Island(name if pieces == 1 else f"{name}_{k}", members[label == k]) for k in range(pieces)]
    return out
