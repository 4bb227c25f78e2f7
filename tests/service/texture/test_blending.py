"""One texture of several photos: light brought together, the best views, what moves outvoted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from service.face.finder import Face
from service.face.fit.fit import Fit
from service.face.reading.part_labels import PARTS
from service.face.reading.part_labels import SKIN as SKIN_PART
from service.face.reading.reader import View
from service.geometry.chart import Chart
from service.map_registry import SEEN
from service.texture.texture import Texture, make_texture
from tests.service.texture.scenes import SKIN, bare, checks, fitted, photograph, plain, read_off, turned
from tests.toyhead import sphere_head

HEAD = sphere_head(40, 60)
CHART = Chart.build(HEAD, 288, 192)
SKIN_MASK = CHART.part == 0
Paint = Callable[[np.ndarray], np.ndarray]


def seen(yaw: float, paint: Paint) -> tuple[View, Fit]:
    camera = turned(yaw)
    face = Face(np.zeros(4), 0.9, np.zeros((6, 2)), np.zeros((468, 3)), 1.0)
    return View(photograph(HEAD, camera, paint), face, bare(HEAD, camera)), fitted(HEAD, camera)


def textured(*photos: tuple[View, Fit]) -> Texture:
    (view, fit), *others = photos
    return make_texture(view.photo, fit, CHART, view.reading, False, others)


def dimmed(paint: Paint, share: float) -> Paint:
    """The same in other light: factors of linear values, about."""
    return lambda points: np.asarray(paint(points)) * share ** (1 / 2.2) * np.array([1.0, 0.97, 0.9])


def test_another_exposure_and_white_balance_are_brought_to_the_first_photo() -> None:
    """A dim, yellow photo from the side leaves no step on the cheek."""
    whole = textured(seen(0, plain(SKIN)), seen(-50, dimmed(plain(SKIN), 0.25)), seen(50, dimmed(plain(SKIN), 0.5)))
    where = SKIN_MASK & (whole.confidence >= SEEN)
    assert np.abs(whole.texture[where] / 255 - np.array(SKIN)).max(-1).mean() < 0.02


@pytest.mark.parametrize(
    ("beside", "known", "gone"), [(3, False, True), (2, False, True), (1, False, False), (1, True, True)]
)
def test_what_one_photo_has_is_outvoted_by_two_others_or_known_by_its_reading(
    beside: int, known: bool, gone: bool
) -> None:
    """Something dark before the face, which the reading calls glasses or does not know; two photos cannot vote."""

    def spot(points: np.ndarray) -> np.ndarray:
        nose = HEAD.mean[np.argmax(HEAD.mean[:, 2])]
        return np.asarray(np.linalg.norm(points - nose, axis=1) < 0.02)

    first, fit = seen(0, lambda points: np.where(spot(points)[:, None], 0.1, np.asarray(SKIN)))
    if known:
        read = read_off(HEAD, turned(0), lambda points: np.where(spot(points), PARTS.index("glasses"), SKIN_PART))
        first = replace(first, reading=read)
    whole = textured((first, fit), *[seen(yaw, plain(SKIN)) for yaw in (-15, 15, 4)[:beside]])
    assert (whole.texture[SKIN_MASK].min(-1).min() > 0.7 * 255 * min(SKIN)) == gone


def test_shares_of_the_photos_add_up_where_any_shows_the_head() -> None:
    whole = textured(seen(0, checks), seen(-50, checks))
    total = np.sum([one.share.astype(int) for one in whole.photos], 0)
    where = SKIN_MASK & np.any([one.seen > 128 for one in whole.photos], 0)
    assert (np.abs(total[where] - 255) <= 2).mean() > 0.99


def test_it_is_known_how_many_photos_show_a_texel() -> None:
    whole, alone = textured(seen(0, checks), seen(-50, checks)), textured(seen(0, checks))
    assert whole.seen_by is not None and alone.seen_by is None
    assert set(np.unique(whole.seen_by[SKIN_MASK])) == {0, 1, 2}
    squarely = SKIN_MASK & (alone.confidence > 240)
    assert (whole.seen_by[squarely] >= 1).all()
    assert (whole.seen_by[SKIN_MASK & (whole.confidence < SEEN)] == 0).mean() > 0.9
