"""Another head model in our file format."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from models.head.import_npz import read_npz
from models.head.importing import Source, convert
from models.head.shoot import look_at
from models.head.writing import save_head
from service.errors import ModelFault
from service.face.finder import Face
from service.head.files import load_head
from service.photo.photo import Photo
from tests.support.fits import fit_face


def foreign() -> Source:
    """Our own skin in centimetres under another numbering and without parts: the landmarks' true places are known."""
    head = load_head()
    skin = head.polygons[head.polygon_part == 0]
    used = np.unique(skin)[::-1]
    place = np.full(len(head.mean), -1)
    place[used] = np.arange(len(used))
    balls = [head.mean[head.triangles[head.triangle_part == p]].reshape(-1, 3).astype(float) for p in (1, 2)]
    eyes = np.stack([0.5 * (ball.min(0) + ball.max(0)) for ball in balls])
    shift = np.array([3.0, -7.0, 11.0])
    return Source(
        name="foreign",
        licence="MIT",
        unit_m=0.01,
        neutral=head.shape(np.eye(len(head.identity))[2] * 1.5)[used] * 100.0 + shift,
        identity=head.identity[:5, used].astype(float) * 100,
        expression=head.expression[:3, used].astype(float) * 100,
        names=head.expression_names[:3],
        polygons=place[skin],
        polygon_uv=head.polygon_uv[head.polygon_part == 0].astype(np.int64),
        uv=head.uv.astype(float),
        eyes=eyes * 100 + shift,
    )


def test_landmarks_arrive_at_the_same_places(tmp_path: Path) -> None:
    ours, source = load_head(), foreign()
    head = convert(source, ours)
    save_head(head, tmp_path / "foreign.npz")
    head = load_head(tmp_path / "foreign.npz")
    got = (head.mean[head.triangles[head.landmark_triangle]] * head.landmark_barycentric[..., None]).sum(1)
    true = ours.shape(np.eye(len(ours.identity))[2] * 1.5)
    true = (true[ours.triangles[ours.landmark_triangle]] * ours.landmark_barycentric[..., None]).sum(1)
    eyes = source.eyes.mean(0) / 100 - np.array([3.0, -7.0, 11.0]) / 100
    error = np.linalg.norm(got - (true - eyes), axis=1)
    assert np.median(error) < 0.0012
    assert np.percentile(error, 95) < 0.006
    assert np.abs(head.region("lips") - 0).max() > 0.9
    assert head.shape(np.zeros(5), np.zeros(3)).shape == head.mean.shape


def test_the_fitter_takes_an_imported_head() -> None:
    """Landmarks of the imported head itself under a known camera: the fit must find the pose again."""
    head = convert(foreign(), load_head())
    camera = look_at(18.0, 4.0, 0.0, 0.9, 800, 1500.0)
    points = (head.mean[head.triangles[head.landmark_triangle]] * head.landmark_barycentric[..., None]).sum(1)
    pixels = camera.project(points)
    box = np.r_[pixels.min(0), pixels.max(0)]
    landmarks = np.c_[pixels, np.zeros(len(pixels))]
    face = Face(box, 1.0, np.zeros((6, 2)), landmarks, 1.0)
    fit = fit_face(face, Photo(np.full((800, 800, 3), 128, np.uint8)), head)
    assert fit.landmark_rms_px < 0.03 * fit.inter_ocular_px
    assert abs(fit.camera.yaw_pitch_roll_deg()[0] - 18.0) < 4.0
    assert fit.vertices.shape == head.mean.shape


def test_generic_import_names_what_is_missing(tmp_path: Path) -> None:
    np.savez(tmp_path / "half.npz", neutral=np.zeros((4, 3)))
    with pytest.raises(ModelFault, match="lacks identity"):
        read_npz(tmp_path / "half.npz", 1.0, "x", "y")
