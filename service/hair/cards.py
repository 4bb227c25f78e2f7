"""Hair cards: ribbons along strands of a groom, with a texture of strips in their colours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from service.arrays import Float32, UInt8
from service.colour import linear_to_srgb, luma
from service.hair.groom import Groom
from service.hair.guides import resampled, unit
from service.hair.scalp import Scalp
from service.levels import QualityName
from service.materials.material import Material, OwnMap
from service.materials.part import MeshPart


@dataclass(frozen=True)
class Budget:
    """What hair may cost: triangles of all meshes, and texels of the atlas's side."""

    triangles: int
    atlas: int


BUDGETS: Mapping[QualityName, Budget] = {
    "draft": Budget(20_000, 1024), "standard": Budget(60_000, 2048), "high": Budget(120_000, 2048),
    "reference": Budget(120_000, 4096),
}  # fmt: skip
QUADS, STRIPS, STRIP = 10, 16, 32
"""Quads of a ribbon; strips of the texture by brightness, and texels across one."""
HALF_M = 0.0035
"""Half a ribbon's width."""


def hair_parts(groom: Groom, scalp: Scalp, budget: Budget, seed: int = 0) -> tuple[MeshPart, ...]:
    """The mesh of a head of hair, which stands still; nothing where no strand grows."""
    if not len(groom):
        return ()
    rng = np.random.default_rng([seed, 0xCA4D])
    count = min(len(groom), budget.triangles // (2 * QUADS))
    chosen = rng.choice(len(groom), count, replace=False)
    line = resampled(groom.strands[chosen], np.ones(count, np.float32), QUADS + 1)
    along = unit(np.gradient(line, axis=1))
    across = unit(np.cross(along, scalp.outwards(line)))
    width = HALF_M * np.linspace(1, 0.5, QUADS + 1, dtype=np.float32)[None, :, None]
    points = np.stack([line - width * across, line + width * across], 2).reshape(-1, 3)
    bright = luma(groom.colour.linear()[chosen].mean(1))
    strip = (np.argsort(np.argsort(bright, kind="stable"), kind="stable") * STRIPS // count).astype(np.float32)
    u = (strip[:, None, None] + np.array([0.05, 0.95], np.float32)) / STRIPS
    v = np.linspace(0.995, 0.005, QUADS + 1, dtype=np.float32)[None, :, None]
    uv = np.stack(np.broadcast_arrays(u, v), -1).reshape(-1, 2).astype(np.float32)
    quad = np.array([[0, 1, 3], [0, 3, 2]])
    faces = (quad[None, None] + 2 * np.arange(QUADS)[None, :, None, None]
             + 2 * (QUADS + 1) * np.arange(count)[:, None, None, None]).reshape(-1, 3)  # fmt: skip
    picture = OwnMap("hair", _strips(groom.colour.linear(), strip, chosen, rng))
    material = Material("hair", colour_map=picture, alpha="mask", cutoff=0.35, double_sided=True, roughness=0.45)
    return (MeshPart("hair", points, points, faces.astype(np.int32), uv, material),)


def _strips(colour: Float32, strip: Float32, chosen: np.ndarray, rng: np.random.Generator) -> UInt8:
    """(256, STRIPS * STRIP, 4) uint8: strands side by side from root (row 0) to tip."""
    picture = np.zeros((256, STRIPS * STRIP, 4), np.float32)
    rows = np.linspace(0, colour.shape[1] - 1, 256)
    for k in range(STRIPS):
        own = colour[chosen[strip == k]]
        if not len(own):
            continue
        pick = own[rng.integers(0, len(own), STRIP)]
        low = np.minimum(rows.astype(int), colour.shape[1] - 2)
        part = (rows - low)[None, :, None]
        drawn = pick[:, low] * (1 - part) + pick[:, low + 1] * part
        picture[:, k * STRIP : (k + 1) * STRIP, :3] = np.moveaxis(drawn, 0, 1)
        ends = rng.uniform(0.75, 1.0, STRIP) * (rng.random(STRIP) < 0.85)
        picture[:, k * STRIP : (k + 1) * STRIP, 3] = np.linspace(0, 1, 256)[:, None] < ends
    picture[..., :3] = linear_to_srgb(np.clip(picture[..., :3], 0, 1))
    return np.rint(255 * picture).astype(np.uint8)
