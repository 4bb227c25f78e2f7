"""One subject's skin: everything listed once, then any window of the chart drawn on demand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from models.lightstage.skin.anatomy import Anatomy
from models.lightstage.skin.atlas import Atlas, Metric, enlarge
from models.lightstage.skin.base import BaseMaps, base_maps
from models.lightstage.skin.chromophores import ColourTable
from models.lightstage.skin.colour import Paint, diffuse_albedo
from models.lightstage.skin.drawn import Drawn
from models.lightstage.skin.gloss import roughness, specular_albedo
from models.lightstage.skin.hair import draw_strands, list_brows, list_stubble
from models.lightstage.skin.normals import diffuse_normals, normals_of
from models.lightstage.skin.pores import draw_pores, list_pores
from models.lightstage.skin.relief import Relief
from models.lightstage.skin.splat import Marks
from models.lightstage.skin.spots import draw_lines, draw_spots, list_lines, list_spots
from models.lightstage.skin.stack import GaussianStack
from models.lightstage.skin.subject import Subject
from models.lightstage.skin.window import CHART_WIDTH, ChartWindow
from models.lightstage.skin.wrinkles import draw_wrinkles, list_wrinkles

_WIDEST = 20.0
"""Largest blur (sigma, texels at 6144 columns): 1.4 mm at 14 texels per mm. A bound keeps halos small."""
_FINEST_PPM = 40.0
"""More texels per mm at 6144 columns than any chart has."""

_DENSE_WIDTH = 5000
"""Charts at least this wide have 11 texels per mm on the face, so noise of 0.8 mm and more needs only half of them."""


@dataclass(frozen=True)
class SkinMaps:
    """What a light stage would have measured, (C, h, w) float32 each.

    Attributes:
        diffuse_albedo: (3,) linear sRGB in [0, 1].
        specular_albedo: (1,) s in [0, 1]; F0 = 0.04 s.
        roughness: (3,) GGX alpha of the narrow and the broad lobe, and the share of the narrow one.
        specular_normal, diffuse_normal: (3,) unit, tangent space: x along +u, y across it towards +v, z out.
        height_mm: (1,) displacement of the fine relief; mean about 0.
        mask: (1,) 1 on the skin.
        regions: (K,) helper masks in [0, 1], named by ``REGION_NAMES``.
    """

    diffuse_albedo: Tensor
    specular_albedo: Tensor
    roughness: Tensor
    specular_normal: Tensor
    diffuse_normal: Tensor
    height_mm: Tensor
    mask: Tensor
    regions: Tensor

    REGION_NAMES = ("lips", "hair", "face", "pore", "scalp")


@dataclass(frozen=True)
class Skin:
    """A subject in one expression, ready to be drawn; make it with ``Skin.of``.

    Attributes:
        expression: ARKit unit -> [0, 1]; it moves the geometry and deepens wrinkles.
        position: (3, H, W) mm, template at rest; where noise lives.
        geometry: (3, H, W) mm, the subject's own head with this expression; what slopes are measured on.
        base, edge: slow maps, and the distance to the chart's border.
    """

    subject: Subject
    expression: dict[str, float]
    position: Tensor
    geometry: Tensor
    edge: Tensor
    base: BaseMaps
    colours: ColourTable
    relief: Relief
    paint: Paint
    pores: Marks
    spots: Marks
    lines: Marks
    wrinkles: Marks
    brows: Marks
    stubble: Marks
    device: torch.device

    @classmethod
    def of(
        cls,
        subject: Subject,
        anatomy: Anatomy,
        expression: dict[str, float] | None = None,
        device: torch.device | str = "cpu",
    ) -> Skin:
        """List everything; takes about a second on a CPU core."""
        pose = expression or {}
        atlas = anatomy.atlas
        device = torch.device(device)

        def put(values: np.ndarray) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(values, np.float32)).to(device)

        return cls(
            subject=subject,
            expression=pose,
            position=put(atlas.position),
            geometry=put(
                atlas.positions(vertices_of(subject, atlas, pose)) if atlas.head is not None else atlas.position
            ),
            edge=put(atlas.edge[None]),
            base=base_maps(subject, anatomy, device),
            colours=ColourTable.build(subject.tone.eumelanin, device),
            relief=Relief.of(subject, device),
            paint=Paint.of(subject, device),
            pores=list_pores(subject, anatomy),
            spots=list_spots(subject, anatomy),
            lines=list_lines(subject, anatomy),
            wrinkles=list_wrinkles(subject, anatomy, pose),
            brows=list_brows(subject, anatomy),
            stubble=list_stubble(subject, anatomy),
            device=device,
        )

    def halo(self, window: ChartWindow) -> int:
        """Texels beyond a window that its maps depend on."""
        return GaussianStack.reach(_WIDEST * window.chart_width / CHART_WIDTH) + 2

    def maps(self, window: ChartWindow) -> SkinMaps:
        """All maps of a window; bit-identical to the same part of any larger window of the same chart size."""
        outer = window.grown(self.halo(window), GaussianStack.ALIGN)
        drawn = self.draw(outer)
        size = window.chart_width / CHART_WIDTH
        widest, finest = _WIDEST * size, _FINEST_PPM * size
        metric = drawn.metric
        ppm = metric.texels_per_mm()
        normal = normals_of(drawn.height, metric)
        soft = diffuse_normals(normal, ppm, drawn.hair.cover, self.subject.gloss.scatter_scale, widest, finest)
        cavity = GaussianStack.build(drawn.height[None], widest)
        albedo = diffuse_albedo(self.subject, self.colours, self.paint, drawn, cavity, ppm, finest)
        gloss = specular_albedo(self.subject, drawn, cavity, ppm, finest)
        rough = roughness(self.subject, drawn)
        mask = (drawn.edge > 0.0).float()
        regions = torch.stack([drawn.lips, drawn.hair_cover, drawn.base["face"], drawn.pits.cover, drawn.base["scalp"]])
        parts = (albedo, gloss[None], rough, normal, soft, drawn.height[None], mask[None], regions)
        return SkinMaps(*(window.cut(part, outer).contiguous() for part in parts))

    def draw(self, window: ChartWindow) -> Drawn:
        """Everything that needs no neighbourhood."""
        dense = window.chart_width >= _DENSE_WIDTH
        position = enlarge(self.position, window)
        metric = Metric.of(enlarge(self.geometry, window))
        base = self.base.split(enlarge(self.base.maps, window))
        texel = (metric.p * metric.r).sqrt()
        lips = (0.5 - base["lip"] / self.subject.regions.lip_border_mm).clamp(0.0, 1.0)
        pits = draw_pores(self.pores, window, self.device)
        spots = draw_spots(self.spots, window, self.device)
        lines = draw_lines(self.lines, window, self.device)
        folds = draw_wrinkles(self.wrinkles, window, self.device)
        brows = draw_strands(self.brows, window, self.device)
        stubble = draw_strands(self.stubble, window, self.device)
        height = self.relief.height(position, texel, base["relief"], base["across"].clamp(0.0, 1.0), lips, dense)
        height = height + pits.height + spots.height + lines.height - folds + brows.height + 0.6 * stubble.height
        edge = enlarge(self.edge, window)[0]
        noises = self.paint.noises(position, dense)
        return Drawn(
            position, metric, texel, base, lips, pits, spots, lines, folds, brows, stubble, height, edge, *noises
        )


def vertices_of(subject: Subject, atlas: Atlas, expression: dict[str, float]) -> np.ndarray:
    """(V, 3) float32 metres of the subject's head; identity coefficients beyond the model's are left out."""
    head = atlas.head
    if head is None:
        raise ValueError("a flat atlas has no head")
    unknown = sorted(set(expression) - set(head.expression_names))
    if unknown:
        raise KeyError(f"the head has no expression unit {', '.join(unknown)}")
    weights = np.array([expression.get(name, 0.0) for name in head.expression_names], np.float32)
    identity = np.asarray(subject.identity[: len(head.identity)], np.float32)
    return head.shape(identity, weights)
