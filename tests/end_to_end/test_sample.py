"""The sample photo through the pipeline, as it is and made hard: then the answer is a head close to that of the plain
photo, or a refusal; no wrong head.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import numpy.typing as npt
import pytest

from models.head.writing import save_head
from service.archive.avatar import Avatar
from service.archive.pack import archive_members
from service.errors import FaceCutOff, FaceTooSmall, NoFace
from service.face.finder import OVAL
from service.face.fit.landmark_fit import at_barycentric
from service.geometry.chart import Chart
from service.head.regions import vertex_mask
from service.map_registry import SEEN
from service.pipeline import make_avatar
from service.texture.unwrap import Zones
from tests.end_to_end.command import ROOT
from tests.end_to_end.conftest import QUICK, Pixels, png

Make = Callable[[Pixels], Avatar]
EYES = ((33, 133), (362, 263))
"""Corners of the image-left and the image-right eye."""


def difference_mm(ours: Avatar, other: Avatar) -> npt.NDArray[np.float64]:
    """Distance of each face vertex between two neutral heads, after aligning position, turn and scale."""
    inside = ours.head.region("face") > 0.5
    a, b = (avatar.fit.neutral[inside].astype(np.float64) for avatar in (ours, other))
    a, b = a - a.mean(0), b - b.mean(0)
    left, _, right = np.linalg.svd(a.T @ b)
    scale = np.sqrt((b**2).sum() / (a**2).sum())
    return np.asarray(np.linalg.norm(scale * a @ (left @ right) - b, axis=1) * 1e3)


def whole(avatar: Avatar) -> dict[str, bytes]:
    """The archive's files, after checking that nothing in them is NaN and that the manifest obeys its schema."""
    for values in (avatar.fit.vertices, avatar.fit.neutral, avatar.fit.camera.translation, avatar.fit.camera.rotation):
        assert np.isfinite(values).all()
    members = archive_members(avatar)
    schema = json.loads((ROOT / "docs" / "manifest.schema.json").read_text("utf-8"))
    jsonschema.validate(json.loads(members["manifest.json"]), schema)
    return members


def resized(portrait: Pixels, plain: Avatar, face_px: float) -> Pixels:
    """The photo shrunk until its face box has the given width."""
    factor = face_px / float(plain.face.box[2] - plain.face.box[0])
    return np.asarray(cv2.resize(portrait, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA), np.uint8)


def cut(portrait: Pixels, plain: Avatar, share: float) -> Pixels:
    """The photo without the part left of a line that runs through the face box, at ``share`` of its width."""
    x0, _, x1, _ = plain.face.box
    return np.ascontiguousarray(portrait[:, int(x0 + share * (x1 - x0)) :])


def test_a_face_of_30_pixels_is_refused_with_the_size_that_would_do(
    portrait: Pixels, plain: Avatar, make: Make
) -> None:
    """Landmarks are off by more than a good fit may be: the head would be somebody's, not this person's."""
    with pytest.raises(FaceTooSmall, match=r"the face is (29|30|31) pixels wide; 40 are needed"):
        make(resized(portrait, plain, 30))


def shrunk(portrait: Pixels, plain: Avatar) -> Pixels:
    """A face of 45 pixels: a filter of zero width, or a crop of none, would show."""
    return resized(portrait, plain, 45)


def without_chin(portrait: Pixels, plain: Avatar) -> Pixels:
    """The photo ends between mouth and chin."""
    y = plain.face.landmarks[list(OVAL), 1]
    return np.ascontiguousarray(portrait[: int(y.max() - 0.15 * np.ptp(y))])


def grey(portrait: Pixels, plain: Avatar) -> Pixels:
    return np.dstack([np.asarray(cv2.cvtColor(portrait, cv2.COLOR_RGB2GRAY), np.uint8)] * 3)


def dark(portrait: Pixels, plain: Avatar) -> Pixels:
    """Under-exposed by 5 stops in linear light: weights by contrast fade out, and must not fade to nothing."""
    return (portrait * 0.18).astype(np.uint8)


def dark_glasses(portrait: Pixels, plain: Avatar) -> Pixels:
    """Both eyes are guesses of the network. Trusted fully they would bend the brows, the nose and the pose."""
    worn = portrait.copy()
    for corners in EYES:
        x, y = plain.face.landmarks[list(corners), :2].mean(0)
        cv2.ellipse(worn, (int(x), int(y)), (19, 13), 0, 0, 360, (18, 16, 20), -1)
    return worn


