"""Random places on the skin with a given density and no two too close."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from models.lightstage.skin.atlas import Atlas
from models.lightstage.skin.streams import Stream

Float = npt.NDArray[np.float64]


def scatter(atlas: Atlas, stream: Stream, density_per_cm2: npt.NDArray[np.floating], spacing: float = 0.0) -> Float:
    """(N, 2) chart coordinates of a random set with (H, W) expected density.

    Args:
        atlas: the chart.
        stream: source of randomness.
        density_per_cm2: (H, W) of the result; 0 where none may be.
        spacing: 0 gives a Poisson process; otherwise points nearer than ``spacing`` times the mean distance of
            neighbours are thinned by random priority (Matern's second process), about 0.7 looks natural.
    """
    expected = np.maximum(density_per_cm2, 0.0) * atlas.area_mm2 / 100.0
    # A second Matern process keeps (1 - exp(-x)) / x of its points, x = pi spacing^2 times what is put in.
    excess = 1.0
    if spacing > 0:
        kept = min(np.pi * spacing**2, 0.93)
        excess = -np.log(1.0 - kept) / kept
    cumulative = np.cumsum(expected.ravel(), dtype=np.float64)
    mean = float(cumulative[-1]) * excess
    count = int(max(0, round(mean + np.sqrt(mean) * float(stream.normal()[0]))))
    if count == 0:
        return np.zeros((0, 2))
    texel = np.searchsorted(cumulative, stream.uniform(size=count) * cumulative[-1], side="right")
    texel = np.minimum(texel, expected.size - 1)
    height, width = expected.shape
    row, column = np.divmod(texel, width)
    uv = np.stack([(column + stream.uniform(size=count)) / width, 1.0 - (row + stream.uniform(size=count)) / height], 1)
    if spacing <= 0:
        return uv
    priority = stream.uniform(size=count)
    local = density_per_cm2.ravel()[texel]
    local = np.maximum(local, 0.1 * float(local.max()))  # keeps the search short where points are rare anyway
    radius = spacing * np.sqrt(100.0 / local)
    points = atlas.sample(atlas.position, uv)
    pairs = cKDTree(points).query_pairs(float(radius.max()), output_type="ndarray")
    if len(pairs):
        near = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1) < radius[pairs].min(1)
        pairs = pairs[near]
        loser = np.where(priority[pairs[:, 0]] < priority[pairs[:, 1]], pairs[:, 0], pairs[:, 1])
        keep = np.ones(count, bool)
        keep[loser] = False
        uv = uv[keep]
    return uv
