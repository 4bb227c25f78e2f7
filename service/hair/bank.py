"""A bank of styles with their silhouettes, and which of them look like the hair of a photo.

``python -m models.hair.bank`` makes it: random styles on the mean head, drawn from ``VIEWS`` on ``CELLS`` cells. A
photo's mask is laid over the view that is nearest to its own by the similarity between the two projected heads.
"""

from __future__ import annotations

import dataclasses
import zipfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from service.arrays import Bool, Float32, Float64, Int64, UInt8
from service.errors import ModelFault
from service.face.fit.fit import Fit
from service.geometry.camera import Camera
from service.geometry.sampling import sample_at
from service.hair.kinds import KINDS
from service.hair.reading import CELLS as PHOTO_CELLS
from service.hair.reading import HairReading
from service.hair.sight import Sight
from service.hair.style import LENGTHS, Style
from service.head.model import HeadModel
from service.head.regions import vertex_mask

FILE = Path(__file__).resolve().parents[1] / "data" / "hair" / "bank.npz"
CELLS = 56
"""Cells along a view, of ``SIDE_M / CELLS`` = 8 mm."""
SIDE_M, MIDDLE, DISTANCE_M = 0.46, (0.0, -0.02, -0.05), 1.2
"""Side of the square at the head, the point in its middle (head's frame, metres), and how far away the camera is."""
VIEWS = (*((yaw, pitch) for yaw in (-25, 0, 25) for pitch in (-15, 0, 15)), (-50, 0), (50, 0))
"""Yaw and pitch of the head in degrees, as :meth:`service.geometry.camera.Camera.yaw_pitch_roll_deg` has them."""
TEMPERATURE = 0.08
"""Loss by which a style becomes e times less likely."""
TRUST: dict[str, float] = {"length": 0.8, "gathered": 0.8, "parting": 0.65, "fringe": 0.8, "curl": 1.3}
"""Exponents of the reading's own probabilities."""
OVERSURE = 1.3
"""Temperature of the probabilities of kinds that are told: silhouettes and readings err together, so their product is
surer than right."""
ENDS_TRUST, ENDS_M = 0.5, 0.03
"""Weight of the height of the ends that was read, and the standard deviation that it has at least."""
CROPPED_MM = 5.0
"""Length of the longest strands below which a style is cropped to the skin."""
UNLIKELY = 0.02
"""Least probability that a reading can give to a choice."""


@dataclass(frozen=True)
class Bank:
    """Styles.

    Attributes:
        styles: n of them.
        masks: (n, views, CELLS * CELLS / 8) uint8, bits of their silhouettes row by row.
        ends: (n,) float32 metres, height of their lowest ends in the head's frame.
        kinds: (n, kinds) uint8, for each of ``service.hair.reading.KINDS`` the number of the choice.
    """

    styles: tuple[Style, ...]
    masks: UInt8
    kinds: UInt8
    ends: Float32

    def seen(self, view: int) -> Float32:
        """(2 n, CELLS * CELLS) float32 0 or 1: silhouettes of all styles, then of all their mirror images."""
        yaw, pitch = VIEWS[view]
        other = VIEWS.index((-yaw, pitch))
        plain, turned = (np.unpackbits(self.masks[:, v], axis=1) for v in (view, other))
        turned = turned.reshape(-1, CELLS, CELLS)[:, :, ::-1].reshape(len(turned), -1)
        return np.concatenate([plain, turned]).astype(np.float32)

    @property
    def cropped(self) -> Bool:
        """(2 n,) whether strands are too short to be grown, in the order of :meth:`seen`."""
        return np.tile([max(getattr(style, name) for name in LENGTHS) < CROPPED_MM for style in self.styles], 2)

    def style(self, index: int) -> Style:
        """By a row of :meth:`seen`."""
        style = self.styles[index % len(self.styles)]
        return style if index < len(self.styles) else mirrored(style)


