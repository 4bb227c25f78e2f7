"""A run's checkpoint from the files that ship: ``python -m models.training.restore rho -o build/training/rho_compact``.

The weights are those of the service, rounded to float16. Training can begin with them (``--begin-with``), and the run
can be measured, averaged and converted like any other. What a checkpoint has besides (state of the optimiser, the
discriminator, the log) does not ship and begins afresh.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from torch import Tensor

from models.networks.configs import CONFIGS, NETWORKS, build
from models.training.train import TASKS
from models.training.trainer import Run, Trainer
from service.errors import ModelFault, UsageError
from service.runtime.sessions import MODELS, model_table

HALF = "_f16"
"""Ending of the names of weights that are stored as float16 (``export.faces.onnx_tools.store_half``)."""


def weights_of(path: Path) -> dict[str, Tensor]:
    """Weights in an ONNX file by the names that they have in torch, float32.

    Raises:
        ModelFault: there is no such file.
    """
    import onnx
    from onnx import numpy_helper

    if not path.exists():
        raise ModelFault(f"{path} does not exist; the networks of the service lie in {MODELS}")
    tensors = {t.name.removesuffix(HALF): numpy_helper.to_array(t) for t in onnx.load(str(path)).graph.initializer}
    return {name: torch.from_numpy(values.astype(np.float32)) for name, values in tensors.items()}


def weights_for(state: Mapping[str, Tensor], path: Path, apart: tuple[str, ...] = ()) -> dict[str, Tensor]:
    """Weights in an ONNX file of all that a network's state has.

    Args:
        state: of the network.
        path: the file.
        apart: beginnings of the names of what does not ship, and is left out.

    Raises:
        ModelFault: there is no such file, or its network is of another size.
    """
    found = weights_of(path)
    wanted = {name: values.shape for name, values in state.items() if not name.startswith(apart)}
    for name, shape in wanted.items():
        if name not in found or found[name].shape != shape:
            raise ModelFault(f"{path} has no {name} of {tuple(shape)}: its network is of another size")
    return {name: found[name] for name in wanted}


def shipped(network: str, folder: Path = MODELS) -> dict[str, Tensor]:
    """Weights of a network of the service; those of zeta lie in two files.

    Raises:
        ModelFault: a file is not there.
    """
    if network != "zeta":
        return weights_of(folder / f"{network}.onnx")
    return {f"{part}.{name}": values for part in ("body", "tail")
            for name, values in weights_of(folder / f"zeta_{part}.onnx").items()}  # fmt: skip


def restored(network: str, config: str, folder: Path = MODELS) -> dict[str, Tensor]:
    """State of a network of this size with the weights of the service.

    Raises:
        ModelFault: a file is not there, or its weights are of another size.
    """
    state, found = build(network, config).state_dict(), shipped(network, folder)
    for name, values in state.items():
        if name not in found or found[name].shape != values.shape:
            raise ModelFault(f"{folder}: {network} has no {name} of {tuple(values.shape)}; is its size {config!r}?")
    return {name: found[name] for name in state}


def steps_of(network: str, folder: Path = MODELS) -> int:
    """Steps that the shipped weights were trained for, as ``models.json`` says; 0 where it does not.

    Raises:
        ModelFault: the table is missing or not what it should be.
    """
    name = "zeta_body" if network == "zeta" else network
    found = re.search(r"(\d+) steps", str(model_table(folder).get(name, {}).get("source", "")))
    return int(found[1]) if found else 0


def main(
    network: Annotated[str, typer.Argument(help=f"One of: {', '.join(NETWORKS)}.")],
    output: Annotated[Path, typer.Option("-o", help="Folder of the new run.")],
    config: Annotated[str, typer.Option(help="Size of the network that ships.")] = "compact",
    side: Annotated[int, typer.Option(min=64, help="Of the training crops that it is measured on, texels.")] = 256,
) -> None:
    """Write a run whose last step left the weights of the service."""
    if network not in NETWORKS or config not in CONFIGS:
        raise UsageError(f"there is no {network!r} of size {config!r}: {', '.join(NETWORKS)}; {', '.join(CONFIGS)}")
    if (output / "checkpoint.pt").exists():
        raise UsageError(f"{output} has a checkpoint; name another folder")
    steps = steps_of(network)
    task = TASKS[network](output, side)  # reads nothing: a run that has not begun needs no captures
    trainer = Trainer(Run(network, config, steps, 1, side, 1e-4, 1, 0.0, 0.0), task, "cpu")
    trainer.step = steps
    trainer.take(restored(network, config))
    output.mkdir(parents=True, exist_ok=True)
    trainer.save(output)
    typer.echo(f"{output}: {network} {config} as it ships")


if __name__ == "__main__":
    typer.run(main)
