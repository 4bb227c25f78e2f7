"""Make the chart: lay every left island flat, place it in the right half of the image, mirror."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from models.head.chart.islands import cut, left_polygons
from models.head.chart.layout import HEIGHT, WIDTH, Flat, eye_disc, place, upright
from models.head.chart.unfold import unfold_face, unfold_small
from models.head.crop import Crop
from models.head.source import BaseMesh

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

SMALL_PPM = {"mouth": 1.9, "socket": 2.4, "teeth_upper": 4.5, "teeth_lower": 4.5, "tongue": 2.6}
EYE_RADIUS = 150.0


@dataclass(frozen=True)
class Chart:
    """uv: (U, 2) float64 in [0, 1], origin bottom left; polygon_uv: (Q, 4) int64, -1 pads triangles."""

    uv: Float
    polygon_uv: Int


def build_chart(base: BaseMesh, crop: Crop, template_mm: Float) -> Chart:
    """The whole chart for a (V, 3) template in mm with its origin between the eyes."""
    left = left_polygons(crop, template_mm)
    flats = [eye_disc(crop, 1, left[crop.part[left] == 1], EYE_RADIUS)]
    for island in cut(base, crop, template_mm):
        if island.name == "face":
            flats.append(unfold_face(crop, template_mm, island))
        else:
            flats.append(upright(unfold_small(crop, template_mm, island, SMALL_PPM.get(island.name, 5.0))))
    place(flats)
    return mirror_chart(crop, flats, left)


def mirror_chart(crop: Crop, flats: list[Flat], left: Int) -> Chart:
    """Join the islands and add the other half: u <-> 1 - u."""
    polygon_uv = np.full((len(crop.polygons), 4), -1)
    xy, seam = [], []
    offset = 0
    for flat in flats:
        polygon_uv[flat.polygons] = np.where(flat.corners < 0, -1, flat.corners + offset)
        xy.append(flat.xy)
        seam.append(flat.on_midline)
        offset += len(flat.xy)
    points, on_seam = np.concatenate(xy), np.concatenate(seam)
    points[on_seam, 0] = 0.0
    partner = np.arange(len(points))
    partner[~on_seam] = len(points) + np.arange(int((~on_seam).sum()))
    uv = np.stack([0.5 + points[:, 0] / WIDTH, points[:, 1] / HEIGHT], 1)
    other = np.stack([0.5 - points[~on_seam, 0] / WIDTH, points[~on_seam, 1] / HEIGHT], 1)
    right_of = {tuple(sorted(p)): k for k, p in enumerate(crop.polygons.tolist())}
    for k in left:
        corners = crop.polygons[k]
        images = np.where(corners < 0, -1, crop.mirror[corners])
        target = right_of[tuple(sorted(images.tolist()))]
        lookup = {int(v): int(partner[u]) for v, u in zip(images, polygon_uv[k], strict=True) if v >= 0}
        polygon_uv[target] = [lookup[int(v)] if v >= 0 else -1 for v in crop.polygons[target]]
    return Chart(np.concatenate([uv, other]), polygon_uv)
