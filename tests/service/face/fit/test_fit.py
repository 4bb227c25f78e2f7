"""The fit on landmarks made from the head model itself, where the truth is known, and on every way they go bad."""

from dataclasses import replace

import numpy as np
import pytest

from service.colour import linear_to_srgb, to_bytes
from service.errors import FitFailed
from service.face.finder import Face
from service.face.fit.fit import FitSettings
from service.face.fit.landmark_fit import LandmarkModel
from service.geometry.camera import Camera, exp_rotation
from service.geometry.mesh import vertex_normals
from service.geometry.raster import rasterise
from service.head.model import HeadModel
from service.photo.photo import Photo
from tests.support.fits import fit_face

WIDTH, HEIGHT, FOCAL = 640, 480, 900.0
MIDDLE = np.array([WIDTH / 2, HEIGHT / 2])


def make(
    head: HeadModel, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0, distance: float = 1.0, noise: float = 0.0
) -> tuple[Face, Photo, Camera, np.ndarray]:
    """Landmarks of a random head of the model in a known pose, a grey photo, the camera and the identity."""
    rng = np.random.default_rng(11)
    turn = exp_rotation(np.radians([0.0, yaw, 0.0])) @ exp_rotation(np.radians([-pitch, 0.0, 0.0]))
    rotation = exp_rotation(np.radians([0.0, 0.0, roll])) @ np.diag([1.0, -1.0, -1.0]) @ turn
    camera = Camera(WIDTH, HEIGHT, FOCAL, MIDDLE, rotation, np.array([0.02, -0.01, distance]))
    model = LandmarkModel(head, 40)
    identity = rng.normal(size=40)
    coefficients = np.concatenate([identity, np.zeros(model.expression_count)])
    points = model.at_yaw(yaw).points(coefficients)
    depth = camera.to_camera(points)[:, 2] * FOCAL / distance
    landmarks = np.concatenate([camera.project(points), depth[:, None]], 1)
    landmarks += rng.normal(size=landmarks.shape) * noise
    low, high = landmarks[:, :2].min(0), landmarks[:, :2].max(0)
    face = Face(np.array([*low, *high]), 0.9, np.zeros((6, 2)), landmarks, 1.0)
    photo = Photo(np.full((HEIGHT, WIDTH, 3), 128, np.uint8))
    return face, photo, camera, identity


def surface_error_mm(head: HeadModel, found: np.ndarray, identity: np.ndarray) -> float:
    """Median distance of face vertices to the truth after aligning both by their centroids and scale."""
    inside = head.region("face") > 0.5
    ours, truth = found[inside], head.shape(identity)[inside]
    ours, truth = ours - ours.mean(0), truth - truth.mean(0)
    ours = ours * np.sqrt((truth**2).sum() / (ours**2).sum())
    return float(np.median(np.linalg.norm(ours - truth, axis=1)) * 1e3)


@pytest.mark.parametrize(
    ("yaw", "pitch", "roll"), [(0, 0, 0), (30, 0, 0), (-45, 10, 0), (0, 15, 30), (60, 0, 0), (0, 0, 90)]
)
def test_pose_and_shape_come_back(head: HeadModel, yaw: float, pitch: float, roll: float) -> None:
    face, photo, camera, identity = make(head, yaw, pitch, roll)
    fit = fit_face(face, photo, head)
    angle = np.degrees(np.arccos(np.clip((np.trace(fit.camera.rotation.T @ camera.rotation) - 1) / 2, -1, 1)))
    assert angle < 4.0
    assert surface_error_mm(head, fit.neutral, identity) < 2.0
    assert fit.landmark_rms_px < 0.02 * fit.inter_ocular_px
    assert "low-confidence" not in fit.warnings


def test_a_quarter_of_wild_landmarks_is_outvoted(head: HeadModel) -> None:
    """Without robust weights hair or a hand over a cheek drags the whole pose along."""
    face, photo, _, identity = make(head, noise=0.5)
    bad = face.landmarks.copy()
    wild = np.random.default_rng(0).choice(468, 117, replace=False)
    bad[wild, :2] += np.random.default_rng(1).uniform(20, 60, (117, 2))
    fit = fit_face(replace(face, landmarks=bad), photo, head)
    assert surface_error_mm(head, fit.neutral, identity) < 3.0


@pytest.mark.parametrize("share", [0.01, 0.5, 0.9])
def test_nan_landmarks_are_ignored(head: HeadModel, share: float) -> None:
    """One NaN in the normal equations makes every unknown NaN."""
    face, photo, _, _ = make(head)
    bad = face.landmarks.copy()
    bad[np.random.default_rng(2).random(468) < share] = np.nan
    fit = fit_face(replace(face, landmarks=bad), photo, head)
    assert np.isfinite(fit.vertices).all() and np.isfinite(fit.camera.translation).all()
    assert np.isfinite(fit.landmark_rms_px)


