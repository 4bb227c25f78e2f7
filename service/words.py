"""Words for stable codes: of warnings, which tell what makes an avatar less certain than usual, and of problems."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

WarningCode = Literal[
    "icc-ignored", "extra-images-ignored", "transparent", "focal-ignored", "no-colour", "photo-made-smaller",
    "landmarks-read", "landmarks-inconsistent", "landmarks-uncertain", "low-resolution", "turned-90", "turned-180",
    "turned-270", "face-at-edge", "under-exposed", "eyes-covered", "extreme-pose", "low-confidence", "gaze-not-seen",
    "not-read", "no-light", "little-seen", "not-segmented", "glasses-removed", "brows-made-up", "face-covered",
    "photos-left-out", "over-budget", "small-tiles", "hair-unseen", "hair-kind-doubtful", "hair-style-poor",
    "hair-colour-guessed", "hair-not-for-this-head",
]  # fmt: skip
"""Every code that a stage may issue: the fields that carry warnings have this type."""

WORDS: dict[str, dict[str, str]] = json.loads((Path(__file__).parent / "data" / "words.json").read_text("utf-8"))
"""By code: a sentence for each of the ``warnings``, which the page is built from too, and ``titles`` and
``explanations`` of problems."""
