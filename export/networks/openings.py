"""The trained networks of lids and lips -> ONNX: ``python -m export.networks.openings RUN_FOLDER``.

Weights are rounded to float16 for storage; a file is written only where its outputs agree with torch on onnxruntime.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import torch
import typer

from export.faces.registry import MODELS, register
from export.networks.convert import LICENCE, OPSET, rounded
from export.networks.whole import convert
from models.networks.openings import STATIONS, OpeningNetwork
from service.archive.container import replace_file
from service.errors import ModelFault
from service.face.reading.openings import KINDS, OpeningKind

OUTPUTS = ("heights", "scatter")


def write(folder: Path, kind: OpeningKind, output: Path) -> str:
    """Convert, check, write and register one kind; a line that says what was done.

    Raises:
        ModelFault: the run has no such network.
        ParityError: the file fails the gate; nothing is written.
    """
    source = folder / f"{kind.name}.pt"
    if not source.is_file():
        raise ModelFault(f"{source} does not exist; train with: python -m models.training.openings")
    content = torch.load(source, map_location="cpu", weights_only=True)
    network = OpeningNetwork(content["side"])
    network.load_state_dict(content["state"])
    data, worst = convert(rounded(network), "patch", torch.zeros(1, 3, kind.side, kind.side), OUTPUTS, {})
    path = output / f"{kind.name}.onnx"
    replace_file(path, lambda stream: stream.write(data))
    register(kind.name, path, {
        "licence": LICENCE, "source": f"trained on synthetic people: {content['steps']} steps", "opset": OPSET,
        "inputs": {"patch": {"shape": [1, 3, kind.side, kind.side], "range": [0.0, 1.0], "colour": "sRGB"}},
        "outputs": {name: [1, 2, STATIONS] for name in OUTPUTS},
    })  # fmt: skip
    told = ", ".join(f"{name} {value:.2f}" for name, value in content["held_out"].items())
    return f"{path.name}: {len(data) / 1e6:.2f} MB, held out: {told}; off by {worst:.1e}"


def main(
    run: Annotated[Path, typer.Argument(help="Folder of a training run.")],
    output: Annotated[Path, typer.Option("-o", help="Folder of the service's models.")] = MODELS,
) -> None:
    """Write the ONNX files of the networks that the run has, lids or lips or both, and their rows in models.json."""
    found = [kind for kind in KINDS if (run / f"{kind.name}.pt").is_file()] or KINDS
    for kind in found:
        typer.echo(write(run, kind, output))


if __name__ == "__main__":
    typer.run(main)
