"""The stages of reflectance together, with toy networks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from service.anatomy.eyes import BRIGHTEST
from service.colour import LUMA, from_codes, linear_to_srgb, srgb_to_linear, to_codes
from service.errors import ModelFault, NumericFault
from service.map_registry import MAPS
from service.reflectance.planes import Planes, interpolated
from service.reflectance.reflectance import make_reflectance
from service.reflectance.reflectance_maps import MID, Reflectance, unpack_normals
from service.reflectance.reflectance_plan import ROLES, STAGES, ReflectancePlan
from service.reflectance.subject import Subject
from service.reflectance.translate import ELSEWHERE
from service.runtime.network_registry import GEOMETRY, REGISTRY
from service.runtime.networks import Engine
from service.runtime.tiles import reflected
from tests.service.reflectance.toys import TEXTURE, noise, toy_folder, toy_models, toy_subject
from tests.service.runtime.toynets import toy_net, write_models

SIZE = (240, 160)
ALL = ReflectancePlan.of(ROLES)


@pytest.fixture(scope="module", autouse=True)
def no_bf16_to_miss() -> Iterator[None]:
    """On a processor with bf16 and without OpenVINO every run says so."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("service.reflectance.reflectance.lacks_openvino", lambda: False)
        yield


@pytest.fixture(scope="module")
def engine(tmp_path_factory: pytest.TempPathFactory) -> Engine:
    return Engine(threads=1, folder=toy_folder(tmp_path_factory.mktemp("models")))


@pytest.fixture(scope="module")
def subject() -> Subject:
    return toy_subject()


@pytest.fixture(scope="module")
def made(engine: Engine, subject: Subject) -> Reflectance:
    return make_reflectance(noise(), subject, ALL, SIZE, engine)


def maps(made: Reflectance) -> dict[str, npt.NDArray[Any]]:
    return {name: getattr(made, name) for name in ROLES if getattr(made, name) is not None}


def test_every_map_is_there_in_full_size(made: Reflectance) -> None:
    assert {name: plane.shape for name, plane in maps(made).items()} == {
        "diffuse_albedo": (160, 240, 3),
        "specular_albedo": (160, 240),
        "specular_normal": (160, 240, 2),
        "diffuse_normal": (160, 240, 2),
        "displacement": (160, 240),
    }
    assert made.super_resolution and made.fallbacks == ()
    assert list(made.timings_s) == list(STAGES)
    assert all(plane.std() > 0 for plane in maps(made).values())


def test_what_ran_is_told_network_by_network(made: Reflectance, engine: Engine) -> None:
    """A manifest that names one runtime while zeta ran on another could not be reproduced from."""
    assert made.engines == dict.fromkeys(made.models, "onnxruntime fp32")
    assert made.integration is not None and made.integration.cut_fraction is None
    mixed = replace(engine, runtime="onnxruntime", exceptions=frozenset({"zeta_tail"}))
    assert mixed.told(made.models) == {**made.engines, "zeta_tail": "openvino fp32"}


def test_cliffs_are_kept_where_the_plan_says_so(made: Reflectance, engine: Engine, subject: Subject) -> None:
    plan = replace(ALL, keep_cliffs=True)
    other = make_reflectance(noise(), subject, plan, SIZE, engine)
    assert other.integration is not None and other.integration.cut_fraction is not None
    assert made.displacement is not None and other.displacement is not None
    assert (other.displacement != made.displacement).any()
    np.testing.assert_array_equal(other.specular_normal, made.specular_normal)


@pytest.mark.parametrize("tile", [40, 100, 5000])
def test_tiles_do_not_show(tile: int, made: Reflectance, engine: Engine, subject: Subject) -> None:
    """All stages one after the other: of 65,536 codes two of albedo from rounding, what a random net makes of them in
    the normals, and 3 um of relief a thousand um high.
    """
    other = make_reflectance(noise(), subject, ALL, SIZE, engine, tile=tile)
    most = {"specular_normal": 8, "diffuse_normal": 8, "displacement": 60}
    for name, plane in maps(made).items():
        assert np.abs(plane.astype(np.int64) - maps(other)[name]).max() <= most.get(name, 2), name