def test_too_few_finite_landmarks_are_refused(head: HeadModel) -> None:
    face, photo, _, _ = make(head)
    bad = np.full_like(face.landmarks, np.inf)
    bad[:12] = face.landmarks[:12]
    with pytest.raises(FitFailed, match="only 12 of 468"):
        fit_face(replace(face, landmarks=bad), photo, head)


def test_all_landmarks_in_one_point_are_refused(head: HeadModel) -> None:
    """The scale is zero there: dividing by it would send the head to infinity."""
    face, photo, _, _ = make(head)
    with pytest.raises(FitFailed):
        fit_face(replace(face, landmarks=np.zeros((468, 3))), photo, head)


def test_noise_is_refused_or_distrusted(head: HeadModel) -> None:
    face, photo, _, _ = make(head)
    noise = np.random.default_rng(3).uniform(0, 480, (468, 3))
    try:
        fit = fit_face(replace(face, landmarks=noise), photo, head)
    except FitFailed:
        return
    assert "low-confidence" in fit.warnings


def test_half_a_face_outside_the_photo(head: HeadModel) -> None:
    """Landmarks off the photo are legal coordinates; the pixel stage must not read beyond the border."""
    face, photo, _, _ = make(head)
    moved = face.landmarks + np.array([-WIDTH / 2 - 10, 0, 0])
    for refine in ("landmarks", "full"):
        fit = fit_face(replace(face, landmarks=moved), photo, head, FitSettings(refine=refine))
        assert np.isfinite(fit.vertices).all()


@pytest.mark.parametrize("level", [0, 128, 255])
def test_pixel_stage_of_a_blank_photo_keeps_the_landmark_fit(head: HeadModel, level: int) -> None:
    """No edge and no shading: the outline weights sum to zero and the light cannot be normalised."""
    face, photo, _, _ = make(head, yaw=30)
    blank = replace(photo, pixels=np.full((HEIGHT, WIDTH, 3), level, np.uint8))
    a = fit_face(face, blank, head)
    b = fit_face(face, blank, head, FitSettings(refine="landmarks"))
    assert np.abs(a.vertices - b.vertices).max() < 2e-3


def test_zero_area_triangles_do_no_harm(head: HeadModel) -> None:
    """A landmark in a degenerate triangle has no normal; it would be NaN when normalised without a guard."""
    triangles = head.triangles.copy()
    triangles[head.landmark_triangle[:20]] = triangles[head.landmark_triangle[:20], :1]
    face, photo, _, _ = make(head)
    fit = fit_face(face, photo, replace(head, triangles=triangles))
    assert np.isfinite(fit.vertices).all()


def lit(head: HeadModel, camera: Camera, identity: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 photo of a matt head under a yellow lamp, direction in camera axes, and a faint blue sky."""
    vertices = head.shape(identity).astype(float)
    depth = camera.to_camera(vertices)[:, 2]
    raster = rasterise(camera.project(vertices), depth, head.triangles, WIDTH, HEIGHT, perspective=True)
    normals = vertex_normals(vertices, head.triangles) @ camera.rotation.T
    shade = np.maximum(normals @ towards, 0)[:, None] * [1.0, 0.9, 0.7] + np.array([0.12, 0.14, 0.2])
    corner = (shade * [0.55, 0.4, 0.33])[head.triangles[raster.triangle[raster.mask]]]
    image = np.full((HEIGHT, WIDTH, 3), 0.1, np.float32)
    image[raster.mask] = np.einsum("nk,nkc->nc", raster.barycentric[raster.mask], corner)
    return to_bytes(linear_to_srgb(image))


@pytest.mark.parametrize("yaw", [0, 30])
@pytest.mark.parametrize("towards", [(0.0, 0.0, -1.0), (-0.7, -0.3, -0.65), (0.6, -0.2, -0.77), (0.1, -0.7, -0.7)])
def test_known_light_comes_back(head: HeadModel, yaw: float, towards: tuple[float, float, float]) -> None:
    """In the head's frame instead of the camera's, or with an axis turned over, the direction would be far off."""
    face, photo, camera, identity = make(head, yaw)
    direction = np.array(towards) / np.linalg.norm(towards)
    fit = fit_face(face, replace(photo, pixels=lit(head, camera, identity, direction)), head)
    assert fit.light is not None and "no-light" not in fit.warnings
    linear = (fit.light @ [0.2126, 0.7152, 0.0722])[[3, 1, 2]]
    assert np.degrees(np.arccos(linear @ direction / np.linalg.norm(linear))) < 15.0


def test_yaw_75_is_said_to_be_extreme(head: HeadModel) -> None:
    face, photo, _, _ = make(head, yaw=76)
    fit = fit_face(face, photo, head)
    assert "extreme-pose" in fit.warnings and np.isfinite(fit.vertices).all()
