"""Sample points of a skin under light, for the planner."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from models.lightstage.light.bake import LitMaps
from models.lightstage.light.geometry import Geometry
from models.lightstage.light.relief import STEPS_MM
from models.lightstage.light.sampling import displaced, enlarged
from models.lightstage.skin.streams import Stream
from models.lightstage.skin.window import ChartWindow
from service.scene.surface import AZIMUTHS, RING_MM, Surface

Array = npt.NDArray[np.float64]


def survey(skin: LitMaps, geometry: Geometry, window: ChartWindow, count: int = 384, seed: int = 0) -> Surface:
    """Samples of the face in a window (of all of its skin where it shows none of the face), evenly over its texels.

    Args:
        skin: maps of the window, at the resolution that is to be baked: fine relief casts no shadow on coarse maps.
        geometry: the head.
        window: what the maps show.
        count: number of samples.
        seed: which texels.
    """
    site = geometry.site(window)
    weight = enlarged(geometry.face, window)[0].clamp(0.0, 1.0) * (skin.mask[0] > 0.5)
    for fallback in (skin.mask[0].float(), torch.ones_like(weight)):
        if float(weight.sum()) < 1e-3:
            weight = fallback
    total = weight.flatten().double().cumsum(0)
    spots = (np.arange(count) + Stream(seed, "survey").uniform(size=count)) / count * float(total[-1])
    index = torch.searchsorted(total, torch.from_numpy(spots).to(total)).clamp(max=weight.numel() - 1)
    row, column = index // window.width, index % window.width

    def pick(image: Tensor, at: Tensor = index) -> Array:
        """(K, C) of (C, h, w)."""
        return np.asarray(image.reshape(image.shape[0], -1)[:, at].T.double().cpu().numpy())

    diffuse = site.to_head(skin.diffuse_normal)
    places = [_beside(site.step, row, column, k, window) for k in range(len(RING_MM))]
    seen = enlarged(geometry.visible.float() / 255.0, window) if window.width * window.height <= 65536 else None
    visible = pick(seen) if seen is not None else _visible(geometry, window, row, column)
    rough = pick(skin.roughness.float())
    return Surface(
        position=np.stack([pick(site.position, at) for at in places]) / 1000.0,
        diffuse_normal=np.stack([pick(diffuse, at) for at in places]),
        albedo=np.stack([pick(skin.diffuse_albedo.float(), at) for at in places]).clip(0.0, 1.0),
        normal=pick(site.normal),
        tangent=pick(site.tangent),
        bitangent=pick(site.bitangent),
        specular_normal=pick(site.to_head(skin.specular_normal)),
        specular=pick(skin.specular_albedo.float())[:, 0],
        alpha=rough[:, :2].clip(0.03, 1.0),
        share=rough[:, 2],
        visible=visible,
        horizon=_horizons(skin.height_mm[0].float(), site.step, pick),
        weight=np.full(count, 1.0 / count),
    )


def _beside(step: Tensor, row: Tensor, column: Tensor, place: int, window: ChartWindow) -> Tensor:
    """Flat index of the texel at a place of the rings."""
    angle = (place % 4) * 0.5 * math.pi + (0.25 * math.pi if place > 4 else 0.0)
    x, y = RING_MM[place] * math.cos(angle), RING_MM[place] * math.sin(angle)
    right = (step[0, 0] * x + step[0, 1] * y)[row, column].round().long()
    up = (step[1, 0] * x + step[1, 1] * y)[row, column].round().long()
    return (row - up).clamp(0, window.height - 1) * window.width + (column + right).clamp(0, window.width - 1)


def _visible(geometry: Geometry, window: ChartWindow, row: Tensor, column: Tensor) -> Array:
    """(K, D) visibility at texels, from the nearest texel of its own map."""
    _, height, width = geometry.visible.shape
    r = ((row + window.y + 0.5) / window.chart_height * height).long().clamp(0, height - 1)
    c = ((column + window.x + 0.5) / window.chart_width * width).long().clamp(0, width - 1)
    return np.asarray(geometry.visible[:, r, c].T.double().cpu().numpy()) / 255.0


def _horizons(height: Tensor, step: Tensor, pick: Callable[[Tensor], Array]) -> Array:
    slopes = []
    for k in range(AZIMUTHS):
        x, y = math.cos(2.0 * math.pi * k / AZIMUTHS), math.sin(2.0 * math.pi * k / AZIMUTHS)
        right, up = step[0, 0] * x + step[0, 1] * y, step[1, 0] * x + step[1, 1] * y
        horizon = torch.zeros_like(height)
        for mm in STEPS_MM:
            beside = displaced(height, (right * mm).clamp(-64, 64), (up * mm).clamp(-64, 64))
            horizon = torch.maximum(horizon, (beside - height) / mm)
        slopes.append(horizon)
    return pick(torch.stack(slopes))
