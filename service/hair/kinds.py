"""Kinds of hair that a photo is asked for, and which of them a groom is.

Length is told by how far hair reaches that grows at the front and the sides, as it hangs: the hairdresser's ear, jaw
and shoulder. What a style's numbers say beside that (fade, lift, volume) is the groom's own (``service.hair.style``).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from service.arrays import Float32
from service.hair.scalp import CENTRE
from service.hair.style import Style

LENGTHS = ("cropped", "short", "ear", "jaw", "shoulder", "longer")
"""Up to 12 mm long; ends above the ears' middle; at their lobes; at the jaw; at the shoulders; below."""
GATHERED = ("none", "half", "tied", "plaits")
"""Loose; its upper or front part pinned back; a ponytail or bun; one plait or two."""
PARTINGS = ("none", "left", "middle", "right")
"""On the subject's own side."""
FRINGES = ("no", "yes")
"""Whether hair lies over the forehead."""
CURLS = ("straight", "wavy", "curly", "coily")
"""Andre Walker's types 1 to 4."""
KINDS: Mapping[str, tuple[str, ...]] = {
    "length": LENGTHS, "gathered": GATHERED, "parting": PARTINGS, "fringe": FRINGES, "curl": CURLS,
}  # fmt: skip
CROPPED_MM = 12.0
LENGTH_ENDS_M = (-0.042, -0.07, -0.125, -0.215)
"""Height in the head's frame to which short, ear, jaw and shoulder length reach; the origin lies between the eyes."""
SIDES_RAD = 2.2
"""Azimuth up to which hair grows at the front and the sides; what grows on the nape is low however short it is."""
LOWEST = 0.05
"""Share of the strands that may reach lower than what is called their ends."""
FOREHEAD_M = (0.045, 0.02, 0.055)
"""The forehead: half its width, and its lower and upper height in the head's frame."""
FRINGED, FRINGE_CELL_M = 0.4, 0.008
"""Share of the forehead's cells that strands have to lie on to be a fringe, and the side of a cell."""
_GATHERED = {"ponytail": "tied", "bun": "tied", "plait": "plaits", "two_plaits": "plaits", "half_up": "half",
             "pinned": "half"}  # fmt: skip


def ends_m(strands: Float32) -> float:
    """Height of the lowest ends of strands (N, P, 3) in the head's frame, metres; NaN where there are none."""
    away = strands[:, 0] - CENTRE
    front = np.abs(np.arctan2(away[:, 0], away[:, 2])) < SIDES_RAD
    lowest = strands[..., 1].min(1)[front]
    return float(np.quantile(lowest, LOWEST)) if len(lowest) else float("nan")


def length_of(ends: float) -> str:
    """What hair is called that is not cropped and whose lowest ends lie at a height, metres."""
    return LENGTHS[1 + int(np.searchsorted(-np.array(LENGTH_ENDS_M), -ends))]


def kinds_of(style: Style, strands: Float32) -> dict[str, str]:
    """The choice of each of :data:`KINDS` that a groom is: strands (N, P, 3) on the mean head; none: cropped."""
    gathered = _GATHERED.get(style.gather, "none")
    longest = max(style.top_mm, style.sides_mm if style.fade < 0.5 else 0.0)
    cropped = not len(strands) or longest <= CROPPED_MM
    parted = style.top_mm > 30 and (gathered != "none" or style.combing not in ("back", "up"))
    return {
        "length": "cropped" if cropped else length_of(ends_m(strands)),
        "gathered": gathered,
        "parting": style.parting if parted else "none",
        "fringe": "yes" if len(strands) and _fringed(strands) else "no",
        "curl": CURLS[int(style.curl[0]) - 1],
    }


def _fringed(strands: Float32) -> bool:
    half, low, high = FOREHEAD_M
    x, y, z = np.moveaxis(strands.reshape(-1, 3), -1, 0)
    over = (np.abs(x) < half) & (y > low) & (y < high) & (z > -0.01)
    cells = np.floor(np.stack([x[over] + half, y[over] - low]) / FRINGE_CELL_M).astype(int)
    whole = np.ceil(2 * half / FRINGE_CELL_M) * np.ceil((high - low) / FRINGE_CELL_M)
    return len(np.unique(cells, axis=1).T) > FRINGED * float(whole)
