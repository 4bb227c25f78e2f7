"""From light to a coded picture."""

from __future__ import annotations

import torch
from torch import Tensor

from models.colour import srgb
from service.errors import UsageError
from service.light.scene import Response


def developed(light: Tensor, response: Response) -> Tensor:
    """(3, ...) coded sRGB in [0, 1] of linear light (3, ...) >= 0: exposure, white balance, soft clip, coding, gamma.

    Raises:
        UsageError: the exposure is still to be chosen (``models.lightstage.light.expose``).
    """
    if response.exposure is None:
        raise UsageError("scene: exposure is null; choose one with models.lightstage.light.expose or give a number")
    balance = torch.tensor(response.white_balance, device=light.device, dtype=torch.float32)
    factor = (balance * response.exposure).view(3, *[1] * (light.ndim - 1)).to(light.dtype)
    x = (light * factor).clamp(min=0.0)
    if response.shoulder > 0.0:
        knee = 1.0 - response.shoulder
        bent = knee + response.shoulder * (1.0 - torch.exp(-(x - knee).clamp(min=0.0) / response.shoulder))
        x = torch.where(x > knee, bent, x)
    coded = srgb(x)
    return coded if response.gamma == 1.0 else coded.clamp(min=0.0) ** response.gamma
