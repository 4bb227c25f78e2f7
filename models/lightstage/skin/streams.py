"""Random numbers by counter: every list of a subject has its own Philox key, so the order of calls is free."""

from __future__ import annotations

import zlib

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

Array = npt.NDArray[np.float64]


class Stream:
    """Numbers that depend on the seed and the name alone.

    Only raw 64-bit words of the generator are used: NumPy promises those to stay the same for ever, its distributions
    not.
    """

    def __init__(self, seed: int, name: str) -> None:
        self._bits = np.random.Philox(key=np.array([seed & 0xFFFFFFFFFFFFFFFF, zlib.crc32(name.encode())], np.uint64))

    def uniform(self, low: float = 0.0, high: float = 1.0, size: int = 1) -> Array:
        """(size,) float64 in the open interval (low, high)."""
        words = np.asarray(self._bits.random_raw(size), np.uint64)
        return low + (high - low) * ((words >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53

    def normal(self, mean: float = 0.0, sigma: float = 1.0, size: int = 1) -> Array:
        """(size,) float64."""
        return np.asarray(mean + sigma * ndtri(self.uniform(size=size)))

    def log_normal(self, median: float, sigma: float, size: int = 1) -> Array:
        """(size,) float64 with the given median and standard deviation of the logarithm."""
        return np.asarray(median * np.exp(self.normal(0.0, sigma, size)))

    def one(self, low: float = 0.0, high: float = 1.0) -> float:
        """One uniform number."""
        return float(self.uniform(low, high)[0])

    def chance(self, probability: float) -> bool:
        """True with the given probability."""
        return self.one() < probability

    def rotation(self) -> Array:
        """(3, 3) float64 uniformly random rotation (Shoemake's quaternion)."""
        a, b, c = self.uniform(size=3)
        x, y, z, w = (
            np.sqrt(1 - a) * np.sin(2 * np.pi * b),
            np.sqrt(1 - a) * np.cos(2 * np.pi * b),
            np.sqrt(a) * np.sin(2 * np.pi * c),
            np.sqrt(a) * np.cos(2 * np.pi * c),
        )
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
