"""Brows, stubble and the short hair of the scalp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from models.lightstage.skin.anatomy import Anatomy
from models.lightstage.skin.curves import OWN_VALUES, coverage, distance, grown, segments
from models.lightstage.skin.sites import scatter
from models.lightstage.skin.splat import Marks, accumulator, add, finished, peak, raise_to, stamps
from models.lightstage.skin.streams import Stream
from models.lightstage.skin.subject import Subject
from models.lightstage.skin.window import ChartWindow

Float = npt.NDArray[np.float64]

_BROW_PIECES = 4
_HAIR_HEIGHT = 0.035


def _strands(anatomy: Anatomy, s: Stream, uv: Float, grey: float, width: Float) -> Marks:
    """Segments of strands (N, P + 1, 2) that taper; values: width, 1 for a grey hair, brightness, share of height."""
    n, pieces = len(uv), uv.shape[1] - 1
    taper = 1.0 - 0.75 * (np.arange(pieces) / max(pieces, 1)) ** 2
    white = (s.uniform(size=n) < grey).astype(np.float64)
    values = np.zeros((n, pieces, 4))
    values[..., 0] = width[:, None] * taper
    values[..., 1] = white[:, None]
    values[..., 2] = s.uniform(0.75, 1.0, n)[:, None]
    values[..., 3] = taper
    return segments(anatomy, uv, values, 3.0 * values[..., 0] + 0.1)


def list_brows(subject: Subject, anatomy: Anatomy) -> Marks:
    """Strands of both brows, growing up at the nose, outwards along the brow and down at its end."""
    h, a, s = subject.hair, anatomy, Stream(subject.seed, "brows")
    mask = a["brow"].astype(np.float64) * a["seen"]
    full = np.clip(mask / max(float(mask.max()), 1e-3), 0.0, 1.0) ** (2.8 / max(h.brow_spread, 0.3))
    area = float((full * a.atlas.area_mm2).sum()) / 100.0
    if area < 1e-3:
        return _strands(a, s, np.zeros((0, _BROW_PIECES + 1, 2)), 0.0, np.zeros(0))
    root = scatter(a.atlas, s, (full * (2 * h.brow_count / area)).astype(np.float32), spacing=0.3)
    n = len(root)
    x = a.atlas.sample(a.atlas.position[:1], root)[:, 0]
    level = np.argsort(np.argsort(root[:, 1])) / max(n, 1)
    inner, outer = a.points["brow_inner"][0], a.points["brow_outer"][0]
    t = np.clip((np.abs(x) - inner) / (outer - inner), -0.2, 1.1)
    # Hairs of the lower edge rise, hairs of the upper edge fall: they meet along the middle of the brow.
    angle = np.radians(np.interp(t, [-0.2, 0.05, 0.3, 0.7, 1.1], [88.0, 62.0, 24.0, 2.0, -16.0]))
    angle = angle + np.radians(16.0) * (0.5 - level) * 2.0 * np.clip(t * 2.0, 0.0, 1.0) + s.normal(0.0, 0.16, n)
    turn = -s.uniform(0.0, 0.6, n)
    angle = np.where(x > 0, angle, np.pi - angle)
    turn = np.where(x > 0, turn, -turn)
    length = h.brow_length * s.uniform(0.5, 1.15, n) * np.interp(t, [-0.2, 0.2, 1.0], [0.75, 1.0, 0.7])
    uv = grown(a, root, angle, turn, length, _BROW_PIECES)
    return _strands(a, s, uv, h.grey * 0.7, h.brow_width * s.uniform(0.75, 1.2, n))


def beard_cover(subject: Subject, anatomy: Anatomy) -> Float:
    """(H, W) relative density of the beard in [0, 1.2]."""
    a = anatomy
    lips = np.clip(a["lip_distance"] / 3.0, 0.0, 1.0)
    mask = np.clip(a["beard"] + subject.hair.moustache * a["moustache"], 0.0, 1.2) * lips * a["seen"]
    mask = mask * (1.0 - 0.92 * np.clip(1.7 * a["cheek"], 0.0, 1.0))
    return np.asarray(mask * (1.0 - a["nose"]) * (1.0 - a["nostril"]), np.float64)


def list_stubble(subject: Subject, anatomy: Anatomy) -> Marks:
    """Stubble strands and, shaved, the dots that are left."""
    h, a, s = subject.hair, anatomy, Stream(subject.seed, "stubble")
    cover = beard_cover(subject, anatomy) if h.beard_density > 0 else np.zeros_like(a["seen"], np.float64)
    root = scatter(a.atlas, s, (cover * h.beard_density).astype(np.float32), spacing=0.4)
    n = len(root)
    x, y = a.atlas.sample(a.atlas.position[:2], root).T
    side = np.sign(x)
    chin = a.points["chin"][1] if "chin" in a.points else 0.0
    angle = -np.pi / 2 + side * 0.35 * (y > chin) + s.normal(0.0, 0.28, n)
    length = 0.1 + h.beard_length * s.uniform(0.25, 1.0, n)
    uv = grown(a, root, angle, s.normal(0.0, 0.25, n), length, 2 if h.beard_length > 0.8 else 1)
    return _strands(a, s, uv, h.grey, s.uniform(0.045, 0.1, n))


@dataclass(frozen=True)
class HairMaps:
    """(h, w) each: cover by pigmented and by grey hair in [0, 1], relief (mm), soft shadow of roots in [0, inf)."""

    dark: Tensor
    grey: Tensor
    height: Tensor
    shadow: Tensor

    @property
    def cover(self) -> Tensor:
        """(h, w) share covered by any hair."""
        return torch.maximum(self.dark, self.grey)


def draw_strands(marks: Marks, window: ChartWindow, device: torch.device | str = "cpu") -> HairMaps:
    """Anti-aliased strands; the nearer of two crossing strands is not told apart."""
    dark, grey, height = (peak(window, device) for _ in range(3))
    shadow, thick_dark, thick_grey = (accumulator(window, device) for _ in range(3))
    for s in stamps(marks, window, device):
        _, away = distance(s)
        width, white, bright, share = s.values[OWN_VALUES:]
        cover = coverage(away, width, s.size_mm) * bright
        raise_to(dark, s.texel, cover * (1.0 - white))
        raise_to(grey, s.texel, cover * white)
        # Where texels are wider than strands several share one: their covers combine as independent ones do.
        half = s.values[0]
        many = cover * (s.size_mm / width.clamp(min=1e-3) - 1.0).clamp(0.0, 1.0) * half / (half + 0.5 * s.size_mm)
        add(thick_dark, s.texel, many * (1.0 - white))
        add(thick_grey, s.texel, many * white)
        raise_to(height, s.texel, _HAIR_HEIGHT * share * cover)
        soft = (width * width + s.size_mm * s.size_mm).sqrt()
        add(shadow, s.texel, (1.0 - white) * width / soft * torch.exp(-((away / (1.6 * soft)) ** 2)))
    own, white, rise, under, many_dark, many_grey = (
        finished(t, window) for t in (dark, grey, height, shadow, thick_dark, thick_grey)
    )
    both = 1.0 - torch.exp(-many_dark - many_grey)
    share = many_dark / (many_dark + many_grey).clamp(min=1e-6)
    return HairMaps(torch.maximum(own, both * share), torch.maximum(white, both * (1.0 - share)), rise, under)
