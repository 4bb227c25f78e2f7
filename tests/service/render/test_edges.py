"""Edges and strands finer than a pixel: coverage is that of the geometry, without stairs and without dots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.geometry.camera import Camera
from service.materials.material import Material, OwnMap
from service.materials.part import MeshPart
from service.render.draw import see
from service.render.drawn import DrawnHead
from service.render.fibres import EDGE, StrandTexture, widened
from service.render.sketch import outlined, sketch
from tests.service.render.toys import HEAD

SIDE = 40
CAMERA = Camera(SIDE, SIDE, 400.0, np.full(2, SIDE / 2), np.diag([1.0, -1.0, -1.0]), np.array([-5.0, 0.0, 1.0]))
"""Looks at (5, 0, 0) from 1 m before it, far from the head: a pixel is 2.5 mm wide there."""
PIXEL_M = 1 / 400


def ribbon(half_m: tuple[float, float], turn_deg: float, material: Material, rows: int = 2) -> MeshPart:
    """A flat ribbon at the middle of the picture, of half a width and half a length, turned in the picture's plane."""
    v = np.linspace(0, 1, rows)
    uv = np.stack(np.broadcast_arrays(np.array([0.0, 1.0]), v[:, None]), -1).reshape(-1, 2)
    flat = (2 * uv - 1) * half_m
    angle = np.radians(turn_deg)
    turned = flat @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    points = np.column_stack([turned[:, 0] + 5, turned[:, 1], np.zeros(len(turned))]).astype(np.float32)
    first = 2 * np.arange(rows - 1)[:, None]
    return MeshPart(
        "toy", points, points, (first + np.array([0, 1, 3, 2])).astype(np.int32), uv.astype(np.float32), material
    )


def coverage(part: MeshPart, pieces: int = 1, camera: Camera = CAMERA) -> np.ndarray:
    seen = see(DrawnHead.of(HEAD, HEAD.mean, (part,)), camera, 1.0, pieces=pieces)
    return seen.resolved(np.zeros((len(seen.index), 3), np.float32))[1]


def hair(columns: list[int], **options: object) -> Material:
    """Hair whose texture has columns of these opacities."""
    pixels = np.full((64, len(columns), 4), 90, np.uint8)
    pixels[..., 3] = columns
    look = {"alpha": "mask", "cutoff": 0.35, "double_sided": True, "anisotropy": 0.75} | options
    return Material("hair", colour_map=OwnMap("hair", pixels), **look)  # type: ignore[arg-type]


@pytest.mark.parametrize("turn", [0.0, 3.0, 20.0, 45.0, 77.0])
def test_a_slanted_edge_covers_its_share_of_each_pixel(turn: float) -> None:
    wide = ribbon((6.3 * PIXEL_M, 1.0), turn, Material("solid", double_sided=True))
    fine = (np.arange(SIDE * 32) + 0.5) / 32 - SIDE / 2
    x, y = np.meshgrid(fine, -fine)
    angle = np.radians(turn)
    inside = np.abs(x * np.cos(angle) + y * np.sin(angle)) < 6.3
    wanted = inside.reshape(SIDE, 32, SIDE, 32).mean((1, 3))
    made = coverage(wide, pieces=3)
    assert np.abs(made - wanted).max() < 0.25
    assert np.abs(made - wanted).mean() < 0.02
    assert np.abs(coverage(wide) - wanted).mean() > 2 * np.abs(made - wanted).mean(), "one sample makes stairs"
    assert made.mean() == pytest.approx(wanted.mean(), rel=0.02)


def test_what_lies_behind_an_edge_shows_beside_it() -> None:
    """A piece of a sample hides what is behind that piece alone."""
    front = ribbon((0.01, 1.0), 20.0, Material("solid", double_sided=True))
    sheet = replace(ribbon((1.0, 1.0), 0.0, hair([255] * 4)), name="behind")
    behind = replace(sheet, vertices=sheet.vertices - np.array([0, 0, 0.1], np.float32))
    seen = see(DrawnHead.of(HEAD, HEAD.mean, (front, behind)), CAMERA, 1.0, pieces=3)
    for one in seen.parts:
        one.radiance[:] = one.part.name == "behind"
    light, covered = seen.resolved(np.zeros((len(seen.index), 3), np.float32))
    np.testing.assert_allclose(covered, 1, atol=1e-5)
    np.testing.assert_allclose(light[..., 0], 1 - coverage(front, pieces=3), atol=1e-5)


