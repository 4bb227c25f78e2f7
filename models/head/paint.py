"""Random but plausible albedo maps in the chart, to render heads for calibration.

Not a skin model: colours of skin, lips, brows, hair and eyes with some mottling, enough for a detector to see a face.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from models.head.settle import LIMBUS_DEG
from service.geometry.raster import rasterise
from service.head.model import HeadModel

Image = npt.NDArray[np.float32]

SKIN_SRGB = (
    (204, 178, 160), (196, 166, 146), (186, 150, 126), (173, 130, 102), (158, 111, 79), (137, 88, 58), (115, 69, 46),
    (92, 55, 40), (74, 46, 38),
)  # fmt: skip
"""Skin from very light to dark (melanin series of a two-layer skin model)."""
IRIS_SRGB = ((70, 45, 28), (92, 60, 34), (110, 90, 55), (96, 110, 84), (98, 122, 146), (120, 140, 160), (48, 32, 24))
PART_COLOURS = {
    "teeth_upper": (0.72, 0.66, 0.55),
    "teeth_lower": (0.66, 0.60, 0.50),
    "tongue": (0.42, 0.15, 0.14),
    "lashes": (0.02, 0.015, 0.012),
}
HAIR_SRGB = ((22, 18, 16), (38, 28, 22), (62, 44, 30), (96, 68, 44), (150, 118, 78), (140, 136, 130))


def to_linear(srgb: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """SRGB in [0, 1] -> linear (IEC 61966-2-1)."""
    x = np.asarray(srgb, np.float64)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


@dataclass(frozen=True)
class Canvas:
    """The head's regions and template positions at every texel of the chart.

    Attributes:
        mask: (H, W) bool, texels inside an island.
        part: (H, W) uint8 part, 255 outside.
        position: (H, W, 3) float32 metres on the mean head.
        regions: region name -> (H, W) float32.
        nearest: (2, H, W) row and column of the nearest texel inside an island.
    """

    mask: npt.NDArray[np.bool_]
    part: npt.NDArray[np.uint8]
    position: Image
    regions: dict[str, Image]
    nearest: npt.NDArray[np.int32]

    @classmethod
    def of(cls, head: HeadModel, width: int, height: int) -> Canvas:
        """Rasterise the chart at a size (width : height should be 3 : 2)."""
        from scipy.ndimage import distance_transform_edt

        pixels = np.stack([head.uv[:, 0] * width, (1 - head.uv[:, 1]) * height], 1)
        raster = rasterise(pixels, np.zeros(len(pixels)), head.triangle_uv, width, height)
        mask, triangle = raster.mask, raster.triangle
        corners, weights = head.triangles[triangle[mask]], raster.barycentric[mask]

        def spread(values: npt.NDArray[np.floating]) -> Image:
            shape = (height, width, *values.shape[1:])
            out = np.zeros(shape, np.float32)
            out[mask] = np.einsum("nk,nk...->n...", weights, values[corners])
            return out

        part = np.full((height, width), 255, np.uint8)
        part[mask] = head.triangle_part[triangle[mask]]
        regions = {name: spread(head.regions[k]) for k, name in enumerate(head.region_names)}
        nearest = distance_transform_edt(~mask, return_distances=False, return_indices=True)
        return cls(mask, part, spread(head.mean), regions, np.asarray(nearest, np.int32))


def _mottle(position: Image, scale_mm: float, random: np.random.Generator, waves: int = 24) -> Image:
    """Smooth noise of unit variance over the surface."""
    frequency = random.normal(size=(3, waves)).astype(np.float32) / (scale_mm * 1e-3)
    phase = random.uniform(0, 2 * np.pi, waves).astype(np.float32)
    return np.asarray(np.cos(position @ frequency + phase).sum(-1) * np.sqrt(2 / waves), np.float32)


def _pick(table: tuple[tuple[int, int, int], ...], random: np.random.Generator) -> npt.NDArray[np.float64]:
    return to_linear(np.array(table[random.integers(len(table))]) / 255.0) * random.uniform(0.85, 1.15)


def paint(head: HeadModel, canvas: Canvas, random: np.random.Generator) -> Image:
    """(H, W, 3) float32 linear RGB albedo in [0, 1] of a random subject, grown beyond the islands."""
    place = random.uniform(0, len(SKIN_SRGB) - 1)
    low = int(place)
    table = to_linear(np.array(SKIN_SRGB) / 255.0)
    skin = table[low] + (place - low) * (table[min(low + 1, len(table) - 1)] - table[low])
    r = canvas.regions
    flush = np.array([1.0, 0.78, 0.74])
    tone = 1 + 0.05 * _mottle(canvas.position, 9.0, random) + 0.05 * _mottle(canvas.position, 2.5, random)
    out = np.clip(tone, 0.6, 1.4)[..., None] * skin
    red = 0.5 * (r["cheek_left"] + r["cheek_right"] + r["nose_tip"]) + 0.4 * (r["ear_left"] + r["ear_right"])
    out *= 1 - (random.uniform(0.1, 0.6) * np.clip(red, 0, 1))[..., None] * (1 - flush)
    lip = skin * np.array([0.85, 0.5, 0.5]) * random.uniform(0.75, 1.1) + random.uniform(0, 0.06) * np.array(
        [1, 0.1, 0.2]
    )
    out = _blend(out, lip, r["lips"] * random.uniform(0.6, 1.0))
    hair = _pick(HAIR_SRGB, random)
    if random.random() < 0.85:
        out = _blend(out, hair, r["scalp"])
    hairs = np.clip(0.75 + 0.4 * _mottle(canvas.position, 1.2, random), 0, 1)
    out = _blend(
        out, hair * 0.8, np.clip((r["brow_left"] + r["brow_right"]) * hairs * random.uniform(0.5, 1.2), 0, 0.95)
    )
    if random.random() < 0.3:
        out = _blend(out, hair, r["beard"] * random.uniform(0.1, 0.7))
    out = _blend(out, skin * np.array([0.55, 0.35, 0.33]), np.clip(r["mouth_inner"] + r["eye_socket"], 0, 1))
    lid = np.clip(sum(r[f"eyelid_upper_{s}"] for s in ("left", "right")) - 0.8, 0, 0.2) * 5
    out = _blend(out, hair * 0.5, lid * random.uniform(0.3, 0.9))
    names = head.part_names
    eye_seed = int(random.integers(2**31))
    for name in ("eye_left", "eye_right"):
        if name in names:
            _paint_eye(out, head, canvas, names.index(name), eye_seed)
    for name, colour in PART_COLOURS.items():
        if name in names:
            out[canvas.part == names.index(name)] = colour
    out = out[canvas.nearest[0], canvas.nearest[1]]  # grow the islands, so that filtering never reaches beyond them
    return np.clip(out, 0, 1).astype(np.float32)


def _blend(
    image: npt.NDArray[np.float64], colour: npt.NDArray[np.float64], weight: npt.NDArray[np.floating[Any]]
) -> npt.NDArray[np.float64]:
    return np.asarray(image + weight[..., None] * (colour - image))


def _paint_eye(out: npt.NDArray[np.float64], head: HeadModel, canvas: Canvas, part: int, seed: int) -> None:
    """Sclera, iris with a dark rim, pupil; the same seed gives both eyes of a subject the same colours."""
    texels = canvas.part == part
    members = np.unique(head.triangles[head.triangle_part == part])
    centre = 0.5 * (head.mean[members].min(0) + head.mean[members].max(0))
    ray = canvas.position[texels] - centre
    angle = np.degrees(np.arccos(np.clip(ray[:, 2] / np.maximum(np.linalg.norm(ray, axis=1), 1e-9), -1, 1)))
    random = np.random.default_rng(seed)
    iris = _pick(IRIS_SRGB, random)
    colour = np.tile([0.70, 0.64, 0.60], (len(angle), 1)) * random.uniform(0.85, 1.1)
    inside = np.clip((LIMBUS_DEG - angle) / 1.5 + 0.5, 0, 1)[:, None]
    rim = np.clip(1 - np.abs(angle - LIMBUS_DEG + 1.5) / 2.0, 0, 1)[:, None]
    colour = colour + inside * (iris * (1 - 0.5 * rim) - colour)
    pupil = np.clip((random.uniform(8.3, 14.0) - angle) / 1.0 + 0.5, 0, 1)[:, None]
    out[texels] = colour + pupil * (np.array([0.005, 0.005, 0.005]) - colour)
