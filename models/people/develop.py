"""From light to a photo: background, exposure, lens and sensor, what devices do to pictures, JPEG."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from models.lightstage.skin.streams import Stream
from service.colour import linear_to_srgb
from service.errors import UnreadableInput
from service.geometry.camera import Camera
from service.light.environment import lookup

Image = npt.NDArray[np.float32]
Bytes = npt.NDArray[np.uint8]


def backdrop(seed: int, camera: Camera, sky: Image) -> Image:
    """(H, W, 3) linear light of what stands behind the person."""
    s = Stream(seed, "backdrop")
    size, kind = camera.width, s.one()
    level = (float(sky.mean()) + 1e-3) * 0.4  # things reflect part of the light that falls on them
    if kind < 0.45:  # the surroundings, out of focus
        y, x = np.mgrid[:size, :size] + 0.5
        rays = np.stack(
            [
                (x - camera.principal_point[0]) / camera.focal_px,
                (y - camera.principal_point[1]) / camera.focal_px,
                np.ones_like(x),
            ],
            -1,
        )
        rays = rays * [s.one(1.0, 3.0), s.one(1.0, 3.0), 1.0]
        rays = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)) @ camera.rotation
        return np.asarray(lookup(sky.astype(np.float64), rays) * s.one(0.2, 1.0), np.float32)
    colour = np.exp(s.normal(0.0, 0.5, 3) * 0.5 + s.normal(0.0, 0.8)[0]) * level
    if kind < 0.65:  # a wall in uneven light
        y, x = np.mgrid[:size, :size] / size - 0.5
        turn = s.one(0, 6.3)
        shade = np.exp(s.one(-1.5, 1.5) * (x * np.cos(turn) + y * np.sin(turn)))
        return np.asarray(shade[..., None] * colour, np.float32)
    image = clutter(s, size)
    return np.asarray(image * colour * 2.0, np.float32)


def clutter(s: Stream, size: int) -> Image:
    """(size, size, 3) random coloured noise of all scales with random shapes, in [0, 1]."""
    image = np.zeros((size, size, 3), np.float32)
    for cells in (2, 4, 8, 16, 32, 64):
        field = s.uniform(size=cells * cells * 3).reshape(cells, cells, 3).astype(np.float32)
        weight = np.float32(s.one() ** 2 * (1.0 if cells < 20 else 0.5))
        image += weight * (cv2.resize(field, (size, size), interpolation=cv2.INTER_CUBIC) - 0.5)
    image = np.clip(0.5 + image * s.one(0.3, 1.0), 0.02, 1.0)
    for _ in range(int(s.one(0, 12))):
        colour = tuple(float(c) for c in s.uniform(0.0, 1.0, 3))
        at = (s.uniform(-0.1, 1.1, 6) * size).astype(int)
        if s.chance(0.5):
            cv2.rectangle(image, (int(at[0]), int(at[1])), (int(at[2]), int(at[3])), colour, -1)
        else:
            cv2.fillPoly(image, [at.reshape(3, 2).astype(np.int32)], colour)
    grey = image.mean(-1, keepdims=True)
    image = grey + (image - grey) * np.float32(s.one() ** 1.5)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), s.one(0.3, 4.0)) ** 2.2, np.float32)


def exposure(s: Stream, light: Image, face: npt.NDArray[np.bool_]) -> float:
    """Factor that brings the brighter part of the face to a level that photographers choose, now and then badly."""
    values = light[face].mean(-1) if face.any() else light.reshape(-1, 3).mean(-1)
    bright = float(np.quantile(values, 0.8)) if len(values) else 1.0
    target = float(np.clip(s.log_normal(0.42, 0.45)[0], 0.08, 1.3))
    return target / max(bright, 1e-5)


def develop(seed: int, light: Image, face: npt.NDArray[np.bool_]) -> tuple[Bytes, bytes]:
    """(H, W, 3) uint8 sRGB picture as decoded from the JPEG file, and that file.

    Args:
        seed: names the camera and what happened to its picture.
        light: (H, W, 3) float32 linear.
        face: (H, W) bool, pixels to expose for.
    """
    s = Stream(seed, "develop")
    size = light.shape[0]
    image = light * np.float32(exposure(s, light, face))
    balance = np.exp(s.normal(0.0, 0.10, 3) * np.array([1.0, 0.3, 1.0]))
    image = image * (balance / balance[1]).astype(np.float32)
    image = _lens(s, image)
    image = _sensor(s, np.maximum(image, 0.0))
    shoulder = s.one(0.0, 0.5)
    if shoulder > 0.02:
        knee = 1.0 - shoulder
        image = np.where(image > knee, knee + shoulder * (1 - np.exp(-np.maximum(image - knee, 0) / shoulder)), image)
    coded = linear_to_srgb(np.clip(image, 0.0, 1.0).astype(np.float32))
    coded = _curves(s, coded)
    if s.chance(0.08):
        coded = np.repeat(coded @ np.array([[0.299], [0.587], [0.114]], np.float32), 3, -1)
    if s.chance(0.2):  # a small picture made large
        small = max(24, int(size * s.one(0.25, 0.8)))
        filter_ = cv2.INTER_CUBIC if s.chance(0.5) else cv2.INTER_LINEAR
        shrunk = cv2.resize(coded, (small, small), interpolation=cv2.INTER_AREA)
        coded = np.asarray(cv2.resize(shrunk, (size, size), interpolation=filter_), np.float32)
    picture = np.round(np.clip(coded, 0.0, 1.0) * 255).astype(np.uint8)
    quality = int(s.one(30, 98)) if s.chance(0.8) else 98
    done, buffer = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise OSError("the JPEG encoder failed")
    data = buffer.tobytes()
    return decoded(data), data


def decoded(jpeg: bytes) -> Bytes:
    """(H, W, 3) uint8 sRGB of a JPEG file.

    Raises:
        UnreadableInput: it is none.
    """
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise UnreadableInput("the portrait's JPEG file cannot be decoded")
    return np.ascontiguousarray(image[..., ::-1].astype(np.uint8, copy=False))


def _lens(s: Stream, image: Image) -> Image:
    """Blur by focus or motion, glow, vignetting."""
    size = image.shape[0]
    if s.chance(0.35):
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), s.one(0.4, 0.012 * size)), np.float32)
    if s.chance(0.08):
        length = max(3, int(s.one(0.01, 0.05) * size))
        kernel = np.zeros((length, length), np.float32)
        turn, half = s.one(0, np.pi), (length - 1) / 2
        ends = [
            (round(half + sign * half * np.cos(turn)), round(half + sign * half * np.sin(turn))) for sign in (-1, 1)
        ]
        cv2.line(kernel, ends[0], ends[1], 1.0)
        image = np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), np.float32)
    if s.chance(0.2):
        image = image + np.float32(s.one(0.02, 0.15)) * cv2.GaussianBlur(
            np.minimum(image, 4.0), (0, 0), size * s.one(0.02, 0.1)
        )
    if s.chance(0.3):
        y, x = np.mgrid[:size, :size] / size - 0.5 + s.normal(0, 0.1)[0]
        image = image * np.exp(-s.one(0.3, 2.0) * (x * x + y * y))[..., None].astype(np.float32)
    return image


def _sensor(s: Stream, image: Image) -> Image:
    """Shot and read noise, coarser where the device has smoothed it."""
    strength = s.one() ** 3 * 0.08
    noise = s.normal(size=image.size).reshape(image.shape).astype(np.float32)
    if s.chance(0.4):
        noise = cv2.GaussianBlur(noise, (0, 0), s.one(0.5, 1.2)) * np.float32(1.8)
    return np.asarray(image + noise * np.sqrt(image * strength**2 * 2.0 + (0.3 * strength) ** 2 * 0.1), np.float32)


def _curves(s: Stream, coded: Image) -> Image:
    """What devices and people do to colours: contrast, gamma, saturation, sharpening."""
    coded = coded ** np.float32(np.clip(s.log_normal(1.0, 0.12)[0], 0.6, 1.6))
    if s.chance(0.5):
        coded = coded + np.float32(s.one(-0.25, 0.35)) * (coded * coded * (3 - 2 * coded) - coded)
    grey = coded.mean(-1, keepdims=True)
    coded = grey + (coded - grey) * np.float32(np.clip(s.log_normal(1.0, 0.2)[0], 0.2, 1.8))
    if s.chance(0.25):
        coded = coded + np.float32(s.one(0.2, 1.2)) * (coded - cv2.GaussianBlur(coded, (0, 0), s.one(0.6, 1.5)))
    return np.asarray(np.clip(coded, 0.0, 1.0), np.float32)
