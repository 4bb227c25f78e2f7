"""Expressions by seed: faces at rest, faces that people make, and single units of all 52 in any mixture."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.lightstage.poses import UNITS
from models.lightstage.skin.streams import Stream

Float = npt.NDArray[np.float64]

FACES: dict[str, dict[str, float]] = {
    **UNITS,
    "laugh": {"mouthSmileLeft": 0.8, "mouthSmileRight": 0.8, "jawOpen": 0.35, "cheekSquintLeft": 0.6,
              "cheekSquintRight": 0.6, "mouthUpperUpLeft": 0.35, "mouthUpperUpRight": 0.35, "eyeSquintLeft": 0.5,
              "eyeSquintRight": 0.5},
    "grin": {"mouthSmileLeft": 0.7, "mouthSmileRight": 0.7, "mouthStretchLeft": 0.3, "mouthStretchRight": 0.3,
             "mouthUpperUpLeft": 0.4, "mouthUpperUpRight": 0.4, "mouthLowerDownLeft": 0.4, "mouthLowerDownRight": 0.4},
    "yawn": {"jawOpen": 0.95, "eyeSquintLeft": 0.6, "eyeSquintRight": 0.6, "browInnerUp": 0.3, "mouthFunnel": 0.2},
    "tongue": {"jawOpen": 0.4, "tongueOut": 0.9},
    "press": {"mouthPressLeft": 0.8, "mouthPressRight": 0.8, "mouthRollLower": 0.4, "mouthRollUpper": 0.3},
    "speech": {"jawOpen": 0.18, "mouthFunnel": 0.3, "mouthLowerDownLeft": 0.2, "mouthLowerDownRight": 0.2},
    "smirk": {"mouthSmileLeft": 0.7, "mouthDimpleLeft": 0.5, "mouthLeft": 0.2, "browOuterUpRight": 0.5},
    "puff": {"cheekPuff": 0.9, "mouthPressLeft": 0.4, "mouthPressRight": 0.4},
    "sad": {"browInnerUp": 0.8, "mouthFrownLeft": 0.6, "mouthFrownRight": 0.6, "mouthShrugLower": 0.3},
    "anger": {"browDownLeft": 0.9, "browDownRight": 0.9, "mouthLowerDownLeft": 0.5, "mouthLowerDownRight": 0.5,
              "noseSneerLeft": 0.5, "noseSneerRight": 0.5, "jawOpen": 0.15},
}  # fmt: skip
"""What a face is made of, by ARKit units."""

EYES = ("open", "open", "open", "open", "open", "open", "half", "closed", "wink")
"""States of the eyes; each entry is as likely as another."""
MOST_MOUTH = 3.2
"""Sum of the units of mouth and jaw beyond which they are weakened together: faces fold up otherwise."""
SHUT = 0.97
"""Activation of eyeBlink from which an eye counts as closed: no iris shows."""


def draw_expression(seed: int, names: tuple[str, ...]) -> tuple[Float, str]:
    """(E,) activations in [0, 1] and the state of the eyes, one of ``EYES``, of the person ``seed``."""
    s = Stream(seed, "face")
    units = dict.fromkeys(names, 0.0)
    kind = s.one()
    if kind > 0.2:  # a face that people make, more or less of it
        face = FACES[tuple(FACES)[int(s.one() * len(FACES))]]
        strength, tilt = s.one(0.3, 1.15), s.normal(0.0, 0.15)[0]
        for name, value in face.items():
            side = 1.0 + tilt if name.endswith("Left") else 1.0 - tilt if name.endswith("Right") else 1.0
            units[name] += value * strength * side
    if kind > 0.6:  # anything on top
        for _ in range(1 + int(s.one() * 6)):
            name = names[int(s.one() * len(names))]
            value = s.one() ** 1.5
            units[name] += value
            partner = name.replace("Left", "Right") if "Left" in name else name.replace("Right", "Left")
            if s.chance(0.7):
                units[partner] = max(units[partner], value * s.one(0.7, 1.0))
    for name in names:  # nobody is quite still
        units[name] += max(0.0, s.normal(-0.03, 0.05)[0])
    state = _eyes(units, Stream(seed, "eyes"))
    _possible(units)
    return np.clip(np.array([units[name] for name in names]), 0.0, 1.0), state


def _eyes(units: dict[str, float], s: Stream) -> str:
    """Blinks and gaze; both eyes look the same way but for a little."""
    for name in units:
        if name.startswith(("eyeBlink", "eyeLook")):
            units[name] = 0.0
    state = EYES[int(s.one() * len(EYES))]
    blink = {"open": s.one(-0.1, 0.25), "half": s.one(0.35, 0.75), "closed": 1.0, "wink": 1.0}[state]
    left = blink
    right = s.one(0.0, 0.3) if state == "wink" else blink + (s.normal(0.0, 0.03)[0] if blink < SHUT else 0.0)
    if state == "wink" and s.chance(0.5):
        left, right = right, left
    units["eyeBlinkLeft"], units["eyeBlinkRight"] = max(left, 0.0), max(right, 0.0)
    across, up = s.normal(0.0, 0.3 if s.chance(0.7) else 0.6)[0], s.normal(0.0, 0.2)[0]
    across, up = float(np.clip(across, -1, 1)), float(np.clip(up, -0.8, 0.8))
    cross = s.normal(0.0, 0.03)[0]
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        outward = sign * across + cross
        units["eyeLookOut" + side], units["eyeLookIn" + side] = max(outward, 0.0), max(-outward, 0.0)
        units["eyeLookUp" + side], units["eyeLookDown" + side] = max(up, 0.0), max(-up, 0.0)
    return state


def _possible(units: dict[str, float]) -> None:
    """Bounds that a face keeps: lids do not close twice, lips close an open jaw only, opposites do not add up."""
    for side in ("Left", "Right"):
        blink = min(units["eyeBlink" + side], 1.0)
        room = 1.0 - blink
        units["eyeSquint" + side] = min(units["eyeSquint" + side], 0.8 * room)
        units["eyeWide" + side] *= room if blink < 0.3 else 0.0
        units["eyeLookDown" + side] = min(units["eyeLookDown" + side], max(0.0, 1.0 - blink))
        units["eyeLookUp" + side] *= room
    units["tongueOut"] = units["tongueOut"] if units["jawOpen"] > 0.25 else 0.0
    for one, other in (("jawLeft", "jawRight"), ("mouthLeft", "mouthRight")):
        units[one if units[one] < units[other] else other] = 0.0
    mouth = [n for n in units if n.startswith(("mouth", "jaw")) and n != "mouthClose"]
    total = sum(min(units[n], 1.0) for n in mouth)
    if total > MOST_MOUTH:
        for name in mouth:
            units[name] *= MOST_MOUTH / total
    units["mouthClose"] = min(units["mouthClose"], units["jawOpen"])
