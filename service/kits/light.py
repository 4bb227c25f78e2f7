"""The photo's light as an environment that renderers load."""

from __future__ import annotations

import numpy as np

from service.archive.exr import exr_bytes
from service.archive.unpack import unpack_map
from service.arrays import Float32, Float64
from service.colour import bytes_to_linear
from service.kits.unpacked import Source
from service.light.harmonics import basis

SIZE = (128, 64)
"""Width and height of the environment: nine harmonics have nothing finer."""

LEAST_SKIN = 50
"""Fewest texels of lit skin from which its albedo is estimated."""


def environment(source: Source) -> bytes | None:
    """EXR of the radiance around the head, equirectangular, Z up as in Blender; None where the photo gave no light.

    Column 0 is -X; the middle looks along +X, and -Y, where the face looks in a Z-up world, is at three quarters.
    """
    fit, camera = source.manifest.get("fit"), source.manifest.get("camera")
    light = fit.get("light") if isinstance(fit, dict) else None
    if not isinstance(light, dict) or not isinstance(camera, dict):
        return None
    coefficients = np.array(light["coefficients"], np.float64) / _skin(source)
    width, height = SIZE
    longitude = np.pi * (1 - 2 * (np.arange(width) + 0.5) / width)
    latitude = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    around, up = np.meshgrid(longitude, latitude)
    z_up = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], -1)
    head = np.stack([z_up[..., 0], z_up[..., 2], -z_up[..., 1]], -1)
    seen = head @ np.array(camera["rotation"], np.float64).T
    radiance = np.einsum("...k,kc->...c", basis(seen), coefficients)
    return exr_bytes(np.maximum(radiance, 0).astype(np.float32))


def _skin(source: Source) -> Float64:
    """(3,) albedo that the light of the manifest, which has the skin's colour in it, has to be divided by.

    The light is scaled so that skin of luminance 1 is seen; the photo's is the albedo's colour in it.
    """
    needed = ("maps/diffuse_albedo.png", "maps/texture.png", "maps/confidence.png")
    if any(name not in source.names for name in needed):
        return np.ones(3)
    albedo, texture, confidence = (_small(source.read(name)) for name in needed)
    lit = confidence[..., 0] >= 0.6
    if lit.sum() < LEAST_SKIN:
        return np.ones(3)
    shown, own = (bytes_to_linear(np.rint(one * 255).astype(np.uint8))[lit].mean(0) for one in (texture, albedo))
    luminance = float(shown @ np.array([0.2126, 0.7152, 0.0722]))
    return np.asarray(np.maximum(own, 0.01) / max(luminance, 0.01), np.float64)


def _small(png: bytes) -> Float32:
    import cv2

    small = np.asarray(cv2.resize(unpack_map(png, "map"), (192, 128), interpolation=cv2.INTER_AREA), np.float32)
    return small * np.float32(1 / 255)
