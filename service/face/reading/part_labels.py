"""What a pixel of a portrait shows, by number."""

from __future__ import annotations

PARTS = (
    "background", "skin", "brow", "beard", "lip", "mouth", "sclera", "iris", "hair", "glasses", "hat", "cloth", "other",
)  # fmt: skip
"""What a pixel shows: "mouth" are teeth, gums, tongue and lining, "iris" includes the pupil, "other" hides the face."""

(
    BACKGROUND, SKIN, BROW, BEARD, LIP, MOUTH, SCLERA, IRIS, HAIR, GLASSES, HAT, CLOTH, OTHER,
) = range(len(PARTS))  # fmt: skip

CHARTED = (SKIN, BROW, BEARD, LIP, MOUTH, SCLERA, IRIS, HAIR)
"""Parts that may carry chart coordinates (hair where it is painted on the scalp); all others never do."""

READ = (SKIN, BROW, BEARD, LIP, HAIR)
"""Parts whose chart coordinates the reader has learnt: the skin's island. Eyes and mouth lie in islands elsewhere."""
