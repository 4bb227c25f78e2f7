"""Light on strands: how much reaches them, and the skin, through the body of hair, and what they reflect.

Cards are flat, but what they show are strands: cylinders with tilted scales. Reflection is that of Marschner et al.
2003 ("Light Scattering from Human Hair Fibers", eq. 8 to 12) in three lobes: R, white, shifted towards the root; TRT,
in the hair's colour, shifted towards the tip and twice as wide; TT, against the light. What is scattered many times is
diffuse, with the normals of the body of hair. Shadow is the transmittance through a grid of how much hair lies in each
cell, as in deep opacity maps (Yuksel and Keyser 2008).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, AnyInt, Bool, Float32, Float64, Int64
from service.geometry.mesh import normalise, spread_points, unit
from service.light.environment import Illumination, flux_by_direction, spread_directions
from service.light.formulas import Graphs, lamp_numbers
from service.light.scene import PointLight
from service.materials.part import MeshPart
from service.render.draw import SeenPart
from service.render.drawn import DrawnPart

TILT = np.radians(3.0)
"""Of a cuticle's scales (Marschner 2003, table 1)."""
WIDTH = np.radians(9.0)
"""Standard deviation of the first lobe along a strand: that of single strands (5 to 10 degrees)."""
F0 = 0.0465
"""Reflectance at normal incidence for the index of refraction 1.55."""
SHEEN = 0.4
"""Share of what a single strand mirrors that leaves a body of hair: neighbours hide the rest."""
CELL_MM = 6.0
"""Side of a cell of the grid, which is turned towards each light."""
GRAIN_MM2 = 18.0
"""Area of card for which one point stands."""
FACING = 0.7
"""Mean cosine between cards and light, as they lie at all angles about their strands."""
SOLID = 4.0
"""Opacity of the head, in layers of hair."""
DIRECTIONS = 32
"""Into which the sky is divided for hair."""
BIAS = {"hair": 1.0, "skin": 0.4}
"""Cells by which a point is moved towards the light: strands around it belong to what is seen there itself."""
PIECE = 1 << 16
"""Points lit at once."""


