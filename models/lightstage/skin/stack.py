"""Gaussian blur whose width varies from texel to texel, as millimetres on a stretched chart do."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import torch
from torch import Tensor

_KERNEL_SIGMAS = 2.4


def shifted_sum(image: Tensor, weights: list[float], axis: int) -> Tensor:
    """Correlation of the last axes with a short odd kernel, edges repeated, always added in the same order.

    Convolution routines choose their order of summation by the size of the image; this one gives a crop the same bits
    as the whole.
    """
    radius = len(weights) // 2
    length = image.shape[axis]
    index = torch.arange(-radius, length + radius, device=image.device).clamp(0, length - 1)
    padded = image.index_select(axis, index)
    total = padded.narrow(axis, 0, length) * weights[0]
    for i in range(1, len(weights)):
        total = total.add(padded.narrow(axis, i, length), alpha=weights[i])
    return total


def gaussian_weights(sigma: float) -> list[float]:
    """Truncated, normalised samples of a Gaussian with exactly the variance ``sigma`` squared, up to truncation."""
    radius = max(1, math.ceil(_KERNEL_SIGMAS * sigma))
    raw = [math.exp(-0.5 * (i / sigma) ** 2) for i in range(-radius, radius + 1)]
    return [w / sum(raw) for w in raw]


def blurred(image: Tensor, sigma: float) -> Tensor:
    """(..., h, w) blurred by ``sigma`` texels; as it is below 0.2."""
    if sigma < 0.2:
        return image
    weights = gaussian_weights(sigma)
    return shifted_sum(shifted_sum(image, weights, image.ndim - 1), weights, image.ndim - 2)


def halved(image: Tensor) -> Tensor:
    """(..., h / 2, w / 2) means of 2 x 2 blocks; sizes must be even."""
    rows = image[..., 0::2, :] + image[..., 1::2, :]
    return 0.25 * (rows[..., 0::2] + rows[..., 1::2])


def doubled(image: Tensor) -> Tensor:
    """(..., 2 h, 2 w) bilinear, inverse of ``halved`` in position; edges repeated."""
    for axis in (image.ndim - 2, image.ndim - 1):
        n = image.shape[axis]
        index = torch.arange(-1, n + 1, device=image.device).clamp(0, n - 1)
        padded = image.index_select(axis, index)
        low, mid, high = padded.narrow(axis, 0, n), padded.narrow(axis, 1, n), padded.narrow(axis, 2, n)
        first, second = 0.25 * low + 0.75 * mid, 0.75 * mid + 0.25 * high
        image = torch.stack([first, second], axis + 1).flatten(axis, axis + 1)
    return image


def _ladder(widest: float) -> list[tuple[int, float, float]]:
    """Rungs (halvings, blur at that size in its texels, variance reached in full-size texels^2), up to ``widest``."""
    count = max(0, math.ceil(math.log2(max(widest, 1e-3) / 0.8)))
    rungs, halving, variance = [], 0, 0.0
    for i in range(count + 1):
        sigma = widest / 2 ** (count - i)
        if sigma < 0.3:
            continue
        # Two halvings behind the width keep the steps of the coarse grid invisible.
        while halving < 4 and sigma / 2**halving >= 3.0:
            variance += 0.25 * (4**halving)  # of the 2 x 2 box
            halving += 1
        step = math.sqrt(max(sigma**2 - variance, 0.04)) / 2**halving
        variance += (step * 2**halving) ** 2
        rungs.append((halving, step, variance))
    return rungs


@dataclass(frozen=True)
class GaussianStack:
    """An image blurred by widths that grow by a factor of two, from which any width in between is mixed.

    Mixing two Gaussians linearly in variance gives exactly the wanted variance, so the blur has the right width at
    every texel. Levels live on images halved once or more; the corner of the image must be a multiple of ``ALIGN`` on
    the chart, or crops would not agree.

    Attributes:
        levels: images at their own resolution; level k is halved ``halvings[k]`` times.
        variances: in full-size texels^2, rising, from 0.
    """

    levels: tuple[Tensor, ...]
    halvings: tuple[int, ...]
    variances: tuple[float, ...]

    ALIGN = 16

    @classmethod
    def build(cls, image: Tensor, widest: float) -> GaussianStack:
        """Stack of (C, h, w) for widths up to ``widest`` texels (sigma); blurs beyond are cut to it."""
        levels, halvings, variances = [image], [0], [0.0]
        for halving, step, variance in _ladder(widest):
            current = levels[-1]
            for _ in range(halving - halvings[-1]):
                current = halved(current)
            levels.append(blurred(current, step))
            halvings.append(halving)
            variances.append(variance)
        return cls(tuple(levels), tuple(halvings), tuple(variances))

    @staticmethod
    def reach(widest: float) -> int:
        """Texels beyond which the image cannot change the result."""
        rungs = _ladder(widest)
        reach = sum((len(gaussian_weights(step)) // 2 + 1) * 2**halving for halving, step, _ in rungs)
        return reach + (2 ** (rungs[-1][0] + 1) if rungs else 0)

    def at(self, scale: Tensor, mixtures: list[tuple[float, float]], finest: float) -> Tensor:
        """(C, h, w): weighted sum of blurs.

        Args:
            scale: (h, w) texels per mm, in [0, ``finest``]; beyond, the end of the range is taken.
            mixtures: pairs of a width (sigma, mm) and a weight.
            finest: end of the range, the same for all windows that shall agree.
        """
        steps = 256
        table = self._weights(torch.linspace(0.0, finest, steps + 1), mixtures).to(scale.device)
        position = (scale * (steps / finest)).clamp(0.0, steps - 1e-3)
        index = position.long()
        part = position - index
        total = torch.zeros((), device=scale.device)
        for k, image in enumerate(self.full):
            low = table[:, k][index]
            total = total + (low + part * (table[:, k][index + 1] - low)) * image
        return total

    def _weights(self, scales: Tensor, mixtures: list[tuple[float, float]]) -> Tensor:
        """(n, levels) share of each level at n scales."""
        weights = torch.zeros(len(scales), len(self.levels))
        top = self.variances[-1]
        for sigma, share in mixtures:
            variance = (scales * sigma).square().clamp(0.0, top * (1.0 - 1e-6))
            for k, (low, high) in enumerate(pairwise(self.variances)):
                t = (variance - low) / (high - low)
                inside = ((variance >= low) & (variance < high)).float()
                weights[:, k] += share * inside * (1.0 - t)
                weights[:, k + 1] += share * inside * t
        return weights

    @cached_property
    def full(self) -> tuple[Tensor, ...]:
        """All levels at full size."""
        images = []
        for image, halvings in zip(self.levels, self.halvings, strict=True):
            for _ in range(halvings):
                image = doubled(image)
            images.append(image)
        return tuple(images)
