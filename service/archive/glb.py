"""``mesh/head.glb``: the neutral head with its blendshapes as morph targets (glTF 2.0).

trimesh writes no morph targets, so the file is assembled here. glTF has metres, +Y up, the face towards +Z, and v
increasing downwards, so only v changes. Every part is a separate mesh with the same list of targets (names in
``mesh.extras.targetNames``), so one set of weights drives all of them. Parts with a normal map have the tangents that
it refers to: along u, made orthogonal to the normal. Arrays of a kind share one buffer view: that keeps the JSON small.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from service import GENERATOR
from service.archive.images import SIGNATURE, Rows, encode_jpeg, encode_png_rows
from service.archive.surfaces import Piece
from service.arrays import AnyFloat, AnyInt, Float32, UInt8
from service.materials.material import WHITE, ChartMap, Map, Material, OwnMap
from service.materials.part import MeshPart

Object = dict[str, Any]

_FLOAT, _UINT16, _UINT32 = 5126, 5123, 5125
_ARRAY_BUFFER, _ELEMENT_BUFFER = 34962, 34963


@dataclass
class GltfWriter:
    """Collects the binary part of a glTF file and the accessors into it."""

    accessors: list[Object] = field(default_factory=list)
    chunks: dict[str, list[bytes]] = field(default_factory=dict)
    sizes: dict[str, int] = field(default_factory=dict)
    zeros: dict[tuple[int, bool], int] = field(default_factory=dict)

    def add_raw(self, data: bytes) -> int:
        """A separate buffer view for bytes without an accessor."""
        view, _ = self._append(f"raw{len(self.chunks)}", data)
        return view

    def add_vertices(self, rows: AnyFloat, *, bounds: bool = False) -> int:
        """Accessor of (N, 2), (N, 3) or (N, 4) float32 vertex data."""
        data = np.ascontiguousarray(rows, "<f4")
        view, offset = self._append(f"vec{data.shape[1]}", data.tobytes())
        return self._accessor(data, bounds, {"bufferView": view, "byteOffset": offset})

    def add_indices(self, triangles: AnyInt, vertex_count: int) -> int:
        """Accessor of triangle corners, 16-bit where possible (index 65535 would restart the primitive)."""
        wide = vertex_count > 0xFFFF
        kind, code = (_UINT32, "<u4") if wide else (_UINT16, "<u2")
        data = np.ascontiguousarray(triangles.ravel(), code)
        view, offset = self._append(f"indices{code}", data.tobytes())
        accessor = {"bufferView": view, "byteOffset": offset, "componentType": kind, "count": len(data)}
        self.accessors.append({**accessor, "type": "SCALAR"})
        return len(self.accessors) - 1

    def add_offsets(self, rows: Float32, *, bounds: bool = False) -> int:
        """Accessor of (N, 3) morph offsets: without data if all are zero, sparse where that is smaller."""
        moved = np.flatnonzero((rows[:, 0] != 0) | (rows[:, 1] != 0) | (rows[:, 2] != 0))
        if not len(moved):
            return self._zeros(len(rows), bounds)
        wide = len(rows) > 0xFFFF
        if len(moved) * (12 + (4 if wide else 2)) >= len(rows) * 12:
            return self.add_vertices(rows, bounds=bounds)
        values = np.ascontiguousarray(rows[moved], "<f4")
        value_view, value_offset = self._append("sparse_values", values.tobytes())
        kind, code = (_UINT32, "<u4") if wide else (_UINT16, "<u2")
        index_view, index_offset = self._append(f"sparse_indices{code}", moved.astype(code).tobytes())
        sparse = {
            "count": len(moved),
            "indices": {"bufferView": index_view, "byteOffset": index_offset, "componentType": kind},
            "values": {"bufferView": value_view, "byteOffset": value_offset},
        }
        return self._accessor(rows, bounds, {"sparse": sparse})

    def finish(self, document: Object) -> bytes:
        """The GLB: header, JSON chunk padded with spaces, binary chunk padded with zeros."""
        offset, views = 0, []
        for name, size in self.sizes.items():
            view: Object = {"buffer": 0, "byteOffset": offset, "byteLength": size}
            views.append(view | _view_facts(name))
            offset += size + -size % 4
        content = document | {
            "accessors": self.accessors,
            "bufferViews": views,
            "buffers": [{"byteLength": offset}],
        }
        text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        padded = ((*self.chunks[name], b"\0" * (-size % 4)) for name, size in self.sizes.items())
        binary = b"".join(chunk for chunks in padded for chunk in chunks)
        total = 12 + 8 + len(text) + 8 + len(binary)
        head = struct.pack("<4sII", b"glTF", 2, total) + struct.pack("<I4s", len(text), b"JSON")
        return b"".join((head, text, struct.pack("<I4s", len(binary), b"BIN\0"), binary))

    def _zeros(self, count: int, bounds: bool) -> int:
        key = (count, bounds)
        if key not in self.zeros:
            self.zeros[key] = self._accessor(np.zeros((count, 3), np.float32), bounds, {})
        return self.zeros[key]

    def _accessor(self, rows: AnyFloat, bounds: bool, source: Object) -> int:
        facts: Object = {"componentType": _FLOAT, "count": len(rows), "type": f"VEC{rows.shape[1]}"}
        if bounds:
            facts |= {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        self.accessors.append(source | facts)
        return len(self.accessors) - 1

    def _append(self, view: str, data: bytes) -> tuple[int, int]:
        """Index of the view and the offset of ``data`` in it, both multiples of four bytes."""
        if view not in self.chunks:
            self.chunks[view], self.sizes[view] = [], 0
        padding = b"\0" * (-self.sizes[view] % 4)
        offset = self.sizes[view] + len(padding)
        self.chunks[view] += [padding, data]
        self.sizes[view] = offset + len(data)
        return list(self.sizes).index(view), offset


def _view_facts(name: str) -> Object:
    """Shared vertex data needs target and stride, indices a target; sparse data and images must have neither."""
    if name.startswith("vec"):
        return {"target": _ARRAY_BUFFER, "byteStride": 4 * int(name[3:])}
    return {"target": _ELEMENT_BUFFER} if name.startswith("indices") else {}


Slot = Literal["colour", "roughness", "specular", "normal", "cavity", "anisotropy"]

SPECULAR, IOR = "KHR_materials_specular", "KHR_materials_ior"
ANISOTROPY = "KHR_materials_anisotropy"

COPYRIGHT = "No rights are claimed by the makers of this program; those of the person shown remain. See LICENSES.md"
DEFAULT_IOR = 1.5
JPEG_QUALITY = 92
"""Of colours without alpha; ``maps/`` has all of them without loss."""

_LINEAR, _MIPMAPS, _CLAMP = 9729, 9987, 33071


@dataclass(eq=False)
class GltfMaterials:
    """Collects the materials of a file and the textures that they use.

    Attributes:
        writer: takes the pictures.
        charts: PNG or JPEG of the chart's maps by role, in glTF's coding: specular albedo in alpha, roughness in green,
            cavity in red; roles that share a picture share a texture.
        own: PNG of parts' own textures by name, taken as they are where glTF reads the same channels.
    """

    writer: GltfWriter
    charts: Mapping[str, bytes]
    own: Mapping[str, bytes]
    _written: list[Object] = field(default_factory=list)
    _names: dict[str, int] = field(default_factory=dict)
    _textures: list[Object] = field(default_factory=list)
    _images: list[Object] = field(default_factory=list)
    _known: dict[tuple[int, str], int] = field(default_factory=dict)
    _extensions: set[str] = field(default_factory=set)

    def has_normals(self, material: Material) -> bool:
        """Whether its normal map is there."""
        one = material.normal_map
        return isinstance(one, OwnMap) or (one is not None and one.role in self.charts)

    def add(self, material: Material) -> int:
        """Index of the material, written at the first call."""
        if material.name not in self._names:
            self._names[material.name] = len(self._written)
            self._written.append(self._material(material))
        return self._names[material.name]

    def document(self) -> Object:
        """Keys of the glTF document."""
        document: Object = {
            "materials": self._written,
            "textures": self._textures,
            "samplers": [{"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": _CLAMP, "wrapT": _CLAMP}],
            "images": self._images,
            "extensionsUsed": sorted(self._extensions),
        }
        return {key: value for key, value in document.items() if value and (key != "samplers" or self._textures)}

    def _material(self, material: Material) -> Object:
        surface: Object = {"metallicFactor": 0.0, "roughnessFactor": material.roughness}
        self._put(surface, "baseColorTexture", material.colour_map, "colour")
        if self._put(surface, "metallicRoughnessTexture", material.roughness_map, "roughness"):
            surface["roughnessFactor"] = 1.0
        if material.colour != WHITE or material.opacity < 1:
            surface["baseColorFactor"] = [*material.colour, material.opacity]
        written: Object = {"name": material.name, "pbrMetallicRoughness": surface}
        self._put(written, "normalTexture", material.normal_map, "normal")
        self._put(written, "occlusionTexture", material.cavity_map, "cavity")
        if material.alpha != "opaque":
            written["alphaMode"] = material.alpha.upper()
        if material.alpha == "mask":
            written["alphaCutoff"] = material.cutoff
        if material.double_sided:
            written["doubleSided"] = True
        if any(isinstance(one, ChartMap) for one in material.maps):
            written["extras"] = {"chart": True}  # texture coordinates are those of maps/
        extensions = self._extended(material)
        if extensions:
            written["extensions"] = extensions
            self._extensions |= set(extensions)
        return written

    def _extended(self, material: Material) -> Object:
        specular: Object = {}
        self._put(specular, "specularTexture", material.specular_map, "specular")
        if material.specular < 1 and not specular:
            specular["specularFactor"] = material.specular
        found: Object = {SPECULAR: specular} if specular else {}
        if material.ior != DEFAULT_IOR:
            found[IOR] = {"ior": material.ior}
        if material.anisotropy > 0:
            found[ANISOTROPY] = {"anisotropyStrength": material.anisotropy}
            self._put(found[ANISOTROPY], "anisotropyTexture", material.anisotropy_map, "anisotropy")
        return found

    def _put(self, into: Object, key: str, one: Map | None, slot: Slot) -> bool:
        """Reference a texture under ``key`` where there is one."""
        index = None if one is None else self._texture(one, slot)
        if index is not None:
            into[key] = {"index": index}
        return index is not None

    def _texture(self, one: Map, slot: Slot) -> int | None:
        if isinstance(one, ChartMap):
            picture = self.charts.get(one.role)
            return None if picture is None else self._image(one.role, "", picture)
        if (id(one), slot) in self._known:
            return self._known[id(one), slot]
        pixels = packed(one.pixels, slot)
        whole = pixels is one.pixels and one.name in self.own and not _as_jpeg(pixels, slot)
        picture = self.own[one.name] if whole else _encoded(pixels, slot)
        return self._image(one.name, slot, picture, id(one))

    def _image(self, name: str, slot: str, picture: bytes, key: int | None = None) -> int:
        key = id(picture) if key is None else key
        if (key, slot) not in self._known:
            view = self.writer.add_raw(picture)
            kind = "image/png" if picture.startswith(SIGNATURE) else "image/jpeg"
            self._images.append({"name": name, "mimeType": kind, "bufferView": view})
            self._textures.append({"name": name, "source": len(self._images) - 1, "sampler": 0})
            self._known[key, slot] = len(self._textures) - 1
        return self._known[key, slot]


def _as_jpeg(pixels: UInt8, slot: Slot) -> bool:
    return slot == "colour" and pixels.shape[2] == 3


def _encoded(pixels: UInt8, slot: Slot) -> bytes:
    if _as_jpeg(pixels, slot):
        return encode_jpeg(pixels, JPEG_QUALITY)
    return encode_png_rows(Rows.of(pixels), srgb=slot == "colour")


def packed(pixels: UInt8, slot: Slot) -> UInt8:
    """A texture (h, w), (h, w, 3) or (h, w, 4) in the channels where glTF reads it: (h, w, 3 or 4).

    Specular is in alpha, roughness in green, cavity in red; of several channels the first counts.
    """
    if slot in ("colour", "normal", "anisotropy"):
        return pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, 2)
    values = pixels if pixels.ndim == 2 else pixels[..., 0]
    channels = np.full((*values.shape, 4 if slot == "specular" else 3), 255, np.uint8)
    channels[..., {"cavity": 0, "roughness": 1, "specular": 3}[slot]] = values
    if slot == "roughness":
        channels[..., 2] = 0  # metallic
    return channels


def chart_textures(
    colour: UInt8,
    normal: UInt8 | None = None,
    specular: UInt8 | None = None,
    roughness: UInt8 | None = None,
    cavity: UInt8 | None = None,
) -> dict[str, bytes]:
    """Textures of the chart by role, each (h, w, 3) or (h, w) in the channels where glTF reads it.

    Normals are of tangent space, +Y up. Specular albedo is in alpha (KHR_materials_specular): the factor scales F0 =
    0.04 of the default index of refraction, as the map does. Roughness and cavity are one picture.
    """
    found = {"diffuse_albedo": _encoded(colour, "colour")}
    if roughness is not None:
        channels = packed(roughness, "roughness")
        channels[..., 0] = 255 if cavity is None else cavity
        found["roughness"] = _encoded(channels, "roughness")
        if cavity is not None:
            found["cavity"] = found["roughness"]
    if normal is not None:
        found["specular_normal"] = _encoded(normal, "normal")
    if specular is not None:
        found["specular_albedo"] = _encoded(packed(specular, "specular"), "specular")
    return found


def glb_bytes(
    parts: Sequence[MeshPart],
    charts: Mapping[str, bytes],
    *,
    units: Sequence[str],
    expression: Mapping[str, float],
    head: str,
    licence: str,
    own: Mapping[str, bytes] | None = None,
) -> bytes:
    """Binary glTF of a head in its neutral pose, as all morph weights are zero.

    Args:
        parts: meshes in the order of the file; those of opacity 0 are left out.
        charts: PNG or JPEG of the chart's maps by role, in glTF's coding.
        units: names of the blendshapes, in the order of the targets.
        expression: weight of each blendshape in the photo, kept in ``extras.expressionWeights``.
        head: name of the head model, in ``asset.extras``.
        licence: of the head model, likewise.
        own: PNG of parts' own textures by name, where they are encoded already.
    """
    writer = GltfWriter()
    materials = GltfMaterials(writer, charts, own or {})
    drawn = [part for part in parts if part.material.opacity > 0]
    meshes = [_mesh(writer, Piece.of(part), units, materials) for part in drawn]
    nodes: list[Object] = [{"name": part.name, "mesh": index} for index, part in enumerate(drawn)]
    weights = {name: round(float(expression.get(name, 0.0)), 6) for name in units}
    nodes.append({"name": "head", "children": list(range(len(drawn))), "extras": {"expressionWeights": weights}})
    document: Object = {
        "asset": {
            "version": "2.0",
            "generator": GENERATOR,
            "copyright": COPYRIGHT,
            "extras": {"headModel": head, "headModelLicence": licence, "units": "metre"},
        },
        "scene": 0,
        "scenes": [{"name": "avatar", "nodes": [len(drawn)]}],
        "nodes": nodes,
        "meshes": meshes,
        **materials.document(),
    }
    return writer.finish(document)


def _mesh(writer: GltfWriter, piece: Piece, units: Sequence[str], materials: GltfMaterials) -> Object:
    flipped = np.stack([piece.uv[:, 0], 1 - piece.uv[:, 1]], 1)
    material = piece.part.material
    primitive: Object = {
        "attributes": {
            "POSITION": writer.add_vertices(piece.part.neutral[piece.vertex], bounds=True),
            "NORMAL": writer.add_vertices(piece.normal),
            "TEXCOORD_0": writer.add_vertices(flipped),
        },
        "indices": writer.add_indices(piece.triangles, len(piece.vertex)),
        "material": materials.add(material),
        "mode": 4,
    }
    if materials.has_normals(material):
        primitive["attributes"]["TANGENT"] = writer.add_vertices(piece.tangents())
    mesh: Object = {"name": piece.part.name, "primitives": [primitive]}
    if units:
        primitive["targets"] = [
            {"POSITION": writer.add_offsets(position, bounds=True), "NORMAL": writer.add_offsets(turned)}
            for position, turned in piece.offsets(units)
        ]
        mesh["weights"] = [0.0] * len(units)
        mesh["extras"] = {"targetNames": list(units)}
    return mesh


def weights_by_name(names: Sequence[str], values: AnyFloat) -> dict[str, float]:
    """Non-zero blendshape weights of a fit by name."""
    return {name: float(value) for name, value in zip(names, values, strict=True) if value != 0}
