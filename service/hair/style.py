"""What a hairdresser would say of a head of hair: a style, by name, by seed, or with every number given."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Le
from pydantic import Strict, StringConstraints, TypeAdapter
from pydantic.dataclasses import dataclass as checked_dataclass

from service.checks import CHECKED
from service.hair.colour import Melanin

Gather = Literal["none", "ponytail", "bun", "half_up", "plait", "two_plaits", "pinned"]
LOOSE: frozenset[Gather] = frozenset({"none", "half_up", "pinned"})
"""Ways under which some of the hair, or all of it, still hangs."""
Parting = Literal["none", "left", "middle", "right"]
Combing = Literal["natural", "down", "back", "forward", "side", "up"]
Curl = Literal["1", "2a", "2b", "2c", "3a", "3b", "3c", "4a", "4b", "4c"]
"""Andre Walker's types: 1 straight, 2 wavy, 3 curly, 4 coily."""


@dataclass(frozen=True)
class Wave:
    """Shape of one curl type along a strand.

    Attributes:
        radius_mm: of the helix; a wave has it across only.
        pitch_mm: length of the strand's middle line in one turn.
        flat: 1 for a wave in a plane, 0 for a round helix.
        frizz: share of the radius by which strands of a lock differ.
        begins: share of the strand's length at which it begins to show; up to there its weight draws it straight.
    """

    radius_mm: float
    pitch_mm: float
    flat: float
    frizz: float
    begins: float = 0.0


WAVES: Mapping[Curl, Wave] = {
    "1": Wave(0.0, 80.0, 1.0, 0.0),
    "2a": Wave(3.0, 80.0, 0.9, 0.15, 0.5), "2b": Wave(5.5, 62.0, 0.8, 0.2, 0.3), "2c": Wave(7.5, 48.0, 0.6, 0.25, 0.1),
    "3a": Wave(9.0, 34.0, 0.25, 0.2), "3b": Wave(7.0, 24.0, 0.1, 0.25), "3c": Wave(4.5, 16.0, 0.0, 0.3),
    "4a": Wave(2.8, 9.0, 0.0, 0.35), "4b": Wave(2.0, 6.5, 0.0, 0.5), "4c": Wave(1.4, 5.0, 0.0, 0.7),
}  # fmt: skip
"""After what hairdressers tell the types by: chalk for 3a, a marker for 3b, a pencil for 3c, a needle for 4a; and 2a is
straight to the middle of its length, while 2c waves from near the root."""


LENGTHS = ("top_mm", "fringe_mm", "sides_mm", "back_mm")
"""Lengths of strands by where they grow."""


_Name = Annotated[str, StringConstraints(pattern=r"^[^\W\d]\w{0,39}$")]
_Mm = Annotated[float, Strict(), Ge(0), Le(1500)]
_Share = Annotated[float, Strict(), Ge(0), Le(1)]


@checked_dataclass(frozen=True, config=CHECKED)
class Style:
    """A head of hair.

    Attributes:
        kind: what one would call it.
        top_mm, fringe_mm, sides_mm, back_mm: length of strands by where they grow; the fringe is what grows over the
            forehead.
        cut_y: height in metres in the head's frame at which everything that hangs is cut off; None for no such cut.
        layers: 0 for one height of cut, 1 for ends that are spread over a third of the length.
        parting: where the hair falls apart.
        combing: which way it lies before it hangs.
        lift: how far strands stand up from the skin, 0 to 1.
        gravity: how soon they hang, 0 (coils, gel) to 1.
        stiffness: how straight they go on, 0 to 1.
        curl: type.
        clump: how much the strands of a lock come together at its end, 0 to 1.
        lock_mm: distance between locks at the roots.
        frizz_mm: random wander of single strands.
        flyaways: share of strands that leave their lock.
        volume_mm: how far the outermost layer stands off the skin.
        gather: whether and how it is tied.
        tie_y: height in metres of the tie; two plaits have two.
        receding: of the temples, 0 to 1.
        crown: bald on the crown, 0 to 1.
        hairline: random rise and fall of the hairline, 0 to 1.
        tucked: how much of the hair beside the face lies behind the ears, 0 to 1.
        wisps: share of the hair along the hairline beside the face that has come loose from a tie, 0 to 1.
        fade: how far up the sides are clipped short, 0 to 1.
        density: strands for each that a full head has, 0 to 1.
        melanin: its pigment.

    Raises:
        pydantic.ValidationError: a value is out of range, or none of its choices.
    """

    kind: _Name
    top_mm: _Mm
    fringe_mm: _Mm
    sides_mm: _Mm
    back_mm: _Mm
    cut_y: Annotated[float, Strict(), Ge(-1), Le(0.2)] | None = None
    layers: _Share = 0.3
    parting: Parting = "none"
    combing: Combing = "natural"
    lift: _Share = 0.3
    gravity: _Share = 0.7
    stiffness: _Share = 0.6
    curl: Curl = "1"
    clump: _Share = 0.35
    lock_mm: Annotated[float, Strict(), Ge(0.5), Le(100)] = 9.0
    frizz_mm: _Mm = 0.6
    flyaways: _Share = 0.01
    volume_mm: _Mm = 14.0
    gather: Gather = "none"
    tie_y: Annotated[float, Strict(), Ge(-0.2), Le(0.2)] = 0.0
    receding: _Share = 0.0
    crown: _Share = 0.0
    hairline: _Share = 0.15
    tucked: _Share = 0.0
    wisps: _Share = 0.0
    fade: _Share = 0.0
    density: _Share = 1.0
    melanin: Melanin = field(default_factory=lambda: Melanin(0.45, 0.12))

    def scaled(self, factor: float, *names: str) -> Style:
        """With these lengths in mm times a factor, within 0.5 and 1200."""
        changed = {name: float(np.clip(getattr(self, name) * factor, 0.5, 1200)) for name in names}
        return dataclasses.replace(self, **changed)  # type: ignore[arg-type]


