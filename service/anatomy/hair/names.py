"""Names that the option ``hair`` takes, without loading any style."""

from __future__ import annotations

from typing import Literal, get_args

HairName = Literal[
    "auto", "none", "afro01", "bob01", "bob02", "braid01", "long01", "ponytail01", "short01", "short02", "short03",
    "short04",
]  # fmt: skip
"""What the photo tells, nothing, or a style by name."""

AUTO, NONE = "auto", "none"
CHOICES: tuple[str, ...] = get_args(HairName)
STYLES = tuple(name for name in CHOICES if name not in (AUTO, NONE))
