"""``preview/sheet.jpg``: the whole result at a glance."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from service.anatomy.wearables import bust_colours, small_albedo, to_albedo
from service.archive.avatar import Avatar, Drawn, View
from service.archive.images import encode_normals8
from service.arrays import Float32, UInt8
from service.colour import bytes_to_linear, luma, to_bytes
from service.face.features.eye_colours import colourless
from service.geometry.camera import Camera
from service.geometry.mesh import normalise
from service.geometry.sampling import sample_chart
from service.image_filters import resized, shrunk
from service.light.environment import Illumination
from service.light.scene import WHITE, PointLight, Triple
from service.materials.part import framed
from service.render.draw import see
from service.render.drawn import DrawnHead
from service.render.sketch import over, sketch
from service.render.view import turned_camera
from service.words import WORDS

Image = UInt8
Colour = tuple[int, int, int]

PAPER: Colour = (250, 250, 248)
TILE_COLOUR: Colour = (234, 235, 236)
INK: Colour = (38, 42, 48)
GREY: Colour = (118, 122, 128)
WARNING: Colour = (176, 72, 20)

What = TypeVar("What")
Made = TypeVar("Made")

TILE = (256, 306)
"""Width and height of a view of the head."""
PIECES = 3
"""Into how many per axis pixels at edges are divided."""

TEXTURED_YAWS = (-90, -45, 0, 45, 90)
"""Yaw of the head in the textured views, degrees."""

RELIT = {-45: (-80,), 0: (-70, 0, 70), 45: (80,)}
"""Azimuths of the lamp in the relit views by the yaw of the head, degrees."""

SEEN_SIZE = (768, 512)
"""Width and height of the colours in views: a texel is smaller than their pixels."""

LAMP_M, LAMP_RADIUS_M = 2.0, 0.7
"""Distance of lamps from the head, and their radius: the terminator is soft under large ones."""
STUDIO = (
    ((-0.55, -0.60, -0.58), (0.86, 0.84, 0.80)),
    ((0.80, -0.15, -0.58), (0.16, 0.18, 0.22)),
    ((0.30, -0.45, 0.84), (0.30, 0.32, 0.36)),
)
"""Key, fill and rim: direction in camera axes (x right, y down, z away) and linear RGB on a white surface."""

CLAY = (0.50, 0.47, 0.44)
"""Linear albedo of the untextured skin."""
_PART_CLAY = {"eye": (0.72, 0.72, 0.72), "teeth": (0.68, 0.66, 0.60), "tongue": (0.42, 0.28, 0.26)}


def coloured(avatar: Avatar) -> tuple[tuple[View, ...], tuple[View, ...]]:
    """Captions and (h, w, 3) uint8 pictures of ``TILE``, of what is seen once from each of five sides.

    First the texture, with the photo's light; then the diffuse albedo under other lamps, nothing without albedo.
    """
    made = avatar.reflectance
    texture = avatar.texture.texture
    colours = bytes_to_linear(texture if texture.shape[1] <= SEEN_SIZE[0] else resized(texture, SEEN_SIZE))
    albedo = None if made is None or made.diffuse_albedo is None else small_albedo(made.diffuse_albedo, SEEN_SIZE)
    model, tint = DrawnHead.of(avatar.head, avatar.fit.vertices, avatar.parts), photo_light(avatar)
    behind = backdrop(*TILE)
    neck = bust_colours(avatar.head, texture)
    grey = avatar.fit.cheek is not None and colourless(avatar.fit.cheek)

    def views(yaw: int) -> tuple[View, list[View]]:
        camera = turned_camera(framed(model.vertices, [one.part for one in model.parts]), yaw, *TILE)
        seen = see(model, camera, 1.0, colours, pieces=PIECES)
        side = "Front" if yaw == 0 else f"{'Right' if yaw > 0 else 'Left'} side, {abs(yaw)}°"
        busts = [(one, one.colour.copy()) for one in seen.parts if one.part.name == "bust"]
        for one, _ in busts:
            if neck is not None:
                # It goes on from the neck, whose shadows the light of the whole photo does not tell.
                skin = np.rint(sample_chart(neck, one.uv)).astype(np.uint8)
                one.colour[:] = bytes_to_linear(skin) / np.array(tint, np.float32)
        shown, covered = sketch(seen, seen.read(colours), None, tint)
        if grey:  # what is made has a hue, which the light of such a photo would turn
            shown = np.repeat(luma(shown)[..., None], 3, -1)
        first = side, to_bytes(over(shown, covered, behind))
        for one, colour in busts:
            one.colour[:] = colour
        if albedo is None:
            return first, []
        unlit, relit = seen.recoloured(bytes_to_linear(albedo)), []
        for azimuth in RELIT.get(yaw, ()):
            where = "in front" if azimuth == 0 else "on the right" if azimuth > 0 else "on the left"
            lit = over(*sketch(seen, unlit, side_lamp(camera, azimuth)), behind)
            relit.append((f"Albedo, lamp {where}", to_bytes(lit)))
        return first, relit

    firsts, lit = zip(*_side_by_side(views, TEXTURED_YAWS), strict=True)
    return firsts, tuple(view for several in lit for view in several)


def clay(avatar: Avatar) -> Iterator[View]:
    """Captions and pictures of the shape, in the photo's expression and neutral."""
    views = (
        ("Shape" if avatar.given else "Shape, photo's expression", avatar.fit.vertices, 0),
        ("Shape, neutral", avatar.fit.neutral, 0),
        ("Shape, neutral, 45°", avatar.fit.neutral, 45),
    )

    def view(what: tuple[str, Float32, int]) -> View:
        camera = turned_camera(what[1], what[2], *TILE)
        return what[0], to_bytes(over(*clay_picture(avatar, what[1], camera), backdrop(*TILE)))

    yield from _side_by_side(view, views)