def test_the_seed_is_what_the_made_up_detail_depends_on(made: Reflectance, engine: Engine, subject: Subject) -> None:
    same, other = (make_reflectance(noise(), subject, ALL, SIZE, engine, seed=seed) for seed in (0, 1))
    for name, plane in maps(made).items():
        np.testing.assert_array_equal(plane, maps(same)[name])
    assert (maps(made)["diffuse_albedo"] != maps(other)["diffuse_albedo"]).any()


@pytest.mark.parametrize("colour", ["black", "white", "red", "grey", "saturated noise"])
def test_hard_textures(colour: str, engine: Engine, subject: Subject) -> None:
    """No NaN, no crash; normals of length 1; heights within the clamp."""
    flat = {"black": (0, 0, 0), "white": (255, 255, 255), "red": (255, 0, 0), "grey": (128, 128, 128)}
    texture = noise() // 128 * 255 if colour == "saturated noise" else np.full_like(noise(), flat[colour])
    made = make_reflectance(texture.astype(np.uint8), subject, ALL, SIZE, engine)
    assert made.specular_normal is not None and made.displacement is not None
    vectors = unpack_normals(made.specular_normal)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=2), 1, atol=1e-3)
    assert vectors[..., 2].min() > 0.16
    assert np.abs(made.displacement.astype(int) - MID).max() <= 20000


