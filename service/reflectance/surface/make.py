"""Maps of the surface that need no network: roughness, cavity and thickness."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, Float32, UInt8
from service.geometry.chart import Chart
from service.head.model import HeadModel
from service.reflectance.result import Reflectance
from service.reflectance.subject import GEOMETRY_SIZE
from service.reflectance.surface.cavity import cavity
from service.reflectance.surface.roughness import oil_of, roughness
from service.reflectance.surface.thickness import thickness_mm

Scalar = TypeVar("Scalar", bound=np.generic)

LARGEST = (1152, 768)
"""Largest size of these maps: a texel is a third of a millimetre on the face, and they show little that is finer. Of
smaller ones they have half the sides."""

CODES_PER_MM = 10
"""Of thickness."""


@dataclass(frozen=True)
class SurfaceMaps:
    """Maps on the head's chart, (h, w) uint8, padded outside the islands; None: not requested, or not to be had.

    Attributes:
        roughness: 255 = 1, square root of GGX alpha.
        cavity: 255 = 1, share of the sky that the relief leaves open.
        thickness: ``CODES_PER_MM``; 255 is thick.
    """

    roughness: UInt8 | None = None
    cavity: UInt8 | None = None
    thickness: UInt8 | None = None


def surface_maps(
    head: HeadModel,
    vertices: AnyFloat,
    made: Reflectance | None,
    roles: Collection[str],
    size: tuple[int, int],
) -> SurfaceMaps | None:
    """The maps among ``roles``; None where none of them is.

    Args:
        head: topology, chart and regions.
        vertices: (V, 3) metres.
        made: specular albedo says how oily the skin is, displacement where its cavities are.
        roles: maps that were requested.
        size: (width, height) of the other maps.
    """
    wanted = set(roles) & {one.name for one in fields(SurfaceMaps)}
    if not wanted:
        return None
    size = min((max(size[0] // 2, 1), max(size[1] // 2, 1)), LARGEST)
    chart = Chart.build(head, *min(size, GEOMETRY_SIZE))
    specular = None if made is None else made.specular_albedo
    relief = None if made is None else made.displacement
    oil = oil_of(chart, None if specular is None else _resized(specular, (chart.width, chart.height)))
    thick = chart.fill_outside(chart.interpolate(thickness_mm(head, vertices)))[..., 0]
    open_sky = None if relief is None else cavity(relief, _texel_mm(head, vertices, size[0]), size)
    return SurfaceMaps(
        roughness=_codes(_resized(roughness(chart, oil), size), 255) if "roughness" in wanted else None,
        cavity=_codes(open_sky, 255) if "cavity" in wanted and open_sky is not None else None,
        thickness=_codes(_resized(thick, size), CODES_PER_MM) if "thickness" in wanted else None,
    )


def _texel_mm(head: HeadModel, vertices: AnyFloat, width: int) -> float:
    """Median size of a texel of the face, mm: edges of the mesh over those of the chart, which is ``width`` wide."""
    face = head.region("face") if "face" in head.region_names else np.ones(len(head.mean), np.float32)
    chosen = (face[head.triangles] > 0.5).all(1) & (head.triangle_part == 0)
    if not chosen.any():
        chosen = head.triangle_part == 0
    corners = np.asarray(vertices, np.float64)[head.triangles[chosen]]
    places = head.uv.astype(np.float64)[head.triangle_uv[chosen]] * (width, width * 2 / 3)
    length, texels = (np.linalg.norm(one[:, 1] - one[:, 0], axis=1) for one in (corners, places))
    return float(np.median(length * 1e3 / np.maximum(texels, 1e-9))) if len(length) else 1.0


def _resized(image: npt.NDArray[Scalar], size: tuple[int, int]) -> npt.NDArray[Scalar]:
    import cv2

    smaller = image.shape[1] > size[0]
    pixels: Any = image
    made = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR)
    return np.asarray(made, image.dtype)


def _codes(values: Float32 | None, scale: float) -> UInt8 | None:
    return None if values is None else np.rint(np.clip(values * scale, 0, 255)).astype(np.uint8)
