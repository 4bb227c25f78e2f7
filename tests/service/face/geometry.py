"""Measures shared by the tests of this folder."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]


def inter_ocular(landmarks: Float) -> float:
    return float(np.linalg.norm(landmarks[[33, 133], :2].mean(0) - landmarks[[263, 362], :2].mean(0)))


def rms(one: Float, other: Float) -> float:
    """Root mean square distance in the picture over the inter-ocular distance of the second."""
    gaps = np.linalg.norm(one[:, :2] - other[:, :2], axis=1)
    return float(np.sqrt((gaps**2).mean())) / inter_ocular(other)
