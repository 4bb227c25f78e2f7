"""All that is read off a face: each pixel's place on the head, how that is turned, and which part it shows.

The reader's recipe is ``models/training/reader.py``. The crop stands upright on the landmarks, as the portraits did
that it was trained on, and is read twice, as it is and mirrored: the average treats both sides alike.

The reader was taught on synthetic people before synthetic backgrounds; it can take a curtain beside a head for hair.
MediaPipe's selfie segmentation was taught on real photos and knows no parts. Each is a witness with errors of its own:
Bayes' rule weighs them, with the second one's errors as they are in the very photo.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace

import numpy as np

from service.arrays import Bool, Float32, Float64, UInt8
from service.errors import NumericFault
from service.face.detection import face_roll
from service.face.finder import Face
from service.face.reading.openings import Landmarker, Openings, OpeningsNetwork, Scores
from service.face.reading.part_labels import BACKGROUND, BEARD, BROW, HAIR, IRIS, LIP, MOUTH, OTHER, PARTS, SCLERA, SKIN
from service.face.region import Region, level_square
from service.geometry.camera import ahead
from service.geometry.sampling import sample_at
from service.photo.photo import Photo
from service.runtime.sessions import Session, load_session
from service.stage_cache import Loaded

SIDE, CELLS, PART_CELLS = 256, 64, 128
"""Pixels along the crop, cells of chart coordinates and normals, cells of parts."""
FILL = 0.64
"""Longer side of the landmarks' bounding box over the crop's; the portraits have 0.45 to 0.86."""
ABOVE = 0.03
"""How far the middle of the landmarks stands above the middle of the crop, over its side, as in the portraits."""
AROUND_FILL, AROUND_ABOVE = 0.47, -0.04
"""The same of the wider crop that holds all of the hair: near the widest of the portraits, whose middles vary."""
CHART_MM = (410.0, 273.0)
"""Millimetres of face that one unit of u and of v stands for, about."""


@dataclass(frozen=True)
class Reading:
    """What the reader says of one photo, and the networks beside it of lids, lips and expression.

    Attributes:
        region: the crop in the photo.
        chart: (64, 64, 2) float64 u and v of each cell's middle, origin bottom left, not confined to [0, 1].
        chart_mm: (64, 64) float64 its standard deviation, millimetres on the face.
        normal: (64, 64, 3) float64 unit, axes of the photo's x, y and of the ray to the crop's middle.
        normal_sine: (64, 64) float64 standard deviation of its components.
        parts: (128, 128, 13) float32 probabilities of ``service.face.reading.part_labels``.
        openings: edges of lids and lips; those that could not be read are missing.
        scores: of the expression; None where they could not be read.
        around: the same network's answer to a wider crop, which holds the hair; None where there is none.
    """

    region: Region
    chart: Float64
    chart_mm: Float64
    normal: Float64
    normal_sine: Float64
    parts: Float32
    openings: Openings = field(default_factory=dict)
    scores: Scores | None = None
    around: Reading | None = None

    @property
    def cells(self) -> Float64:
        """(4096, 2) photo pixels of the cells' middles, row by row."""
        return middles(self.region, CELLS)

    def camera_normals(self, focal_px: float, principal_point: Float64) -> Float64:
        """(64, 64, 3) unit normals in the axes of the photo's camera (x right, y down, z forward)."""
        ray = np.array([*(np.array([self.region.x, self.region.y]) - principal_point) / max(focal_px, 1e-9), 1.0])
        return np.asarray(self.normal @ ahead(ray))


def middles(region: Region, count: int) -> Float64:
    """(count^2, 2) photo pixels of the middles of a crop's cells, row by row."""
    at = np.arange(count) + 0.5
    x, y = np.meshgrid(at, at)
    return region.to_photo(np.stack([x.ravel(), y.ravel()], 1), count)


