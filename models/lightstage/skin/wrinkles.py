"""Wrinkles: where they run, how deep age and the expression make them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from models.lightstage.skin.anatomy import Anatomy
from models.lightstage.skin.curves import OWN_VALUES, distance, segments, smooth_curve
from models.lightstage.skin.splat import Marks, finished, peak, raise_to, stamps
from models.lightstage.skin.streams import Stream
from models.lightstage.skin.subject import Subject
from models.lightstage.skin.window import ChartWindow

Float = npt.NDArray[np.float64]

_PIECE_MM = 1.1
_REACH = 4.5

UNITS: dict[str, dict[str, float]] = {
    "forehead": {"browInnerUp": 1.0, "browOuterUp": 0.7},
    "glabella": {"browDown": 1.2},
    "crow": {"eyeSquint": 0.7, "mouthSmile": 0.8, "cheekSquint": 0.5, "eyeBlink": 0.15},
    "under_eye": {"eyeSquint": 0.7, "cheekSquint": 0.5, "mouthSmile": 0.4},
    "nasolabial": {"mouthSmile": 0.9, "noseSneer": 0.6, "mouthUpperUp": 0.5, "cheekSquint": 0.3},
    "marionette": {"mouthFrown": 0.9, "mouthStretch": 0.4},
    "bunny": {"noseSneer": 1.1},
    "upper_lip": {"mouthPucker": 1.0, "mouthFunnel": 0.4},
    "smile": {"mouthSmile": 0.7, "mouthDimple": 0.6, "mouthStretch": 0.3},
    "neck": {"mouthStretch": 0.3},
    "lid": {},
}
"""How much each ARKit unit adds to the strength of a family of wrinkles; sided units act on their own side."""


def activation(expression: dict[str, float], family: str, side: int) -> float:
    """Strength that an expression adds: ``side`` 1 is the subject's left, -1 the right, 0 the middle (mean of both)."""
    total = 0.0
    for unit, gain in UNITS[family].items():
        if unit in expression:
            total += gain * expression[unit]
            continue
        left, right = expression.get(f"{unit}Left", 0.0), expression.get(f"{unit}Right", 0.0)
        total += gain * (left if side > 0 else right if side < 0 else 0.5 * (left + right))
    return total


@dataclass(frozen=True)
class Family:
    """Lines of one kind: control points in front-view mm (C, N, 2), depth and width in mm at strength 1."""

    name: str
    lines: list[Float]
    depth: float
    width: float
    side: int


def _families(subject: Subject, anatomy: Anatomy) -> list[Family]:
    p, s = anatomy.points, Stream(subject.seed, "wrinkle lines")

    def jittered(points: list[tuple[float, float]], amount: float = 1.2) -> Float:
        line = np.array(points, np.float64)
        return line + s.normal(0.0, amount, line.size).reshape(line.shape)

    brow_y = p["brow_inner"][1]
    kinds = (("forehead", 0.16, 0.75), ("glabella", 0.18, 0.6), ("neck", 0.2, 0.9))
    families = [Family(name, [], depth, width, 0) for name, depth, width in kinds]
    count = int(s.one(3, 6.99))
    for k in range(count):
        y = brow_y + 14.0 + (k + s.one(-0.25, 0.25)) * 34.0 / count
        left, right = s.one(-46, -18), s.one(18, 46)
        bow = s.one(-1.0, 3.0)
        xs = np.linspace(left, right, 6)
        families[0].lines.append(jittered([(x, y + bow * np.cos(x / 22.0) - 0.0025 * x * x) for x in xs], 0.9))
    for x in (-5.5 - s.one(0, 2), 5.5 + s.one(0, 2)):
        families[1].lines.append(jittered([(x * 0.9, brow_y - 7), (x, brow_y + 1), (x * 1.1, brow_y + 10)], 0.7))
    for k in range(int(s.one(2, 4.99))):
        y = p["chin"][1] - 22.0 - 13.0 * k + s.one(-3, 3)
        families[2].lines.append(jittered([(x, y + 0.004 * x * x) for x in np.linspace(-38, 38, 6)], 1.0))
    for side in (1, -1):
        families += _sided(p, s, side)
    return families


