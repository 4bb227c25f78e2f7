"""Portraits on disk: compressed files of some dozens each, in small types, written once and never half.

A shard is an ``.npz`` without pickle. For N portraits of H x W pixels:

| array | type | what |
|---|---|---|
| seed | int64 (N) | name of the portrait |
| jpeg, jpeg_end | uint8 (B), int64 (N) | the files one after the other, and where each ends |
| chart | uint16 (N, H, W, 2) | 0 none, else 1 + round(65534 u), the same for v |
| normal | int8 (N, H, W, 3) | round(127 n), camera space |
| depth | uint16 (N, H, W) | tenths of a millimetre, 0 on the background |
| part | uint8 (N, H, W) | index into ``labels.PARTS`` |
| points, seen | float32 (N, 478, 2), bool (N, 478) | landmarks in pixels, and whether nothing hides them |
| focal_px, principal_point, rotation, translation | float64 | camera |
| identity, expression | float16 | coefficients of the head model |
| vertices | int16 (N, V, 3) | hundredths of a millimetre, head space |
| hair | uint8 (N, H, W) | round(255 share) of hair |
| direction | int8 (N, H, W, 2) | round(127 direction of strands), 0 without |
| kinds, ends_m | uint8 (N, 5), float16 (N) | index into each of ``KINDS``, 255 unknown; height of the ends |
| eyes, lids_mm | uint8 (N), float16 (N, 2) | index into ``EYE_STATES``; opening of the lids |
"""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from models.people.develop import decoded
from models.people.make import Portrait, portrait
from service.errors import UnreadableInput
from service.geometry.camera import Camera
from service.hair.kinds import KINDS

Arrays = dict[str, npt.NDArray[Any]]

EYE_STATES = ("open", "half", "closed", "wink")
PER_SHARD = 64
DEPTH_UNIT_M, VERTEX_UNIT_M = 1e-4, 1e-5


def encode(portraits: list[Portrait]) -> Arrays:
    """The arrays of a shard."""
    chart = np.stack([p.chart for p in portraits])
    coded = np.where(np.isfinite(chart), 1 + np.round(np.clip(np.nan_to_num(chart), 0, 1) * 65534), 0)
    depth = np.stack([p.depth for p in portraits])
    tenths = np.where(np.isfinite(depth), np.clip(np.round(np.nan_to_num(depth, posinf=0) / DEPTH_UNIT_M), 1, 65535), 0)
    vertices = np.stack([p.vertices for p in portraits]) / VERTEX_UNIT_M
    return {
        "seed": np.array([p.seed for p in portraits]),
        "jpeg": np.frombuffer(b"".join(p.jpeg for p in portraits), np.uint8),
        "jpeg_end": np.cumsum([len(p.jpeg) for p in portraits]),
        "chart": coded.astype(np.uint16),
        "normal": np.round(127 * np.stack([p.normal for p in portraits])).astype(np.int8),
        "depth": tenths.astype(np.uint16),
        "part": np.stack([p.part for p in portraits]),
        "points": np.stack([p.points for p in portraits]),
        "seen": np.stack([p.seen for p in portraits]),
        "focal_px": np.array([p.camera.focal_px for p in portraits]),
        "principal_point": np.stack([p.camera.principal_point for p in portraits]),
        "rotation": np.stack([p.camera.rotation for p in portraits]),
        "translation": np.stack([p.camera.translation for p in portraits]),
        "identity": np.stack([p.identity for p in portraits]).astype(np.float16),
        "expression": np.stack([p.expression for p in portraits]).astype(np.float16),
        "vertices": np.clip(np.round(vertices), -32767, 32767).astype(np.int16),
        "hair": np.round(255 * np.stack([p.hair for p in portraits])).astype(np.uint8),
        "direction": np.round(127 * np.stack([p.direction for p in portraits])).astype(np.int8),
        "kinds": np.array([[_number(kind, p.kinds[kind]) for kind in KINDS] for p in portraits], np.uint8),
        "ends_m": np.array([p.ends_m for p in portraits], np.float16),
        "eyes": np.array([EYE_STATES.index(p.eyes) for p in portraits], np.uint8),
        "lids_mm": np.stack([p.lids_mm for p in portraits]).astype(np.float16),
    }