def clay_picture(avatar: Avatar, vertices: Float32, camera: Camera) -> tuple[Float32, Float32]:
    """The untextured head, as of :meth:`service.render.draw.SeenHead.resolved`."""
    seen = see(DrawnHead.of(avatar.head, vertices), camera, 1.0, pieces=PIECES)
    for one in seen.parts:
        one.colour[:] = _PART_CLAY.get(one.part.material.name, CLAY)
    colour = np.broadcast_to(np.array(CLAY, np.float32), seen.position_m.shape)
    return sketch(seen, colour, lamps(camera, STUDIO, (0.15, 0.15, 0.17)))


def lamps(camera: Camera, towards: Sequence[tuple[Triple, Triple]], ambient: Triple) -> Illumination:
    """Large lamps around the head: direction in camera axes and linear RGB of each, and linear RGB from all sides."""
    lights = []
    for direction, colour in towards:
        x, y, z = (float(v) for v in normalise(np.array(direction)) @ camera.rotation * LAMP_M)
        red, green, blue = (np.pi * value * LAMP_M**2 for value in colour)
        lights.append(PointLight((x, y, z), (red, green, blue), LAMP_RADIUS_M))
    return Illumination(tuple(lights), np.tile(np.array(ambient), (16, 32, 1)))


def side_lamp(camera: Camera, azimuth_deg: float) -> Illumination:
    """A strong lamp above eye level, ``azimuth_deg`` from the camera (> 0: at the image's right), and a dim sky."""
    angle = np.radians(azimuth_deg)
    key = (0.9 * float(np.sin(angle)), -0.45, -0.9 * float(np.cos(angle)))
    return lamps(camera, ((key, (1.5, 1.46, 1.4)), ((0.0, -1.0, 0.3), (0.25, 0.27, 0.31))), (0.12, 0.125, 0.14))


def photo_light(avatar: Avatar) -> Triple:
    """Factors from the parts' albedo to their colours in the photo's light, in which the texture is."""
    made, texture = avatar.reflectance, avatar.texture
    if made is None or made.diffuse_albedo is None:
        return WHITE
    height, width = texture.texture.shape[:2]
    light = to_albedo(texture.texture, small_albedo(made.diffuse_albedo, (width, height)), texture.lit_skin)
    red, green, blue = (1 / float(value) for value in light)
    return red, green, blue


def _side_by_side(view: Callable[[What], Made], what: Sequence[What]) -> Iterator[Made]:
    """What each gives, in order, drawn on two threads: most of the time is spent in numpy, which releases the GIL."""
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


