"""Read an untrusted archive: sizes bounded, contents checked, maps decoded in the photos' decode gate."""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from dataclasses import dataclass, fields
from pathlib import Path
from typing import IO, Any

import numpy as np

from service import manifest as m
from service.archive.container import PART_TEXTURE, ArchiveFile
from service.archive.obj import MAX_BYTES as MAX_OBJ
from service.archive.obj import ObjMesh, read_obj
from service.arrays import UInt8
from service.errors import BadArchive, CorruptImage, NumericFault, UnreadableInput
from service.geometry.mesh import normalise
from service.materials.material import ChartMap, Map, Material, OwnMap
from service.materials.part import MeshPart
from service.photo.container import open_container
from service.photo.gate import decode_container
from service.photo.limits import Limits
from service.photo.wire import Codec, Output
from service.render.surface import StoredMap

MAX_TEXTURE = 64 << 20
"""Bytes of a part's own texture."""
DRAWN = ("colour", "normal", "anisotropy")
"""Slots of materials that a picture needs."""


@dataclass(frozen=True)
class AvatarFile:
    """The contents of an archive that a renderer needs.

    Attributes:
        manifest: as stored; only the keys that are used here were checked.
        mesh: ``mesh/head.obj``, the head's own parts.
        maps: by role.
        parts: meshes beside the head's own, in the photo's expression; of their maps they have ``DRAWN``.
        replaced: the head's own parts in place of which others stand.
    """

    manifest: dict[str, Any]
    mesh: ObjMesh
    maps: dict[str, StoredMap]
    parts: tuple[MeshPart, ...] = ()
    replaced: tuple[str, ...] = ()


def open_avatar(source: Path | IO[bytes], roles: tuple[str, ...]) -> AvatarFile:
    """Read mesh and maps of an archive, a path or a seekable stream; roles that it lacks are left out.

    UsageError: there is no such file. BadArchive: not an avatar's archive, damaged, or unpacks to more than is
    accepted. BadMesh: its mesh cannot be read.
    """
    archive = ArchiveFile.open(source)
    mesh = read_obj(archive.read("mesh/head.obj", MAX_OBJ))
    whole = read_obj(archive.read("mesh/parts.obj", MAX_OBJ)) if "mesh/parts.obj" in archive.names else mesh
    drawn, materials = described_parts(archive.manifest)
    others = [part for part in drawn if part.name not in mesh.part_names and part.name in whole.part_names]
    known: dict[str, Map] = {}
    parts = tuple(_part(archive, whole, part, materials, known) for part in others)
    names = {part.name for part in drawn}
    gone = tuple(name for name in mesh.part_names if names and name not in names)
    listed = {str(item.get("role")): item for item in archive.manifest["maps"]}
    there = [role for role in roles if role in listed and f"maps/{role}.png" in archive.names]
    maps = {role: _stored(role, archive.read(f"maps/{role}.png"), listed[role]) for role in there}
    return AvatarFile(archive.manifest, mesh, maps, parts, gone)


def described_parts(manifest: dict[str, Any]) -> tuple[list[m.Part], dict[str, m.MaterialEntry]]:
    """All parts of the files, and materials by name; none in the manifests of older versions.

    Keys that other versions of the schema have are left out, and so are the parts of clear glass that older archives
    have before their eyes: no material is clear now. BadArchive: one of them is not as the schema says.
    """
    from pydantic import TypeAdapter, ValidationError

    def known(kind: type[Any], given: list[dict[str, Any]]) -> list[dict[str, Any]]:
        return [{field.name: one[field.name] for field in fields(kind) if field.name in one} for one in given]

    try:
        given = manifest.get("materials", [])
        clear = {one["name"] for one in given if one.get("transmission", 0) > 0}
        seen = [one for one in manifest.get("parts", []) if one.get("material") not in clear]
        parts = TypeAdapter(list[m.Part]).validate_python(known(m.Part, seen))
        materials = TypeAdapter(list[m.MaterialEntry]).validate_python(known(m.MaterialEntry, given))
    except (ValidationError, AttributeError, KeyError, TypeError) as error:
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
        raise BadArchive(f"the manifest's parts or materials cannot be used: {why}") from error
    return parts, {one.name: one for one in materials}


