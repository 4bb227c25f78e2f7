"""The reader's way from photo to reading, with a network whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from service.errors import NumericFault
from service.face.reading.openings import Landmarker, OpeningsNetwork
from service.face.reading.part_labels import BACKGROUND, HAIR, PARTS, SKIN
from service.face.reading.reader import (
    CELLS,
    PART_CELLS,
    ReaderNetwork,
    Readers,
    Reading,
    crop_of,
    parts_at_pixels,
    read_face,
)
from service.face.reading.segments import SegmenterNetwork
from service.face.region import Region
from service.geometry.camera import ahead, exp_rotation
from tests.service.face.geometry import oval


class Known:
    """Says of a crop: u grows to the right, v upwards, everything faces up and to the left, part by brightness."""

    name, outputs = "reader", ("chart", "chart_mm", "normal", "normal_sine", "parts")

    def __init__(self, twist: float = 0.0) -> None:
        self.twist, self.seen = twist, []  # type: tuple[float, list[np.ndarray]]

    def run(self, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        crop = inputs["crop"]
        self.seen.append(crop)
        x = np.tile((np.arange(CELLS) + 0.5) / CELLS, (CELLS, 1))
        chart = np.stack([x + self.twist, 1 - x.T])[None]
        normal = np.tile(np.array([-0.6, 0.0, -0.8])[None, :, None, None], (1, 1, CELLS, CELLS))
        if len(self.seen) % 2 == 0:  # what a true network says of the mirror image
            normal = normal * np.array([-1.0, 1.0, 1.0])[None, :, None, None]
        parts = np.zeros((1, len(PARTS), PART_CELLS, PART_CELLS))
        parts[:, 1] = np.where(crop[:, 0, ::2, ::2] > 0.5, 9.0, -9.0)
        one = np.ones((1, 1, CELLS, CELLS))
        return [a.astype(np.float32) for a in (chart, one * 2.0, normal, one * 0.1, parts)]


CLASS_LOGITS = (-5.0, 5.0), (-5.0, -5.0), (-5.0, -5.0), (5.0, -5.0), (-5.0, -5.0), (-5.0, -5.0)
"""Of the segmentation's classes, above and below: a face above, background below."""