def sheet(avatar: Avatar, drawn: Drawn) -> Image:
    """(h, w, 3) uint8 sRGB: textured views, relit views, untextured views, measurements of the fit, maps."""
    maps, in_lamps = list(_maps(avatar)), drawn.in_lamps
    maps_high, view_high = _map_size()[1] + _CAPTION, TILE[1] + _CAPTION
    high = (3 if in_lamps else 2) * view_high + -(-len(maps) // _MAPS_A_ROW) * maps_high
    page = blank(_WIDTH, _TITLE + high + _MARGIN)
    write_text(page, "Avatar", _MARGIN, 40, 26, INK, bold=True)
    count = len(avatar.sources)
    origin = "no photo" if avatar.given else f"{count} photos" if count > 1 else "one photo"
    write_text(page, f"{avatar.head.name} · {len(avatar.head.mean)} vertices · {origin}", _MARGIN + 104, 40, 15, GREY)
    y = _TITLE
    columns = list(_columns(TILE[0]))
    for views in (drawn.textured, in_lamps):
        for x, (caption, picture) in zip(columns, views, strict=False):
            _tile(page, picture, caption, x, y)
        y += view_high if views else 0
    for x, (caption, picture) in zip(columns, drawn.clay, strict=False):
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
    paste(page, picture, x, y)
    write_text(page, caption, x, y + picture.shape[0] + 18, 14, GREY)


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
    from service.reflectance.reflectance_maps import MID, SCALE_MM, unpack_normals

    made = avatar.reflectance
    if made is None:
        return

    def grey(values: Float32) -> Image:
        return np.repeat(np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8)[..., None], 3, 2)

    if made.diffuse_albedo is not None:
        yield "Diffuse albedo", small_albedo(made.diffuse_albedo, _map_size())
    if made.specular_albedo is not None:
        yield "Specular albedo", grey(shrunk(made.specular_albedo, _map_size()) * np.float32(1 / 65535))
    for caption, normals in (("Specular", made.specular_normal), ("Diffuse", made.diffuse_normal)):
        if normals is not None:
            yield f"{caption} normals, tangent space", encode_normals8(unpack_normals(shrunk(normals, _map_size())))
    if made.displacement is not None:
        height = (shrunk(made.displacement, _map_size()) - MID) * np.float32(0.5 * SCALE_MM / _RELIEF_MM)
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
    write_text(page, "Measured", x, y + 14, 16, INK, bold=True)
    y += 42
    for name, value in _measured(avatar):
        write_text(page, name, x, y, 14, GREY)
        write_text(page, value, x + 190, y, 14, INK)
        y += 24
    warnings = avatar.all_warnings()
    if not warnings:
        return
    write_text(page, "Warnings", x, y + 14, 16, WARNING, bold=True)
    y += 40
    for code in warnings[:4]:
        write_text(page, WORDS["warnings"][code], x, y, 14, WARNING)
        y += 21
    if len(warnings) > 4:
        write_text(page, f"and {len(warnings) - 4} more, see manifest.json", x, y, 14, WARNING)


def _measured(avatar: Avatar) -> Iterator[tuple[str, str]]:
    fit, given = avatar.fit, avatar.given
    if given is not None:
        yield "Made of", "a texture and a mesh; no photo"
        yield "Texture", f"{given.width} x {given.height}"
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


def blank(width: int, height: int, colour: Colour = PAPER) -> Image:
    """(height, width, 3) uint8 sRGB of one colour."""
    return np.full((height, width, 3), colour, np.uint8)


def backdrop(width: int, height: int) -> Float32:
    """(height, width, 3) float32 sRGB in [0, 1]: the tile colour, brighter behind the head."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    away = ((x - width / 2) / (0.7 * width)) ** 2 + ((y - 0.42 * height) / (0.7 * height)) ** 2
    glow = np.float32(0.05) * np.exp(-2 * away)[..., None]
    return np.asarray(np.array(TILE_COLOUR, np.float32) / 255 * 0.98 + glow, np.float32)


def paste(page: Image, picture: Image, x: int, y: int) -> None:
    """Copy ``picture`` into ``page`` with its top left corner at (x, y); it has to lie within the page."""
    height, width = picture.shape[:2]
    page[y : y + height, x : x + width] = picture


_PEN = ThreadPoolExecutor(1)
"""Writes all text: OpenCV reads its typeface again, in 17 ms, in each thread that writes."""


def write_text(page: Image, text: str, x: int, y: int, size: int, colour: Colour = INK, *, bold: bool = False) -> None:
    """Write one line of ``text`` into ``page``, its baseline starting at (x, y), ``size`` pixels high."""
    import cv2

    _PEN.submit(cv2.putText, page, text, (x, y), colour, cv2.FontFace("sans"), size, 600 if bold else 400).result()
