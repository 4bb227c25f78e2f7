"""Who a portrait shows: the shape of the head, its expression, its skin and the colour of its hair, by seed."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from models.lightstage.skin.streams import Stream
from models.people.expression import draw_expression
from models.people.sexes import with_sex
from models.people.skins import COUNT, default_folder, load_skin
from service.face.fit.landmark_fit import FIELDS, process_places
from service.head.files import load_head
from service.head.model import HeadModel
from service.head.regions import OpeningEdges, lid_edges

Float = npt.NDArray[np.float32]

FREEDOM = 5.0
"""Degrees of freedom of the t distribution of identity coefficients: tails heavier than the model's own."""
WIDEST = 4.0
"""Bound of a coefficient, standard deviations."""
WAVES = 40
STEPS = np.linspace(0.0, 1.0, 9)
"""Activations of eyeBlink between which the height of the opening is interpolated."""
OVERLAP_M = 0.0003
"""By how much closed lids pass each other, so that nothing shows between them."""


@dataclass(frozen=True)
class Person:
    """Somebody.

    Attributes:
        identity: (K,) float32 coefficients of the head model; residual: (V, 3) float32 metres on top.
        expression: (E,) float32 activations; eyes: state of the eyes ("open", "half", "closed", "wink").
        neutral, vertices: (V, 3) float32 metres, without and with the expression.
        skin: number of the skin, whose sex they have; tint: (3,) factors of its linear albedo.
        hair: (3,) linear RGB, or None for what goes with the skin.
        old: share of greying in [0, 1].
    """

    identity: Float
    residual: Float
    expression: Float
    eyes: str
    neutral: Float
    vertices: Float
    skin: int
    tint: Float
    hair: Float | None
    old: float


@functools.lru_cache(maxsize=1)
def the_head() -> HeadModel:
    """The head model in the box."""
    return load_head()


@functools.lru_cache(maxsize=1)
def _places() -> npt.NDArray[np.float64]:
    return process_places(the_head())


@functools.lru_cache(maxsize=1)
def _lids() -> tuple[OpeningEdges, ...]:
    """Edges of the lids of the subject's right eye and of the left."""
    found = [lid_edges(the_head(), side) for side in ("right", "left")]
    return tuple(edges for edges in found if edges is not None)


def lid_openings(vertices: Float) -> Float:
    """(2,) float32 mm between the lids of (V, 3) vertices in metres; negative where they overlap."""
    return np.asarray([1e3 * edges.height(vertices) for edges in _lids()], np.float32)


def lids_as_meant(vertices: Float, expression: Float) -> Float:
    """(E,) the expression with eyeBlink such that the lids close by the share that it says, whatever the shape.

    What the unit leaves open differs from shape to shape, and which row of a lid bounds the opening changes on the way.
    """
    head, out = the_head(), expression.copy()
    units = [head.expression_names.index(name) for name in ("eyeBlinkRight", "eyeBlinkLeft")]
    open_ = vertices - np.tensordot(expression[units], head.expression[units], 1)
    for unit, edges in zip(units, _lids(), strict=True):
        heights = [edges.height(open_ + step * head.expression[unit]) for step in STEPS]
        share = float(expression[unit])
        wanted = (1.0 - share) * heights[0] - share * OVERLAP_M
        falling = np.minimum.accumulate(heights)
        out[unit] = np.interp(wanted, falling[::-1], STEPS[::-1])
    return out


def _residual(s: Stream) -> Float:
    """(V, 3) float32 metres: random Fourier features (Rahimi and Recht 2007), more alike left and right than not."""
    points, size = _places(), s.log_normal(0.8, 0.5)[0]
    mirrored = points * [-1.0, 1.0, 1.0]
    total = np.zeros_like(points)
    for length, sigma in FIELDS:
        frequency = s.normal(size=3 * WAVES).reshape(3, WAVES) / length
        phase = s.uniform(0.0, 2 * np.pi, WAVES)
        gain = s.normal(size=3 * WAVES).reshape(WAVES, 3) * sigma * size * np.sqrt(2.0 / WAVES)
        direct = np.cos(points @ frequency + phase) @ gain
        other = (np.cos(mirrored @ frequency + phase) @ gain) * [-1.0, 1.0, 1.0]
        total += 0.80 * direct + 0.60 * other
    return np.asarray(total, np.float32)


def _identity(s: Stream, count: int) -> Float:
    """(K,) a t distribution, for some people flatter and for some wider."""
    chi = -2.0 * np.log(s.uniform(size=count)) - 2.0 * np.log(s.uniform(size=count)) + s.normal(size=count) ** 2
    wide = float(np.clip(s.log_normal(1.0, 0.3)[0], 0.4, 1.8))
    values = wide * s.normal(size=count) / np.sqrt(chi / FREEDOM) * np.sqrt((FREEDOM - 2) / FREEDOM)
    return np.asarray(np.clip(values, -WIDEST, WIDEST), np.float32)


def _hair(s: Stream) -> Float | None:
    """A dyed or unusual colour for one in seven, else what goes with the skin."""
    if not s.chance(0.15):
        return None
    choices = ([0.25, 0.15, 0.07], [0.30, 0.05, 0.02], [0.02, 0.012, 0.009], [0.35, 0.33, 0.30], [0.10, 0.02, 0.16],
               [0.02, 0.06, 0.20], [0.40, 0.10, 0.18])  # fmt: skip
    return np.asarray(choices[int(s.one() * len(choices))], np.float32) * s.one(0.7, 1.3)


def draw_person(seed: int, folder: Path | None = None, face: int | None = None) -> Person:
    """The person named ``seed``.

    Args:
        seed: >= 0.
        folder: where skins are kept (``models.people.skins``).
        face: whose expression they have; None: their own.
    """
    head, s = the_head(), Stream(seed, "somebody")
    tint = np.exp(s.normal(0.0, 0.12)[0] + s.normal(0.0, 0.03, 3))
    skin = int(s.one() * COUNT)
    male = load_skin(skin, folder or default_folder()).male
    identity = _identity(Stream(seed, "shape"), len(head.identity))
    identity = np.clip(with_sex(identity, male, float(Stream(seed, "sex").normal()[0])), -WIDEST, WIDEST)
    residual = _residual(Stream(seed, "residual"))
    expression, eyes = draw_expression(seed if face is None else face, head.expression_names)
    weights = np.asarray(expression, np.float32)
    neutral = head.shape(identity) + residual
    weights = lids_as_meant(neutral + np.tensordot(weights, head.expression, 1), weights)
    vertices = neutral + np.tensordot(weights, head.expression, 1)
    return Person(
        identity, residual, weights, eyes, neutral, np.asarray(vertices, np.float32), skin,
        np.asarray(tint, np.float32), _hair(s), float(np.clip(s.one(-0.6, 1.0), 0.0, 1.0)),
    )  # fmt: skip