def eye_patch(portrait: Pixels, plain: Avatar) -> Pixels:
    """The covered side's landmarks, if believed, pull the eye sockets apart in height and depth."""
    patched = portrait.copy()
    x, y = (int(v) for v in plain.face.landmarks[list(EYES[1]), :2].mean(0))
    patched[y - 14 : y + 14, x - 18 : x + 18] = 15
    return patched


@pytest.mark.parametrize(
    ("hard", "warning", "most_mm", "high_mm"),
    [
        (shrunk, "low-resolution", 1.5, 9.0), (grey, "no-colour", 1.5, 9.0), (dark, "under-exposed", 2.0, 9.0),
        (dark_glasses, "eyes-covered", 2.0, 4.0), (eye_patch, None, 2.0, 4.0),
        (without_chin, "face-at-edge", 2.0, 6.0),
    ],
)  # fmt: skip
def test_it_is_the_same_head(
    hard: Callable[[Pixels, Avatar], Pixels], warning: str | None, most_mm: float, high_mm: float,
    portrait: Pixels, plain: Avatar, make: Make,
) -> None:  # fmt: skip
    avatar = make(hard(portrait, plain))
    assert warning is None or warning in avatar.all_warnings()
    difference = difference_mm(avatar, plain)
    assert np.median(difference) < most_mm and np.percentile(difference, 95) < high_mm
    assert abs(avatar.fit.camera.yaw_pitch_roll_deg()[0] - plain.fit.camera.yaw_pitch_roll_deg()[0]) < 5.0
    if hard is grey:
        assert np.ptp(avatar.texture.texture.astype(int), axis=-1).max() == 0, "colour would have been made up"
    whole(avatar)


def test_half_a_face_is_refused(portrait: Pixels, plain: Avatar, make: Make) -> None:
    """The networks make up the half that is not there; fitting it would look like success."""
    with pytest.raises((FaceCutOff, NoFace)):
        make(cut(portrait, plain, 0.5))


def test_a_cheek_outside_the_photo_is_not_called_seen(portrait: Pixels, plain: Avatar, make: Make) -> None:
    """Texels beyond the border have no pixel: reading there repeats the last column as if it were skin."""
    avatar = make(cut(portrait, plain, 0.2))
    assert np.median(difference_mm(avatar, plain)) < 2.5
    seen = avatar.texture.visible_fraction
    assert 0.4 < seen < plain.texture.visible_fraction - 0.05
    width = avatar.texture.confidence.shape[1] // 2
    left, right = (avatar.texture.confidence[:, half] >= SEEN for half in (np.s_[:width], np.s_[width:]))
    before = plain.texture.confidence >= SEEN
    lost = {"left": before[:, :width].sum() - left.sum(), "right": before[:, width:].sum() - right.sum()}
    assert max(lost.values()) > 3 * max(min(lost.values()), 1), "only the side that was cut off loses texels"
    whole(avatar)


def test_glasses_leave_the_skin_and_the_archive_says_so(portrait: Pixels, plain: Avatar, make: Make) -> None:
    """Their frame in the albedo is a tattoo. Nothing but the skin under and beside it may change by their going."""
    worn, frame = portrait.copy(), np.zeros(portrait.shape[:2], np.uint8)
    centres = [plain.face.landmarks[list(corners), :2].mean(0) for corners in EYES]
    apart = float(centres[1][0] - centres[0][0])
    for x, y in centres:
        cv2.ellipse(frame, (int(x), int(y) + 2), (int(0.4 * apart), int(0.3 * apart)), 0, 0, 360, 1, 2)
    ends = [(int(x + turn * 0.4 * apart), int(y)) for turn, (x, y) in zip((1, -1), centres, strict=True)]
    cv2.line(frame, ends[0], ends[1], 1, 2)
    worn[frame > 0] = (30, 26, 24)
    avatar = make(worn)
    assert "glasses-removed" in avatar.all_warnings() and "glasses-removed" not in plain.all_warnings()
    assert np.median(difference_mm(avatar, plain)) < 2.0
    chart = Chart.build(avatar.head, *avatar.texture.lit_skin.shape[::-1])
    zones = Zones.of(chart)
    features = chart.inside(vertex_mask(avatar.head, "brow_left", "brow_right", "eyelid_left", "eyelid_right")[:, None])
    bare = zones.skin & (zones.face > 0.7) & (features[:, 0] < 0.3)
    before, after = (a.texture.texture.reshape(-1, 3)[chart.texels][bare].astype(int) for a in (plain, avatar))
    assert ((before - after).min(1) > 50).mean() < 0.005, "2 % with the frame left in"
    whole(avatar)


