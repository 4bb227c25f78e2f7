"""Trained networks -> ONNX files of the service: ``python -m export.networks.convert RUN_FOLDER``.

The weights are the moving average of a checkpoint, rounded to float16 for storage; arithmetic stays float32. Before a
file is written it has to pass the gate: names, axes, shapes and values on two sizes, one of them not square, against
torch, on onnxruntime and on OpenVINO where that is installed.
"""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
import torch
import typer
from torch import Tensor, nn

from export.faces.onnx_tools import ParityError, store_half
from export.faces.registry import MODELS, register
from models.networks.configs import CONTEXT_CHANNELS, ZETA_CHANNELS, Zeta, build
from models.networks.context import HEIGHT, WIDTH, ContextNet
from models.networks.rcan import SCALE
from models.networks.stages import StageNet
from service.archive.container import replace_file
from service.errors import ModelFault
from service.runtime.network_registry import CONTEXT, PACKED, REGISTRY, TEXTURE
from service.runtime.networks import KEY
from service.runtime.sessions import openvino_library

OPSET = 18
LICENCE = "Apache-2.0"
BOUND = 1e-3
"""Largest difference from torch at outputs of about [-1, 1]; features and log light are compared at their own scale."""

ZETA_TEXTURE = (576, 384)

DEEP = 64
"""Halo from which on a network counts as deep. What lies at the edge of a deep network's receptive field hardly counts
(Luo et al. 2016): beyond three quarters of its halo no result of the networks in the box moves by more than a tenth of
an 8-bit step.
"""

SIZES = ((8, 8), (6, 11))
"""Heights and widths, in strides, of the results on which files are checked."""


@dataclass(frozen=True)
class Part:
    """One file to be: a module, what it says about itself, and the sizes (height, width) it is checked at."""

    name: str
    module: nn.Module
    description: dict[str, Any]
    sizes: tuple[tuple[int, int], ...]


def parts_of(network: str, module: nn.Module) -> list[Part]:
    """The files that a network becomes: two for zeta, else one."""
    if isinstance(module, Zeta):
        return _zeta_parts(module)
    if isinstance(module, ContextNet):
        about = _about(network, CONTEXT_CHANNELS, CONTEXT, whole=[WIDTH, HEIGHT])
        return [Part(network, module, about, ((HEIGHT, WIDTH),))]
    if isinstance(module, StageNet):
        stride, halo = module.stride, module.halo()
        module.margin = halo * 3 // 4 // stride * stride if halo >= DEEP else halo
        known = next((one.channels for one in REGISTRY if one.name == network), module.channels)
        channels = packed_names(known, len(known) - len(module.channels) + module.detail + module.whole)
        about = _about(network, channels, module.outputs, stride=stride, margin=module.margin)
        sizes = tuple((2 * module.margin + stride * high, 2 * module.margin + stride * wide) for high, wide in SIZES)
        return [Part(network, module, about, sizes)]
    raise TypeError(f"{type(module).__name__} is no network of this program")


def packed_names(channels: Sequence[str], first: int) -> tuple[str, ...]:
    """Names of channels of which those from ``first`` on are packed by four (``models.networks.translator.Stem``)."""
    packed = [PACKED.join(channels[at : at + 4]) for at in range(first, len(channels), 4)]
    return (*channels[:first], *packed)


def _zeta_parts(module: Zeta) -> list[Part]:
    size = module.size
    body = module.body
    tail = module.tail
    features = tuple(f"feature_{i}" for i in range(size.features))
    noise = tuple(f"noise_{i}" for i in range(size.noise))
    about_body = _about("zeta_body", ZETA_CHANNELS, ("features",), whole=list(ZETA_TEXTURE))
    tail.margin = tail.halo
    about_tail = _about("zeta_tail", (*features, *noise), TEXTURE, margin=tail.margin, scale=SCALE)
    sizes = ((32, 32), (24, 40))
    return [Part("zeta_body", body, about_body, sizes), Part("zeta_tail", tail, about_tail, sizes)]


def _about(
    network: str, channels: Sequence[str], outputs: Sequence[str], *, stride: int = 1, margin: int = 0, scale: int = 1,
    whole: list[int] | None = None,
) -> dict[str, Any]:  # fmt: skip
    return {
        "network": network, "channels": list(channels), "outputs": list(outputs), "stride": stride, "margin": margin,
        "scale": scale, "whole": whole,
    }  # fmt: skip


def rounded(module: nn.Module) -> nn.Module:
    """The same module with weights that float16 holds exactly."""
    with torch.no_grad():
        for values in module.parameters():
            if values.numel() >= 256:
                values.copy_(values.half().float())
    return module.eval()


