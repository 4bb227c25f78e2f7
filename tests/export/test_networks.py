"""What leaves the gate computes what torch computes, and what does not, does not leave."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")

from export.faces.onnx_tools import ParityError  # noqa: E402
from export.networks.convert import check, load_run, parts_of, rounded, to_onnx, write  # noqa: E402
from models.networks.configs import build  # noqa: E402
from models.training.trainer import Run  # noqa: E402
from service.runtime.networks import KEY, Description, Engine, open_network  # noqa: E402  # noqa: E402

pytestmark = pytest.mark.train


def run_of(network: str, folder: Path) -> Path:
    """A training run that ended before it began."""
    torch.manual_seed(0)
    module = build(network, "slim")
    settings = asdict(Run(network, "slim", 1, 1, 64, 1e-3, 0, 0.0, 0.0))
    torch.save({"run": settings, "step": 0, "seconds": 0.0, "average": module.state_dict()}, folder / "checkpoint.pt")
    return folder


@pytest.mark.parametrize("network", ["delta", "psi", "rho", "sigma", "delta_context", "zeta"])
def test_the_service_runs_what_was_trained(network: str, tmp_path: Path) -> None:
    """Through the service's own seam, at a size that the exporter did not see."""
    write(run_of(network, tmp_path), tmp_path / "models")
    _, module, _ = load_run(tmp_path)
    for part in parts_of(network, rounded(module)):
        with open_network(part.name, Engine(threads=1, folder=tmp_path / "models")) as shipped:
            what = shipped.description
            inner = (what.stride * 5, what.stride * 9)
            height, width = part.sizes[0] if what.whole else (side + 2 * what.margin for side in inner)
            maps = np.random.default_rng(0).uniform(-1, 1, (len(what.channels), height, width)).astype(np.float32)
            with torch.no_grad():
                expected = part.module(torch.from_numpy(maps)[None])[0].numpy()
            result = np.asarray(shipped._compiled(maps[None]))[0]  # whole networks check their size before running
            assert np.abs(result - expected).max() <= 1e-3 * max(1.0, float(np.abs(expected).max()))


def test_a_file_says_what_it_is(tmp_path: Path) -> None:
    """The service reads channels, stride and margin from the file alone."""
    (part,) = parts_of("rho", build("rho", "slim").eval())
    model = to_onnx(part)
    text = next(p.value for p in model.metadata_props if p.key == KEY)
    found = Description.parse(text, "rho")
    assert json.loads(text)["network"] == "rho" and found.margin % found.stride == 0
    assert found.outputs == ("specular_slope_x", "specular_slope_y")


def test_the_kernels_of_every_convolution_are_known_when_the_file_is_loaded(tmp_path: Path) -> None:
    """One that follows from the shape of an input is put together anew for every tile, and cannot be quantised."""
    for network in ("delta", "psi", "rho"):
        write(run_of(network, tmp_path), tmp_path / "models")
        options = onnxruntime.SessionOptions()
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_BASIC
        options.optimized_model_filepath = str(tmp_path / "folded.onnx")
        onnxruntime.InferenceSession(str(tmp_path / "models" / f"{network}.onnx"), options, ["CPUExecutionProvider"])
        graph = onnx.load(str(tmp_path / "folded.onnx")).graph
        known = {tensor.name for tensor in graph.initializer}
        assert all(node.input[1] in known for node in graph.node if node.op_type == "Conv"), network


def test_a_network_that_differs_is_refused() -> None:
    """Weights that change between the two would slip through a gate that compares a file with itself."""
    (part,) = parts_of("psi", build("psi", "slim").eval())
    data = to_onnx(part).SerializeToString()
    assert max(check(part, data).values()) < 1e-3
    with torch.no_grad():
        for values in part.module.parameters():
            values.mul_(1.5)
    with pytest.raises(ParityError, match="psi"):
        check(part, data)