def crop_of(landmarks: Float64, fill: float = FILL, above: float = ABOVE) -> Region | None:
    """The upright square that the reader sees; None where fewer than three landmarks are finite or all coincide.

    Args:
        landmarks: (468, 2 or 3) photo pixels.
        fill: as ``FILL``.
        above: as ``ABOVE``.
    """
    good = landmarks[np.isfinite(landmarks).all(1), :2]
    if len(good) < 3:
        return None
    region = level_square(good, face_roll(landmarks), 1 / fill, above)
    return region if region.side > 1.0 else None


class ReaderNetwork:
    """The network applied to the crops of photos."""

    def __init__(self, session: Session | None = None) -> None:
        self._session = session or load_session("reader")

    def __call__(self, pixels: UInt8, region: Region) -> Reading:
        """Read one square region of an (H, W, 3) uint8 sRGB photo."""
        crop: Float32 = np.asarray(region.cut(pixels, SIDE) / 255, np.float32)
        plain, mirrored = (self._run(image) for image in (crop, crop[:, ::-1]))
        chart, chart_mm, normal, sine, parts = _average(plain, _turned_back(mirrored))
        cos, sin = np.cos(region.angle), np.sin(region.angle)
        upright = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return Reading(region, chart, chart_mm, normal @ upright.T, sine, parts.astype(np.float32))

    def _run(self, crop: Float32) -> list[Float64]:
        outputs = self._session.run({"crop": np.ascontiguousarray(crop.transpose(2, 0, 1))[None]})
        chart, chart_mm, normal, sine, parts = (np.moveaxis(a[0].astype(np.float64), 0, -1) for a in outputs)
        share = np.exp(parts - parts.max(-1, keepdims=True))
        return [chart, chart_mm[..., 0], normal, sine[..., 0], share / share.sum(-1, keepdims=True)]


def _turned_back(answer: list[Float64]) -> list[Float64]:
    """The answer to a mirrored crop as one to the crop itself."""
    chart, chart_mm, normal, sine, parts = (a[:, ::-1] for a in answer)
    return [np.stack([1.0 - chart[..., 0], chart[..., 1]], -1), chart_mm, normal * [-1.0, 1.0, 1.0], sine, parts]


def _average(one: list[Float64], other: list[Float64]) -> list[Float64]:
    """The mean of two answers; where they disagree the uncertainty is at least half their difference."""
    chart, normal = 0.5 * (one[0] + other[0]), 0.5 * (one[2] + other[2])
    apart = 0.5 * np.linalg.norm((one[0] - other[0]) * CHART_MM, axis=-1)
    turned = 0.5 * np.linalg.norm(one[2] - other[2], axis=-1)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = np.where(length > 1e-6, normal / np.maximum(length, 1e-6), one[2])
    chart_mm, sine = 0.5 * (one[1] + other[1]), 0.5 * (one[3] + other[3])
    return [chart, np.maximum(chart_mm, apart), normal, np.maximum(sine, turned), 0.5 * (one[4] + other[4])]


def parts_at_pixels(reading: Reading, at: Float64, *, strands: bool = False) -> Float32:
    """(N, 13) float32 probabilities of the parts at photo pixels (N, 2); what no crop shows counts as background.

    The narrow crop, which is finer, goes over into the wider one at its border.

    Args:
        reading: of the photo.
        at: photo pixels.
        strands: hair is where either crop shows it, for those who would rather miss skin than take hair for it: of
            hair before the skin of portraits the narrow crop misses 3.5 %, both 2.4 %.
    """
    narrow, inside = _in_crop(reading, at)
    if reading.around is None:
        return _beyond(narrow, inside)
    wide, around = _in_crop(reading.around, at)
    wide = _beyond(wide, around)
    # Cells of the narrow crop over which its answer goes over into that of the wider one, at its border.
    share = np.clip(inside / 6.0, 0, 1)[:, None]
    parts = np.asarray(share * narrow + (1 - share) * wide, np.float32)
    return _with_hair(parts, wide[:, HAIR]) if strands else parts


