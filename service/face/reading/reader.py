"""All that is read off a face: each pixel's place on the head, how that is turned, and which part it shows.

The reader's recipe is ``models/training/reader.py``. The crop stands upright on the landmarks, as the portraits did
that it was trained on, and is read twice, as it is and mirrored: the average treats both sides alike.

Beside it ``service.face.reading.segments`` tells hair, skin, clothes and things as real photos have them.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace

import numpy as np

from service.arrays import Float32, Float64, UInt8
from service.errors import NumericFault
from service.face.detection import face_roll
from service.face.finder import Face
from service.face.reading.openings import Landmarker, Openings, OpeningsNetwork, Scores
from service.face.reading.part_labels import BACKGROUND
from service.face.reading.segments import SegmenterNetwork, Segments, likelihoods, parts_of, weigh_parts
from service.face.region import Region, level_square
from service.geometry.camera import ahead
from service.geometry.sampling import sample_at
from service.photo.photo import Photo
from service.runtime.sessions import Session, load_session
from service.stage_cache import Loaded

log = logging.getLogger(__name__)

SIDE, CELLS, PART_CELLS = 256, 64, 128
"""Pixels along the crop, cells of chart coordinates and normals, cells of parts."""
FILL = 0.64
"""Longer side of the landmarks' bounding box over the crop's; the portraits have 0.45 to 0.86."""
ABOVE = 0.03
"""How far the middle of the landmarks stands above the middle of the crop, over its side, as in the portraits."""
AROUND_FILL, AROUND_ABOVE = 0.47, -0.04
"""The same of the wider crop: near the widest of the portraits, whose middles vary."""
HEAD_FILL, HEAD_ABOVE = 0.40, 0.05
"""The same of the square with all of the hair: about 0.44 m, from above the crown to below the shoulders."""
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
        segments: of the square with all of the hair, which is in the parts already; None without.
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
    segments: Segments | None = None

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


def parts_at_pixels(reading: Reading, at: Float64) -> Float32:
    """(N, 13) float32 probabilities of the parts at photo pixels (N, 2).

    What no crop shows is told by the segmentation alone, or counts as background without one. The narrow crop, which is
    finer, goes over into the wider one at its border.

    Args:
        reading: of the photo.
        at: photo pixels.
    """
    narrow, inside = _in_crop(reading, at)
    if reading.around is None:
        return _beyond(reading, at, narrow, inside)
    wide, around = _in_crop(reading.around, at)
    wide = _beyond(reading, at, wide, around)
    # Cells of the narrow crop over which its answer goes over into that of the wider one, at its border.
    share = np.clip(inside / 6.0, 0, 1)[:, None]
    return np.asarray(share * narrow + (1 - share) * wide, np.float32)


def _in_crop(reading: Reading, at: Float64) -> tuple[Float32, Float32]:
    """(N, 13) a crop's probabilities, and (N,) how many cells the points lie within its border, < 0 beyond."""
    cells = reading.region.to_crop(at, PART_CELLS).astype(np.float32)
    x, y = (cells[:, k] - np.float32(0.5) for k in (0, 1))
    return np.asarray(sample_at(reading.parts, x, y), np.float32), np.minimum(cells, PART_CELLS - cells).min(1)


def _beyond(reading: Reading, at: Float64, parts: Float32, inside: Float32) -> Float32:
    beyond = inside < 0
    parts[beyond] = np.eye(parts.shape[1], dtype=np.float32)[BACKGROUND]
    if reading.segments is not None and beyond.any():
        parts[beyond] = parts_of(reading.segments.at(at[beyond]))
    return parts


def with_segments(pixels: UInt8, reading: Reading, segments: Segments) -> Reading:
    """A reading whose parts in both crops are weighed with what the segmentation says.

    Args:
        pixels: (H, W, 3) uint8 sRGB photo.
        reading: of it.
        segments: of a square that holds both crops.
    """
    wide = reading if reading.around is None else reading.around
    height, width = pixels.shape[:2]
    at = middles(wide.region, PART_CELLS)
    inside = np.asarray(((at >= 0) & (at < [width, height])).all(1))
    says = likelihoods(wide.parts.reshape(len(at), -1), segments.at(at), inside)

    def weighed(one: Reading) -> Reading:
        shares = segments.at(middles(one.region, PART_CELLS)).reshape(PART_CELLS, PART_CELLS, -1)
        return replace(one, parts=weigh_parts(one.parts, shares, says))

    around = None if reading.around is None else weighed(reading.around)
    return replace(weighed(reading), around=around, segments=segments)


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
        segmenter: that tells hair, skin, clothes and things; True for the shipped one, False for none.
    """

    def __init__(
        self, pixels: ReaderNetwork | None = None, openings: OpeningsNetwork | None = None,
        scores: Landmarker | None = None, segmenter: SegmenterNetwork | bool = True,
    ) -> None:  # fmt: skip
        self.pixels = pixels or ReaderNetwork()
        self.openings = openings or OpeningsNetwork()
        self.scores = scores or Landmarker()
        self.segmenter = (SegmenterNetwork() if segmenter else None) if isinstance(segmenter, bool) else segmenter


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
    square = crop_of(landmarks, HEAD_FILL, HEAD_ABOVE)
    if readers.segmenter is not None and square is not None:
        try:
            reading = with_segments(pixels, reading, readers.segmenter(pixels, square))
        except NumericFault as fault:
            log.warning("hair, skin and things are not told apart by photos: %s", fault)
    return replace(
        reading,
        openings=readers.openings(pixels, landmarks),
        scores=readers.scores(pixels, landmarks),
    )
