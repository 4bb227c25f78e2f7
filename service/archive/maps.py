"""The maps of an archive: their coding and PNG bytes, where they lie, and smaller copies for the meshes."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from service import map_registry
from service.archive.avatar import Avatar
from service.archive.glb import JPEG_QUALITY, Picture
from service.archive.images import (
    Rows,
    encode_jpeg,
    encode_normals8,
    encode_png,
    encode_png_rows,
    normal_coding,
    quantise_normals,
    to_8_bits,
)
from service.arrays import Float32, UInt8, UInt16
from service.levels import LEVELS
from service.map_registry import WRINKLE, RegisteredMap
from service.materials.material import Map, OwnMap
from service.reflectance.reflectance_maps import MID, NORMAL_ONE, SCALE_MM, Reflectance, Wrinkle, unpack_normals
from service.reflectance.surface_maps import CODES_PER_MM

HEIGHT_STEP = 1 / 128
"""Steps of the displacement, as a share of a texel's side: the slope between texels is then as fine as in the 8-bit
codes of the normals."""
COARSEST_STEP = 32
"""Codes of the coarsest step, 1.6 micrometres."""
CHART_MM = 410.0
"""Width of the chart at its scale on the face, 15 texels per mm at 6144 (``python -m models.head.report``)."""


@dataclass(frozen=True)
class MapSpec:
    """One map of the archive: its row in ``service.map_registry``, and how it is coded.

    Attributes:
        entry: the row.
        codes: avatar -> rows of (h, w) or (h, w, 3) codes, or None where the avatar has no such map.
    """

    entry: RegisteredMap
    codes: Callable[[Avatar], Rows | None]

    @property
    def role(self) -> str:
        """Its name."""
        return self.entry.name

    @property
    def path(self) -> str:
        """Name in the archive."""
        return f"maps/{self.role}.png"

    def coding(self, bits: int) -> tuple[float, float]:
        """``zero`` and ``scale`` in value = (code - zero) / scale."""
        if self.entry.kind == "normal":
            return normal_coding(bits)
        if self.entry.kind == "length":
            return (0, CODES_PER_MM)
        return (MID, round(1 / SCALE_MM)) if self.entry.kind == "height" else (0, 2**bits - 1)

    def frame(self, avatar: Avatar) -> Literal["object", "tangent"] | None:
        """Frame of normals; None for other maps."""
        if self.entry.kind != "normal":
            return None
        return "tangent" if self.entry.framed and not in_object_space(avatar) else "object"


def normal_bits(avatar: Avatar) -> int:
    """Bits per component of normal maps that the options request."""
    return int(avatar.options.get("bits") or LEVELS[avatar.options.get("quality", "standard")].normal_bits)


def in_object_space(avatar: Avatar) -> bool:
    """Whether the options request object-space normals."""
    return avatar.options.get("normals") == "object"


def map_wanted(avatar: Avatar, role: str) -> bool:
    """Whether the options request a map; without a list they request all. Wrinkles come with the specular normals."""
    if role.startswith(WRINKLE):
        role = "specular_normal"
    chosen = avatar.options.get("maps")
    return chosen is None or role in chosen


def fine_mesh_wanted(avatar: Avatar) -> bool:
    """Whether the options request the subdivided, displaced mesh: displacement at a level that has it."""
    level = LEVELS[avatar.options.get("quality", "standard")]
    return level.fine_mesh and "displacement" in (avatar.options.get("maps") or ("displacement",))


def encode_map(spec: MapSpec, avatar: Avatar) -> bytes | None:
    """PNG bytes of one map, None where there is none; NumericFault where normals are not finite."""
    rows = spec.codes(avatar)
    if rows is None:
        return None
    if spec.entry.made_by == "surface":  # small, and smooth, so that matches pay
        return encode_png(np.asarray(rows.read(0, rows.shape[0]), np.uint8), srgb=False, level=6)
    return encode_png_rows(rows, srgb=spec.entry.colour_space == "srgb")


def _of(made: Callable[[Reflectance], npt.NDArray[Any] | None]) -> Callable[[Avatar], Any]:
    """A map of the reflectance, None where there is none."""
    return lambda avatar: None if avatar.reflectance is None else made(avatar.reflectance)


def _eight_bits(codes: UInt16 | None) -> Rows | None:
    """16-bit codes rounded to 8 bits."""
    if codes is None:
        return None

    return Rows(codes.shape, 8, lambda first, last: to_8_bits(codes[first:last]))


def _as_they_are(codes: UInt8 | UInt16 | None) -> Rows | None:
    return None if codes is None else Rows.of(codes)


def _heights(codes: UInt16 | None) -> Rows | None:
    """Displacement in steps of ``HEIGHT_STEP`` of a texel's side: finer ones are noise that cannot be compressed."""
    if codes is None:
        return None
    step = min(2 ** int(math.log2(max(HEIGHT_STEP * CHART_MM / codes.shape[1] / SCALE_MM, 1.0))), COARSEST_STEP)
    half, limit = step // 2, 65535 - MID
    return Rows(
        codes.shape, 16,
        lambda first, last: np.asarray(
            np.minimum((codes[first:last].astype(np.int32) - MID + half) // step * step, limit // step * step) + MID,
            np.uint16,
        ),
    )  # fmt: skip


def wrinkle_of(avatar: Avatar, role: str) -> Wrinkle | None:
    """The wrinkles of an avatar that a map of this role shows."""
    made = () if avatar.reflectance is None else avatar.reflectance.wrinkles
    return next((one for one in made if WRINKLE + one.name == role), None)


def _wrinkle(role: str) -> Callable[[Avatar], Rows | None]:
    def codes(avatar: Avatar) -> Rows | None:
        found = wrinkle_of(avatar, role)
        return None if found is None else _tangent(avatar, found.normal)

    return codes


def _tangent(avatar: Avatar, codes: npt.NDArray[np.int16] | None) -> Rows | None:
    """Normals of the reflectance as codes of the archive, in the frame and bits that the options request."""
    if codes is None:
        return None
    if in_object_space(avatar):
        from service.reflectance.subject import Subject, to_object

        codes = to_object(codes, Subject.of(avatar.head, avatar.fit.vertices))
    bits, plain = normal_bits(avatar), codes

    def read(first: int, last: int) -> UInt8 | UInt16:
        strip = plain[first:last]
        vectors = unpack_normals(strip) if strip.shape[-1] == 2 else strip * np.float32(1 / NORMAL_ONE)
        return quantise_normals(vectors, bits)

    return Rows((*plain.shape[:2], 3), bits, read)


_CODES: dict[str, Callable[[Avatar], Rows | None]] = {
    "diffuse_albedo": lambda avatar: _eight_bits(_of(lambda made: made.diffuse_albedo)(avatar)),
    "specular_albedo": lambda avatar: _eight_bits(_of(lambda made: made.specular_albedo)(avatar)),
    "diffuse_normal": lambda avatar: _tangent(avatar, _of(lambda made: made.diffuse_normal)(avatar)),
    "specular_normal": lambda avatar: _tangent(avatar, _of(lambda made: made.specular_normal)(avatar)),
    "displacement": lambda avatar: _heights(_of(lambda made: made.displacement)(avatar)),
    "roughness": lambda avatar: _as_they_are(None if avatar.surface is None else avatar.surface.roughness),
    "cavity": lambda avatar: _as_they_are(None if avatar.surface is None else avatar.surface.cavity),
    "thickness": lambda avatar: _as_they_are(None if avatar.surface is None else avatar.surface.thickness),
    "albedo_error": lambda avatar: _as_they_are(_of(lambda made: made.albedo_error)(avatar)),
    "texture": lambda avatar: Rows.of(avatar.texture.texture if avatar.own_texture is None else avatar.own_texture),
    "confidence": lambda avatar: Rows.of(avatar.texture.confidence),
    "shape_normal": lambda avatar: Rows.of(
        quantise_normals(avatar.texture.shape_normal_object, normal_bits(avatar))
    ),
}

MAPS = tuple(
    MapSpec(one, _wrinkle(one.name) if one.name.startswith(WRINKLE) else _CODES[one.name])
    for one in map_registry.MAPS
)
"""All maps, in the order of the archive."""


@dataclass(frozen=True)
class MapFiles:
    """Relative paths of maps.

    Attributes:
        roles: maps of the chart that the archive has.
        folder: from the mesh to the maps.
        substitutes: role -> role of the chart that stands in where the first is not there.
    """

    roles: Collection[str]
    folder: str = "../maps"
    substitutes: tuple[tuple[str, str], ...] = (("diffuse_albedo", "texture"),)

    def path(self, one: Map | None) -> str | None:
        """Path of a map; None where there is none."""
        if one is None:
            return None
        if isinstance(one, OwnMap):
            return f"{self.folder}/parts/{one.name}.png"
        for role in (one.role, dict(self.substitutes).get(one.role)):
            if role in self.roles:
                return f"{self.folder}/{role}.png"
        return None


Scalar = TypeVar("Scalar", bound=np.generic)

GLB_TEXTURE_PX, SMALL_GLB_PX = 2048, 1024
"""Longest side of a texture in the GLB, where many viewers refuse more than 4096: two thirds of the maps', but no
more than the first and no less than the second."""
OBJ_TEXTURE_PX, SMALL_OBJ_PX = 1024, 512
"""The same of maps that are there for the OBJ alone, as EXR without loss: a third. The full ones lie in ``maps/``."""


def chart_pictures(avatar: Avatar) -> dict[str, Picture]:
    """Textures of the chart by role, in the channels where glTF reads them.

    "diffuse_albedo" is the texture, with the photo's light in it, where there is no albedo. Specular albedo is in alpha
    (KHR_materials_specular): the factor scales F0 = 0.04 of the default index of refraction, as the map does. Normals
    are of tangent space, +Y up; glTF decodes code / 127.5 - 1, so that 128 is 0.004 instead of 0; no code is 0 exactly,
    and the error is invisible. Roughness is in green and cavity in red of one picture, beside a blue without metal.
    """
    made, surface = avatar.reflectance, avatar.surface
    albedo = None if made is None else made.diffuse_albedo
    colours = _fitting(avatar.texture.texture) if albedo is None else (_fitting(albedo) // 257).astype(np.uint8)
    found = {"diffuse_albedo": Picture(encode_jpeg(colours, JPEG_QUALITY), "image/jpeg")}
    if surface is not None and surface.roughness is not None:
        channels = np.zeros((*surface.roughness.shape, 3), np.uint8)
        channels[..., 0] = 255 if surface.cavity is None else surface.cavity
        channels[..., 1] = surface.roughness
        found["roughness"] = _data_picture(channels)
        if surface.cavity is not None:
            found["cavity"] = found["roughness"]
    if made is not None and made.specular_normal is not None:
        found["specular_normal"] = _data_picture(encode_normals8(unpack_normals(_fitting(made.specular_normal))))
    if made is not None and made.specular_albedo is not None:
        alpha = _fitting(made.specular_albedo)
        rgba = np.full((*alpha.shape, 4), 255, np.uint8)
        rgba[..., 3] = to_8_bits(alpha)
        found["specular_albedo"] = _data_picture(rgba)
    return found


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


def _data_picture(codes: UInt8) -> Picture:
    """PNG of data."""
    return Picture(encode_png_rows(Rows.of(codes), srgb=False), "image/png")


def _fitting(image: npt.NDArray[Scalar], *, obj: bool = False) -> npt.NDArray[Scalar]:
    """The image, reduced by area to what GLB or OBJ have of it."""
    import cv2

    longest = max(image.shape[:2])
    share = longest // 3 if obj else longest * 2 // 3
    least, largest = (SMALL_OBJ_PX, OBJ_TEXTURE_PX) if obj else (SMALL_GLB_PX, GLB_TEXTURE_PX)
    most = min(max(share, least), largest)
    if longest <= most:
        return image
    size = (image.shape[1] * most // longest, image.shape[0] * most // longest)
    pixels: Any = image
    smaller = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    return np.asarray(smaller, image.dtype)


def map_files(avatar: Avatar) -> MapFiles:
    """Where the meshes find the maps of the chart; normals in object space are no use to them."""
    there = [spec for spec in MAPS if map_wanted(avatar, spec.role) and spec.codes(avatar) is not None]
    return MapFiles([spec.role for spec in there if not (spec.entry.framed and in_object_space(avatar))])
