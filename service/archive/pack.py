"""The archive of an avatar: what is in it, and writing it.

The same photo, options and seed give the same bytes. That is why nothing here looks at the clock, and why measured
times and memory are left out unless ``timings`` asks for them.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from service.archive.avatar import Avatar
from service.archive.container import write_file, write_stream
from service.archive.describe import describe
from service.archive.glb import Picture, glb_bytes, weights_by_name
from service.archive.images import encode_jpeg, encode_png
from service.archive.licences import COPYRIGHT, licences_text
from service.archive.manifest import to_json
from service.archive.maps import MAPS, encode_map
from service.archive.obj import mtl_bytes, obj_bytes
from service.archive.usd import usda_bytes
from service.archive.version import GENERATOR

GLB_TEXTURE_PX = 2048
"""Longest side of the texture in the GLB; many viewers refuse more than 4096."""


def write_archive(avatar: Avatar, target: Path | BinaryIO, *, timings: bool = False) -> None:
    """Write the archive of ``avatar`` to a file, whole or not at all, or to a binary stream.

    Args:
        avatar: the results of one photo.
        target: a path, or a stream that may be a pipe.
        timings: also write times and memory into the manifest; the bytes then differ from run to run.

    Raises:
        OutputFault: the file or the stream could not be written.
        NumericFault: a result holds NaN or infinity.
    """
    members = archive_members(avatar, timings=timings)
    if isinstance(target, Path):
        write_file(target, members)
    else:
        write_stream(target, members)


def archive_members(avatar: Avatar, *, timings: bool = False) -> dict[str, bytes]:
    """Name -> content of every file of the archive; see :func:`write_archive`."""
    with ThreadPoolExecutor(2) as pool:
        previews = pool.submit(_previews, avatar)
        files = _maps(avatar) | _meshes(avatar) | {"LICENSES.md": licences_text(avatar).encode()}
        files |= previews.result()
    files["manifest.json"] = to_json(describe(avatar, files, timings=timings))
    return files


def _maps(avatar: Avatar) -> dict[str, bytes]:
    """PNG bytes by path; two at a time, as packing is most of the time and leaves Python's lock alone."""
    wanted = [spec for spec in MAPS if _wanted(avatar, spec.role)]
    with ThreadPoolExecutor(2) as pool:
        packed = pool.map(lambda spec: encode_map(spec, avatar), wanted)
        return {spec.path: data for spec, data in zip(wanted, packed, strict=True) if data is not None}


def _wanted(avatar: Avatar, role: str) -> bool:
    """Whether the options ask for a map; without a list, all that there are."""
    chosen = avatar.options.get("maps")
    return chosen is None or role in chosen


def _meshes(avatar: Avatar) -> dict[str, bytes]:
    head, fit = avatar.head, avatar.fit
    title = f"{GENERATOR}: {head.name} fitted to a photo"
    textured = _wanted(avatar, "texture")
    glb = glb_bytes(
        head,
        fit.neutral,
        glb_texture(avatar.texture.texture),
        generator=GENERATOR,
        copyright_notice=COPYRIGHT,
        expression=weights_by_name(head.expression_names, fit.expression),
        extras={"headModel": head.name, "headModelLicence": head.licence, "units": "metre"},
    )
    return {
        "mesh/head.obj": obj_bytes(head, fit.vertices, title),
        "mesh/head.mtl": mtl_bytes(head, textured=textured),
        "mesh/head.glb": glb,
        "mesh/head.usda": usda_bytes(head, fit.vertices, title, textured=textured),
    }


def glb_texture(texture: npt.NDArray[np.uint8]) -> Picture:
    """A texture (h, w, 3) uint8 sRGB as PNG; scaled down and as JPEG where it is larger than a viewer wants."""
    import cv2

    longest = max(texture.shape[:2])
    if longest <= GLB_TEXTURE_PX:
        return Picture(encode_png(texture, srgb=True), "image/png")
    size = (texture.shape[1] * GLB_TEXTURE_PX // longest, texture.shape[0] * GLB_TEXTURE_PX // longest)
    smaller = np.asarray(cv2.resize(texture, size, interpolation=cv2.INTER_AREA), np.uint8)
    return Picture(encode_jpeg(smaller, 92), "image/jpeg")


def _previews(avatar: Avatar) -> Mapping[str, bytes]:
    from service.archive.preview.overlay import overlay
    from service.archive.preview.sheet import sheet

    return {
        "preview/overlay.jpg": encode_jpeg(overlay(avatar)),
        "preview/sheet.jpg": encode_jpeg(sheet(avatar)),
    }
