"""Assemble and write the archive of an avatar.

The same photo, options and seed give the same bytes, so nothing here depends on the clock, and measured times and
memory are left out.
"""

from __future__ import annotations

import dataclasses
import gc
import hashlib
import struct
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np

from service import GENERATOR, PROGRAM, __version__
from service import manifest as m
from service.archive.avatar import Avatar, Drawn, Shapes, Source, drawn_parts, licences_text
from service.archive.container import MEDIA_TYPES, MEMBERS, in_order, write_file, write_stream
from service.archive.glb import glb_bytes, weights_by_name
from service.archive.images import encode_jpeg, encode_png
from service.archive.maps import (
    MapFiles,
    chart_pictures,
    chart_values,
    coding,
    encode_map,
    frame,
    map_files,
    map_wanted,
    wrinkle_of,
)
from service.archive.obj import data_maps, mtl_bytes, obj_bytes, parts_obj_bytes
from service.archive.surfaces import JOINTS, PARENTS, displaced, joint_weights, skeleton, subdivided_head
from service.archive.usd import curves_bytes, usda_bytes, usda_meshes
from service.archive.usd_materials import mtlx_bytes
from service.arrays import Float32
from service.face.fit.fit import Fit
from service.hair.groom import Groom
from service.hair.scalp import length_of
from service.hair.style import style_to_json
from service.hair.worn_hair import WornHair
from service.levels import LEVELS
from service.manifest import to_json
from service.map_registry import MAPS, RegisteredMap
from service.materials.material import Material
from service.materials.part import MeshPart, material_of
from service.reflectance.reflectance_maps import MID, SCALE_MM
from service.runtime.sessions import release
from service.runtime.tiles import SMALL_MAP


