"""Archives for the tests of the page: real ones, with what a test wants to be otherwise."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

NORMALS = ("diffuse_normal", "specular_normal")


def rewritten(source: Path, target: Path, change: Callable[[str, bytes], bytes]) -> None:
    """Copy an archive; ``change`` gets name and bytes of each file, and gives its bytes."""
    with zipfile.ZipFile(source) as opened, zipfile.ZipFile(target, "w") as archive:
        for name in opened.namelist():
            archive.writestr(name, change(name, opened.read(name)))


def leaning(source: Path, target: Path, slope: tuple[float, float]) -> None:
    """Copy an archive of 8 bits with tangent-space normals that lean everywhere the same way.

    Args:
        source: the archive.
        target: of the copy.
        slope: tangents of the angles towards +u and +v.
    """
    normal = np.array([*slope, 1.0]) / np.linalg.norm([*slope, 1.0])
    codes = np.round(128 + 127 * normal).astype(np.uint8)
    with zipfile.ZipFile(source) as opened:
        maps = {one["path"]: one for one in json.loads(opened.read("manifest.json"))["maps"] if one["role"] in NORMALS}

    def lean(name: str, data: bytes) -> bytes:
        if name not in maps:
            return data
        stream = io.BytesIO()
        Image.fromarray(np.full((maps[name]["height"], maps[name]["width"], 3), codes)).save(stream, "PNG")
        return stream.getvalue()

    rewritten(source, target, lean)
