"""Assemble and write the archive of an avatar.

The same photo, options and seed give the same bytes, so nothing here depends on the clock, and measured times and
memory are left out unless ``timings`` requests them.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import BinaryIO

from service.archive.avatar import Avatar
from service.archive.container import write_file, write_stream
from service.archive.describe import describe
from service.archive.fine import fine_obj_bytes
from service.archive.glb import glb_bytes, weights_by_name
from service.archive.images import encode_jpeg
from service.archive.licences import COPYRIGHT, licences_text
from service.archive.manifest import to_json
from service.archive.maps import MAPS, encode_map, fine_mesh_wanted, in_object_space
from service.archive.obj import mtl_bytes, obj_bytes
from service.archive.pictures import colours, normal_picture, specular_picture
from service.archive.usd import usda_bytes
from service.archive.version import GENERATOR
from service.runtime.memory import release


def write_archive(avatar: Avatar, target: Path | BinaryIO, *, timings: bool = False) -> None:
    """Write the archive of ``avatar`` to a file, atomically, or to a binary stream.

    Args:
        avatar: the results of one photo.
        target: a path, or a stream that may be a pipe.
        timings: also write times and memory into the manifest; the bytes then differ from run to run.

    Raises:
        OutputFault: the file or the stream could not be written.
        NumericFault: a result holds NaN or infinity.
    """
    members = archive_members(avatar, timings=timings)
    try:
        if isinstance(target, Path):
            write_file(target, members)
        else:
            write_stream(target, members)
    finally:
        release()  # else fragmented memory accumulates in a process that makes many avatars


def archive_members(avatar: Avatar, *, timings: bool = False) -> dict[str, bytes]:
    """Name -> content of every file of the archive; see :func:`write_archive`."""
    with ThreadPoolExecutor(2) as pool:
        previews = pool.submit(_previews, avatar)
        files = _maps(avatar) | _meshes(avatar) | {"LICENSES.md": licences_text(avatar).encode()}
        files |= previews.result()
    files["manifest.json"] = to_json(describe(avatar, files, timings=timings))
    return files


def _maps(avatar: Avatar) -> dict[str, bytes]:
    """PNG bytes by path; on two threads, as compression takes most of the time and releases the GIL."""
    wanted = [spec for spec in MAPS if _wanted(avatar, spec.role)]
    with ThreadPoolExecutor(2) as pool:
        packed = pool.map(lambda spec: encode_map(spec, avatar), wanted)
        return {spec.path: data for spec, data in zip(wanted, packed, strict=True) if data is not None}


def _wanted(avatar: Avatar, role: str) -> bool:
    """Whether the options request a map; without a list they request all."""
    chosen = avatar.options.get("maps")
    return chosen is None or role in chosen


def _meshes(avatar: Avatar) -> dict[str, bytes]:
    head, fit, made = avatar.head, avatar.fit, avatar.reflectance
    title = f"{GENERATOR}: {head.name} {'with maps of its own' if avatar.given else 'fitted to a photo'}"
    albedo = made is not None and made.diffuse_albedo is not None
    role = "diffuse_albedo" if albedo and _wanted(avatar, "diffuse_albedo") else "texture"
    textured, texture = _wanted(avatar, role), f"../maps/{role}.png"
    has_normals = made is not None and made.specular_normal is not None and _wanted(avatar, "specular_normal")
    normal = "../maps/specular_normal.png" if has_normals and not in_object_space(avatar) else None
    glb = glb_bytes(
        head,
        fit.neutral,
        colours(avatar),
        normal=None if made is None else normal_picture(made),
        specular=None if made is None else specular_picture(made),
        generator=GENERATOR,
        copyright_notice=COPYRIGHT,
        expression=weights_by_name(head.expression_names, fit.expression),
        extras={"headModel": head.name, "headModelLicence": head.licence, "units": "metre"},
    )
    files = {
        "mesh/head.obj": obj_bytes(head, fit.vertices, title),
        "mesh/head.mtl": mtl_bytes(head, textured=textured, texture=texture, normal=normal),
        "mesh/head.glb": glb,
        "mesh/head.usda": usda_bytes(head, fit.vertices, title, textured=textured, texture=texture),
    }
    if made is not None and made.displacement is not None and fine_mesh_wanted(avatar):
        files["mesh/head_fine.obj"] = fine_obj_bytes(head, fit.vertices, made.displacement, title)
    return files


def _previews(avatar: Avatar) -> Mapping[str, bytes]:
    from service.archive.preview.overlay import overlay
    from service.archive.preview.sheet import sheet

    pictures = {} if avatar.given else {"preview/overlay.jpg": encode_jpeg(overlay(avatar))}
    return {**pictures, "preview/sheet.jpg": encode_jpeg(sheet(avatar))}