def write_archive(avatar: Avatar, target: Path | BinaryIO) -> None:
    """Write the archive of an avatar to a file, atomically, or to a binary stream that may be a pipe.

    OutputFault: it could not be written. NumericFault: a result holds NaN or infinity.
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
        written = _meshes(avatar, shapes, maps, pictures, values, drawn)
        own = {f"maps/parts/{name}.png": data for name, data in drawn.result().textures.items()}
        files = packed.result() | written | own
        files |= {"LICENSES.md": licences_text(avatar).encode()} | previews.result()
    files["manifest.json"] = to_json(describe(avatar, files, shapes.drawn, maps))
    return files


def _meshes(
    avatar: Avatar,
    shapes: Shapes,
    maps: MapFiles,
    pictures: Future[dict[str, bytes]],
    values: Future[dict[str, Float32]],
    drawn: Future[Drawn],
) -> dict[str, bytes]:
    """Name -> content of everything under ``mesh/``, while the chart's pictures and values may still be drawn."""
    head, fit, made = avatar.head, avatar.fit, avatar.reflectance
    title, parts = _title(avatar), shapes.drawn
    materials = [part.material for part in parts]
    fine_wanted = LEVELS[avatar.options.get("quality", "standard")].fine_mesh
    fine_wanted &= "displacement" in (avatar.options.get("maps") or ("displacement",))
    files = {}
    if fine_wanted and made is not None and made.displacement is not None:
        # First: it takes much memory for a moment, and the maps' PNGs, made meanwhile, take as much until the end.
        fine, smooth = subdivided_head(head, fit.vertices)
        embossed = displaced(fine, smooth, made.displacement)
        files["mesh/head_fine.obj"] = obj_bytes(fine, embossed, f"{title}, subdivided and displaced")
        del fine, smooth, embossed
    files |= {
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
    for name, groom in (("hair", None if avatar.hair is None else avatar.hair.groom), ("beard", avatar.beard)):
        if groom is not None and len(groom) and fine_wanted:
            files[f"mesh/{name}.usda"] = curves_bytes(groom, f"{title}, {name}")
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


Section = TypeVar("Section")

_PNG_HEADER = struct.Struct(">II BB")
_PNG_CHANNELS = {0: 1, 2: 3, 6: 4}


def describe(avatar: Avatar, files: Mapping[str, bytes], parts: Sequence[MeshPart], where: MapFiles) -> m.Manifest:
    """Manifest of an avatar, of the contents of its other files by name, its ``drawn_parts`` and its ``map_files``."""
    head, (width, height) = avatar.head, avatar.photo.size
    photo, box = avatar.given is None, avatar.face.box.astype(float).tolist()
    return m.Manifest(
        schema_version=m.SCHEMA_VERSION,
        generator=m.Generator(PROGRAM, __version__),
        options=dict(sorted(avatar.options.items())),
        seed=avatar.seed,
        input=m.Input(avatar.photo.sha256, width, height, box, float(avatar.face.score)) if photo else None,
        given=avatar.given,
        camera=_camera(avatar.fit) if photo else None,
        units="m",
        up="+Y",
        forward="+Z",
        head=_taken(
            m.HeadEntry, head, vertices=len(head.mean), polygons=len(head.polygons), parts=list(head.part_names),
            blendshapes=list(head.expression_names), uv_origin="bottom-left",
        ),
        maps=[_map(one, avatar, files[one.path]) for one in MAPS if one.path in files],
        files=[_file(name, files[name]) for name in in_order(files)],
        parts=[m.Part(part.name, part.material.name, part.bone) for part in parts],
        materials=[_material(one, where) for one in {part.material.name: part.material for part in parts}.values()],
        joints=_joints(avatar),
        displacement=m.Displacement(SCALE_MM, MID) if "maps/displacement.png" in files else None,
        reflectance=_reflectance(avatar),
        fit=_fit(avatar) if photo else None,
        hair=None if avatar.hair is None else _hair(avatar.hair),
        effects=[],
        timings_s=None,  # differs from run to run, as memory does
        peak_rss_mb=None,
        models=list(avatar.models),
        warnings=list(avatar.all_warnings()),
        overlay=_overlay(avatar) if photo else None,
        photos=[_used(avatar, one) for one in avatar.sources],
        left_out=list(avatar.left_out),
        beard=None if avatar.beard is None else _beard(avatar.beard),
    )  # fmt: skip


def _taken(kind: type[Section], source: object, **own: Any) -> Section:
    """A section of the manifest from the attributes of ``source`` that are named like its keys, and from ``own``."""
    names = [one.name for one in dataclasses.fields(kind) if one.name not in own]  # type: ignore[arg-type]
    return kind(**{name: _plain(getattr(source, name)) for name in names}, **own)


def _plain(value: Any) -> Any:
    """As JSON values: arrays and tuples as lists, mappings as dictionaries."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    return list(value) if isinstance(value, tuple) else value


def _overlay(avatar: Avatar) -> m.Overlay:
    from service.archive.preview.overlay import crop_box, panel_box

    return m.Overlay(list(crop_box(avatar)), list(panel_box(avatar)))


def _camera(fit: Fit) -> m.CameraEntry:
    return _taken(m.CameraEntry, fit.camera, yaw_pitch_roll_deg=list(fit.camera.yaw_pitch_roll_deg()))


def _used(avatar: Avatar, source: Source) -> m.UsedPhoto:
    stages = (source.photo, source.face, source.fit)
    return m.UsedPhoto(
        sha256=source.photo.sha256,
        face_box=source.face.box.astype(float).tolist(),
        camera=_camera(source.fit),
        landmark_rms_px=float(source.fit.landmark_rms_px),
        used_for=list(source.used_for),
        texture_share=round(min(max(source.share, 0.0), 1.0), 4),
        expression=weights_by_name(avatar.head.expression_names, source.fit.expression),
        warnings=list(dict.fromkeys(code for stage in stages for code in stage.warnings)),
    )


def _map(entry: RegisteredMap, avatar: Avatar, data: bytes) -> m.Map:
    width, height, bits, colour_type = _PNG_HEADER.unpack_from(data, 16)
    wrinkle = wrinkle_of(avatar, entry.name)
    return m.Map(
        path=entry.path,
        role=entry.name,
        colour_space=entry.colour_space,
        bits=bits,
        channels=_PNG_CHANNELS[colour_type],  # type: ignore[arg-type]
        width=width,
        height=height,
        size=len(data),
        sha256=hashlib.sha256(data).hexdigest(),
        frame=frame(entry, avatar),
        coding=m.Coding(*coding(entry, bits), entry.meaning),
        units=None if wrinkle is None else {unit: round(value, 6) for unit, value in wrinkle.units.items()},
    )


def _material(material: Material, where: MapFiles) -> m.MaterialEntry:
    paths = {slot: where.path(one) for slot, one in material.slots.items()}
    maps = {slot: path.removeprefix("../") for slot, path in paths.items() if path is not None}
    return _taken(m.MaterialEntry, material, maps=maps)


def _joints(avatar: Avatar) -> list[m.Joint]:
    made = skeleton(avatar.head, avatar.fit.neutral)
    return [
        m.Joint(name, None if parent < 0 else JOINTS[parent], [round(float(value), 6) for value in position])
        for name, parent, position in zip(JOINTS, PARENTS, made.positions, strict=True)
    ]


def _reflectance(avatar: Avatar) -> m.ReflectanceEntry | None:
    made = avatar.reflectance
    if made is None:
        return None
    return _taken(
        m.ReflectanceEntry,
        made,
        quality=avatar.options.get("quality", "standard"),
        width=made.size[0],
        height=made.size[1],
        engines=dict(sorted(made.engines.items())),
    )


def _file(name: str, data: bytes) -> m.FileEntry:
    stem = name.rpartition("/")[2].partition(".")[0]
    role = MEMBERS.get(name) or (f"texture {stem}" if name.startswith("maps/parts/") else stem)
    return m.FileEntry(name, role, MEDIA_TYPES[name.rpartition(".")[2]], len(data), hashlib.sha256(data).hexdigest())


def _usual_colour(groom: Groom) -> list[float]:
    return [round(float(value), 6) for value in np.median(groom.colour.linear().reshape(-1, 3), 0)]


def _beard(groom: Groom) -> m.Beard:
    length = 1000 * np.median(length_of(groom.strands))
    return m.Beard(strands=len(groom), length_mm=round(float(length), 1), colour=_usual_colour(groom))


def _hair(hair: WornHair) -> m.Hair:
    groom, colour, melanin = hair.groom, None, None
    if groom is not None and len(groom):
        colour = _usual_colour(groom)
        melanin = [round(float(value), 4) for value in np.median(groom.colour.melanin.reshape(-1, 2), 0)]
    return m.Hair(
        kind=hair.kind,
        probabilities={kind: round(share, 4) for kind, share in hair.kinds.items()},
        style=None if groom is None else style_to_json(groom.style),
        strands=0 if groom is None else len(groom),
        agreement=round(hair.agreement, 4),
        seen=round(float(hair.seen.mean()) if len(hair.seen) else 0.0, 4),
        colour=colour,
        melanin=melanin,
        dyed=groom is not None and groom.colour.dyed,
        doubts=list(hair.doubts),
    )


def _fit(avatar: Avatar) -> m.FitReport:
    fit = avatar.fit
    relative = fit.landmark_rms_px / fit.inter_ocular_px if fit.inter_ocular_px > 0 else None
    return _taken(
        m.FitReport,
        fit,
        landmark_rms_px=float(fit.landmark_rms_px),
        landmark_rms_iod=None if relative is None else float(relative),
        visible_fraction=float(avatar.texture.visible_fraction),
        identity_similarity=avatar.similarity,
        light=None if fit.light is None else m.Light("sh9", "camera", fit.light.tolist()),
        gaze=None if fit.gaze is None else _taken(m.GazeEntry, fit.gaze, irises_seen=len(fit.gaze.irises)),
        expression=weights_by_name(avatar.head.expression_names, fit.expression),
    )
