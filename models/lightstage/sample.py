"""Writes one capture as images."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import torch

from models.colour import srgb
from models.lightstage.light.texture import bake_texture
from models.lightstage.skin.synthesis import Skin, SkinMaps
from models.lightstage.skin.window import ChartWindow
from models.lightstage.split import subject_part
from models.lightstage.stage import Stage
from service.archive.images import encode_normals8, encode_png
from service.errors import OutputFault, UsageError
from service.geometry.chart import Chart
from service.texture.texture import depth_map, shape_normals

TILE = 1024
DISPLACEMENT_MM = 5e-5
DISPLACEMENT_MID = 32768
DEPTH_M = 1e-5
DEPTH_MID = 32768

Bytes = npt.NDArray[np.uint8]


def tiles(width: int, height: int, size: int = TILE) -> list[ChartWindow]:
    """Windows that cover a chart of a size, row by row."""
    return [
        ChartWindow(x, y, min(size, width - x), min(size, height - y), width, height)
        for y in range(0, height, size)
        for x in range(0, width, size)
    ]


def _byte(values: torch.Tensor) -> Bytes:
    """(C, h, w) in [0, 1] -> (h, w, C) uint8, one channel without its axis."""
    coded = (values.clamp(0.0, 1.0) * 255.0).round().byte().cpu().numpy().transpose(1, 2, 0)
    return np.asarray(coded[..., 0] if coded.shape[-1] == 1 else coded)


def coded(maps: SkinMaps) -> dict[str, npt.NDArray[np.generic]]:
    """Images of a window's maps by file name: albedo in sRGB, normals as 128 + 127 n, height in 50 nm steps."""
    height = (maps.height_mm[0].double() / DISPLACEMENT_MM).round() + DISPLACEMENT_MID
    return {
        "diffuse_albedo": _byte(srgb(maps.diffuse_albedo)),
        "specular_albedo": _byte(maps.specular_albedo),
        "diffuse_normal": encode_normals8(maps.diffuse_normal.permute(1, 2, 0).cpu().numpy()),
        "specular_normal": encode_normals8(maps.specular_normal.permute(1, 2, 0).cpu().numpy()),
        "displacement": height.clamp(0, 65535).cpu().numpy().astype(np.uint16),
        "mask": _byte(maps.mask),
    }


def write_sample(stage: Stage, seed: int, width: int, height: int, pose: str, folder: Path) -> list[str]:
    """Write all maps of one capture at width x height into a folder; returns the names of the files.

    Raises:
        UsageError: the size is not 3:2 or too small.
        OutputFault: a file cannot be written.
    """
    if width * 2 != height * 3 or width < 96:
        raise UsageError(f"size {width}x{height}: the chart is 3:2 and at least 96 wide, for example 6144x4096")
    skin = stage.skin(seed, pose)
    images: dict[str, npt.NDArray[np.generic]] = {}
    for window in tiles(width, height):
        for name, part in coded(skin.maps(window)).items():
            whole = images.setdefault(name, np.zeros((height, width, *part.shape[2:]), part.dtype))
            whole[window.y : window.y + window.height, window.x : window.x + window.width] = part
    vertices = stage.vertices(skin)
    chart = Chart.build(stage.head, width, height)
    images["shape_normal"] = encode_normals8(shape_normals(chart, vertices)[0])
    depth = np.round(np.asarray(depth_map(chart, vertices), np.float64) / DEPTH_M) + DEPTH_MID
    images["depth"] = np.clip(depth, 0, 65535).astype(np.uint16)
    images["texture"] = bake_texture(skin, stage, width, height, skin.subject.seed)
    return _write(skin, images, pose, folder)


def _write(skin: Skin, images: dict[str, npt.NDArray[np.generic]], pose: str, folder: Path) -> list[str]:
    names = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, image in images.items():
            (folder / f"{name}.png").write_bytes(png(image, srgb=name in ("diffuse_albedo", "texture")))
            names.append(f"{name}.png")
        facts = {
            "expression": {"name": pose, "units": skin.expression},
            "part": subject_part(skin.subject.seed),
            "displacement": {"mm_per_unit": DISPLACEMENT_MM, "mid": DISPLACEMENT_MID},
            "depth": {"metres_per_unit": DEPTH_M, "mid": DEPTH_MID, "axis": "z of head space"},
            "normals": "uint8 = 128 + 127 n; diffuse and specular in tangent space, +Y up; shape in object space",
            "specular_albedo": "s, linear; F0 = 0.04 s",
            "subject": json.loads(skin.subject.to_json()),
        }
        (folder / "subject.json").write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputFault(f"cannot write to {folder}: {error.strerror or error}") from error
    return [*names, "subject.json"]


def png(image: npt.NDArray[np.generic], *, srgb: bool) -> bytes:
    """PNG bytes of a uint8 or uint16 image."""
    if image.dtype == np.uint8:
        return encode_png(np.asarray(image, np.uint8), srgb=srgb)
    done, buffer = cv2.imencode(".png", np.asarray(image, np.uint16), [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not done:
        raise OutputFault(f"the PNG encoder refused an image of shape {image.shape}")
    return buffer.tobytes()
