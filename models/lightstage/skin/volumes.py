"""Periodic noise volumes, sampled at points of the template in millimetres.

Noise lives in the space around the template head and not on the chart, so that it has neither seams nor stretch. Each
volume is made once from fixed seeds; subjects differ by a random rotation and shift, which also keeps the period from
showing: its lattice vectors do not lie in the surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from models.lightstage.skin.stack import doubled, halved
from models.lightstage.skin.streams import Stream

CHANNELS = 4


@dataclass(frozen=True)
class Volume:
    """A periodic scalar field with some channels.

    Attributes:
        data: (1, C, D + 1, D + 1, D + 1) float32, last plane equal to the first.
        period: length of the period in the unit that the volume was designed in.
    """

    data: Tensor
    period: float

    def __call__(self, points: Tensor, scale: float, place: Placement) -> Tensor:
        """(C, h, w) float32 trilinear values at (3, h, w) points in mm; ``scale`` mm is one unit of the volume.

        Every value depends on its own point only.
        """
        matrix = torch.tensor(place.rotation / (scale * self.period), dtype=torch.float32, device=points.device)
        x, y, z = points[0], points[1], points[2]
        axes = [matrix[i, 0] * x + matrix[i, 1] * y + matrix[i, 2] * z + place.shift[i] for i in range(3)]
        grid = torch.stack([(a - a.floor()) * 2.0 - 1.0 for a in axes], -1)[None, None]
        return torch.nn.functional.grid_sample(self.data, grid, mode="bilinear", align_corners=True)[0, :, 0]

    def coarse(self, points: Tensor, scale: float, place: Placement, dense: bool) -> Tensor:
        """As a call, but on a grid of half the size where texels are ``dense`` against ``scale`` (10 or more in it).

        The points must be aligned as ``GaussianStack`` wants it, else crops do not agree; the outermost texel differs.
        """
        if not dense:
            return self(points, scale, place)
        return doubled(self(halved(points).contiguous(), scale, place))

    def to(self, device: torch.device | str) -> Volume:
        """The same volume on a device."""
        return Volume(self.data.to(device), self.period)


@dataclass(frozen=True)
class Placement:
    """Where a subject's layer lies in a volume: (3, 3) rotation (rows may be scaled for anisotropy) and shift."""

    rotation: npt.NDArray[np.float64]
    shift: tuple[float, float, float]

    @classmethod
    def sample(cls, seed: int, layer: str) -> Placement:
        """A random one."""
        stream = Stream(seed, f"placement {layer}")
        rotation = stream.rotation()
        a, b, c = stream.uniform(size=3)
        return cls(rotation, (float(a), float(b), float(c)))

    def stretched(self, along: npt.NDArray[np.float64], factor: float) -> Placement:
        """Features drawn out by ``factor`` along the direction ``along`` (3,) of the template's space."""
        axis = along / max(float(np.linalg.norm(along)), 1e-9)
        squeeze = np.eye(3) - (1.0 - 1.0 / factor) * np.outer(axis, axis)
        return Placement(self.rotation @ squeeze, self.shift)


def _closed(values: npt.NDArray[np.floating]) -> Tensor:
    padded = np.pad(values.astype(np.float32), ((0, 0), (0, 1), (0, 1), (0, 1)), mode="wrap")
    return torch.from_numpy(padded)[None]


@lru_cache(maxsize=8)
def noise(octaves: int = 1, gain: float = 0.7, size: int = 64) -> Volume:
    """Gaussian noise of variance 1 in 4 channels, whose unit is the shortest wavelength.

    The spectrum falls by ``gain`` in amplitude an octave from the longest wavelength, 2^(octaves - 1) units, to the
    shortest; one octave is a band of an octave's width. Four voxels a unit keep trilinear interpolation honest.
    """
    frequency = np.fft.fftfreq(size) * 4.0
    radius = np.sqrt(frequency[:, None, None] ** 2 + frequency[None, :, None] ** 2 + frequency[None, None, :] ** 2)
    octave = -np.log2(np.maximum(radius, 1e-6))  # 0 at the shortest wavelength
    inside = (octave > -0.5) & (octave < octaves - 0.5)
    # Power per octave in three dimensions goes with the cube of the frequency.
    shape = np.where(inside, gain ** (-octave) * np.maximum(radius, 1e-6) ** -1.5, 0.0)
    white = Stream(octaves, f"noise {size} {gain}").normal(size=CHANNELS * size**3).reshape(CHANNELS, size, size, size)
    field = np.fft.ifftn(np.fft.fftn(white, axes=(1, 2, 3)) * shape, axes=(1, 2, 3)).real
    return Volume(_closed(field / field.std(axis=(1, 2, 3), keepdims=True)), size / 4.0)


@lru_cache(maxsize=4)
def furrows(width: float = 0.16, cells: int = 12, voxels: int = 8) -> Volume:
    """The net of lines between the cells of a Voronoi diagram, unit = mean spacing of the cells.

    Channels: 0 the furrows, 1 in their beds and 0 on the plateaus, each edge with its own depth in [0.25, 1]; 1 a dome
    over each cell in [0, 1]; 2 a random value in [-1, 1] per cell; 3 the same for a second, independent value.
    """
    stream = Stream(cells, "furrows")
    corner = np.stack(np.meshgrid(*[np.arange(cells)] * 3, indexing="ij"), -1).reshape(-1, 3)
    sites = (corner + stream.uniform(size=3 * cells**3).reshape(-1, 3)) % cells
    values = stream.uniform(-1.0, 1.0, size=2 * cells**3).reshape(2, -1)
    size = cells * voxels
    axis = np.arange(size) / voxels
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    distance, index = cKDTree(sites, boxsize=cells).query(points, k=2)
    border = distance[:, 1] - distance[:, 0]
    pair = (np.minimum(index[:, 0], index[:, 1]) * 7919 + np.maximum(index[:, 0], index[:, 1]) * 104729) % 1009
    depth = 0.25 + 0.75 * pair / 1008.0
    groove = depth * np.exp(-((border / width) ** 1.5))
    dome = 1.0 - np.clip(distance[:, 0] / 0.75, 0.0, 1.0) ** 2
    field = np.stack([groove, dome, values[0][index[:, 0]], values[1][index[:, 0]]])
    return Volume(_closed(field.reshape(4, size, size, size)), float(cells))
