"""Weights of MakeHuman's macro targets (ancestry, gender, age, muscle, weight) for one person.

Each macro target is a corner of a grid; its weight is the product of linear hat functions of the parameters, as in
MakeHuman's own ``macro.json``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from models.head.source import target_path

ANCESTRIES = ("african", "asian", "caucasian")
GENDERS = ("female", "male")
AGES = ("child", "young", "old")
MUSCLES = ("minmuscle", "averagemuscle", "maxmuscle")
WEIGHTS = ("minweight", "averageweight", "maxweight")


@dataclass(frozen=True)
class Person:
    """Macro parameters.

    Attributes:
        ancestry: (3,) non-negative shares of ANCESTRIES, sum 1.
        gender: 0 female to 1 male.
        age: 0 child (about 12 years), 0.5 young (25), 1 old (90).
        muscle, weight: 0 least to 1 most, 0.5 average.
    """

    ancestry: npt.NDArray[np.float64]
    gender: float
    age: float
    muscle: float
    weight: float


def hats(value: float, count: int) -> npt.NDArray[np.float64]:
    """(count,) weights of equidistant nodes on [0, 1] for linear interpolation at ``value`` (clipped)."""
    position = np.clip(value, 0.0, 1.0) * (count - 1)
    return np.maximum(0.0, 1.0 - np.abs(np.arange(count) - position))


def macro_names() -> list[str]:
    """All macro targets used, in the order of ``macro_weights``."""
    names = [f"{r}-{g}-{a}" for r in ANCESTRIES for g in GENDERS for a in AGES]
    return names + [f"universal-{g}-{a}-{m}-{w}" for g in GENDERS for a in AGES for m in MUSCLES for w in WEIGHTS]


def macro_weights(person: Person) -> npt.NDArray[np.float64]:
    """Weights of ``macro_names()``."""
    gender = np.array([1 - person.gender, person.gender])
    age = hats(person.age, 3)
    grid = np.einsum("r,g,a->rga", person.ancestry, gender, age).ravel()
    body = np.einsum("g,a,m,w->gamw", gender, age, hats(person.muscle, 3), hats(person.weight, 3)).ravel()
    return np.concatenate([grid, body])


def macro_paths(data: Path) -> list[Path]:
    """Files of ``macro_names()``."""
    return [target_path(data, "macrodetails", name) for name in macro_names()]
