"""Strips of lashes in tools that know no opacity."""

from __future__ import annotations

import numpy as np

from service.anatomy.lashes.cards import PART, colour_cards
from service.geometry.chart import NO_PART
from service.head.files import load_head
from service.reflectance.subject import Subject, margin
from tests.service.reflectance.toys import toy_subject


def test_lashes_have_the_colour_of_the_lids_and_nothing_else_changes() -> None:
    """Dark strips would lie over the eyes like a mask; and no other island may be painted over."""
    head = load_head()
    subject = Subject.of(head, head.mean)
    size = (1536, 1024)
    part = subject.islands(size)
    lashes = part == head.part_names.index(PART)
    assert lashes.any()
    albedo = np.full((*size[::-1], 3), (30000, 20000, 15000), np.uint16)
    albedo[part != head.part_names.index("skin")] = 900
    before = albedo.copy()
    painted = colour_cards(albedo, subject.chart, margin(size[0]))
    assert np.abs(painted[lashes].astype(int) - (30000, 20000, 15000)).max() <= 1
    others = (part != NO_PART) & ~lashes
    assert np.array_equal(painted[others], before[others])
    rows, columns = np.nonzero(lashes)
    assert (painted[rows.clip(1) - 1, columns] != 900).any(axis=-1)[part[rows.clip(1) - 1, columns] == NO_PART].all()


def test_a_head_without_lashes_stays_as_it_is() -> None:
    """An imported head has no such part, nor regions of lids."""
    albedo = np.random.default_rng(0).integers(0, 65535, (64, 96, 3), np.uint16)
    assert np.array_equal(colour_cards(albedo.copy(), toy_subject().chart, 1), albedo)


def test_lids_of_the_head() -> None:
    """Both eyes' on the head in the box, none on one without such regions."""
    head = load_head()
    lids = Subject.of(head, head.mean).lids
    half = lids.shape[1] // 2
    assert abs(lids[:, :half].sum() / lids[:, half:].sum() - 1) < 0.02 and lids.min() >= 0 and lids.max() > 0.5
    assert not toy_subject().lids.any()
