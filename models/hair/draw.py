"""Grooms as a camera sees them: lines with a hair's reflection, in their own shadow, before and behind a head.

The reflection is that of Marschner et al. 2003 in the form of Kajiya and Kay 1989 with two shifted lobes (Scheuermann
2004); shadow is the transmittance through a grid of how much hair lies in each cell.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from service.colour import linear_to_srgb
from service.geometry.camera import Camera
from service.geometry.mesh import vertex_normals
from service.geometry.raster import interpolate, rasterise
from service.hair.groom import Groom
from service.head.model import HeadModel

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

TILT = np.radians(3.0)
"""Of the scales of a hair's cuticle, which shift its two highlights (Marschner 2003)."""
GLOSS, SECOND_GLOSS = (60.0, 0.12), (18.0, 0.25)
"""Exponent and strength of the first highlight, in the lamp's colour, and of the second, in the hair's."""
AMBIENT = 0.28
SKIN = np.array([0.55, 0.37, 0.29], np.float32)
SHADE_CELL_M = 0.006
OPACITY = 0.06
"""Light that one millimetre of a strand in a cell takes, for 10,000 strands on a head."""
SUBPIXELS = 4
"""Samples a pixel's side is drawn with."""


@dataclass(frozen=True)
class Picture:
    """What the camera sees.

    Attributes:
        colour: (H, W, 3) float32 linear RGB.
        hair: (H, W) float32 in [0, 1], share of the pixel that hair covers.
        direction: (H, W, 2) float32 unit direction from root to tip in the picture, x right, y down; 0 without hair.
        depth: (H, W) float32 metres along the camera's axis of what is seen; inf beside the head.
    """

    colour: Float
    hair: Float
    direction: Float
    depth: Float


def facing(azimuth_deg: float, size: int = 320, distance_m: float = 1.4, fov_deg: float = 20.0) -> Camera:
    """A camera that looks at the head from an azimuth, 0 in front, positive from the subject's left."""
    a = np.radians(azimuth_deg)
    target = np.array([0.0, -0.045, -0.06])
    origin = target + distance_m * np.array([np.sin(a), 0.06, np.cos(a)])
    forward = (target - origin) / np.linalg.norm(target - origin)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    focal = size / 2 / np.tan(np.radians(fov_deg / 2))
    return Camera(size, size, float(focal), np.full(2, size / 2), rotation, -rotation @ origin)


def shade(groom: Groom, eye: Float, lamp: tuple[float, float, float] = (0.5, 0.8, 0.7)) -> Float:
    """(N, P, 3) linear RGB of the points of strands for an eye at ``eye`` (3,) metres and a lamp far away."""
    points = groom.strands
    along = np.gradient(points, axis=1)
    along /= np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-9)
    light = np.array(lamp, np.float32) / np.float32(np.linalg.norm(lamp))
    view = eye - points
    view /= np.maximum(np.linalg.norm(view, axis=2, keepdims=True), 1e-9)
    half = light + view
    half /= np.maximum(np.linalg.norm(half, axis=2, keepdims=True), 1e-9)
    cosine = (along * light).sum(2)
    matt = np.sqrt(np.maximum(1 - cosine**2, 0))
    angle = np.arcsin(np.clip((along * half).sum(2), -1, 1))
    first = GLOSS[1] * np.cos(np.clip(angle + 2 * TILT, -np.pi / 2, np.pi / 2)) ** GLOSS[0]
    second = SECOND_GLOSS[1] * np.cos(np.clip(angle - 3 * TILT, -np.pi / 2, np.pi / 2)) ** SECOND_GLOSS[0]
    lit = transmitted(groom, light)[..., None]
    sky = transmitted(groom, np.array([0, 1, 0.3], np.float32))[..., None]
    colour = groom.colour.linear(points.shape[1])
    direct = lit * (colour * (0.65 * matt + second)[..., None] + first[..., None])
    return np.asarray(direct + AMBIENT * (0.25 + 0.75 * sky) * colour, np.float32)


def transmitted(groom: Groom, light: Float) -> Float:
    """(N, P) float32 share of the light from direction ``light`` (3,) that reaches each point through the hair."""
    points = groom.strands.reshape(-1, 3)
    toward = light / np.linalg.norm(light)
    side = np.cross(toward, [0.3, 0.1, 0.9])
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(toward, side), -toward]).astype(np.float32)
    cells = ((points @ frame.T) / SHADE_CELL_M).astype(np.int32)
    cells -= cells.min(0)
    shape = tuple(cells.max(0) + 2)
    flat = np.ravel_multi_index(tuple(cells.T), shape)
    steps = np.linalg.norm(np.diff(groom.strands, axis=1), axis=2)
    amount = np.concatenate([steps, steps[:, -1:]], 1).ravel() * 1000 * 10_000 / max(len(groom.strands), 1)
    filled = np.bincount(flat, amount, int(np.prod(shape))).reshape(shape)
    before = np.cumsum(filled, axis=2) - 0.5 * filled
    soft = cv2.blur(before.reshape(shape[0], -1).astype(np.float32), (1, 3)).reshape(shape)
    thick = soft.ravel()[flat].reshape(groom.strands.shape[:2])
    return np.asarray(np.exp(-OPACITY * thick * 0.01 / (SHADE_CELL_M / 0.006) ** 2), np.float32)