class Faulty:
    """Gives no numbers."""

    def run(self, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        raise NumericFault("NaN")


def readers(pixels: Known, segmenter: SegmenterNetwork | bool = False) -> Readers:
    """The network of pixels, and none that answers of lids, lips and expression."""
    no = Faulty()
    openings = OpeningsNetwork({"lids": no, "lips": no})  # type: ignore[dict-item]
    return Readers(ReaderNetwork(pixels), openings, Landmarker((no, no)), segmenter)  # type: ignore[arg-type]


@pytest.mark.parametrize("landmarks", [np.full((468, 3), np.nan), np.zeros((468, 3))])
def test_landmarks_without_extent_give_no_crop(landmarks: np.ndarray) -> None:
    """A crop of no size would divide by zero."""
    assert crop_of(landmarks) is None
    assert read_face(np.zeros((9, 9, 3), np.uint8), landmarks, readers(Known())) is None


def test_what_is_mirrored_is_turned_back() -> None:
    """u of the mirrored crop counts from the other side; not turned back, the average would be one half everywhere."""
    network = Known()
    pixels = np.zeros((400, 600, 3), np.uint8)
    pixels[:, 300:] = 255
    reading = ReaderNetwork(network)(pixels, Region(300, 200, 256))  # type: ignore[arg-type]
    assert np.array_equal(network.seen[1], network.seen[0][..., ::-1])
    expected = (np.arange(CELLS) + 0.5) / CELLS
    assert np.allclose(reading.chart[:, :, 0], expected[None], atol=1e-6)
    assert np.allclose(reading.normal, [-0.6, 0.0, -0.8], atol=1e-6)
    assert np.allclose(reading.parts.sum(-1), 1.0, atol=1e-5)
    middle = PART_CELLS // 2
    assert (reading.parts[:, middle + 1 :, 1] > 0.9).all() and (reading.parts[:, : middle - 1, 1] < 0.1).all()


def test_a_turned_crop_gives_normals_of_the_photo() -> None:
    straight = ReaderNetwork(Known())(np.zeros((400, 600, 3), np.uint8), Region(300, 200, 256))  # type: ignore[arg-type]
    turned = ReaderNetwork(Known())(np.zeros((400, 600, 3), np.uint8), Region(300, 200, 256, 0.5))  # type: ignore[arg-type]
    turn = exp_rotation(np.array([0.0, 0.0, 0.5]))
    assert np.allclose(turned.normal, straight.normal @ turn.T, atol=1e-6)
    assert np.allclose(np.linalg.norm(turned.camera_normals(500.0, np.array([100.0, 90.0])), axis=-1), 1.0)


def test_a_network_without_numbers_is_no_reading() -> None:
    class Broken(Known):
        def run(self, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
            raise NumericFault("network reader: output chart has 4 of 8192 values that are NaN or Inf")

    assert read_face(np.zeros((400, 600, 3), np.uint8), oval(0.0), readers(Broken())) is None


@pytest.mark.parametrize("ray", [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [np.nan, 0.0, 1.0]])
def test_a_ray_that_does_not_lead_forward_is_refused(ray: list[float]) -> None:
    with pytest.raises(ValueError, match="forward"):
        ahead(np.array(ray))


def test_the_segmentation_counts_where_it_is_not_switched_off_and_gives_numbers(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Above:
        """Sees a face in the upper half of the square, background below: misses some of the face."""

        def run(self, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
            upper = np.arange(256)[:, None] < 128
            return [np.stack([np.where(upper, *c) + np.zeros((256, 256)) for c in CLASS_LOGITS], -1)[None]]

    pixels = np.zeros((400, 600, 3), np.uint8)
    pixels[:240] = 255
    plain = read_face(pixels, oval(0.0), readers(Known()))
    weighed = read_face(pixels, oval(0.0), readers(Known(), SegmenterNetwork(Above())))  # type: ignore[arg-type]
    with caplog.at_level("WARNING"):
        blind = read_face(pixels, oval(0.0), readers(Known(), SegmenterNetwork(Faulty())))  # type: ignore[arg-type]
    assert plain is not None and weighed is not None and blind is not None
    assert np.array_equal(blind.parts, plain.parts) and blind.segments is None
    assert "not told apart" in caplog.text and "NaN" in caplog.text
    assert plain.segments is None and weighed.segments is not None
    assert (weighed.parts[..., BACKGROUND] - plain.parts[..., BACKGROUND]).max() > 0.01
    assert readers(Known()).segmenter is None and readers(Known(), True).segmenter is not None


def reading(side: float, hair: float, around: Reading | None = None) -> Reading:
    """A crop around (200, 200) that shows skin, and hair with some probability."""
    parts = np.zeros((PART_CELLS, PART_CELLS, len(PARTS)), np.float32)
    parts[..., HAIR], parts[..., SKIN] = hair, 1 - hair
    grid = np.ones((CELLS, CELLS))
    vectors = np.zeros((CELLS, CELLS, 3))
    return Reading(Region(200, 200, side), vectors[..., :2], grid, vectors, grid, parts, around=around)


def test_hair_beyond_the_narrow_crop_is_read_in_the_wider_one() -> None:
    both = reading(100, 0.0, reading(200, 1.0))
    at = np.array([[200.0, 120.0], [200.0, 20.0]])
    found = parts_at_pixels(both, at)
    assert found[0, HAIR] > 0.99, "above the narrow crop"
    assert found[1, BACKGROUND] == 1.0, "above both"
    assert parts_at_pixels(reading(100, 0.0), at)[0, BACKGROUND] == 1.0


def test_more_points_than_opencv_takes_at_a_time() -> None:
    at = np.full((70_000, 2), 200.0)
    assert (parts_at_pixels(reading(100, 0.3), at)[:, HAIR] == np.float32(0.3)).all()
    assert parts_at_pixels(reading(100, 0.3), at[:0]).shape == (0, len(PARTS))
