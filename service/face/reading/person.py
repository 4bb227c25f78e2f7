"""A person told from what is behind: MediaPipe's selfie segmentation, and what it says of the reader's parts.

The reader was taught on synthetic people before synthetic backgrounds; it can take a curtain beside a head for hair.
This network was taught on real photos and knows no parts. Each is a witness with errors of its own: Bayes' rule weighs
them, with the second one's errors as they are in the very photo.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from service.arrays import Bool, Float32, Float64, UInt8
from service.errors import NumericFault
from service.face.reading.part_labels import BACKGROUND, BEARD, BROW, IRIS, LIP, MOUTH, OTHER, PARTS, SCLERA, SKIN
from service.face.reading.reader import PART_CELLS, Reading, middles
from service.face.region import Region
from service.runtime.sessions import Session, load_session

log = logging.getLogger(__name__)

SIDE = 256
OWN = tuple(k for k in range(len(PARTS)) if k not in (BACKGROUND, OTHER))
"""Parts that are the person's; what else hides a face may be anything."""
FACE = (SKIN, BROW, BEARD, LIP, MOUTH, SCLERA, IRIS)
"""Parts by which a miss of the person is known: there is a face, as landmarks were found."""
LEAST_RATE = 0.02
"""Least rate of misses and of false alarms that is believed: they are counted on few cells, and on the face, which is
easier to see than hair."""


class PersonNetwork:
    """The network applied to the crop of a photo."""

    def __init__(self, session: Session | None = None, threads: int = 2) -> None:
        self._session = session or load_session("person", threads)

    def __call__(self, pixels: UInt8, region: Region) -> Float32:
        """(256, 256) float32 in [0, 1]: how much a pixel of the crop of an (H, W, 3) uint8 sRGB photo shows a person.

        Raises:
            NumericFault: the network gives no numbers.
        """
        image = np.ascontiguousarray(region.cut(pixels, SIDE), np.float32)[None] / np.float32(255)
        return np.asarray(self._session.run({"image": image})[0].reshape(SIDE, SIDE), np.float32)


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

    x, y = (region.to_crop(at, SIDE).astype(np.float32) - np.float32(0.5)).T
    side = round(len(at) ** 0.5)
    x, y = x.reshape(side, side), y.reshape(side, side)
    return np.asarray(cv2.remap(seen, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)
