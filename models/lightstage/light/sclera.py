"""How much light the whites of the eyes stand in, beside the lids round them.

The whites tell the program the light of a photo (``service.face.features.eye_colours``), but they lie deeper than
skin does, between lids and under brows. How much reaches them follows from the head and the light, so it is computed
from both. Lids are thin and touch the eye; so rays are cast at the triangles themselves, not at points on them as
elsewhere in the light stage.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from service.face.features.eye_colours import BEYOND, LIT
from service.geometry.mesh import normalise, vertex_normals
from service.geometry.sampling import surface_points
from service.head.model import HeadModel
from service.head.regions import IRIS_RADIUS_M, SIDES, eyeball, vertex_mask
from service.light.environment import Illumination, flux_by_direction, spread_directions
from service.light.formulas import disc_of
from service.light.scene import PointLight

Array = npt.NDArray[np.float64]

DIRECTIONS = 256
PLACES = 6
"""Points of a lamp at most from which its shadows are cast."""
SPACING_M = 0.0006
"""Of the points on the eyeball."""
OFF_M = 0.0001
"""Rays begin so far above the surface."""
CAMERA_M = (0.0, -0.03, 1.2)
FACING = 0.15
"""Least cosine to the camera of a point on the white that a photo shows."""
LEAST = 40
"""Points of an eye that is open."""
DARKEST, TINY = 0.12, 1e-9
"""Share of the light on the lids that skin sends even to whites in shadow; and irradiance that counts as none."""


@dataclass(frozen=True)
class Eye:
    """What of one eye is lit.

    Attributes:
        position, normal: (N, 3) metres and unit vectors: the white that a photo shows, then the lids.
        white: how many belong to the white.
        sky: (D, N) cosine of the spread directions, 0 where something is in the way.
        mesh: the head, for rays.
    """

    position: Array
    normal: Array
    white: int
    sky: Array
    mesh: Any

    def lit(self, light: PointLight) -> Array:
        """(N, 3) irradiance of a lamp."""
        places = disc_of(light, self.position.mean(0))
        places = places[:: math.ceil(len(places) / PLACES)]
        total = np.zeros(len(self.position))
        for place in places:
            offset = place - self.position
            square = np.maximum((offset**2).sum(1), max(light.radius_m, 1e-3) ** 2)
            towards = normalise(offset)
            total += reached(self.mesh, self.position, self.normal, towards) / square
        return np.asarray(total[:, None] / len(places) * np.asarray(light.intensity))


@dataclass(frozen=True)
class Whites:
    """Both eyes of a head, the subject's left one first; None for one that is closed, or that the head lacks."""

    eyes: tuple[Eye | None, ...]

    @classmethod
    def of(cls, head: HeadModel, vertices: npt.NDArray[np.floating]) -> Whites:
        """Prepare (V, 3) vertices in metres."""
        import trimesh

        parts = [i for i, name in enumerate(head.part_names) if name == "skin" or name.startswith("eye_")]
        triangles = head.triangles[np.isin(head.triangle_part, parts)]
        mesh = trimesh.Trimesh(vertices, triangles, process=False)
        return cls(tuple(_eye(head, np.asarray(vertices, np.float64), side, mesh) for side in SIDES))

    def beside_lids(self, light: Illumination) -> npt.NDArray[np.float32]:
        """(2, 3) log(light on the best lit part of the white / mean light on the lids) by eye and channel.

        The best lit part is that of which the program reads the light. NaN where an eye is closed or not there; 0
        without light.
        """
        flux = flux_by_direction(light.sky, DIRECTIONS)
        result = np.full((len(self.eyes), 3), np.nan, np.float32)
        for row, eye in zip(result, self.eyes, strict=True):
            if eye is None:
                continue
            arriving = eye.sky.T @ flux + sum((eye.lit(lamp) for lamp in light.lights), np.zeros(3))
            white, lids = arriving[: eye.white], arriving[eye.white :].mean(0)
            strength = white.mean(1)
            low, high = np.quantile(strength, LIT)
            best = white[(strength >= low) & (strength <= high)].mean(0)
            least = DARKEST * lids + TINY
            row[:] = np.log((best + least) / (lids + least))
        return result


def _eye(head: HeadModel, vertices: Array, side: str, mesh: Any) -> Eye | None:
    ball, region = eyeball(head, vertices, side), f"eyelid_{side}"
    if ball is None or region not in head.region_names:
        return None
    own = head.triangles[head.triangle_part == head.part_names.index(f"eye_{side}")]
    skin = head.triangles[head.triangle_part == head.part_names.index("skin")]
    lids = np.flatnonzero(vertex_mask(head, region) > 0.5)
    return eye_in(mesh, (vertices, own), ball.centre, vertices[lids], vertex_normals(vertices, skin)[lids])


def eye_in(
    mesh: Any, ball: tuple[Array, npt.NDArray[np.integer]], centre: Array, lids: Array, lid_normals: Array
) -> Eye | None:
    """An eye of a head that is given as meshes, in metres; None where too little of its white is seen from the front.

    Args:
        mesh: ``trimesh.Trimesh`` of skin and eyeballs.
        ball: (V, 3) vertices and (T, 3) triangles of the eyeball.
        centre: (3,) of the eyeball.
        lids: (M, 3) points on the skin round the eye, M > 0.
        lid_normals: (M, 3) unit normals there.
    """
    position = surface_points(*ball, SPACING_M).astype(np.float64)
    normal, view = normalise(position - centre), normalise(np.array(CAMERA_M) - position)
    pole = position[np.argmax(position[:, 2])]
    beside = np.linalg.norm(position - pole, axis=1) > BEYOND * IRIS_RADIUS_M
    seen = beside & (reached(mesh, position, normal, view) > FACING)
    if seen.sum() < LEAST:
        return None
    position, normal = np.concatenate([position[seen], lids]), np.concatenate([normal[seen], lid_normals])
    sky = np.zeros((DIRECTIONS, len(position)))
    for row, direction in zip(sky, spread_directions(DIRECTIONS), strict=True):
        row[:] = reached(mesh, position, normal, np.broadcast_to(direction, position.shape))
    return Eye(position, normal, int(seen.sum()), sky, mesh)


def reached(mesh: Any, position: Array, normal: Array, towards: Array) -> Array:
    """(N,) cosine to unit directions ``towards`` (N, 3); 0 behind the horizon and where the head is in the way."""
    cosine = np.maximum((normal * towards).sum(1), 0.0)
    up = np.flatnonzero(cosine)
    if len(up):
        cosine[up[mesh.ray.intersects_any(position[up] + OFF_M * normal[up], towards[up])]] = 0.0
    return np.asarray(cosine)
