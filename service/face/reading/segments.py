"""What a photo shows by MediaPipe's multiclass selfie segmentation, and what that makes of the reader's parts.

The reader was taught on drawn people before drawn backgrounds: it can take a curtain, a cap or a black hat for hair.
The segmentation was taught on real photos, and knows six classes only. Each is a witness with errors of its own: Bayes'
rule weighs them, the second one's errors as they are usual and, of the person and the background, as they are in the
very photo.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float32, Float64, UInt8
from service.face.reading.part_labels import (
    BACKGROUND,
    BEARD,
    BROW,
    CLOTH,
    GLASSES,
    HAIR,
    HAT,
    IRIS,
    LIP,
    MOUTH,
    OTHER,
    PARTS,
    SCLERA,
    SKIN,
)  # fmt: skip
from service.face.region import Region
from service.geometry.sampling import sample_at
from service.runtime.sessions import Session, load_session

SIDE = 256
"""Pixels along the square."""
CLASSES = ("background", "hair", "body skin", "face skin", "clothes", "thing")
"""What the network tells apart; a "thing" is a hat, glasses, jewels, what a hand holds."""

SAYS: Float32 = np.zeros((len(PARTS), len(CLASSES)), np.float32)
"""(13, 6) how often the network says a class where a part is: probabilities, each row sums to 1."""
SAYS[BACKGROUND] = 0.95, 0.01, 0.01, 0.01, 0.01, 0.01
SAYS[SKIN] = 0.01, 0.03, 0.23, 0.71, 0.01, 0.01
SAYS[[BROW, LIP, MOUTH]] = 0.01, 0.02, 0.03, 0.92, 0.01, 0.01
SAYS[BEARD] = 0.02, 0.20, 0.06, 0.70, 0.01, 0.01
SAYS[[SCLERA, IRIS]] = 0.01, 0.02, 0.01, 0.88, 0.01, 0.07
# Single strands before a face or a wall are too thin for it.
SAYS[HAIR] = 0.08, 0.72, 0.04, 0.10, 0.01, 0.05
SAYS[GLASSES] = 0.02, 0.02, 0.02, 0.64, 0.01, 0.29
SAYS[HAT] = 0.05, 0.08, 0.02, 0.02, 0.08, 0.75
SAYS[CLOTH] = 0.02, 0.02, 0.03, 0.01, 0.88, 0.04
SAYS[OTHER] = 0.15, 0.05, 0.35, 0.05, 0.10, 0.30

FACE = (SKIN, BROW, BEARD, LIP, MOUTH, SCLERA, IRIS)
"""Parts by which a miss of the person is known: there is a face, as landmarks were found."""
LEAST_DOUBT = 0.02
"""Least doubt of the network: errors are counted on few cells, and on the face, which is easier to see than hair."""
TOLD: Float32 = 0.97 * np.eye(len(PARTS), dtype=np.float32)
"""(13, 13) what is there, by columns, where the reader is sure of a part, by rows: drawn hats are not real ones."""
TOLD[:, [SKIN, OTHER]] += 0.015
TOLD[BACKGROUND, [BACKGROUND, HAIR, HAT, CLOTH]] = 0.90, 0.06, 0.01, 0.01
TOLD[SKIN, [SKIN, HAIR, HAT]] = 0.93, 0.04, 0.01
TOLD[BEARD, [BEARD, HAIR]] = 0.94, 0.03
TOLD[HAIR, [BACKGROUND, HAIR, HAT, CLOTH]] = 0.03, 0.86, 0.07, 0.01
TOLD[HAT, [BACKGROUND, HAIR, HAT]] = 0.02, 0.10, 0.85
TOLD[CLOTH, [BACKGROUND, HAIR, CLOTH]] = 0.03, 0.08, 0.86
TOLD[OTHER, [BACKGROUND, HAIR, HAT, CLOTH, OTHER]] = 0.03, 0.10, 0.03, 0.05, 0.77
TOLD /= TOLD.sum(1, keepdims=True)
BEYOND: Float32 = np.zeros(len(PARTS), np.float32)
"""(13,) how often a part is there where the reader sees nothing, round its crops."""
BEYOND[[BACKGROUND, HAIR, SKIN, CLOTH, OTHER, HAT]] = 0.44, 0.14, 0.2, 0.18, 0.03, 0.01


@dataclass(frozen=True)
class Segments:
    """The network's answer.

    Attributes:
        region: the square in the photo.
        shares: (256, 256, 6) float32 probabilities of ``CLASSES``; what lies beyond the photo is background.
    """

    region: Region
    shares: Float32

    def at(self, pixels: Float64) -> Float32:
        """(N, 6) float32 probabilities at photo pixels (N, 2), linearly interpolated; as at the border beyond it."""
        x, y = (self.region.to_crop(pixels, SIDE).astype(np.float32) - np.float32(0.5)).T
        return np.asarray(sample_at(self.shares, x, y), np.float32)


class SegmenterNetwork:
    """The network applied to the crop of a photo."""

    def __init__(self, session: Session | None = None) -> None:
        self._session = session or load_session("segmenter")

    def __call__(self, pixels: UInt8, region: Region) -> Segments:
        """What a square of an (H, W, 3) uint8 sRGB photo shows.

        Raises:
            NumericFault: the network gives no numbers.
        """
        image = np.ascontiguousarray(region.cut(pixels, SIDE), np.float32)[None] / np.float32(127.5) - np.float32(1)
        logits = np.asarray(self._session.run({"image": image})[0].reshape(SIDE, SIDE, len(CLASSES)), np.float32)
        share = np.exp(logits - logits.max(-1, keepdims=True))
        share /= share.sum(-1, keepdims=True)
        cells = np.arange(SIDE) + 0.5
        at = region.to_photo(np.stack(np.meshgrid(cells, cells), -1).reshape(-1, 2), SIDE)
        beyond = ((at < 0) | (at > [pixels.shape[1], pixels.shape[0]])).any(1).reshape(SIDE, SIDE)
        share[beyond] = np.eye(len(CLASSES), dtype=np.float32)[0]  # a face is seen in the black there
        return Segments(region, share)


def likelihoods(parts: Float32, shares: Float32, inside: Bool) -> Float32:
    """(13, 6) how often a part is said to be a class in this photo.

    A network that is blind to this person, or sees one everywhere, is found out on the cells that the reader calls face
    and background; one that says the same everywhere then changes nothing.

    Args:
        parts: (N, 13) probabilities of the reader.
        shares: (N, 6) what the network says there.
        inside: (N,) whether a cell lies in the photo.
    """

    def mean(weight: Float32) -> tuple[Float32, bool]:
        total = float((weight * inside).sum())
        return np.asarray((shares * (weight * inside)[:, None]).sum(0) / max(total, 1e-6), np.float32), total > 1.0

    (face, faced), (behind, any_behind) = mean(parts[:, list(FACE)].sum(1)), mean(parts[:, BACKGROUND])
    skin = CLASSES.index("body skin"), CLASSES.index("face skin")
    wrong = float(np.clip(1 - face[list(skin)].sum(), LEAST_DOUBT, 1)) if faced else 1.0
    false = float(1 - behind[0])
    doubt = max(wrong, false if any_behind else 0.0)
    says = (1 - doubt) * SAYS + doubt * (face if faced else 1 / len(CLASSES))
    says[BACKGROUND] = (1 - doubt) * SAYS[BACKGROUND] + doubt * (behind if any_behind else 1 / len(CLASSES))
    return np.asarray(np.maximum(says, 1e-4), np.float32)


def weigh_parts(parts: Float32, shares: Float32, says: Float32) -> Float32:
    """Probabilities of the parts after what the network says (Bayes' rule).

    What a cell shows in part counts in part, as logarithms are averaged.

    Args:
        parts: (..., 13) float32 probabilities of the reader.
        shares: (..., 6) float32 of the network.
        says: (13, 6) its likelihoods.

    Returns:
        (..., 13) float32 that sum to 1.
    """
    return _posterior(parts @ TOLD, shares, says)


def _posterior(prior: Float32, shares: Float32, says: Float32) -> Float32:
    told = prior * np.exp(shares @ np.log(says).T)
    return np.asarray(told / np.maximum(told.sum(-1, keepdims=True), 1e-12), np.float32)


def parts_of(shares: Float32) -> Float32:
    """(N, 13) float32 probabilities of the parts by the network's (N, 6) alone."""
    return _posterior(BEYOND, shares, SAYS)
