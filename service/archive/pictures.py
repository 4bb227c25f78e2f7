"""Textures of the GLB: the maps at a size that viewers accept, in glTF's coding."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from service.archive.avatar import Avatar
from service.archive.gltf_materials import Picture
from service.archive.images import encode_jpeg, encode_normals8, encode_png, to_8_bits
from service.arrays import UInt8
from service.reflectance.result import Reflectance, unpack_normals

Scalar = TypeVar("Scalar", bound=np.generic)

GLB_TEXTURE_PX = 2048
"""Longest side of a texture in the GLB; many viewers refuse more than 4096."""


def chart_pictures(avatar: Avatar) -> dict[str, Picture]:
    """Textures of the chart by role, as ``gltf_materials.Materials`` wants them.

    "diffuse_albedo" is the texture, with the photo's light in it, where there is no albedo.
    """
    made = avatar.reflectance
    found = {"diffuse_albedo": colours(avatar)}
    if made is not None:
        more = {"specular_normal": normal_picture(made), "specular_albedo": specular_picture(made)}
        found |= {role: picture for role, picture in more.items() if picture is not None}
    return found


def colours(avatar: Avatar) -> Picture:
    """Diffuse albedo where there is one, else the texture with the photo's light in it."""
    made = avatar.reflectance
    if made is None or made.diffuse_albedo is None:
        return glb_texture(avatar.texture.texture)
    codes = _fitting(made.diffuse_albedo)
    return _picture((codes // 257).astype(np.uint8), photographic=codes is not made.diffuse_albedo)


def glb_texture(texture: UInt8) -> Picture:
    """A texture (h, w, 3) uint8 sRGB as PNG; larger ones reduced to ``GLB_TEXTURE_PX`` as JPEG."""
    smaller = _fitting(texture)
    return _picture(smaller, photographic=smaller is not texture)


def normal_picture(made: Reflectance) -> Picture | None:
    """Specular normals, tangent space, +Y up, as 8-bit PNG; None where there are none.

    glTF decodes code / 127.5 - 1, so that 128 is 0.004 instead of 0; no code is 0 exactly, and the error is invisible.
    """
    if made.specular_normal is None:
        return None
    return Picture(encode_png(encode_normals8(unpack_normals(_fitting(made.specular_normal))), srgb=False), "image/png")


def specular_picture(made: Reflectance) -> Picture | None:
    """Specular albedo in the alpha of an 8-bit PNG, where KHR_materials_specular reads it; None where there is none.

    The factor scales F0 = 0.04 of the default index of refraction, which is the convention of the map.
    """
    if made.specular_albedo is None:
        return None
    alpha = _fitting(made.specular_albedo)
    rgba = np.full((*alpha.shape, 4), 255, np.uint8)
    rgba[..., 3] = to_8_bits(alpha)
    return Picture(encode_png(rgba, srgb=False), "image/png")


def _picture(image: UInt8, *, photographic: bool) -> Picture:
    if photographic:
        return Picture(encode_jpeg(image, 92), "image/jpeg")
    return Picture(encode_png(image, srgb=True), "image/png")


def _fitting(image: npt.NDArray[Scalar]) -> npt.NDArray[Scalar]:
    """The image, reduced by area where its longest side exceeds ``GLB_TEXTURE_PX``."""
    import cv2

    longest = max(image.shape[:2])
    if longest <= GLB_TEXTURE_PX:
        return image
    size = (image.shape[1] * GLB_TEXTURE_PX // longest, image.shape[0] * GLB_TEXTURE_PX // longest)
    pixels: Any = image
    smaller = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    return np.asarray(smaller, image.dtype)
