"""The tint of the light on the lids, between what the network found and what the whites of the eyes show.

The network goes by the hue of skin too, and takes skin that is pinker or yellower than any it has learnt from for
light of that tint. The whites are nearly grey in everybody, and their tint errs by a few percent only; how strong the
light is they tell less well (shade of the lids), so that stays as the network found it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]

LIDS = "lids"
"""Channel that weights the skin of the lids."""

SHARE = 0.5
"""How far the tint goes from the network's to that of the whites. On held-out subjects, whose hues it has learnt,
the albedo is as good with any share to a half."""

LARGEST = 0.3
"""Bound of the change of a channel, in logarithms."""


def tint_of_whites(light: Float, eyes: npt.NDArray[np.floating], lids: Float) -> Float:
    """(3, h, w) log light with the tint that the whites tell half of; of the same strength.

    Args:
        light: (3, h, w) log light that the network found.
        eyes: (4,) log light that the whites show, and 1 where they are seen, else 0: the light stays as it is then.
        lids: (h, w) weights >= 0 of the lids; where all are 0 the light stays as it is.
    """
    total = float(lids.sum())
    if eyes[3] < 0.5 or total < 1e-3:
        return light
    found = np.einsum("chw,hw->c", light, lids) / total
    seen = np.asarray(eyes[:3], np.float64)
    change = SHARE * ((seen - seen.mean()) - (found - found.mean()))
    change = np.clip(change, -LARGEST, LARGEST)
    return np.asarray(light + (change - change.mean())[:, None, None], np.float32)
