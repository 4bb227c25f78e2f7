"""What people wear on the head and round the neck: knitted caps, hats with a brim, headscarves, scarves.

All are made by rule, on the mean head's measures: a membrane over the skin, or a surface of rings around the head.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from models.lightstage.skin.streams import Stream
from models.people.draw import Mesh
from models.people.figure import smooth_normals
from models.people.person import the_head
from models.people.shells import fabric, shell
from models.people.strands import Hides
from service.face.reading import part_labels as labels

Float = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

AROUND = 96
"""Points of a ring."""
TURN = 2 * np.pi * np.arange(AROUND) / AROUND + np.pi
"""Their angles, from behind: 0 is in front."""
RING = np.stack([np.sin(TURN), np.zeros(AROUND), np.cos(TURN)], -1)
UP = np.array([0.0, 1.0, 0.0])
DARK = 0.45
"""Share of caps, hats and scarves that are black, grey or dark blue."""


@dataclass(frozen=True)
class HeadWear:
    """What somebody has on the head.

    Attributes:
        meshes: to be drawn.
        hides: which of points (N, 3) lie under it, where no hair is drawn; None where all hair is hidden.
    """

    meshes: tuple[Mesh, ...]
    hides: Hides | None


def beanie(s: Stream, vertices: Float) -> HeadWear:
    """A knitted cap: tight or slack, its rim turned up or not, ribbed, striped, with a bobble now and then."""
    p = the_head().mean.astype(np.float64)
    rim, behind, thick = s.one(0.02, 0.085), s.one(0.25, 0.9), s.one(0.003, 0.008)

    def over_rim(points: npt.NDArray[np.floating]) -> Array:
        return np.asarray(points[:, 1] - rim + behind * np.maximum(0.0, 0.02 - points[:, 2]))  # lower behind

    above = over_rim(p)
    look = _knitted(s)
    slack, fold = s.one(0.0, 0.03) * s.chance(0.6), s.one(0.03, 0.07) * s.chance(0.55)
    crown = np.clip((above - 0.03) / 0.09, 0.0, 1.0)
    lean = np.array([0.0, 1.0, -s.one(0.0, 1.2)])
    body = shell(vertices, above * 20.0, thick, 12, labels.HAT, look)
    used = _near(body.position, vertices, crown)
    body.position = (body.position + (slack * used**2)[:, None] * lean / np.linalg.norm(lean)).astype(np.float32)
    meshes = [_in_rings(body)]
    if fold:  # the rim turned up lies on the cap
        band = shell(
            vertices, np.minimum(above, fold - above) * 20.0, thick + s.one(0.003, 0.007), 12, labels.HAT, look
        )
        meshes.append(_in_rings(band))
    if s.chance(0.25):
        top = body.position[int(body.position[:, 1].argmax())]
        meshes.append(_bobble(s, top, look))
    return HeadWear(tuple(meshes), lambda points: over_rim(points) > 0)


def hat(s: Stream, vertices: Float) -> HeadWear:
    """A hat of rings: felt or straw with a brim all round, a bucket hat, or a cap whose brim is in front only."""
    rim, tilt = s.one(0.03, 0.075), s.one(-0.25, 0.15)
    middle, half = _section(vertices, rim)
    kind = s.one()
    peaked, bucket = kind < 0.4, 0.4 <= kind < 0.6
    high = float(vertices[:, 1].max()) - rim + (s.one(0.004, 0.02) if peaked or bucket else s.one(0.01, 0.05))
    wide = s.one(0.06, 0.085) if peaked else s.one(0.04, 0.06) if bucket else s.one(0.05, 0.14)
    droop = s.one(0.2, 0.5) if peaked else s.one(0.7, 1.3) if bucket else s.one(-0.25, 0.35)
    close = s.one(0.004, 0.012)
    in_front = np.clip((np.cos(TURN) - 0.15) / 0.5, 0, 1) ** 0.6
    rings = []
    for t in np.linspace(1.0, 0.0, 10):  # from the brim's edge inwards
        out = t * wide * (in_front if peaked else np.ones(AROUND))
        hangs: Array | float = droop
        if not peaked and not bucket:
            hangs = droop + s.one(-0.02, 0.02) - s.one(0.0, 0.1) * np.cos(2 * TURN)
        rings.append(RING * (half + close + out[:, None]) - UP * (hangs * out)[:, None])
    taper = s.one(0.02, 0.2)
    full = s.one(0.35, 0.55) if peaked else s.one(0.2, 0.45)
    for t in np.linspace(0.0, 1.0, 16)[1:]:  # up the crown and in over its top
        if peaked:
            up, wide_here = np.sin(0.5 * np.pi * min(t / 0.85, 1.0)), (1 - t**4) ** full
        else:
            up, over = min(t / 0.75, 1.0), max(0.0, (t - 0.75) / 0.25)
            wide_here = 1 - taper * up - (1 - taper) * over**2
        rings.append(RING * (half + close) * max(float(wide_here), 0.01) + UP * high * up)
    if not peaked and not bucket and s.chance(0.7):  # dented
        for ring in rings[-4:]:
            ring[:, 1] -= s.one(0.008, 0.03) * np.exp(-((ring[:, 0] / 0.03) ** 2))
    points = np.concatenate(rings)
    lean = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    points = points @ lean.T + middle
    look = _felt(s)
    mesh = _ringed(points, len(rings), labels.HAT, look)
    if not peaked and s.chance(0.6):  # a ribbon
        mesh.uniforms |= {"band": (rim + 0.004, rim + s.one(0.02, 0.045)), "stripe": _grey(s.one(0.01, 0.1))}
    sag = float(np.clip(droop, 0.0, 0.5)) * (not peaked)

    def hides(points: Float) -> Bool:
        beside = np.hypot(*((points - middle)[:, [0, 2]] / half[[0, 2]]).T) - 1.0
        return np.asarray(points[:, 1] > rim - sag * half[0] * np.maximum(beside, 0.0))

    return HeadWear((mesh,), hides)


def headscarf(s: Stream, vertices: Float) -> HeadWear:
    """A headscarf or hood: all but the face."""
    p = the_head().mean.astype(np.float64)
    wide, high, middle = s.one(0.062, 0.074), s.one(0.085, 0.105), s.one(-0.045, -0.03)
    oval = np.sqrt((p[:, 0] / wide) ** 2 + ((p[:, 1] - middle) / high) ** 2) - 1.0
    value = np.maximum(oval, (-0.035 - p[:, 2]) * 20.0)
    return HeadWear((shell(vertices, value, s.one(0.004, 0.012), 30, labels.CLOTH, fabric(s, 0.0)),), None)


def neck_scarf(s: Stream, vertices: Float) -> list[Mesh]:
    """A scarf wound round the neck, once to three times, its folds by chance; hair goes into it or hangs over it."""
    middle, half = _section(vertices, -0.16)
    look = _knitted(s) if s.chance(0.5) else _felt(s)
    meshes = []
    for _ in range(1 + int(s.one() * 3)):
        thick, far = s.one(0.016, 0.035), s.one(0.0, 0.025)
        height = s.one(-0.03, 0.035) + s.one(-0.02, 0.02) * np.cos(TURN) + s.one(-0.02, 0.02) * np.sin(TURN)
        around = RING * (half + thick + far) + UP * height[:, None]
        folds = [1 + s.one(0.0, 0.3) * np.cos(k * TURN + s.one(0, 2 * np.pi)) for k in (2, 5, 9)]
        wide = (thick * folds[0] * folds[1])[:, None]
        rings = [
            around + RING * wide * np.cos(angle) + UP * wide * 1.4 * np.sin(angle) * folds[2][:, None]
            for angle in np.linspace(0, 2 * np.pi, 15)
        ]
        meshes.append(_ringed(np.concatenate(rings) + middle, len(rings), labels.CLOTH, look))
    return meshes


def _section(vertices: Float, height: float) -> tuple[Array, Array]:
    """Middle (3,) and half axes (3,) of the head, or the neck, at a height of the mean head."""
    head = the_head()
    at = (np.abs(head.mean[:, 1] - height) < 0.012) & (head.region("mouth_inner") < 0.5)
    for ear in ("ear_left", "ear_right"):
        at &= head.region(ear) < 0.5
    ring = vertices[at].astype(np.float64)
    low, high = ring.min(0), ring.max(0)
    middle = 0.5 * (low + high)
    middle[1] = float(ring[:, 1].mean())
    return middle, 0.5 * (high - low) * np.array([1.0, 0.0, 1.0])


def _near(points: Float, vertices: Float, value: Array) -> Array:
    """(N,) ``value`` (V,) of the vertex that is nearest to each point."""
    return np.asarray(value[cKDTree(vertices).query(points)[1]])


def _in_rings(mesh: Mesh) -> Mesh:
    """The same, with picture coordinates round the head and upwards, for ribs and stripes; its kind is "knit"."""
    x, y, z = mesh.position.T.astype(np.float64)
    mesh.kind = "knit"
    mesh.normal = smooth_normals(mesh.position, mesh.triangles)
    mesh.uv[:, 0], mesh.uv[:, 1] = np.arctan2(x, z + 0.06) / (2 * np.pi), y
    return mesh


def _ringed(points: Array, rings: int, label: int, look: dict[str, object]) -> Mesh:
    """A surface through rings of ``AROUND`` points, the first one first."""
    i, k = np.meshgrid(np.arange(rings - 1), np.arange(AROUND), indexing="ij")
    a, b = i * AROUND + k, i * AROUND + (k + 1) % AROUND
    c, d = b + AROUND, a + AROUND
    triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    position, faces = points.astype(np.float32), triangles.astype(np.int32)
    extra = np.zeros((len(position), 4), np.float32)
    extra[:, 0] = np.tile(np.arange(AROUND) / AROUND, rings)
    extra[:, 1], extra[:, 2] = position[:, 1], 1.0
    # A ring begins and ends at one point, where the coordinate jumps: ribs are whole, so that nobody sees it.
    return Mesh("knit", position, smooth_normals(position, faces), faces, extra, label, uniforms=dict(look))


def _bobble(s: Stream, at: Float, look: dict[str, object]) -> Mesh:
    """A ball of wool."""
    radius = s.one(0.018, 0.04)
    rough = 1 + 0.18 * s.normal(0.0, 1.0, 12 * AROUND).reshape(12, AROUND, 1)
    angles = np.linspace(0.02, np.pi - 0.02, 12)
    rings = radius * rough * np.stack([RING * np.sin(angle) + UP * np.cos(angle) for angle in angles])
    points = rings.reshape(-1, 3) + at + UP * 0.7 * radius
    return _ringed(points, len(angles), labels.HAT, {**look, "knit": (1.0, 1.0, 0.0, 0.0)})


def _grey(level: float) -> tuple[float, float, float]:
    return level, level, level


def _colours(s: Stream) -> dict[str, object]:
    """Colour of the cloth and of its stripes, linear."""
    look = fabric(s, 0.0)
    if s.chance(DARK):
        look["colour"] = tuple(float(c) for c in s.one(0.006, 0.05) * np.exp(s.normal(0, 0.15, 3)))
    return look


def _knitted(s: Stream) -> dict[str, object]:
    """Uniforms of wool: ribs round the head, rows a metre, how deep they are, share of stripes."""
    ribs = float(round(s.one(40, 160)))
    return {
        **_colours(s), "knit": (ribs, s.one(150, 500), s.one(0.1, 0.7), s.one(15, 60) * s.chance(0.2)),
        "band": (9.0, 9.0), "stripe": fabric(s, 0.0)["colour"],
    }  # fmt: skip


def _felt(s: Stream) -> dict[str, object]:
    """Uniforms of felt, straw or cotton: without ribs, woven coarsely or not at all."""
    coarse = s.one(0.0, 0.4) * s.chance(0.4)
    return {
        **_colours(s), "knit": (float(round(s.one(100, 300))), s.one(300, 900), coarse, 0.0),
        "band": (9.0, 9.0), "stripe": (0.0, 0.0, 0.0),
    }  # fmt: skip
