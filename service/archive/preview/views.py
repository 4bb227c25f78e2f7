"""Views of the head for ``preview/sheet.jpg``: textured, relit, and untextured."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from service.anatomy.hair.worn import to_albedo
from service.archive.avatar import Avatar
from service.archive.preview.page import Image, backdrop, to_pixels
from service.archive.preview.parts import Shown
from service.archive.preview.render import render, turned_camera
from service.archive.preview.shading import side_lamp
from service.archive.surface import vertex_normals
from service.arrays import Float32, UInt16
from service.materials.part import framed

What = TypeVar("What")

TILE = (256, 306)
"""Width and height of a view of the head."""

TEXTURED_YAWS = (-90, -45, 0, 45, 90)
"""Yaw of the head in the textured views, degrees."""

RELIT = ((-45, -80), (0, -70), (0, 0), (0, 70), (45, 80))
"""Yaw of the head and azimuth of the lamp in the relit views, degrees."""

VIEWED = (768, 512)
"""Width and height of the albedo in relit views: a texel is smaller than their pixels."""


def textured(avatar: Avatar) -> Iterator[tuple[str, Image]]:
    """Captions and (h, w, 3) uint8 pictures of ``TILE``: the texture, with the photo's light, from five sides."""
    fit = avatar.fit
    normals = vertex_normals(fit.vertices, avatar.head.triangles)
    behind, around = backdrop(*TILE), framed(avatar.fit.vertices, avatar.parts)
    parts = Shown(avatar.parts, avatar.texture.texture, None, photo_light(avatar))

    def view(yaw: int) -> tuple[str, Image]:
        camera = turned_camera(around, yaw, *TILE)
        drawn = render(avatar.head, fit.vertices, normals, camera, avatar.texture.texture, parts=parts)
        side = "Front" if yaw == 0 else f"{'Right' if yaw > 0 else 'Left'} side, {abs(yaw)}°"
        return side, to_pixels(drawn.over(behind))

    yield from _side_by_side(view, TEXTURED_YAWS)


def relit(avatar: Avatar) -> Iterator[tuple[str, Image]]:
    """Captions and pictures of the diffuse albedo under other lamps; nothing without albedo."""
    made, fit = avatar.reflectance, avatar.fit
    if made is None or made.diffuse_albedo is None:
        return
    albedo = small_albedo(made.diffuse_albedo, VIEWED)
    normals = vertex_normals(fit.vertices, avatar.head.triangles)
    behind, around = backdrop(*TILE), framed(avatar.fit.vertices, avatar.parts)

    def view(what: tuple[int, int]) -> tuple[str, Image]:
        yaw, azimuth = what
        camera, lamps = turned_camera(around, yaw, *TILE), side_lamp(azimuth)
        parts = Shown(avatar.parts, albedo, lamps, np.ones(3, np.float32))
        drawn = render(avatar.head, fit.vertices, normals, camera, albedo, lamps=lamps, parts=parts)
        side = "in front" if azimuth == 0 else "on the right" if azimuth > 0 else "on the left"
        return f"Albedo, lamp {side}", to_pixels(drawn.over(behind))

    yield from _side_by_side(view, RELIT)


def photo_light(avatar: Avatar) -> Float32:
    """(3,) factors from the parts' albedo to their colours in the photo's light, in which the texture is."""
    made, texture = avatar.reflectance, avatar.texture
    if made is None or made.diffuse_albedo is None:
        return np.ones(3, np.float32)
    height, width = texture.texture.shape[:2]
    light = to_albedo(texture.texture, small_albedo(made.diffuse_albedo, (width, height)), texture.lit_skin)
    return np.asarray(1 / light, np.float32)


def small_albedo(codes: UInt16, size: tuple[int, int]) -> Image:
    """(h, w, 3) uint8 sRGB, ``size`` = (w, h), of 16-bit codes of diffuse albedo (H, W, 3)."""
    import cv2

    small = np.asarray(cv2.resize(codes, size, interpolation=cv2.INTER_AREA), np.float32)
    return np.rint(small / 257).astype(np.uint8)


def clay(avatar: Avatar) -> Iterator[tuple[str, Image]]:
    """Captions and pictures of the shape, in the photo's expression and neutral."""
    behind = backdrop(*TILE)
    views = (
        ("Shape" if avatar.given else "Shape, photo's expression", avatar.fit.vertices, 0),
        ("Shape, neutral", avatar.fit.neutral, 0),
        ("Shape, neutral, 45°", avatar.fit.neutral, 45),
    )

    def view(what: tuple[str, Float32, int]) -> tuple[str, Image]:
        caption, vertices, yaw = what
        normals = vertex_normals(vertices, avatar.head.triangles)
        drawn = render(avatar.head, vertices, normals, turned_camera(vertices, yaw, *TILE))
        return caption, to_pixels(drawn.over(behind))

    yield from _side_by_side(view, views)


def _side_by_side(view: Callable[[What], tuple[str, Image]], what: Sequence[What]) -> Iterator[tuple[str, Image]]:
    """Views in order, rendered on two threads: most of the time is spent in numpy, which releases the GIL."""
    with ThreadPoolExecutor(2) as pool:
        yield from pool.map(view, what)
