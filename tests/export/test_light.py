"""The exported formulas of light: those that are shipped are those of the light stage."""

from __future__ import annotations

import dataclasses

import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
pytest.importorskip("onnx", reason="onnx is not installed: pip install '.[dev]'")

from export.faces.onnx_tools import ParityError  # noqa: E402
from export.light import convert  # noqa: E402

pytestmark = pytest.mark.train


@pytest.mark.parametrize("name", [part.name for part in convert.parts()])
def test_what_is_shipped_computes_what_torch_computes(name: str) -> None:
    part = next(part for part in convert.parts() if part.name == name)
    assert convert.check(part, (convert.LIGHT / f"{name}.onnx").read_bytes()) <= convert.ON_AN_EDGE


def test_the_gate_refuses_another_formula() -> None:
    by_name = {part.name: part for part in convert.parts()}
    wrong = dataclasses.replace(by_name["kept"], module=by_name["kept_flat"].module)
    with pytest.raises(ParityError, match="off by"):
        convert.check(by_name["kept"], convert.to_onnx(wrong))
