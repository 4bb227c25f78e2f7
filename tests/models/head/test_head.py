"""The head model in the box: what the other stages take for granted."""

from __future__ import annotations

from collections import Counter

import numpy as np
import numpy.typing as npt
import pytest

from models.head.build import variance_weights
from models.head.chart.measure import HEIGHT, WIDTH, measure, overlap_texels, percentiles
from models.head.digest import BASE_NAME
from models.head.embedding import CONTOUR
from models.head.expression import PARTNERS
from service.head.files import load_head
from service.head.model import HeadModel

FLIP = np.array([-1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_head()


def part(head: HeadModel, name: str) -> npt.NDArray[np.int64]:
    return np.unique(head.triangles[head.triangle_part == head.part_names.index(name)])


def test_name(head: HeadModel) -> None:
    assert head.name == BASE_NAME
    assert head.licence == "CC0-1.0"


def test_the_52_arkit_names(head: HeadModel) -> None:
    """Apple's list, in any order; a misspelt unit would be silently dead in every renderer."""
    sided = "browDown browOuterUp cheekSquint eyeBlink eyeLookDown eyeLookIn eyeLookOut eyeLookUp eyeSquint eyeWide "
    sided += "mouthDimple mouthFrown mouthLowerDown mouthPress mouthSmile mouthStretch mouthUpperUp noseSneer jaw mouth"
    single = (
        "browInnerUp cheekPuff jawForward jawOpen mouthClose mouthFunnel mouthPucker mouthRollLower mouthRollUpper "
    )
    single += "mouthShrugLower mouthShrugUpper tongueOut"
    wanted = {s + side for s in sided.split() for side in ("Left", "Right")} | set(single.split())
    assert len(wanted) == 52
    assert set(head.expression_names) == wanted


def test_mirror_is_an_involution_that_maps_the_mean_onto_itself(head: HeadModel) -> None:
    np.testing.assert_array_equal(head.mirror[head.mirror], np.arange(len(head.mean)))
    np.testing.assert_allclose(head.mean[head.mirror] * FLIP, head.mean, atol=2e-7)


def test_mirrored_polygons_are_polygons(head: HeadModel) -> None:
    known = Counter(tuple(sorted(t)) for t in head.triangles.tolist())
    image = Counter(tuple(sorted(t)) for t in head.mirror[head.triangles].tolist())
    assert known == image


def test_units_are_mirror_images(head: HeadModel) -> None:
    table = dict(zip(head.expression_names, head.expression, strict=True))
    for name, offset in table.items():
        np.testing.assert_allclose(offset[head.mirror] * FLIP, table[PARTNERS[name]], atol=2e-5, err_msg=name)


def test_components_are_symmetric_or_antisymmetric(head: HeadModel) -> None:
    kinds = []
    for component in head.identity:
        image = component[head.mirror] * FLIP
        size = np.abs(component).max()
        even, odd = np.abs(image - component).max() / size, np.abs(image + component).max() / size
        assert min(even, odd) < 5e-3
        kinds.append(even < odd)
    assert kinds[0]
    assert 0 < sum(kinds) < len(kinds)


def test_components_are_orthogonal_and_ordered(head: HeadModel) -> None:
    """Under the weights of the PCA, up to half precision; else a prior of independent coefficients would be wrong.

    Eyes, teeth and tongue, which had a small part in it, are put in their places afterwards and do not count.
    """
    weight = variance_weights(head) * np.isin(np.arange(len(head.mean)), part(head, "skin"))
    flat = (head.identity.astype(float) * np.sqrt(weight)[None, :, None]).reshape(len(head.identity), -1)
    size = np.linalg.norm(flat, axis=1)
    assert (np.diff(size) < 1e-3 * size[0]).all()
    cosine = (flat / size[:, None]) @ (flat / size[:, None]).T
    assert np.abs(cosine - np.eye(len(cosine))).max() < 0.04


def test_adult_measures(head: HeadModel) -> None:
    """Eye distance 63 +- 3.7 mm (Zhuang and Bradtmiller 2005); the frame is metres, faces +Z, eyes about the origin."""
    balls = [head.mean[part(head, f"eye_{side}")] for side in ("left", "right")]
    centres = np.array([0.5 * (ball.min(0) + ball.max(0)) for ball in balls])
    basis = np.stack([head.identity[:, part(head, f"eye_{s}")].mean(1) for s in ("left", "right")])
    assert centres[0, 0] > 0
    assert np.abs(centres.mean(0)).max() < 3e-4
    assert 0.0605 < np.linalg.norm(centres[0] - centres[1]) < 0.0655
    spread = np.sqrt(((basis[0, :, 0] - basis[1, :, 0]) ** 2).sum())
    assert 0.0025 < spread < 0.005
    tip = np.average(head.mean, axis=0, weights=head.region("nose_tip") ** 4)
    assert tip[2] > 0.03
    assert abs(tip[0]) < 1e-3
    assert tip[1] < -0.03


def _outside(head: HeadModel, vertices: npt.NDArray[np.float32], name: str) -> npt.NDArray[np.float64]:
    """How far lid vertices lie outside the eyeball's sphere, metres."""
    ball = vertices[part(head, name)].astype(float)
    centre = 0.5 * (ball.min(0) + ball.max(0))
    radius = np.linalg.norm(ball - centre, axis=1).mean()
    lids = np.flatnonzero(head.region(name.replace("eye_", "eyelid_")) > 0.9)
    return np.asarray(np.linalg.norm(vertices[lids].astype(float) - centre, axis=1) - radius)


def test_lids_stay_outside_the_eyeballs(head: HeadModel) -> None:
    random = np.random.default_rng(0)
    heads = [head.mean] + [head.shape(random.normal(size=len(head.identity))) for _ in range(12)]
    for vertices in heads:
        for name in ("eye_left", "eye_right"):
            gap = _outside(head, vertices, name)
            assert np.percentile(gap, 10) > -0.0025
            assert np.median(gap) < 0.012


def test_eyeballs_stay_round(head: HeadModel) -> None:
    """Each head's eyeball is an affine image of the mean one; an egg would show in the iris."""
    random = np.random.default_rng(1)
    ball = part(head, "eye_left")
    before = np.c_[head.mean[ball].astype(float), np.ones(len(ball))]
    for _ in range(12):
        after = head.shape(random.normal(size=len(head.identity))).astype(float)[ball]
        affine, misfit = np.linalg.lstsq(before, after, rcond=None)[:2]
        assert np.sqrt(misfit / len(ball)).max() < 2e-4
        scale = np.linalg.svd(affine[:3], compute_uv=False)
        assert scale[0] / scale[2] < 1.2


def test_looking_turns_the_eyeball_the_right_way(head: HeadModel) -> None:
    """The pole of the eyeball is its foremost vertex; each unit must move it, and the other eye must rest."""
    table = dict(zip(head.expression_names, head.expression, strict=True))
    for side, out in (("Left", 1.0), ("Right", -1.0)):
        ball = part(head, f"eye_{side.lower()}")
        other = part(head, f"eye_{'right' if side == 'Left' else 'left'}")
        pole = ball[np.argmax(head.mean[ball, 2])]
        for name, direction in (
            ("Up", [0, 1, 0]), ("Down", [0, -1, 0]), ("Out", [out, 0, 0]), ("In", [-out, 0, 0]),
        ):  # fmt: skip
            move = table[f"eyeLook{name}{side}"]
            assert move[pole] @ np.array(direction) > 0.002
            assert np.abs(move[other]).max() < 1e-6


def test_jaw_takes_teeth_and_tongue_along(head: HeadModel) -> None:
    table = dict(zip(head.expression_names, head.expression, strict=True))
    jaw = table["jawOpen"]
    assert jaw[part(head, "teeth_lower"), 1].mean() < -0.01
    assert jaw[part(head, "tongue"), 1].mean() < -0.005
    assert np.abs(jaw[part(head, "teeth_upper")]).max() < 1e-4
    assert table["tongueOut"][part(head, "tongue"), 2].max() > 0.01
    blink = table["eyeBlinkLeft"]
    assert blink[part(head, "lashes"), 1].min() < -0.005


def test_skin_is_a_disc_with_one_rim(head: HeadModel) -> None:
    """The only opening of the skin is the cut through the neck: sockets, nostrils and mouth are closed bags."""
    skin = head.triangles[head.triangle_part == 0]
    sides = np.concatenate([skin[:, [0, 1]], skin[:, [1, 2]], skin[:, [2, 0]]])
    directed = {(int(a), int(b)) for a, b in sides}
    assert len(directed) == len(sides)
    rim = {a: b for a, b in directed if (b, a) not in directed}
    start = next(iter(rim))
    walk = [start]
    while rim[walk[-1]] != start:
        walk.append(rim[walk[-1]])
    assert len(walk) == len(rim)
    assert head.mean[walk, 1].max() < -0.09
    edges = len({frozenset(s) for s in directed})
    assert len(np.unique(skin)) - edges + len(skin) == 1


def test_eyeballs_and_tongue_are_closed(head: HeadModel) -> None:
    for name in ("eye_left", "eye_right", "tongue"):
        faces = head.triangles[head.triangle_part == head.part_names.index(name)]
        sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        directed = {(int(a), int(b)) for a, b in sides}
        assert all((b, a) in directed for a, b in directed), name


def test_outward_orientation(head: HeadModel) -> None:
    corner = head.mean[head.triangles].astype(float)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    middle = corner.mean(1)
    cheek = head.region("cheek_left")[head.triangles].mean(1) > 0.5
    assert (normal[cheek, 2] > 0).all()
    for name in ("eye_left", "eye_right"):
        faces = head.triangle_part == head.part_names.index(name)
        assert ((normal[faces] * (middle[faces] - middle[faces].mean(0))).sum(1) > 0).all()


def test_no_triangle_without_area(head: HeadModel) -> None:
    m = measure(head)
    assert m.area_mm2.min() > 1e-3
    assert (m.signed_px2 > 1e-2).all()


def test_chart_does_not_overlap(head: HeadModel) -> None:
    assert head.uv.min() >= 0
    assert head.uv.max() <= 1
    assert overlap_texels(head, 2048) == 0


def test_chart_is_mirror_symmetric(head: HeadModel) -> None:
    """u <-> 1 - u swaps the sides: every triangle's mirror image in the chart is the chart of its mirror image."""
    table = {}
    for triangle, corners in zip(head.triangles.tolist(), head.triangle_uv.tolist(), strict=True):
        order = np.argsort(triangle)
        table[tuple(np.array(triangle)[order])] = head.uv[np.array(corners)[order]]
    for triangle, corners in zip(head.triangles.tolist(), head.triangle_uv.tolist(), strict=True):
        image = head.mirror[triangle]
        order = np.argsort(image)
        mine = head.uv[np.array(corners)[order]] * [-1, 1] + [1, 0]
        np.testing.assert_allclose(mine, table[tuple(image[order])], atol=1e-6)


def test_chart_stretch_and_scale(head: HeadModel) -> None:
    m = measure(head)
    face = head.region("face")[head.triangles].mean(1) > 0.5
    rest = (head.triangle_part == 0) & ~face & ((head.region("mouth_inner")[head.triangles] < 0.5).all(1))
    assert percentiles(m.stretch, m.area_mm2 * face, (0.9, 0.96)) < [1.7, 2.2]
    assert percentiles(m.stretch, m.area_mm2 * rest, (0.5, 0.9)) < [2.6, 4.5]
    for side in ("left", "right"):
        cheek = head.region(f"cheek_{side}")[head.triangles].mean(1) > 0.5
        assert percentiles(m.ppm, m.area_mm2 * cheek, (0.5,))[0] > 14.0
    assert np.abs(m.signed_px2).sum() > 0.8 * WIDTH * HEIGHT


def test_islands_keep_their_distance(head: HeadModel) -> None:
    """16 pixels at full size, so that filtering and smaller maps do not bleed from one island into the next."""
    from scipy.ndimage import maximum_filter, minimum_filter
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    from service.geometry.raster import rasterise

    size = len(head.uv)
    t = head.triangle_uv
    graph = coo_matrix((np.ones(2 * len(t)), (np.r_[t[:, 0], t[:, 1]], np.r_[t[:, 1], t[:, 2]])), shape=(size, size))
    label = connected_components(graph, directed=False)[1]
    width, height = WIDTH // 4, HEIGHT // 4
    raster = rasterise(head.uv * [width, -height] + [0, height], np.zeros(size), t, width, height)
    island = np.where(raster.mask, label[t[:, 0]][raster.triangle], -1)
    least = 16 / 4 - 1.5
    reach = np.arange(-2, 3)
    disc = np.hypot(reach, reach[:, None]) < least
    highest = maximum_filter(island, footprint=disc)
    lowest = minimum_filter(np.where(raster.mask, island, size), footprint=disc)
    assert (highest == island)[raster.mask].all() and (lowest == island)[raster.mask].all()


def test_landmarks_lie_on_the_skin(head: HeadModel) -> None:
    assert len(head.landmark_triangle) == 468
    inner = head.region("mouth_inner") + head.region("eye_socket")
    for triangles in (head.landmark_triangle, head.contour_triangle.ravel()):
        assert (head.triangle_part[triangles] == 0).all()
        assert (inner[head.triangles[triangles]].max(1) < 1).all()
    assert tuple(head.contour_landmarks) == CONTOUR
    points = (head.mean[head.triangles[head.landmark_triangle]] * head.landmark_barycentric[..., None]).sum(1)
    assert points[33, 0] < -0.03  # outer corner of the subject's right eye
    assert points[263, 0] > 0.03
    assert points[1, 2] > points[:, 2].max() - 0.01  # nose tip
    assert points[152, 1] < points[0, 1] < points[1, 1] < points[168, 1] < points[10, 1]
    assert (head.landmark_spread > 0).all()
    assert head.landmark_spread.max() < 0.02


def test_contour_slides_with_the_pose(head: HeadModel) -> None:
    """Turning towards the image right (yaw > 0) hides the subject's left side: its outline moves to the front there."""
    corners = head.mean[head.triangles[head.contour_triangle]]
    points = (corners * head.contour_barycentric[..., None]).sum(2)
    cheek = list(head.contour_landmarks).index(454)  # subject's left, beside the ear when seen from the front
    zero, turned = np.argmin(np.abs(head.contour_yaw_deg)), np.argmax(head.contour_yaw_deg)
    assert points[turned, cheek, 2] > points[zero, cheek, 2] + 0.01


def test_regions_are_where_they_should_be(head: HeadModel) -> None:
    for name in head.region_names:
        mask = head.region(name)
        assert mask.min() >= 0
        assert 0.5 < mask.max() <= 1
        other = name.replace("_left", "_") if "_left" in name else name
        twin = name.replace("_left", "_right") if other != name else name.replace("_right", "_left")
        np.testing.assert_allclose(mask[head.mirror], head.region(twin), atol=1e-3)
    centre = {n: np.average(head.mean, axis=0, weights=head.region(n)) for n in head.region_names}
    assert centre["brow_left"][1] > centre["eyelid_left"][1] > centre["nose_tip"][1] > centre["lip_upper"][1]
    assert centre["lip_upper"][1] > centre["lip_lower"][1] > centre["chin"][1] > centre["neck"][1]
    assert centre["ear_left"][0] > 0.05 > -0.05 > centre["ear_right"][0]
    assert centre["scalp"][2] < centre["face"][2]
