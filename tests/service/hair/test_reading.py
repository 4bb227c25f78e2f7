"""How a photo's hair is read: the square, directions, and the network's answer as it is and mirrored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from service.face.finder import FaceFinder
from service.face.reading.part_labels import BACKGROUND, HAIR, HAT, PARTS
from service.face.reading.reader import CELLS as READER_CELLS
from service.face.reading.reader import PART_CELLS, Readers, Reading, crop_of, read_face
from service.face.region import Region
from service.hair.kinds import KINDS
from service.hair.reading import (
    CELLS,
    FINE,
    SIDE,
    HairNetwork,
    agreement,
    read_hair,
    region_of,
    together,
    with_curls,
)  # fmt: skip
from service.photo.gate import read_photo

SAMPLE = Path(__file__).parents[3] / "service" / "data" / "sample" / "astronaut.png"


class Eye:
    """Sees hair where the crop is dark, strands that run towards its brighter side, and a parting on the left."""

    def __init__(self, left: float = 3.0) -> None:
        self.left = left

    def run(self, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        grey = inputs["crop"][0].mean(0).reshape(CELLS, 2, CELLS, 2).mean((1, 3))
        tilt = float(np.sign((grey * np.linspace(-1, 1, CELLS)).sum()))
        way = np.stack([np.full_like(grey, tilt * 0.6), np.full_like(grey, 0.8)])
        kinds = np.zeros((1, sum(len(c) for c in KINDS.values())), np.float32)
        first = len(KINDS["length"]) + len(KINDS["gathered"])
        kinds[0, first + (1 if tilt > 0 else 3)] = self.left
        ends = np.array([[-0.1 - 0.01 * tilt, 0.02]], np.float32)
        return [20 * (0.5 - grey[None, None]), way[None], np.full_like(grey, 0.1)[None, None], kinds, ends]


def network(session: object) -> HairNetwork:
    return HairNetwork(session)  # type: ignore[arg-type]


def face(around: bool = True, angle: float = 0.0, part: int = BACKGROUND) -> Reading:
    """Of landmarks that fill a square of 100 pixels round (300, 300)."""
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    points = np.random.default_rng(0).uniform(-50, 50, (468, 2))
    points[:2] = [[-50, -50], [50, 50]]
    parts = np.zeros((PART_CELLS, PART_CELLS, len(PARTS)), np.float32)
    parts[..., part] = 1.0
    grid, vectors = np.ones((READER_CELLS, READER_CELLS)), np.zeros((READER_CELLS, READER_CELLS, 3))
    made: list[Reading | None] = [None]
    for fill, above in ((0.47, -0.04), (0.64, 0.03)) if around else ((0.64, 0.03),):
        side = 100 / fill
        x, y = np.array([300.0, 300.0]) + np.array([0, above * side]) @ turn
        region = Region(float(x), float(y), side, angle)
        made.append(Reading(region, vectors[..., :2], grid, vectors, grid, parts, around=made[-1]))
    assert made[-1] is not None
    return made[-1]


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_the_square_is_the_same_by_either_crop_and_wider_than_both(angle: float) -> None:
    wide, narrow = region_of(face(True, angle)), region_of(face(False, angle))
    np.testing.assert_allclose([wide.x, wide.y, wide.side], [narrow.x, narrow.y, narrow.side])
    assert wide.side == pytest.approx(250.0)
    middle = wide.to_crop(np.array([[300.0, 300.0]]), CELLS)[0] / CELLS
    np.testing.assert_allclose(middle, [0.5, 0.45], atol=1e-9)


def test_a_mirrored_photo_is_read_as_the_mirror_image() -> None:
    rng = np.random.default_rng(1)
    crop = rng.integers(0, 120, (SIDE, SIDE, 3)).astype(np.uint8)
    crop[:, SIDE // 2 :] += 60
    plain, mirrored = network(Eye())(crop), network(Eye())(np.ascontiguousarray(crop[:, ::-1]))
    np.testing.assert_allclose(plain.mask, mirrored.mask[:, ::-1], atol=1e-5)
    np.testing.assert_allclose(plain.direction, mirrored.direction[:, ::-1] * [-1, 1], atol=1e-5)
    assert plain.kinds["parting"]["left"] == pytest.approx(mirrored.kinds["parting"]["right"])
    assert plain.kinds["parting"]["left"] > 0.8
    # Its two answers were 20 mm apart, which is half a doubt.
    assert plain.ends_m == pytest.approx((-0.1, 0.02))


def test_probabilities_sum_to_one_and_nothing_is_read_beside_the_photo() -> None:
    pixels = np.full((330, 600, 3), 20, np.uint8)
    found = read_hair(pixels, face(part=HAIR), network(Eye()))
    assert found is not None
    for kind, choices in KINDS.items():
        assert tuple(found.kinds[kind]) == choices
        assert sum(found.kinds[kind].values()) == pytest.approx(1.0)
    beside = found.cells[:, 1].reshape(CELLS, CELLS) > 330
    assert beside.any()
    assert found.mask[beside].max() == found.known[beside].max() == found.certainty[beside].max() == 0
    assert found.mask[~beside].mean() > 0.9
    assert 0 < found.known.mean() < 1
    np.testing.assert_allclose(np.linalg.norm(found.direction, axis=2), 1.0, atol=1e-5)


def test_hair_is_what_parts_and_network_make_likely() -> None:
    """Fair locks that the network doubts are hair, a bald top that it takes for hair is none; undecided, it decides."""
    own, parts = (np.array([row], np.float32) for row in ([0.1, 0.95, 0.95, 0.05], [0.97, 0.02, 0.5, 0.5]))
    found = together(own, parts)[0]
    assert found[0] > 0.9 and found[1] < 0.15
    assert found[2] > 0.6 > 0.4 > found[3]
    ends = together(*(np.array(a, np.float32) for a in ([0, 1, 0, 1], [0, 0, 1, 1])))
    assert np.isfinite(ends).all(), "0 and 1 have no finite odds"


def test_a_hat_hides_whether_there_is_hair() -> None:
    pixels = np.full((600, 600, 3), 20, np.uint8)
    found = read_hair(pixels, face(part=HAT), network(Eye()))
    assert found is not None
    inner = face().around
    assert inner is not None
    at = inner.region.to_crop(found.cells, 1)
    within = ((at > 0.05) & (at < 0.95)).all(1).reshape(CELLS, CELLS)
    assert found.known[within].max() == 0


def test_the_sample_photo_has_hair_over_the_forehead_and_none_on_the_face() -> None:
    """By the shipped network."""
    photo = read_photo(SAMPLE.read_bytes())
    landmarks = FaceFinder().find(photo.pixels)[0].landmarks
    reading = read_face(photo.pixels, landmarks, Readers())
    assert reading is not None
    found = read_hair(photo.pixels, reading)
    assert found is not None
    face_crop = crop_of(landmarks)
    assert face_crop is not None
    x, y = landmarks[10, :2]
    reach = face_crop.side
    above, on_face = (
        found.mask[tuple(found.region.to_crop(at, CELLS).astype(int).T[::-1])]
        for at in (
            np.array([[x, y - 0.12 * reach], [x - 0.1 * reach, y - 0.12 * reach]]),
            landmarks[[4, 152, 50, 280], :2],
        )
    )
    assert above.min() > 0.6
    assert on_face.max() < 0.3
    assert found.kinds["length"]["cropped"] < 0.5


def strands_of(turned: float) -> np.ndarray:
    """(336, 336, 3) uint8: vertical strands, in squares of 1.6 cm turned by up to so many radians either way."""
    rng = np.random.default_rng(3)
    rows, columns = np.mgrid[: FINE * CELLS, : FINE * CELLS].astype(np.float32)
    angle = np.kron(rng.uniform(-turned, turned, (28, 28)), np.ones((12, 12)))
    grey = 120 + 60 * np.sin((columns * np.cos(angle) + rows * np.sin(angle)) * 1.4)
    return np.repeat(grey[..., None], 3, 2).astype(np.uint8)


def test_strands_of_straight_hair_agree_and_those_of_curls_do_not() -> None:
    hair = np.zeros((CELLS, CELLS), np.float32)
    hair[20:80, 20:80] = 1
    square = Region(FINE * CELLS / 2, FINE * CELLS / 2, FINE * CELLS, 0.0)
    straight, curly = (agreement(strands_of(turned), square, hair) for turned in (0.0, 1.5))
    assert straight is not None and curly is not None
    assert straight > 0.95 and curly < 0.65
    turned = agreement(np.ascontiguousarray(strands_of(0.0).transpose(1, 0, 2)), square, hair)
    assert turned == pytest.approx(straight, abs=0.02), "whichever way they run"
    flat = agreement(np.full((FINE * CELLS, FINE * CELLS, 3), 9, np.uint8), square, hair)
    assert flat is not None and np.isfinite(flat), "hair without any contrast divides by no energy"
    assert agreement(strands_of(0.0), square, hair * (np.arange(CELLS) < 24)) is None, "too little hair"


def test_curls_are_told_of_loose_hair_that_hangs_alone() -> None:
    def kinds(length: str, gathered: str) -> dict[str, dict[str, float]]:
        certain = {"length": length, "gathered": gathered}
        told = {name: {c: float(c == certain.get(name, c)) for c in choices} for name, choices in KINDS.items()}
        return told | {"curl": {"straight": 0.4, "wavy": 0.4, "curly": 0.15, "coily": 0.05}}

    long = kinds("shoulder", "none")
    curly, smooth = with_curls(long, 0.4)["curl"], with_curls(long, 0.85)["curl"]
    assert max(curly, key=lambda name: curly[name]) == "curly" and smooth["curly"] < 0.05
    for told in (curly, smooth, with_curls(long, -5.0)["curl"], with_curls(long, 9.0)["curl"]):
        assert sum(told.values()) == pytest.approx(1.0) and np.isfinite(list(told.values())).all()
    assert with_curls(kinds("short", "none"), 0.4)["curl"] == long["curl"]
    assert with_curls(kinds("longer", "plaits"), 0.4)["curl"] == long["curl"]
    assert with_curls(long, None) == long
