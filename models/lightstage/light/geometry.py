"""A head under light: where each texel lies, how it is turned, and which of all directions it sees."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from models.lightstage.light.sampling import enlarged, reduced, unit
from models.lightstage.light.visibility import Points, lit_from_direction, lit_from_point
from models.lightstage.skin.window import ChartWindow
from service.geometry.chart import Chart
from service.geometry.sampling import surface_points
from service.head.model import HeadModel
from service.light.environment import spread_directions
from service.light.formulas import disc_of
from service.light.scene import PointLight

_CASTERS = ("skin", "eye_left", "eye_right")
_CASTERS_MM = (0.9, 1.8)


@dataclass(frozen=True)
class Site:
    """Geometry at the texels of a window, float32.

    Attributes:
        position: (3, h, w) mm in head space.
        tangent, bitangent, normal: (3, h, w) unit axes of tangent space: along +u, across it towards +v, out.
        texels_per_mm: (h, w), square root of texels per mm^2.
        step: (2, 2, h, w) texels to the right (first) and up (second) per mm along the tangent and the bitangent.
        mask: (h, w) 1 on the islands.
    """

    position: Tensor
    tangent: Tensor
    bitangent: Tensor
    normal: Tensor
    texels_per_mm: Tensor
    step: Tensor
    mask: Tensor

    def to_head(self, tangent_space: Tensor) -> Tensor:
        """(3, h, w) unit vectors in head space of tangent-space ones."""
        x, y, z = tangent_space.to(self.normal.dtype)
        return unit(x * self.tangent + y * self.bitangent + z * self.normal)


@dataclass(frozen=True)
class Geometry:
    """What light needs to know of a head; made once a subject and expression, used for all its lightings.

    Attributes:
        maps: (13, H, W) float32 of the whole chart: position, normal, tangent (3 each), and the change of position per
            unit of u and of v, (p, q; 0, r) mm along tangent and bitangent, as (p, q, 0, r).
        mask: (1, H, W) 1 on the skin.
        occluders, coarse: (M, 3) mm, points that cast hard and soft shadows, ``casters_mm`` apart.
        visible: (D, h, w) uint8, 255 where the texel sees the direction (and the direction is above its horizon).
        face: (1, H, W) soft mask of the face, for exposure and errors.
    """

    maps: Tensor
    mask: Tensor
    face: Tensor
    occluders: Tensor
    coarse: Tensor
    casters_mm: tuple[float, float]
    visible: Tensor
    _shadows: dict[PointLight, Tensor] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(
        cls,
        head: HeadModel,
        vertices: npt.NDArray[np.floating],
        *,
        size: tuple[int, int] = (384, 256),
        sky_size: tuple[int, int] = (192, 128),
        directions: int = 256,
        casters_mm: tuple[float, float] = _CASTERS_MM,
        device: torch.device | str = "cpu",
    ) -> Geometry:
        """Prepare (V, 3) vertices in metres; a few seconds on a CPU core.

        Args:
            head: topology and chart.
            vertices: in head space.
            size: columns and rows of the maps and of shadows.
            sky_size: columns and rows of the visibility of the surroundings.
            directions: how many directions the surroundings are divided into.
            casters_mm: spacing of the points that cast hard shadows, and soft ones and those of the surroundings.
            device: where everything lives.
        """
        chart = Chart.build(head, *size)
        maps, mask, face = (torch.from_numpy(a).to(device) for a in _maps(chart, vertices))
        casters = np.isin(head.triangle_part, [i for i, name in enumerate(head.part_names) if name in _CASTERS])
        triangles = head.triangles[casters]
        fine, coarse = (
            torch.from_numpy(surface_points(np.asarray(vertices) * 1000.0, triangles, spacing)).to(device)
            for spacing in casters_mm
        )
        visible = _sky(maps, coarse, casters_mm[1], sky_size, directions)
        return cls(maps, mask, face, fine, coarse, casters_mm, visible)

    @property
    def device(self) -> torch.device:
        """Where the maps live."""
        return self.maps.device

    def site(self, window: ChartWindow) -> Site:
        """Geometry of a window; a crop has the values of the whole."""
        maps = enlarged(self.maps, window)
        normal = unit(maps[3:6])
        along = maps[6:9] - normal * (maps[6:9] * normal).sum(0)
        tangent = unit(along, (1.0, 0.0, 0.0))
        bitangent = torch.linalg.cross(normal, tangent, dim=0)
        p, q, _, r = maps[9:13]
        p, q, r = p / window.chart_width, q / window.chart_height, r / window.chart_height
        p, r = p.clamp(min=1e-4), r.clamp(min=1e-4)
        # A step of one texel right and up is (p, q; 0, r) mm; its inverse gives texels per mm.
        step = torch.stack([torch.stack([1.0 / p, -q / (p * r)]), torch.stack([torch.zeros_like(p), 1.0 / r])])
        mask = (enlarged(self.mask, window)[0] > 0.5).float()
        return Site(maps[:3], tangent, bitangent, normal, (p * r).rsqrt(), step, mask)

    def sky_light(self, flux: Tensor, window: ChartWindow) -> Tensor:
        """(9, h, w) vector irradiance of the surroundings, blocked by the head: sum of V d flux over directions d.

        Its dot product with a normal near the smooth one is the irradiance there. Channel 3 c + k is colour c, axis k.

        Args:
            flux: (D, 3) radiance times solid angle of each direction.
            window: where.
        """
        directions = torch.from_numpy(spread_directions(len(self.visible))).to(flux)
        each = (flux[:, :, None] * directions[:, None, :]).reshape(len(flux), 9)
        seen = self.visible.view(len(flux), -1)
        light = torch.zeros(9, seen.shape[1], device=self.device)
        for part in range(0, len(flux), 64):
            light += each[part : part + 64].float().T @ (seen[part : part + 64].float() / 255.0)
        return enlarged(light.view(9, *self.visible.shape[1:]), window)

    def density(self, window: ChartWindow) -> float:
        """Texels per mm of the densest part of the face on a chart of the window's size (98th percentile)."""
        inside = self.face[0] > 0.5
        area = (self.maps[9] * self.maps[12])[inside if inside.any() else self.mask[0] > 0.5]
        if not area.numel():
            return 1.0
        smallest = max(float(area.quantile(0.02)), 1.0)
        return math.sqrt(window.chart_width * window.chart_height / smallest)

    def openness(self, window: ChartWindow) -> Tensor:
        """(h, w) ambient occlusion in [0, 1]: share of evenly bright surroundings' irradiance that arrives."""
        even = torch.full((len(self.visible), 3), 4.0 * torch.pi / len(self.visible), device=self.device)
        vector = self.sky_light(even, window)[:3]
        return ((vector * self.site(window).normal).sum(0) / torch.pi).clamp(0.0, 1.0)

    def shadow(self, light: PointLight, window: ChartWindow) -> Tensor:
        """(h, w) share in [0, 1] of a light that arrives; computed for the whole chart once and remembered."""
        if light not in self._shadows:
            if len(self._shadows) >= 32:
                self._shadows.clear()
            self._shadows[light] = self._cast(light)
        return enlarged(self._shadows[light], window)[0].clamp(0.0, 1.0)

    def forget_shadows(self) -> None:
        """Give back the memory of remembered shadows."""
        self._shadows.clear()

    def _cast(self, light: PointLight) -> Tensor:
        height, width = self.maps.shape[1:]
        points = Points(self.maps[:3].reshape(3, -1), self.maps[3:6].reshape(3, -1))
        centre = (0.5 * (self.occluders.amin(0) + self.occluders.amax(0))).double().cpu().numpy()
        places = torch.from_numpy(disc_of(light, centre / 1000.0) * 1000.0).to(points.position)
        occluders, spacing = (self.occluders if len(places) == 1 else self.coarse), self.casters_mm[len(places) > 1]
        lit = torch.stack([lit_from_point(occluders, spacing, points, at) for at in places]).mean(0)
        return lit.view(1, height, width)


