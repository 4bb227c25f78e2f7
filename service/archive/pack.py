"""Assemble and write the archive of an avatar.

The same photo, options and seed give the same bytes, so nothing here depends on the clock, and measured times and
memory are left out.
"""

from __future__ import annotations

import gc
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import BinaryIO

from service import GENERATOR
from service.archive.avatar import Avatar, Drawn, Shapes, drawn_parts, licences_text
from service.archive.container import write_file, write_stream
from service.archive.describe import describe
from service.archive.glb import EncodedPicture, glb_bytes, weights_by_name
from service.archive.images import encode_jpeg, encode_png
from service.archive.maps import MapFiles, chart_pictures, chart_values, encode_map, map_files, map_wanted
from service.archive.obj import data_maps, mtl_bytes, obj_bytes, parts_obj_bytes
from service.archive.surfaces import displaced, joint_weights, skeleton, subdivided_head
from service.archive.usd import curves_bytes, usda_bytes, usda_meshes
from service.archive.usd_materials import mtlx_bytes
from service.arrays import Float32
from service.levels import LEVELS
from service.manifest import to_json
from service.map_registry import MAPS
from service.materials.part import material_of
from service.runtime.sessions import release
from service.runtime.tiles import SMALL_MAP


def write_archive(avatar: Avatar, target: Path | BinaryIO) -> None:
    """Write the archive of ``avatar`` to a file, atomically, or to a binary stream.

    Args:
        avatar: the results of one photo.
        target: a path, or a stream that may be a pipe.

    Raises:
        OutputFault: the file or the stream could not be written.
        NumericFault: a result holds NaN or infinity.
    """
    made = avatar.reflectance
    if made is not None and made.size[0] * made.size[1] > SMALL_MAP:
        gc.collect()
        release()  # hundreds of MiB that the stages left in pieces
    members = archive_members(avatar)
    try:
        if isinstance(target, Path):
            write_file(target, members)
        else:
            write_stream(target, members)
    finally:
        release()  # else fragmented memory accumulates in a process that makes many avatars


def archive_members(avatar: Avatar) -> dict[str, bytes]:
    """Name -> content of every file of the archive; see :func:`write_archive`."""
    with ThreadPoolExecutor(3) as pool:
        drawn = pool.submit(lambda: avatar.drawn or draw(avatar))
        packed = pool.submit(_maps, avatar)
        pictures, values = pool.submit(chart_pictures, avatar), pool.submit(chart_values, avatar)
        previews = pool.submit(lambda: _previews(avatar, drawn.result()))
        shapes, maps = avatar.shapes or draw_shapes(avatar), map_files(avatar)
        parts = shapes.drawn
        written = _meshes(avatar, shapes, maps, pictures, values, drawn)
        own = {f"maps/parts/{name}.png": data for name, data in drawn.result().textures.items()}
        files = packed.result() | written | own
        files |= {"LICENSES.md": licences_text(avatar).encode()} | previews.result()
    files["manifest.json"] = to_json(describe(avatar, files, parts, maps))
    return files


def _meshes(
    avatar: Avatar,
    shapes: Shapes,
    maps: MapFiles,
    pictures: Future[dict[str, EncodedPicture]],
    values: Future[dict[str, Float32]],
    drawn: Future[Drawn],
) -> dict[str, bytes]:
    """Name -> content of everything under ``mesh/``, while the chart's pictures and values may still be drawn."""
    head, fit, made = avatar.head, avatar.fit, avatar.reflectance
    title, parts = _title(avatar), shapes.drawn
    materials = [part.material for part in parts]
    files = {
        "mesh/head.obj": shapes.head,
        **({"mesh/parts.obj": shapes.parts} if avatar.parts else {}),
        "mesh/head.mtl": mtl_bytes([*map(material_of, head.part_names), *materials], maps),
        "mesh/head.mtlx": mtlx_bytes(materials, maps),
        "mesh/head.usda": usda_bytes(shapes.usda, parts, maps),
        "mesh/head.glb": glb_bytes(
            parts,
            pictures.result(),
            units=head.expression_names,
            expression=weights_by_name(head.expression_names, fit.expression),
            head=head.name,
            licence=head.licence,
            own=drawn.result().textures,
        ),
    }
    fine_wanted = LEVELS[avatar.options.get("quality", "standard")].fine_mesh
    fine_wanted &= "displacement" in (avatar.options.get("maps") or ("displacement",))
    if fine_wanted and made is not None and made.displacement is not None:
        fine, smooth = subdivided_head(head, fit.vertices)
        embossed = displaced(fine, smooth, made.displacement)
        files["mesh/head_fine.obj"] = obj_bytes(fine, embossed, f"{title}, subdivided and displaced")
    groom = None if avatar.hair is None else avatar.hair.groom
    if groom is not None and len(groom) and fine_wanted:
        files["mesh/hair.usda"] = curves_bytes(groom, f"{title}, hair")
    return files | data_maps(materials, maps, values.result())


def _maps(avatar: Avatar) -> dict[str, bytes]:
    """PNG bytes by path; on two threads, as compression takes most of the time and releases the GIL."""
    wanted = [one for one in MAPS if map_wanted(avatar, one)]
    with ThreadPoolExecutor(2) as pool:
        packed = pool.map(lambda one: encode_map(one, avatar), wanted)
        return {one.path: data for one, data in zip(wanted, packed, strict=True) if data is not None}


def draw_shapes(avatar: Avatar) -> Shapes:
    """Text of an avatar's meshes, which has nothing of its maps."""
    head, fit, title = avatar.head, avatar.fit, _title(avatar)
    joints, drawn = skeleton(head, fit.neutral), drawn_parts(avatar)
    usda = usda_meshes(
        drawn,
        title,
        units=head.expression_names,
        expression=weights_by_name(head.expression_names, fit.expression),
        joints=joints,
        weights=joint_weights(head, joints),
    )
    parts = parts_obj_bytes(avatar.parts, title) if avatar.parts else b""
    return Shapes(drawn, obj_bytes(head, fit.vertices, title), parts, usda)


def _title(avatar: Avatar) -> str:
    return f"{GENERATOR}: {avatar.head.name} {'with maps of its own' if avatar.given else 'fitted to a photo'}"


def draw(avatar: Avatar) -> Drawn:
    """What an archive shows of an avatar whose maps may still be made, but for texture and albedo."""
    from service.archive.preview.overlay import overlay
    from service.archive.preview.sheet import clay, coloured

    textured, in_lamps = coloured(avatar)
    over = None if avatar.given else overlay(avatar)
    own = {one.name: (one, one is part.material.colour_map) for part in avatar.parts for one in part.own_maps}
    pngs = {name: encode_png(one.pixels, srgb=colour) for name, (one, colour) in own.items()}
    return Drawn(over, textured, in_lamps, tuple(clay(avatar)), pngs)


def _previews(avatar: Avatar, drawn: Drawn) -> dict[str, bytes]:
    from service.archive.preview.sheet import sheet

    pictures = {} if drawn.overlay is None else {"preview/overlay.jpg": encode_jpeg(drawn.overlay)}
    return {**pictures, "preview/sheet.jpg": encode_jpeg(sheet(avatar, drawn))}
