"""The surroundings as seen in the mirror of a rough surface: prefiltered once per environment and roughness."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from service.scene.sphere import pixel_directions, pixel_solid_angles

ALPHAS = (0.08, 0.16, 0.27, 0.42, 0.64, 1.0)
_OUT = (32, 64)


@functools.lru_cache(maxsize=len(ALPHAS))
def _kernel(alpha: float) -> npt.NDArray[np.float32]:
    """(out pixels, in pixels) weights of radiance for a mirror direction, viewed along the normal (Karis 2013)."""
    seen = pixel_directions(*_OUT).reshape(-1, 3).astype(np.float32)
    cosine = np.clip(seen @ seen.T, -1.0, 1.0)  # of twice the angle between normal and half vector
    n_h2 = 0.5 * (1.0 + cosine)
    d = 1.0 - n_h2 * (1.0 - alpha * alpha)
    weight = np.maximum(cosine, 0.0) / (d * d) * pixel_solid_angles(*_OUT).ravel().astype(np.float32)
    return np.asarray(weight / weight.sum(1, keepdims=True), np.float32)


@dataclass(frozen=True)
class Mirror:
    """(6, 3, 32, 64) radiance for each of ``ALPHAS`` and each mirror direction; ``exact`` where nothing is blurred."""

    levels: Tensor

    @classmethod
    def of(cls, sky: npt.NDArray[np.floating], device: torch.device | str = "cpu") -> Mirror:
        """Prefilter (H, W, 3) radiance whose sides are multiples of 32 and 64; about 0.1 s."""
        rows, columns = sky.shape[0] // _OUT[0], sky.shape[1] // _OUT[1]
        small = np.asarray(sky, np.float32).reshape(_OUT[0], rows, _OUT[1], columns, 3).mean((1, 3)).reshape(-1, 3)
        levels = [(_kernel(alpha) @ small).reshape(*_OUT, 3).transpose(2, 0, 1) for alpha in ALPHAS]
        return cls(torch.from_numpy(np.ascontiguousarray(np.stack(levels), np.float32)).to(device))

    def seen(self, direction: Tensor, alpha: Tensor) -> Tensor:
        """(3, h, w) mean radiance about unit mirror directions (3, h, w) for (h, w) GGX alpha."""
        height, width = self.levels.shape[2:]
        row = (torch.acos(direction[1].clamp(-1.0, 1.0)) / math.pi * height - 0.5).clamp(0.0, height - 1.0)
        column = (torch.atan2(direction[0], direction[2]) / (2.0 * math.pi) + 0.5) * width - 0.5
        knots = torch.tensor(ALPHAS, device=alpha.device).log()
        x = alpha.float().clamp(ALPHAS[0], ALPHAS[-1]).log()
        level = torch.bucketize(x, knots[1:-1])
        share = (x - knots[level]) / (knots[level + 1] - knots[level])
        r0 = row.floor().clamp(max=height - 2)
        c0 = column.floor()
        fr, fc = row - r0, column - c0
        r, c = r0.long(), c0.long()
        left, right = c % width, (c + 1) % width
        flat = self.levels.permute(1, 0, 2, 3).reshape(3, -1)

        def at(k: Tensor) -> Tensor:
            base = k * (height * width) + r * width
            top = torch.lerp(flat[:, base + left], flat[:, base + right], fc)
            low = torch.lerp(flat[:, base + width + left], flat[:, base + width + right], fc)
            return torch.lerp(top, low, fr)

        return torch.lerp(at(level), at(level + 1), share)


@functools.lru_cache(maxsize=64)
def _cached(data: bytes, shape: tuple[int, ...], device: str) -> Mirror:
    return Mirror.of(np.frombuffer(data, np.float32).reshape(shape), device)


def mirror_of(sky: npt.NDArray[np.floating], device: torch.device | str) -> Mirror:
    """As ``Mirror.of``, remembering the latest 64 skies."""
    exact = np.ascontiguousarray(sky, np.float32)
    return _cached(exact.tobytes(), exact.shape, str(device))
