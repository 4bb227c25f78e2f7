"""Light from all directions: shipped images, analytic skies, suns taken out as lamps, and their rough reflections.

Directions are in head space: +X the subject's left, +Y up, +Z out of the face. A latitude-longitude image has +Y at its
top and the direction +Z, from where light falls on the face, at its middle column; a column further right is nearer to
+X.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, Float32, Float64
from service.checks import shown
from service.errors import ModelFault, UsageError
from service.light.scene import Environment, PointLight, Scene

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
"""Radians between successive points of a Fibonacci spiral."""


@functools.lru_cache(maxsize=8)
def pixel_directions(height: int, width: int) -> Float64:
    """(height, width, 3) unit directions of the pixel centres."""
    theta = (np.arange(height) + 0.5) / height * np.pi
    phi = ((np.arange(width) + 0.5) / width - 0.5) * 2.0 * np.pi
    sine, cosine = np.sin(theta)[:, None], np.cos(theta)[:, None]
    flat = np.ones_like(phi)[None]
    return np.stack([sine * np.sin(phi), cosine * flat, sine * np.cos(phi)], -1)


@functools.lru_cache(maxsize=8)
def pixel_solid_angles(height: int, width: int) -> Float64:
    """(height, width) steradians, exact, sum 4 pi."""
    edges = np.cos(np.arange(height + 1) / height * np.pi)
    return np.broadcast_to(((edges[:-1] - edges[1:]) * 2.0 * np.pi / width)[:, None], (height, width))


@functools.lru_cache(maxsize=8)
def spread_directions(count: int) -> Float64:
    """(count, 3) unit directions, evenly spread (Fibonacci spiral about the vertical); each stands for 4 pi / count."""
    y = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    radius = np.sqrt(1.0 - y * y)
    angle = np.arange(count) * GOLDEN_ANGLE
    return np.stack([radius * np.sin(angle), y, radius * np.cos(angle)], 1)


@functools.lru_cache(maxsize=4)
def _sharing(count: int, height: int, width: int) -> Float32:
    """(count, height * width) solid angle of each pixel, distributed over the nearest directions."""
    pixels = pixel_directions(height, width).reshape(-1, 3)
    sharpness = count / 3.0  # a Gaussian about as wide as the directions are apart
    weight = np.exp(sharpness * (spread_directions(count) @ pixels.T - 1.0))
    weight /= weight.sum(0)
    return (weight * pixel_solid_angles(height, width).ravel()).astype(np.float32)


def flux_by_direction(radiance: AnyFloat, count: int) -> Float64:
    """(count, 3) radiance times solid angle of each of ``count`` spread directions, of the same sum as the image's.

    A pixel is distributed over several directions with smooth weights, so that the shadow of a small bright spot does
    not jump from one direction to the next.
    """
    height, width = radiance.shape[:2]
    return np.asarray(_sharing(count, height, width) @ np.asarray(radiance, np.float64).reshape(-1, 3))


FILE = Path(__file__).resolve().parent.parent / "data" / "environments" / "environments.npz"
HEIGHT, WIDTH = 64, 128
"""Size of environment images, pixels."""

_FAR_M = 100.0
"""Distance of extracted suns, metres: their light is parallel across a head."""
_MOST_SUNS = 3
_SUN_REACH_DEG = 6.0
"""Angular radius around a peak within which radiance belongs to a sun."""


@functools.lru_cache(maxsize=1)
def _shipped() -> dict[str, npt.NDArray[np.float16]]:
    try:
        with np.load(FILE, allow_pickle=False) as archive:
            return {name: archive[name] for name in sorted(archive.files)}
    except (OSError, ValueError, EOFError) as fault:
        raise ModelFault(
            f"environment maps {FILE} cannot be read ({fault}); "
            "build them with python -m models.lightstage.light.environments"
        ) from fault


def names() -> tuple[str, ...]:
    """Names of the shipped environments."""
    return tuple(_shipped())


def check_name(environment: Environment) -> None:
    """Refuse a name that no shipped environment has, by UsageError."""
    if environment.name is not None and environment.name not in _shipped():
        words = f"no environment {shown(environment.name)}; there are {', '.join(names())}"
        raise UsageError(words, field="environment/name")


def radiance(environment: Environment) -> Float64:
    """(64, 128, 3) float64 linear radiance >= 0, rotated and scaled as the scene says; UsageError: an unknown name."""
    made = _sky(environment)
    check_name(environment)
    if environment.name is not None:
        made = made + _shipped()[environment.name].astype(np.float64)
    return turned(made, environment.rotation_deg) * environment.strength


def turned(image: Float64, degrees: float) -> Float64:
    """A latitude-longitude image (H, W, C) rotated about the vertical, linear between columns."""
    shift = degrees / 360.0 * image.shape[1]
    whole = math.floor(shift)
    part = shift - whole
    return np.asarray((1.0 - part) * np.roll(image, whole, 1) + part * np.roll(image, whole + 1, 1))


def _sky(environment: Environment) -> Float64:
    directions = pixel_directions(HEIGHT, WIDTH)
    up = directions[..., 1:2]
    zenith, horizon, ground = (np.asarray(c) for c in (environment.zenith, environment.horizon, environment.ground))
    blend = 1.0 / (1.0 + np.exp(-np.clip(up / 0.05, -40.0, 40.0)))
    above = horizon + (zenith - horizon) * np.clip(up, 0.0, 1.0) ** 0.6
    image = ground + (above - ground) * blend
    for box in environment.softboxes:
        towards = np.asarray(box.direction) / np.linalg.norm(box.direction)
        image = image + np.exp(box.sharpness * (directions @ towards - 1.0))[..., None] * np.asarray(box.radiance)
    return np.asarray(image)


@dataclass(frozen=True)
class Illumination:
    """A scene's light, divided by how it is computed.

    Attributes:
        lights: the scene's point lights, then the suns of the environment as distant spherical lights.
        sky: (64, 128, 3) radiance of the environment without its suns.
    """

    lights: tuple[PointLight, ...]
    sky: Float64

    @property
    def dark(self) -> bool:
        """Whether the sky sends no light at all."""
        return not self.sky.any()


def illumination(scene: Scene) -> Illumination:
    """Point lights and sky of a scene; suns become point lights, as few directions cannot resolve their shadows."""
    sky, suns = without_suns(radiance(scene.environment))
    return Illumination((*scene.lights, *suns), sky)


def without_suns(image: Float64) -> tuple[Float64, tuple[PointLight, ...]]:
    """Extract suns from a latitude-longitude image (H, W, 3) of linear radiance.

    A sun is a spot that sends more than 2 % of all light from within 6 degrees and whose peak is eight times as bright
    as the ring around it. It is replaced by the level of that ring, and returned as a spherical light at 100 m of the
    same angular size and the same irradiance on a facing surface.
    """
    height, width = image.shape[:2]
    directions, angles = pixel_directions(height, width), pixel_solid_angles(height, width)
    sky, suns = image.copy(), []
    for _ in range(_MOST_SUNS):
        light = sky.mean(-1)
        total = float((light * angles).sum())
        peak = np.unravel_index(int(np.argmax(light)), light.shape)
        cosine = directions @ directions[peak]
        spot = cosine > math.cos(math.radians(_SUN_REACH_DEG))
        ring = (cosine > math.cos(math.radians(2.0 * _SUN_REACH_DEG))) & ~spot
        level = np.median(sky[ring], 0)
        excess = np.maximum(sky - level, 0.0) * (spot * angles)[..., None]
        # 8.0: ratio of a sun's peak to the ring around it that has to be exceeded.
        # 0.02: fraction of all light that a sun has to exceed.
        if light[peak] <= 8.0 * level.mean() or excess.mean(-1).sum() <= 0.02 * total:
            break
        suns.append(_sun(excess, directions, float(np.sqrt(angles[peak] / math.pi))))
        sky = np.where(spot[..., None], np.minimum(sky, level), sky)
    return sky, tuple(suns)


def _sun(flux: Float64, directions: Float64, smallest: float) -> PointLight:
    """The spherical light that sends the (H, W, 3) flux; its angular radius is at least ``smallest`` radians."""
    weight = flux.mean(-1)
    mean = (directions * weight[..., None]).sum((0, 1))
    towards = mean / np.linalg.norm(mean)
    # A disc of angular radius r has mean cos = 1 - r^2 / 4.
    spread = float((weight * (1.0 - directions @ towards)).sum() / weight.sum())
    radius = min(max(2.0 * math.sqrt(max(spread, 0.0)), smallest), 0.3)
    x, y, z = (float(v) for v in towards * _FAR_M)
    red, green, blue = (float(v) for v in flux.sum((0, 1)) * _FAR_M**2)
    return PointLight((x, y, z), (red, green, blue), radius * _FAR_M)


def lookup(image: Float64, directions: Float64) -> Float64:
    """(..., 3) radiance of a latitude-longitude image at unit directions, bilinear."""
    from scipy.ndimage import map_coordinates

    height, width = image.shape[:2]
    theta, phi = np.arccos(np.clip(directions[..., 1], -1.0, 1.0)), np.arctan2(directions[..., 0], directions[..., 2])
    whole = np.pad(image, ((0, 0), (1, 1), (0, 0)), "wrap")  # the first column follows the last
    place = [theta / np.pi * height - 0.5, (phi / (2.0 * np.pi) + 0.5) * width - 0.5 + 1]
    colours = [map_coordinates(whole[..., channel], place, order=1, mode="nearest") for channel in range(3)]
    return np.stack(colours, -1)


LEVEL_ALPHAS = (0.08, 0.16, 0.27, 0.42, 0.64, 1.0)
"""GGX alpha of each level; smoother surfaces use the first."""

LEVEL_SIZE = (32, 64)
"""Rows and columns of each level."""


@functools.lru_cache(maxsize=len(LEVEL_ALPHAS))
def _kernel(alpha: float) -> Float32:
    """(out pixels, in pixels) weights of radiance for each mirror direction, viewed along the normal (Karis 2013)."""
    seen = pixel_directions(*LEVEL_SIZE).reshape(-1, 3).astype(np.float32)
    cosine = np.clip(seen @ seen.T, -1.0, 1.0)  # of twice the angle between normal and half vector
    n_h2 = 0.5 * (1.0 + cosine)
    d = 1.0 - n_h2 * (1.0 - alpha * alpha)
    weight = np.maximum(cosine, 0.0) / (d * d) * pixel_solid_angles(*LEVEL_SIZE).ravel().astype(np.float32)
    return np.asarray(weight / weight.sum(1, keepdims=True), np.float32)


def prefiltered(sky: AnyFloat) -> Float32:
    """(6, 3, 32, 64) float32 linear radiance for each of ``LEVEL_ALPHAS`` and each mirror direction; about 0.1 s.

    The sky is (H, W, 3) linear radiance, its sides multiples of 32 and 64.
    """
    rows, columns = sky.shape[0] // LEVEL_SIZE[0], sky.shape[1] // LEVEL_SIZE[1]
    blocks = np.asarray(sky, np.float32).reshape(LEVEL_SIZE[0], rows, LEVEL_SIZE[1], columns, 3)
    small = blocks.mean((1, 3)).reshape(-1, 3)
    levels = [(_kernel(alpha) @ small).reshape(*LEVEL_SIZE, 3).transpose(2, 0, 1) for alpha in LEVEL_ALPHAS]
    return np.ascontiguousarray(np.stack(levels), np.float32)