def _sided(p: dict[str, Float], s: Stream, side: int) -> list[Family]:
    def line(points: list[tuple[float, float]], amount: float = 1.0) -> Float:
        made = np.array(points, np.float64)
        made = made + s.normal(0.0, amount, made.size).reshape(made.shape)
        return made * [side, 1.0]

    outer, inner, ala, mouth = p["eye_outer"], p["eye_inner"], p["ala"], p["mouth_corner"]
    crow, under, lid, upper, bunny = [], [], [], [], []
    for angle in np.linspace(-50, 42, int(s.one(4, 8.99))) + s.one(-5, 5):
        a, length = np.radians(angle + s.one(-4, 4)), s.one(9, 19)
        start = outer[:2] + 5.5 * np.array([np.cos(a), np.sin(a)])
        bend = 0.18 * np.sign(angle + 1e-6)
        ends = [start + r * length * np.array([np.cos(a + bend * r), np.sin(a + bend * r)]) for r in (0.0, 0.5, 1.0)]
        crow.append(line([tuple(e) for e in ends], 0.35))
    for k in range(int(s.one(8, 18))):
        r = 0.35 + 0.75 * k / 17.0
        t0, span = s.one(0.0, 0.55), s.one(0.25, 0.45)
        points = []
        for t in (t0, t0 + 0.5 * span, t0 + span):
            x = inner[0] + t * (outer[0] + 3 - inner[0])
            points.append((x, inner[1] - 4.0 - 13.0 * r * np.sin(np.pi * (0.12 + 0.76 * t))))
        under.append(line(points, 0.5))
    for lift in (5.5, 7.0):
        xs = np.linspace(inner[0] - 1.5, outer[0] + 2.5, 6)
        ys = inner[1] + 2.0 + lift * np.sin(np.pi * np.linspace(0.1, 0.9, 6))
        lid.append(line(list(zip(xs, ys, strict=True)), 0.15))
    fold = [(ala[0] + 1.5, ala[1] + 5.0), (ala[0] + 7, ala[1] - 8)]
    fold += [(mouth[0] + 7, mouth[1] + 13), (mouth[0] + 10, mouth[1] - 1)]
    down = [(mouth[0] + 4.5, mouth[1] - 3), (mouth[0] + 6.5, mouth[1] - 13), (mouth[0] + 6, mouth[1] - 24)]
    smile = [
        [(mouth[0] + d, mouth[1] + 9), (mouth[0] + d + 2.5, mouth[1]), (mouth[0] + d + 1.0, mouth[1] - 9)]
        for d in (13, 18)
    ]
    for _ in range(int(s.one(3, 6))):
        x = s.one(2.5, mouth[0] - 3)
        upper.append(line([(x, mouth[1] + 9.0), (x * 1.07, mouth[1] + 12.0), (x * 1.12, mouth[1] + 15.5)], 0.4))
    for k in range(3):
        y = inner[1] - 6 - 5 * k
        bunny.append(line([(3.0, y - 2), (7.5, y + 1.0), (11.5, y + 4)], 0.6))
    return [
        Family("crow", crow, 0.13, 0.4, side),
        Family("under_eye", under, 0.035, 0.22, side),
        Family("lid", lid, 0.14, 0.45, side),
        Family("nasolabial", [line(fold, 1.2)], 0.3, 1.3, side),
        Family("marionette", [line(down, 1.2)], 0.22, 1.0, side),
        Family("smile", [line(c, 1.5) for c in smile], 0.16, 1.0, side),
        Family("upper_lip", upper, 0.08, 0.4, side),
        Family("bunny", bunny, 0.12, 0.5, side),
    ]


