"""Hair of strands on synthetic people: which groom somebody wears, fitted to their head, and lines for the renderer.

Grooms grow on the mean head (``service.hair.groom``); a smooth field carries them to anybody's. A groom serves
``SHARED`` people, as growing it costs as much as a portrait; each of them has a head, colour, camera and light of their
own, and every other one wears its mirror image.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from models.hair.draw import transmitted
from models.hair.random_styles import sample_melanin, sample_style
from models.lightstage.skin.streams import Stream
from models.people.light import DIRECTIONS, Light
from models.people.person import Person, the_head
from models.people.skins import Skin
from service.hair.colour import HairColour, absorption_of
from service.hair.groom import Groom, make_groom
from service.hair.style import Parting, Style
from service.light.environment import flux_by_direction, spread_directions

Float = npt.NDArray[np.float32]
Hides = Callable[[Float], npt.NDArray[np.bool_]]
"""Which of points (N, 3), metres on the head, lie under a hat."""

SHARED = 3
"""People who wear one groom, if they are of one sex."""
CHANCE: Mapping[bool, Mapping[str, float]] = {
    False: {"shaved": 0.02, "crop": 0.04, "side_part": 0.05, "slicked_back": 0.02, "afro": 0.05, "bob": 0.16,
            "curly": 0.11, "long_wavy": 0.21, "ponytail": 0.20, "bun": 0.14},
    True: {"shaved": 0.10, "crop": 0.27, "side_part": 0.23, "slicked_back": 0.13, "afro": 0.06, "bob": 0.03,
           "curly": 0.08, "long_wavy": 0.04, "ponytail": 0.04, "bun": 0.02},
}  # fmt: skip
"""How often women and men (True) begin as each of the named styles.

A frontal photo can hardly tell hair that is tied behind from short hair by strands alone; who wears it is evidence too,
and nothing is rare enough not to be learnt.
"""
FAIR_DEG = (-10.0, 40.0)
"""Individual typology angles of skin between which hair goes from black and brown to any."""
ODD = 0.2
"""Share of people whose hair does not go with their skin: domain randomisation."""
COUNT, SHORT_COUNT = 8000, 18_000
"""Strands of a full head: those of a groom that hangs, and of hair so short that it hardly overlaps."""
SHORT_MM = 40.0
MOST_POINTS = 48
"""Points of a strand that are drawn."""
AXIS = np.array([0.0, 0.02, -0.075], np.float32)
"""Of the body of hair: outwards is away from the vertical through it, and above it from it."""
FIELD_CELL_M, FIELD_NEAR_M = 0.03, 0.02
"""Grid of the field that carries grooms to other heads, and within how much of a vertex that vertex alone tells."""
CAST = 5
"""Every so many strands casts a shadow on the rest of the person; lamps see them as lines of a millimetre."""
DYED = 0.06
"""Share of people whose hair is of a colour that no melanin gives."""


@dataclass(frozen=True)
class WornGroom:
    """Hair of one person.

    Attributes:
        style: what it is; its parting is the mirror image's where it is mirrored.
        groom: as grown, on the mean head.
        strands: (N, P, 3) float32 metres on the person's head, root first.
        albedo: (N, P, 3) float32 linear RGB of many strands together.
        mean: (3,) float32 its mean, for brows, beard and roots.
        gloss: factor of its highlights.
    """

    style: Style
    groom: Groom
    strands: Float
    albedo: Float
    mean: Float
    gloss: float


@functools.lru_cache(maxsize=2)
def _grown(number: int, male: bool) -> Groom:
    style = sample_style(number, CHANCE[male])
    short = max(style.top_mm, style.sides_mm, style.back_mm) < SHORT_MM
    return make_groom(style, number, SHORT_COUNT if short else COUNT)


MIRRORED: dict[Parting, Parting] = {"left": "right", "right": "left"}


def wear_groom(seed: int, person: Person, skin: Skin) -> WornGroom | None:
    """The groom that the person named ``seed`` with a skin wears; None where nothing of it grows."""
    s, rng = Stream(seed, "groom"), np.random.default_rng([seed, 0x6A2])
    groom = _grown(seed // SHARED, skin.male)
    strands = groom.strands
    if not len(strands):
        return None
    if strands.shape[1] > MOST_POINTS:
        strands = strands[:, np.linspace(0, strands.shape[1] - 1, MOST_POINTS).round().astype(int)]
    style = groom.style
    if seed % 2:
        strands = strands * np.array([-1, 1, 1], np.float32)
        style = dataclasses.replace(style, parting=MIRRORED.get(style.parting, style.parting))
    fair = 1.0 if s.chance(ODD) else float(np.clip(np.interp(skin.angle_deg, FAIR_DEG, (0, 1)), 0, 1))
    colour = HairColour.of(sample_melanin(rng, fair), len(strands), rng)
    if s.chance(DYED):
        dye = absorption_of(np.clip(s.uniform(0.01, 0.55, 3), 0.01, 0.6))
        colour = dataclasses.replace(colour, melanin=0.15 * colour.melanin, dye=dye)
    strands = carried(strands, person)
    albedo = colour.linear(strands.shape[1])
    mean = albedo.reshape(-1, 3).mean(0).astype(np.float32)
    return WornGroom(style, groom, strands, albedo, mean, float(np.clip(s.log_normal(0.9, 0.5)[0], 0.2, 2.5)))


def carried(points: Float, person: Person) -> Float:
    """Points (..., 3) beside the mean head as they lie beside a person's."""
    head = the_head()
    skin = np.unique(head.triangles[head.triangle_part == head.part_names.index("skin")])[::4]
    at, moved = head.mean[skin].astype(np.float32), (person.neutral - head.mean)[skin].astype(np.float32)
    low = points.reshape(-1, 3).min(0) - FIELD_CELL_M
    count = np.ceil((points.reshape(-1, 3).max(0) + FIELD_CELL_M - low) / FIELD_CELL_M).astype(int) + 1
    axes = [low[k] + FIELD_CELL_M * np.arange(count[k], dtype=np.float32) for k in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    apart = (nodes**2).sum(1)[:, None] - 2 * nodes @ at.T + (at**2).sum(1)
    weight = 1 / np.square(np.maximum(apart, 0) + np.float32(FIELD_NEAR_M**2))
    field = (weight @ moved / weight.sum(1, keepdims=True)).reshape(*count, 3)
    place = (points.reshape(-1, 3) - low).T / FIELD_CELL_M
    shift = np.stack([map_coordinates(field[..., k], place, order=1, mode="nearest") for k in range(3)], -1)
    return np.asarray(points + shift.reshape(points.shape), np.float32)


def covered(groom: Groom, vertices: Float) -> Float:
    """(V,) float32 in [0, 1]: how much of the skin round each vertex (V, 3) of the mean head has roots."""
    from scipy.spatial import cKDTree

    roots = groom.strands[:, 0]
    count = cKDTree(roots).query_ball_point(vertices, 0.008, return_length=True)
    full = 0.5 * len(roots) * np.pi * 0.008**2 / 0.055
    return np.asarray(np.clip(count / full, 0, 1), np.float32)


def outwards(points: Float) -> Float:
    """(..., 3) float32 unit directions from the middle of the head to points (..., 3)."""
    away = points - AXIS
    away[..., 1] = np.maximum(away[..., 1], 0)
    return np.asarray(away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-6), np.float32)


