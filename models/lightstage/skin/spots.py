"""Freckles, moles, lentigines, acne and its marks, blackheads, papules, scars, fine vessels and veins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from models.lightstage.skin.anatomy import Anatomy
from models.lightstage.skin.curves import OWN_VALUES, distance, grown, segments
from models.lightstage.skin.sites import scatter
from models.lightstage.skin.splat import Marks, accumulator, add, finished, peak, raise_to, stamps
from models.lightstage.skin.streams import Stream
from models.lightstage.skin.subject import Subject
from models.lightstage.skin.window import ChartWindow

Float = npt.NDArray[np.float64]

SPOT_VALUES = (
    "radius",
    "edge",
    "cos",
    "sin",
    "stretch",
    "melanin",
    "blood",
    "height",
    "pale",
    "lobe",
    "lobe2",
    "gloss",
)


def _list(anatomy: Anatomy, stream: Stream, count: float, mask: Float, **values: Float | float) -> Marks:
    """``count`` expected spots over a mask; named values are repeated or cut to the number drawn."""
    area = float((mask * anatomy.atlas.area_mm2).sum()) / 100.0
    density = mask * (count / max(area, 1e-6))
    uv = scatter(anatomy.atlas, stream, density.astype(np.float32))
    n = len(uv)
    angle = stream.uniform(0.0, np.pi, n)
    table = {
        "edge": np.full(n, 0.2), "cos": np.cos(angle), "sin": np.sin(angle), "stretch": stream.uniform(1.0, 1.35, n),
        "melanin": np.zeros(n), "blood": np.zeros(n), "height": np.zeros(n), "pale": np.zeros(n),
        "lobe": stream.normal(0.0, 0.35, n), "lobe2": stream.normal(0.0, 0.35, n), "gloss": np.zeros(n),
    }  # fmt: skip
    for name, value in values.items():
        table[name] = np.resize(np.asarray(value, np.float64), n) if n else np.zeros(0)
    matrix = np.stack([table[name] for name in SPOT_VALUES], 1)
    reach = 1.6 * table["radius"] * table["stretch"] + 2.0 * table["edge"]
    return Marks(uv, anatomy.atlas.frames(uv), reach, matrix)


def list_spots(subject: Subject, anatomy: Anatomy) -> Marks:
    """All spots of a subject, see ``SPOT_VALUES``: lengths in mm, melanin added, blood as a change of its logarithm."""
    spots, a = subject.spots, anatomy
    bare = (a["seen"] * (1.0 - a["lips"]) * (1.0 - a["scalp"])).astype(np.float64)
    face = bare * (0.15 + 0.85 * a["face"])
    sunny = bare * np.clip(
        0.8 * a["cheek"] + 0.7 * a["nose"] + 0.35 * a["forehead"] + 0.25 * a["under_eye"] + 0.05, 0.0, 1.0
    )
    beard = bare * np.clip(0.5 * a["cheek"] + 0.6 * a["chin"] + 0.5 * a["forehead"] + 0.15 * a["face"], 0.0, 1.0)
    m = subject.tone.melanin

    def stream(name: str) -> Stream:
        return Stream(subject.seed, f"spots {name}")

    def many(name: str, median: float, sigma: float, low: float, high: float) -> Float:
        return np.clip(stream(f"{name} size").log_normal(median, sigma, 4096), low, high)

    s = stream("strength")
    freckle = s.uniform(0.25, 1.0, 4096) ** 1.5 * spots.freckle_melanin * (0.045 + 0.5 * m)
    acne_stage = s.uniform(0.0, 1.0, 4096)
    mole = s.uniform(0.2, 0.9, 4096)
    lists = [
        _list(a, stream("freckles"), spots.freckles, sunny,
              radius=0.5 * many("freckles", 1.3, 0.4, 0.5, 4.0), edge=0.35, melanin=freckle),
        _list(a, stream("lentigines"), spots.lentigines, sunny, radius=0.5 * many("lentigines", 3.6, 0.45, 1.8, 11.0),
              edge=0.5, melanin=s.uniform(0.15, 0.8, 4096) * (0.03 + 0.5 * m)),
        _list(a, stream("moles"), spots.moles * 1.6, bare, radius=0.5 * many("moles", 1.9, 0.4, 0.9, 5.5), edge=0.3,
              melanin=mole, height=np.where(s.uniform(size=4096) < 0.25, s.uniform(0.15, 0.6, 4096), 0.02)),
        _list(a, stream("acne"), spots.acne, beard, radius=0.5 * many("acne", 2.6, 0.3, 1.2, 5.0), edge=1.1,
              blood=np.log(s.uniform(1.8, 4.0, 4096)), height=0.35 * acne_stage**2,
              pale=np.where(acne_stage > 0.8, 1.0, 0.0), gloss=0.15),
        _list(a, stream("acne marks"), spots.acne_marks, beard, radius=0.5 * many("acne marks", 2.4, 0.35, 1.0, 5.0),
              edge=0.9, blood=np.log(s.uniform(1.05, 1.6, 4096)), melanin=s.uniform(0.1, 0.5, 4096) * (0.02 + 0.35 * m),
              height=-0.02),
        _list(a, stream("blackheads"), spots.blackheads, a["seen"] * np.clip(a["nose"] + 0.4 * a["alae"], 0, 1),
              radius=0.5 * many("blackheads", 0.26, 0.2, 0.16, 0.42), edge=0.12,
              melanin=s.uniform(0.1, 0.35, 4096), height=0.01),
        _list(a, stream("papules"), spots.papules, face, radius=0.5 * many("papules", 1.2, 0.4, 0.5, 2.6), edge=0.6,
              height=s.uniform(0.02, 0.12, 4096), blood=s.normal(0.0, 0.12, 4096)),
        # Nobody's skin is even: faint brown and red dots are everywhere.
        _list(a, stream("dots"), 900.0, face, radius=0.5 * many("dots", 0.7, 0.5, 0.25, 2.2), edge=0.3,
              melanin=s.uniform(0.0, 1.0, 4096) ** 3 * 0.35 * (0.01 + m), blood=s.uniform(-0.15, 0.35, 4096)),
    ]  # fmt: skip
    return Marks.joined(lists)


@dataclass(frozen=True)
class SpotMaps:
    """(h, w) each: melanin added, change of log blood, height (mm), pale cover in [0, 1], loss of gloss."""

    melanin: Tensor
    blood: Tensor
    height: Tensor
    pale: Tensor


def draw_spots(marks: Marks, window: ChartWindow, device: torch.device | str = "cpu") -> SpotMaps:
    """Uneven discs with soft edges; raised ones are domes, those with a head pale in the middle."""
    melanin, blood, height = (accumulator(window, device) for _ in range(3))
    pale = peak(window, device)
    for s in stamps(marks, window, device):
        radius, edge, cos, sin, stretch, fm, fb, rise, head, lobe, lobe2, _ = s.values
        along, across = (s.a * cos + s.b * sin) / stretch, -s.a * sin + s.b * cos
        r = (along * along + across * across).sqrt().clamp(min=1e-4)
        x, y = along / r, across / r
        # Outline: second and third harmonics of the angle, written without angles.
        uneven = lobe * (x * x - y * y) + lobe2 * (x * x * x - 3.0 * x * y * y) + 0.7 * lobe * lobe2 * y
        outline = radius * (1.0 + 0.28 * uneven)
        soft = torch.maximum(edge, 0.8 * s.size_mm)
        inside = (0.5 - (r - outline) / (2.0 * soft)).clamp(0.0, 1.0)
        inside = inside * inside * (3.0 - 2.0 * inside) * (radius / (0.6 * s.size_mm)).clamp(max=1.0)
        add(melanin, s.texel, fm * inside)
        add(blood, s.texel, fb * inside)
        dome = (1.0 - (r / (outline + soft)) ** 2).clamp(min=0.0)
        add(height, s.texel, rise * dome * dome.sqrt())
        raise_to(pale, s.texel, head * (1.0 - (r / (0.45 * radius)) ** 2).clamp(0.0, 1.0))
    return SpotMaps(*(finished(t, window) for t in (melanin, blood, height, pale)))


VESSEL_VALUES = ("width", "blood", "blue", "melanin", "height")


def list_lines(subject: Subject, anatomy: Anatomy) -> Marks:
    """Vessels, veins and scars as segments; values after the segment's own: see ``VESSEL_VALUES``."""
    a, spots = anatomy, subject.spots
    red = (a["seen"] * np.clip(1.2 * a["alae"] + 0.25 * a["cheek"] + 0.15 * a["nose"], 0.0, 1.0)).astype(np.float64)
    blue = (a["seen"] * np.clip(a["temple"] + 0.5 * a["under_eye"], 0.0, 1.0)).astype(np.float64)
    bare = (a["seen"] * (1.0 - a["scalp"]) * (0.2 + 0.8 * a["face"])).astype(np.float64)
    lists = [Marks(np.zeros((0, 2)), np.ones((0, 3)), np.zeros(0), np.zeros((0, OWN_VALUES + len(VESSEL_VALUES))))]
    kinds = (
        ("telangiectasia", spots.telangiectasia * 2.0, red, 6, (2.0, 6.0), (0.1, 0.22), (0.35, 1.0, 0.0, 0.0, 0.0)),
        ("veins", 5.0 * spots.veins, blue, 8, (12.0, 30.0), (1.0, 2.2), (0.0, 0.0, 0.55, 0.0, 0.0)),
        ("scars", spots.scars, bare, 6, (4.0, 16.0), (0.3, 1.2), (0.0, -0.35, 0.0, -0.25, 0.06)),
    )
    for name, count, mask, pieces, lengths, widths, effect in kinds:
        s = Stream(subject.seed, f"lines {name}")
        area = float((mask * a.atlas.area_mm2).sum()) / 100.0
        if area < 1e-6 or count <= 0:
            continue
        root = scatter(a.atlas, s, (mask * (count / area)).astype(np.float32))
        n = len(root)
        if n == 0:
            continue
        uv = grown(a, root, s.uniform(0.0, 2 * np.pi, n), s.normal(0.0, 1.1, n), s.uniform(*lengths, size=n), pieces)
        wander = s.normal(0.0, 0.06, n * (pieces + 1) * 2).reshape(uv.shape)
        uv = uv + wander * np.linalg.norm(uv[:, -1] - uv[:, 0], axis=1)[:, None, None]
        strength = s.uniform(0.4, 1.0, n)
        width = s.uniform(*widths, size=n)
        values = np.zeros((n, pieces, len(VESSEL_VALUES)))
        values[..., 0] = width[:, None]
        sign = np.where(s.uniform(size=n) < 0.5, 1.0, -1.0) if name == "scars" else np.ones(n)
        for k, base in enumerate((effect[1], effect[2], effect[3], effect[4])):
            values[..., k + 1] = (base * strength * (sign if k == 3 else 1.0))[:, None]
        lists.append(segments(a, uv, values, 2.2 * np.repeat(width[:, None], pieces, 1) + 0.1))
    return Marks.joined(lists)