UNKNOWN = 255
"""Number of a kind that is not known."""


def _number(kind: str, name: str) -> int:
    return KINDS[kind].index(name) if name else UNKNOWN


def _name(kind: str, number: int) -> str:
    return KINDS[kind][number] if number != UNKNOWN else ""


def decode(arrays: Arrays) -> Iterator[Portrait]:
    """The portraits of a shard, as exactly as it holds them."""
    ends = arrays["jpeg_end"]
    for i, seed in enumerate(arrays["seed"].tolist()):
        data = arrays["jpeg"][(ends[i - 1] if i else 0) : ends[i]].tobytes()
        image = decoded(data)
        chart = arrays["chart"][i].astype(np.float32)
        depth = arrays["depth"][i].astype(np.float32)
        size = image.shape[0]
        camera = Camera(
            size,
            size,
            float(arrays["focal_px"][i]),
            arrays["principal_point"][i],
            arrays["rotation"][i],
            arrays["translation"][i],
        )
        yield Portrait(
            seed,
            image,
            data,
            np.where(chart > 0, (chart - 1) / 65534, np.float32(np.nan)).astype(np.float32),
            arrays["normal"][i].astype(np.float32) / 127,
            np.where(depth > 0, depth * DEPTH_UNIT_M, np.inf).astype(np.float32),
            arrays["part"][i],
            arrays["points"][i],
            arrays["seen"][i],
            camera,
            arrays["identity"][i].astype(np.float32),
            arrays["expression"][i].astype(np.float32),
            arrays["vertices"][i].astype(np.float32) * np.float32(VERTEX_UNIT_M),
            EYE_STATES[int(arrays["eyes"][i])],
            arrays["lids_mm"][i].astype(np.float32),
            arrays["hair"][i].astype(np.float32) / 255,
            arrays["direction"][i].astype(np.float32) / 127,
            {kind: _name(kind, int(k)) for kind, k in zip(KINDS, arrays["kinds"][i], strict=True)},
            float(arrays["ends_m"][i]),
        )


def save(arrays: Arrays, path: Path) -> None:
    """Write a shard; whoever finds the file finds it whole. The same arrays give the same bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.part")
    with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=2) as archive:
        for key, value in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.ascontiguousarray(value), version=(1, 0), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{key}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, buffer.getvalue())
    part.replace(path)


def load(path: Path) -> Arrays:
    """Read a shard.

    Raises:
        UnreadableInput: it is damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {key: archive[key] for key in archive.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as fault:
        raise UnreadableInput(f"{path} is not a shard of portraits: {fault}") from fault


def orders(
    start: int, count: int, size: int, framing: str = "face", meshes: Sequence[str] = ()
) -> dict[str, dict[str, Any]]:
    """Name of each shard -> its order; all shards but the last end at multiples of ``PER_SHARD``."""
    result, seed, end = {}, start, start + count
    while seed < end:
        n = min(PER_SHARD - seed % PER_SHARD, end - seed)
        drawn = {"seed": seed, "count": n, "size": size, "framing": framing, "meshes": list(meshes)}
        result[f"people-{size}-{seed:08d}-{n:02d}.npz"] = {"what": "people", **drawn}
        seed += n
    return result


def draw_order(order: Mapping[str, Any], target: Path) -> None:
    """Draw one shard: ``count`` portraits of ``size`` pixels from seed ``seed`` on, in one framing."""
    seeds = range(order["seed"], order["seed"] + order["count"])
    save(encode([portrait(s, order["size"], None, order["framing"], tuple(order["meshes"])) for s in seeds]), target)
