"""Automatic exposure, metered on the face."""

from __future__ import annotations

import math

from service.light.scene import Response, Scene

BRIGHT = 0.9
"""Quantile of the face's luminance that the exposure brings to the response's target."""


def level_of(response: Response) -> float:
    """Linear value that the response's tone curve maps to its target."""
    coded = response.target ** (1.0 / response.gamma)
    linear = coded / 12.92 if coded <= 0.04045 else ((coded + 0.055) / 1.055) ** 2.4
    knee = 1.0 - response.shoulder
    if response.shoulder > 0.0 and linear > knee:
        return float(knee - response.shoulder * math.log(max(1.0 - (linear - knee) / response.shoulder, 1e-6)))
    return float(linear)


def exposed_for(scene: Scene, bright: float) -> Scene:
    """The scene with the exposure that maps a linear luminance to the response's target; 1 in complete darkness."""
    return scene.exposed(min(level_of(scene.response) / bright, 1e9) if bright > 1e-9 else 1.0)
