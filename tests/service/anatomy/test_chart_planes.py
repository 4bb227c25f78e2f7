"""Where lashes grow along the edges of the lids."""

from __future__ import annotations

from service.anatomy.canvas import lash_line
from service.geometry.chart import Chart
from service.head.files import load_head
from service.head.regions import vertex_mask
from service.reflectance.subject import GEOMETRY_SIZE, Subject
from service.runtime.network_registry import CLUES, COVERED
from tests.toyhead import sphere_head

HEAD = load_head()
CHART = Chart.build(HEAD, 576, 384)


def test_lashes_are_dense_above_and_sparse_below_and_nowhere_else() -> None:
    line = CHART.spread(lash_line(CHART)[:, None])[..., 0]
    upper, lower, lids = (
        CHART.spread(CHART.inside(vertex_mask(HEAD, *names)[:, None]))[..., 0]
        for names in (
            ("eyelid_upper_left", "eyelid_upper_right"),
            ("eyelid_lower_left", "eyelid_lower_right"),
            ("eyelid_left", "eyelid_right", "eye_socket"),
        )
    )
    assert line[upper > 0.9].max() > 0.7 > 0.4 > line[lower > 0.9].max() > 0.2
    assert line[lids < 0.01].max() == 0
    subject = Subject(HEAD, HEAD.mean, Chart.build(HEAD, *GEOMETRY_SIZE))
    covered = dict(zip(CLUES, subject.clues, strict=True))[COVERED]
    drawn = subject.chart.spread(lash_line(subject.chart)[:, None])[..., 0]
    assert covered[drawn > 0.5].min() > 0.8  # no groove in the normals
    toy = Chart.build(sphere_head(24, 48), 192, 128)
    assert not lash_line(toy).any()
