"""Scenes as JSON, environments, directions, harmonics, and the light on skin."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from service.errors import UsageError
from service.geometry.mesh import normalise
from service.light import environment, formulas
from service.light.environment import (
    flux_by_direction,
    pixel_directions,
    pixel_solid_angles,
    spread_directions,
)
from service.light.formulas import BAND_GAIN, estimate_light, gradient, sh_basis
from service.light.scene import Environment, PointLight, Scene, Softbox
from service.render.request import RenderRequest

RNG = np.random.default_rng(5)


def sphere(n: int) -> np.ndarray:
    v = RNG.normal(size=(n, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def test_irradiance_of_a_smooth_sky_agrees_with_monte_carlo() -> None:
    """E(n) / pi of a band-limited environment, integrated by brute force: a wrong constant in any band shows."""
    light = RNG.normal(size=(9, 3)) * 0.1
    light[0] = 2.0
    directions = sphere(400_000)
    radiance = (sh_basis(directions) / np.array([1.0, *[2 / 3] * 3, *[1 / 4] * 5])) @ light
    for n in sphere(5):
        cosine = np.maximum(directions @ n, 0)
        irradiance = 4 * np.pi * (radiance * cosine[:, None]).mean(0)
        np.testing.assert_allclose(sh_basis(n[None])[0] @ light, irradiance / np.pi, rtol=0.02)


def test_recovers_light_in_spite_of_outliers() -> None:
    normals = sphere(3000)
    normals = normals[normals[:, 2] > 0.2]
    truth = np.zeros((9, 3))
    truth[0], truth[2], truth[3] = 2.5, 0.8, [0.5, 0.4, 0.3]
    colours = sh_basis(normals) @ truth * 0.4
    colours[: len(colours) // 10] *= 0.1
    found = estimate_light(normals, colours, np.ones(len(normals)))
    assert found is not None
    expected = sh_basis(normals) @ truth
    got = sh_basis(normals) @ found
    factor = (expected * got).sum() / (got**2).sum()
    assert np.abs(factor * got - expected).mean() < 0.05 * expected.mean()


@pytest.mark.parametrize("colour", [0.0, np.nan])
def test_black_or_broken_skin_has_no_light(colour: float) -> None:
    """Dividing by the mean of a black face would give infinite light."""
    assert estimate_light(sphere(500), np.full((500, 3), colour), np.ones(500)) is None


def test_one_normal_only_stays_finite() -> None:
    """All normals equal: the normal equations have rank one."""
    light = estimate_light(np.tile([0.0, 0, 1], (200, 1)), np.full((200, 3), 0.4), np.ones(200))
    assert light is not None and np.isfinite(light).all()


def test_gradient_of_spherical_harmonics() -> None:
    random = np.random.default_rng(9)
    n = normalise(random.normal(size=(20, 3)))
    light = random.normal(size=9)
    numeric = [((sh_basis(n + e) - sh_basis(n - e)) @ light) / 2e-6 for e in np.eye(3) * 1e-6]
    np.testing.assert_allclose(gradient(n, BAND_GAIN * light), np.stack(numeric, 1), atol=1e-6)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[", "JSON"),
        ("[]", "object"),
        ('{"lamps": []}', "lamps"),
        ('{"lights": [{"position_m": [0, 0], "intensity": [1, 1, 1]}]}', "position_m"),
        ('{"lights": [{"position_m": [0, 0, 1], "intensity": [1, 1, -1]}]}', "intensity"),
        ('{"lights": [{"position_m": [0, 0, 1], "intensity": [1, 1, NaN]}]}', "intensity"),
        ('{"lights": [{"intensity": [1, 1, 1]}]}', "position_m"),
        ('{"lights": 3}', "lights"),
        ('{"viewpoints": []}', "viewpoints"),
        ('{"response": {"gamma": true}}', "gamma"),
        ('{"environment": {"strength": -1}}', "strength"),
        ('{"environment": {"softboxes": [{"direction": [0, 0, 0], "radiance": [1, 1, 1]}]}}', "direction"),
    ],
)
def test_bad_scenes_are_refused_by_name(text: str, named: str) -> None:
    with pytest.raises(UsageError, match=named):
        Scene.from_json(text)


@pytest.mark.parametrize(("scene", "place", "kind"), [
    ({"ligths": []}, "ligths", Scene),
    ({"environment": {"nam": "studio"}}, "environment/nam", Environment),
    ({"environment": {"softboxes": [{"directon": [0, 1, 0], "radiance": [1, 1, 1]}]}},
     "environment/softboxes/0/directon", Softbox),
    ({"lights": [{"position_m": [0, 0, 1], "intensity": [1, 1, 1], "radius": 1}]}, "lights/0/radius", PointLight),
])  # fmt: skip
def test_a_name_that_does_not_exist_is_answered_with_those_that_do(
    scene: dict[str, object], place: str, kind: type
) -> None:
    names = ", ".join(field.name for field in dataclasses.fields(kind))
    with pytest.raises(UsageError, match=f"scene: there is no {place}; there are {names}$") as refusal:
        Scene.from_json(json.dumps(scene))
    assert refusal.value.extra == {"field": place}
    with pytest.raises(UsageError, match=f"there is no scene/{place}; there are {names}$"):
        RenderRequest(scene=scene)  # type: ignore[arg-type]


def test_spread_directions_integrate_a_cosine() -> None:
    d = spread_directions(256)
    for n in np.eye(3):
        assert np.maximum(d @ n, 0).sum() * 4 * np.pi / 256 == pytest.approx(np.pi, rel=5e-3)


def test_harmonics_give_the_irradiance_of_smooth_light() -> None:
    """Independent reference: the cosine integral over the pixels of a sky of degree one."""
    directions = pixel_directions(64, 128)
    sky = np.repeat((1.0 + 0.5 * directions[..., 1] + 0.3 * directions[..., 0])[..., None], 3, -1)
    normals = spread_directions(20)
    cosine = np.maximum(np.einsum("hwx,nx->nhw", directions, normals), 0.0) * pixel_solid_angles(64, 128)
    wanted = np.einsum("nhw,hwc->nc", cosine, sky)
    np.testing.assert_allclose(formulas.irradiance(formulas.project(sky), normals), wanted, rtol=5e-3)
    basis = formulas.basis(directions) * np.sqrt(pixel_solid_angles(64, 128))[..., None]
    gram = np.einsum("hwi,hwj->ij", basis, basis)
    np.testing.assert_allclose(gram, np.eye(9), atol=5e-3)


def test_a_sun_is_taken_out_with_its_light() -> None:
    image = np.full((64, 128, 3), 0.5)
    image[20, 70] += 500.0
    sky, suns = environment.without_suns(image)
    assert len(suns) == 1
    towards = np.asarray(suns[0].position_m) / 100.0
    assert towards @ pixel_directions(64, 128)[20, 70] > 0.9999
    flux = 500.0 * pixel_solid_angles(64, 128)[20, 70]
    assert np.asarray(suns[0].intensity) / 100.0**2 == pytest.approx(flux, rel=1e-6)
    np.testing.assert_allclose(sky, 0.5)
    assert environment.without_suns(np.full((64, 128, 3), 0.5))[1] == ()
    assert environment.without_suns(np.zeros((64, 128, 3)))[1] == ()


def test_unknown_environments_are_refused() -> None:
    with pytest.raises(UsageError, match="studio"):
        environment.radiance(Environment(name="nowhere"))


def test_flux_keeps_all_light() -> None:
    image = np.random.default_rng(0).uniform(0, 3, (64, 128, 3))
    total = (image * pixel_solid_angles(64, 128)[..., None]).sum((0, 1))
    np.testing.assert_allclose(flux_by_direction(image, 256).sum(0), total, rtol=1e-5)
