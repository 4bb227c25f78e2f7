"""Materials and parts refuse what no file could hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.errors import NumericFault
from service.materials.material import ChartMap, Material, OwnMap
from service.materials.part import SKIN, check_parts, head_parts, material_of
from tests.service.archive.toys import toy_head, toy_part

PIXELS = np.zeros((4, 4, 3), np.uint8)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"roughness": 1.5}, "roughness"), ({"colour": (0.1, -0.1, 0.0)}, "green"),
        ({"opacity": float("nan")}, "opacity"),
        ({"ior": 0.5}, "refraction"), ({"subsurface_mm": (1.0, -1.0, 0.0)}, "subsurface"), ({"name": "a b"}, "a b"),
        ({"colour": (0.9, 0.8, 0.7), "colour_map": ChartMap("diffuse_albedo")}, "a map and a colour"),
        ({"name": "../x"}, "x"), ({"name": ""}, "named ''"),
    ],
)  # fmt: skip
def test_a_material_out_of_range_is_refused(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(NumericFault, match=said):
        Material(**({"name": "m"} | wrong))  # type: ignore[arg-type]


@pytest.mark.parametrize("pixels", [np.zeros((4, 4), np.float32), np.zeros((4, 4, 2), np.uint8), np.zeros(4, np.uint8)])
def test_a_texture_of_another_kind_is_refused(pixels: np.ndarray) -> None:
    with pytest.raises(NumericFault, match=r"\(h, w"):
        OwnMap("t", pixels)


def test_f0_is_that_of_the_index_of_refraction() -> None:
    assert Material("m").f0 == pytest.approx(0.04)
    assert Material("m", ior=1.33, specular=0.5).f0 == pytest.approx(0.5 * 0.0200, abs=1e-4)
    assert SKIN.textured and SKIN.detailed and not material_of("lashes").textured
    assert Material("m", colour_map=ChartMap("x"), normal_map=ChartMap("x")).maps == (ChartMap("x"),)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"neutral": np.zeros((4, 3), np.float32)}, "neutral"), ({"uv": np.zeros((3, 2), np.float32)}, "uv_faces"),
        ({"vertices": np.full((5, 3), np.nan, np.float32)}, "vertices"),
        ({"faces": np.array([[0, 1, 5]])}, "points outside"),
        ({"faces": np.array([[0, -1, 2, 3]])}, "points outside"), ({"faces": np.zeros((0, 3), np.int32)}, "faces"),
        ({"targets": {"jawOpen": np.zeros((2, 3), np.float32)}}, "jawOpen"),
        ({"uv_faces": np.array([[0, 1, 2]])}, "differ"),
    ],
)  # fmt: skip
def test_a_part_that_does_not_fit_together_is_refused(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(NumericFault, match=said):
        toy_part(**wrong)


def test_names_are_unambiguous() -> None:
    part = toy_part()
    check_parts([part, replace(part, name="second")], ["skin"])
    with pytest.raises(NumericFault, match="two parts"):
        check_parts([part], ["toy_hair"])
    other = replace(part, name="second", material=replace(part.material, roughness=0.9))
    with pytest.raises(NumericFault, match="two materials"):
        check_parts([part, other], [])
    same_file = Material("another", colour_map=OwnMap("toy_hair", PIXELS))
    with pytest.raises(NumericFault, match="two materials or two textures"):
        check_parts([part, replace(part, name="second", material=same_file)], [])


def test_the_heads_own_parts_are_the_head() -> None:
    head = toy_head()
    moved = head.shape(np.zeros(0), np.array([0.5, 0.2, 0.1, 0.0]))
    parts = head_parts(head, moved, head.mean)
    assert [part.name for part in parts] == list(head.part_names)
    for index, part in enumerate(parts):
        chosen = head.polygon_part == index
        present = head.polygons[chosen] >= 0
        assert ((part.polygons >= 0) == present).all()
        np.testing.assert_array_equal(part.neutral[part.polygons[present]], head.mean[head.polygons[chosen][present]])
        np.testing.assert_array_equal(part.vertices[part.polygons[present]], moved[head.polygons[chosen][present]])
        np.testing.assert_array_equal(part.uv[part.polygons_uv[present]], head.uv[head.polygon_uv[chosen][present]])
        assert "tongueOut" not in part.targets, "moves nothing"
    assert parts[4].bone == "jaw" and parts[1].bone == "eye_left" and parts[0].bone == "head"