def vertices_of(worn: WornGroom, light: Light) -> Float:
    """(N * P, 19) float32 rows of ``FIELDS``."""
    strands = worn.strands
    points, flat = strands.shape[1], strands.reshape(-1, 3)
    along = np.gradient(strands, axis=1) if points > 1 else np.zeros_like(strands)
    along /= np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-9)
    out = outwards(flat)
    shown = dataclasses.replace(worn.groom, strands=strands)
    ways = [at / max(float(np.linalg.norm(at)), 1e-6) for at in light.at][:3]
    lit = np.ones((len(flat), 4), np.float32)
    for k, way in enumerate([*ways, np.array([0.1, 1.0, 0.35])]):
        lit[:, k if k < len(ways) else 3] = transmitted(shown, np.asarray(way, np.float32)).ravel()
    flux = flux_by_direction(light.sky, DIRECTIONS).astype(np.float32)
    towards = spread_directions(DIRECTIONS).astype(np.float32)
    sky = np.maximum(out @ towards.T * 0.7 + 0.3, 0) @ flux / np.float32(np.pi)
    rows = [flat, along.reshape(-1, 3), out, worn.albedo.reshape(-1, 3), lit, sky]
    return np.ascontiguousarray(np.concatenate(rows, 1), np.float32)


def lines(strands: Float, hides: Hides | None, every: int = 1) -> npt.NDArray[np.int32]:
    """(L, 2) int32 pairs of rows of :func:`vertices_of`; none under a hat."""
    count, points = strands.shape[:2]
    first = np.arange(0, count, every)[:, None] * points + np.arange(points - 1)
    pairs = np.stack([first, first + 1], -1).reshape(-1, 2)
    if hides is not None:
        pairs = pairs[~hides(strands.reshape(-1, 3))[pairs].any(1)]
    return np.ascontiguousarray(pairs, np.int32)


FIELDS = "3f 3f 3f 3f 4f 3f", ("position", "tangent", "outward", "albedo", "lit", "sky")


class Strands:
    """Lines on the card.

    Args:
        gl: context of moderngl.
        worn: hair; light: of the portrait; hides: where a hat hides it.
    """

    def __init__(self, gl: Any, programs: dict[str, Any], worn: WornGroom, light: Light, hides: Hides | None) -> None:
        self.gl, self.programs, self.gloss = gl, programs, worn.gloss
        index = lines(worn.strands, hides)
        self.empty = not len(index)
        if self.empty:
            return
        few = lines(worn.strands, hides, CAST)
        vertices = gl.buffer(vertices_of(worn, light).tobytes())
        all_, cast = gl.buffer(index.tobytes()), gl.buffer((few if len(few) else index[:1]).tobytes())
        own = [(vertices, *_layout(programs["draw"]))]
        self.draw_array = gl.vertex_array(programs["draw"], own, all_)
        self.cast_array = gl.vertex_array(programs["cast"], [(vertices, *_layout(programs["cast"]))], cast)
        self.owned = [vertices, all_, cast, self.draw_array, self.cast_array]

    def cast(self, matrix: npt.NDArray[np.floating]) -> None:
        """Draw them into a depth map."""
        if not self.empty:
            self.programs["cast"]["toClip"].write(np.asarray(matrix, np.float32).T.tobytes())
            self.cast_array.render(self.gl.LINES)

    def draw(self) -> None:
        """Draw them into the bound target; the uniforms are set."""
        if not self.empty:
            self.draw_array.render(self.gl.LINES)

    def release(self) -> None:
        """Free what they hold."""
        for one in () if self.empty else self.owned:
            one.release()


def _layout(program: Any) -> tuple[Any, ...]:
    known = [name if name in program else None for name in FIELDS[1]]
    text = " ".join(
        part if name else f"{4 * int(part[0])}x" for part, name in zip(FIELDS[0].split(), known, strict=True)
    )
    return (text, *(name for name in known if name))
