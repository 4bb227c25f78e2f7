"""Names that the option ``hair`` takes, without loading any style."""

from __future__ import annotations

AUTO, NONE = "auto", "none"
STYLES = (
    "afro01", "bob01", "bob02", "braid01", "long01", "ponytail01", "short01", "short02", "short03", "short04",
)  # fmt: skip
CHOICES = (AUTO, NONE, *STYLES)
