"""How sure the diffuse albedo is: the error of its brightness that two texels in three stay within.

A log-linear model of a texel's absolute error in log luminance, by what makes an albedo uncertain: that the photo does
not show the texel, and how far apart heads like this one are there (the posterior of
``service.reflectance.albedo.albedo_prior``); that little light, much light, clipped light or an edge of light was
divided out; that no white told how bright the light is. Its weights are the 68 % quantile regression (Koenker and
Bassett 1978) of ``benchmarks.albedo_error`` on rendered photos with known albedo.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np

from service.arrays import Float32, UInt8
from service.colour import LUMA
from service.errors import ModelFault
from service.image_filters import blurred, shrunk, stretched_to

FILE = Path(str(files("service"))) / "data" / "albedo" / "error.json"

CLUES = ("always", "unseen", "apart", "shade", "edge", "clipped", "dim", "no_white", "lids", "dark_skin")
"""What the model weighs, in the order of :func:`clues`."""

LEAST, MOST = 0.02, 1.0
"""Range of what is stated, natural logarithm of luminance; ``MOST`` stands for that or more."""

CLIPPED = 0.97
"""sRGB code of a channel from which light may be lost."""
DIM = -2.5
"""Log luminance of the texture below which noise and black level count."""
DARK = -2.0
"""Mean log luminance of the albedo below which skin counts as dark: much of what it shows is mirrored."""
DARKEST = 1e-3
"""Linear value at which logarithms stop."""
SOFT = 1.5
"""Standard deviation of the blur before edges are measured, texels of the context."""


@dataclass(frozen=True)
class ErrorModel:
    """Weights (K,) of ``CLUES`` in the natural logarithm of the stated error."""

    weights: Float32

    @classmethod
    def read(cls, path: Path = FILE) -> ErrorModel:
        """Read a file of ``benchmarks.albedo_error``.

        Raises:
            ModelFault: there is no such file, or it has not one finite weight for each clue.
        """
        try:
            told = json.loads(path.read_text("utf-8"))["weights"]
            weights = np.array([told[name] for name in CLUES], np.float32)
        except (OSError, KeyError, ValueError, TypeError) as error:
            raise ModelFault(
                f"{path}: no model of the albedo's error ({error}); benchmarks.albedo_error --fit writes it"
            ) from error
        if not np.isfinite(weights).all():
            raise ModelFault(f"{path}: weights have to be finite; they are {told}")
        return cls(weights)

    def stated(self, clue: Float32) -> Float32:
        """(h, w) float32 error in [``LEAST``, ``MOST``] by clues (K, h, w)."""
        logs = np.tensordot(self.weights, np.nan_to_num(clue), 1)
        return np.asarray(np.exp(np.clip(logs, np.log(LEAST), np.log(MOST))), np.float32)


@lru_cache(maxsize=1)
def error_model() -> ErrorModel:
    """The model in the box, read once a process."""
    return ErrorModel.read()


def clues(
    light: Float32, texture: Float32, seen: Float32, lids: Float32, apart: Float32 | None, white_seen: bool
) -> Float32:
    """(K, h, w) float32 channels ``CLUES`` of the context's chart.

    Args:
        light: (3, h, w) natural logarithm of the linear RGB light that was divided out.
        texture: (3, h, w) linear RGB.
        seen: (h, w) in [0, 1], skin that the photo shows.
        lids: (h, w) in [0, 1].
        apart: (h, w) >= 0, standard deviation of log luminance by the prior; None: not known.
        white_seen: whether sclera or teeth tell how bright the light is.
    """
    bright = np.asarray(np.tensordot(LUMA, light, 1), np.float32)
    shown = np.log(np.maximum(np.tensordot(LUMA, texture, 1), DARKEST)).astype(np.float32)
    weight = seen if float(seen.sum()) >= 1 else np.ones_like(seen)
    total = float(weight.sum())
    mean = float((bright * weight).sum()) / total
    pale = float(((shown - bright) * weight).sum()) / total
    soft = blurred(shown, SOFT)
    edge = np.hypot(cv2.Sobel(soft, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(soft, cv2.CV_32F, 0, 1, scale=1 / 8))
    coded = np.clip(texture.max(0), 0, 1) ** np.float32(1 / 2.2)
    same = np.ones_like(bright)
    return np.stack(
        [
            same,
            1 - np.clip(seen, 0, 1),
            np.clip(same if apart is None else apart, 0, 1),
            np.clip(np.abs(bright - mean), 0, 2),
            np.clip(edge, 0, 0.5),
            np.asarray(coded > CLIPPED, np.float32),
            np.clip(DIM - shown, 0, 3),
            same * np.float32(not white_seen),
            np.clip(lids, 0, 1),
            same * np.float32(np.clip(DARK - pale, 0, 2)),
        ]
    ).astype(np.float32)


def error_map(stated: Float32, skin: UInt8, size: tuple[int, int]) -> UInt8:
    """(H, W) uint8 of ``size`` (width, height), 255 = ``MOST``; that also where a texel is no skin, as it is painted.

    Args:
        stated: (h, w) of :meth:`ErrorModel.stated`.
        skin: (h', w') uint8, 255 on skin, 0 on eyes and teeth.
        size: of the map.
    """
    whole = stretched_to(stated, size)
    on_skin = shrunk(skin, size) * np.float32(1 / 255)
    return np.rint(255 / MOST * (MOST + on_skin * (whole - MOST))).clip(0, 255).astype(np.uint8)
