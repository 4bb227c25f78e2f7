"""The albedo of a whole head, completed from the part of it that a photo shows.

Ears are redder than cheeks, a beard on the chin goes on along the jaw, lids and lips have their own hues: what a face
shows of its skin tells much of the rest. A Gaussian over maps of log albedo (probabilistic principal components:
Tipping and Bishop 1999), learnt from the light stage (``models.training.albedo_prior``), has for its mean, given the
texels that are seen, the likeliest rest. It stands for the texture prior of AvatarMe, whose generator completes T
(section 3.1). There are two: of heads of all kinds, and of heads without a beard, for photos that show none. By the
first alone, what is left of shade on a woman's jaw is likeliest a beard.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import numpy as np
import numpy.typing as npt

from service.arrays import Float32
from service.colour import LUMA
from service.errors import ModelFault
from service.image_filters import shrunk, stretched_to

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
