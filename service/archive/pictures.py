"""Textures of the GLB: the maps at a size that viewers accept, in glTF's coding."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from service.archive.avatar import Avatar
from service.archive.gltf_materials import JPEG_QUALITY, Picture
from service.archive.images import encode_jpeg, encode_normals8, encode_png, to_8_bits
from service.arrays import Float32, UInt8
from service.reflectance.reflectance_maps import Reflectance, unpack_normals

Scalar = TypeVar("Scalar", bound=np.generic)

GLB_TEXTURE_PX, SMALL_GLB_PX = 2048, 1024
"""Longest side of a texture in the GLB, where many viewers refuse more than 4096: two thirds of the maps', but no
more than the first and no less than the second."""
OBJ_TEXTURE_PX, SMALL_OBJ_PX = 1024, 512
"""The same of maps that are there for the OBJ alone, as EXR without loss: a third. The full ones lie in ``maps/``."""


def chart_pictures(avatar: Avatar) -> dict[str, Picture]:
    """Textures of the chart by role, as ``gltf_materials.Materials`` wants them.

    "diffuse_albedo" is the texture, with the photo's light in it, where there is no albedo.
    """
    made = avatar.reflectance
    packed = surface_picture(avatar)
    found: dict[str, Picture | None] = {"diffuse_albedo": colours(avatar), "roughness": packed}
    if avatar.surface is not None and avatar.surface.cavity is not None:
        found["cavity"] = packed
    if made is not None:
        found |= {"specular_normal": normal_picture(made), "specular_albedo": specular_picture(made)}
    return {role: picture for role, picture in found.items() if picture is not None}


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


def surface_picture(avatar: Avatar) -> Picture | None:
    """Cavity in red, roughness in green, metallic (none) in blue, as 8-bit PNG; None where there is no roughness."""
    surface = avatar.surface
    if surface is None or surface.roughness is None:
        return None
    channels = np.zeros((*surface.roughness.shape, 3), np.uint8)
    channels[..., 0] = 255 if surface.cavity is None else surface.cavity
    channels[..., 1] = surface.roughness
    return Picture(_packed(channels), "image/png")


def colours(avatar: Avatar) -> Picture:
    """Diffuse albedo where there is one, else the texture with the photo's light in it."""
    made = avatar.reflectance
    if made is None or made.diffuse_albedo is None:
        return glb_texture(avatar.texture.texture)
    return glb_texture((_fitting(made.diffuse_albedo) // 257).astype(np.uint8))


def glb_texture(texture: UInt8) -> Picture:
    """A texture (h, w, 3) uint8 sRGB as JPEG, larger ones reduced to ``GLB_TEXTURE_PX``."""
    return Picture(encode_jpeg(_fitting(texture), JPEG_QUALITY), "image/jpeg")


def normal_picture(made: Reflectance) -> Picture | None:
    """Specular normals, tangent space, +Y up, as 8-bit PNG; None where there are none.

    glTF decodes code / 127.5 - 1, so that 128 is 0.004 instead of 0; no code is 0 exactly, and the error is invisible.
    """
    if made.specular_normal is None:
        return None
    codes = encode_normals8(unpack_normals(_fitting(made.specular_normal)))
    return Picture(_packed(codes), "image/png")


def specular_picture(made: Reflectance) -> Picture | None:
    """Specular albedo in the alpha of an 8-bit PNG, where KHR_materials_specular reads it; None where there is none.

    The factor scales F0 = 0.04 of the default index of refraction, which is the convention of the map.
    """
    if made.specular_albedo is None:
        return None
    alpha = _fitting(made.specular_albedo)
    rgba = np.full((*alpha.shape, 4), 255, np.uint8)
    rgba[..., 3] = to_8_bits(alpha)
    return Picture(_packed(rgba), "image/png")


def _packed(codes: UInt8) -> bytes:
    """PNG of data, the harder the smaller it is."""
    return encode_png(codes, srgb=False, level=7 if max(codes.shape) <= SMALL_GLB_PX else 3)


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
