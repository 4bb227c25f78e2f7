"""Whatever a stage hands on can be kept on disk, and it sees nothing but what it is given: told from the source."""

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
        AssertionError: there is a class that cannot be kept, or a type that does not tell.
    """
    kind = typing.get_origin(annotation) or annotation
    for argument in typing.get_args(annotation) if kind is not np.ndarray else ():
        if not isinstance(argument, str | int):  # of a Literal
            dataclasses_in(argument, seen)
    assert kind is not Any, "Any would hide a class that cannot be kept"
    if not isinstance(kind, type) or kind is UnionType:
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


def test_a_stage_sees_only_what_it_is_given() -> None:
    """A function of the module cannot see a request's options, so its result follows from its arguments."""
    tree, seen = ast.parse(inspect.getsource(service.pipeline)), set()
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        if getattr(call.func, "id", "") == "kept":
            stage = getattr(service.pipeline, getattr(call.args[1], "id", ""), None)
            assert inspect.isfunction(stage), ast.unparse(call)
            seen.add(ast.literal_eval(call.args[0]))
    assert {"detect", "fit", "hair", "texture", "compare"} <= seen


def test_stages_of_the_maps_see_only_what_they_are_found_by() -> None:
    """All but the last of them are closures within one function, whose arguments they are found by."""
    module = service.reflectance.reflectance
    tree = ast.parse(inspect.getsource(module))
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    made = [node for node in ast.walk(functions["make_reflectance"]) if isinstance(node, ast.Call)]
    stages = [call.args[1] for call in made if getattr(call.func, "id", "") == "run"]
    assert all(isinstance(stage, ast.Name) and stage.id in functions for stage in stages)
    inner = [node for node in made if getattr(node.func, "id", "") == "_by_networks"]
    handed = [ast.unparse(one) for call in inner for one in call.args]
    assert handed[0] == "*given" and not {"subject", "stages", "coloured"} & set(handed)
