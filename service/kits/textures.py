"""Maps of the chart in the packing of an engine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from service.archive.gltf_materials import Picture
from service.archive.images import NORMAL_SCALE, NORMAL_ZERO, encode_jpeg, encode_png
from service.archive.unpack import unpack_map
from service.arrays import UInt8
from service.kits.unpacked import Source

LARGEST = 4096
IN_GLB = 2048
"""Largest sides of textures as files, and in the GLBs."""


@dataclass
class Charts:
    """Maps of the chart of an archive, decoded when they are needed, square: engines want powers of two.

    Attributes:
        source: the archive.
        largest: side of the textures at most; less where the maps are smaller.
    """

    source: Source
    largest: int = LARGEST
    _read: dict[str, UInt8] = field(default_factory=dict)

    def has(self, role: str) -> bool:
        """Whether there is such a map."""
        return f"maps/{role}.png" in self.source.names

    def codes(self, role: str) -> UInt8:
        """(n, n, 3) uint8 codes, n a power of two: the height of the map, or the next lower one."""
        if role not in self._read:
            self._read[role] = _square(unpack_map(self.source.read(f"maps/{role}.png"), role), self.largest)
        return self._read[role]

    @property
    def colour(self) -> str:
        """Role of the colours."""
        return "diffuse_albedo" if self.has("diffuse_albedo") else "texture"

    def normal(self, *, up: bool) -> UInt8:
        """Specular normals as 127.5 (1 + n), green up as in OpenGL, or down as in DirectX."""
        vectors = (self.codes("specular_normal").astype(np.float32) - NORMAL_ZERO) / np.float32(NORMAL_SCALE)
        if not up:
            vectors[..., 1] *= -1
        length = np.sqrt(np.maximum(np.einsum("hwc,hwc->hw", vectors, vectors), 1e-6))[..., None]
        return np.asarray(np.rint(127.5 * (1 + vectors / length)).clip(0, 255), np.uint8)

    def packed(self, channels: Mapping[str, float | Callable[[UInt8], UInt8]], order: tuple[str | int, ...]) -> UInt8:
        """Channels of several maps in one picture.

        Args:
            channels: role -> what is done to its codes, or the value in [0, 1] where there is no such map.
            order: of each channel of the result a role, or a code.
        """
        side = next((self.codes(role).shape[0] for role in order if isinstance(role, str) and self.has(role)), 1)
        planes = []
        for role in order:
            if isinstance(role, int):
                planes.append(np.full((side, side), role, np.uint8))
                continue
            value = channels.get(role, 1.0)
            if self.has(role):
                codes = _square(self.codes(role), side)[..., 0]
                planes.append(value(codes) if callable(value) else codes)
            else:
                constant = value if isinstance(value, float) else 1.0
                planes.append(np.full((side, side), round(255 * constant), np.uint8))
        return np.stack(planes, -1)


def glb_charts(charts: Charts) -> dict[str, Picture]:
    """Textures of the chart for ``service.archive.glb``, no larger than ``IN_GLB``, by role."""
    small = Charts(charts.source, IN_GLB, {role: _square(codes, IN_GLB) for role, codes in charts._read.items()})
    found = {"diffuse_albedo": Picture(encode_jpeg(small.codes(small.colour), 92), "image/jpeg")}
    if small.has("specular_normal"):
        found["specular_normal"] = Picture(encode_png(small.normal(up=True), srgb=False), "image/png")
    if small.has("specular_albedo"):
        alpha = small.packed({}, (255, 255, 255, "specular_albedo"))
        found["specular_albedo"] = Picture(encode_png(alpha, srgb=False), "image/png")
    if small.has("roughness"):
        orm = Picture(encode_png(small.packed({}, ("cavity", "roughness", 0)), srgb=False), "image/png")
        found["roughness"] = orm
        if small.has("cavity"):
            found["cavity"] = orm
    return found


def half(codes: UInt8) -> UInt8:
    """Codes of half the value: Unreal's Specular of 0.5 is F0 = 0.04."""
    return np.asarray((codes.astype(np.uint16) + 1) // 2, np.uint8)


def inverted(codes: UInt8) -> UInt8:
    """255 - code: smoothness of roughness."""
    return np.asarray(255 - codes, np.uint8)


def _square(codes: UInt8, largest: int) -> UInt8:
    import cv2

    side = min(1 << (codes.shape[0].bit_length() - 1), largest)
    if codes.shape[:2] == (side, side):
        return codes
    way = cv2.INTER_AREA if codes.shape[0] > side or codes.shape[1] > side else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(codes, (side, side), interpolation=way))