def _maps(chart: Chart, vertices: npt.NDArray[np.floating]) -> tuple[npt.NDArray[np.float32], ...]:
    """(13, H, W) geometry, (1, H, W) mask of the skin and (1, H, W) mask of the face."""
    frame = chart.frame(vertices)
    metric = chart.metric(vertices) * np.array(
        [chart.width**2, chart.width * chart.height, chart.height**2], np.float32
    )  # mm^2 per unit of u and v
    p = np.sqrt(np.maximum(metric[..., 0], 1e-8))
    q = metric[..., 1] / p
    r = np.sqrt(np.maximum(metric[..., 2] - q * q, 1e-8))
    position, steps = chart.interpolate(np.asarray(vertices) * 1000.0), np.stack([p, q, 0 * r, r], -1)
    parts = (position, frame.normal, frame.tangent, steps)
    maps = chart.fill_outside(np.concatenate(parts, -1))
    skin = (chart.part == chart.head.part_names.index("skin")).astype(np.float32)
    has_face = "face" in chart.head.region_names
    face = chart.interpolate(chart.head.region("face"))[..., 0] * skin if has_face else skin
    return np.ascontiguousarray(maps.transpose(2, 0, 1), np.float32), skin[None], face.astype(np.float32)[None]


def _sky(maps: Tensor, occluders: Tensor, spacing_mm: float, size: tuple[int, int], count: int) -> Tensor:
    """(count, h, w) uint8 visibility of spread directions at the texels of a smaller map."""
    small = reduced(maps[:6], size[1], size[0])
    points = Points(small[:3].reshape(3, -1), unit(small[3:]).reshape(3, -1))
    directions = torch.from_numpy(spread_directions(count)).to(maps)
    visible = torch.zeros(count, size[1] * size[0], dtype=torch.uint8, device=maps.device)
    for k in range(count):
        visible[k] = (lit_from_direction(occluders, spacing_mm, points, directions[k]) * 255.0 + 0.5).to(torch.uint8)
    return visible.view(count, size[1], size[0])
