"""An archive with every map that the page knows: that of a real run, with reflectance maps drawn by rule.

The page must show maps of any size, depth and coding, so these need not be plausible skin, only checkable.
"""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

SOFT = 0.2
"""Slopes of the diffuse normals as a share of the specular ones, as light inside the skin blurs them."""


def _png(pixels: npt.NDArray[Any]) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


def _entry(role: str, data: bytes, bits: int, frame: str | None, space: str, size: tuple[int, int]) -> dict[str, Any]:
    middle = 2 ** (bits - 1)
    signed = frame is not None or role == "displacement"
    return {
        "path": f"maps/{role}.png",
        "role": role,
        "colour_space": space,
        "bits": bits,
        "width": size[0],
        "height": size[1],
        "size": len(data),
        "frame": frame,
        "coding": {
            "zero": middle if signed else 0,
            "scale": middle - 1 if signed else 2**bits - 1,
            "meaning": role.replace("_", " "),
        },
    }


def _normals(slope_x: npt.NDArray[np.float64], slope_y: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.round(128 + 127 * normal).astype(np.uint8)


def with_reflectance(source: Path, target: Path, slope: tuple[float, float] | None = None) -> None:
    """Copy an archive and add reflectance maps to it.

    Args:
        source, target: zip files.
        slope: normals that lean everywhere the same way, by the tangents of the angles towards +u and +v; None for
            waves.
    """
    with zipfile.ZipFile(source) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    texture = np.asarray(Image.open(io.BytesIO(members["maps/texture.png"])).convert("RGB"))
    height, width = texture.shape[:2]
    v, u = np.mgrid[0:height, 0:width]
    wave_x, wave_y = 0.25 * np.sin(u * 1.1), 0.25 * np.cos(v * 1.1)
    soft = SOFT if slope is None else 1.0
    if slope is not None:
        wave_x, wave_y = np.full(u.shape, -slope[0]), np.full(u.shape, -slope[1])
    grey = texture.mean(2)
    relief = (32768 + 8000 * np.sin(u * 0.35) * np.sin(v * 0.35)).astype(np.uint16)
    drawn: list[tuple[str, npt.NDArray[Any], int, str | None, str]] = [
        ("diffuse_albedo", np.clip(255 * (texture / 255.0) ** 0.8, 0, 255).astype(np.uint8), 8, None, "srgb"),
        ("specular_albedo", (90 + grey / 2).astype(np.uint8), 8, None, "linear"),
        ("diffuse_normal", _normals(soft * wave_x, soft * wave_y), 8, "tangent", "data"),
        ("specular_normal", _normals(wave_x, wave_y), 8, "tangent", "data"),
        ("displacement", relief, 16, None, "linear"),
    ]
    manifest = json.loads(members["manifest.json"])
    for role, pixels, bits, frame, space in drawn:
        data = _png(pixels)
        members[f"maps/{role}.png"] = data
        manifest["maps"].append(_entry(role, data, bits, frame, space, (width, height)))
        manifest["files"].append({"path": f"maps/{role}.png", "role": role, "size": len(data)})
    members["manifest.json"] = json.dumps(manifest).encode()
    with zipfile.ZipFile(target, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
