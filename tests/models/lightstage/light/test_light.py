"""Closed forms and hard cases of the baked light."""

from __future__ import annotations

import dataclasses
import math
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from tests.toyhead import sphere_head as toy_head

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")

from models.lightstage.light import scatter  # noqa: E402
from models.lightstage.light.bake import bake, footprint, radiance  # noqa: E402
from models.lightstage.light.expose import expose  # noqa: E402
from models.lightstage.light.geometry import Geometry  # noqa: E402
from models.lightstage.light.lobes import directional_albedo, fresnel, ggx  # noqa: E402
from models.lightstage.light.plain import PlainSkin  # noqa: E402
from models.lightstage.light.prior import sample_scene  # noqa: E402
from models.lightstage.light.relief import relief_shadow  # noqa: E402
from models.lightstage.light.response import developed  # noqa: E402
from models.lightstage.light.survey import survey  # noqa: E402
from models.lightstage.skin.window import ChartWindow  # noqa: E402
from service.light.environment import illumination  # noqa: E402
from service.light.plan import LightPlan, plan  # noqa: E402
from service.light.scene import Environment, PointLight, Response, Scene  # noqa: E402
from service.light.shading import Shading, develop  # noqa: E402

pytestmark = pytest.mark.train

WHOLE = ChartWindow.whole(96, 64)
EVEN = Environment(zenith=(1.0,) * 3, horizon=(1.0,) * 3, ground=(1.0,) * 3)
VIEW = ((0.0, 0.0, 1.2),)


@lru_cache(maxsize=1)
def geometry() -> Geometry:
    head = toy_head()
    return Geometry.of(head, head.mean, size=(96, 64), sky_size=(96, 64), casters_mm=(3.0, 3.0))


def skin(**changes: object) -> PlainSkin:
    return PlainSkin.even(WHOLE, **changes)  # type: ignore[arg-type]


def front() -> Any:
    """(h, w) skin texels that face the camera, away from the eyeballs, which stick out of the toy's sphere."""
    site = geometry().site(WHOLE)
    return (site.normal[2] > 0.3) & (geometry().mask[0] > 0.5) & (site.position[1].abs() > 45.0)


def light_of(scene: Scene, maps: PlainSkin, chosen: LightPlan | None = None) -> Any:
    return radiance(maps, geometry(), scene, chosen or LightPlan.everything(scene), WHOLE)[0][0]


