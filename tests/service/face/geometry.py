"""Measures shared by the tests of this folder."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.geometry.camera import Camera
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]


def inter_ocular(landmarks: Float) -> float:
    return float(np.linalg.norm(landmarks[[33, 133], :2].mean(0) - landmarks[[263, 362], :2].mean(0)))


def rms(one: Float, other: Float) -> float:
    """Root mean square distance in the picture over the inter-ocular distance of the second."""
    gaps = np.linalg.norm(one[:, :2] - other[:, :2], axis=1)
    return float(np.sqrt((gaps**2).mean())) / inter_ocular(other)


def oval(angle: float, centre: tuple[float, float] = (300.0, 200.0)) -> np.ndarray:
    """468 points in an oval of 100 x 140 pixels that is turned by ``angle``, eyes and mouth where they belong."""
    t = np.linspace(0, 2 * np.pi, 468, endpoint=False)
    points = np.stack([50 * np.cos(t), 70 * np.sin(t)], 1)
    for pair, place in (((33, 133), (-20, -20)), ((362, 263), (20, -20)), ((13, 14), (0, 35))):
        points[list(pair)] = place
    cos, sin = np.cos(angle), np.sin(angle)
    turned = points @ np.array([[cos, sin], [-sin, cos]]) + centre
    return np.concatenate([turned, np.zeros((468, 1))], 1)


FOCAL = 2400.0
VIEW = Camera(1000, 1000, FOCAL, np.array([500.0, 500.0]), np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
"""A camera a metre before the eyes."""


def units(head: HeadModel, **values: float) -> Float:
    """(E,) activations by the names of units; those of both sides by the name without the side."""
    out = np.zeros(len(head.expression))
    for name, value in values.items():
        for unit in {name, f"{name}Left", f"{name}Right"} & set(head.expression_names):
            out[head.expression_names.index(unit)] = value
    return out
