"""The list of captures, and which of them training never sees: whole subjects, whole lights, whole corners of skin."""

from __future__ import annotations

from dataclasses import dataclass

from models.lightstage.poses import EXPRESSIONS
from models.lightstage.skin.streams import Stream
from models.lightstage.skin.subject import Subject

SUBJECTS = 200
FIRST_SEED = 1000
HELD_OUT_SHARE = 0.1
LIGHT_HELD_OUT_SHARE = 0.15

TRAIN, HELD_OUT = "train", "held-out"


def corner(subject: Subject) -> str | None:
    """The corner of the skin's parameters that a subject lies in, if it is one that training never sees.

    Corners are joint extremes, so that each parameter alone is covered by training: what is tested is the combination.
    """
    angle, age = subject.tone.typology_angle_deg, subject.age_years
    if angle < -35.0 and age > 55.0:
        return "dark and old"
    if angle > 45.0 and subject.spots.freckles > 120.0:
        return "pale and freckled"
    if subject.surface.pore_diameter > 0.27 and subject.surface.primary_depth > 0.044:
        return "coarse"
    if subject.coupling.cavity_darkening > 0.14 and subject.coupling.free_noise < 0.013:
        return "colour follows height"
    return None


def subject_part(seed: int) -> str:
    """``train`` or ``held-out`` for the subject named ``seed``; never depends on which others are in use."""
    if Stream(seed, "split").chance(HELD_OUT_SHARE) or corner(Subject.sample(seed)) is not None:
        return HELD_OUT
    return TRAIN


def light_part(name: str) -> str:
    """The same for a light, named as its file or as ``procedural-<seed>``."""
    return HELD_OUT if Stream(0, f"light {name}").chance(LIGHT_HELD_OUT_SHARE) else TRAIN


@dataclass(frozen=True)
class Capture:
    """One subject in one expression."""

    seed: int
    expression: str
    part: str


def captures(subjects: int = SUBJECTS, first_seed: int = FIRST_SEED) -> list[Capture]:
    """All captures of the stage in order; all expressions of a subject are in the same part."""
    result = []
    for seed in range(first_seed, first_seed + subjects):
        part = subject_part(seed)
        result += [Capture(seed, name, part) for name in EXPRESSIONS]
    return result
