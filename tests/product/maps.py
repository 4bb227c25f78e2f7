"""What a map of an archive is like, in a few numbers."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

MIDDLE = 768
"""Half the side of the part whose octaves are looked at, in texels."""


@dataclass(frozen=True)
class Looks:
    """Numbers of one map; codes count from 0 to 255 whatever the bits.

    Attributes:
        mean: of all channels.
        low, high: what 2 % of the codes lie below and above.
        octaves: of the middle, where the face is: standard deviation of what halving the map loses, then of what
            halving that loses, and so on.
    """

    mean: float
    low: float
    high: float
    octaves: tuple[float, ...]

    @classmethod
    def of(cls, png: bytes, count: int = 4) -> Looks:
        """Numbers of a PNG with 8 or 16 bits."""
        codes = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
        assert codes is not None, "no PNG"
        values = codes.astype(np.float32) * (255 / (255 if codes.dtype == np.uint8 else 65535))
        low, high = np.percentile(values[::4, ::4], [2, 98])
        top, left = (max(side // 2 - MIDDLE, 0) for side in values.shape[:2])
        octaves: list[float] = []
        level: Any = values[top : top + 2 * MIDDLE, left : left + 2 * MIDDLE]
        for _ in range(count):
            half = cv2.resize(level, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            lost = level - cv2.resize(half, level.shape[1::-1], interpolation=cv2.INTER_LINEAR)
            octaves.append(round(float(lost.std()), 3))
            level = half
        return cls(round(float(values.mean()), 1), round(float(low), 1), round(float(high), 1), tuple(octaves))

    def unlike(self, known: Looks) -> list[str]:
        """In what this map differs from a known one by more than a change of the program that nobody would see."""
        found = [
            f"{name} is {mine}, not {theirs}"
            for name, mine, theirs in (
                ("mean", self.mean, known.mean), ("low", self.low, known.low), ("high", self.high, known.high)
            )
            if abs(mine - theirs) > 6
        ]  # fmt: skip
        for octave, (mine, theirs) in enumerate(zip(self.octaves, known.octaves, strict=True)):
            if not 0.7 * theirs - 0.02 <= mine <= 1.4 * theirs + 0.02:
                found.append(f"octave {octave} has {mine}, not {theirs}")
        return found


def looks_of(archive: Path) -> dict[str, Looks]:
    """Numbers of every map of an archive by role."""
    with zipfile.ZipFile(archive) as opened:
        manifest: dict[str, Any] = json.loads(opened.read("manifest.json"))
        return {entry["role"]: Looks.of(opened.read(entry["path"])) for entry in manifest["maps"]}
