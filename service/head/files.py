"""Reading head model files (``docs/head-model.md``): one ``.npz`` without pickle, validated when read."""

from __future__ import annotations

import json
import zipfile
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from service.arrays import AnyInt, Int32, UInt8
from service.errors import ModelFault
from service.head.model import HeadModel

FORMAT = 1
DEFAULT_HEAD = Path(__file__).resolve().parent.parent / "data" / "head" / "head.npz"

TEXT = ("name", "licence", "expression_names", "part_names", "region_names")

_ARRAYS: dict[str, tuple[type, tuple[str | int, ...]]] = {
    "mean": (np.float32, ("V", 3)), "identity": (np.float32, ("K", "V", 3)), "expression": (np.float32, ("E", "V", 3)),
    "polygons": (np.int32, ("Q", 4)), "polygon_uv": (np.int32, ("Q", 4)), "polygon_part": (np.uint8, ("Q",)),
    "uv": (np.float32, ("U", 2)), "mirror": (np.int32, ("V",)), "triangles": (np.int32, ("T", 3)),
    "triangle_uv": (np.int32, ("T", 3)), "triangle_part": (np.uint8, ("T",)), "landmark_triangle": (np.int32, ("L",)),
    "landmark_barycentric": (np.float32, ("L", 3)), "landmark_spread": (np.float32, ("L",)),
    "contour_landmarks": (np.int32, ("C",)), "contour_yaw_deg": (np.float32, ("B",)),
    "contour_triangle": (np.int32, ("B", "C")), "contour_barycentric": (np.float32, ("B", "C", 3)),
    "regions": (np.float32, ("R", "V")),
}  # fmt: skip
"""Type and axes of every array: letters must agree everywhere (V vertices, K components, E units, Q polygons, U chart
points ...)."""
STORED = [name for name in _ARRAYS if not name.startswith("triangle")]
"""The others follow from the polygons."""
_RANGES = {
    "polygons": "V", "polygon_uv": "U", "mirror": "V", "triangles": "V", "triangle_uv": "U", "landmark_triangle": "T",
    "contour_landmarks": "L", "contour_triangle": "T",
}  # fmt: skip


def split_polygons(polygons: AnyInt) -> Int32:
    """(F, 4) polygons (-1 pads triangles), or (F, 3), -> (T, 3): corners 0, 1, 2 of all, then 0, 2, 3 of the quads."""
    quads = polygons[polygons[:, -1] >= 0] if polygons.shape[1] == 4 else polygons[:0]
    return np.concatenate([polygons[:, [0, 1, 2]], quads[:, [0, -2, -1]]]).astype(np.int32)


def load_head(path: Path | None = None) -> HeadModel:
    """Read and check a head model file, by default the shipped one.

    ModelFault: it is missing, damaged, of another format version, or its arrays contradict each other.
    """
    path = DEFAULT_HEAD if path is None else path
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            raw = {key: archive[key] for key in archive.files}
    except FileNotFoundError:
        raise ModelFault(f"head model {path} is missing; build it with python -m models.head.build") from None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as fault:
        raise ModelFault(f"head model {path} cannot be read: {fault}") from fault
    header = _header(raw, path)
    missing = [key for key in STORED if key not in raw]
    if missing:
        raise ModelFault(f"head model {path} lacks {', '.join(missing)}")
    values: dict[str, Any] = {}
    for key in TEXT:
        if key not in header:
            raise ModelFault(f"head model {path} has no {key}")
        values[key] = tuple(header[key]) if isinstance(header[key], list) else str(header[key])
    for key in STORED:
        kind = np.dtype(_ARRAYS[key][0])
        if raw[key].dtype.kind not in ("f" if kind.kind == "f" else "iu"):
            raise ModelFault(f"head model {path}: {key} has type {raw[key].dtype}")
        values[key] = raw[key].astype(kind)
    sides = values["polygons"].shape
    for key, wanted in (("polygons", (*sides[:1], 4)), ("polygon_uv", sides), ("polygon_part", sides[:1])):
        if values[key].shape != wanted:
            raise ModelFault(f"head model {path}: {key} has shape {values[key].shape}, wanted {wanted}")
    values |= triangle_fields(values["polygons"], values["polygon_uv"], values["polygon_part"])
    model = HeadModel(**values)
    check(model, str(path))
    return model