def test_a_turned_photo_without_a_tag_is_the_same_head(portrait: Pixels, plain: Avatar, make: Make) -> None:
    """Nothing says that the photo lies on its side; the landmarks turned back have to be those of the upright one."""
    avatar = make(np.ascontiguousarray(np.rot90(portrait, -1)))
    assert "turned-90" in avatar.all_warnings()
    x, y = avatar.face.landmarks[:, 0], avatar.face.landmarks[:, 1]
    back = np.stack([y, portrait.shape[0] - x], 1)
    eyes = np.linalg.norm(np.subtract(*plain.face.landmarks[[[33, 133], [362, 263]], :2].mean(1)))
    gap = np.linalg.norm(back - plain.face.landmarks[:, :2], axis=1)
    assert np.sqrt(np.mean(gap**2)) < 0.02 * eyes
    assert np.median(difference_mm(avatar, plain)) < 1.5
    roll = avatar.fit.camera.yaw_pitch_roll_deg()[2] - plain.fit.camera.yaw_pitch_roll_deg()[2]
    assert (roll - 90 + 180) % 360 - 180 == pytest.approx(0, abs=3)


def test_the_camera_puts_the_head_where_the_face_is(plain: Avatar) -> None:
    """The manifest's formula on the vertices of the OBJ file meets the detector's landmarks.

    A transposed rotation, a flipped axis, a principal point half a pixel off its convention by the size of the image,
    or an OBJ in another unit puts the head somewhere else.
    """
    members = archive_members(plain)
    lines = members["mesh/head.obj"].decode().splitlines()
    vertices = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)
    head, camera = plain.head, json.loads(members["manifest.json"])["camera"]
    assert vertices.shape == head.mean.shape
    points = at_barycentric(vertices, head.triangles[head.landmark_triangle], head.landmark_barycentric)
    x, y, z = np.array(camera["rotation"]) @ points.T + np.array(camera["translation"])[:, None]
    assert (z > 0.2).all() and camera["rotation"][2][2] < 0, "the face looks at the camera, in front of it"
    pixels = camera["focal_px"] * np.stack([x, y], 1) / z[:, None] + camera["principal_point"]
    gap = np.linalg.norm(pixels - plain.face.landmarks[:, :2], axis=1)
    steady = ~np.isin(np.arange(len(gap)), head.contour_landmarks)
    eyes = np.linalg.norm(np.subtract(*plain.face.landmarks[[[33, 133], [362, 263]], :2].mean(1)))
    assert np.sqrt(np.mean(gap[steady] ** 2)) < 0.05 * eyes


def test_another_head_model_takes_the_place_of_ours(portrait: Pixels, plain: Avatar, tmp_path: Path) -> None:
    """A user's own file, here a bare skin without blendshapes: the archive is of that head and says whose it is."""
    skin = plain.head.polygon_part == 0
    flat = plain.head.triangle_part == 0
    bare = replace(
        plain.head,
        name="another",
        licence="LicenseRef-mine",
        identity=plain.head.identity[:20],
        expression=plain.head.expression[:0],
        expression_names=(),
        polygons=plain.head.polygons[skin],
        polygon_uv=plain.head.polygon_uv[skin],
        polygon_part=plain.head.polygon_part[skin],
        part_names=("skin",),
        triangles=plain.head.triangles[flat],
        triangle_uv=plain.head.triangle_uv[flat],
        triangle_part=plain.head.triangle_part[flat],
        landmark_triangle=(np.cumsum(flat) - 1)[plain.head.landmark_triangle].astype(np.int32),
        contour_triangle=(np.cumsum(flat) - 1)[plain.head.contour_triangle].astype(np.int32),
    )
    assert flat[plain.head.landmark_triangle].all(), "landmarks lie on the skin"
    save_head(bare, tmp_path / "another.npz")
    members = archive_members(make_avatar(png(portrait), QUICK, head_file=tmp_path / "another.npz"))
    manifest = json.loads(members["manifest.json"])
    assert (manifest["head"]["name"], manifest["head"]["licence"]) == ("another", "LicenseRef-mine")
    assert manifest["head"]["parts"] == ["skin"] and manifest["head"]["blendshapes"] == []
    digest = hashlib.sha256((tmp_path / "another.npz").read_bytes()).hexdigest()
    assert [model["sha256"] for model in manifest["models"] if model["name"] == "another"] == [digest]
    assert b"LicenseRef-mine" in members["LICENSES.md"]
    assert members["mesh/head.obj"].count(b"\nf ") == skin.sum()
