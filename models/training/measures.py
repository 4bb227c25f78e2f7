"""Measures of an albedo beside its PSNR: how far its colours look off, and how much of the light is left in it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from models.colour import linear
from models.networks.context import DARKEST
from models.training.reflectance import grey

Array = npt.NDArray[np.float64]


def colour_difference(found: Tensor, truth: Tensor, mask: Tensor) -> float:
    """Median CIEDE2000 of coded albedos (1, 3, h, w) in [0, 1] where a mask (1, 1, h, w) is above 1/2; NaN: nowhere.

    1 is just seen side by side, 5 at a glance.
    """
    from skimage.color import deltaE_ciede2000, rgb2lab

    inside = mask[0, 0] > 0.5
    if not bool(inside.any()):
        return float("nan")
    labs = [rgb2lab(image[0].clamp(0.0, 1.0)[:, inside].T.double().numpy()) for image in (found, truth)]
    return float(np.median(deltaE_ciede2000(*labs)))


def light_left(found: Tensor, truth: Tensor, texture: Tensor, mask: Tensor) -> float:
    """|correlation| of log(found / true albedo) with the log of the light, by luminance; 0 where either is constant.

    A de-lighting that is right, or wrong by one factor, has 0; the texture itself has 1.

    Args:
        found: (1, 3, h, w) coded albedo.
        truth: the true one.
        texture: the true one in its light.
        mask: (1, 1, h, w), where to look.
    """
    inside = mask[0, 0] > 0.5
    logs = [
        torch.log(grey(linear(i.clamp(0.0, 1.0))).clamp(min=DARKEST))[0, 0][inside] for i in (found, truth, texture)
    ]
    return abs(correlation((logs[0] - logs[1]).double().numpy(), (logs[2] - logs[1]).double().numpy()))


def correlation(a: Array, b: Array) -> float:
    """Of values (n,); 0 where one of both does not vary."""
    if len(a) < 2:
        return 0.0
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / power if power > 1e-9 else 0.0
