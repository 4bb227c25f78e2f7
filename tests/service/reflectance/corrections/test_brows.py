"""Brows keep the depth of their colour: light under them is that of the skin around."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from service.anatomy.brows import brow_plane
from service.colour import FULL_CODE, linear_to_srgb
from service.geometry.chart import Chart
from service.head.files import load_head
from service.reflectance.chart_light import found_by
from service.reflectance.corrections.brows import NONE, under_brows
from service.reflectance.diffuse_albedo import CONTEXT
from service.reflectance.normals import SPECULAR, tangent_normals
from service.reflectance.planes import Planes
from service.reflectance.result import unpack_normals
from service.reflectance.subject import BROWS, CLUES, COVERED, GEOMETRY, Subject
from service.reflectance.translate import MapInputs
from service.runtime.networks import Engine, open_network
from tests.service.archive.toys import toy_head
from tests.service.reflectance.toys import toy_folder

HEAD = load_head(None)
SIZE = (288, 192)


def region(*names: str) -> np.ndarray:
    """(h, w) of the head's regions on the context's chart."""
    chart = Chart.build(HEAD, *SIZE)
    return np.asarray(chart.interpolate(np.sum([HEAD.region(name) for name in names], 0)[:, None])[..., 0] * chart.mask)


def test_brows_lie_where_the_head_has_them_and_a_little_beside() -> None:
    brow = brow_plane(Chart.build(HEAD, *SIZE))
    own = region("brow_left", "brow_right")
    assert brow[own > 0.5].min() == 1
    assert brow[region("cheek_left", "cheek_right") > 0.5].max() == 0
    assert own[own > 0.3].size < (brow > 0.5).sum() < 3 * (own > 0.3).sum()
    np.testing.assert_allclose(brow, brow[:, ::-1], atol=0.2)


def test_a_head_that_names_no_brows_keeps_its_light() -> None:
    brow = brow_plane(Chart.build(toy_head(), 96, 64))
    assert brow.shape == (64, 96) and not brow.any()
    light = np.random.default_rng(0).normal(size=(3, 64, 96)).astype(np.float32)
    assert np.array_equal(under_brows(light, light, np.ones((64, 96), np.float32), brow), light)


def test_what_was_found_under_brows_does_not_count() -> None:
    """Smooth light, and brows that were taken for shade: the light comes back, and changes nowhere else."""
    row, column = np.mgrid[: SIZE[1], : SIZE[0]].astype(np.float32)
    true = np.stack([0.002 * row + 0.001 * column + k for k in range(3)]).astype(np.float32)
    brow = brow_plane(Chart.build(HEAD, *SIZE))
    found = np.where(brow > NONE, true - np.float32(1), true)
    lit = np.ones(SIZE[::-1], np.float32)
    result = under_brows(found, found, lit, brow)
    inside = region("brow_left", "brow_right") > 0.5
    assert np.abs((result - true)[:, inside]).max() < 0.1
    assert np.array_equal(result[:, brow == 0], true[:, brow == 0])
    assert np.array_equal(under_brows(found, found, lit * 0, brow), found), "no skin to go on from"
    all_brows = under_brows(found, found, lit, np.ones_like(brow))
    assert np.array_equal(all_brows, found), "a weight of zero would be divided by"


def test_a_darker_brow_is_darker_in_the_albedo() -> None:
    """The network in the box, with brows painted on a plain face: their light may not follow their colour."""
    subject = Subject.of(HEAD, HEAD.mean)
    depth = region("brow_left", "brow_right")
    lights = []
    with open_network(CONTEXT, Engine(threads=2)) as network:
        for painted in (0.0, 1.2):
            skin = np.array([0.40, 0.23, 0.16], np.float32) * np.exp(-np.float32(painted) * depth)[..., None]
            planes = Planes(SIZE)
            coded = np.rint(linear_to_srgb(skin.astype(np.float32)) * FULL_CODE).astype(np.uint16)
            planes.add_codes("texture", coded)
            planes.add_coarse(GEOMETRY, subject.geometry)
            planes.add_coarse(CLUES, subject.clues)
            lights.append(found_by(network, planes).light[:3].mean(0))
    change = (lights[1] - lights[0])[depth > 0.5]
    assert change.mean() > -0.15, f"{-change.mean():.2f} of {1.2 * depth[depth > 0.5].mean():.2f} was taken for shade"
    assert BROWS in CLUES


def test_relief_is_flatter_under_cover_and_the_same_elsewhere(tmp_path: Path) -> None:
    """Strands are dark lines, which a network that knows creases would carve into the skin."""
    engine, size = Engine(threads=1, folder=toy_folder(tmp_path)), (48, 32)
    rng = np.random.default_rng(3)
    brow = np.zeros((32, 48), np.float32)
    brow[:, :16] = 1
    found = []
    for clues in (None, brow):
        planes = Planes(size)
        planes.add_grey("shaded_grey", np.full((32, 48), 30000, np.uint16))
        planes.add_coarse(GEOMETRY, rng.normal(size=(len(GEOMETRY), 32, 48)).astype(np.float32))
        if clues is not None:
            planes.add_coarse([COVERED], clues[None])
        job = MapInputs(planes, np.full((32, 48), 255, np.uint8), engine, 256, lambda _: None)
        found.append(unpack_normals(tangent_normals(SPECULAR, job)))
        rng = np.random.default_rng(3)
    plain, flatter = (np.linalg.norm(each[..., :2], axis=2) for each in found)
    assert np.array_equal(plain[:, 20:], flatter[:, 20:])
    assert flatter[:, :14].mean() < 0.75 * plain[:, :14].mean()
    assert plain.max() > 0.1


def test_hair_and_glasses_cover_skin_and_made_up_skin_is_bare() -> None:
    """A frame across the nose is a dark line; necks that no photo showed keep their pores."""
    lit, inpainted = np.ones((64, 96), np.float32), np.zeros((64, 96), np.float32)
    lit[28:34] = 0
    lit[50:], inpainted[50:] = 0, 1
    subject = replace(Subject.of(HEAD, HEAD.mean), lit=lit, inpainted=inpainted)
    clues = dict(zip(CLUES, subject.clues, strict=True))
    skin = subject.bare((768, 512)) > 0.99
    beside = cv2.GaussianBlur(clues[BROWS], (0, 0), 5.0) < 0.01
    assert clues[COVERED][cv2.erode(clues[BROWS], np.ones((9, 9))) > 0.99].min() > 0.7
    assert clues[COVERED][232:264][(skin & beside)[232:264]].min() > 0.9
    assert clues[COVERED][420:][(skin & beside)[420:]].max() < 0.02, "made up"
    assert clues[COVERED][300:380][(skin & beside)[300:380]].max() < 0.02, "lit"
    scalp = (subject.bare((768, 512)) < 0.01) & (subject.own_skin > 0)
    assert scalp.sum() > 1000
    assert clues[COVERED][scalp].min() > 0.98, "fair hair is taken for lit skin, and its strands for creases"