def to_onnx(part: Part) -> Any:
    """ONNX model with input ``maps``, output ``result``, free height and width (unless it runs whole), half storage."""
    import onnx

    height, width = part.sizes[0]
    channels = len(part.description["channels"])
    example = torch.zeros(1, channels, height, width)
    fixed = len(part.sizes) == 1
    axes = None if fixed else {"maps": {2: "height", 3: "width"}, "result": {2: "rows", 3: "columns"}}
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # deprecation of the exporter that needs no further packages
        torch.onnx.export(
            part.module, (example,), buffer, input_names=["maps"], output_names=["result"], opset_version=OPSET,
            dynamic_axes=axes, dynamo=False, do_constant_folding=False,  # weights keep their names: training can go on
        )  # fmt: skip
    model = store_half(onnx.load_from_string(buffer.getvalue()))
    model.metadata_props.add(key=KEY, value=json.dumps(part.description, sort_keys=True))
    onnx.checker.check_model(model, full_check=True)
    return model


def check(part: Part, data: bytes) -> dict[str, float]:
    """Largest difference from torch by runtime, relative to the output's own scale where that is more than 1.

    Raises:
        ParityError: another shape than torch's, values that are not finite, or a difference over ``BOUND``.
    """
    worst: dict[str, float] = {}
    generator = torch.Generator().manual_seed(5)
    runners = {"onnxruntime": _onnxruntime(data)}
    if find_spec("openvino") is not None:
        runners["openvino"] = _openvino(data)
    for height, width in part.sizes:
        maps = torch.rand(1, len(part.description["channels"]), height, width, generator=generator) * 2.0 - 1.0
        with torch.no_grad():
            expected = cast(Tensor, part.module(maps)).numpy()
        for name, run in runners.items():
            found = run(maps.numpy())
            if found.shape != expected.shape or not np.isfinite(found).all():
                raise ParityError(f"{part.name} on {name}: {found.shape} instead of {expected.shape}, or not finite")
            scale = max(1.0, float(np.abs(expected).max()))
            worst[name] = max(worst.get(name, 0.0), float(np.abs(found - expected).max()) / scale)
    bad = {name: value for name, value in worst.items() if not value <= BOUND}
    if bad:
        raise ParityError(f"{part.name}: off by {bad}, at most {BOUND} is allowed; nothing written")
    return worst


def _onnxruntime(data: bytes) -> Any:
    import onnxruntime as ort

    session = ort.InferenceSession(data, providers=["CPUExecutionProvider"])
    return lambda maps: session.run(["result"], {"maps": maps})[0]


def _openvino(data: bytes) -> Any:
    ov = openvino_library()

    core = ov.Core()
    compiled = core.compile_model(core.read_model(data), "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    return lambda maps: np.asarray(compiled(maps)[0])


def load_run(folder: Path) -> tuple[str, nn.Module, dict[str, Any]]:
    """Network name, module with the averaged weights, and the checkpoint's facts.

    Raises:
        ModelFault: there is no checkpoint.
    """
    path = folder / "checkpoint.pt"
    if not path.exists():
        raise ModelFault(f"{path} does not exist; train with: python -m models.training.train")
    content = torch.load(path, map_location="cpu", weights_only=True)
    run = content["run"]
    module = build(run["network"], run["config"])
    module.load_state_dict(content["average"])
    return run["network"], module, {**run, "steps_done": content["step"], "seconds": round(content["seconds"])}


def write(folder: Path, output: Path) -> list[str]:
    """Convert, check, write and register the files of a run; lines that say what was done.

    Raises:
        ParityError: a file fails the gate; nothing of the network is written.
    """
    network, module, facts = load_run(folder)
    done = []
    for part in parts_of(network, rounded(module)):
        model = to_onnx(part)
        data: bytes = model.SerializeToString(deterministic=True)
        done.append((part, data, check(part, data)))
    lines = []
    output.mkdir(parents=True, exist_ok=True)
    for part, data, worst in done:
        path = output / f"{part.name}.onnx"
        replace_file(path, lambda stream, data=data: stream.write(data))  # type: ignore[misc]
        source = f"trained on the synthetic light stage: config {facts['config']}, {facts['steps_done']} steps"
        shape: list[int | str] = [1, len(part.description["channels"]), "height", "width"]
        facts_of_file = {
            "licence": LICENCE, "source": source, "opset": OPSET, "inputs": {"maps": {"shape": shape}},
            "outputs": {"result": part.description["outputs"]},
        }  # fmt: skip
        register(part.name, path, facts_of_file)
        differences = ", ".join(f"{name} {value:.1e}" for name, value in worst.items())
        lines.append(f"{path.name}: {len(data) / 1e6:.2f} MB; against torch: {differences}")
    return lines


def main(
    run: Annotated[Path, typer.Argument(help="Folder of a training run.")],
    output: Annotated[Path, typer.Option("-o", help="Folder of the service's models.")] = MODELS,
) -> None:
    """Write the ONNX files of a trained network and their rows in models.json."""
    for line in write(run, output):
        typer.echo(line)


if __name__ == "__main__":
    typer.run(main)
