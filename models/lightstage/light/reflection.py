"""The surroundings in the mirror of a rough surface, read at texels; ``service.light.environment`` prefilters them."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from service.light.environment import LEVEL_ALPHAS, prefiltered

__all__ = ["LEVEL_ALPHAS", "Mirror", "mirror_of"]


@dataclass(frozen=True)
class Mirror:
    """(6, 3, 32, 64) radiance for each alpha and mirror direction; ``exact`` where nothing is blurred."""

    levels: Tensor

    @classmethod
    def of(cls, sky: npt.NDArray[np.floating], device: torch.device | str = "cpu") -> Mirror:
        """Prefilter (H, W, 3) radiance whose sides are multiples of 32 and 64; about 0.1 s."""
        return cls(torch.from_numpy(prefiltered(sky)).to(device))

    def seen(self, direction: Tensor, alpha: Tensor) -> Tensor:
        """(3, h, w) mean radiance about unit mirror directions (3, h, w) for (h, w) GGX alpha."""
        height, width = self.levels.shape[2:]
        row = (torch.acos(direction[1].clamp(-1.0, 1.0)) / math.pi * height - 0.5).clamp(0.0, height - 1.0)
        column = (torch.atan2(direction[0], direction[2]) / (2.0 * math.pi) + 0.5) * width - 0.5
        knots = torch.tensor(LEVEL_ALPHAS, device=alpha.device).log()
        x = alpha.float().clamp(LEVEL_ALPHAS[0], LEVEL_ALPHAS[-1]).log()
        level = (x[..., None] > knots[1:-1]).sum(-1)
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