@lru_cache(maxsize=1)
def read_bank(file: Path = FILE) -> Bank:
    """The bank in the box.

    Raises:
        ModelFault: the file is damaged or made by another version.
    """
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            styles = TypeAdapter(tuple[Style, ...]).validate_json(arrays["styles"].tobytes())
            bank = Bank(styles, arrays["masks"], arrays["kinds"], arrays["ends"])
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise ModelFault(f"{file} is no bank of styles: {error}") from error
    wanted = (len(styles), len(VIEWS), CELLS * CELLS // 8), (len(styles), len(KINDS))
    if (bank.masks.shape, bank.kinds.shape) != wanted:
        raise ModelFault(f"{file} has masks {bank.masks.shape} and kinds {bank.kinds.shape} for {len(styles)} styles")
    return bank


def mirrored(style: Style) -> Style:
    """With left and right exchanged."""
    swapped = {"left": "right", "right": "left"}.get(style.parting, style.parting)
    return dataclasses.replace(style, parting=swapped)  # type: ignore[arg-type]


def view_camera(yaw_deg: float, pitch_deg: float) -> Camera:
    """The camera of a view, whose picture is as many pixels wide as a reading has cells."""
    yaw, pitch = np.radians([yaw_deg, pitch_deg])
    # Where the camera stands as the head sees it.
    away = np.array([-np.sin(yaw) * np.cos(pitch), -np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    right = np.cross([0.0, 1.0, 0.0], away)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, -np.cross(away, right), -away])
    focal = PHOTO_CELLS / SIDE_M * DISTANCE_M
    middle = np.array(MIDDLE)
    translation = np.array([0.0, 0.0, DISTANCE_M]) - rotation @ middle
    return Camera(PHOTO_CELLS, PHOTO_CELLS, focal, np.full(2, PHOTO_CELLS / 2), rotation, translation)


@dataclass(frozen=True)
class Matches:
    """How likely the styles of a bank are.

    Attributes:
        probability: (2 n,) float64, sum 1, in the order of :meth:`Bank.seen`.
        overlap: (2 n,) float32 intersection over union with the photo's hair, in [0, 1].
    """

    probability: Float64
    overlap: Float32

    def best(self, count: int) -> Int64:
        """Rows of the likeliest, best first."""
        return np.argsort(-self.probability, kind="stable")[:count]

    def kinds(self, bank: Bank) -> dict[str, float]:
        """Probability of each kind of :func:`kind_of`, likeliest first."""
        found: dict[str, float] = {}
        softened = self.probability ** (1 / OVERSURE)
        for index, share in enumerate(softened / softened.sum()):
            name = kind_of(bank.styles[index % len(bank.styles)])
            found[name] = found.get(name, 0.0) + float(share)
        return dict(sorted(found.items(), key=lambda item: -item[1]))


def kind_of(style: Style) -> str:
    """What one would call it, without what its fringe adds to the name."""
    return style.kind.removesuffix("_fringe")


def match(bank: Bank, sight: Sight, fit: Fit, head: HeadModel, reading: HairReading) -> Matches:
    """Compare all styles of a bank with a photo.

    Args:
        bank: the styles.
        sight: the photo's hair.
        fit: the head in it.
        head: its topology.
        reading: its probabilities of kinds count as well.
    """
    yaw, pitch, _ = fit.camera.yaw_pitch_roll_deg()
    view = min(range(len(VIEWS)), key=lambda v: (VIEWS[v][0] - yaw) ** 2 + (VIEWS[v][1] - pitch) ** 2)
    hair, known = on_view(sight, fit, head, view)
    masks = bank.seen(view)
    both = masks @ (known * hair).ravel()
    union = float((known * hair).sum()) + masks @ known.ravel() - both
    overlap = both / np.maximum(union, 1e-6)
    logs = -(1 - overlap.astype(np.float64)) / TEMPERATURE
    doubled = np.concatenate([bank.kinds, _turned(bank.kinds)])
    for column, (name, choices) in enumerate(KINDS.items()):
        chance = np.array([max(reading.kinds[name].get(choice, 0.0), UNLIKELY) for choice in choices])
        logs += TRUST[name] * np.log(chance)[doubled[:, column]]
    ends, doubt = reading.ends_m
    logs -= ENDS_TRUST * 0.5 * np.tile((bank.ends - ends) ** 2, 2) / (doubt**2 + ENDS_M**2)
    share = np.exp(logs - logs.max())
    return Matches(share / share.sum(), np.asarray(overlap, np.float32))


def _turned(kinds: UInt8) -> UInt8:
    """Kinds of the mirror images: the parting changes its side."""
    turned = kinds.copy()
    names = list(KINDS["parting"])
    swap = np.array([names.index({"left": "right", "right": "left"}.get(name, name)) for name in names], np.uint8)
    column = list(KINDS).index("parting")
    turned[:, column] = swap[kinds[:, column]]
    return turned


def on_view(sight: Sight, fit: Fit, head: HeadModel, view: int) -> tuple[Float32, Float32]:
    """The photo's hair and where it is known, (CELLS, CELLS) float32 each, laid over a view of the bank."""
    own = np.flatnonzero(vertex_mask(head, "face", "scalp") > 0.5)
    there = view_camera(*VIEWS[view]).project(head.mean[own])
    here = sight.region.to_crop(fit.camera.project(fit.vertices[own]), PHOTO_CELLS)
    turn, shift = _similarity(there, here)
    at = (np.arange(CELLS) + 0.5) * (PHOTO_CELLS / CELLS)
    x, y = np.meshgrid(at, at)
    cells = np.stack([x.ravel(), y.ravel()], 1) @ turn.T + shift
    values = np.stack([sight.hair, sight.known], -1)
    read = sample_at(values, *(np.asarray(cells[:, k] - 0.5, np.float32) for k in (0, 1)))
    inside = ((cells >= 0) & (cells < PHOTO_CELLS)).all(1)
    hair, known = (np.asarray(read[:, k] * inside, np.float32).reshape(CELLS, CELLS) for k in (0, 1))
    return np.asarray(hair > 0.5, np.float32), known


def _similarity(source: Float64, target: Float64) -> tuple[Float64, Float64]:
    """Matrix (2, 2) and shift (2,) of the similarity that best brings points (N, 2) onto others (Umeyama 1991)."""
    a, b = source - source.mean(0), target - target.mean(0)
    size = max(float((a**2).sum()), 1e-12)
    cos, sin = (a * b).sum() / size, (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / size
    turn = np.array([[cos, -sin], [sin, cos]])
    return turn, target.mean(0) - turn @ source.mean(0)
