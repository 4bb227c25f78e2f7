"""The trained hair reader -> ``hair.onnx`` of the service: ``python -m export.networks.hair RUN_FOLDER --data SHARDS``.

The weights are the run's moving average, rounded to float16 for storage; ``--keep 0.5`` halves the way to them from the
weights that ship, from which the run must have begun (Wortsman et al., Robust fine-tuning of zero-shot models, 2022):
what both agree on serves photos better than what the last people taught. Before they are written each kind's logits are
made as sharp as held-out people say (temperature scaling, Guo et al. 2017), so that a probability is a frequency. The
file is written only where its outputs agree with torch on onnxruntime, on crops and on constants.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import torch
import typer

from export.faces.registry import MODELS, register
from export.networks.convert import LICENCE, OPSET, rounded
from export.networks.whole import convert
from models.networks.hair import CELL, COUNTS, LEAST_WAY, SIDE, HairReader
from models.networks.reader import ReaderSize
from models.people.shards import UNKNOWN
from models.training.hair import NOT_SHIPPED, calibration_set
from models.training.reader import shards
from models.training.restore import weights_for
from service.archive.container import replace_file
from service.errors import ModelFault
from service.hair.kinds import KINDS

OUTPUTS = ("mask", "direction", "spread", "kinds", "ends")
SCALES = {"mask": 20.0, "kinds": 20.0, "direction": 1 / LEAST_WAY}
"""What the difference is divided by where an output is not of about [-1, 1], or enlarges what it is made from."""
SHARPNESS = tuple(0.1 * k for k in range(3, 21))
"""Factors of the logits that are tried."""


def load_run(folder: Path) -> tuple[HairReader, int, float]:
    """The averaged network of a run, its steps and its minutes.

    Raises:
        ModelFault: there is no checkpoint.
    """
    path = folder / "checkpoint.pt"
    if not path.is_file():
        raise ModelFault(f"{path} does not exist; train with: python -m models.training.hair")
    content = torch.load(path, map_location="cpu", weights_only=True)
    network = HairReader(ReaderSize(**content["size"]) if "size" in content else None)
    network.load_state_dict(content["average"])
    return network.eval(), int(content["step"]), float(content["seconds"]) / 60.0


def keep(network: HairReader, share: float) -> None:
    """Mix a share in [0, 1] of the weights that ship into a network's.

    Raises:
        ModelFault: they are of another size.
    """
    if not 0 <= share <= 1:
        raise ModelFault(f"--keep is {share}; it goes from 0 to 1")
    state = network.state_dict()
    for name, values in weights_for(state, MODELS / "hair.onnx", NOT_SHIPPED).items():
        state[name].lerp_(values, share)


def calibrate(network: HairReader, data: Path) -> list[float]:
    """Set the sharpness of each kind's logits to the factor under which held-out people are likeliest.

    Raises:
        ModelFault: there are none.
    """
    paths = shards(data, held_out=True)
    if not paths:
        raise ModelFault(f"{data}: no held-out shard; make some: python -m models.people --framing hair --count 256")
    batch = calibration_set(paths)
    with torch.no_grad():
        said = network.read(batch.image).kinds.split(COUNTS, 1)
        for k, part in enumerate(said):
            told = batch.kinds[:, k] != UNKNOWN
            loss = [float(torch.nn.functional.cross_entropy(f * part[told], batch.kinds[told, k])) for f in SHARPNESS]
            network.sharpness[k] = SHARPNESS[loss.index(min(loss))]
    return [round(float(f), 2) for f in network.sharpness]


def write(folder: Path, data: Path, output: Path, kept: float = 0.0) -> str:
    """Mix in what is kept, calibrate, convert, check, write and register; a line that says what was done.

    Raises:
        ParityError: the file fails the gate; nothing is written.
    """
    network, steps, minutes = load_run(folder)
    keep(network, kept)
    sharpness = dict(zip(KINDS, calibrate(network, data), strict=True))
    network = rounded(network)
    content, worst = convert(network, "crop", torch.zeros(1, 3, SIDE, SIDE), OUTPUTS, SCALES)
    output.mkdir(parents=True, exist_ok=True)
    path, cells = output / "hair.onnx", SIDE // CELL
    replace_file(path, lambda stream: stream.write(content))
    measured = (folder / "log.jsonl").read_text(encoding="utf-8").splitlines()
    register("hair", path, {
        "licence": LICENCE, "source": f"trained on synthetic people: {steps} steps", "opset": OPSET,
        "inputs": {"crop": {"shape": [1, 3, SIDE, SIDE], "range": [0.0, 1.0], "colour": "sRGB"}},
        "outputs": {"mask": [1, 1, cells, cells], "direction": [1, 2, cells, cells], "spread": [1, 1, cells, cells],
                    "kinds": [1, sum(COUNTS)], "ends": [1, 2]},
    })  # fmt: skip
    told = json.loads(measured[-1]) if measured else {}
    return f"{path.name}: {len(content) / 1e6:.2f} MB, {steps} steps, {minutes:.0f} minutes, sharpness {sharpness}; " \
           f"held out {told}; off by {worst:.1e}"  # fmt: skip


def main(
    run: Annotated[Path, typer.Argument(help="Folder of a training run.")],
    data: Annotated[Path, typer.Option(help="Folder of shards with held-out people.")],
    kept: Annotated[float, typer.Option("--keep", help="Share of the weights that ship which stays.")] = 0.0,
    output: Annotated[Path, typer.Option("-o", help="Folder of the service's models.")] = MODELS,
) -> None:
    """Write the hair reader's ONNX file and its row in models.json."""
    typer.echo(write(run, data, output, kept))


if __name__ == "__main__":
    typer.run(main)
