"""What a kit takes from an archive: files, materials, meshes with their blendshapes, and the photo's light."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from service.archive.container import ArchiveFile
from service.archive.images import exr_bytes
from service.archive.reading import described_parts, stored_material, unpack_map
from service.archive.usd import REST, read_meshes
from service.archive.usd_text import Prim
from service.arrays import Float32, Float64, Int32
from service.colour import bytes_to_linear
from service.errors import BadArchive, NumericFault, OutputFault
from service.image_filters import shrunk
from service.light.formulas import basis
from service.manifest import Part
from service.materials.material import Map, Material
from service.materials.part import MeshPart


def opened(path: Path) -> ArchiveFile:
    """An archive that has what kits are made of; UsageError where there is no such file.

    BadArchive: not an archive of this program, or of a version without materials and joints.
    """
    archive = ArchiveFile.open(path)
    if any(name not in archive.manifest for name in ("materials", "joints", "parts", "head")):
        raise BadArchive("the manifest has no materials and joints: made by an older version; make it anew")
    return archive


def extract(archive: ArchiveFile, folder: Path, prefixes: tuple[str, ...]) -> list[Path]:
    """Write the files under some prefixes into a folder, under their names; returns where they are.

    BadArchive: one is damaged. OutputFault: one could not be written.
    """
    names = [name for name in archive.names if name.startswith(prefixes)]
    for name in names:
        write(folder / name, archive.read(name))
    return [folder / name for name in names]


def write(path: Path, data: bytes) -> None:
    """Write a file, and the folders that it needs; OutputFault where that fails."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    except OSError as error:
        raise OutputFault(f"cannot write {path}: {error.strerror or error}", path=str(path)) from error


def materials_of(source: ArchiveFile) -> dict[str, Material]:
    """Materials by name, with all their maps; textures of parts' own are decoded.

    BadArchive: the manifest's materials are not as they should be, or a texture cannot be read.
    """
    known: dict[str, Map] = {}
    materials = described_parts(source.manifest)[1]
    return {name: stored_material(source, one, known, one.maps) for name, one in materials.items()}


MOST_USD_BYTES = 256 << 20


def read_parts(data: bytes, manifest: Mapping[str, Any], materials: Mapping[str, Material]) -> list[MeshPart]:
    """Parts of ``mesh/head.usda`` in their neutral pose; ``vertices`` is neutral too.

    The manifest says which material and which bone each part has. BadArchive: the file is not as the archive's.
    """
    if len(data) > MOST_USD_BYTES:
        raise BadArchive(f"mesh/head.usda has {len(data)} bytes; at most {MOST_USD_BYTES} are accepted")
    try:
        known = {part.name: part for part in described_parts(dict(manifest))[0]}
        return [_part(mesh, known[mesh.name], materials) for mesh in read_meshes(data)]
    except (UnicodeDecodeError, KeyError, ValueError, IndexError, TypeError, NumericFault) as error:
        raise BadArchive(f"mesh/head.usda of the archive cannot be read: {error}") from error


def _part(mesh: Prim, facts: Part, materials: Mapping[str, Material]) -> MeshPart:
    points = _rows(mesh, "point3f[] points", 3)
    counts, corners = _whole(mesh, "int[] faceVertexCounts"), _whole(mesh, "int[] faceVertexIndices")
    places = _whole(mesh, "int[] primvars:st:indices") if "int[] primvars:st:indices" in mesh.values else corners
    targets = {}
    for shape in mesh.children:
        if shape.name != REST:
            targets[shape.name] = np.zeros_like(points)
            moved = _whole(shape, "uniform int[] pointIndices")
            targets[shape.name][moved] = _rows(shape, "uniform vector3f[] offsets", 3)
    return MeshPart(
        name=mesh.name,
        vertices=points,
        neutral=points,
        faces=_polygons(counts, corners),
        uv=_rows(mesh, "texCoord2f[] primvars:st", 2),
        uv_faces=_polygons(counts, places),
        material=materials[facts.material],
        targets=targets,
        bone=facts.bone,
        normals=_rows(mesh, "normal3f[] normals", 3) if materials[facts.material].anisotropy > 0 else None,
    )


def _polygons(counts: Int32, flat: Int32) -> Int32:
    polygons = np.full((len(counts), 4), -1, np.int32)
    polygons[np.arange(4) < counts[:, None]] = flat
    return polygons


