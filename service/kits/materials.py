"""Materials of a manifest as objects again, and the pictures that they need."""

from __future__ import annotations

from typing import Any

import numpy as np

from service.archive.unpack import LIMITS
from service.arrays import UInt8
from service.errors import BadArchive, NumericFault, UnreadableInput
from service.kits.unpacked import Source
from service.materials.material import ChartMap, Map, Material, OwnMap
from service.photo.gate import decoding_request, open_container
from service.photo.sandbox import run_decoder
from service.photo.wire import Status

_OWN = "maps/parts/"
MOST_PIXELS = 4096 * 4096
"""Largest texture of a part's own."""


def materials_of(source: Source) -> dict[str, Material]:
    """Materials by name; textures of parts' own are decoded.

    Raises:
        BadArchive: the manifest's materials are not as they should be, or a texture cannot be read.
    """
    known: dict[str, Map] = {}
    try:
        return {one["name"]: _material(one, source, known) for one in source.manifest["materials"]}
    except (KeyError, TypeError, ValueError, NumericFault) as error:
        raise BadArchive(f"the manifest's materials cannot be used: {error}") from error


def _material(one: dict[str, Any], source: Source, known: dict[str, Map]) -> Material:
    maps: dict[str, Map] = {}
    for slot, path in one["maps"].items():
        if path not in known:
            stem = path.rpartition("/")[2].removesuffix(".png")
            known[path] = OwnMap(stem, _pixels(source.read(path), path)) if path.startswith(_OWN) else ChartMap(stem)
        maps[f"{slot}_map"] = known[path]
    red, green, blue = one["colour"]
    near, middle, far = one["subsurface_mm"]
    return Material(
        name=one["name"], colour=(red, green, blue), opacity=one["opacity"], alpha=one["alpha"], cutoff=one["cutoff"],
        double_sided=one["double_sided"], roughness=one["roughness"], ior=one["ior"], specular=one["specular"],
        subsurface_mm=(near, middle, far), transmission=one["transmission"], **maps,
    )  # fmt: skip


def _pixels(png: bytes, path: str) -> UInt8:
    """Codes of a texture with its alpha. The gate checks that it can be decoded; it drops alpha, which OpenCV keeps."""
    import cv2

    try:
        container = open_container(png, LIMITS)
        reply, _ = run_decoder(decoding_request(container._replace(icc=b"", gamma=0.0, exif=b""), LIMITS), LIMITS)
    except UnreadableInput as error:
        raise BadArchive(f"{path} of the archive cannot be read: {error.message}") from error
    if reply.status != Status.DONE or reply.width * reply.height > MOST_PIXELS:
        raise BadArchive(f"{path} of the archive cannot be read")
    codes = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    if codes is None or codes.dtype != np.uint8:
        raise BadArchive(f"{path} of the archive is no 8-bit PNG")
    if codes.ndim == 2:
        return np.asarray(codes, np.uint8)
    way = cv2.COLOR_BGR2RGB if codes.shape[2] == 3 else cv2.COLOR_BGRA2RGBA
    return np.asarray(cv2.cvtColor(codes, way), np.uint8)
