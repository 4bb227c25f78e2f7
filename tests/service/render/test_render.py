"""What has to hold for every picture, whatever the light."""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from service.archive.rendering import MOST_POLYGONS, smoothed
from service.errors import BadArchive, UsageError
from service.light.scene import Environment, PointLight, Softbox
from service.render.render import NO_RELIEF, RenderedPicture
from tests.service.render.toys import EVEN, HEAD, LAMP, albedo, flat_normals, scene, stored, toy_picture
from tests.toyhead import CENTRE, RADIUS

BOX = Softbox((0.6, 0.3, 1.0), (3.0, 2.5, 2.0), 30.0)
SKY = Environment(zenith=(0.3, 0.4, 0.6), horizon=(0.3,) * 3, ground=(0.1,) * 3, softboxes=(BOX,))


@lru_cache(maxsize=1)
def usual() -> RenderedPicture:
    return toy_picture(scene(SKY, LAMP), tolerance=0.0)


def test_twice_the_light_is_twice_the_radiance() -> None:
    red, green, blue = LAMP.intensity
    brighter = dataclasses.replace(LAMP, intensity=(2.0 * red, 2.0 * green, 2.0 * blue))
    double = toy_picture(scene(dataclasses.replace(SKY, strength=2.0), brighter), tolerance=0.0)
    assert usual().light.max() > 0.1
    np.testing.assert_allclose(double.light, 2.0 * usual().light, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("code", [0, 255])
def test_a_white_furnace_gains_nothing(code: int) -> None:
    """In even light of 1 nothing sends out more than 1; what is white all over sends nearly that."""
    picture = toy_picture(scene(EVEN), albedo(code), tolerance=0.0)
    assert (picture.light <= 1.02 * picture.covered[..., None]).all()
    typical = float(np.median(picture.light[picture.covered == 1.0]))
    assert typical > 0.9 if code == 255 else typical < 0.2  # the mirror alone


def test_a_lambert_surface_under_one_lamp() -> None:
    """By hand, in the middle of the picture, where the sphere faces the camera and no highlight falls."""
    lamp = PointLight((1.2, 0.0, 1.2), (3.0, 3.0, 3.0))
    black = {**albedo(188), "specular_albedo": stored("specular_albedo", np.zeros((16, 24), np.uint8))}
    picture = toy_picture(scene(None, lamp), black, size=(64, 64), tolerance=0.0)
    towards = np.array([1.2, 0.0, 1.2 - 0.01])
    cosine = towards[2] / np.linalg.norm(towards)
    reflected = ((188 / 255 + 0.055) / 1.055) ** 2.4 / np.pi * 3.0 / (towards @ towards) * cosine
    found = picture.light[22:24, 31:33].mean()  # above the boards that stick out of the toy
    assert found == pytest.approx(reflected, rel=0.12)


@pytest.mark.parametrize("code", [(128, 128, 128), (255, 128, 128), (0, 0, 0), (128, 128, 255)])
@pytest.mark.parametrize("frame", ["tangent", "object"])
def test_normals_without_direction_or_at_the_horizon_stay_finite(code: tuple[int, ...], frame: str) -> None:
    maps = albedo()
    image = np.full((16, 24, 3), code, np.uint8)
    image[::2] = flat_normals()[::2]  # neighbours that disagree: means of no length
    maps |= {role: stored(role, image, frame=frame) for role in ("specular_normal", "diffuse_normal")}
    light = toy_picture(scene(SKY, LAMP), maps, size=(24, 28)).light
    assert np.isfinite(light).all()
    assert light.max() > 0


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0101), (0.0, 0.0, -0.08), (0.0, 0.02, 0.03), (0.0, 0.0, 1000.0)])
@pytest.mark.parametrize("radius", [0.0, 0.2])
def test_lamps_on_in_and_far_from_the_head_stay_finite(place: tuple[float, float, float], radius: float) -> None:
    """On the skin there is no direction to the lamp, in the head all is hidden, far away depth has few digits."""
    strength = 1e6 if place[2] == 1000.0 else 0.01
    picture = toy_picture(scene(None, PointLight(place, (strength,) * 3, radius)), size=(24, 28), tolerance=0.0)
    assert np.isfinite(picture.light).all()
    if place[2] == 1000.0:
        assert picture.light.max() > 0.05


def test_turning_head_light_and_camera_together_changes_nothing() -> None:
    """A quarter turn about the vertical; directions of the sky fall elsewhere, so the rest is sampling."""
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # +Z becomes +X
    x, y, z = LAMP.position_m
    there = scene(dataclasses.replace(SKY, rotation_deg=90.0), dataclasses.replace(LAMP, position_m=(z, y, -x)))
    turned = toy_picture(
        dataclasses.replace(there, viewpoints=((1.2, 0.0, 0.0),)), vertices=HEAD.mean @ turn.T.astype(np.float32),
        tolerance=0.0,
    )  # fmt: skip
    difference = np.abs(turned.pixels.astype(int) - usual().pixels.astype(int))
    assert difference.mean() < 0.5
    assert np.quantile(difference, 0.99) <= 8


