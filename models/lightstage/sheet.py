"""Many subjects at a glance: the whole face of each, and pieces at the full scale."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import torch

from models.colour import srgb
from models.lightstage.poses import EXPRESSIONS
from models.lightstage.skin.synthesis import Skin, SkinMaps
from models.lightstage.skin.window import ChartWindow
from models.lightstage.stage import Stage

Bytes = npt.NDArray[np.uint8]

_FACE = (0.24, 0.06, 0.52, 0.86)
"""Part of the chart that holds the face: left, top, width, height."""
_LIGHT = (0.5, 0.45, 0.74)


def image(values: torch.Tensor) -> Bytes:
    """(3, h, w) in [0, 1] -> (h, w, 3) uint8."""
    return np.asarray((values.clamp(0.0, 1.0) * 255.0).round().byte().permute(1, 2, 0).cpu().numpy())


def lit(maps: SkinMaps, light: tuple[float, float, float] = _LIGHT) -> torch.Tensor:
    """(3, h, w) sRGB of a flat piece under one far light, seen from above: to judge relief, not to train on."""
    direction = torch.tensor(light, device=maps.mask.device)
    direction = direction / direction.norm()
    half = direction + torch.tensor([0.0, 0.0, 1.0], device=maps.mask.device)
    half = half / half.norm()
    diffuse = (maps.diffuse_normal * direction.view(3, 1, 1)).sum(0).clamp(min=0.0)
    cosine = (maps.specular_normal * half.view(3, 1, 1)).sum(0).clamp(0.0, 1.0)
    narrow, broad, mix = maps.roughness
    lobe = mix * _ggx(cosine, narrow) + (1.0 - mix) * _ggx(cosine, broad)
    return srgb(1.3 * (maps.diffuse_albedo * diffuse + 0.04 * maps.specular_albedo * lobe))


def _ggx(cosine: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    squared = alpha * alpha
    return squared / (np.pi * (cosine * cosine * (squared - 1.0) + 1.0) ** 2)


def face(skin: Skin, width: int) -> Bytes:
    """The albedo of the face at a small size, outside of the island in grey."""
    chart = round(width / _FACE[2] / 3) * 3
    height = chart * 2 // 3
    window = ChartWindow(int(_FACE[0] * chart), int(_FACE[1] * height), width, int(_FACE[3] * height), chart, height)
    maps = skin.maps(window)
    return image(torch.where(maps.mask > 0.5, srgb(maps.diffuse_albedo), 0.25))


def row(stage: Stage, seed: int, size: int) -> Bytes:
    """One subject: its face, and five pieces at 1:1 (albedo above, lit below)."""
    skin = stage.skin(seed, EXPRESSIONS[seed % len(EXPRESSIONS)])
    columns = [cv2.resize(face(skin, 2 * size), (2 * size, 2 * size), interpolation=cv2.INTER_AREA)]
    places = stage.places()
    for name in ("cheek", "nose", "mouth", "brow", "forehead"):
        maps = skin.maps(stage.window(*places[name], size))
        columns.append(np.vstack([image(srgb(maps.diffuse_albedo)), image(lit(maps))]))
    label = f"{seed}: ITA {skin.subject.tone.typology_angle_deg:.0f}, {skin.subject.age_years:.0f} y"
    cv2.putText(columns[0], label, (6, 2 * size - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
    return np.hstack(columns)


def sheet(stage: Stage, seeds: range, size: int = 256) -> Bytes:
    """All subjects of a range, one row each."""
    return np.vstack([row(stage, seed, size) for seed in seeds])
