"""What a caller may ask of hair, without loading any numeric library: the command line starts with it."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import ValidationError

from service.checks import refused
from service.errors import UsageError

AUTO, NONE = "auto", "none"
StyleName = Literal[
    "shaved", "crop", "side_part", "slicked_back", "afro", "bob", "curly", "long_wavy", "ponytail", "bun"
]  # fmt: skip
"""Styles by name; ``service.hair.style.NAMED`` has their numbers."""
STYLES: tuple[str, ...] = get_args(StyleName)
ColourName = Literal[
    "auto", "black", "dark_brown", "brown", "light_brown", "dark_blond", "blond", "platinum", "red", "auburn", "grey",
    "white",
]  # fmt: skip
"""The photo's, or a natural colour by name; ``service.hair.colour.COLOURS`` has their pigment."""
COLOURS: tuple[str, ...] = get_args(ColourName)
LENGTHS_MM = (1, 1200)
"""Shortest and longest hair that can be asked for."""

HairChoice = str | dict[str, Any]
"""``auto``, ``none``, the name of a style, or the numbers of one (the fields of ``service.hair.style.Style``)."""


@dataclass(frozen=True)
class AskedHair:
    """The options of hair.

    Attributes:
        style: as ``HairChoice``.
        colour: a name out of ``COLOURS``, or ``#rrggbb``, sRGB, of the hair under white light.
        length_mm: of the longest strands; None for the style's, or the photo's.
    """

    style: HairChoice = AUTO
    colour: str = AUTO
    length_mm: float | None = None

    @property
    def named(self) -> bool:
        """Whether a style was asked for, whatever the photo shows."""
        return self.style not in (AUTO, NONE)


def checked_hair(hair: HairChoice) -> HairChoice:
    """The same.

    Raises:
        UsageError: there is no style of this name, or its numbers are none.
    """
    if isinstance(hair, str):
        name = hair.strip().replace("-", "_")
        if name not in (AUTO, NONE, *STYLES):
            raise UsageError(f"hair is {hair!r}; there are auto, none, {', '.join(STYLES)}", field="hair")
        return name
    from service.hair.style import Style, style_from_json  # loads numpy, which the command line does without

    try:
        style_from_json(hair)
    except ValidationError as error:
        raise UsageError(f"hair is no style: {refused(error, Style).message}", field="hair") from error
    return hair


def checked_colour(colour: str) -> str:
    """The same.

    Raises:
        UsageError: it is neither a name nor ``#rrggbb``.
    """
    name = colour.strip().lower().replace("-", "_")
    if name not in COLOURS and not re.fullmatch("#[0-9a-f]{6}", name, re.ASCII):
        raise UsageError(
            f"hair_colour is {colour!r}; there are {', '.join(COLOURS)}, or #rrggbb as of #5a3b25", field="hair_colour"
        )
    return name


def parse_hair(text: str) -> HairChoice:
    """``auto``, ``none``, a style's name, or the name of a file with a style as JSON.

    Raises:
        UsageError: the file cannot be read or has no JSON object.
    """
    if not text.endswith(".json"):
        return text
    try:
        values = json.loads(Path(text).read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"hair is {text!r}, which holds no style: {error}", field="hair") from error
    if not isinstance(values, dict):
        raise UsageError(f"hair is {text!r}, which holds no JSON object but {type(values).__name__}", field="hair")
    return values


def parse_length(text: str) -> float | None:
    """``auto`` or millimetres.

    Raises:
        UsageError: it is neither.
    """
    bare = text.strip().lower().removesuffix("mm").strip()
    if bare == AUTO:
        return None
    try:
        return float(bare)
    except ValueError:
        words = f"hair_length is {text!r}; it has to be 'auto' or millimetres, {LENGTHS_MM[0]} to {LENGTHS_MM[1]}"
        raise UsageError(words, field="hair_length") from None