def _with_hair(parts: Float32, other: Float32) -> Float32:
    """Probabilities (N, 13) in which hair has at least another's (N,), at the cost of all else alike."""
    hair = np.maximum(parts[:, HAIR], other)
    left = (1 - hair) / np.maximum(1 - parts[:, HAIR], np.float32(1e-6))
    parts = parts * np.minimum(left, 1)[:, None]
    parts[:, HAIR] = hair
    return parts


def _in_crop(reading: Reading, at: Float64) -> tuple[Float32, Float32]:
    """(N, 13) a crop's probabilities, and (N,) how many cells the points lie within its border, < 0 beyond."""
    cells = reading.region.to_crop(at, PART_CELLS).astype(np.float32)
    x, y = (cells[:, k] - np.float32(0.5) for k in (0, 1))
    return np.asarray(sample_at(reading.parts, x, y), np.float32), np.minimum(cells, PART_CELLS - cells).min(1)


def _beyond(parts: Float32, inside: Float32) -> Float32:
    parts[inside < 0] = np.eye(parts.shape[1], dtype=np.float32)[BACKGROUND]
    return parts


log = logging.getLogger(__name__)

PERSON_SIDE = 256
OWN = tuple(k for k in range(len(PARTS)) if k not in (BACKGROUND, OTHER))
"""Parts that are the person's; what else hides a face may be anything."""
FACE = (SKIN, BROW, BEARD, LIP, MOUTH, SCLERA, IRIS)
"""Parts by which a miss of the person is known: there is a face, as landmarks were found."""
LEAST_RATE = 0.02
"""Least rate of misses and of false alarms that is believed: they are counted on few cells, and on the face, which is
easier to see than hair."""


class PersonNetwork:
    """The network applied to the crop of a photo."""

    def __init__(self, session: Session | None = None) -> None:
        self._session = session or load_session("person")

    def __call__(self, pixels: UInt8, region: Region) -> Float32:
        """(256, 256) float32 in [0, 1]: how much a pixel of the crop of an (H, W, 3) uint8 sRGB photo shows a person.

        Raises:
            NumericFault: the network gives no numbers.
        """
        image = np.ascontiguousarray(region.cut(pixels, PERSON_SIDE), np.float32)[None] / np.float32(255)
        return np.asarray(self._session.run({"image": image})[0].reshape(PERSON_SIDE, PERSON_SIDE), np.float32)


def with_person(pixels: UInt8, reading: Reading, network: PersonNetwork) -> Reading:
    """A reading of both crops whose parts of the person are less probable where the network denies that there is one.

    The network sees the wider crop. Where it gives no numbers, the reading stays as it is.

    Args:
        pixels: (H, W, 3) uint8 sRGB photo.
        reading: of it.
        network: of the person.
    """
    wide = reading if reading.around is None else reading.around
    try:
        seen = network(pixels, wide.region)
    except NumericFault as fault:
        log.warning("the person is not told from the background: %s", fault)
        return reading
    height, width = pixels.shape[:2]
    at = middles(wide.region, PART_CELLS)
    inside = ((at >= 0) & (at < [width, height])).all(1).reshape(PART_CELLS, PART_CELLS)
    rates = error_rates(wide.parts, sampled(seen, wide.region, at), inside)

    def weighed(one: Reading) -> Reading:
        shown = sampled(seen, wide.region, middles(one.region, PART_CELLS))
        return replace(one, parts=weigh_parts(one.parts, shown, *rates))

    around = None if reading.around is None else weighed(reading.around)
    return replace(weighed(reading), around=around)


def error_rates(parts: Float32, person: Float32, inside: Bool) -> tuple[float, float]:
    """How often the network misses a person whom the reader sees, and how often it sees one in the background.

    Args:
        parts: (C, C, 13) probabilities of the reader.
        person: (C, C) the network's.
        inside: (C, C) whether a cell lies in the photo.

    Returns:
        Both in [``LEAST_RATE``, 1 - ``LEAST_RATE``]; one half where no cell tells.
    """

    def mean(values: Float32, weight: Float32) -> float:
        total = float((weight * inside).sum())
        return float((values * weight * inside).sum()) / total if total > 1.0 else 0.5

    missed = mean(1 - person, parts[..., list(FACE)].sum(-1))
    false = mean(person, parts[..., BACKGROUND])
    low, high = np.clip([missed, false], LEAST_RATE, 1 - LEAST_RATE)
    return float(low), float(high)


