"""Light through the opening of the mouth against what is known of form factors."""

from __future__ import annotations

import numpy as np

from service.anatomy.mouth.light import WITHIN, light_inside, opening
from service.head.files import load_head

TURN = np.linspace(0, 2 * np.pi, 256, endpoint=False)
FORWARD = np.array([[0.0, 0.0, 1.0]])


def disc(radius: float) -> np.ndarray:
    return np.stack([radius * np.cos(TURN), radius * np.sin(TURN), 0 * TURN], 1)


def test_a_disc_seen_from_its_axis() -> None:
    """r^2 / (r^2 + h^2), the form factor of a parallel disc (Howell's catalogue, B-12)."""
    for depth in (0.01, 0.02, 0.05):
        found = light_inside(np.array([[0.0, 0.0, -depth]]), FORWARD, disc(0.02))[0]
        share = 0.02**2 / (0.02**2 + depth**2)
        assert abs(found - (WITHIN + (1 - WITHIN) * share)) < 2e-3


def test_either_order_of_the_outline_will_do() -> None:
    at = np.array([[0.003, 0.001, -0.02]])
    np.testing.assert_allclose(light_inside(at, FORWARD, disc(0.02)), light_inside(at, FORWARD, disc(0.02)[::-1]))


def test_in_front_of_the_lips_all_is_open_and_behind_none_without_an_opening() -> None:
    points = np.array([[0.0, 0.0, 0.01], [0.0, 0.0, -0.02]])
    normals = np.repeat(FORWARD, 2, 0)
    found = light_inside(points, normals, disc(0.02))
    assert found[0] == 1 and found[1] < 0.6
    assert light_inside(points, normals, np.zeros((0, 3))).tolist() == [np.float32(WITHIN)] * 2
    away = light_inside(points[1:], -FORWARD, disc(0.02))
    assert abs(away[0] - WITHIN) < 1e-6, "what looks into the throat sees nothing of it"


def test_an_open_jaw_lets_in_more() -> None:
    head = load_head(None)
    jaw = np.eye(len(head.expression_names))[head.expression_names.index("jawOpen")]
    point = np.array([[0.0, -0.075, -0.01]])
    light = [
        float(light_inside(point, FORWARD, opening(head, head.shape(np.zeros(0), share * jaw)))[0])
        for share in (0.0, 0.3, 1.0)
    ]
    assert light[0] < 0.2 < light[1] < light[2]