def test_parts_that_the_networks_have_not_seen(
    made: Reflectance, engine: Engine, subject: Subject, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Eyes and boards: texture without one light (and the lids' shade on eyes) as albedo, flat normals, a constant
    specular albedo, no displacement."""
    part = subject.islands(SIZE)
    others = (part != 0) & (part != 255)
    assert others.sum() > 500
    assert made.specular_albedo is not None and made.diffuse_albedo is not None and made.displacement is not None
    np.testing.assert_allclose(made.specular_albedo[others] / 65535, ELSEWHERE, atol=1e-4)
    for normals in (made.specular_normal, made.diffuse_normal):
        assert normals is not None and not normals[others].any()
    assert (made.displacement[others] == MID).all()
    monkeypatch.setattr("service.reflectance.reflectance.pad_parts", lambda albedo, *_: albedo)
    plain = make_reflectance(
        noise(), subject, ReflectancePlan.of(["diffuse_albedo"], super_resolution=False), (96, 64), engine
    )
    assert plain.diffuse_albedo is not None
    there = (subject.islands((96, 64)) != 0) & (subject.islands((96, 64)) != 255)
    assert subject.parts is not None
    np.testing.assert_allclose(plain.diffuse_albedo[there] / 65535, subject.parts[there] / 255, atol=2e-4)
    bare = replace(subject, parts=None)
    plain = make_reflectance(
        noise(), bare, ReflectancePlan.of(["diffuse_albedo"], super_resolution=False), (96, 64), engine
    )
    assert plain.diffuse_albedo is not None
    lit = srgb_to_linear(noise()[there] / 255)
    light = lit / srgb_to_linear(plain.diffuse_albedo[there] / 65535)
    brightest = 0.99 * 65535 * float(linear_to_srgb(np.array(BRIGHTEST)))
    told = (lit > 0.02).all(1) & (plain.diffuse_albedo[there] < brightest).all(1)
    assert told.sum() > 20 and light[told].std(0).max() < 2e-2 * light[told].mean(), "one light of all"


@pytest.mark.parametrize("role", ROLES)
def test_one_map_runs_only_what_it_needs(role: str, tmp_path: Path, subject: Subject) -> None:
    """The files of all other networks are gone, so loading one would fail."""
    plan = ReflectancePlan.of([role])
    models = toy_models()
    write_models(tmp_path, {name: models[name] for name in plan.networks})
    made = make_reflectance(noise(), subject, plan, (96, 64), Engine(threads=1, folder=tmp_path))
    assert set(made.timings_s) == set(plan.stages)
    assert getattr(made, role) is not None
    assert made.models == plan.networks


def test_light_of_the_eyes_reaches_the_context_or_its_absence_is_told(engine: Engine, subject: Subject) -> None:
    """Another light gives another albedo; without one the fallback says so, and nothing becomes NaN."""
    plan = ReflectancePlan.of(["diffuse_albedo"], super_resolution=False)
    brighter, unseen = (replace(subject, eye_light=light) for light in (np.array([0.9, 0.9, 0.9]), None))
    first, second, third = (make_reflectance(noise(), s, plan, (96, 64), engine) for s in (subject, brighter, unseen))
    assert first.diffuse_albedo is not None and second.diffuse_albedo is not None
    assert not np.array_equal(first.diffuse_albedo, second.diffuse_albedo)
    assert "light-from-skin-alone" in third.fallbacks and "light-from-skin-alone" not in first.fallbacks
    assert not unseen.eyes.any() and np.isfinite(replace(subject, eye_light=np.zeros(3)).eyes).all()


def test_detail_is_made_up_as_strongly_as_asked(engine: Engine, subject: Subject) -> None:
    """Without any, the seed decides nothing; with it, more is further away."""
    plan = ReflectancePlan.of(["diffuse_albedo"], super_resolution=True)

    def albedo(seed: int, detail: float) -> npt.NDArray[np.float64]:
        made = make_reflectance(noise(), subject, plan, SIZE, engine, seed=seed, detail=detail)
        assert made.diffuse_albedo is not None
        return made.diffuse_albedo.astype(np.float64)

    none, some, full = (albedo(1, detail) for detail in (0.0, 0.5, 1.0))
    assert np.array_equal(none, albedo(2, 0.0)) and not np.array_equal(full, albedo(2, 1.0))
    assert 0 < np.abs(some - none).mean() < np.abs(full - none).mean()


def test_bf16_that_is_not_used_is_said(engine: Engine, subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    """Users of a fast processor would never learn that a package is missing."""
    monkeypatch.setattr("service.reflectance.reflectance.lacks_openvino", lambda: True)
    plan = ReflectancePlan.of(["diffuse_albedo"], super_resolution=False)
    assert "bf16-needs-openvino" in make_reflectance(noise(), subject, plan, (96, 64), engine).fallbacks


def test_a_network_with_other_channels_needs_no_change_of_code(tmp_path: Path, subject: Subject) -> None:
    """delta without context and geometry: delta_context is not loaded, here not even there."""
    write_models(tmp_path, {"delta": toy_net("delta", TEXTURE, ("r", "g", "b"))})
    plan = ReflectancePlan.of(["diffuse_albedo"], super_resolution=False)
    made = make_reflectance(noise(), subject, plan, (96, 64), Engine(threads=1, folder=tmp_path))
    assert made.diffuse_albedo is not None and made.fallbacks == ("texture-resampled",)


@pytest.mark.parametrize(("network", "message"), [
    (toy_net("delta", ("texture_r", "infrared"), ("r", "g", "b")), "no channel 'infrared'"),
    (toy_net("delta", TEXTURE, ("r", "g")), "has to give 3"),
    (toy_net("delta", TEXTURE, ("r", "g", "b"), scale=2), "at the same size"),
])  # fmt: skip
def test_networks_that_do_not_fit_are_named(network: bytes, message: str, tmp_path: Path, subject: Subject) -> None:
    write_models(tmp_path, {"delta": network})
    plan = ReflectancePlan.of(["diffuse_albedo"], super_resolution=False)
    with pytest.raises(ModelFault, match=message):
        make_reflectance(noise(), subject, plan, (96, 64), Engine(threads=1, folder=tmp_path))


def test_a_network_that_overflows_is_named_and_nothing_comes_out(tmp_path: Path, subject: Subject) -> None:
    from onnx import TensorProto, helper

    from tests.service.runtime.toynets import finish

    huge = helper.make_tensor("huge", TensorProto.FLOAT, [1], [1e38])
    nodes = [helper.make_node("Mul", ["maps", "huge"], ["big"]), helper.make_node("Mul", ["big", "huge"], ["result"])]
    write_models(tmp_path, {"delta": finish(nodes, [huge], "delta", TEXTURE, ("r", "g", "b"))})
    plan = ReflectancePlan.of(["diffuse_albedo"], super_resolution=False)
    with pytest.raises(NumericFault, match="delta: output r"):
        make_reflectance(noise(), subject, plan, (96, 64), Engine(threads=1, folder=tmp_path))


def test_geometry_is_finite_and_within_reach(subject: Subject) -> None:
    geometry = subject.geometry
    assert geometry.shape == (len(GEOMETRY), 512, 768)
    assert np.isfinite(geometry).all() and np.abs(geometry).max() < 3
    normal = geometry[GEOMETRY.index("normal_object_x") : GEOMETRY.index("normal_object_z") + 1]
    np.testing.assert_allclose((normal**2).sum(0), 1, atol=1e-4)


def test_progress_grows_by_tile_to_one(engine: Engine, subject: Subject) -> None:
    told: list[tuple[str, float]] = []
    make_reflectance(noise(), subject, ALL, SIZE, engine, tile=80, progress=lambda *now: told.append(now))
    shares = [share for _, share in told]
    assert shares == sorted(shares) and shares[0] >= 0 and shares[-1] <= 1
    assert list(dict.fromkeys(name for name, _ in told)) == list(STAGES)
    assert sum(name == "diffuse_albedo" for name, _ in told) >= 6


def test_kept_stages_are_not_computed_again(engine: Engine, subject: Subject, made: Reflectance) -> None:
    kept: dict[str, Any] = {}

    class Stages:
        def get_or_compute(self, name: str, make: Any) -> Any:
            if name not in kept:
                kept[name] = make()
            return kept[name]

    first = make_reflectance(noise(), subject, ALL, SIZE, engine, stages=Stages())
    gone = replace(engine, folder=Path("nowhere"))
    again = make_reflectance(noise(), subject, ALL, SIZE, gone, stages=Stages())
    for name in (field.name for field in fields(Reflectance) if field.name in ROLES):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))


def test_relief_is_the_likeliest_whatever_detail_is_made_up(engine: Engine, subject: Subject) -> None:
    """``detail`` scales what no photo tells; what the networks read off the skin it neither adds to nor takes from."""
    plan = ReflectancePlan.of(["specular_normal"], super_resolution=False)
    none, full = (
        make_reflectance(noise(), subject, plan, (96, 64), engine, detail=one).specular_normal for one in (0.0, 1.0)
    )
    assert none is not None and full is not None
    assert np.array_equal(none, full) and np.linalg.norm(unpack_normals(full)[..., :2], axis=-1).max() > 0.02


def test_covered_skin_is_flat_and_bare_skin_is_not(engine: Engine, subject: Subject) -> None:
    """Strands of hair and frames are dark lines as creases are; the skin under them would be scarred."""
    hidden = replace(subject, lit=np.zeros((64, 96), np.float32))
    plan = ReflectancePlan.of(["specular_normal"], super_resolution=False)
    skin = hidden.skin((96, 64)) == 255
    tilts = []
    for one in (hidden, subject):
        made = make_reflectance(noise(), one, plan, (96, 64), engine).specular_normal
        assert made is not None
        tilts.append(float(np.linalg.norm(unpack_normals(made)[skin][:, :2], axis=1).mean()))
    assert tilts[1] > 0.03 and tilts[0] < 1e-3


def test_stages_run_after_what_they_need() -> None:
    order = list(STAGES)
    for name, stage in STAGES.items():
        assert all(order.index(need) < order.index(name) for need in stage.needs)


def test_tables_name_no_stage_that_there_is_not() -> None:
    assert {one.needs for one in MAPS} - {None} < set(STAGES)
    assert {one.stage for one in REGISTRY} - {"detect", "read", "compare"} < set(STAGES)


@pytest.mark.parametrize(("asked", "expected"), [
    ([], ()),
    (["texture"], ()),
    (["diffuse_albedo"], ("super_resolution", "diffuse_albedo")),
    (["diffuse_normal"], ("super_resolution", "diffuse_albedo", "diffuse_normal")),
    (["displacement"], ("super_resolution", "diffuse_albedo", "specular_normal", "displacement")),
    (ROLES, tuple(STAGES)),
])  # fmt: skip
def test_what_runs(asked: list[str], expected: tuple[str, ...]) -> None:
    assert ReflectancePlan.of(asked).stages == expected
    assert ReflectancePlan.of(asked, super_resolution=False).stages == tuple(
        s for s in expected if s != "super_resolution"
    )


def test_shares_make_a_whole() -> None:
    assert sum(ReflectancePlan.of(ROLES).shares().values()) == pytest.approx(1)
    assert ReflectancePlan.of([]).shares() == {}


@pytest.mark.parametrize("size", [(48, 32), (36, 24), (12, 8), (9, 6), (50, 31)])
def test_a_linear_field_stays_linear_between_the_centres(size: tuple[int, int]) -> None:
    """Centres aligned: half a texel of shift would show at every ratio. Beyond the outer centres the edge goes on."""
    field = np.linspace(0, 1, 12, dtype=np.float32)[None] + 2 * np.linspace(0, 1, 8, dtype=np.float32)[:, None]
    rows, columns = np.arange(size[1]), np.arange(size[0])
    x = np.clip((columns + 0.5) * 12 / size[0] - 0.5, 0, 11) / 11
    y = np.clip((rows + 0.5) * 8 / size[1] - 0.5, 0, 7) / 7
    np.testing.assert_allclose(interpolated(field, size, rows, columns), x[None] + 2 * y[:, None], atol=1e-5)


@pytest.mark.parametrize("size", [(192, 128), (100, 70)])
def test_a_part_is_that_part_of_the_whole(size: tuple[int, int]) -> None:
    """Also where a tile's halo turns at the border of the map."""
    field = np.random.default_rng(0).normal(0, 1, (16, 24)).astype(np.float32)
    whole = interpolated(field, size, np.arange(size[1]), np.arange(size[0]))
    for top, left in ((-20, -9), (0, 0), (37, 41), (size[1] - 10, size[0] - 25)):
        rows, columns = reflected(size[1], top, top + 30), reflected(size[0], left, left + 50)
        np.testing.assert_allclose(interpolated(field, size, rows, columns), whole[np.ix_(rows, columns)], atol=1e-5)


def test_codes_hold_colours_to_a_65536th() -> None:
    values = np.linspace(-1, 1, 1001, dtype=np.float32)
    np.testing.assert_allclose(from_codes(to_codes(values)), values, atol=1.6e-5)
    assert to_codes(np.array([-7.0, 7.0], np.float32)).tolist() == [0, 65535]


def test_channels_by_name() -> None:
    codes = np.random.default_rng(1).integers(0, 65536, (6, 9, 3), np.uint16)
    planes = Planes((9, 6))
    planes.add_codes("albedo", codes)
    rows, columns = np.array([5, 4, 4, 0]), np.array([0, 1, 8])
    red, grey = planes.read(["albedo_r", "albedo_grey"])(rows, columns)
    np.testing.assert_allclose(red, from_codes(codes[..., 0])[np.ix_(rows, columns)])
    np.testing.assert_allclose(grey, (from_codes(codes) @ LUMA)[np.ix_(rows, columns)], atol=1e-6)
    np.testing.assert_allclose(
        planes.shrunk(["albedo_r"], (3, 2))[0, 0, 0], from_codes(codes[:3, :3, 0]).mean(), atol=3e-5
    )
    planes.drop("albedo")
    with pytest.raises(ModelFault, match="no channel 'albedo_r'"):
        planes.read(["albedo_r"])
