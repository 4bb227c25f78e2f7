"""The albedo of a whole head, completed from the part of it that a photo shows.

Ears are redder than cheeks, a beard on the chin goes on along the jaw, lids and lips have their own hues: what a face
shows of its skin tells much of the rest. A Gaussian over maps of log albedo (probabilistic principal components:
Tipping and Bishop 1999), learnt from the light stage (``models.training.albedo_prior``), has for its mean, given the
texels that are seen, the likeliest rest. It stands for the texture prior of AvatarMe, whose generator completes T
(section 3.1). There are two: of heads of all kinds, and of heads without a beard, for photos that show none. By the
first alone, what is left of shade on a woman's jaw is likeliest a beard.

**How sure the albedo is** says the error of its brightness that two texels in three stay within: a log-linear model of
a texel's absolute error in log luminance, by what makes an albedo uncertain: that the photo does not show the texel,
and how far apart heads like this one are there (the prior's posterior); that little light, much light, clipped light or
an edge of light was divided out; that no white told how bright the light is. Its weights are the 68 % quantile
regression (Koenker and Bassett 1978) of ``benchmarks.albedo_error`` on rendered photos with known albedo.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from service.arrays import Float32, UInt8
from service.colour import LUMA
from service.errors import ModelFault
from service.image_filters import blurred, shrunk, stretched_to

FILE = Path(str(files("service"))) / "data" / "albedo" / "prior.npz"

BARE = "bare_"
"""Before the names of the arrays of the prior of heads without a beard."""

SAME_ISLANDS = 0.95
"""Overlap (intersection over union) of a chart's islands with the prior's from which on it is the same chart."""


@dataclass(frozen=True)
class AlbedoPrior:
    """Gaussian over the albedo maps of heads.

    Attributes:
        mean: (3, h, w) float32 natural logarithm of linear albedo.
        components: (K, 3, h, w) float32, each as long as its standard deviation; offsets of whole channels among them,
            as measurements differ by a factor.
        noise: standard deviation of what the components leave of a texel, as if texels erred apart.
        inside: (h, w) float32 in [0, 1], islands of the chart.
    """

    mean: Float32
    components: Float32
    noise: float
    inside: Float32

    @classmethod
    def read(cls, path: Path = FILE, bearded: bool = True) -> AlbedoPrior:
        """Read one of the two priors in a file of ``models.training.albedo_prior``.

        Raises:
            ModelFault: there is no such file, or it is not what it should be.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                kind = "" if bearded else BARE
                mean, components = (file[kind + name].astype(np.float32) for name in ("mean", "components"))
                inside, noise = file["inside"].astype(np.float32), float(file[kind + "noise"])
        except (OSError, KeyError, ValueError) as error:
            raise ModelFault(
                f"{path}: no prior of albedo ({error}); its trainer is models.training.albedo_prior"
            ) from error
        if mean.shape != components.shape[1:] or mean.shape[1:] != inside.shape or not noise > 0:
            raise ModelFault(
                f"{path}: mean {mean.shape}, components {components.shape}, islands {inside.shape}, {noise}"
            )
        return cls(mean, components, noise, inside)

    def is_of(self, inside: Float32) -> bool:
        """Whether a chart with islands (H, W) is the one that it was learnt on."""
        other = _shrunk(inside[None], self.inside.shape)[0]
        union = float(np.maximum(other, self.inside).sum())
        return union > 0 and float(np.minimum(other, self.inside).sum()) / union > SAME_ISLANDS

    def apart(self, weight: Float32) -> Float32:
        """(H, W) float32 standard deviation of log luminance over the heads that agree with the seen part.

        Of the posterior, whose covariance depends on what is seen alone: ``weight`` (H, W) in [0, 1] as in
        :meth:`complete`.
        """
        shape = self.mean.shape[1:]
        share = _shrunk(weight[None], shape)[0] * self.inside
        covariance = np.linalg.inv(self._normal(share))
        grey = np.tensordot(self.components, LUMA, ((1,), (0,))).reshape(len(self.components), -1)
        variance = np.einsum("kn,kl,ln->n", grey, covariance.astype(np.float32), grey, optimize=True)
        plane = np.sqrt(np.maximum(variance, 0)).reshape(shape)
        return stretched_to(plane, weight.shape[::-1])

    def _normal(self, share: Float32) -> npt.NDArray[np.float64]:
        """(K, K) inverse covariance of the components' weights given the share (h, w) of each texel that is seen."""
        root = np.sqrt(np.broadcast_to(share, self.mean.shape).ravel()) / self.noise
        basis = self.components.reshape(len(self.components), -1) * root.astype(np.float64)
        return np.asarray(basis @ basis.T + np.eye(len(basis)))

    def complete(self, seen: Float32, weight: Float32) -> Float32:
        """(3, H, W) float32 log albedo that is likeliest given the seen part: smooth, also where it is seen.

        Args:
            seen: (3, H, W) log albedo; what it is where ``weight`` is 0 does not matter, so long as it is finite.
            weight: (H, W) in [0, 1], how far a texel is seen; 0 everywhere gives the mean of all heads.
        """
        shape = self.mean.shape[1:]
        share = _shrunk(weight[None], shape)[0] * self.inside
        values = _shrunk(seen * weight, shape) / np.maximum(_shrunk(weight[None], shape), np.float32(1e-6))
        basis = self.components.reshape(len(self.components), -1).astype(np.float64)
        trust = np.broadcast_to(share, self.mean.shape).ravel() / self.noise**2
        apart = (values - self.mean).ravel().astype(np.float64)
        coefficients = np.linalg.solve(self._normal(share), basis @ (trust * apart))
        whole = self.mean + np.tensordot(coefficients.astype(np.float32), self.components, 1)
        size = (weight.shape[1], weight.shape[0])
        return np.stack([stretched_to(plane, size) for plane in whole])


@lru_cache(maxsize=2)
def albedo_prior(bearded: bool) -> AlbedoPrior:
    """The prior in the box of heads of all kinds, or of those without a beard; each read once a process."""
    return AlbedoPrior.read(bearded=bearded)


def _shrunk(planes: Float32, shape: tuple[int, ...]) -> Float32:
    """(C, h, w) means over areas."""
    return np.stack([shrunk(np.ascontiguousarray(plane), (shape[1], shape[0])) for plane in planes])


ERROR_FILE = Path(str(files("service"))) / "data" / "albedo" / "error.json"

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
    def read(cls, path: Path = ERROR_FILE) -> ErrorModel:
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


def certainty(light: Float32, texture: Float32, seen: Float32) -> Float32:
    """(h, w) float32 in [0, 1], how far the albedo of seen skin (h, w) tells of the rest: less where it is more likely
    off than at the median of that skin, as at the edge of a cap's shadow, whose texels err together.

    Args: as in :func:`clues`.
    """
    error = error_model().stated(clues(light, texture, seen, np.zeros_like(seen), None, white_seen=True))
    usual = np.median(error[seen > 0.5]) if (seen > 0.5).any() else MOST
    return np.asarray(np.minimum(usual / error, 1) ** 4, np.float32)


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
