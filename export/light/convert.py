"""The formulas of light -> ONNX files of the service: ``python -m export.light.convert``.

The renderer of avatars computes light by the very code that the light stage bakes with, exported like a network. Before
anything is written every file has to pass the gate: names, shapes and values against torch, on two sizes of which one
is not square, with inputs in which something is degenerate (no direction, grazing, light within the head).
"""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
import torch
import typer
from torch import Tensor, nn

from export.faces.onnx_tools import ParityError
from export.faces.registry import register
from export.light.examples import EXAMPLES, Inputs
from models.lightstage.light import graphs
from service.archive.container import replace_file
from service.runtime.networks import KEY

OPSET = 18
LICENCE = "Apache-2.0"
LIGHT = Path(__file__).parents[2] / "service" / "data" / "light"
SIZES = ((24, 24), (17, 40))
"""Rows and columns at which each graph is checked; the first one is the example of the exporter."""

BOUND = 2e-4
"""Largest difference from torch, relative to the output's own scale where that is more than 1."""

ON_AN_EDGE = 1e-3
"""For depth maps: mean difference. A point on the border of two cells may fall into either by its last bit."""


@dataclass(frozen=True)
class Part:
    """One file to be.

    Attributes:
        name: of the file.
        module: what it computes.
        inputs: makes named inputs for a size.
        axes: free axes by input and output.
        mean: whether the mean difference counts (``ON_AN_EDGE``) and not the largest.
    """

    name: str
    module: nn.Module
    inputs: Callable[[tuple[int, int]], Inputs]
    axes: dict[str, dict[int, str]]
    mean: bool = False


_ROWS = {1: "height", 2: "width"}
_FLAT = {0: "height", 1: "width"}
_DEPTH = {"occluders": {1: "casters"}, "points": {1: "count"}, "blank": {0: "side", 1: "side"}, "result": {0: "count"}}


def parts() -> list[Part]:
    """All graphs of the light."""
    vectors = {"position": _ROWS, "view": _ROWS, "normal": _ROWS, "shade": _FLAT, "specular": _FLAT, "alpha": _FLAT}
    surface = {"result": _ROWS, **vectors}
    made: list[tuple[str, nn.Module, dict[str, dict[int, str]]]] = [
        ("lit_from_direction", graphs.FromDirection(), _DEPTH),
        ("lit_from_point", graphs.FromPoint(), _DEPTH),
        ("irradiance", graphs.Irradiance(), surface),
        ("scattering", graphs.Scattering(), dict.fromkeys(("albedo", "arriving", "result"), _ROWS)
         | {"texels_per_mm": _FLAT, "mask": _FLAT}),
        ("reflection", graphs.Reflection(), surface | {"part": _FLAT, "openness": _FLAT}),
    ]  # fmt: skip
    for ending, rising in (("", True), ("_flat", False)):
        made.append((f"kept{ending}", graphs.Kept(rising=rising), {**surface, "result": _FLAT}))
        made.append((f"highlight{ending}", graphs.Highlight(rising=rising), surface))
    result = []
    for name, module, axes in made:
        inputs = EXAMPLES[name.removesuffix("_flat")]
        used = {key: axes[key] for key in (*inputs(SIZES[0]), "result") if key in axes}
        result.append(Part(name, module.eval(), inputs, used, mean=name.startswith("lit")))
    return result


def to_onnx(part: Part) -> bytes:
    """ONNX file with the module's own argument names as inputs, and one output ``result``."""
    import onnx

    example = part.inputs(SIZES[0])
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of tracing, and of the exporter that needs no further packages
        torch.onnx.export(
            part.module, tuple(example.values()), buffer, input_names=list(example), output_names=["result"],
            opset_version=OPSET, dynamic_axes=part.axes, dynamo=False,
        )  # fmt: skip
    model = onnx.load_from_string(buffer.getvalue())
    model.metadata_props.add(key=KEY, value=json.dumps({"inputs": list(example)}))
    onnx.checker.check_model(model, full_check=True)
    return cast(bytes, model.SerializeToString(deterministic=True))


def check(part: Part, data: bytes) -> float:
    """Difference from torch on all ``SIZES``.

    Raises:
        ParityError: other inputs or another shape than torch's, values that are not finite, or too large a difference.
    """
    import onnxruntime as ort

    session = ort.InferenceSession(data, providers=["CPUExecutionProvider"])
    worst = 0.0
    for size in SIZES:
        inputs = part.inputs(size)
        if [item.name for item in session.get_inputs()] != list(inputs):
            raise ParityError(f"{part.name}: inputs {[item.name for item in session.get_inputs()]}; nothing written")
        with torch.no_grad():
            expected = cast(Tensor, part.module(*inputs.values())).numpy()
        found = session.run(["result"], {name: value.numpy() for name, value in inputs.items()})[0]
        if found.shape != expected.shape or not np.isfinite(found).all():
            raise ParityError(f"{part.name}: {found.shape} instead of {expected.shape}, or not finite; nothing written")
        difference = np.abs(found - expected) / max(1.0, float(np.abs(expected).max()))
        worst = max(worst, float(difference.mean() if part.mean else difference.max()))
    if not worst <= (ON_AN_EDGE if part.mean else BOUND):
        raise ParityError(f"{part.name}: off by {worst:.2e}; nothing written")
    return worst


def write(output: Path = LIGHT) -> list[str]:
    """Convert, check, write and register all graphs; lines that say what was done.

    Raises:
        ParityError: a graph fails the gate; nothing is written.
    """
    done = [(part, data, check(part, data)) for part in parts() for data in (to_onnx(part),)]
    output.mkdir(parents=True, exist_ok=True)
    lines = []
    for part, data, worst in done:
        path = output / f"{part.name}.onnx"
        replace_file(path, lambda stream, data=data: stream.write(data))  # type: ignore[misc]
        facts: dict[str, Any] = {
            "licence": LICENCE, "source": "exported from models/lightstage/light by export/light", "opset": OPSET,
            "inputs": {name: {"shape": list(value.shape)} for name, value in part.inputs(SIZES[0]).items()},
            "outputs": {"result": list(part.axes["result"].values())},
        }  # fmt: skip
        register(part.name, path, facts)
        lines.append(f"{path.name}: {len(data)} bytes; {'mean' if part.mean else 'largest'} difference {worst:.1e}")
    return lines


def main(output: Annotated[Path, typer.Option("-o", help="Folder of the service's graphs.")] = LIGHT) -> None:
    """Write the graphs of light and their table."""
    for line in write(output):
        typer.echo(line)


if __name__ == "__main__":
    typer.run(main)