def stored_material(
    archive: ArchiveFile, given: m.MaterialEntry, known: dict[str, Map], slots: Collection[str]
) -> Material:
    """A material of an archive, with the maps of some slots ("colour", "normal" and the like).

    ``known`` has maps by path, to which new ones are added; textures of parts' own are decoded, and maps of the chart
    left out where the slots are ``DRAWN``. BadArchive: a value is out of range, or a texture cannot be read.
    """
    maps: dict[str, Any] = {}
    for slot in set(slots) & set(given.maps):
        path = given.maps[slot]
        own = PART_TEXTURE.fullmatch(path) is not None and path.endswith(".png") and path in archive.names
        stem = path.rpartition("/")[2].removesuffix(".png")
        if own and path not in known:
            known[path] = OwnMap(stem, unpack_texture(archive.read(path, MAX_TEXTURE), stem))
        if own or slots != DRAWN:
            maps[f"{slot}_map"] = known[path] if own else ChartMap(stem)
    values = {field.name: getattr(given, field.name) for field in fields(m.MaterialEntry) if field.name != "maps"}
    triples = {name: tuple(value) for name, value in values.items() if isinstance(value, list)}
    try:
        return Material(**values | triples | maps)
    except NumericFault as fault:
        raise BadArchive(f"the material {given.name[:40]!r} of the archive cannot be used: {fault}") from fault


def _part(
    archive: ArchiveFile, whole: ObjMesh, part: m.Part, materials: dict[str, m.MaterialEntry], known: dict[str, Map]
) -> MeshPart:
    if part.material not in materials:
        raise BadArchive(f"the manifest names no material {part.material[:40]!r}, which a part has")
    mesh, material = whole.part(part.name), stored_material(archive, materials[part.material], known, DRAWN)
    points, has_uv = mesh.vertices.astype(np.float32), (mesh.polygon_uv[:, 0] >= 0).all()
    uv, uv_faces = (mesh.uv, mesh.polygon_uv) if has_uv else (np.zeros((len(points), 2)), None)
    normals = None
    if mesh.normals is not None and mesh.normals.any():
        normals = np.asarray(normalise(mesh.normals, (0.0, 1.0, 0.0)), np.float32)
    try:
        return MeshPart(
            part.name, points, points, mesh.polygons, uv.astype(np.float32), material, uv_faces=uv_faces,
            normals=normals,
        )  # fmt: skip
    except NumericFault as fault:
        raise BadArchive(f"the part {part.name[:40]!r} of the archive cannot be used: {fault}") from fault


def _stored(role: str, png: bytes, entry: dict[str, Any]) -> StoredMap:
    try:
        bits, frame, coding = entry["bits"], entry["frame"], entry["coding"]
        zero, scale = float(coding["zero"]), float(coding["scale"])
        if (
            bits not in (8, 16)
            or frame not in (None, "object", "tangent")
            or not 0 < scale < 1e6
            or not 0 <= zero < 1e6
        ):
            raise ValueError(f"bits {bits!r}, frame {frame!r}, zero {zero}, scale {scale}")
    except (KeyError, TypeError, ValueError) as error:
        raise BadArchive(f"the manifest's entry of the map {role} cannot be used: {error}") from error
    changed = hashlib.sha256(png).hexdigest() != entry.get("sha256")
    return StoredMap(lambda: unpack_map(png, role), bits, zero, scale, frame, changed)


LIMITS = Limits(
    max_bytes=512 << 20, min_side=8, max_side=8192, max_pixels=40_000_000, max_aspect=2.0, cpu_seconds=60,
    wall_seconds=120.0,
)  # fmt: skip
"""A map of 6144 x 4096 takes a second to decode, more on a busy machine."""


def unpack_map(png: bytes, name: str) -> UInt8:
    """(H, W, 3) uint8 codes of a PNG, 3:2; grey has three equal channels, 16-bit codes are rounded: code / 257.

    BadArchive: not a PNG, damaged, or of another shape; names the map.
    """
    codes = _decoded(png, name, Output.CODES)
    if codes.shape[1] * 2 != codes.shape[0] * 3:
        raise BadArchive(f"the map {name} is {codes.shape[1]}x{codes.shape[0]}; the chart is 3:2", map=name)
    return codes


def unpack_texture(png: bytes, name: str) -> UInt8:
    """(h, w, 4) uint8 sRGB with straight alpha of a part's own texture of any shape; (h, w, 3) where it is opaque.

    BadArchive: not a PNG, or damaged; names the texture.
    """
    codes = _decoded(png, name, Output.CODES_AND_ALPHA)
    return codes if (codes[..., 3] < 255).any() else codes[..., :3]


def _decoded(png: bytes, name: str, output: Output) -> UInt8:
    """(h, w, 3 or 4) uint8 codes: maps are data, to which gamma, colour profile and EXIF turn must not be applied."""
    try:
        container = open_container(png, LIMITS)
        if container.codec != Codec.PNG:
            raise CorruptImage("it is not a PNG")
        reply, raw = decode_container(container, LIMITS, output)
    except UnreadableInput as error:
        raise BadArchive(f"the map {name} cannot be read: {error.message}", map=name) from error
    return np.frombuffer(raw, np.uint8).reshape(reply.height, reply.width, output.channels)