NAMED: Mapping[str, Style] = {
    style.kind: style
    for style in (
        Style("shaved", 2, 2, 1, 1, lift=0.75, gravity=0, stiffness=1, clump=0, frizz_mm=0.1, volume_mm=2, flyaways=0),
        Style("crop", 22, 18, 9, 9, combing="forward", lift=0.5, gravity=0.1, stiffness=0.9, clump=0.25, lock_mm=6,
              frizz_mm=0.4, volume_mm=9, fade=0.3),
        Style("side_part", 75, 90, 25, 20, parting="left", combing="side", lift=0.4, gravity=0.25, stiffness=0.8,
              fade=0.35, volume_mm=16),
        Style("slicked_back", 95, 110, 40, 35, combing="back", lift=0.25, gravity=0.2, stiffness=0.7, clump=0.3,
              lock_mm=7, frizz_mm=0.3, volume_mm=11),
        Style("afro", 75, 60, 65, 65, combing="up", lift=0.95, gravity=0.0, stiffness=0.9, curl="4b", clump=0.45,
              lock_mm=5, frizz_mm=2.5, flyaways=0.04, volume_mm=60),
        Style("bob", 300, 280, 240, 210, cut_y=-0.105, layers=0.05, parting="middle", combing="down", volume_mm=17,
              frizz_mm=0.4),
        Style("curly", 230, 200, 230, 230, cut_y=-0.17, layers=0.8, parting="left", curl="3b", clump=0.75, lock_mm=11,
              frizz_mm=1.2, flyaways=0.03, volume_mm=30, lift=0.5, gravity=0.5),
        Style("long_wavy", 520, 500, 480, 480, cut_y=-0.33, layers=0.6, parting="middle", combing="down", curl="2b",
              clump=0.6, lock_mm=13, volume_mm=20),
        Style("ponytail", 480, 480, 480, 480, combing="back", gather="ponytail", tie_y=0.045, clump=0.4,
              frizz_mm=0.4, volume_mm=8, lift=0.1),
        Style("bun", 380, 380, 380, 380, combing="back", gather="bun", tie_y=0.02, clump=0.4, frizz_mm=0.5,
              volume_mm=8, lift=0.1),
    )
}  # fmt: skip
"""Ten styles that most people can be given."""


def style_to_json(style: Style) -> dict[str, Any]:
    """JSON values of a style, numbers rounded to four digits."""
    values = dataclasses.asdict(style)
    melanin = {name: round(value, 4) for name, value in values.pop("melanin").items()}
    return {
        **{name: float(f"{value:.4g}") if isinstance(value, float) else value for name, value in values.items()},
        "melanin": melanin,
    }


def style_from_json(values: dict[str, Any]) -> Style:
    """The inverse of :func:`style_to_json`.

    Raises:
        pydantic.ValidationError: values are missing, unknown or out of range.
    """
    return TypeAdapter(Style).validate_python(values)