@dataclass(frozen=True)
class HairVolume:
    """Hair, and the head within it, as what stops light.

    Attributes:
        points: (M, 3) float32 mm.
        amount: (M,) float32 mm^2 that each hides.
        hair: how many of them, the first ones, are hair.
    """

    points: Float32
    amount: Float32
    hair: int

    @property
    def alone(self) -> HairVolume:
        """The hair without the head, which has finer shadows of its own."""
        return HairVolume(self.points[: self.hair], self.amount[: self.hair], self.hair)

    @classmethod
    def of(cls, parts: Sequence[DrawnPart], vertices: AnyFloat, triangles: AnyInt) -> HairVolume | None:
        """The volume of the hair among a head's parts, those with anisotropy; None where none of them is hair.

        Vertices (V, 3) metres are the head's, triangles (T, 3) of its skin.
        """
        hair = [part for part in parts if part.along is not None]
        if not hair:
            return None
        points, amount = [], []
        for one in hair:
            corner, weight, area = _spread(one.part.vertices, one.triangles)
            place = one.places[corner]
            uv = np.einsum("mk,mkc->mc", weight, one.part.uv[place]).astype(np.float32)
            points.append(np.einsum("mk,mkc->mc", weight, one.part.vertices[one.triangles[corner]]))
            amount.append(FACING * area * one.opacity(uv))
        strands = _thinned(np.concatenate(points) * 1000, np.concatenate(amount))
        corner, weight, area = _spread(vertices, triangles)
        skin = np.einsum("mk,mkc->mc", weight, np.asarray(vertices)[triangles[corner]])
        solid = _thinned(skin * 1000, SOLID * area)
        both, hidden = (np.concatenate(pair).astype(np.float32) for pair in zip(strands, solid, strict=True))
        return cls(both, hidden, len(strands[0]))

    def passed(self, at: Float32, towards: AnyFloat, bias: float, *, place: bool = False) -> Float32:
        """(N,) share of light in [0, 1] that comes through to points (N, 3) mm, moved towards it by ``bias`` cells.

        ``towards`` is the unit direction of the light, or (``place``) its position in mm.
        """
        from scipy.ndimage import map_coordinates

        middle = self.points.mean(0)
        axis = normalise(np.asarray(towards, np.float64) - middle if place else towards, (0.0, 1.0, 0.0))
        side = normalise(np.cross(axis, [0.31, 0.12, 0.94]), (1.0, 0.0, 0.0))
        frame = np.stack([side, np.cross(axis, side), -axis]).astype(np.float32) / np.float32(CELL_MM)
        far = float(np.linalg.norm(np.asarray(towards) - middle)) if place else 0.0

        def seen(points: Float32) -> Float32:
            turned = np.einsum("nk,ck->nc", points - middle, frame)
            if place:  # rays that spread become parallel
                turned[:, :2] *= far / np.maximum(far + CELL_MM * turned[:, 2:], 0.1 * far)
            return np.asarray(turned, np.float32)

        own, asked = seen(self.points), seen(at)
        low = own.min(0) - 1
        shape = tuple(int(value) for value in np.ceil(own.max(0) - low) + 2)
        cell = np.ravel_multi_index(tuple((own - low).astype(int).T), shape)
        filled = np.bincount(cell, self.amount, int(np.prod(shape))).reshape(shape) / CELL_MM**2
        before = np.concatenate([np.zeros((*shape[:2], 1)), np.cumsum(filled, 2)], 2)
        depth = map_coordinates(before, (asked - low - [0.5, 0.5, bias]).T, order=1, mode="nearest")
        return np.asarray(np.exp(-depth), np.float32)

    def from_sky(self, at: Float32, count: int, bias: float) -> Float32:
        """(count, N) share of the light from spread directions that comes through to points (N, 3) mm."""
        few = spread_directions(min(count, 2 * DIRECTIONS))
        nearest = (spread_directions(count) @ few.T).argmax(1)
        return np.asarray(np.stack([self.passed(at, way, bias) for way in few])[nearest], np.float32)

    def from_lamp(self, at: Float32, lamp: PointLight, bias: float) -> Float32:
        """(N,) share of a lamp's light that comes through to points (N, 3) mm."""
        return self.passed(at, np.array(lamp.position_m) * 1000, bias, place=True)


def _thinned(points: AnyFloat, amount: AnyFloat) -> tuple[Float64, Float64]:
    """One point for each cube of half a cell's side, in the middle of those in it, and what they hide together."""
    cube = np.floor(points / (0.5 * CELL_MM)).astype(np.int64)
    _, index = np.unique(cube @ np.array([1 << 40, 1 << 20, 1]), return_inverse=True)
    total = np.maximum(np.bincount(index, amount), 1e-9)
    middle = np.stack([np.bincount(index, amount * column) / total for column in points.T], 1)
    return middle, total


def _spread(vertices: AnyFloat, triangles: AnyInt) -> tuple[Int64, Float64, AnyFloat]:
    """Points on triangles (T, 3), as :func:`spread_points`; areas in mm^2."""
    corners = np.asarray(vertices, np.float64)[triangles] * 1000
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return spread_points(0.5 * np.linalg.norm(across, axis=1), GRAIN_MM2)


