"""Pictures of ours beside those of a reference renderer: how far apart they are, as a table and as a picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Difference:
    """Two pictures (size, size, 3), sRGB coded, in [0, 1], and what counts of them.

    Attributes:
        mean: mean absolute difference over the pixels that count, in 1/255.
        high: its 95th percentile.
        pixels: how many count.
        ours: one picture.
        theirs: the other.
        mask: (size, size) where they count.
    """

    mean: float
    high: float
    pixels: int
    ours: Float
    theirs: Float
    mask: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, ours: Float, theirs: Float, mask: npt.NDArray[np.bool_]) -> Difference:
        """Compare.

        Raises:
            ValueError: no pixel counts.
        """
        if not mask.any():
            raise ValueError("no pixel of the two pictures can be compared: the mask is empty")
        off = np.abs(ours - theirs)[mask].mean(-1) * 255.0
        return cls(float(off.mean()), float(np.percentile(off, 95)), int(mask.sum()), ours, theirs, mask)


def table(results: Mapping[str, Difference], what: str) -> str:
    """Markdown; ``what`` is that of which there is a row each."""
    lines = [f"| {what} | mean difference (sRGB/255) | 95th percentile | pixels |", "|---" * 4 + "|"]
    lines += [f"| {name} | {one.mean:.2f} | {one.high:.2f} | {one.pixels} |" for name, one in results.items()]
    return "\n".join(lines)


def draw(results: Mapping[str, Difference], path: Path) -> None:
    """Write a row for each: ours, theirs, and eight times the difference where it counts."""
    import cv2

    rows = [
        np.concatenate([one.ours, one.theirs, 8 * np.abs(one.ours - one.theirs) * one.mask[..., None]], 1)
        for one in results.values()
    ]
    picture = np.rint(np.clip(np.concatenate(rows), 0, 1) * 255).astype(np.uint8)
    cv2.imwrite(str(path), picture[..., ::-1])
