"""Where teeth lie in the chart, and their albedo: in the photo's colours where it shows them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.anatomy.mouth.paint import part_points, shade
from service.anatomy.teeth.colours import GUMS, WHITEST
from service.colour import linear_to_srgb, luma, srgb_to_linear
from service.geometry.chart import Chart
from service.ledger import Correction

Float = npt.NDArray[np.float32]
Points = npt.NDArray[np.floating]

HALF_DEPTH_M = 0.028
"""Depth behind the front tooth at which a tooth is half as bright, on sRGB values."""
CROWN_M = (0.0095, 0.0115)
"""Height of a tooth's crown: up to the first all tooth, from the second on all gum."""
NEIGHBOUR_M = 0.005
"""Vertices within this horizontal distance belong to the same tooth."""
LEAST_BRIGHT = (0.60, 0.80)
"""Luma over the measured tooth's below which the photo shows a gap or a shadow, and from which on it shows teeth."""


def crown_share(points: Points, vertices: Points, *, upper: bool) -> Float:
    """(N,) 1 on the crown of a tooth, 0 on the gum; arguments as of :func:`biting_height`."""
    low, high = CROWN_M
    height = biting_height(points, vertices, upper=upper)
    return np.asarray(np.clip((high - height) / (high - low), 0.0, 1.0), np.float32)


def biting_height(points: Points, vertices: Points, *, upper: bool) -> npt.NDArray[np.float64]:
    """(N,) metres from the biting edge towards the gum.

    Args:
        points: (N, 3) metres on a row of teeth.
        vertices: (M, 3) metres of that row; its biting edge is their lowest (upper row) or highest height near a point.
        upper: which row.
    """
    sign = 1.0 if upper else -1.0
    apart = np.linalg.norm(points[:, None, [0, 2]] - vertices[None, :, [0, 2]], axis=2)
    near = apart <= np.maximum(NEIGHBOUR_M, apart.min(1, keepdims=True) + 1e-6)
    edge = np.where(near, sign * vertices[None, :, 1], np.inf).min(1)
    return np.asarray(sign * points[:, 1] - edge)


class Teeth:
    """Where both rows of teeth lie in the chart.

    Attributes:
        own: (n,) positions of their texels among the inner ones.
        depth: (n,) float32 metres behind the foremost tooth of the same row, in the neutral mean head.
        crown: (n,) float32 share of tooth rather than gum.
    """

    def __init__(self, chart: Chart) -> None:
        """For any head; n is 0 where it has no teeth."""
        own, depth, crown = [], [], []
        for index, name in enumerate(chart.head.part_names):
            texels = np.flatnonzero(chart.inner_part == index)
            if not name.startswith("teeth") or not len(texels):
                continue
            points, vertices = part_points(chart, index, texels)
            own.append(texels)
            depth.append((vertices[:, 2].max() - points[:, 2]).astype(np.float32))
            crown.append(crown_share(points, vertices, upper=not name.endswith("lower")))
        none = np.zeros(0, np.float32)
        self.own: npt.NDArray[np.int64] = np.concatenate(own) if own else np.zeros(0, np.int64)
        self.depth: Float = np.concatenate(depth) if depth else none
        self.crown: Float = np.concatenate(crown) if crown else none

    def paint(self, tooth: Float) -> Float:
        """(n, 3) sRGB-coded albedo with teeth of a given colour (3,) at the front, darker the further in."""
        gums = linear_to_srgb(GUMS)
        flat = gums + self.crown[:, None] * (tooth - gums)
        return np.asarray(flat * shade(self.depth, HALF_DEPTH_M), np.float32)

    def shows(self, colour: Float, tooth: Float) -> Float:
        """(n,) in [0, 1]: how far the photo's colours (n, 3) are tooth rather than gap, shadow or gum line."""
        bright = luma(colour) / max(float(luma(tooth)), 1e-3)
        low, high = LEAST_BRIGHT
        return np.asarray(np.clip((bright - low) / (high - low), 0.0, 1.0), np.float32)


def no_bluer(albedo: Float) -> Float:
    """(n, 3) sRGB-coded albedo of teeth without what would make them greener or bluer than ``WHITEST``.

    The eyes, which tell the light, lie deeper than the front teeth and see more of the skin's own colour; and the
    brightest teeth are overexposed. Both would make teeth cyan.
    """
    linear = srgb_to_linear(albedo)
    linear[:, 1:] = np.minimum(linear[:, 1:], linear[:, :1] * np.array(WHITEST, np.float32))
    return linear_to_srgb(linear)


TOOTH_HUE = Correction(
    name="tooth-hue",
    mends="By the light of the eyes, overexposed teeth come out cyan.",
    source="texture",
)