@dataclass(frozen=True)
class StrandLight:
    """Lights strands.

    Attributes:
        light: of the scene.
        graphs: the formulas.
        volume: what stops light.
        viewpoint: (3,) metres.
    """

    light: Illumination
    graphs: Graphs
    volume: HairVolume
    viewpoint: AnyFloat

    def shares(self, part: MeshPart) -> Float32:
        """(V, DIRECTIONS + L) share of the light of parts of the sky and of lamps that reaches a part's vertices."""
        at = np.asarray(part.vertices, np.float32) * np.float32(1000)
        sky = [self.volume.passed(at, way, BIAS["hair"]) for way in spread_directions(DIRECTIONS)]
        lamps = [self.volume.from_lamp(at, lamp, BIAS["hair"]) for lamp in self.light.lights]
        return np.stack([*sky, *lamps], 1)

    def lit(self, one: SeenPart, strands: Float32, shares: Float32, visible: Bool) -> None:
        """Set the radiance of the visible fragments (F,) of a part, whose strands run along unit vectors (F, 3)."""
        ways, flux = spread_directions(DIRECTIONS).astype(np.float32), np.zeros((DIRECTIONS, 3), np.float32)
        if not self.light.dark:
            flux = flux_by_direction(self.light.sky, DIRECTIONS).astype(np.float32)
        chosen = np.flatnonzero(visible)
        for first in range(0, len(chosen), PIECE):
            some = chosen[first : first + PIECE]
            corners, weights = one.corners[some], one.weights[some][..., None]
            share = (shares[corners] * weights).sum(1)
            point = (one.part.vertices[corners] * weights).sum(1)
            normal = unit((one.drawn.normals[corners] * weights).sum(1))
            colour, along = one.colour[some], strands[some]
            view = unit(np.asarray(self.viewpoint, np.float32) - point)
            facing = share[:, :DIRECTIONS] * np.maximum(normal @ ways.T, 0)
            total = colour * (facing @ flux) / np.float32(np.pi)
            for k in range(DIRECTIONS) if not self.light.dark else ():
                total += share[:, k : k + 1] * flux[k] * reflected(along, view, ways[k], colour)
            for k, lamp in enumerate(self.light.lights):
                reach = np.ascontiguousarray(share[:, DIRECTIONS + k])
                given = {"position": np.ascontiguousarray(point.T * np.float32(1000)), "shade": reach}
                numbers = lamp_numbers(lamp)
                arriving = self.graphs.at_points(
                    "irradiance", given | {"normal": np.ascontiguousarray(normal.T)}, **numbers
                )
                toward = unit(np.array(lamp.position_m, np.float32) - point)
                facing_it = given | {"normal": np.ascontiguousarray(toward.T)}
                whole = self.graphs.at_points("irradiance", facing_it, **numbers)
                total += colour * arriving.T / np.float32(np.pi) + whole.T * reflected(along, view, toward, colour)
            one.radiance[some] = total


def reflected(along: Float32, view: Float32, light: Float32, colour: Float32, width: float = WIDTH) -> Float32:
    """(N, 3) radiance by which strands answer one unit of irradiance on a surface across the light.

    Unit vectors run ``along`` the strands (N, 3), from root to tip, to the eye (N, 3) and to the light (N, 3) or (3,);
    the colour (N, 3) is the linear albedo of many strands. ``width`` is that of the first lobe, radians: wider where
    strands differ in direction.
    """
    sin_i, sin_r = (along * light).sum(1), (along * view).sum(1)
    theta_i, theta_r = np.arcsin(np.clip(sin_i, -1, 1)), np.arcsin(np.clip(sin_r, -1, 1))
    half, cos_d = 0.5 * (theta_i + theta_r), np.maximum(np.cos(0.5 * (theta_r - theta_i)), 0.3)
    flat_l, flat_v = light - along * sin_i[:, None], view - along * sin_r[:, None]
    size = np.sqrt(np.maximum((flat_l**2).sum(1) * (flat_v**2).sum(1), 1e-8))
    cos_phi = np.clip((flat_l * flat_v).sum(1) / size, -1, 1)
    cos_half = np.sqrt(0.5 * (1 + cos_phi))
    fresnel = F0 + (1 - F0) * (1 - np.clip(cos_d * cos_half, 0, 1)) ** 5
    common = np.maximum(np.cos(theta_i), 0) / cos_d**2
    first = SHEEN * common * _lobe(half + 2 * TILT, width) * 0.25 * cos_half * fresnel
    inner = (1 - fresnel) ** 2
    second = common * _lobe(half - 3 * TILT, 2 * width) * 0.12 * (1 + cos_phi) ** 2 * inner * fresnel
    against = common * _lobe(half - TILT, 0.7 * width) * 0.5 * np.exp(4 * (-cos_phi - 1)) * inner
    # Light passes the pigment once on its way through a strand and twice where it comes back.
    tint = np.clip(colour, 0, 1)
    through = 0.5 * against[:, None] * np.sqrt(tint) * tint
    return np.asarray(first[:, None] + second[:, None] * tint + through, np.float32)


def _lobe(angle: AnyFloat, width: float) -> AnyFloat:
    return np.asarray(np.exp(-0.5 * np.square(angle / width)) / (width * np.sqrt(2 * np.pi)))