def _resting(subject: Subject, family: str) -> float:
    s = subject.surface
    return {
        "forehead": s.forehead_lines, "glabella": s.glabella_lines, "crow": s.crow_feet, "under_eye": s.under_eye_lines,
        "nasolabial": s.nasolabial, "marionette": s.marionette, "upper_lip": s.upper_lip_lines, "neck": s.neck_lines,
        "lid": 0.5 + 0.5 * s.lid_lines, "smile": 0.12 * s.nasolabial, "bunny": 0.1 * s.glabella_lines,
    }[family]  # fmt: skip


def list_wrinkles(subject: Subject, anatomy: Anatomy, expression: dict[str, float]) -> Marks:
    """All wrinkles as segments; values after the segment's own: depth and width (mm).

    Lines lie where they lie whatever the expression; only their strength changes, and old skin folds deeper than young.
    """
    empty = Marks(np.zeros((0, 2)), np.ones((0, 3)), np.zeros(0), np.zeros((0, OWN_VALUES + 2)))
    if not anatomy.points:
        return empty
    curves: list[tuple[Float, Float, Float]] = []
    for number, family in enumerate(_families(subject, anatomy)):
        s = Stream(subject.seed, f"wrinkle {number}")
        folds = 0.35 + 0.65 * _resting(subject, family.name)
        strength = _resting(subject, family.name) + folds * activation(expression, family.name, family.side)
        curves += [_curve(s, family, line, strength) for line in family.lines]
    curves = [c for c in curves if c[1].max() > 0.002]
    if not curves:
        return empty
    on_chart = anatomy.in_front(np.concatenate([c[0] for c in curves]))
    parts = np.split(on_chart, np.cumsum([len(c[0]) for c in curves])[:-1])
    lists = [
        segments(anatomy, uv[None], np.stack([depth, width], 1)[None], _REACH * width[None])
        for uv, (_, depth, width) in zip(parts, curves, strict=True)
    ]
    return Marks.joined(lists)


def _curve(s: Stream, family: Family, line: Float, strength: float) -> tuple[Float, Float, Float]:
    """Front-view points (P + 1, 2) of a line that wanders a little, and depth and width of its P pieces in mm."""
    own, widths = float(s.log_normal(1.0, 0.35)[0]), float(s.log_normal(1.0, 0.2)[0])
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    pieces = max(3, int(length / _PIECE_MM))
    front = smooth_curve(line, pieces + 1)
    kernel = np.hanning(13)[1:-1] / np.hanning(13).sum()
    loose = s.normal(0.0, 1.0, 2 * (len(front) + len(kernel) - 1)).reshape(2, -1)
    wander = np.stack([np.convolve(x, kernel, "valid") for x in loose], 1)
    t = (np.arange(pieces) + 0.5) / pieces
    uneven = np.convolve(s.normal(0.0, 1.0, pieces + 4), np.ones(5) / 5, "valid")
    taper = np.sin(np.pi * t) ** 0.6 * np.clip(1.0 + 0.6 * uneven, 0.1, 2.0)
    depth = np.minimum(strength * own * family.depth * taper, 0.6)
    width = np.full(pieces, family.width * widths) * (0.7 + 0.3 * taper)
    return front + 0.7 * min(family.width, 0.8) * wander, depth, width


def draw_wrinkles(marks: Marks, window: ChartWindow, device: torch.device | str = "cpu") -> Tensor:
    """(h, w) depth in mm, >= 0: a groove with a rounded bed and walls that run out exponentially."""
    depth = peak(window, device)
    for s in stamps(marks, window, device):
        _, away = distance(s)
        deep, width = s.values[OWN_VALUES : OWN_VALUES + 2]
        bed = 0.35 * width + 0.4 * s.size_mm
        fall = ((away * away + bed * bed).sqrt() - bed) / width
        raise_to(depth, s.texel, deep * (torch.exp(-fall) - float(np.exp(-_REACH + 0.35))).clamp(min=0.0))
    return finished(depth, window)
