"""The trained reader -> ``reader.onnx`` of the service: ``python -m export.networks.reader RUN_FOLDER --data SHARDS``.

The weights are the run's moving average, rounded to float16 for storage. Before they are written its standard
deviations are stretched to what held-out people say: a network is surer of people it has seen. The file is written only
where its outputs agree with torch on onnxruntime, on crops and on constants.
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
from models.networks.reader import CHART_MM, SIDE, Reader, ReaderSize
from models.training.reader import measured_on, shards
from service.archive.container import replace_file
from service.errors import ModelFault

OUTPUTS = ("chart", "chart_mm", "normal", "normal_sine", "parts")
SCALES = {"parts": 20.0, "chart_mm": 50.0}
"""What the difference is divided by where an output is not of about [-1, 1]."""
WITHIN_ONE, CHI3_MEDIAN = 0.3935, 1.5382
"""Share within one standard deviation in two dimensions; median of the distance in three, standard deviations."""


def load_run(folder: Path) -> tuple[Reader, int, float]:
    """The averaged network of a run, its steps and its minutes.

    Raises:
        ModelFault: there is no checkpoint.
    """
    path = folder / "checkpoint.pt"
    if not path.is_file():
        raise ModelFault(f"{path} does not exist; train with: python -m models.training.reader")
    content = torch.load(path, map_location="cpu", weights_only=True)
    network = Reader(ReaderSize(**content["size"]))
    network.load_state_dict(content["average"])
    return network.eval(), int(content["step"]), float(content["seconds"]) / 60.0


def calibrate(network: Reader, data: Path, most: int = 256) -> list[float]:
    """Set the factors of the standard deviations, of charts and of normals, by the first ``most`` held-out people.

    As many cells as a normal distribution has lie within one: 1 - exp(-1/2) of those of two axes, and half of the
    normals within the median of a chi distribution of three.

    Raises:
        ModelFault: there are none.
    """
    paths = shards(data, held_out=True)
    if not paths:
        raise ModelFault(f"{data}: no held-out shard; make some: python -m models.people --count 256 --out {data}")
    scale = torch.tensor(CHART_MM).view(1, 2, 1, 1)
    off, turned = [], []
    with torch.no_grad():
        for batch in measured_on(paths, most):
            read = network.read(batch.image)
            there, shaped = batch.charted > 0, batch.shaped > 0
            apart = ((read.chart - batch.chart) * scale).square().sum(1, keepdim=True).sqrt()
            off.append((apart / read.chart_mm)[there])
            turn = (read.normal - batch.normal).square().sum(1, keepdim=True).sqrt()
            turned.append((turn / read.normal_sine)[shaped])
    network.spread_scale[0] = float(torch.cat(off).kthvalue(int(WITHIN_ONE * sum(map(len, off))) + 1).values)
    network.spread_scale[1] = float(torch.cat(turned).median()) / CHI3_MEDIAN
    return [round(float(f), 2) for f in network.spread_scale]


def write(folder: Path, data: Path, output: Path) -> str:
    """Calibrate, convert, check, write and register; a line that says what was done.

    Raises:
        ParityError: the file fails the gate; nothing is written.
    """
    network, steps, minutes = load_run(folder)
    spread = calibrate(network, data)
    network = rounded(network)
    content, worst = convert(network, "crop", torch.zeros(1, 3, SIDE, SIDE), OUTPUTS, SCALES)
    output.mkdir(parents=True, exist_ok=True)
    path = output / "reader.onnx"
    replace_file(path, lambda stream: stream.write(content))
    measured = (folder / "log.jsonl").read_text(encoding="utf-8").splitlines()
    last = json.loads(measured[-1]) if measured else {}
    register("reader", path, {
        "licence": LICENCE, "source": f"trained on synthetic people: {steps} steps", "opset": OPSET,
        "inputs": {"crop": {"shape": [1, 3, SIDE, SIDE], "range": [0.0, 1.0], "colour": "sRGB"}},
        "outputs": {"chart": [1, 2, 64, 64], "chart_mm": [1, 1, 64, 64], "normal": [1, 3, 64, 64],
                    "normal_sine": [1, 1, 64, 64], "parts": [1, 13, 128, 128]},
    })  # fmt: skip
    told = f"chart {last.get('chart_mm_median')} mm, normals {last.get('normal_deg_mean')} degrees held out"
    told += f", standard deviations times {spread}"
    return f"{path.name}: {len(content) / 1e6:.2f} MB, {steps} steps, {minutes:.0f} minutes, {told}; off by {worst:.1e}"


def main(
    run: Annotated[Path, typer.Argument(help="Folder of a training run.")],
    data: Annotated[Path, typer.Option(help="Folder of shards with held-out people.")],
    output: Annotated[Path, typer.Option("-o", help="Folder of the service's models.")] = MODELS,
) -> None:
    """Write the reader's ONNX file and its row in models.json."""
    typer.echo(write(run, data, output))


if __name__ == "__main__":
    typer.run(main)
