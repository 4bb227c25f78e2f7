"""The maps of an archive: their coding and PNG bytes, where they lie, and smaller copies for the meshes."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from service.archive.avatar import Avatar
from service.archive.glb import chart_textures
from service.archive.images import (
    Rows,
    encode_normals8,
    encode_png,
    encode_png_rows,
    normal_coding,
    quantise_normals,
    to_8_bits,
)
from service.arrays import Float32, UInt8, UInt16
from service.image_filters import resized
from service.levels import LEVELS
from service.map_registry import MAPS, WRINKLE, RegisteredMap
from service.materials.material import Map, OwnMap
from service.reflectance.reflectance_maps import MID, NORMAL_ONE, SCALE_MM, Reflectance, Wrinkle, unpack_normals
from service.reflectance.surface_maps import CODES_PER_MM, SurfaceMaps

HEIGHT_STEP = 1 / 128
"""Steps of the displacement, as a share of a texel's side: the slope between texels is then as fine as in the 8-bit
codes of the normals."""
COARSEST_STEP = 32
"""Codes of the coarsest step, 1.6 micrometres."""
CHART_MM = 410.0
"""Width of the chart at its scale on the face, 15 texels per mm at 6144 (``python -m models.head.report``)."""


def coding(entry: RegisteredMap, bits: int) -> tuple[float, float]:
    """``zero`` and ``scale`` in value = (code - zero) / scale."""
    if entry.kind == "normal":
        return normal_coding(bits)
    if entry.kind == "length":
        return (0, CODES_PER_MM)
    if entry.kind == "count":
        return (0, 1)
    return (MID, round(1 / SCALE_MM)) if entry.kind == "height" else (0, 2**bits - 1)


def frame(entry: RegisteredMap, avatar: Avatar) -> Literal["object", "tangent"] | None:
    """Frame of normals; None for other maps."""
    if entry.kind != "normal":
        return None
    return "tangent" if entry.framed and not in_object_space(avatar) else "object"


def in_object_space(avatar: Avatar) -> bool:
    """Whether the options request object-space normals."""
    return avatar.options.get("normals") == "object"


def map_wanted(avatar: Avatar, entry: RegisteredMap) -> bool:
    """Whether the options request a map, or the one beside which it comes; without a list they request all."""
    chosen = avatar.options.get("maps")
    return chosen is None or (entry.beside or entry.name) in chosen


def rows_of(entry: RegisteredMap, avatar: Avatar) -> Rows | None:
    """Codes (h, w) or (h, w, 3) of one map, None where the avatar has no such map."""
    bits = int(avatar.options.get("bits") or LEVELS[avatar.options.get("quality", "standard")].normal_bits)
    if entry.made_by == "photo":
        texture = avatar.texture
        if entry.kind == "normal":
            return Rows.of(quantise_normals(texture.shape_normal_object, bits))
        own = avatar.own_texture if entry.name == "texture" else None
        shown = getattr(texture, entry.name) if own is None else own
        return None if shown is None else Rows.of(shown)
    wrinkle = wrinkle_of(avatar, entry.name)
    made = (getattr(one, entry.name, None) for one in (avatar.reflectance, avatar.surface))
    codes: Any = next((one for one in made if one is not None), None) if wrinkle is None else wrinkle.normal
    if codes is None or entry.kind == "normal":
        return None if codes is None else _normals(avatar, codes, bits)
    if entry.kind == "height":
        return _heights(codes)
    if codes.dtype == np.uint16:
        return Rows(codes.shape, 8, lambda first, last: to_8_bits(codes[first:last]))
    return Rows.of(codes)


def encode_map(entry: RegisteredMap, avatar: Avatar) -> bytes | None:
    """PNG bytes of one map, None where there is none; NumericFault where normals are not finite."""
    rows = rows_of(entry, avatar)
    if rows is None:
        return None
    if entry.made_by == "surface":  # small, and smooth, so that matches pay
        return encode_png(np.asarray(rows.read(0, rows.shape[0]), np.uint8), srgb=False)
    return encode_png_rows(rows, srgb=entry.colour_space == "srgb")


def _heights(codes: UInt16) -> Rows:
    """Displacement in steps of ``HEIGHT_STEP`` of a texel's side: finer ones are noise that cannot be compressed."""
    step = min(2 ** int(math.log2(max(HEIGHT_STEP * CHART_MM / codes.shape[1] / SCALE_MM, 1.0))), COARSEST_STEP)
    half, limit = step // 2, 65535 - MID
    return Rows(
        codes.shape, 16,
        lambda first, last: np.asarray(
            np.minimum((codes[first:last].astype(np.int32) - MID + half) // step * step, limit // step * step) + MID,
            np.uint16,
        ),
    )  # fmt: skip


def _normals(avatar: Avatar, codes: npt.NDArray[np.int16], bits: int) -> Rows:
    """Normals of the reflectance as codes of the archive, in the frame that the options request."""
    if in_object_space(avatar):
        from service.reflectance.subject import Subject, to_object

        codes = to_object(codes, Subject.of(avatar.head, avatar.fit.vertices))

    def read(first: int, last: int) -> UInt8 | UInt16:
        strip = codes[first:last]
        vectors = unpack_normals(strip) if strip.shape[-1] == 2 else strip * np.float32(1 / NORMAL_ONE)
        return quantise_normals(vectors, bits)

    return Rows((*codes.shape[:2], 3), bits, read)


def wrinkle_of(avatar: Avatar, role: str) -> Wrinkle | None:
    """The wrinkles of an avatar that a map of this role shows."""
    made = () if avatar.reflectance is None else avatar.reflectance.wrinkles
    return next((one for one in made if WRINKLE + one.name == role), None)


@dataclass(frozen=True)
class MapFiles:
    """Paths of maps as seen from the mesh, in an archive that has the chart's maps of some roles."""

    roles: Collection[str]

    def path(self, one: Map | None) -> str | None:
        """Path of a map; None where there is none. The texture stands in for an albedo that is not there."""
        if one is None:
            return None
        if isinstance(one, OwnMap):
            return f"../maps/parts/{one.name}.png"
        role = "texture" if one.role == "diffuse_albedo" and one.role not in self.roles else one.role
        return f"../maps/{role}.png" if role in self.roles else None


Scalar = TypeVar("Scalar", bound=np.integer | np.floating)

GLB_TEXTURE_PX, SMALL_GLB_PX = 2048, 1024
"""Longest side of a texture in the GLB, where many viewers refuse more than 4096: two thirds of the maps', but no
more than the first and no less than the second."""
OBJ_TEXTURE_PX, SMALL_OBJ_PX = 1024, 512
"""The same of maps that are there for the OBJ alone, as EXR without loss: a third. The full ones lie in ``maps/``."""


def chart_pictures(avatar: Avatar) -> dict[str, bytes]:
    """Textures of the chart by role, as the GLB has them.

    "diffuse_albedo" is the texture, with the photo's light in it, where there is no albedo. glTF decodes codes of
    normals as code / 127.5 - 1, so that 128 is 0.004 instead of 0; no code is 0 exactly, and the error is invisible.
    """
    made, surface = avatar.reflectance or Reflectance((0, 0)), avatar.surface or SurfaceMaps()
    albedo, normal, specular = made.diffuse_albedo, made.specular_normal, made.specular_albedo
    return chart_textures(
        _fitting(avatar.texture.texture) if albedo is None else (_fitting(albedo) // 257).astype(np.uint8),
        None if normal is None else encode_normals8(unpack_normals(_fitting(normal))),
        None if specular is None else to_8_bits(_fitting(specular)),
        surface.roughness,
        surface.cavity,
    )


def chart_values(avatar: Avatar) -> dict[str, Float32]:
    """Maps of the chart that are no colours, no wider than ``OBJ_TEXTURE_PX``, by role.

    Normals (h, w, 3) in [-1, 1], specular albedo and roughness (h, w) in [0, 1].
    """
    made = avatar.reflectance
    found: dict[str, Any] = {}
    if made is not None and made.specular_normal is not None:
        found["specular_normal"] = unpack_normals(_fitting(made.specular_normal, obj=True))
    if made is not None and made.specular_albedo is not None:
        found["specular_albedo"] = _fitting(made.specular_albedo, obj=True) / np.float32(65535)
    if avatar.surface is not None and avatar.surface.roughness is not None:
        found["roughness"] = _fitting(avatar.surface.roughness, obj=True) / np.float32(255)
    return {role: np.asarray(values, np.float32) for role, values in found.items()}


def _fitting(image: npt.NDArray[Scalar], *, obj: bool = False) -> npt.NDArray[Scalar]:
    """The image, reduced by area to what GLB or OBJ have of it."""
    longest = max(image.shape[:2])
    share = longest // 3 if obj else longest * 2 // 3
    least, largest = (SMALL_OBJ_PX, OBJ_TEXTURE_PX) if obj else (SMALL_GLB_PX, GLB_TEXTURE_PX)
    most = min(max(share, least), largest)
    if longest <= most:
        return image
    return resized(image, (image.shape[1] * most // longest, image.shape[0] * most // longest))


def map_files(avatar: Avatar) -> MapFiles:
    """Where the meshes find the maps of the chart; normals in object space are no use to them."""
    there = [one for one in MAPS if map_wanted(avatar, one) and rows_of(one, avatar) is not None]
    return MapFiles([one.name for one in there if not (one.framed and in_object_space(avatar))])
