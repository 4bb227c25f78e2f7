"""``mesh/head.obj``, ``mesh/parts.obj`` and their ``mesh/head.mtl``.

The head has the photo's expression; its mesh is whole, on one chart and of the same topology in every archive. Parts
with textures of their own, such as hair and the finer eyes and teeth, are a file of their own: no ray that looks for
the head meets them. Metres, +Y up, +Z out of the face, unposed (the camera holds the pose). The original polygons, a
``vt`` per chart vertex with its origin bottom left, one object, group and material per part. OBJ has no unit, so the
header names it.

Materials have the PBR keys that importers of Blender, Maya and others read. Blender reads ``Ks`` as its specular level
(0.5 is the F0 that ``Ni`` gives), ``Pr`` as roughness, and a normal map only as ``map_Bump -bm 1``; ``norm`` is for
others. It takes every texture of an MTL file for sRGB but EXR, so all that are no colours come as EXR
(:func:`data_maps`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from service.archive.images import decode_normals8, exr_bytes
from service.archive.maps import MapFiles
from service.archive.surfaces import vertex_normals
from service.arrays import AnyFloat, Float32, Int32, UInt8
from service.errors import NumericFault
from service.head.files import split_polygons
from service.head.model import HeadModel
from service.materials.material import ChartMap, Map, Material, OwnMap
from service.materials.part import MeshPart, is_cards, material_of, part_normals

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
    return _text(title, len(head.polygons), [vertices], [head.uv], normals, _own_faces(head))


def parts_obj_bytes(parts: Sequence[MeshPart], title: str) -> bytes:
    """OBJ text of parts beside the head's own, in the photo's expression; materials are those of ``head.mtl``.

    They have one smoothing group each and no normals, which every reader computes, but for masked cards.
    """
    points, charts = [part.vertices for part in parts], [part.uv for part in parts]
    normals = [part_normals(part, part.vertices, split_polygons(part.polygons)) for part in parts if is_cards(part)]
    return _text(title, sum(len(part.faces) for part in parts), points, charts, normals, _part_faces(parts), "%.5f")


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


def _own_faces(head: HeadModel) -> Iterator[str]:
    for index, name in enumerate(head.part_names):
        chosen = head.polygon_part == index
        if chosen.any():
            yield _begin(name, material_of(name).name)
            yield _faces(head.polygons[chosen], head.polygon_uv[chosen], (0, 0, 0))


def _part_faces(parts: Sequence[MeshPart]) -> Iterator[str]:
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


LEVEL = 0.5
"""Specular level of ``Ks`` that stands for the whole F0 of the index of refraction."""


def mtl_bytes(materials: Iterable[Material], files: MapFiles) -> bytes:
    """MTL text of materials, each once by name, in order of appearance."""
    distinct = {material.name: material for material in materials}
    return "\n".join(_mtl_lines(material, files) for material in distinct.values()).encode("ascii")


def _mtl_lines(material: Material, files: MapFiles) -> str:
    red, green, blue = material.colour
    # Phong exponent whose lobe is about as wide as that of GGX with alpha = roughness^2.
    exponent = 2.0 / max(material.roughness, 0.05) ** 4 - 2.0
    level = LEVEL * material.specular
    lines = [
        f"newmtl {material.name}",
        "Ka 0 0 0",
        f"Kd {red:g} {green:g} {blue:g}",
        f"Ks {level:g} {level:g} {level:g}",
        f"Ns {min(exponent, 1000.0):.1f}",
        f"Ni {material.ior:g}",
        f"d {material.opacity:g}",
        "illum 2",
        f"Pr {material.roughness:g}",
    ]
    colour = files.path(material.colour_map)
    maps = {
        "map_Kd": colour, "map_d": colour if material.alpha != "opaque" else None,
        "map_Ks": data_path(material.specular_map, files), "map_Pr": data_path(material.roughness_map, files),
        "map_Bump -bm 1": data_path(material.normal_map, files), "norm": data_path(material.normal_map, files),
    }  # fmt: skip
    lines += [f"{key} {path}" for key, path in maps.items() if path is not None]
    return "\n".join(lines) + "\n"


def data_path(one: Map | None, files: MapFiles) -> str | None:
    """Path of the EXR of a map, as seen from the mesh; None where there is none."""
    if one is None or files.path(one) is None:
        return None
    return f"{one.role}.exr" if isinstance(one, ChartMap) else f"../maps/parts/{one.name}.exr"


def data_maps(materials: Iterable[Material], files: MapFiles, charts: Mapping[str, Float32]) -> dict[str, bytes]:
    """Name in the archive -> EXR of every map that is no colour.

    Args:
        materials: of the MTL file.
        files: which maps the archive has.
        charts: of the chart, by role: normals (h, w, 3) in [-1, 1], the others (h, w) in [0, 1].
    """
    made: dict[str, bytes] = {}
    for material in materials:
        for slot, one in (
            ("specular", material.specular_map), ("roughness", material.roughness_map), ("normal", material.normal_map),
        ):  # fmt: skip
            path = data_path(one, files)
            name = None if path is None else path.removeprefix("../") if path.startswith("../") else f"mesh/{path}"
            if name is None or name in made:
                continue
            if one is not None:
                values = _own_values(one, slot) if isinstance(one, OwnMap) else charts[one.role]
                made[name] = exr_bytes(_coded(values, slot))
    return made


def _own_values(one: OwnMap, slot: str) -> Float32:
    pixels: UInt8 = one.pixels
    if slot == "normal":
        return decode_normals8(pixels[..., :3])
    return np.asarray((pixels if pixels.ndim == 2 else pixels[..., 0]) / np.float32(255), np.float32)


def _coded(values: Float32, slot: str) -> Float32:
    """Normals as 0.5 + 0.5 n, specular as a level, roughness as it is, in steps of 1/256, which compress well."""
    factor, shift = {"normal": (0.5, 0.5), "specular": (LEVEL, 0.0), "roughness": (1.0, 0.0)}[slot]
    codes = np.rint(values * np.float32(256 * factor) + np.float32(256 * shift))
    return np.asarray(codes / np.float32(256), np.float32)
