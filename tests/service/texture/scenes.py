"""Photos of the toy head with known colours, made with the z-buffer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from service.face.fit.fit import Fit
from service.face.reading.part_labels import BACKGROUND, PARTS
from service.face.reading.part_labels import SKIN as SKIN_PART
from service.face.reading.reader import CELLS, PART_CELLS, Reading
from service.face.region import Region
from service.geometry.camera import Camera
from service.geometry.raster import rasterise
from service.head.model import HeadModel
from service.photo.photo import Photo

Array = npt.NDArray[np.float64]


def turned(yaw_deg: float, size: int = 400, pitch_deg: float = 0.0) -> Camera:
    """Camera 0.8 m in front of the toy head, which turns by ``yaw_deg`` towards the image right."""
    a, b = np.radians([yaw_deg, pitch_deg])
    turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    nod = np.array([[1, 0, 0], [0, np.cos(b), np.sin(b)], [0, -np.sin(b), np.cos(b)]])
    rotation = np.diag([1.0, -1.0, -1.0]) @ turn @ nod
    translation = np.array([0.0, 0.0, 0.8]) + rotation @ np.array([0.0, 0.0, 0.08])
    return Camera(size, size, 3.0 * size, np.array([size / 2, size / 2]), rotation, translation)


def fitted(head: HeadModel, camera: Camera, vertices: npt.NDArray[np.float32] | None = None) -> Fit:
    shape = head.mean if vertices is None else vertices
    return Fit(camera, np.zeros(2), np.zeros(2), shape, shape, None, 1.0, 60.0)


def photograph(
    head: HeadModel,
    camera: Camera,
    paint: Callable[[Array], Array],
    background: tuple[float, float, float] = (0.1, 0.6, 0.2),
) -> Photo:
    """Photo of the head, its sRGB colour at head-space points (N, 3) given by ``paint``; 2 x 2 samples per pixel."""
    side = 2
    width, height = camera.width * side, camera.height * side
    points = camera.project(head.mean)
    raster = rasterise(
        points * side, camera.to_camera(head.mean)[:, 2], head.triangles, width, height, perspective=True
    )
    image = np.broadcast_to(np.asarray(background), (height, width, 3)).copy()
    mask = raster.mask
    corners = head.mean[head.triangles[raster.triangle[mask]]].astype(float)
    image[mask] = paint(np.einsum("nk,nki->ni", raster.barycentric[mask], corners))
    small = image.reshape(camera.height, side, camera.width, side, 3).mean((1, 3))
    return Photo(np.rint(np.clip(small, 0, 1) * 255).astype(np.uint8))


def read_off(head: HeadModel, camera: Camera, part: Callable[[Array], npt.NDArray[np.integer]]) -> Reading:
    """What a reader that errs nowhere says of such a photo, which has to be square.

    Args:
        head: in the photo.
        camera: of the photo.
        part: (N,) numbers of the parts at head-space points (N, 3).
    """
    points = camera.project(head.mean) * PART_CELLS / camera.width
    depth = camera.to_camera(head.mean)[:, 2]
    raster = rasterise(points, depth, head.triangles, PART_CELLS, PART_CELLS, perspective=True)
    label = np.full((PART_CELLS, PART_CELLS), BACKGROUND)
    corners = head.mean[head.triangles[raster.triangle[raster.mask]]].astype(float)
    label[raster.mask] = part(np.einsum("nk,nki->ni", raster.barycentric[raster.mask], corners))
    unknown, middle = np.ones((CELLS, CELLS)), camera.width / 2
    region, vectors = Region(middle, middle, camera.width), np.zeros((CELLS, CELLS, 3))
    return Reading(region, vectors[..., :2], unknown, vectors, unknown, np.eye(len(PARTS), dtype=np.float32)[label])


def bare(head: HeadModel, camera: Camera) -> Reading:
    """The same where all of the head is skin."""
    return read_off(head, camera, lambda points: np.full(len(points), SKIN_PART))


def plain(colour: tuple[float, float, float]) -> Callable[[Array], Array]:
    return lambda points: np.broadcast_to(np.asarray(colour), (len(points), 3))


SKIN = (0.80, 0.62, 0.52)


def checks(points: Array) -> Array:
    """Checkerboard of 12 mm in x and y about a skin tone, the same on both sides of the head."""
    dark = (np.floor(np.abs(points[:, 0]) / 0.012) + np.floor((points[:, 1] + 1) / 0.012)) % 2
    return np.asarray(SKIN) * (1 - 0.25 * dark[:, None])
