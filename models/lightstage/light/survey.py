"""Sample points of a skin under light, for the planner."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from models.lightstage.light.geometry import Geometry
from models.lightstage.light.maps import LitMaps
from models.lightstage.light.relief import STEPS_MM
from models.lightstage.light.sampling import enlarged, read_at
from models.lightstage.skin.streams import Stream
from models.lightstage.skin.window import ChartWindow
from service.light.samples import AZIMUTHS, Index, LitChart, SurfaceSamples
from service.light.samples import survey as sampled

Array = npt.NDArray[np.float64]


def survey(skin: LitMaps, geometry: Geometry, window: ChartWindow, count: int = 384, seed: int = 0) -> SurfaceSamples:
    """Samples of the face in a window (of all of its skin where it shows none of the face), evenly over its texels.

    Args:
        skin: maps of the window, at the resolution that is to be baked: fine relief casts no shadow on coarse maps.
        geometry: the head.
        window: what the maps show.
        count: number of samples.
        seed: which texels.
    """
    site = geometry.site(window)

    def flat(image: Tensor) -> npt.NDArray[np.float32]:
        """(h, w, C) of (C, h, w)."""
        return np.asarray(image.permute(1, 2, 0).float().cpu().numpy())

    def there(at: Index) -> Tensor:
        return torch.from_numpy(at).to(geometry.device)

    rough, skinned = flat(skin.roughness), skin.mask[0] > 0.5
    chart = LitChart(
        position_m=flat(site.position) / 1000.0,
        normal=flat(site.normal),
        tangent=flat(site.tangent),
        bitangent=flat(site.bitangent),
        diffuse_normal=flat(site.to_head(skin.diffuse_normal)),
        specular_normal=flat(site.to_head(skin.specular_normal)),
        albedo=flat(skin.diffuse_albedo),
        specular=flat(skin.specular_albedo)[..., 0],
        alpha=rough[..., :2],
        share=rough[..., 2],
        texels_per_mm=flat(site.texels_per_mm[None])[..., 0],
        skin=skinned.cpu().numpy(),
    )
    return sampled(
        chart,
        flat(enlarged(geometry.face, window).clamp(0.0, 1.0) * skinned)[..., 0],
        Stream(seed, "survey").uniform(size=count),
        lambda at: _visible(geometry, window, there(at // window.width), there(at % window.width)),
        lambda at: _horizons(skin.height_mm[0].float(), site.step, there(at)),
    )


def survey_chart(
    draw: Callable[[ChartWindow], LitMaps], geometry: Geometry, width: int, height: int, windows: int = 8
) -> SurfaceSamples:
    """Samples for baking a whole chart of a size; large charts are looked at through small windows on the face.

    Fine relief and highlights are other ones on a small copy of the maps, so the maps have to be of the chart's size.

    Args:
        draw: gives the maps of a window (``Skin.maps``).
        geometry: the head.
        width: columns of the chart.
        height: rows of the chart.
        windows: how many to look through.
    """
    if width * height <= 384 * 256:
        whole = ChartWindow.whole(width, height)
        return survey(draw(whole), geometry, whole)
    face = geometry.face[0].double()
    total = (face if float(face.sum()) > 1e-3 else geometry.mask[0].double()).flatten().cumsum(0)
    spots = (np.arange(windows) + Stream(0, "survey windows").uniform(size=windows)) / windows * float(total[-1])
    index = torch.searchsorted(total, torch.from_numpy(spots).to(total)).clamp(max=total.numel() - 1).tolist()
    side = 96
    parts = []
    for k, at in enumerate(index):
        row, column = divmod(int(at), face.shape[1])
        x = min(max(int((column + 0.5) / face.shape[1] * width) - side // 2, 0), width - side)
        y = min(max(int((row + 0.5) / face.shape[0] * height) - side // 2, 0), height - side)
        window = ChartWindow(x, y, side, side, width, height)
        parts.append(survey(draw(window), geometry, window, 384 // windows, k))
    return joined(parts)


def joined(parts: list[SurfaceSamples]) -> SurfaceSamples:
    """Samples of several surveys that stand for equal shares of the face."""
    fields = {}
    for f in dataclasses.fields(SurfaceSamples):
        arrays = [getattr(part, f.name) for part in parts]
        by_place = f.name in ("position", "diffuse_normal", "albedo", "specular_normal", "horizon")
        fields[f.name] = np.concatenate(arrays, 1 if by_place else 0)
    return dataclasses.replace(SurfaceSamples(**fields), weight=fields["weight"] / len(parts))


def _visible(geometry: Geometry, window: ChartWindow, row: Tensor, column: Tensor) -> Array:
    """(K, D) visibility at texels, bilinear as ``enlarged`` has it."""
    _, height, width = geometry.visible.shape
    at = [window.rows(height).to(row.device)[row], window.columns(width).to(row.device)[column]]
    low = [x.floor() for x in at]
    share = [(x - x0).float() for x, x0 in zip(at, low, strict=True)]
    r0, c0 = (x.long() for x in low)

    def corner(dr: int, dc: int) -> Tensor:
        return geometry.visible[:, (r0 + dr).clamp(0, height - 1), (c0 + dc).clamp(0, width - 1)].float() / 255.0

    top = torch.lerp(corner(0, 0), corner(0, 1), share[1])
    low_row = torch.lerp(corner(1, 0), corner(1, 1), share[1])
    return np.asarray(torch.lerp(top, low_row, share[0]).T.double().cpu().numpy())


def _horizons(height: Tensor, step: Tensor, at: Tensor) -> Array:
    """(K, azimuths) horizon of the relief at flat indices, as ``relief_shadow`` finds it."""
    rows, columns = height.shape
    row, column = at // columns, at % columns
    (xx, xy), (yx, yy) = (step.reshape(2, 2, -1)[i, :, at] for i in (0, 1))
    angle = torch.arange(AZIMUTHS, device=height.device) * (2.0 * math.pi / AZIMUTHS)
    x, y = angle.cos()[:, None], angle.sin()[:, None]
    right, up = xx * x + xy * y, yx * x + yy * y
    here = height.reshape(-1)[at]
    horizon = torch.zeros_like(right)
    for mm in STEPS_MM:
        c = (column + (right * mm).clamp(-64, 64)).clamp(0, columns - 1)
        r = (row - (up * mm).clamp(-64, 64)).clamp(0, rows - 1)
        horizon = torch.maximum(horizon, (read_at(height, r, c) - here) / mm)
    return np.asarray(horizon.T.double().cpu().numpy())
