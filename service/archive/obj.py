"""``mesh/head.obj``: the head with the photo's expression; ``mesh/parts.obj``: the parts beside it.

The head's own mesh is whole, on one chart and of the same topology in every archive. Parts with textures of their own,
such as hair and the finer eyes and teeth, are a file of their own: no ray that looks for the head meets them.

Metres, +Y up, +Z out of the face, unposed (the camera holds the pose). The original polygons, a ``vt`` per chart
vertex with its origin bottom left, one object, group and material per part. OBJ has no unit, so the header names it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from service.archive.surface import is_cards, part_normals, vertex_normals
from service.arrays import AnyFloat, Int32
from service.errors import NumericFault
from service.head.files import split_polygons
from service.head.model import HeadModel
from service.materials.of_head import material_of
from service.materials.part import MeshPart

_HEADER = """\
# {title}
# unit: metre; +Y up, +Z out of the face, +X to the subject's left; the photo's expression, without the head's pose
# vt origin: bottom left; {vertices} vertices, {polygons} polygons
mtllib head.mtl
"""


def obj_bytes(head: HeadModel, vertices: AnyFloat, title: str) -> bytes:
    """OBJ text of ``vertices`` (V, 3) metres with the topology of ``head``, to the micrometre.

    The vertices are in the head model's order, so the same line of two archives is the same point of two heads.

    Raises:
        NumericFault: a vertex is not finite.
    """
    if not np.isfinite(vertices).all():
        raise NumericFault(f"vertex {int(np.argwhere(~np.isfinite(vertices))[0, 0])} of the head is not finite")
    normals = [vertex_normals(vertices, head.triangles)]
    return _text(title, len(head.polygons), [vertices], [head.uv], normals, _own(head))


def parts_obj_bytes(parts: Sequence[MeshPart], title: str) -> bytes:
    """OBJ text of parts beside the head's own, in the photo's expression; materials are those of ``head.mtl``.

    They have one smoothing group each and no normals, which every reader computes, but for masked cards.
    """
    points, charts = [part.vertices for part in parts], [part.uv for part in parts]
    normals = [part_normals(part, part.vertices, split_polygons(part.polygons)) for part in parts if is_cards(part)]
    return _text(title, sum(len(part.faces) for part in parts), points, charts, normals, _others(parts), "%.5f")


def _text(
    title: str, polygons: int, points: Sequence[AnyFloat], charts: Sequence[AnyFloat], normals: Sequence[AnyFloat],
    faces: Iterator[str], place: str = "%.6f",
) -> bytes:  # fmt: skip
    """The file; charts of parts, 1024 texels wide, are written less finely than that of the head, with 6144."""
    header = _HEADER.format(title=title, vertices=sum(map(len, points)), polygons=polygons)
    blocks = [header, *(_lines("v %.6f %.6f %.6f\n", rows) for rows in points)]
    blocks += [_lines(f"vt {place} {place}\n", rows) for rows in charts]
    blocks += [_lines("vn %.4f %.4f %.4f\n", rows) for rows in normals]
    return "".join([*blocks, *faces]).encode("ascii")


def _lines(pattern: str, rows: AnyFloat) -> str:
    values = np.asarray(rows, np.float64) + 0.0  # -0.0 becomes 0.0
    return (pattern * len(values)) % tuple(values.ravel().tolist())


def _own(head: HeadModel) -> Iterator[str]:
    for index, name in enumerate(head.part_names):
        chosen = head.polygon_part == index
        if chosen.any():
            yield _begin(name, material_of(name).name)
            yield _faces(head.polygons[chosen], head.polygon_uv[chosen], (0, 0, 0))


def _others(parts: Sequence[MeshPart]) -> Iterator[str]:
    before, before_uv, before_normal = 0, 0, 0
    for part in parts:
        own = is_cards(part)
        yield _begin(part.name, part.material.name)
        yield _faces(part.polygons, part.polygons_uv, (before, before_uv, before_normal), normals=own)
        before, before_uv = before + len(part.vertices), before_uv + len(part.uv)
        before_normal += own * len(part.vertices)


def _begin(name: str, material: str) -> str:
    return f"o {name}\ng {name}\nusemtl {material}\ns 1\n"


def _faces(polygons: Int32, uv: Int32, before: tuple[int, int, int], *, normals: bool = True) -> str:
    """Lines ``f v/vt/vn ...`` or ``f v/vt ...`` in the order given; a part has a normal for each vertex.

    Args:
        polygons: (Q, 4), -1 in the last column marks a triangle.
        uv: (Q, 4) likewise.
        before: vertices, chart vertices and normals written for other parts.
        normals: whether there are any.
    """
    columns = [polygons.astype(np.int64) + before[0], uv.astype(np.int64) + before[1]]
    if normals:
        columns.append(polygons.astype(np.int64) + before[2])
    corners = np.stack(columns, 2) + 1
    present = np.repeat(polygons >= 0, corners.shape[2], axis=1)
    corner = "/".join(["%d"] * corners.shape[2])
    patterns = np.where(polygons[:, 3] < 0, f"f {' '.join([corner] * 3)}\n", f"f {' '.join([corner] * 4)}\n")
    return "".join(patterns.tolist()) % tuple(corners.reshape(len(polygons), -1)[present].tolist())
