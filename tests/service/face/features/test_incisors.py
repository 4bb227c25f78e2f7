"""Upper teeth end where the photo shows their edge."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from service.face.features.mouth import ROW, teeth_drop
from service.head.model import HeadModel
from service.head.regions import part_vertices
from tests.service.face.geometry import VIEW

SKIN, TOOTH, LIP, DARK = (200, 150, 130), (225, 215, 200), (150, 80, 80), (30, 15, 15)
FLESH = np.array(SKIN, np.float32) / np.float32(255)


def edge_px(head: HeadModel) -> float:
    """Pixel row of the biting edge of the head's upper incisors."""
    teeth = head.mean[part_vertices(head, ROW)]
    return float(VIEW.project(teeth[np.abs(teeth[:, 0]) < 0.01])[:, 1].max())


def rim(top: float, bottom: float) -> np.ndarray:
    """(20, 2) of an opening with straight edges: left corner, lower lip, right corner, upper lip back."""
    x = np.linspace(430, 570, 11)
    upper, lower = (np.full(9, y) for y in (top, bottom))
    corners = [[x[0], (top + bottom) / 2], [x[-1], (top + bottom) / 2]]
    back = np.stack([x[1:-1][::-1], lower], 1)
    return np.concatenate([corners[1:], back, corners[:1], np.stack([x[1:-1], upper], 1)])


def mouth(top: float, bottom: float, *rows: tuple[float, float]) -> np.ndarray:
    """(1000, 1000, 3) uint8: a dark opening with rows of teeth between pixel rows."""
    photo = np.full((1000, 1000, 3), SKIN, np.uint8)
    cv2.rectangle(photo, (425, int(top) - 12), (575, int(bottom) + 12), LIP, -1)
    cv2.rectangle(photo, (430, int(top)), (570, int(bottom)), DARK, -1)
    for begin, end in rows:
        cv2.rectangle(photo, (430, int(begin)), (570, int(end)), TOOTH, -1)
    return photo


@pytest.mark.parametrize(
    "case", ["no teeth", "closed", "nan", "far outside", "from behind", "side view", "black photo"]
)
def test_what_cannot_be_read_changes_nothing(head: HeadModel, case: str) -> None:
    """Lengths of nothing, points behind the camera, colours without light."""
    edge, teeth, camera, skin = edge_px(head), head.mean[part_vertices(head, ROW)], VIEW, FLESH
    points, photo = rim(edge - 14, edge + 22), mouth(edge - 14, edge + 22, (edge - 14, edge + 8))
    if case == "no teeth":
        toothless = replace(head, part_names=tuple(f"other_{k}" for k, _ in enumerate(head.part_names)))
        teeth = head.mean[part_vertices(toothless, ROW)]
        assert not len(teeth)
    elif case == "closed":
        points = rim(edge, edge)
    elif case == "nan":
        points = np.full((20, 2), np.nan)
    elif case == "far outside":
        points = points + 1e7
    elif case == "from behind":
        camera = replace(VIEW, rotation=np.diag([-1.0, -1.0, 1.0]))
    elif case == "side view":
        camera = replace(VIEW, rotation=np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]))
    else:
        photo, skin = np.zeros_like(photo), np.zeros(3, np.float32)
    with np.errstate(all="raise", under="ignore"):
        assert teeth_drop(photo, teeth, camera, points, skin) == 0.0