@pytest.mark.parametrize("alpha", [0.05, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("cosine", [0.02, 0.3, 1.0])
def test_the_lobe_sends_what_its_table_says_and_never_more_than_all(alpha: float, cosine: float) -> None:
    """Independent quadrature of f n.l over the hemisphere of lights, fine around the mirror direction."""
    n = 1200
    theta = (torch.arange(n, dtype=torch.float64) + 0.5) / n * (math.pi / 2)
    phi = (torch.arange(n, dtype=torch.float64) + 0.5) / n * math.pi
    t, p = torch.meshgrid(theta, phi, indexing="ij")
    light = torch.stack([-t.sin() * p.cos(), t.sin() * p.sin(), t.cos()])
    view = torch.tensor([math.sqrt(1 - cosine**2), 0.0, cosine], dtype=torch.float64).view(3, 1, 1)
    half = light + view
    half = half / half.norm(dim=0)
    value = ggx(torch.tensor(alpha, dtype=torch.float64), 1.0 - half[2] ** 2, light[2], view[2])
    cell = t.sin() * (math.pi / 2 / n) * (math.pi / n) * 2.0
    for f0 in (0.0278, 1.0):
        shine = fresnel(torch.tensor(f0, dtype=torch.float64), (half * view).sum(0))
        wanted = float((value * shine * light[2] * cell).sum())
        one = torch.tensor([cosine])
        made = float(directional_albedo(torch.full((1,), f0), torch.full((1,), alpha), one))
        assert made <= 1.0
        assert wanted <= 1.02
        if cosine >= 0.3:  # the table ends at cosine 1/64
            assert made == pytest.approx(wanted, abs=0.02)


@pytest.mark.parametrize("albedo", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_white_furnace_gains_nothing(albedo: float, dtype: Any) -> None:
    scene = Scene(EVEN, viewpoints=VIEW, response=Response(exposure=1.0))
    maps, everything = skin(albedo=(albedo,) * 3, specular=1.0, dtype=dtype), LightPlan.everything(scene)
    seen = radiance(maps, geometry(), scene, everything, WHOLE, dtype=dtype)[0][0].float()[:, front()]
    assert seen.max() <= (1.01 if dtype == torch.float32 else 1.02)
    if albedo == 1.0:
        assert seen.min() > 0.9  # and a white convex body loses next to nothing
    if albedo == 0.0:
        assert seen.max() < 0.35  # the mirror alone, strongest at a slant


def test_lambert_under_one_lamp() -> None:
    """Albedo / pi * intensity * cos / d^2, by hand, where nothing is in the way."""
    lamp = PointLight((0.0, 0.0, 2.0), (3.0, 2.0, 1.0))
    scene = Scene(Environment(), (lamp,), VIEW, Response(exposure=1.0))
    chosen = LightPlan.everything(scene).without("specular", 0).without("scattering")
    seen = light_of(scene, skin(specular=0.0), chosen)
    site = geometry().site(WHOLE)
    offset = torch.tensor([0.0, 0.0, 2.0]).view(3, 1, 1) - site.position / 1000.0
    d = offset.norm(dim=0)
    wanted = 0.6 / math.pi * 3.0 * (offset * site.normal).sum(0) / d**3
    inside = front() & (site.normal[2] > 0.6)
    torch.testing.assert_close(seen[0][inside], wanted[inside], rtol=0.02, atol=1e-4)


HARD = {
    "light on the skin": Scene(Environment(), (PointLight((0.0, 0.0, 0.01), (1e-4,) * 3),), VIEW),
    "light inside the head": Scene(Environment(), (PointLight((0.0, 0.0, -0.08), (1.0,) * 3, 0.01),), VIEW),
    "light at a grazing angle": Scene(Environment(), (PointLight((5.0, 0.0, -0.05), (1.0,) * 3),), VIEW),
    "point": Scene(EVEN, (PointLight((0.3, 0.3, 0.7), (1.0,) * 3, 0.0),), VIEW),
    "huge ball": Scene(EVEN, (PointLight((0.3, 0.3, 0.7), (1.0,) * 3, 50.0),), VIEW),
    "blinding sky": Scene(dataclasses.replace(EVEN, strength=1e4), (), VIEW),
    "blinding lamp": Scene(Environment(), (PointLight((0.3, 0.3, 0.7), (1e8,) * 3),), VIEW),
    "complete darkness": Scene(Environment(), (), VIEW),
    "dark lamp": Scene(Environment(), (PointLight((0.0, 0.0, 1.0), (0.0,) * 3),), VIEW),
    "grazing view": Scene(EVEN, (), ((1.0, 0.0, -0.08),)),
    "view from within": Scene(EVEN, (), ((0.0, 0.0, -0.08),)),
    "view on the skin": Scene(EVEN, (PointLight((0.0, 0.0, 0.5), (1.0,) * 3),), ((0.0, 0.0, 0.01),)),
}


@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_hard_scenes_stay_finite_and_positive(name: str, dtype: Any) -> None:
    scene = HARD[name].exposed(1.0)
    maps = PlainSkin.even(WHOLE, alpha=(0.02, 1.0), share=0.5, dtype=dtype)
    everything = LightPlan.everything(scene)
    for light, weight in radiance(maps, geometry(), scene, everything, WHOLE, dtype=dtype):
        assert light.isfinite().all()
        assert light.min() >= 0.0
        assert weight.isfinite().all()
    image = bake(maps, geometry(), scene, everything, WHOLE, dtype=dtype)
    assert image.dtype == dtype
    assert image.isfinite().all()
    assert 0.0 <= float(image.min()) <= float(image.max()) <= 1.0
    made = plan(scene, survey(maps, geometry(), WHOLE, count=64))
    assert np.isfinite([d.bound for d in made.decisions]).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_normals_of_no_length_or_all_alike_do_no_harm(dtype: Any) -> None:
    scene = HARD["point"].exposed(1.0)
    for vector in ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (float("nan"), 0.0, 0.0)):
        bad = torch.tensor(vector, dtype=dtype).view(3, 1, 1).expand(3, 64, 96)
        maps = dataclasses.replace(skin(dtype=dtype), specular_normal=bad, diffuse_normal=bad)
        image = bake(maps, geometry(), scene, LightPlan.everything(scene), WHOLE, dtype=dtype)
        assert image.isfinite().all()
        assert image.min() >= 0.0


def test_a_half_lit_plane_scatters_as_the_sum_of_error_functions() -> None:
    """Closed form: sum of weights times Phi(x / sigma) behind a straight edge; 6 texels per mm."""
    ppm, width = 6.0, 320
    x = (torch.arange(width) + 0.5 - width / 2) / ppm
    step = (x > 0).float().expand(3, 64, width)
    density = torch.full((64, width), ppm)
    made = scatter.scattered(step, density, torch.ones(64, width), ppm)[:, 32]
    for c in range(3):
        wanted = sum(w[c] * 0.5 * (1.0 + torch.erf(x / math.sqrt(2.0 * v))) for v, w in scatter.PROFILE)
        middle = slice(60, width - 60)
        assert (made[c] - wanted)[middle].abs().mean() < 0.004
        beyond = middle_of(x, 0.4)  # nearer to the edge a texel is as wide as the narrowest Gaussian
        assert (made[c] - wanted)[beyond].abs().max() < 0.02


def middle_of(x: Any, from_edge: float) -> Any:
    return (x.abs() > from_edge) & (x.abs() < 15.0)


def test_even_light_scatters_to_itself_and_stays_on_the_skin() -> None:
    mask = torch.zeros(96, 96)
    mask[20:70, 20:70] = 1.0
    density = torch.linspace(0.3, 8.0, 96).expand(96, 96)
    made = scatter.scattered(torch.full((3, 96, 96), 0.7), density, mask, 8.0)
    torch.testing.assert_close(made[:, mask > 0], torch.full((3, int(mask.sum())), 0.7), rtol=1e-4, atol=1e-4)
    outside = torch.where(mask > 0, 0.0, 5.0).expand(3, 96, 96)
    assert scatter.scattered(outside, density, mask, 8.0)[:, mask > 0].max() == 0.0
    np.testing.assert_allclose(np.sum([w for _, w in scatter.PROFILE], 0), 1.0, atol=1e-6)


def test_a_pit_is_in_the_shade_of_a_low_light() -> None:
    window = ChartWindow.whole(96, 64)
    site = geometry().site(window)
    pitch = 1.0 / float(site.step[0, 0][32, 48])
    height = torch.zeros(1, 64, 96)
    height[0, :, 50:] = 3.0 * pitch if pitch < 1 else 1.0
    site = dataclasses.replace(site, step=torch.tensor([[8.0, 0.0], [0.0, 8.0]]).view(2, 2, 1, 1).expand(2, 2, 64, 96))
    low = torch.tensor([0.95, 0.0, 0.31]).view(3, 1, 1).expand(3, 64, 96)
    high = torch.tensor([0.0, 0.0, 1.0]).view(3, 1, 1).expand(3, 64, 96)
    assert relief_shadow(height, low, site)[32, 48] < 0.05
    assert relief_shadow(height, low, site)[32, 60] == 1.0
    assert relief_shadow(height, high, site).min() == 1.0
    assert relief_shadow(height, -low, site)[32, 60] < 0.05  # a light below the horizon


def test_a_crop_is_the_same_as_the_whole() -> None:
    big = ChartWindow.whole(384, 256)
    scene = Scene(EVEN, (PointLight((0.3, 0.3, 0.7), (1.0,) * 3),), VIEW, Response(exposure=0.5))
    everything = LightPlan.everything(scene)
    noise = torch.rand(1, 512, 640, generator=torch.Generator().manual_seed(1))

    def maps(window: ChartWindow) -> PlainSkin:
        plain = PlainSkin.even(window)
        part = noise[:, window.y + 128 : window.y + 128 + window.height, window.x + 128 : window.x + 128 + window.width]
        return dataclasses.replace(plain, diffuse_albedo=plain.diffuse_albedo * part, height_mm=0.1 * part)

    crop = ChartWindow(150, 90, 64, 48, 384, 256)
    outer, whole_outer = (footprint(w, geometry(), everything) for w in (crop, big))
    assert outer.x <= crop.x - 2
    part = bake(maps(outer), geometry(), scene, everything, crop, maps_window=outer)
    whole = bake(maps(whole_outer), geometry(), scene, everything, big, maps_window=whole_outer)
    torch.testing.assert_close(part, crop.cut(whole, big), rtol=0, atol=2e-4)
    again = bake(maps(outer), geometry(), scene, everything, crop, maps_window=outer)
    assert torch.equal(part, again)


def test_the_response_is_monotone_and_the_same_in_both_places() -> None:
    """The planner has its own copy in numpy; the two must agree."""
    response = Response(exposure=1.3, white_balance=(1.1, 1.0, 0.9), shoulder=0.3, gamma=0.95)
    light = torch.linspace(0, 4, 999).expand(3, 999)
    made = developed(light, response)
    assert made.diff().min() >= 0.0
    np.testing.assert_allclose(made.numpy().T, develop(light.numpy().T.astype(float), response), atol=1e-5)


def test_the_planner_shades_each_point_as_the_camera_does() -> None:
    """Texel by texel, with and without each effect that needs no shadow; would break: one of two formulas changed."""
    scene = expose(skin(), geometry(), Scene(EVEN, (PointLight((0.2, 0.3, 1.5), (2.0,) * 3, 0.1),), VIEW), WHOLE)
    everything = LightPlan.everything(scene).without("shadows", 0).without("scattering")
    base: set[Any] = {("shadows", 0), ("scattering", None)}
    places = torch.stack(torch.meshgrid(torch.arange(64.0), torch.arange(96.0), indexing="ij"))
    where = survey(
        dataclasses.replace(skin(), diffuse_albedo=torch.cat([places / 128, 0 * places[:1]])), geometry(), WHOLE
    )
    row, column = (np.rint(where.albedo[0, :, i] * 128).astype(int) for i in (0, 1))
    shaded = Shading(scene, survey(skin(), geometry(), WHOLE), illumination(scene))
    for effect in (None, "reflection", "fresnel", "specular", "second_lobe"):
        light = 0 if effect == "specular" else None
        chosen = everything.without(effect, light) if effect else everything
        image = bake(skin(), geometry(), scene, chosen, WHOLE).numpy()[:, row, column].T
        made = shaded.picture({*base, (effect, light)} if effect else base)[0]
        assert np.abs(made - image).mean() * 255 < 1.0, effect


@pytest.mark.parametrize("seed", range(6))
def test_planned_stays_within_the_stated_bound(seed: int) -> None:
    scene = expose(skin(), geometry(), sample_scene(seed), WHOLE)
    chosen = plan(scene, survey(skin(), geometry(), WHOLE))
    whole = bake(skin(), geometry(), scene, LightPlan.everything(scene), WHOLE)
    planned = bake(skin(), geometry(), scene, chosen, WHOLE)
    face = geometry().face[0] > 0.5
    assert float((whole - planned).abs()[:, face].mean()) * 255 <= chosen.bound + 1e-3


def test_a_triangle_without_area_on_the_chart_does_no_harm() -> None:
    head = toy_head()
    uv = head.uv.copy()
    a, b, _ = head.triangle_uv[10]
    uv[b] = uv[a]
    head = dataclasses.replace(head, uv=uv)
    broken = Geometry.of(head, head.mean, size=(96, 64), sky_size=(48, 32), directions=32, casters_mm=(6.0, 6.0))
    scene = HARD["point"].exposed(1.0)
    image = bake(skin(), broken, scene, LightPlan.everything(scene), WHOLE)
    assert image.isfinite().all()
