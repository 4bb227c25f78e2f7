"""Which way strands of hair run, in a photo and in a style that is drawn over it.

Silhouettes do not tell hair that is combed back and tied from hair that is short, or a fringe from a parting; the
direction of strands does (Paris, Briceño and Sillion 2004, "Capture of hair geometry from multiple images"). Directions
without a sign are doubled angles (cos 2a, sin 2a), as their means are then right; their length in [0, 1] is how much
all strands around agree, the coherence of the structure tensor (Bigün and Granlund 1987).
"""

from __future__ import annotations

import numpy as np

from service.anatomy.hair.item import Item
from service.arrays import AnyFloat, Float32, Int64, UInt8
from service.colour import luma

GRADIENT_PX, AROUND_PX = 1.0, 3.0
"""Standard deviations of the derivatives and of the neighbourhood of the structure tensor."""
SHADE_PX = 5.0
"""Standard deviation of the blur that is taken for the shade of the hair as a whole, and for its highlights."""
FLAT = 0.01
"""Gradient of the logarithm of luminance, per pixel, that is no more than noise."""
DARKEST = 0.003
"""Linear luminance under which differences count less and less."""
BORDER = 1
"""Cells from the outline of the hair in which that is mixed with what lies beside it."""
LEAST_CELLS = 60.0
"""Weight of cells at which half of the agreement counts: few strands tell little."""


def doubled(bright: Float32, own: Float32) -> Float32:
    """(h, w, 2) directions along the strands of an image of luminance (h, w), linear; y points down.

    Args:
        bright: luminance.
        own: (h, w) in [0, 1], 1 on hair: what lies beside it, and the shade of the hair as a whole, do not count.
    """
    import cv2

    def mean(values: Float32, sigma: float) -> Float32:
        weight = cv2.GaussianBlur(own, (0, 0), sigma)[..., None] + np.float32(1e-4)
        return np.asarray(cv2.GaussianBlur(values * own[..., None], (0, 0), sigma).reshape(values.shape) / weight)

    levels = np.log(np.asarray(bright, np.float32) + np.float32(DARKEST))[..., None]
    soft = ((mean(levels, GRADIENT_PX) - mean(levels, SHADE_PX)) * own[..., None])[..., 0]
    gx, gy = cv2.Sobel(soft, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(soft, cv2.CV_32F, 0, 1, scale=0.125)
    products = mean(np.stack([gx * gx - gy * gy, 2 * gx * gy, gx * gx + gy * gy], -1), AROUND_PX)
    # Strands run across the gradient: half a turn of the doubled angle.
    return np.asarray(-products[..., :2] / (products[..., 2:] + np.float32(FLAT**2)) * own[..., None], np.float32)


def in_photo(pixels: Float32, hair: Float32) -> Float32:
    """(c, c, 2) directions of the strands in linear RGB (h, h, 3), one for each cell of ``hair`` (c, c) in [0, 1]."""
    import cv2

    count, side = len(hair), len(pixels)
    inner = cv2.erode(np.asarray(hair > 0.5, np.uint8), np.ones((2 * BORDER + 1,) * 2, np.uint8)).astype(np.float32)
    own = np.asarray(cv2.resize(inner, (side, side), interpolation=cv2.INTER_NEAREST), np.float32)
    found = doubled(luma(pixels), own)
    return np.asarray(cv2.resize(found, (count, count), interpolation=cv2.INTER_AREA), np.float32)


def in_texture(picture: UInt8) -> Float32:
    """(H, W, 2) directions of the strands on the texture of a style, row 0 at v = 1; v points up in them."""
    solid = (picture[..., -1] > 127).astype(np.float32)
    found = doubled(np.asarray((picture[..., 0] / 255.0) ** 2, np.float32), solid)
    return np.asarray(found * np.array([1, -1], np.float32), np.float32)


def drawn(item: Item, texture: Float32, flat: AnyFloat, triangle: Int64, barycentric: Float32) -> Float32:
    """(N, 2) directions of a style's strands as they are seen.

    Args:
        item: the style.
        texture: as :func:`in_texture` gives it.
        flat: (V, 2) its vertices in the picture.
        triangle: (N,) which triangle is seen.
        barycentric: (N, 3) where on it.

    Triangles without area on the texture have no direction: 0.
    """
    corners = item.triangles[triangle]
    uv = np.einsum("nk,nkc->nc", barycentric, item.uv[corners])
    height, width = texture.shape[:2]
    column = np.clip((uv[:, 0] % 1.0) * width, 0, width - 1).astype(int)
    row = np.clip(((1 - uv[:, 1]) % 1.0) * height, 0, height - 1).astype(int)
    own = texture[row, column].astype(np.float64)
    coherence, angle = np.linalg.norm(own, axis=1), 0.5 * np.arctan2(own[:, 1], own[:, 0])
    way = np.stack([np.cos(angle), np.sin(angle)], 1) / [width, height]
    edge_uv = item.uv[corners[:, 1:]] - item.uv[corners[:, :1]]  # (N, 2, 2)
    edge = np.asarray(flat)[corners[:, 1:]] - np.asarray(flat)[corners[:, :1]]
    area = np.linalg.det(edge_uv)
    good = np.abs(area) > 1e-12
    inverse = np.zeros_like(edge_uv, np.float64)
    inverse[good] = np.linalg.inv(edge_uv[good].astype(np.float64))
    seen = np.einsum("nc,nck,nkd->nd", way, inverse, edge)
    length = np.linalg.norm(seen, axis=1)
    good &= length > 1e-12
    seen = seen / np.maximum(length, 1e-12)[:, None]
    twice = np.stack([seen[:, 0] ** 2 - seen[:, 1] ** 2, 2 * seen[:, 0] * seen[:, 1]], 1)
    return np.asarray(twice * (coherence * good)[:, None], np.float32)


def agreement(photo: Float32, style: Float32, hair: Float32) -> float:
    """How well two fields of directions (h, w, 2) agree where the photo's hair (h, w) is, in [-1, 1]; 0 tells nothing.

    Each cell counts by how coherent both are; a style counts where it has strands.
    """
    weight = np.linalg.norm(photo, axis=-1) * np.linalg.norm(style, axis=-1) * hair
    return float((photo * style).sum(-1).ravel() @ hair.ravel() / (weight.sum() + LEAST_CELLS))
