"""A quick renderer of painted heads: pinhole camera, one soft light, random background. For calibration and reports."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from service.geometry.camera import Camera
from service.geometry.mesh import area_normals
from service.geometry.raster import Raster, rasterise
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]
HIDDEN_PARTS = ("lashes",)
"""Parts left out: lash cards are opaque without a cut-out texture."""


@dataclass(frozen=True)
class Shot:
    """A rendered head.

    Attributes:
        pixels: (H, W, 3) uint8 sRGB.
        raster: what each pixel sees; triangle numbers are those of ``triangle_index``.
        triangle_index: (T',) the head's triangle of each drawn triangle.
    """

    pixels: npt.NDArray[np.uint8]
    raster: Raster
    triangle_index: npt.NDArray[np.int64]


def look_at(yaw_deg: float, pitch_deg: float, roll_deg: float, distance: float, size: int, focal: float) -> Camera:
    """Camera that sees the head's middle; yaw > 0 turns the subject to the image right, pitch > 0 lets it look up."""
    y, p, r = np.radians([yaw_deg, pitch_deg, roll_deg])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(p), np.sin(p)], [0, -np.sin(p), np.cos(p)]])
    about_z = np.array([[np.cos(r), np.sin(r), 0], [-np.sin(r), np.cos(r), 0], [0, 0, 1]])
    rotation = np.diag([1.0, -1.0, -1.0]) @ about_z @ about_x @ about_y
    middle = np.array([0.0, -0.03, -0.06])
    return Camera(
        size, size, focal, np.array([size / 2, size / 2]), rotation, np.array([0, 0, distance]) - rotation @ middle
    )


def shoot(
    head: HeadModel,
    vertices: Float,
    albedo: npt.NDArray[np.float32],
    camera: Camera,
    light: Float,
    ambient: float,
    background: npt.NDArray[np.float32],
) -> Shot:
    """Render (V, 3) vertices with an (h, w, 3) linear albedo map.

    Args:
        head: topology and chart.
        vertices: head space metres.
        albedo: linear RGB in the chart, row 0 = top.
        camera: square or not.
        light: (3,) unit direction towards the light in head space.
        ambient: share of light from everywhere, in [0, 1].
        background: (H, W, 3) linear RGB.
    """
    hidden = [k for k, name in enumerate(head.part_names) if name in HIDDEN_PARTS]
    index = np.flatnonzero(~np.isin(head.triangle_part, hidden))
    triangles = head.triangles[index]
    depth = camera.to_camera(vertices)[:, 2]
    raster = rasterise(camera.project(vertices), depth, triangles, camera.width, camera.height, perspective=True)
    mask = raster.mask
    seen, weight = raster.triangle[mask], raster.barycentric[mask].astype(float)
    normal = np.einsum("nk,nkc->nc", weight, area_normals(vertices, triangles)[triangles[seen]])
    uv = np.einsum("nk,nkc->nc", weight, head.uv[head.triangle_uv[index][seen]].astype(float))
    height, width = albedo.shape[:2]
    x = (uv[:, 0] * width - 0.5).astype(np.float32)
    y = ((1 - uv[:, 1]) * height - 0.5).astype(np.float32)
    rows = 16384  # cv2.remap takes at most 32767 rows
    colour = np.concatenate(
        [
            cv2.remap(albedo, x[i : i + rows, None], y[i : i + rows, None], cv2.INTER_LINEAR)[:, 0]
            for i in range(0, len(x), rows)
        ]
    )
    shade = ambient + (1 - ambient) * np.clip(normal @ light, 0, 1) ** 0.9
    image = background.astype(np.float64).copy()
    image[mask] = colour * shade[:, None] * 1.6
    image = np.clip(image, 0, 1)
    coded = np.where(image <= 0.0031308, 12.92 * image, 1.055 * np.maximum(image, 1e-9) ** (1 / 2.4) - 0.055)
    return Shot((coded * 255 + 0.5).astype(np.uint8), raster, index)
