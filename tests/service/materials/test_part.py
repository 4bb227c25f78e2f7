"""Materials and parts refuse what no file could hold."""

from __future__ import annotations

import numpy as np
import pytest

from service.errors import NumericFault
from service.geometry.mesh import area_normals
from service.head.files import split_polygons
from service.materials.material import ChartMap, Material
from service.materials.part import head_parts
from tests.service.archive.toys import toy_head, toy_part


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


def test_a_part_knows_how_each_unit_turns_its_normals() -> None:
    head = toy_head()
    for part in head_parts(head, head.mean, head.mean):
        assert list(part.turned) == list(part.targets)
        triangles = split_polygons(part.polygons)
        still = area_normals(part.neutral, triangles)
        for unit, offsets in part.targets.items():
            np.testing.assert_array_equal(part.turned[unit], area_normals(part.neutral + offsets, triangles) - still)
        assert part.turned is part.turned
