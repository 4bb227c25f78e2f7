"""What a photo tells of somebody's hair: where it is, which way it runs, and what kind it is, each with its doubt.

::

    photo, reading --region_of--> square with all of the hair --network, reader of faces--> HairReading

The square is wider than the crops of ``service.face.reading.reader``, as hair may reach to the shoulders.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from service.arrays import Float32, Float64, UInt8
from service.errors import NumericFault
from service.face.reading import reader
from service.face.reading.part_labels import BACKGROUND, HAIR, HAT, OTHER
from service.face.reading.reader import (
    AROUND_ABOVE,
    AROUND_FILL,
    HEAD_ABOVE,
    HEAD_FILL,
    Reading,
    middles,
    parts_at_pixels,
)
from service.face.region import Region
from service.hair.kinds import KINDS, LENGTHS, PARTINGS
from service.image_filters import blurred, ramp
from service.runtime.sessions import Session, load_session
from service.stage_cache import Loaded

log = logging.getLogger(__name__)

SIDE, CELLS = 224, 112
"""Pixels along the square as it is read, and cells of what is said of it."""


@dataclass(frozen=True)
class HairReading:
    """Hair of one photo, on the cells of a square; H = W = ``CELLS``, row 0 = top.

    Attributes:
        region: the square in the photo; it stands upright on the face.
        mask: (H, W) float32 in [0, 1]: share of the cell that hair covers, or its probability.
        known: (H, W) float32 in [0, 1]: 0 beside the photo and where a hat or a hand hides whether there is hair.
        background: (H, W) float32 in [0, 1]: probability of what is behind the person.
        direction: (H, W, 2) float32 unit vectors from root to tip in the square's own axes, x right, y down.
        certainty: (H, W) float32 in [0, 1] of the direction; 0 without hair.
        kinds: probability of each choice of ``service.hair.kinds.KINDS``, by name; those of a kind sum to 1.
        ends_m: height of the lowest ends in the head's frame, metres (Y up, 0 between the eyes), and its standard
            deviation.
    """

    region: Region
    mask: Float32
    known: Float32
    background: Float32
    direction: Float32
    certainty: Float32
    kinds: Mapping[str, Mapping[str, float]]
    ends_m: tuple[float, float]

    @property
    def cells(self) -> Float64:
        """(H * W, 2) photo pixels of the middles of the cells, row by row."""
        return middles(self.region, CELLS)


def region_of(reading: Reading) -> Region:
    """The square with all of the hair, by the crops that were read of the face."""
    wide = reading.region if reading.around is None else reading.around.region
    fill, above = (AROUND_FILL, AROUND_ABOVE) if reading.around is not None else (reader.FILL, reader.ABOVE)
    side = wide.side * fill / HEAD_FILL
    down = HEAD_ABOVE * side - above * wide.side
    turn = np.array([-np.sin(wide.angle), np.cos(wide.angle)])
    return Region(wide.x + float(turn[0]) * down, wide.y + float(turn[1]) * down, side, wide.angle)


@dataclass(frozen=True)
class Said:
    """What the network says of a square; as :class:`HairReading`, but all of it by the network alone."""

    mask: Float32
    direction: Float32
    certainty: Float32
    kinds: Mapping[str, Mapping[str, float]]
    ends_m: tuple[float, float]


class HairNetwork(Loaded):
    """The network applied to the square, as it is and mirrored: the average treats both sides alike.

    Its recipe is ``models/training/hair.py``.
    """

    def __init__(self, session: Session | None = None) -> None:
        self._session = session or load_session("hair")

    def __call__(self, crop: UInt8) -> Said:
        """What a (224, 224, 3) uint8 sRGB square shows.

        Raises:
            NumericFault: the network gives no numbers.
        """
        planes = np.asarray(crop, np.float32).transpose(2, 0, 1)[None] / np.float32(255)
        plain, mirrored = (self._run(np.ascontiguousarray(p)) for p in (planes, planes[..., ::-1]))
        mask, way, spread, kinds, ends = (0.5 * (a + b) for a, b in zip(plain, _turned_back(mirrored), strict=True))
        size = np.linalg.norm(way, axis=-1)
        direction = way / np.maximum(size, 1e-6)[..., None]
        # The cosine to expect: of unit vectors whose components are off by ``spread``.
        certainty = np.clip(1 - np.square(spread), 0, 1) * np.minimum(size, 1)
        named, first = {}, 0
        for name, choices in KINDS.items():
            named[name] = {c: float(p) for c, p in zip(choices, kinds[first:], strict=False)}
            first += len(choices)
        apart = abs(float(plain[4][0] - mirrored[4][0])) / 2
        return Said(
            np.asarray(mask, np.float32), np.asarray(direction, np.float32), np.asarray(certainty, np.float32),
            named, (float(ends[0]), max(float(ends[1]), apart)),
        )  # fmt: skip

    def _run(self, planes: Float32) -> list[Float64]:
        """Mask and direction (H, W), (H, W, 2), its spread (H, W), probabilities of all kinds, ends (2,)."""
        mask, way, spread, kinds, ends = (np.asarray(a[0], np.float64) for a in self._session.run({"crop": planes}))
        shares = [softmax(part) for part in np.split(kinds, np.cumsum([len(c) for c in KINDS.values()])[:-1])]
        return [1 / (1 + np.exp(-mask[0])), np.moveaxis(way, 0, -1), spread[0], np.concatenate(shares), ends]


def softmax(values: Float64) -> Float64:
    """(N,) probabilities of logits."""
    share = np.exp(values - values.max())
    return np.asarray(share / share.sum())


def _turned_back(answer: list[Float64]) -> list[Float64]:
    """The answer to a mirrored square as one to the square itself."""
    mask, way, spread, kinds, ends = answer
    kinds = kinds.copy()
    first = sum(len(choices) for choices in list(KINDS.values())[: list(KINDS).index("parting")])
    left, right = first + PARTINGS.index("left"), first + PARTINGS.index("right")
    kinds[[left, right]] = kinds[[right, left]]
    return [mask[:, ::-1], way[:, ::-1] * [-1.0, 1.0], spread[:, ::-1], kinds, ends]


def read_hair(pixels: UInt8, reading: Reading, network: HairNetwork | None = None) -> HairReading | None:
    """Read the hair in a photo whose face was read; None where the network gives no numbers.

    Args:
        pixels: (H, W, 3) uint8 sRGB, the photo.
        reading: of its face.
        network: None for the shipped one.
    """
    region = region_of(reading)
    crop, at = region.cut(pixels, SIDE), middles(region, CELLS)
    parts = parts_at_pixels(reading, at).reshape(CELLS, CELLS, -1)
    height, width = pixels.shape[:2]
    inside = ((at >= 0) & (at < [width, height])).all(1).reshape(CELLS, CELLS)
    known = np.asarray(inside * (1 - ramp(parts[..., HAT] + parts[..., OTHER], (0.15, 0.45))), np.float32)
    try:
        said = (network or HairNetwork())(crop)
    except NumericFault as fault:
        log.warning("the hair is not read: %s", fault)
        return None
    mask = (said.mask if reading.segments is None else together(said.mask, parts[..., HAIR])) * inside
    agrees = agreement(pixels, region, np.minimum(mask, known))
    return HairReading(
        region, mask, known, np.asarray(parts[..., BACKGROUND], np.float32), said.direction,
        np.asarray(said.certainty * mask, np.float32), with_curls(said.kinds, agrees), said.ends_m,
    )  # fmt: skip


FINE = 3
"""Pixels along a cell in which single locks are looked at: 1.3 mm each."""
LOCK, AROUND = 1.5, 12.5
"""Standard deviations, in such pixels, of the structure tensor, 2 mm, and of the place over which directions are
compared, 16 mm: some turns of a curl."""
LEAST_CELLS = 400
"""Cells of hair, 60 square centimetres, below which it tells nothing of curls."""
SURE = 0.7
"""Probability of hair from which on a cell tells of curls."""
AGREES = {"straight": (0.84, 0.08), "wavy": (0.74, 0.09), "curly": (0.5, 0.1), "coily": (0.5, 0.1)}
"""Mean and standard deviation of the agreement in photos of loose hair that hangs to the jaw or lower
(``python -m benchmarks.curls``); of drawn people straight hair is as wavy hair is here."""
LEAST_TOLD, TRUSTED = 0.02, 0.5
"""Likelihood of a curl by the agreement, over that of the likeliest, at least; and the power of the network's own
probabilities: of photos it is surer than it is right."""


def agreement(pixels: UInt8, region: Region, hair: Float32) -> float | None:
    """How much the strands of hair that lie beside each other run the same way, in [0, 1]; None with too little hair.

    A curl turns within a centimetre, which the eye sees in any photo, and the structure tensor does (Foerstner and
    Guelch 1987); the network was taught on drawn curls, and calls those of photos wavy.

    Args:
        pixels: (H, W, 3) uint8 sRGB, the photo.
        region: the square of the hair.
        hair: (C, C) in [0, 1], probability that a cell shows hair.
    """
    crop = region.cut(pixels, FINE * CELLS)
    whole = cv2.erode((hair > SURE).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.float32)
    if int(whole.sum()) < LEAST_CELLS:
        return None
    mask = np.kron(whole, np.ones((FINE, FINE), np.float32))
    grey = blurred(cv2.cvtColor(crop, cv2.COLOR_RGB2GRAY).astype(np.float32), LOCK / 2)
    across, down = cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    tensor = blurred(np.dstack([across**2 - down**2, 2 * across * down, across**2 + down**2]), LOCK)
    size, energy = np.hypot(tensor[..., 0], tensor[..., 1]), tensor[..., 2]
    usual = float((energy * mask).sum() / mask.sum())
    weight = mask * size / (energy + 1e-3) * np.clip(np.sqrt(energy / (usual + 1e-3)), 0, 2)
    # Twice the angle, as a strand has no sign.
    way = tensor[..., :2] * (weight / (size + 1e-6))[..., None]
    mean = blurred(np.dstack([way, weight]), AROUND)
    agrees = np.hypot(mean[..., 0], mean[..., 1]) / (mean[..., 2] + 1e-6)
    return float((agrees * mask).sum() / mask.sum())


def with_curls(kinds: Mapping[str, Mapping[str, float]], agrees: float | None) -> Mapping[str, Mapping[str, float]]:
    """Probabilities of kinds, with those of curls as what the photo's strands show makes them.

    Of loose hair down to the jaw at least: short hair lies in all directions, and so do plaits.
    """
    length, gathered = kinds["length"], kinds["gathered"]
    hangs = sum(length[name] for name in LENGTHS[LENGTHS.index("jaw") :])
    if agrees is None or hangs < 0.5 or max(gathered, key=lambda name: gathered[name]) not in ("none", "half"):
        return kinds
    fits = {name: float(np.exp(-0.5 * ((agrees - mean) / sd) ** 2)) / sd for name, (mean, sd) in AGREES.items()}
    least = LEAST_TOLD * max(max(fits.values()), 1e-12)
    chance = {name: share**TRUSTED * max(fits[name], least) for name, share in kinds["curl"].items()}
    return {**kinds, "curl": {name: share / sum(chance.values()) for name, share in chance.items()}}


OWN_ERRS, OWN_COUNTS = 0.03, 0.5
"""How often the network may be wrong, however sure, and the power of its odds: it was taught on the same drawn people
as the reader of faces, and is half a witness."""


def together(own: Float32, parts: Float32) -> Float32:
    """Probability of hair by the network and by the parts (Bayes' rule on two witnesses), of the same shape."""
    odds = [np.clip(p, OWN_ERRS, 1 - OWN_ERRS) for p in (own, parts)]
    own_odds, part_odds = (p / (1 - p) for p in odds)
    both = own_odds**OWN_COUNTS * part_odds
    return np.asarray(both / (1 + both), np.float32)
