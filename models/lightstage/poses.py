"""Expressions in which each subject is captured."""

from __future__ import annotations

from models.lightstage.skin.streams import Stream

UNITS: dict[str, dict[str, float]] = {
    "neutral": {},
    "smile": {"mouthSmileLeft": 0.85, "mouthSmileRight": 0.85, "cheekSquintLeft": 0.6, "cheekSquintRight": 0.6,
              "eyeSquintLeft": 0.35, "eyeSquintRight": 0.35, "mouthDimpleLeft": 0.3, "mouthDimpleRight": 0.3},
    "frown": {"browDownLeft": 0.9, "browDownRight": 0.9, "mouthFrownLeft": 0.7, "mouthFrownRight": 0.7,
              "eyeSquintLeft": 0.3, "eyeSquintRight": 0.3, "mouthShrugLower": 0.4},
    "surprise": {"browInnerUp": 0.9, "browOuterUpLeft": 0.85, "browOuterUpRight": 0.85, "eyeWideLeft": 0.7,
                 "eyeWideRight": 0.7, "jawOpen": 0.45},
    "mouth_open": {"jawOpen": 0.75},
    "eyes_closed": {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0},
    "disgust": {"noseSneerLeft": 0.9, "noseSneerRight": 0.9, "mouthUpperUpLeft": 0.5, "mouthUpperUpRight": 0.5,
                "browDownLeft": 0.5, "browDownRight": 0.5, "eyeSquintLeft": 0.5, "eyeSquintRight": 0.5},
    "pucker": {"mouthPucker": 0.8, "mouthFunnel": 0.2},
}  # fmt: skip
"""Named expressions from ARKit units; the first seven are the set that the subjects of the list are captured in."""

EXPRESSIONS = tuple(UNITS)[:7]


def expression(name: str, seed: int) -> dict[str, float]:
    """Units of an expression as one person makes it: stronger or weaker, and a little more on one side.

    Raises:
        KeyError: no expression has that name; the message lists those that exist.
    """
    if name not in UNITS:
        raise KeyError(f"no expression {name!r}; there are {', '.join(UNITS)}")
    stream = Stream(seed, f"expression {name}")
    strength, left = stream.one(0.75, 1.12), stream.one(-0.12, 0.12)
    side = {"Left": 1.0 + left, "Right": 1.0 - left}
    result = {}
    for unit, value in UNITS[name].items():
        factor = next((f for end, f in side.items() if unit.endswith(end)), 1.0)
        result[unit] = min(1.0, max(0.0, value * strength * factor))
    return result
