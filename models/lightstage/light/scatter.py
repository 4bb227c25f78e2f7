"""Light that wanders under the skin: irradiance blurred by a sum of Gaussians in millimetres, one set per colour.

Profile: d'Eon and Luebke, GPU Gems 3, ch. 14. Light crosses the surface twice, so half of the albedo colours it on the
way in and half on the way out: radiosity = sqrt(A) * blur(sqrt(A) * E).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

PROFILE: tuple[tuple[float, tuple[float, float, float]], ...] = (
    (0.0064, (0.233, 0.455, 0.649)),
    (0.0484, (0.100, 0.336, 0.344)),
    (0.187, (0.118, 0.198, 0.0)),
    (0.567, (0.113, 0.007, 0.007)),
    (1.99, (0.358, 0.004, 0.0)),
    (7.41, (0.078, 0.0, 0.0)),
)
"""Variance in mm^2 and weights of red, green and blue; each colour's weights add to 1."""

_SIGMAS = 3.0
_FIRST = 0.25  # variance in texels^2 of the first level


def _levels(widest: float) -> list[tuple[int, float]]:
    """(halvings, variance in full-size texels^2) of blurs whose variance doubles, up to at least ``widest``^2."""
    levels, variance = [], _FIRST
    while True:
        sigma = math.sqrt(variance)
        # Blurs are at least 3 texels wide on the halved image: its grid then does not show.
        levels.append((max(0, math.floor(math.log2(sigma / 3.0))) if sigma > 3.0 else 0, variance))
        if variance >= widest * widest:
            return levels
        variance *= 2.0


def alignment(texels_per_mm: float, scale: float = 1.0) -> int:
    """Windows must begin and end at multiples of this for a crop to equal the whole."""
    return int(2 ** _levels(_widest(texels_per_mm, scale))[-1][0])


def reach(texels_per_mm: float, scale: float = 1.0) -> int:
    """Texels beyond which nothing can change the result, for skin of at most ``texels_per_mm``."""
    total, before = 0.0, 0.0
    for halvings, variance in _levels(_widest(texels_per_mm, scale)):
        total += math.ceil(_SIGMAS * math.sqrt(variance - before)) + 2.0 * 2**halvings
        before = variance
    return math.ceil(total)


def _widest(texels_per_mm: float, scale: float) -> float:
    return math.sqrt(PROFILE[-1][0]) * scale * texels_per_mm


def _blur(image: Tensor, sigma: float) -> Tensor:
    """Gaussian of exactly this variance on the last two axes; terms are added in the same order whatever the size."""
    if sigma < 0.05:
        return image
    radius = max(1, math.ceil(_SIGMAS * sigma))
    raw = [math.exp(-0.5 * (i / sigma) ** 2) for i in range(-radius, radius + 1)]
    if sigma < 0.8:  # sampled so coarsely a Gaussian is too narrow or wide: three taps with the right variance
        outer = min(0.5 * sigma * sigma, 0.5)
        radius, raw = 1, [outer, 1.0 - 2.0 * outer, outer]
    weights = [w / sum(raw) for w in raw]
    for axis in (image.ndim - 1, image.ndim - 2):
        n = image.shape[axis]
        index = torch.arange(-radius, n + radius, device=image.device).clamp(0, n - 1)
        padded = image.index_select(axis, index)
        total = padded.narrow(axis, 0, n) * weights[0]
        for i in range(1, len(weights)):
            total = total.add(padded.narrow(axis, i, n), alpha=weights[i])
        image = total
    return image


def _halved(image: Tensor) -> Tensor:
    height, width = image.shape[-2] // 2 * 2, image.shape[-1] // 2 * 2
    even = image[..., :height, :width]
    rows = even[..., 0::2, :] + even[..., 1::2, :]
    return 0.25 * (rows[..., 0::2] + rows[..., 1::2])


def _enlarged(image: Tensor, factor: int, height: int, width: int) -> Tensor:
    """Bilinear, corners of both grids together."""
    for axis, size in ((image.ndim - 2, height), (image.ndim - 1, width)):
        at = (torch.arange(size, device=image.device, dtype=torch.float32) + 0.5) / factor - 0.5
        low = at.floor()
        share = (at - low).to(image.dtype)
        share = share[:, None] if axis == image.ndim - 2 else share
        last = image.shape[axis] - 1
        first = image.index_select(axis, low.long().clamp(0, last))
        second = image.index_select(axis, (low.long() + 1).clamp(0, last))
        image = first + (second - first) * share
    return image


def scattered(light: Tensor, texels_per_mm: Tensor, mask: Tensor, densest: float, scale: float = 1.0) -> Tensor:
    """(3, h, w) light blurred by the profile of each colour, its width in mm everywhere.

    A blur of any width is a mixture of the two nearest of a ladder whose variances double; blurs narrower than half a
    texel are left out. Light outside ``mask`` takes no part: what reaches the mask's edge is scaled up by what is
    missing, so even light stays as it is.

    Args:
        light: (3, h, w) >= 0, float32.
        texels_per_mm: (h, w).
        mask: (h, w) in [0, 1], 1 on skin.
        densest: greatest ``texels_per_mm`` that is allowed for; widths beyond are cut.
        scale: width of the profile relative to the published one.
    """
    height, width = light.shape[1:]
    levels = _levels(_widest(densest, scale))
    variances = [0.0, *(v for _, v in levels)]
    most = variances[-1] * (1.0 - 1e-6)
    spreads = [(texels_per_mm * texels_per_mm * (v * scale * scale)).clamp(max=most) for v, _ in PROFILE]
    current, halvings, before = torch.cat([light * mask, mask[None]]), 0, 0.0
    weight = _share(0, spreads, variances)
    total = weight * current[:3]
    share = weight * mask
    for level, (wanted, variance) in enumerate(levels, 1):
        step = variance - before
        while halvings < wanted:
            current = _halved(current)
            step -= 0.25 * 4**halvings
            halvings += 1
        current = _blur(current, math.sqrt(max(step, 0.0)) / 2**halvings)
        before = variance
        full = current if halvings == 0 else _enlarged(current, 2**halvings, height, width)
        weight = _share(level, spreads, variances)
        total = total + weight * full[:3]
        share = share + weight * full[3]
    return torch.where(share > 1e-4, total / share.clamp(min=1e-4), light)


def _share(level: int, wanted: list[Tensor], variances: list[float]) -> Tensor:
    """(3, h, w) weight of one level: each Gaussian of the profile is shared by the two levels about its variance.

    Args:
        level: index into ``variances``.
        wanted: (h, w) variance in texels^2 of each Gaussian, below the last of ``variances``.
        variances: of the levels in texels^2, growing.
    """
    here, total = variances[level], torch.zeros(3, *wanted[0].shape, device=wanted[0].device)
    for variance, (_, colours) in zip(wanted, PROFILE, strict=True):
        part = torch.zeros_like(variance)
        if level > 0:
            low = variances[level - 1]
            part = torch.where((variance >= low) & (variance < here), (variance - low) / (here - low), part)
        if level + 1 < len(variances):
            high = variances[level + 1]
            part = torch.where((variance >= here) & (variance < high), 1.0 - (variance - here) / (high - here), part)
        total = total + torch.tensor(colours, device=variance.device).view(3, 1, 1) * part
    return total
