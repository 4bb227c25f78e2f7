"""Materials and textures of a glTF file (glTF 2.0 section 3.9; KHR_materials_specular, _ior, _transmission)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from service.archive.gltf import GltfWriter
from service.archive.images import encode_jpeg, encode_png
from service.arrays import UInt8
from service.materials.material import WHITE, ChartMap, Map, Material, OwnMap

Object = dict[str, Any]
Slot = Literal["colour", "roughness", "specular", "normal", "cavity"]

SPECULAR, IOR, TRANSMISSION = "KHR_materials_specular", "KHR_materials_ior", "KHR_materials_transmission"

DEFAULT_IOR = 1.5
JPEG_QUALITY = 92
"""Of colours without alpha; ``maps/`` has all of them without loss."""

_LINEAR, _MIPMAPS, _CLAMP = 9729, 9987, 33071


@dataclass(frozen=True)
class Picture:
    """An encoded texture: ``data`` in format ``mime`` ("image/png" or "image/jpeg")."""

    data: bytes
    mime: str


class Materials:
    """Collects the materials of a file and the textures that they use."""

    def __init__(self, writer: GltfWriter, charts: Mapping[str, Picture]) -> None:
        """For a file.

        Args:
            writer: takes the pictures.
            charts: maps of the chart by role, in glTF's coding: specular albedo in alpha, roughness in green, cavity
                in red; roles that share a picture share a texture.
        """
        self._writer = writer
        self._charts = charts
        self._written: list[Object] = []
        self._names: dict[str, int] = {}
        self._textures: list[Object] = []
        self._images: list[Object] = []
        self._known: dict[tuple[int, str], int] = {}
        self._extensions: set[str] = set()

    def has_normals(self, material: Material) -> bool:
        """Whether its normal map is there."""
        one = material.normal_map
        return isinstance(one, OwnMap) or (one is not None and one.role in self._charts)

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
        if material.transmission > 0:
            found[TRANSMISSION] = {"transmissionFactor": material.transmission}
        return found

    def _put(self, into: Object, key: str, one: Map | None, slot: Slot) -> bool:
        """Reference a texture under ``key`` where there is one."""
        index = None if one is None else self._texture(one, slot)
        if index is not None:
            into[key] = {"index": index}
        return index is not None

    def _texture(self, one: Map, slot: Slot) -> int | None:
        if isinstance(one, ChartMap):
            picture = self._charts.get(one.role)
            return None if picture is None else self._image(one.role, "", picture)
        if (id(one), slot) in self._known:
            return self._known[id(one), slot]
        return self._image(one.name, slot, _encoded(packed(one.pixels, slot), slot), id(one))

    def _image(self, name: str, slot: str, picture: Picture, key: int | None = None) -> int:
        key = id(picture) if key is None else key
        if (key, slot) not in self._known:
            view = self._writer.add_raw(picture.data)
            self._images.append({"name": name, "mimeType": picture.mime, "bufferView": view})
            self._textures.append({"name": name, "source": len(self._images) - 1, "sampler": 0})
            self._known[key, slot] = len(self._textures) - 1
        return self._known[key, slot]


def _encoded(pixels: UInt8, slot: Slot) -> Picture:
    if slot == "colour" and pixels.shape[2] == 3:
        return Picture(encode_jpeg(pixels, JPEG_QUALITY), "image/jpeg")
    return Picture(encode_png(pixels, srgb=slot == "colour", level=7), "image/png")


def packed(pixels: UInt8, slot: Slot) -> UInt8:
    """A texture (h, w), (h, w, 3) or (h, w, 4) in the channels where glTF reads it: (h, w, 3 or 4).

    Specular is in alpha, roughness in green, cavity in red; of several channels the first counts.
    """
    if slot in ("colour", "normal"):
        return pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, 2)
    values = pixels if pixels.ndim == 2 else pixels[..., 0]
    channels = np.full((*values.shape, 4 if slot == "specular" else 3), 255, np.uint8)
    channels[..., {"cavity": 0, "roughness": 1, "specular": 3}[slot]] = values
    if slot == "roughness":
        channels[..., 2] = 0  # metallic
    return channels