def triangle_fields(polygons: Int32, polygon_uv: Int32, polygon_part: UInt8) -> dict[str, Any]:
    """The fields ``triangles``, ``triangle_uv`` and ``triangle_part`` that follow from the polygons."""
    quad = polygons[:, 3] >= 0
    return {
        "triangles": split_polygons(polygons),
        "triangle_uv": np.concatenate([polygon_uv[:, [0, 1, 2]], polygon_uv[quad][:, [0, 2, 3]]]),
        "triangle_part": np.concatenate([polygon_part, polygon_part[quad]]),
    }


def _header(raw: dict[str, npt.NDArray[Any]], path: Path) -> dict[str, Any]:
    try:
        header = json.loads(raw["header"].astype(np.uint8).tobytes().decode())
    except (KeyError, ValueError) as fault:
        raise ModelFault(f"head model {path} has no readable header: {fault}") from fault
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise ModelFault(f"head model {path} is not of format version {FORMAT}")
    return header


def check(model: HeadModel, where: str) -> None:
    """Raise ModelFault where arrays contradict each other, indices are out of range or values not finite."""

    def fault(text: str) -> ModelFault:
        return ModelFault(f"head model {where}: {text}")

    sizes = {"E": len(model.expression_names), "R": len(model.region_names)}
    for key, (_, axes) in _ARRAYS.items():
        shape = getattr(model, key).shape
        if len(shape) != len(axes):
            raise fault(f"{key} has shape {shape}, wanted axes {axes}")
        for axis, length in zip(axes, shape, strict=True):
            wanted = axis if isinstance(axis, int) else sizes.setdefault(axis, length)
            if length != wanted:
                raise fault(f"{key} has shape {shape}: axis {axis} should be {wanted}")
    for field in fields(model):
        value = getattr(model, field.name)
        if isinstance(value, np.ndarray) and value.dtype.kind == "f" and not np.isfinite(value).all():
            raise fault(f"{field.name} holds values that are not finite")
    for key, axis in _RANGES.items():
        value = getattr(model, key)
        lowest = -1 if key.startswith("polygon") else 0
        if value.size and (value.min() < lowest or value.max() >= sizes[axis]):
            raise fault(f"{key} points to {value.min()}..{value.max()}, allowed {lowest}..{sizes[axis] - 1}")
    if (model.polygons[:, :3] < 0).any() or ((model.polygons < 0) != (model.polygon_uv < 0)).any():
        raise fault("only the last corner of a polygon may be -1, in polygons and polygon_uv alike")
    if model.polygon_part.size and model.polygon_part.max() >= len(model.part_names):
        raise fault(f"polygon_part points to part {model.polygon_part.max()} of {len(model.part_names)}")
    if (model.uv < 0).any() or (model.uv > 1).any():
        raise fault("uv leaves [0, 1]")
    if (model.mirror[model.mirror] != np.arange(len(model.mirror))).any():
        raise fault("mirror is not its own inverse")
    for names in (model.expression_names, model.part_names, model.region_names):
        if len(set(names)) != len(names) or not all(isinstance(name, str) and name for name in names):
            raise fault(f"names are empty or not unique: {names}")
    if not model.part_names or model.part_names[0] != "skin":
        raise fault("the first part must be 'skin'")
    for key in ("landmark_barycentric", "contour_barycentric"):
        if np.abs(getattr(model, key).sum(-1) - 1).max(initial=0.0) > 1e-3:
            raise fault(f"{key} does not sum to 1")
