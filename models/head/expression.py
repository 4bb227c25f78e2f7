"""The 52 ARKit units as offsets of the head, exactly symmetric between left and right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import scipy.sparse as sparse

from models.head.source import UNIT_M, face_unit_path, read_target

_SIDED = (
    "browDown", "browOuterUp", "cheekSquint", "eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp",
    "eyeSquint", "eyeWide", "mouthDimple", "mouthFrown", "mouthLowerDown", "mouthPress", "mouthSmile", "mouthStretch",
    "mouthUpperUp", "noseSneer",
)  # fmt: skip
_PAIRED = (("jawLeft", "jawRight"), ("mouthLeft", "mouthRight"))
_SINGLE = (
    "browInnerUp", "cheekPuff", "jawForward", "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthRollLower",
    "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper", "tongueOut",
)  # fmt: skip

PARTNERS: dict[str, str] = {
    **{f"{stem}{a}": f"{stem}{b}" for stem in _SIDED for a, b in (("Left", "Right"), ("Right", "Left"))},
    **{x: y for a, b in _PAIRED for x, y in ((a, b), (b, a))},
    **{name: name for name in _SINGLE},
}
"""Each ARKit unit and its mirror image (itself for a symmetric one)."""
ARKIT = tuple(sorted(PARTNERS))


def read_units(data: Path, operator: sparse.csr_matrix, mirror: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """(52, V, 3) float64 offsets in metres at full activation, in the order of ARKIT.

    The units of the pack move eyeballs, lower teeth, tongue and lashes as well. Where left and right differ slightly,
    both become the mean of the one and the mirror image of the other.
    """
    raw = {
        name: UNIT_M * (operator @ read_target(face_unit_path(data, name), operator.shape[1]).astype(float))
        for name in ARKIT
    }
    flip = np.array([-1.0, 1.0, 1.0])
    return np.stack([0.5 * (raw[name] + raw[PARTNERS[name]][mirror] * flip) for name in ARKIT])
