"""The stages of reflectance together, with toy networks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from service.arrays import Float32
from service.errors import ModelFault, NumericFault
from service.map_registry import maps_made_by
from service.reflectance.planes import Planes, interpolate_into
from service.reflectance.reflectance import make_reflectance
from service.reflectance.reflectance_maps import MID, Reflectance, unpack_normals
from service.reflectance.reflectance_plan import ReflectancePlan
from service.reflectance.subject import Subject
from service.runtime.networks import Engine
from service.runtime.tiles import Indices, reflected
from tests.service.reflectance.toys import TEXTURE, noise, toy_folder, toy_models, toy_subject
from tests.service.runtime.toynets import toy_net, write_models

SIZE = (240, 160)
ALL = ReflectancePlan.of(maps_made_by("networks"))


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
    return {name: getattr(made, name) for name in maps_made_by("networks") if getattr(made, name) is not None}


@pytest.mark.parametrize("tile", [40, 100, 5000])
def test_tiles_do_not_show(tile: int, made: Reflectance, engine: Engine, subject: Subject) -> None:
    """All stages one after the other: of 65,536 codes two of albedo from rounding, what a random net makes of them in
    the normals, and 3 um of relief a thousand um high.
    """
    other = make_reflectance(noise(), subject, ALL, SIZE, engine, tile=tile)
    most = {"specular_normal": 8, "diffuse_normal": 8, "displacement": 60}
    for name, plane in maps(made).items():
        assert np.abs(plane.astype(np.int64) - maps(other)[name]).max() <= most.get(name, 2), name


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


@pytest.mark.parametrize(("network", "message"), [
    (toy_net("delta", ("texture_r", "infrared"), ("r", "g", "b")), "no channel 'infrared'"),
    (toy_net("delta", TEXTURE, ("r", "g")), "has to give 3"),
    (toy_net("delta", TEXTURE, ("r", "g", "b"), scale=2), "at the same size"),
])  # fmt: skip
def test_networks_that_do_not_fit_are_named(network: bytes, message: str, tmp_path: Path, subject: Subject) -> None:
    write_models(tmp_path, toy_models() | {"delta": network})
    plan = ReflectancePlan.of(["diffuse_albedo"], super_resolution=False)
    with pytest.raises(ModelFault, match=message):
        make_reflectance(noise(), subject, plan, (96, 64), Engine(threads=1, folder=tmp_path))


def test_a_network_that_overflows_is_named_and_nothing_comes_out(tmp_path: Path, subject: Subject) -> None:
    from onnx import TensorProto, helper

    from tests.service.runtime.toynets import finish

    huge = helper.make_tensor("huge", TensorProto.FLOAT, [1], [1e38])
    nodes = [helper.make_node("Mul", ["maps", "huge"], ["big"]), helper.make_node("Mul", ["big", "huge"], ["result"])]
    overflowing = finish(nodes, [huge], "delta", TEXTURE, ("r", "g", "b"))
    write_models(tmp_path, toy_models() | {"delta": overflowing})
    plan = ReflectancePlan.of(["diffuse_albedo"], super_resolution=False)
    with pytest.raises(NumericFault, match="delta: output r"):
        make_reflectance(noise(), subject, plan, (96, 64), Engine(threads=1, folder=tmp_path))


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


def interpolated(field: Float32, size: tuple[int, int], rows: Indices, columns: Indices) -> Float32:
    into = np.zeros((len(rows), len(columns)), np.float32)
    interpolate_into(field, size, rows, columns, into)
    return into


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


def test_four_smooth_planes_come_in_one() -> None:
    """Each is what its means over squares of 2 x 2 texels are; what is not interpolated cannot be packed."""
    planes, rng = Planes((96, 64)), np.random.default_rng(3)
    planes.add_coarse(["a", "b", "c"], rng.random((3, 8, 12), np.float32))
    planes.add_full(["d"], rng.random((1, 64, 96), np.float32))
    rows, columns = np.arange(8, 40), np.arange(96)
    means = planes.read(["a", "b", "c"])(rows, columns).reshape(3, 16, 2, 48, 2).mean((2, 4))
    (packed,) = planes.read(["a/b/c"])(rows, columns)
    for k, expected in enumerate((*means, np.zeros_like(means[0]))):
        np.testing.assert_allclose(packed[k // 2 :: 2, k % 2 :: 2], expected, atol=1e-6)
    with pytest.raises(ModelFault, match="packed"):
        planes.read(["a/d"])