def weigh_parts(parts: Float32, person: Float32, missed: float, false: float) -> Float32:
    """Probabilities of the parts after what the network says: odds of the person times a likelihood ratio.

    What a cell shows in part counts in part, as the logarithm of the ratio is averaged. The network takes away only:
    it does not know which part of a person to add. One that says the same of face and background changes nothing.

    Args:
        parts: (..., 13) float32 probabilities of the reader.
        person: (...) float32 in [0, 1], the network's.
        missed: share of the person that it misses, in (0, 1).
        false: share of the background that it takes for the person, in (0, 1).

    Returns:
        (..., 13) float32 that sum to 1 as ``parts`` do.
    """
    seen, unseen = np.log((1 - missed) / false), np.log(missed / (1 - false))
    ratio = np.exp(np.minimum(person * seen + (1 - person) * unseen, 0.0))[..., None]
    # Divided by their sum, without a pass over all parts for it.
    rest = parts[..., BACKGROUND, None] + parts[..., OTHER, None]
    total = 1.0 / np.maximum(ratio + (1 - ratio) * rest, 1e-6)
    factors = np.where(np.isin(np.arange(len(PARTS)), OWN), ratio * total, total)
    return np.asarray(parts * factors, np.float32)


def sampled(seen: Float32, region: Region, at: Float64) -> Float32:
    """(C, C) what the network says of a crop (256, 256), at photo pixels (C^2, 2), linearly interpolated."""
    import cv2

    x, y = (region.to_crop(at, PERSON_SIDE).astype(np.float32) - np.float32(0.5)).T
    side = round(len(at) ** 0.5)
    x, y = x.reshape(side, side), y.reshape(side, side)
    return np.asarray(cv2.remap(seen, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


@dataclass(frozen=True)
class View:
    """One photo of a person.

    Attributes:
        photo: upright.
        face: the person's, landmarks in photo pixels.
        reading: what was read off it (:func:`service.face.reading.reader.read_face`); None: nothing.
    """

    photo: Photo
    face: Face
    reading: Reading | None = None


class Readers(Loaded):
    """The networks that read a face.

    Args:
        pixels: of places, normals and parts; None for the shipped one.
        openings: of lids and lips; None for the shipped ones.
        scores: of points and expression; None for the shipped ones.
        person: that tells a person from what is behind; True for the shipped one, False for none.
    """

    def __init__(
        self, pixels: ReaderNetwork | None = None, openings: OpeningsNetwork | None = None,
        scores: Landmarker | None = None, person: PersonNetwork | bool = True,
    ) -> None:  # fmt: skip
        self.pixels = pixels or ReaderNetwork()
        self.openings = openings or OpeningsNetwork()
        self.scores = scores or Landmarker()
        self.person = (PersonNetwork() if person else None) if isinstance(person, bool) else person


def read_face(pixels: UInt8, landmarks: Float64, readers: Readers) -> Reading | None:
    """Read the face with landmarks (468, 3) in an (H, W, 3) uint8 sRGB photo.

    None where the landmarks give no crop or the network of pixels gives no numbers; openings and scores of which the
    networks give none are missing, and without numbers of the person the parts stay as the first network says.
    """
    region, wide = crop_of(landmarks), crop_of(landmarks, AROUND_FILL, AROUND_ABOVE)
    try:
        reading = None if region is None else readers.pixels(pixels, region)
        around = None if wide is None else readers.pixels(pixels, wide)
    except NumericFault as fault:
        log.warning("the face is not read: %s", fault)
        return None
    if reading is None:
        return None
    reading = replace(reading, around=around)
    if readers.person is not None:
        reading = with_person(pixels, reading, readers.person)
    return replace(
        reading,
        openings=readers.openings(pixels, landmarks),
        scores=readers.scores(pixels, landmarks),
    )
