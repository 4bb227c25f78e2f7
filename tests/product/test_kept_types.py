"""Whatever a stage of the pipeline hands on can be kept on disk, told from the annotations of the stages."""

from __future__ import annotations

import ast
import inspect
import typing
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from types import ModuleType, UnionType
from typing import Any

import numpy as np
import pytest

import service.pipeline
import service.reflectance.reflectance
from service.jobs.stage_files import kept_types


def return_types(module: ModuleType) -> Iterator[Any]:
    """Return types of the functions that stages of a pipeline are given, by name or as what a lambda calls."""
    tree, names = ast.parse(inspect.getsource(module)), vars(module)
    local = {node.name: node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        if getattr(call.func, "id", getattr(call.func, "attr", "")) not in ("kept", "get_or_compute", "run"):
            continue
        given = [getattr(getattr(one, "body", None), "func", one) for one in call.args]
        for name in {one.id for one in given if isinstance(one, ast.Name)}:
            returned = local[name].returns if name in local else None
            if returned is not None:
                yield eval(ast.unparse(returned), names)  # noqa: S307 - our own source
            elif inspect.isfunction(names.get(name)):
                yield typing.get_type_hints(names[name]).get("return")


PLAIN = (bool, int, float, str, type(None), np.ndarray, np.generic, tuple, list, Mapping)


def dataclasses_in(annotation: Any, seen: set[type]) -> set[type]:
    """Adds the dataclasses that a type mentions, and those of their fields, to ``seen``.

    Raises:
        AssertionError: there is a class that cannot be kept.
    """
    for argument in typing.get_args(annotation):
        if not isinstance(argument, str | int):  # of a Literal
            dataclasses_in(argument, seen)
    kind = typing.get_origin(annotation) or annotation
    if not isinstance(kind, type) or kind in (Any, UnionType):
        return seen
    if not is_dataclass(kind):
        assert issubclass(kind, (*PLAIN, np.dtype)), f"no {kind.__qualname__} can be kept"
    elif kind not in seen:
        seen.add(kind)
        for name, field in typing.get_type_hints(kind).items():
            if name in kind.__dataclass_fields__:
                dataclasses_in(field, seen)
    return seen


@pytest.mark.parametrize(
    "module", [service.pipeline, service.reflectance.reflectance], ids=lambda module: module.__name__
)
def test_all_that_stages_hand_on_can_be_kept(module: ModuleType) -> None:
    handed_on: set[type] = set()
    for annotation in return_types(module):
        dataclasses_in(annotation, handed_on)
    assert handed_on, "the stages are written differently now"
    assert handed_on <= set(kept_types(service.pipeline).values())
