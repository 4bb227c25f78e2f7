"""Parts beside the head's own in pictures: read from archives, drawn with alpha, before and behind the head."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from service.archive.images import encode_png
from service.archive.reading import unpack_texture
from service.archive.rendering import smoothed
from service.light.scene import PointLight
from service.materials.material import ChartMap, Material, OwnMap
from service.materials.part import MeshPart
from service.render.draw import see
from service.render.drawn import DrawnHead, without_parts
from service.render.render import NO_SHADOWS, render_head
from service.render.request import RenderRequest
from service.render.sketch import sketch
from service.render.view import camera_at, turned_camera
from tests.service.render.toys import EVEN, HEAD, ROUGH, albedo, scene


def sheet(z: float, code: tuple[int, int, int, int]) -> MeshPart:
    """A square of one colour across the head, at a depth."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) * np.float32(0.06)
    points = corners + np.array([0, 0, z], np.float32)
    picture = OwnMap("sheet", np.tile(np.array(code, np.uint8), (4, 4, 1)))
    material = Material("sheet", colour_map=picture, alpha="blend", double_sided=True)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    return MeshPart("sheet", points, points, np.array([[0, 1, 2, 3]], np.int32), uv, material)


def middle(*parts: MeshPart) -> np.ndarray:
    request = RenderRequest(scene=scene(EVEN), size=(48, 56), samples=1, background="transparent")
    made = render_head(HEAD, HEAD.mean, albedo(), request, threads=1, detail=ROUGH, parts=parts)
    assert (NO_SHADOWS in made.fallbacks) == any(part.material.alpha == "blend" for part in parts)
    return np.asarray(made.light[28, 24])


def test_a_part_hides_what_lies_behind_it_by_its_alpha() -> None:
    alone, solid = middle(), middle(sheet(0.3, (0, 255, 0, 255)))
    assert solid[1] > 5 * max(solid[0], solid[2])
    half = middle(sheet(0.3, (0, 255, 0, 128)))
    np.testing.assert_allclose(half, alone + (solid - alone) * 128 / 255, atol=2e-3)
    np.testing.assert_allclose(middle(sheet(0.3, (0, 255, 0, 0))), alone, atol=1e-6)
    np.testing.assert_allclose(middle(sheet(-0.3, (0, 255, 0, 255))), alone, atol=1e-6)


def test_a_bright_part_before_dark_skin_is_no_white_patch() -> None:
    """The picture is exposed for skin; of black skin, or of skin in the dark, all that covered it burnt out."""
    request = RenderRequest(scene=scene(EVEN, exposure=None), size=(48, 56), samples=1)
    part = sheet(0.3, (140, 130, 120, 255))
    made = render_head(HEAD, HEAD.mean, albedo(6), request, threads=1, detail=ROUGH, parts=(part,))
    red, green, blue = made.pixels[28, 24].astype(int)
    assert 250 > red > green > blue, "it keeps its colour"


def test_a_part_that_goes_on_from_the_head_leaves_no_gap() -> None:
    """At one sample a pixel, or beside a border that was smoothed, the background would show between the two."""
    middle_of = HEAD.mean[HEAD.polygons].mean(1) @ [0.7, 1.0, 0.0]
    low = middle_of < np.median(middle_of)  # along steps, which would be cut off
    marked = np.where(low, len(HEAD.part_names), HEAD.polygon_part).astype(np.uint8)
    cut = dataclasses.replace(HEAD, part_names=(*HEAD.part_names, "lower"), polygon_part=marked)
    upper, vertices = smoothed(without_parts(cut, {"lower"}), HEAD.mean)
    chart = Material("chart", colour_map=ChartMap("diffuse_albedo"))
    lower = MeshPart("bust", HEAD.mean, HEAD.mean, HEAD.polygons[low], HEAD.uv, chart, uv_faces=HEAD.polygon_uv[low])
    request = RenderRequest(scene=scene(EVEN), size=(96, 112), background="transparent")
    whole, split = (
        render_head(head, points, albedo(), request, threads=1, detail=ROUGH, parts=parts, camera=camera)
        for camera in [camera_at((0.0, 0.0, 1.2), HEAD.mean, *request.size)]
        for head, points, parts in ((HEAD, HEAD.mean, ()), (upper, vertices, (lower,)))
    )
    inside = cv2.erode((whole.covered == 1).astype(np.uint8), np.ones((5, 5))) > 0  # the outline is smoothed
    assert inside.sum() > 1000
    np.testing.assert_allclose(split.covered[inside], 1.0, atol=1e-6)


def test_the_bust_lies_in_the_shadow_of_the_head() -> None:
    """It had the light of the open, and was paler than the neck above it."""
    level = np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]], np.float32) * np.float32(0.3)
    chest = level + np.array([0, HEAD.mean[:, 1].min(), 0], np.float32)
    grey = Material("bust", (0.5, 0.5, 0.5), roughness=0.9)
    part = MeshPart("bust", chest, chest, np.array([[0, 1, 2, 3]], np.int32), np.zeros((4, 2), np.float32), grey)
    lamp = PointLight((0.0, 1.0, 0.0), (1.0, 1.0, 1.0), 0.0)
    request = RenderRequest(scene=scene(None, lamp), size=(48, 48), tolerance=0.0)
    camera = camera_at((0.0, 1.2, 1.2), chest, *request.size)
    shadowed, lit = (
        render_head(
            HEAD, HEAD.mean, albedo(), request, threads=1, detail=ROUGH, parts=(part,), without=without, camera=camera
        ).light.mean(2)
        for without in ((), ("shadows",))
    )
    assert ((lit > 0.1) & (shadowed < 0.01)).sum() > 10


def test_colours_and_alpha_come_through_the_decode_gate() -> None:
    pixels = np.random.default_rng(4).integers(0, 256, (8, 12, 4), np.uint8)
    pixels[..., 3] = np.maximum(pixels[..., 3], 1)
    read = unpack_texture(encode_png(pixels, srgb=True), "toy")
    assert np.array_equal(read[..., 3], pixels[..., 3])
    solid = pixels[..., 3] > 200
    assert np.abs(read[solid][:, :3].astype(int) - pixels[solid][:, :3]).max() <= 1
    opaque = unpack_texture(encode_png(pixels[..., :3], srgb=True), "toy")
    assert np.array_equal(opaque, pixels[..., :3])


def test_quick_pictures_have_the_shade_of_cavity_maps() -> None:
    """Without it molars in the corners of an open mouth are as white as front teeth, and look like fangs."""
    pixels = np.full((8, 8), 255, np.uint8)
    pixels[:, 4:] = 51
    looks = []
    for cavity in (None, OwnMap("open", pixels)):
        plain_part = sheet(0.1, (128, 128, 128, 255))
        part = dataclasses.replace(plain_part, material=dataclasses.replace(plain_part.material, cavity_map=cavity))
        seen = see(DrawnHead.of(HEAD, HEAD.mean, (part,)), turned_camera(HEAD.mean, 0, 48, 56), 1.0, None)
        sketch(seen, np.zeros((len(seen.index), 3), np.float32))
        (one,) = (p for p in seen.parts if p.part is part)
        looks.append((one.uv[:, 0], one.radiance[:, 0]))
    (u, plain), (_, shaded) = looks
    left, right = u < 0.4, u > 0.6
    assert left.any() and right.any()
    assert shaded[left] == pytest.approx(plain[left], rel=1e-4)
    assert shaded[right] == pytest.approx(0.2 * plain[right], rel=1e-2)
