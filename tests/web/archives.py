"""Archives for the tests of the page: real ones, with normals that lean where a test wants them to."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image

NORMALS = ("diffuse_normal", "specular_normal")


def leaning(source: Path, target: Path, slope: tuple[float, float]) -> None:
    """Copy an archive with tangent-space normals that lean everywhere the same way.

    Args:
        source, target: zip files; the maps have 8 bits.
        slope: tangents of the angles towards +u and +v.
    """
    normal = np.array([*slope, 1.0]) / np.linalg.norm([*slope, 1.0])
    codes = np.round(128 + 127 * normal).astype(np.uint8)
    with zipfile.ZipFile(source) as opened, zipfile.ZipFile(target, "w") as archive:
        maps = {entry["path"]: entry for entry in json.loads(opened.read("manifest.json"))["maps"]}
        for name in opened.namelist():
            data = opened.read(name)
            if maps.get(name, {}).get("role") in NORMALS:
                stream = io.BytesIO()
                Image.fromarray(np.full((maps[name]["height"], maps[name]["width"], 3), codes)).save(stream, "PNG")
                data = stream.getvalue()
            archive.writestr(name, data)
