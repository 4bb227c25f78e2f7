from __future__ import annotations

import json
from collections.abc import Collection
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from service.checks import shown
from service.errors import UsageError
from service.map_registry import MAP_NAMES
from service.options import (
    LARGEST_SEED,
    TEXTURE_MAPS,
    Options,
    default_maps,
    parse_size,
)

NAN, INF = float("nan"), float("inf")
WRONG: dict[str, tuple[Any, ...]] = {
    "maps": ((), ("texture", "texture"), ("../texture",)),
    "size": ((576, 383), (0, 0), (-576, -384), (95, 63), (6147, 4098), (576.0, 384.0), (576,), (10**30, 10**30)),
    "texture_size": ((1000, 1000), (9000, 6000), "large", None),
    "face": (-1, "smallest", True, 1.0),
    "seed": (-1, LARGEST_SEED + 1, NAN, True),
    "fit": ("magic",), "quality": ("best", None), "bits": (12, True), "normals": ("world",), "runtime": ("coreml",),
    "detail": (-0.1, 1.5, NAN, True, "much"),
    "budget": (0, -3.0, NAN, INF, True),
    "identity_components": (-1, 2.5), "iterations": (0, INF),
}  # fmt: skip
BAD = [(name, value) for name, values in WRONG.items() for value in values]


@pytest.mark.parametrize(("name", "value"), BAD)
def test_a_value_out_of_range_is_refused_with_name_value_and_what_would_be_right(name: str, value: Any) -> None:
    with pytest.raises(UsageError) as refusal:
        Options(**{name: value})
    told, right = refusal.value.message.split("; ", 1)
    assert refusal.value.extra["field"] == name
    assert told.startswith(f"{name} is ") or (name == "maps" and told.startswith("maps has "))
    assert shown(value) in told or name in ("maps", "size", "texture_size"), "the value as it was given"
    assert right.startswith("it has to be ") or name in ("maps", "size", "texture_size")
    assert right.removeprefix("it has to be ") != "one of None", "a type without words for what is right"


@pytest.mark.parametrize(("name", "text"), [("seed", "7"), ("detail", "1"), ("iterations", "8"), ("seed", 7.0)])
def test_nothing_is_converted_behind_the_callers_back(name: str, text: Any) -> None:
    """``"7"`` for a number is a mistake of the caller's, which another value would hide."""
    with pytest.raises(UsageError, match=name):
        Options(**{name: text})


def test_what_was_asked_comes_back_from_its_json() -> None:
    """As jobs do, whose options lie in a data base: tuples come back as lists."""
    asked = Options(
        maps=("confidence", "texture"), size=(1152, 768), texture_size=(96, 64), face="largest", seed=7, budget=3
    )
    read = json.loads(json.dumps(asked.to_json()))
    assert Options(**read) == TypeAdapter(Options).validate_python(read) == asked
    with pytest.raises(UsageError, match="seed is -1"):
        TypeAdapter(Options).validate_python(read | {"seed": -1})


def test_a_name_of_a_hairstyle_that_does_not_exist() -> None:
    """The name comes before what is missing because of it, and those that exist are listed."""
    with pytest.raises(UsageError, match=r"hair is no style: there is no lenght; there are kind, top_mm, "):
        Options(hair={"lenght": 3})


def list_networks(monkeypatch: pytest.MonkeyPatch, names: Collection[str]) -> None:
    """Make an installation that has these networks of maps."""
    monkeypatch.setattr("service.runtime.sessions.model_table", lambda: {name: {} for name in names})


def test_maps_are_left_out_by_default_where_their_networks_are_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    list_networks(monkeypatch, {"zeta_body", "delta_context", "delta", "psi"})
    assert Options().plan().stages == ("diffuse_albedo", "specular_albedo"), "half of zeta is of no use"
    surface = ("roughness", "thickness", "albedo_error")
    assert default_maps() == ("diffuse_albedo", "specular_albedo", *surface, *TEXTURE_MAPS)


@pytest.mark.parametrize(("asked", "maps", "texture"), [
    ({"maps": TEXTURE_MAPS}, None, (576, 384)),
    ({"maps": TEXTURE_MAPS, "size": (1152, 768)}, None, (1152, 768)),
    ({"maps": MAP_NAMES, "quality": "draft"}, (1536, 1024), (576, 384)),
    ({"maps": MAP_NAMES, "quality": "draft", "size": (192, 128)}, (192, 128), (192, 128)),
    ({"maps": MAP_NAMES, "size": (3072, 2048)}, (3072, 2048), (576, 384)),
])  # fmt: skip
def test_which_maps_a_size_is_of(asked: dict[str, Any], maps: tuple[int, int] | None, texture: tuple[int, int]) -> None:
    options = Options(**asked)
    assert options.base_size == texture
    assert maps is None or options.map_size == maps


@pytest.mark.parametrize(("asked", "most"), [
    ({}, 6144),
    ({"quality": "draft"}, 576),
    ({"size": (3072, 2048)}, 3072),
    ({"maps": TEXTURE_MAPS}, 6144),
    ({"maps": TEXTURE_MAPS, "size": (1152, 768)}, 1152),
])  # fmt: skip
def test_how_large_a_texture_may_become_by_itself(asked: dict[str, Any], most: int) -> None:
    assert Options(**asked).most_texture_width == most


def test_the_texture_s_size_is_auto_or_on_the_chart() -> None:
    written: Any = " Auto "
    assert Options(texture_size=written).texture_size == "auto" == Options().texture_size
    written = "1152x768"
    assert Options(texture_size=written).texture_size == (1152, 768)
    written = "1152"
    with pytest.raises(UsageError, match="texture_size is '1152'; write WIDTHxHEIGHT") as refusal:
        Options(texture_size=written)
    assert refusal.value.extra["field"] == "texture_size"
    with pytest.raises(UsageError, match="texture_size is 1152x700; the chart is 3:2"):
        Options(texture_size=(1152, 700))


@given(st.text(max_size=20))
@example("0\x1f")
@example("0\xa0")
def test_any_text_is_parsed_or_refused(text: str) -> None:
    """No other exception, and no number that Python alone would read (``1_0``, Arabic digits, a sign)."""

    def parse_face(written: Any) -> Any:
        return Options(face=written).face

    for parse in (parse_size, parse_face):
        try:
            parsed = parse(text)
        except UsageError:
            continue
        assert text.isascii()
        assert "_" not in text
        assert parsed == "largest" or all(number >= 0 for number in ([parsed] if isinstance(parsed, int) else parsed))