@dataclass(frozen=True)
class LineMaps:
    """(h, w) each: change of log blood, veil of blue in [0, 1], change of log melanin, height (mm)."""

    blood: Tensor
    blue: Tensor
    melanin: Tensor
    height: Tensor


def draw_lines(marks: Marks, window: ChartWindow, device: torch.device | str = "cpu") -> LineMaps:
    """Soft lines; pieces of one line meet without adding up."""
    up, down, blue, pale = (peak(window, device) for _ in range(4))
    rise, sink = peak(window, device), peak(window, device)
    for s in stamps(marks, window, device):
        _, away = distance(s)
        width, blood, vein, melanin, height = s.values[OWN_VALUES:]
        wide = (width * width + s.size_mm * s.size_mm).sqrt()
        shape = torch.exp(-0.5 * (away / (0.5 * wide)) ** 2) * width / wide
        raise_to(up, s.texel, blood.clamp(min=0.0) * shape)
        raise_to(down, s.texel, (-blood).clamp(min=0.0) * shape)
        raise_to(blue, s.texel, vein * shape)
        raise_to(pale, s.texel, (-melanin).clamp(min=0.0) * shape)
        raise_to(rise, s.texel, height.clamp(min=0.0) * shape)
        raise_to(sink, s.texel, (-height).clamp(min=0.0) * shape)
    done = [finished(t, window) for t in (up, down, blue, pale, rise, sink)]
    return LineMaps(done[0] - done[1], done[2], -done[3], done[4] - done[5])