@pytest.mark.parametrize("alpha", ["mask", "blend"])
def test_strands_finer_than_a_pixel_cover_their_share(alpha: str) -> None:
    """Every second of eight columns in a pixel is a strand: read one by one they are dots."""
    part = ribbon((16 * PIXEL_M, 1.0), 7.0, hair([255, 0] * 128, alpha=alpha))
    made = coverage(part)[:, 10:30]
    np.testing.assert_allclose(made, 0.5, atol=0.03)


def test_a_ribbon_narrower_than_a_pixel_is_a_faint_line() -> None:
    """And no dots: with a third of a pixel's width it was missing in two of three rows."""
    for turn in (2.0, 31.0, 60.0):
        made = coverage(ribbon((0.15 * PIXEL_M, 1.0), turn, hair([255] * 4), rows=90))
        axis = 0 if turn > 45 else 1
        each = made.sum(axis)[5:-5]
        across = 0.3 / max(np.cos(np.radians(turn)), np.sin(np.radians(turn)))
        assert (each > 0).mean() > 0.9, turn
        assert each.mean() == pytest.approx(across, rel=0.25), turn


def test_triangles_that_are_wide_stay_as_they_are() -> None:
    flat = np.array([[0.0, 0], [4, 0], [0, 3], [4, 0.25]])
    triangles = np.array([[0, 1, 2], [0, 1, 3]], np.int32)
    corners, made, was, share = widened(flat, triangles)
    assert np.array_equal(made[0], triangles[0]) and share[0] == 1
    assert share[1] == pytest.approx(0.25, rel=0.01)
    assert len(corners) == 5 and was[4] in triangles[1]
    a, b, c = corners[made[1]]
    longest = max(np.linalg.norm(p - q) for p, q in ((a, b), (b, c), (c, a)))
    area = 0.5 * abs((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0])
    assert 2 * area / longest > 0.9


def test_a_texture_near_by_is_read_texel_by_texel() -> None:
    material = hair([255, 255, 0, 0])
    assert isinstance(material.colour_map, OwnMap) and EDGE < 0.3
    texture = StrandTexture.of(material.colour_map, material)
    at = np.array([[0.125, 0.5], [0.875, 0.5]], np.float32)
    assert texture.read(at, np.zeros(2, np.int64))[:, 3].tolist() == [1, 0]
    np.testing.assert_allclose(texture.read(at, np.full(2, 2))[:, 3], 0.5, atol=0.01)


def test_hair_has_a_highlight_where_it_turns_to_the_lamp() -> None:
    """An arc from the top down to the front, under a lamp above the camera: it was as bright all along."""
    part = ribbon((8 * PIXEL_M, 0.04), 0.0, hair([255] * 4), rows=30)
    angle = part.uv[:, 1] * np.pi / 2
    points = part.vertices.copy()
    points[:, 1], points[:, 2] = 0.04 * np.sin(angle), 0.04 * np.cos(angle)
    normals = np.column_stack([np.zeros(len(angle)), np.sin(angle), np.cos(angle)]).astype(np.float32)
    bent = replace(part, vertices=points, neutral=points, normals=normals)
    seen = see(DrawnHead.of(HEAD, HEAD.mean, (bent,)), CAMERA, 1.0)
    light = sketch(seen, np.zeros((len(seen.index), 3), np.float32))[0][:, SIDE // 2, 0]
    shown = light[light > 0]
    assert np.isfinite(light).all()
    assert 0 < shown.argmax() < len(shown) - 1
    assert shown.max() > 1.1 * shown[-3]


@pytest.mark.parametrize("slope", [0.25, 0.5])
def test_an_outline_of_hard_steps_becomes_its_own_slant(slope: float) -> None:
    """And nothing else does: a strand of two pixels, what is blended, and the colour stay."""
    fine = (np.arange(60 * 8) + 0.5) / 8 - 30
    inside = fine[None] > slope * fine[:, None]
    exact = inside.reshape(60, 8, 60, 8).mean((1, 3))
    hard = (exact > 0.5).astype(np.float32)
    light, cover = outlined(np.dstack([0.3 * hard] * 3), hard)
    middle = (slice(5, -5),) * 2
    assert np.abs(cover - exact)[middle].sum() < 0.4 * np.abs(hard - exact)[middle].sum()
    np.testing.assert_allclose(light[..., 0], 0.3 * cover, atol=1e-6)
    for kept in (np.pad(np.ones((60, 2), np.float32), ((0, 0), (29, 29))), np.full((60, 60), 0.5, np.float32)):
        np.testing.assert_array_equal(outlined(np.dstack([kept] * 3), kept)[1], kept)
