"""A quick picture of what a camera sees, lit at the vertices."""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, Float32
from service.colour import linear_to_srgb, srgb_to_linear
from service.geometry.mesh import normalise, unit
from service.light.environment import Illumination
from service.light.formulas import Graphs, irradiance, lamp_numbers, project
from service.light.scene import WHITE, Triple
from service.render.draw import HIDDEN, SeenHead
from service.render.strands import WIDTH, reflected

MIRRORED = 0.02
"""White light that strands mirror on average, over the light on the face: 0.01 below a flash to 0.03 under a clouded
sky, in our own renderer. A photo has it in the colour of hair, of which it is half where hair is black."""
BAND = 0.8
"""Share of it that is a band where no light is given; the rest comes from all sides."""
SOFT = 0.1
"""Opacity that a hard step of coverage may lack."""
STEEP = 2.5
"""Slope that brings a blurred edge between two pixels back to what it was."""
SPREAD = 2 * WIDTH
"""Width of the highlight of the strands around a vertex, which differ in direction."""
DARKEST = 0.65
"""Factor on linear colours with the photo's light in them at grazing angles; 1 where they face the camera."""


def open_light(light: Illumination, graphs: Graphs, points: Float32, normals: AnyFloat) -> Float32:
    """(N, 3) linear radiance of a white diffuse surface in the open, where nothing throws shadows.

    Points (N, 3) are in metres, head space, normals (N, 3) unit.
    """
    arriving = np.zeros((3, len(points)), np.float32)
    if not light.dark:
        arriving += irradiance(project(light.sky), normals).T.astype(np.float32)
    at = {
        "position": np.ascontiguousarray(points.T * np.float32(1000)),
        "normal": np.ascontiguousarray(np.asarray(normals, np.float32).T),
        "shade": np.ones(len(points), np.float32),
    }
    for lamp in light.lights:
        arriving += graphs.at_points("irradiance", at, **lamp_numbers(lamp))
    return np.asarray(arriving.T / np.float32(np.pi), np.float32)


def with_gloss(albedo: AnyFloat, mirrored: AnyFloat | float = MIRRORED) -> Float32:
    """Linear RGB of hair of an albedo under white light, with what it mirrors: x of x^2 / (x + mirrored) = albedo."""
    some = 4 * np.asarray(mirrored, np.float32) * albedo
    return np.asarray(0.5 * (albedo + np.sqrt(np.square(albedo) + some)), np.float32)


def sketch(
    seen: SeenHead, colour: Float32, light: Illumination | None = None, tint: Triple = WHITE
) -> tuple[Float32, Float32]:
    """A quick picture, lit at the vertices: no shadows but cavity maps, no reflections but on hair. As
    :meth:`SeenHead.resolved`.

    Colours (N, 3) are linear, of the points on the head. Without ``light`` they have the photo's in them, and are only
    darkened at grazing angles; ``tint`` (3,) leads from parts' own colours to those in the photo's light.
    """
    graphs = Graphs(1)

    def at(points: AnyFloat, normals: Float32) -> Float32:
        plain = np.asarray(points, np.float32)
        if light is not None:
            return open_light(light, graphs, plain, normals)
        cosine = np.abs((normals * normalise(seen.camera.centre - plain)).sum(1, keepdims=True))
        return np.asarray(DARKEST + (1 - DARKEST) * cosine, np.float32)

    for one, share in zip(seen.parts, seen.reached(), strict=True):
        drawn, used = one.drawn, np.zeros(len(one.part.vertices), bool)
        used[one.corners[share > HIDDEN]] = True
        some, light_there = np.flatnonzero(used), np.zeros((len(used), 6), np.float32)
        there, facing = drawn.part.vertices[some], drawn.normals[some]
        light_there[some, :3] = at(there, facing)
        if drawn.along is not None and len(some):
            light_there[some, 3:] = _shine(seen, there, facing, drawn.along[some], one.colour.mean(0), light)
        own = np.ones(3, np.float32) if drawn.part.material.textured else np.asarray(tint, np.float32)
        lit, mirrored = np.split(one.between(light_there), 2, 1)
        shown = with_gloss(one.colour, mirrored) if light is None and drawn.along is not None else one.colour
        arriving = shown * one.openness() * lit
        one.radiance = own * (arriving if light is None else arriving + mirrored)
    picture = seen.resolved(colour * seen.between(at(seen.model.vertices, seen.model.normals)))
    return outlined(*picture) if any(one.drawn.along is not None for one in seen.parts) else picture


def _shine(
    seen: SeenHead, point: Float32, normal: Float32, along: Float32, colour: Float32, light: Illumination | None
) -> Float32:
    """(N, 3) what hair of a mean colour (3,) mirrors at points (N, 3), where it has normals and directions (N, 3).

    Radiance, or without light that over the light on the face: ``MIRRORED`` on average, more below a lamp above the
    camera.
    """
    view = normalise(seen.camera.centre - point).astype(np.float32)
    if light is None:
        above = normalise(view - seen.camera.rotation[1]).astype(np.float32)
        first = reflected(along, view, above, np.zeros((1, 3), np.float32), SPREAD) * _turned(normal, above)
        band = first / np.maximum(first.mean(), 1e-6)
        return np.asarray(MIRRORED * (1 - BAND + BAND * band), np.float32)
    total = np.zeros_like(point)
    for lamp in light.lights:
        toward = unit(np.array(lamp.position_m, np.float32) - point)
        whole = np.pi * open_light(Illumination((lamp,), np.zeros_like(light.sky)), Graphs(1), point, toward)
        total += whole * reflected(along, view, toward, colour[None], SPREAD) * _turned(normal, toward)
    return total


def _turned(normal: Float32, toward: Float32) -> Float32:
    """(N, 1) share of a lamp that reaches the strands, which those behind the body of hair do not see."""
    return np.asarray(np.clip(2 * (normal * toward).sum(1, keepdims=True), 0, 1), np.float32)


def outlined(light: Float32, covered: Float32) -> tuple[Float32, Float32]:
    """A picture, see :meth:`SeenHead.resolved`, whose outline is no stair where cards of hair turn away.

    There coverage is as steep as before about the line through the middle of the steps. What is thinner than three
    pixels stays.
    """
    import cv2

    cross, square = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8), np.ones((3, 3), np.uint8)
    step = cv2.dilate(covered, cross) - cv2.erode(covered, cross) > 1 - SOFT
    full = (covered > 0.5).astype(np.uint8)
    thin = sum(cv2.morphologyEx(full, kind, square) != full for kind in (cv2.MORPH_OPEN, cv2.MORPH_CLOSE))
    stair = np.flatnonzero(step & (cv2.dilate(np.asarray(thin, np.uint8), square) == 0))
    blurred = cv2.GaussianBlur(np.dstack([light, covered]), (5, 5), 1.0).reshape(-1, 4)[stair]
    share = np.clip(STEEP * (blurred[:, 3] - 0.5) + 0.5, 0, 1)
    smooth, cover = light.reshape(-1, 3).copy(), covered.ravel().copy()
    smooth[stair] = blurred[:, :3] * (share / np.maximum(blurred[:, 3], 1e-6))[:, None]
    cover[stair] = share
    return smooth.reshape(light.shape), cover.reshape(covered.shape)


def over(light: Float32, covered: Float32, backdrop: Float32) -> Float32:
    """(h, w, 3) coded sRGB in [0, 1] of a picture, see :meth:`SeenHead.resolved`, over a coded backdrop."""
    behind = srgb_to_linear(np.clip(backdrop, 0, 1))
    return linear_to_srgb(np.clip(light + (1 - covered)[..., None] * behind, 0, 1))
