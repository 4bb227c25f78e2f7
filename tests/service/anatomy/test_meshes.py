"""Teeth, gums, tongue and eyes as meshes: of a person's size, in the photo's colours, and carried by the head."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from models.head.crossing import crossing_pairs
from service.anatomy.eyes import SEGMENTS, eye_parts, globe, surface_picture
from service.anatomy.items import MOUTH_FILE, read_insets
from service.anatomy.mouth import mouth_parts
from service.errors import ModelFault
from service.face.features.eyes import Gaze
from service.geometry.mesh import area_normals
from service.head.files import load_head
from service.head.model import HeadModel
from service.head.regions import Eyeball, part_vertices
from service.materials.part import MeshPart, head_parts


@dataclass(frozen=True)
class Worn:
    """What the meshes need of a fit."""

    vertices: npt.NDArray[np.float32]
    neutral: npt.NDArray[np.float32]
    gaze: Gaze | None = None


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_head()


@pytest.fixture(scope="module")
def parts(head: HeadModel) -> dict[str, MeshPart]:
    identity = np.random.default_rng(2).normal(size=len(head.identity))
    jaw = np.array([name == "jawOpen" for name in head.expression_names], float)
    fit = Worn(head.shape(identity, jaw), head.shape(identity))
    made = (*mouth_parts(head, fit, None), *eye_parts(head, fit, None))  # type: ignore[arg-type]
    return {part.name: part for part in made}


@pytest.mark.parametrize("seed", [14, 22, 26])
def test_rows_of_teeth_do_not_cross_whatever_the_face(head: HeadModel, seed: int) -> None:
    """Of 80 random faces 17 had teeth that went through the teeth below, and one of 12 photos."""
    neutral = head.shape(np.random.default_rng(seed).normal(size=len(head.identity)))
    made = {part.name: part for part in mouth_parts(head, Worn(neutral, neutral), None)}  # type: ignore[arg-type]
    rows = [made[name] for name in ("teeth_upper_gums", "teeth_lower_gums")]
    points = np.concatenate([row.neutral for row in rows]).astype(np.float64)
    upper, lower = (row.faces.astype(np.int64) for row in rows)
    assert not len(crossing_pairs(points, upper, lower + len(rows[0].neutral)))


def test_units_move_a_mesh_as_they_move_what_it_stands_for(head: HeadModel, parts: dict[str, MeshPart]) -> None:
    jaw = head.expression_names.index("jawOpen")
    for name, own in (("teeth_lower_gums", "teeth_lower"), ("tongue_body", "tongue")):
        drop = parts[name].targets["jawOpen"][:, 1].mean()
        assert drop == pytest.approx(head.expression[jaw, part_vertices(head, own), 1].mean(), rel=0.35)
        np.testing.assert_allclose(
            parts[name].vertices, parts[name].neutral + parts[name].targets["jawOpen"], atol=3e-5
        )
    assert "jawOpen" not in parts["teeth_upper_gums"].targets
    assert "tongueOut" in parts["tongue_body"].targets
    assert "eyeLookOutLeft" in parts["eye_left_ball"].targets
    assert "eyeLookOutRight" not in parts["eye_left_ball"].targets
    assert "eyeBlinkLeft" in parts["eye_left_tears"].targets


def test_all_meshes_are_sound(parts: dict[str, MeshPart]) -> None:
    for part in parts.values():
        quads = part.polygons
        triangles = np.concatenate([quads[:, :3], quads[quads[:, 3] >= 0][:, [0, 2, 3]]])
        a, b, c = (part.neutral[triangles[:, k]].astype(float) for k in range(3))
        assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 0, part.name
        assert part.uv.min() >= 0 and part.uv.max() <= 1, part.name


def test_the_eye_mirrors_as_a_cornea_and_the_sclera_as_the_ball(head: HeadModel) -> None:
    """Normals of map and mesh together are those of a dome of 7.8 mm at its apex, flatter outwards."""
    ball = Eyeball.of(head.mean[part_vertices(head, "eye_left")].astype(np.float64))
    points, faces, uv = globe(ball)
    normals = area_normals(points, np.concatenate([faces[:, :3], faces[faces[:, 3] >= 0][:, [0, 2, 3]]]))
    picture = (surface_picture(head).astype(float) - 128) / 127
    size = len(picture)
    ray = points - ball.centre
    for ring in range(1, len(points), SEGMENTS):
        x, y = uv[ring, 0] * size, (1 - uv[ring, 1]) * size
        local = picture[int(min(y, size - 1)), int(min(x, size - 1))]
        tilt = np.degrees(np.arctan2(normals[ring, 0], normals[ring, 2]) + np.arctan2(local[0], local[2]))
        radius = ray[ring, 0]
        if radius < 0.0045 and ray[ring, 2] > 0:
            dome = np.arcsin(radius / 0.0078)
            assert tilt == pytest.approx(np.degrees(dome), abs=3.0)
        elif np.degrees(np.arctan2(radius, ray[ring, 2])) > ball.limbus_deg + 6:
            assert tilt == pytest.approx(np.degrees(np.arctan2(normals[ring, 0], normals[ring, 2])), abs=3.0)


def test_another_head_keeps_its_own_teeth(head: HeadModel) -> None:
    fit = Worn(head.mean, head.mean)
    assert mouth_parts(replace(head, mean=head.mean[:-1]), fit, None) == ()  # type: ignore[arg-type]
    assert eye_parts(replace(head, part_names=("skin", *"abcdef")), fit, None) == ()  # type: ignore[arg-type]
    assert {part.name for part in head_parts(head, head.mean, head.mean)} >= {"teeth_upper", "tongue"}


def test_a_file_that_is_missing_or_damaged_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelFault, match="missing"):
        read_insets(tmp_path / "none.npz")
    (tmp_path / "mouth.npz").write_bytes(MOUTH_FILE.read_bytes()[:4000])
    with pytest.raises(ModelFault, match="cannot be read"):
        read_insets(tmp_path / "mouth.npz")