def draw(groom: Groom, head: HeadModel, camera: Camera, lamp: tuple[float, float, float] = (0.5, 0.8, 0.7)) -> Picture:
    """Draw a head and its hair."""
    scale = SUBPIXELS
    wide, high = camera.width * scale, camera.height * scale
    colour, depth = _body(head, camera, wide, high, scale, lamp)
    direction = np.zeros((high, wide, 2), np.float32)
    hair = np.zeros((high, wide), np.float32)
    if len(groom.strands):
        eye = np.asarray(camera.centre, np.float32)
        shaded = shade(groom, eye, lamp)
        flat = groom.strands.reshape(-1, 3)
        pixels = np.asarray(scale * camera.project(flat), np.float32).reshape(*groom.strands.shape[:2], 2)
        away = np.asarray(camera.to_camera(flat)[:, 2], np.float32).reshape(groom.strands.shape[:2])
        _lines(pixels, away, shaded, colour, depth, hair, direction)
    small = (camera.width, camera.height)
    nearest = depth.reshape(camera.height, scale, camera.width, scale).min((1, 3))
    along = cv2.resize(direction, small, interpolation=cv2.INTER_AREA)
    size = np.linalg.norm(along, axis=2, keepdims=True)
    along = np.where(size > 1e-3, along / np.maximum(size, 1e-3), 0)
    return Picture(
        np.asarray(cv2.resize(colour, small, interpolation=cv2.INTER_AREA), np.float32),
        np.asarray(cv2.resize(hair, small, interpolation=cv2.INTER_AREA), np.float32),
        along.astype(np.float32), nearest,
    )  # fmt: skip


def _lines(
    pixels: Float, away: Float, colours: Float, colour: Float, depth: Float, hair: Float, direction: Float
) -> None:
    """Put segments into the picture, each of its samples where nothing nearer is there."""
    high, wide = depth.shape
    starts, ends = pixels[:, :-1].reshape(-1, 2), pixels[:, 1:].reshape(-1, 2)
    run = np.linalg.norm(ends - starts, axis=1)
    count = np.clip(np.ceil(run), 1, 64).astype(int)
    index = np.repeat(np.arange(len(count)), count)
    order = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)
    share = ((order + 0.5) / count[index])[:, None].astype(np.float32)
    place = starts[index] + share * (ends - starts)[index]
    x, y = np.floor(place).astype(np.int32).T
    z0, z1 = away[:, :-1].ravel()[index], away[:, 1:].ravel()[index]
    z = z0 + share[:, 0] * (z1 - z0)
    inside = (x >= 0) & (x < wide) & (y >= 0) & (y < high)
    at = (y * wide + x)[inside]
    index, z, share = index[inside], z[inside], share[inside]
    keep = z < depth.ravel()[at] + 0.004  # roots lie on the skin, and must not sink into it
    at, index, z, share = at[keep], index[keep], z[keep], share[keep]
    last = np.lexsort((-z, at))  # of each pixel the nearest comes last
    at, index, z, share = at[last], index[last], z[last], share[last]
    top = np.append(at[1:] != at[:-1], True)
    at, index, z, share = at[top], index[top], z[top], share[top]
    first, second = colours[:, :-1].reshape(-1, 3), colours[:, 1:].reshape(-1, 3)
    colour.reshape(-1, 3)[at] = first[index] * (1 - share) + second[index] * share
    depth.ravel()[at] = z
    hair.ravel()[at] = 1.0
    along = (ends - starts)[index] / np.maximum(run[index], 1e-6)[:, None]
    direction.reshape(-1, 2)[at] = along


def _body(
    head: HeadModel, camera: Camera, wide: int, high: int, scale: int, lamp: tuple[float, float, float]
) -> tuple[Float, Float]:
    """Linear RGB (high, wide, 3) of a matt head before a grey wall, and its depth."""
    vertices = head.mean.astype(np.float64)
    pixels, away = scale * camera.project(vertices), camera.to_camera(vertices)[:, 2]
    drawn = rasterise(pixels, away, head.triangles, wide, high, cull=True, perspective=True)
    colour = np.full((high, wide, 3), 0.62, np.float32)
    depth = np.where(drawn.mask, drawn.depth, np.inf).astype(np.float32)
    there = np.flatnonzero(drawn.mask)
    corners = head.triangles[drawn.triangle.ravel()[there]]
    normals = vertex_normals(vertices, head.triangles).astype(np.float32)
    normal = interpolate(normals, corners, drawn.barycentric.reshape(-1, 3)[there])
    light = np.array(lamp, np.float32) / np.float32(np.linalg.norm(lamp))
    matt = np.clip(normal @ light, 0, 1) * 0.75 + AMBIENT
    colour.reshape(-1, 3)[there] = matt[:, None] * SKIN
    return colour, depth


def sheet(grooms: list[Groom], head: HeadModel, columns: int = 8, size: int = 200) -> npt.NDArray[np.uint8]:
    """(H, W, 3) uint8 sRGB: grooms seen from the front and from a side, side by side, with their kinds."""
    views = [facing(20.0, size), facing(125.0, size)]
    cells = []
    for groom in grooms:
        pair = np.concatenate([draw(groom, head, view).colour for view in views], 1)
        cell = np.rint(255 * linear_to_srgb(np.clip(pair, 0, 1))).astype(np.uint8)
        label = f"{groom.style.kind.replace('_', ' ')}, {groom.style.curl}"
        cell = cell.copy()
        cv2.putText(cell, label, (6, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (20, 20, 20), 1, cv2.LINE_AA)
        cells.append(cell)
    blank = np.full_like(cells[0], 255)
    cells += [blank] * (-len(cells) % columns)
    rows = [np.concatenate(cells[i : i + columns], 1) for i in range(0, len(cells), columns)]
    return np.concatenate(rows)
