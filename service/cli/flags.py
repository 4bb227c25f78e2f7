"""Options that several commands have, each said once, and the signatures of commands made from them."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Annotated, Any, NamedTuple, TypeVar

import typer

from service.hair.asked import parse_hair
from service.map_registry import MAP_NAMES
from service.options import Options

Command = TypeVar("Command", bound=Callable[..., None])

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object for machines.")]
Head = Annotated[str | None, typer.Option(metavar="FILE", help="Head model instead of the one in the box.")]


class Flag(NamedTuple):
    """An option that is None where it is not given.

    Attributes:
        help: of the command.
        kind: str, int or float.
        metavar: what stands for the value in the help.
        parse: makes the value of the text; None where it is the text.
        envvar: variable that it may come from.
    """

    help: str
    kind: type = str
    metavar: str | None = None
    parse: Callable[[str], Any] | None = None
    envvar: str | None = None


def with_flags(flags: Mapping[str, Flag]) -> Callable[[Command], Command]:
    """Gives a command flags in place of its ``**`` parameter."""

    def changed(command: Command) -> Command:
        own = inspect.signature(command, eval_str=True).parameters.values()
        taken = [
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=None,
                annotation=Annotated[
                    flag.kind | None, typer.Option(help=flag.help, metavar=flag.metavar, envvar=flag.envvar)
                ],
            )
            for name, flag in flags.items()
        ]  # fmt: skip
        plain = [item for item in own if item.kind is not inspect.Parameter.VAR_KEYWORD]
        command.__signature__ = inspect.Signature([*plain, *taken])  # type: ignore[attr-defined]
        return command

    return changed


MAPS = {
    "maps": Flag(f"Maps to write, joined by commas: {', '.join(MAP_NAMES)}. [default: all]"),
    "quality": Flag("draft, standard, high or reference. [default: standard]"),
    "size": Flag("Size of the maps, WIDTHxHEIGHT, 3:2. [default: the quality's]"),
    "bits": Flag("Bits of normal maps, 8 or 16. [default: the quality's]", int),
    "normals": Flag("Space of specular and diffuse normals: tangent or object. [default: tangent]"),
    "runtime": Flag("Of networks: auto, onnxruntime or openvino. [default: auto]"),
    "detail": Flag("How much detail finer than the photo is made up, 0 to 1. [default: 1]", float),
    "seed": Flag("Seed of every random choice. [default: 0]", int),
}
"""Fields of ``Options`` that concern maps, whatever they are made from."""

AVATAR = MAPS | {
    "texture_size": Flag("Size of the texture map, 3:2. [default: what the photo holds]", str, "auto|WIDTHxHEIGHT"),
    "budget": Flag("Take the best quality that fits into so many seconds.", float, "SECONDS"),
    "face": Flag("Which face to take where there are several: an index, or 'largest'."),
    "leave_out": Flag("Leave out photos of another person; else they are refused.", metavar="strangers"),
    "fit": Flag("Where the fit stops: 'landmarks', 'dense' or 'full'."),
    "identity_components": Flag("Identity components to fit.", int),
    "iterations": Flag("Steps of the landmark fit.", int),
    "hair": Flag("As the photo shows, none, a style (bob ...), a JSON file.", str, "auto|none|NAME|FILE", parse_hair),
    "hair_colour": Flag("Of the hair: the photo's, blond ..., or sRGB.", metavar="auto|NAME|#rrggbb"),
    "hair_length": Flag("Length of the longest strands in millimetres.", str, "auto|MM"),
    "eye_colour": Flag("Of the irises: the photo's, or brown, blue ...", metavar="auto|NAME"),
    "wrinkles": Flag("As deep as in the photo, or none, younger, older, old.", metavar="auto|NAME"),
    "mouth": Flag("As in the photo, or shut where it came out open.", metavar="auto|shut"),
    "without": Flag("For experts: corrections not to make; docs/corrections.md.", str, "NAME,..."),
}  # fmt: skip
"""All fields of ``Options``."""


def parsed(known: Mapping[str, Flag], flags: Mapping[str, Any]) -> dict[str, Any]:
    """Values of the flags that were given (are not None); UsageError where one cannot be read."""
    given = {name: (known[name].parse, value) for name, value in flags.items() if value is not None}
    return {name: value if parse is None else parse(value) for name, (parse, value) in given.items()}


def asked(flags: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of :class:`Options` whose flags were given, as JSON values; UsageError where one is not possible."""
    fields = parsed(AVATAR, flags)
    values = Options(**fields).to_json()
    return {name: values[name] for name in fields}


SERVER = {
    "data": Flag("Folder of jobs and results. [default: avatarme-data]", str, "DIR"),
    "jobs": Flag("Photos computed at the same time. [default: 1]", int),
    "database": Flag("Postgres that several machines share. [default: SQLite in DIR]", str, "URL"),
    "artifacts": Flag("Store that several machines share. [default: files in DIR]", str, "URL"),
}
"""Settings of a server and of a worker."""
