"""``preview/sheet.jpg``: the whole result at a glance."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from service.anatomy.hair.worn import to_albedo
from service.archive.avatar import Avatar
from service.archive.images import encode_normals8
from service.archive.preview.page import GREY, INK, WARNING, Image, backdrop, blank, place, to_pixels, write
from service.archive.preview.quick import Shown, render, side_lamp, turned_camera
from service.archive.surfaces import vertex_normals
from service.arrays import Float32, UInt8, UInt16
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


_GAP, _MARGIN, _TITLE, _CAPTION = 10, 22, 62, 30
_WIDTH = 5 * TILE[0] + 4 * _GAP + 2 * _MARGIN

_MAPS_A_ROW = 3
_RELIEF_MM = 0.15
"""Height that is shown white; the negative is shown black."""

SEEN_COLOUR = (46, 134, 96)
MIRRORED_COLOUR = (66, 122, 186)
INPAINTED_COLOUR = (206, 202, 196)
"""Confidence in the sheet: from the photo, from the other side of the face, inpainted."""


def sheet(avatar: Avatar) -> Image:
    """(h, w, 3) uint8 sRGB: textured views, relit views, untextured views, measurements of the fit, maps."""
    maps, in_lamps = list(_maps(avatar)), list(relit(avatar))
    maps_high, view_high = _map_size()[1] + _CAPTION, TILE[1] + _CAPTION
    high = (3 if in_lamps else 2) * view_high + -(-len(maps) // _MAPS_A_ROW) * maps_high
    page = blank(_WIDTH, _TITLE + high + _MARGIN)
    write(page, "Avatar", _MARGIN, 40, 26, INK, bold=True)
    origin = "no photo" if avatar.given else "one photo"
    write(page, f"{avatar.head.name} · {len(avatar.head.mean)} vertices · {origin}", _MARGIN + 104, 40, 15, GREY)
    y = _TITLE
    columns = list(_columns(TILE[0]))
    for views in (list(textured(avatar)), in_lamps):
        for x, (caption, picture) in zip(columns, views, strict=False):
            _tile(page, picture, caption, x, y)
        y += view_high if views else 0
    for x, (caption, picture) in zip(columns, clay(avatar), strict=False):
        _tile(page, picture, caption, x, y)
    _facts(page, avatar, columns[3] + 16, y + 8)
    y += view_high
    for index, (caption, picture) in enumerate(maps):
        row, column = divmod(index, _MAPS_A_ROW)
        _tile(page, picture, caption, list(_columns(_map_size()[0]))[column], y + row * maps_high)
    return page


def _columns(width: int) -> Iterator[int]:
    return iter(range(_MARGIN, _WIDTH - _MARGIN - width + 1, width + _GAP))


def _map_size() -> tuple[int, int]:
    width = (_WIDTH - 2 * _MARGIN - (_MAPS_A_ROW - 1) * _GAP) // _MAPS_A_ROW
    return width, round(width * 2 / 3)


def _tile(page: Image, picture: Image, caption: str, x: int, y: int) -> None:
    place(page, picture, x, y)
    write(page, caption, x, y + picture.shape[0] + 18, 14, GREY)


def _maps(avatar: Avatar) -> Iterator[tuple[str, Image]]:
    import cv2

    seen = ("Confidence: seen (green), mirrored (blue), made up (grey)", confidence_colours(avatar.texture.confidence))
    maps = (
        ("Texture", avatar.texture.texture),
        *(() if avatar.given else (seen,)),
        ("Shape normals, object space", encode_normals8(avatar.texture.shape_normal_object)),
    )
    for caption, picture in (*maps, *_reflectance(avatar)):
        way = cv2.INTER_AREA if picture.shape[1] >= _map_size()[0] else cv2.INTER_NEAREST
        yield caption, np.asarray(cv2.resize(picture, _map_size(), interpolation=way), np.uint8)


def _reflectance(avatar: Avatar) -> Iterator[tuple[str, Image]]:
    """Maps of the networks, reduced first, as they may have a hundred times the texels."""
    import cv2

    from service.reflectance.reflectance_maps import MID, SCALE_MM, unpack_normals

    made = avatar.reflectance
    if made is None:
        return

    def small(codes: UInt16 | npt.NDArray[np.int16]) -> Float32:
        return np.asarray(cv2.resize(codes, _map_size(), interpolation=cv2.INTER_AREA), np.float32)

    def grey(values: Float32) -> Image:
        return np.repeat(np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8)[..., None], 3, 2)

    if made.diffuse_albedo is not None:
        yield "Diffuse albedo", small_albedo(made.diffuse_albedo, _map_size())
    if made.specular_albedo is not None:
        yield "Specular albedo", grey(small(made.specular_albedo) * np.float32(1 / 65535))
    for caption, normals in (("Specular", made.specular_normal), ("Diffuse", made.diffuse_normal)):
        if normals is not None:
            yield f"{caption} normals, tangent space", encode_normals8(unpack_normals(small(normals)))
    if made.displacement is not None:
        height = (small(made.displacement) - MID) * np.float32(0.5 * SCALE_MM / _RELIEF_MM)
        yield f"Displacement, black and white at {_RELIEF_MM} mm", grey(height + np.float32(0.5))


def confidence_colours(confidence: UInt8) -> Image:
    """(h, w, 3) uint8 sRGB of a confidence map (h, w): paler where the confidence is lower."""
    from service.map_registry import MIRRORED, SEEN

    codes = np.arange(256)
    inpainted = np.array(INPAINTED_COLOUR, np.float64)
    table = np.tile(inpainted, (256, 1))
    for low, high, colour in ((SEEN, 255, SEEN_COLOUR), (MIRRORED, SEEN - 1, MIRRORED_COLOUR)):
        sure = 0.35 + 0.65 * (codes - low) / (high - low)
        mixed = inpainted + sure[:, None] * (np.array(colour) - inpainted)
        table = np.where(((codes >= low) & (codes <= high))[:, None], mixed, table)
    return np.rint(table).astype(np.uint8)[confidence]


def _facts(page: Image, avatar: Avatar, x: int, y: int) -> None:
    """Write measurements and warnings."""
    write(page, "Measured", x, y + 14, 16, INK, bold=True)
    y += 42
    for name, value in _measured(avatar):
        write(page, name, x, y, 14, GREY)
        write(page, value, x + 190, y, 14, INK)
        y += 24
    warnings = avatar.all_warnings()
    if not warnings:
        return
    write(page, "Warnings", x, y + 14, 16, WARNING, bold=True)
    y += 40
    for code in warnings[:4]:
        write(page, code, x, y, 14, WARNING)
        y += 21
    if len(warnings) > 4:
        write(page, f"and {len(warnings) - 4} more, see manifest.json", x, y, 14, WARNING)


def _measured(avatar: Avatar) -> Iterator[tuple[str, str]]:
    fit, given = avatar.fit, avatar.given
    if given is not None:
        yield "Made of", "a texture and a mesh; no photo"
        yield "Texture", f"{given.size[0]} x {given.size[1]}"
        return
    yaw, pitch, roll = fit.camera.yaw_pitch_roll_deg()
    share = f"{100 * fit.landmark_rms_px / fit.inter_ocular_px:.1f} %" if fit.inter_ocular_px > 0 else "unknown share"
    yield "Landmark error", f"{fit.landmark_rms_px:.1f} px ({share} of eye distance)"
    yield "Yaw, pitch, roll", f"{yaw:.0f}°, {pitch:.0f}°, {roll:.0f}°"
    yield "Focal length", f"{fit.camera.focal_px:.0f} px at {fit.camera.width} x {fit.camera.height}"
    yield "Face seen in the photo", f"{100 * avatar.texture.visible_fraction:.0f} %"
    if avatar.similarity is not None:
        yield "Identity, centred cosine", f"{avatar.similarity.centred_cosine:.2f}"
        between = avatar.similarity.impostor.get("centred_cosine_p95")
        if between is not None:
            yield "95 % of other people", f"below {between:.2f}"
