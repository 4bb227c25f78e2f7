"""Pores: where they are, how large, and the pits that they make."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from models.lightstage.skin.anatomy import Anatomy
from models.lightstage.skin.sites import scatter
from models.lightstage.skin.splat import Marks, accumulator, add, finished, peak, raise_to, stamps
from models.lightstage.skin.streams import Stream
from models.lightstage.skin.subject import Subject
from models.lightstage.skin.window import ChartWindow

_RIM = 0.08


def list_pores(subject: Subject, anatomy: Anatomy) -> Marks:
    """All pores of a subject; values: radii a, b (mm), cos and sin of the long axis, depth (mm), two shape phases."""
    surface = subject.surface
    stream = Stream(subject.seed, "pores")
    a = anatomy
    density = 38.0 * a["seen"]
    density = (
        density + 62.0 * a["nose"] + 45.0 * a["cheek"] + 22.0 * a["alae"] + 20.0 * a["chin"] + 12.0 * a["forehead"]
    )
    density = density * (1.0 - a["lips"]) * (1.0 - 0.9 * np.maximum(a["eyelid_upper"], a["eyelid_lower"]))
    density = density * (1.0 - 0.6 * a["neck"]) * (1.0 - 0.8 * a["scalp"]) * surface.pore_density
    uv = scatter(a.atlas, stream, density.astype(np.float32), spacing=0.45)
    n = len(uv)
    maps = np.stack([a["nose"], a["nose_tip"], a["cheek"], a["alae"], a["neck"], a["forehead"], a["under_eye"]])
    nose, tip, cheek, ala, neck, forehead, below = a.atlas.sample(maps, uv).T
    size = (1.0 + 0.3 * nose + 0.15 * tip + 0.22 * cheek + 0.2 * ala) * (1.0 - 0.3 * neck) * (1.0 - 0.1 * forehead)
    size = size * (1.0 - 0.3 * below)
    diameter = np.clip(surface.pore_diameter * size * stream.log_normal(1.0, surface.pore_spread, n), 0.08, 0.6)
    depth = np.minimum(0.12, 0.3 * diameter * stream.uniform(0.5, 1.3, n)) * surface.pore_depth
    depth *= np.where(stream.uniform(size=n) < 0.3, 0.35, 1.0)  # many are filled to the brim
    long = 1.0 + (surface.pore_elongation - 1.0) * stream.uniform(0.3, 1.6, n) + stream.uniform(0.0, 0.35, n)
    # Skin sags down and outwards.
    side = np.sign(a.atlas.sample(a.atlas.position[:1], uv)[:, 0])
    angle = -np.pi / 2 + side * 0.45 + stream.normal(0.0, 0.5, n)
    radius = 0.5 * diameter
    values = np.stack(
        [
            radius * np.sqrt(long),
            radius / np.sqrt(long),
            np.cos(angle),
            np.sin(angle),
            depth,
            stream.uniform(-1.0, 1.0, n),
            stream.uniform(-1.0, 1.0, n),
        ],
        1,
    )
    return Marks(uv, a.atlas.frames(uv), 2.3 * values[:, 0] + 0.03, values)


@dataclass(frozen=True)
class PorePits:
    """(h, w) each: height in mm (negative in the pits), and how much of a texel is pore, in [0, 1]."""

    height: Tensor
    cover: Tensor


def draw_pores(marks: Marks, window: ChartWindow, device: torch.device | str = "cpu") -> PorePits:
    """Pits with a slight rim; where texels are larger than pores they become shallower and keep their volume."""
    height, cover = accumulator(window, device), peak(window, device)
    for s in stamps(marks, window, device):
        ra, rb, cos, sin, depth, lobe, skew = s.values
        blur = (0.45 * s.size_mm) ** 2
        wide_a, wide_b = (ra * ra + blur).sqrt(), (rb * rb + blur).sqrt()
        along = (s.a * cos + s.b * sin) / wide_a
        across = (-s.a * sin + s.b * cos) / wide_b
        r2 = along * along + across * across
        # A cubic and a linear term make the outline uneven and one wall steeper than the other.
        r2 = r2 * (1.0 + 0.22 * lobe * (along * (along * along - 3.0 * across * across)) / (0.3 + r2 * r2.sqrt()))
        r2 = r2 * (1.0 + 0.25 * skew * along / (1.0 + r2))
        share = ra * rb / (wide_a * wide_b)
        pit = torch.exp(-r2 * (0.7 + 0.3 * r2))
        rim = _RIM * r2 * torch.exp(1.0 - r2)
        add(height, s.texel, -depth * share * (pit - rim))
        raise_to(cover, s.texel, share * torch.exp(-r2))
    return PorePits(finished(height, window), finished(cover, window))