def test_the_skin_is_drawn_smooth_and_other_parts_keep_their_size() -> None:
    fine, vertices = smoothed(HEAD, HEAD.mean)
    assert len(fine.polygons) > 3 * len(HEAD.polygons)
    for part, name in enumerate(HEAD.part_names):
        before, after = (np.unique(head.triangles[head.triangle_part == part]) for head in (HEAD, fine))
        if len(before):
            extent = [np.ptp(v[used], 0) for v, used in ((HEAD.mean, before), (vertices, after))]
            if name == "skin":
                assert (extent[1] < extent[0]).all()
            else:
                np.testing.assert_allclose(extent[1], extent[0], atol=1e-7)
    ring = np.linalg.norm(vertices[fine.triangles[fine.triangle_part == 0]] - CENTRE, axis=-1)
    assert ring.max() < 1.001 * RADIUS
    assert smoothed(fine, vertices)[0] is not fine
    huge = dataclasses.replace(HEAD, polygons=np.zeros((MOST_POLYGONS + 1, 4), np.int32))
    assert smoothed(huge, HEAD.mean)[0] is huge


def test_a_plan_leaves_out_what_costs_little_and_keeps_its_word() -> None:
    made = toy_picture(scene(SKY, LAMP), tolerance=1.0)
    left_out = [d for d in made.plan.decisions if not d.runs]
    assert left_out
    difference = np.abs(made.pixels.astype(float) - usual().pixels.astype(float))
    assert difference[usual().covered > 0].mean() <= made.plan.bound + 0.1
    assert set(made.facts()["effects"]) < set(usual().facts()["effects"]) | {"x"}


def test_tiles_of_scattering_are_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small tiles, so that there are some; what lies beyond the halo is worth less than a code of the picture."""
    monkeypatch.setattr("service.render.shade.TILE", 64)
    maps = {
        "diffuse_albedo": stored("diffuse_albedo", np.random.default_rng(4).integers(0, 256, (64, 96, 3), np.uint8))
    }
    options: dict[str, Any] = {"size": (96, 112), "samples": 2, "tolerance": 0.0}
    tiled = toy_picture(scene(None, LAMP), maps, **options)
    monkeypatch.setattr("service.render.shade.TILE", 4096)
    whole = toy_picture(scene(None, LAMP), maps, **options)
    assert whole.plan.runs("scattering")
    assert whole.chart[0] > 64
    np.testing.assert_allclose(tiled.light, whole.light, atol=2e-3 * whole.light.max())


def test_what_is_missing_is_said_or_refused() -> None:
    assert set(usual().fallbacks) == {
        "diffuse_normal-from-mesh", "specular_normal-from-mesh", "specular_albedo-constant", NO_RELIEF,
    }  # fmt: skip
    with pytest.raises(BadArchive, match="diffuse_albedo"):
        toy_picture(scene(EVEN), {})
    texture = {"texture": dataclasses.replace(albedo()["diffuse_albedo"], changed=True)}
    assert {"diffuse_albedo-from-texture", "texture-changed"} <= set(toy_picture(scene(EVEN), texture).fallbacks)
    several = dataclasses.replace(scene(EVEN), viewpoints=((0.0, 0.0, 1.2), (0.5, 0.0, 1.0)))
    assert "viewpoints-but-first-ignored" in toy_picture(several).fallbacks


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"size": (8, 100)}, "size"),
        ({"size": (4096, 4096), "samples": 2}, "size"),
        ({"samples": 4}, "samples"),
        ({"background": "pink"}, "background"),
        ({"tolerance": float("nan")}, "tolerance"),
        ({"view": "sideways"}, "view"),
        ({"view": "nan"}, "view"),
    ],
)
def test_requests_that_are_not_possible_are_refused_by_name(options: dict[str, Any], field: str) -> None:
    with pytest.raises(UsageError) as refused:
        toy_picture(scene(EVEN), **options)
    assert refused.value.extra["field"] == field


def test_a_viewpoint_in_the_head_is_refused() -> None:
    with pytest.raises(UsageError, match="viewpoint"):
        toy_picture(dataclasses.replace(scene(EVEN), viewpoints=((0.0, 0.0, 0.0),)))


def test_views_go_around_the_head() -> None:
    front = toy_picture(scene(EVEN), view="front").camera.centre
    left = toy_picture(scene(EVEN), view="left").camera.centre
    assert front[2] == pytest.approx(1.2)
    assert left[0] == pytest.approx(1.2)
    np.testing.assert_allclose(toy_picture(scene(EVEN), view="-90").camera.centre, left * [-1, 1, 1], atol=1e-9)


def test_backgrounds() -> None:
    clear = toy_picture(scene(EVEN), background="transparent").pixels
    assert clear.shape[2] == 4
    assert clear[0, 0, 3] == 0 and clear[28, 24, 3] == 255
    sky = toy_picture(scene(EVEN), background="environment").pixels
    assert (sky[0, 0] == 255).all()
    assert not usual().pixels[0, 0].any()
