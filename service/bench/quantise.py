"""Quantise a folder of networks to eight bits, with onnxruntime's tools.

"Dynamic" quantises activations by their range at run time; "static" calibrates the range of every activation on maps of
this head. Only convolutions are quantised. The tools need the package ``onnx``, which serving does not.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import logging
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from service.arrays import Float32
from service.bench.material import Material
from service.bench.stages import inputs
from service.bench.variants import NETWORKS, StageName, Variant, reference
from service.errors import ModelFault, UsageError
from service.reflectance.super_resolution import BODY, Grain, add_noise
from service.runtime.networks import INPUT, Description, Engine, describe, open_network
from service.runtime.sessions import TABLE, checked_bytes, fold, model_table
from service.runtime.tiles import run_whole

SIDE = 256
"""Side of the maps for calibration, pixels."""


def available() -> bool:
    """Whether networks can be quantised in this installation."""
    return importlib.util.find_spec("onnx") is not None


def quantise(stages: Sequence[StageName], static: bool, engine: Engine, material_folder: Path, target: Path) -> None:
    """Write eight-bit versions of the networks of some stages, and their models.json.

    Args:
        stages: whose networks.
        static: calibrate on the material's maps; otherwise dynamic.
        engine: its folder has the networks.
        material_folder: of the material, with the reference's maps.
        target: an empty folder.

    Raises:
        UsageError: the package onnx is not installed.
        ModelFault: a network is missing, changed, or cannot be loaded.
    """
    if not available():
        raise UsageError("quantising networks needs the package onnx: pip install onnx")
    material = Material.load(material_folder)
    there = model_table(engine.folder)
    names = [(stage, name) for stage in stages for name in NETWORKS[stage] if name in there]
    write_folder(
        ((name, sample(stage, name, engine, material) if static else None) for stage, name in names), engine, target
    )


def write_folder(networks: Iterable[tuple[str, Float32 | None]], engine: Engine, target: Path) -> None:
    """Write eight-bit networks and their models.json: static with maps (1, C, h, w), dynamic without.

    Raises:
        ModelFault: a network is missing, changed, or cannot be quantised.
    """
    there = model_table(engine.folder)
    entries = []
    for name, maps in networks:
        path = target / f"{name}.onnx"
        _write(name, engine, maps, path)
        data = path.read_bytes()
        digest = hashlib.sha256(data).hexdigest()
        entries.append({**there[name], "file": path.name, "sha256": digest, "bytes": len(data)})
    (target / TABLE).write_text(json.dumps({"models": entries}), encoding="utf-8")


def sample(stage: StageName, name: str, engine: Engine, material: Material) -> Float32:
    """(1, C, h, w) input of a network, taken from the material."""
    what = describe(name, engine.folder)
    if stage == "zeta":
        return _zeta_sample(name, what, engine, material)
    if what.whole is not None:
        planes = material.whole_texture()
        return np.ascontiguousarray(planes.shrunk(what.channels, what.whole)[None])
    planes, _ = inputs(Variant(stage, width=reference(stage).width), engine, material, what)
    side = min(SIDE, planes.size[0]) // what.stride * what.stride
    first = (planes.size[0] - side) // 2
    index = np.arange(first, first + side)
    return np.ascontiguousarray(planes.read(what.channels)(index, index)[None])


def _zeta_sample(name: str, what: Description, engine: Engine, material: Material) -> Float32:
    planes = material.whole_texture()
    about = describe(BODY, engine.folder)
    add_noise(planes, about.channels, Grain())
    body = planes.shrunk(about.channels, planes.size)
    if name == BODY:
        return np.ascontiguousarray(body[None])
    with open_network(BODY, engine) as network:
        features = run_whole(network, body)
    planes.add_full(about.planes(len(features)), features)
    add_noise(planes, what.channels, Grain())
    rows, columns = (np.arange(length // 4, length // 4 + min(SIDE // 2, length // 2)) for length in planes.size[::-1])
    return np.ascontiguousarray(planes.read(what.channels)(rows, columns)[None])


class _Once:
    """Calibration data of one input (onnxruntime's ``CalibrationDataReader``)."""

    def __init__(self, maps: Float32) -> None:
        self._left = [{INPUT: maps}]

    def get_next(self) -> dict[str, Float32] | None:
        return self._left.pop() if self._left else None


def _write(name: str, engine: Engine, maps: Float32 | None, path: Path) -> None:
    from onnxruntime.quantization import QuantType, quantize_dynamic, quantize_static

    plain = path.with_suffix(".folded")
    fold(name, checked_bytes(name, engine.folder), plain, engine.folder)
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)  # the tools log advice that does not apply here
    try:
        if maps is None:
            quantize_dynamic(plain, path, op_types_to_quantize=["Conv"], weight_type=QuantType.QUInt8)
        else:
            quantize_static(
                plain, path, _Once(maps), op_types_to_quantize=["Conv"], per_channel=True,
                activation_type=QuantType.QUInt8, weight_type=QuantType.QInt8,
            )  # fmt: skip
    except Exception as error:  # the tools raise exceptions of any type
        raise ModelFault(f"{engine.folder / name}: cannot be quantised ({error})") from error
    finally:
        logging.disable(before)
        plain.unlink(missing_ok=True)
