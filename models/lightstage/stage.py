"""The stage itself: the head model and its chart, set up once for all subjects."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from models.lightstage.poses import expression
from models.lightstage.skin.anatomy import Anatomy
from models.lightstage.skin.atlas import Atlas
from models.lightstage.skin.subject import Subject
from models.lightstage.skin.synthesis import Skin, vertices_of
from models.lightstage.skin.window import CHART_HEIGHT, CHART_WIDTH, ChartWindow
from service.head.files import DEFAULT_HEAD, load_head
from service.head.model import HeadModel


@dataclass(frozen=True)
class Stage:
    """Head model and regions; takes some seconds to set up and serves any number of subjects."""

    head: HeadModel
    anatomy: Anatomy

    @classmethod
    def open(cls, head: Path = DEFAULT_HEAD) -> Stage:
        """Load a head model and rasterise its chart."""
        return _open(head)

    def skin(self, seed: int, pose: str = "neutral", device: torch.device | str = "cpu") -> Skin:
        """The person named ``seed`` with a named expression (``models.lightstage.poses``)."""
        return Skin.of(Subject.sample(seed), self.anatomy, expression(pose, seed), device)

    def vertices(self, skin: Skin) -> npt.NDArray[np.float32]:
        """(V, 3) float32 metres of the skin's head with its expression."""
        return np.asarray(vertices_of(skin.subject, self.anatomy.atlas, skin.expression))

    def window(self, x_mm: float, y_mm: float, size: int, chart_width: int = CHART_WIDTH) -> ChartWindow:
        """A square window around the point of the face that a front view of the template shows at (x, y) mm."""
        height = chart_width * CHART_HEIGHT // CHART_WIDTH
        u, v = self.anatomy.in_front(np.array([[x_mm, y_mm]]))[0]
        return ChartWindow(
            int(u * chart_width) - size // 2, int((1.0 - v) * height) - size // 2, size, size, chart_width, height
        )

    def places(self) -> dict[str, tuple[float, float]]:
        """Front-view mm of places worth looking at, on the subject's left."""
        p = self.anatomy.points
        brow = 0.5 * (p["brow_inner"] + p["brow_outer"])
        return {
            "cheek": (p["eye_outer"][0], p["nose_tip"][1] + 3.0),
            "forehead": (10.0, brow[1] + 24.0),
            "nose": (p["nose_tip"][0] + 8.0, p["nose_tip"][1] + 2.0),
            "mouth": (p["mouth_corner"][0] - 8.0, p["mouth_corner"][1]),
            "brow": (brow[0], brow[1] - 6.0),
            "chin": (6.0, p["mouth"][1] - 28.0),
        }


@lru_cache(maxsize=2)
def _open(head: Path) -> Stage:
    model = load_head(head)
    return Stage(model, Anatomy.of(Atlas.of(model)))
