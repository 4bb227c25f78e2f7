"""Identity: dlib's 128-number face descriptor, and the similarity of two of them.

Alignment as in dlib's ``get_face_chip_details`` for the 5-point model (150 pixels, padding 0.25). The raw cosine of two
descriptors is not discriminative, since all lie in a narrow cone (different people have 0.87 on average). Use the
Euclidean distance (King: under 0.6 the same person) or the cosine after subtraction of the population mean. The file
``face_identity_population.json``, made by ``python -m export.faces.population``, holds that mean and the distribution
of both measures between different people.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from service.arrays import AnyFloat, Float32, Float64, UInt8
from service.errors import ModelFault
from service.face.region import Region
from service.runtime.sessions import checked_bytes, load_session
from service.stage_cache import Loaded

Embedding = Float32

SIZE = 150
"""Side of the aligned crop, pixels."""
DIMENSIONS = 128
PADDING = 0.25
"""Border around the template, as a fraction of its side."""
TEMPLATE = np.array([[0.8596, 0.2135], [0.6461, 0.2290], [0.1206, 0.2137], [0.3341, 0.2291], [0.4901, 0.6278]])
"""dlib's mean positions of eye corners (image-right outer, inner, image-left outer, inner) and nose base, box units."""
TEMPLATE_LANDMARKS = (263, 362, 33, 133, 2)
"""Landmarks of the face mesh at the points of ``TEMPLATE``."""


@dataclass(frozen=True)
class Population:
    """Distribution of the descriptors of different people.

    Attributes:
        mean: (128,) float64.
        impostor: "distance_mean", "distance_p05", "centred_cosine_mean", "centred_cosine_p95" over all pairs; a pair's
            cosine is centred by the mean of all other faces.
    """

    mean: Float64
    impostor: dict[str, float]


class Recogniser(Loaded):
    """The identity network; 30 ms to load, 5 ms a face on two cores."""

    def __init__(self) -> None:
        self._session = load_session("face_identity")

    def embed(self, pixels: UInt8, landmarks: AnyFloat) -> Embedding:
        """(128,) float32 descriptor of a face.

        Args:
            pixels: (H, W, 3) uint8 sRGB.
            landmarks: (468, 2 or 3) photo pixels.

        Raises:
            ValueError: landmarks are not finite or coincide.
        """
        crop = alignment(landmarks).cut(pixels, SIZE)
        (embedding,) = self._session.run({"image": crop.astype(np.float32)[None]})
        return np.asarray(embedding[0], np.float32)


def alignment(landmarks: AnyFloat) -> Region:
    """The square of the photo whose 150-pixel crop has eyes and nose where dlib's template has them.

    Least-squares similarity transform without reflection (Umeyama 1991), from template to photo.
    """
    target = np.asarray(landmarks, np.float64)[list(TEMPLATE_LANDMARKS), :2]
    source = (TEMPLATE + PADDING) / (1 + 2 * PADDING)
    a, b = source - source.mean(0), target - target.mean(0)
    along = float((a * b).sum())
    across = float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    side = float(np.hypot(along, across) / (a**2).sum())
    if not np.isfinite(side) or side < 1.0:
        raise ValueError(f"landmarks of eyes and nose are not finite or coincide (alignment has side {side:.3g} px)")
    angle = float(np.arctan2(across, along))
    cos, sin = np.cos(angle) * side, np.sin(angle) * side
    x, y = target.mean(0) + np.array([[cos, -sin], [sin, cos]]) @ (0.5 - source.mean(0))
    return Region(float(x), float(y), side, angle)


def distance(one: AnyFloat, other: AnyFloat) -> float:
    """Euclidean distance of two descriptors: 0 the same picture, under 0.6 the same person."""
    return float(np.linalg.norm(np.asarray(one, np.float64) - np.asarray(other, np.float64)))


def centred_cosine(one: AnyFloat, other: AnyFloat, mean: AnyFloat | None = None) -> float:
    """Cosine in [-1, 1] of two descriptors after subtraction of ``mean`` (default: the population's).

    About 0 for different people and 1 for the same picture; 0 where a descriptor equals the mean.
    """
    centre = population().mean if mean is None else np.asarray(mean, np.float64)
    a, b = np.asarray(one, np.float64) - centre, np.asarray(other, np.float64) - centre
    length = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.clip(a @ b / length, -1.0, 1.0)) if length > 1e-12 else 0.0


@lru_cache(maxsize=1)
def population() -> Population:
    """The shipped population; ModelFault when its file is missing, changed or malformed."""
    data = checked_bytes("face_identity_population")
    try:
        content = json.loads(data)
        mean = np.array(content["mean"], np.float64)
        impostor = {str(k): float(v) for k, v in content["impostor"].items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ModelFault(f"face_identity_population: not JSON with mean and impostor ({error})") from error
    if mean.shape != (DIMENSIONS,) or not np.isfinite(mean).all():
        raise ModelFault(f"face_identity_population: the mean has shape {mean.shape} or is not finite")
    return Population(mean, impostor)