def _rows(prim: Prim, key: str, width: int) -> Float32:
    return np.array(_words(prim, key), np.float64).reshape(-1, width).astype(np.float32)


def _whole(prim: Prim, key: str) -> Int32:
    return np.array(_words(prim, key), np.int32)


def _words(prim: Prim, key: str) -> list[str]:
    """The numbers of an array."""
    text = (prim.values[key] or "").strip("[]").replace("(", "").replace(")", "")
    return text.split(",") if text else []


SIZE = (128, 64)
"""Width and height of the environment: nine harmonics have nothing finer."""

LEAST_SKIN = 50
"""Fewest texels of lit skin from which its albedo is estimated."""


def kit_facts(archive: ArchiveFile) -> dict[str, Any]:
    """What ``kit.json`` says of the head in every kit; BadArchive where the manifest has other things in its places."""
    manifest = archive.manifest
    named = {name: manifest.get(name) for name in ("parts", "materials", "joints", "displacement", "camera")}
    try:
        folds = [one for one in manifest["maps"] if one.get("units")]
        wrinkles = {one["role"]: {"path": one["path"], "units": one["units"]} for one in folds}
        expression = dict((manifest.get("fit") or {}).get("expression", {}))
        return {"units": manifest["head"]["blendshapes"], "expression": expression, "wrinkles": wrinkles, **named}
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise BadArchive(f"the head, the fit or a map of the manifest cannot be used: {error}") from error


def write_light(archive: ArchiveFile, folder: Path) -> list[Path]:
    """The photo's light as ``photo_light.exr`` in a folder; returns its path, or nothing where the photo gave none.

    It is the radiance around the head, equirectangular, Z up as in Blender. Column 0 is -X; the middle looks along +X,
    and -Y, where the face looks in a Z-up world, is at three quarters.
    """
    fit, camera = archive.manifest.get("fit"), archive.manifest.get("camera")
    light = fit.get("light") if isinstance(fit, dict) else None
    if not isinstance(light, dict) or not isinstance(camera, dict):
        return []
    try:
        coefficients = np.array(light["coefficients"], np.float64).reshape(9, 3) / _skin(archive)
        turn = np.array(camera["rotation"], np.float64).reshape(3, 3)
    except (KeyError, TypeError, ValueError) as error:
        raise BadArchive(f"the camera or the light of the manifest cannot be used: {error}") from error
    width, height = SIZE
    longitude = np.pi * (1 - 2 * (np.arange(width) + 0.5) / width)
    latitude = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    around, up = np.meshgrid(longitude, latitude)
    z_up = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], -1)
    head = np.stack([z_up[..., 0], z_up[..., 2], -z_up[..., 1]], -1)
    radiance = np.einsum("...k,kc->...c", basis(head @ turn.T), coefficients)
    if not np.all(np.abs(radiance) < 1e6):  # the most of a scene; also where it is no number
        raise BadArchive("the camera or the light of the manifest cannot be used: it is not finite")
    write(folder / "photo_light.exr", exr_bytes(np.maximum(radiance, 0).astype(np.float32)))
    return [folder / "photo_light.exr"]


def _skin(source: ArchiveFile) -> Float64:
    """(3,) albedo that the light of the manifest, which has the skin's colour in it, has to be divided by.

    The light is scaled so that skin of luminance 1 is seen; the photo's is the albedo's colour in it.
    """
    needed = ("maps/diffuse_albedo.png", "maps/texture.png", "maps/confidence.png")
    if any(name not in source.names for name in needed):
        return np.ones(3)
    small = (shrunk(unpack_map(source.read(name), "map"), (192, 128)) for name in needed)
    albedo, texture, confidence = (codes * np.float32(1 / 255) for codes in small)
    lit = confidence[..., 0] >= 0.6
    if lit.sum() < LEAST_SKIN:
        return np.ones(3)
    shown, own = (bytes_to_linear(np.rint(one * 255).astype(np.uint8))[lit].mean(0) for one in (texture, albedo))
    luminance = float(shown @ np.array([0.2126, 0.7152, 0.0722]))
    return np.asarray(np.maximum(own, 0.01) / max(luminance, 0.01), np.float64)
