"""Classes of skin tone by individual typology angle, as the field's tables give results."""

from __future__ import annotations

from models.lightstage.skin.subject import Subject

TONES = (("dark", -90.0, -30.0), ("brown", -30.0, 10.0), ("tan", 10.0, 28.0), ("light", 28.0, 90.0))
"""Name, least angle and what the angle stays below, in degrees (Chardon et al. 1991; intermediate counts as light)."""


def tone(seed: int) -> str:
    """Name of the class of a subject's skin."""
    angle = Subject.sample(seed).tone.typology_angle_deg
    return next((name for name, low, high in TONES if low <= angle < high), TONES[-1][0])
