"""How much of the skin a photo shows: hair, collars, glasses and the far side of the head leave parts of it.

The light stage's heads are bald and seen from all round. The texture of a photo has lit skin on a third of the chart;
the rest is hair, or colour that was made up. So training hides as much. Brows and beards are seen and belong to the
albedo, but tell nothing of the light (``service.texture.unwrap``).
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from models.networks.context import HEIGHT, WIDTH
from models.training.degrade import blur, smooth_field
from models.training.regions import context_chart, region_planes
from models.training.tasks import choice, uniform
from service.runtime.network_registry import GEOMETRY
from service.texture.unwrap import SHADOW

BARE = 0.08
"""Share of the charts of which all skin is seen, as on rendered scans."""

HAIRY, COLLARED, SCREENED = 0.85, 0.6, 0.4
"""Share of the rest with hair on the scalp, a covered neck, and things before the face."""

YAW, PITCH = math.radians(20.0), math.radians(8.0)
"""Standard deviations of the direction that the photo was taken from."""

FACING, OPAQUE = (0.06, 0.2), 0.12
"""Squared cosine of the viewing angle at which skin begins to be seen, and by how much more it is seen wholly."""

STRANDS, SCREEN_CELLS = 0.3, (5, 8, 14, 24)
"""How far hairlines are frayed, in the scalp's soft mask; and how many screens would lie across a chart."""

LEAST = 0.03
"""Share of the chart that is seen at least, else all of it."""

UNREAD = 0.15
"""Share of the charts whose brows, or whose beard, the reader takes for skin."""

_NORMAL = [GEOMETRY.index(f"normal_object_{axis}") for axis in "xyz"]


class Cover:
    """Hides skin; knows where hair and collars are to be expected."""

    def __init__(self) -> None:
        chart = context_chart()
        self.scalp, self.neck, self.hidden, self.brows = region_planes(
            ("scalp",), ("neck",), ("mouth_inner", "eye_socket"), ("brow_left", "brow_right")
        )
        self.skin = torch.as_tensor((chart.part == chart.head.part_names.index("skin")).astype(np.float32))

    def __call__(self, geometry: Tensor, generator: torch.Generator) -> Tensor:
        """(N, 1, h, w) in [0, 1]: 1 where the photo shows skin; 0 on eyes and teeth and outside the islands.

        Args:
            geometry: (N, 11, h, w) channels ``GEOMETRY`` of the charts.
            generator: what hides which part.
        """
        mask = self.skin * geometry[:, -1:].clamp(0.0, 1.0)
        seen = self._facing(geometry[:, _NORMAL], generator) * (1.0 - self._hair(len(mask), generator))
        seen = seen * (1.0 - self._collar(len(mask), generator)) * (1.0 - self._screen(len(mask), generator))
        seen = seen * (1.0 - self.hidden)
        bare = torch.rand(len(mask), 1, 1, 1, generator=generator) < BARE
        lit = torch.where(bare, 1.0, blur(seen, 0.8).clamp(0.0, 1.0)) * mask
        return _enough(lit, mask)

    def measurable(self, seen: Tensor, beard: Tensor, generator: torch.Generator) -> Tensor:
        """(N, 1, h, w) in [0, 1]: 1 where light can be measured, on the skin that is seen beside brows and beards.

        Args:
            seen: (N, 1, h, w) in [0, 1], of :meth:`__call__`.
            beard: (N, 1, h, w) in [0, 1], how much of the skin a beard covers.
            generator: how the reader errs.
        """
        n, reach = len(seen), max(round(SHADOW * WIDTH), 1)  # as the service leaves out what lies beside hair
        brows = self.brows + STRANDS * self._field(n, (24, 48), generator) * (self.brows > 0.01)
        bare = torch.ones_like(seen)
        for hair in (beard, brows):
            edge = uniform(generator, 0.2, 0.6, n, 1, 1, 1)
            missed = torch.rand(n, 1, 1, 1, generator=generator) < UNREAD
            found = ((hair - edge) * 8.0 + 0.5).clamp(0.0, 1.0) * ~missed
            grown = functional.max_pool2d(found, 2 * reach + 1, 1, reach)
            bare = bare * (1.0 - torch.maximum(blur(grown, reach / 2), found).clamp(0.0, 1.0))
        return _enough(seen * bare, seen)

    def _facing(self, normal: Tensor, generator: torch.Generator) -> Tensor:
        n = len(normal)
        yaw, pitch = (s * torch.randn(n, generator=generator) for s in (YAW, PITCH))
        view = torch.stack([yaw.sin() * pitch.cos(), pitch.sin(), yaw.cos() * pitch.cos()], 1)
        squared = torch.einsum("nchw,nc->nhw", normal, view)[:, None].clamp(min=0.0).square()
        seen = ((squared - uniform(generator, *FACING, n, 1, 1, 1)) / OPAQUE).clamp(0.0, 1.0)
        # The worse side of the face is often the better one's mirror image.
        mirrored = torch.rand(n, 1, 1, 1, generator=generator) < 0.5
        return torch.where(mirrored, torch.maximum(seen, seen.flip(-1)), seen)

    def _hair(self, n: int, generator: torch.Generator) -> Tensor:
        line = uniform(generator, 0.02, 0.95, n, 1, 1, 1)
        frayed = STRANDS * self._field(n, (12, 24, 48), generator)
        here = (torch.rand(n, 1, 1, 1, generator=generator) < HAIRY).float()
        return here * ((self.scalp + frayed * (self.scalp > 0.01) - line) * 8.0).clamp(0.0, 1.0)

    def _collar(self, n: int, generator: torch.Generator) -> Tensor:
        here = (torch.rand(n, 1, 1, 1, generator=generator) < COLLARED).float()
        return here * ((self.neck - uniform(generator, 0.05, 0.8, n, 1, 1, 1)) * 8.0).clamp(0.0, 1.0)

    def _screen(self, n: int, generator: torch.Generator) -> Tensor:
        here = (torch.rand(n, 1, 1, 1, generator=generator) < SCREENED).float()
        height = self._field(n, SCREEN_CELLS, generator) - uniform(generator, 0.9, 2.2, n, 1, 1, 1)
        return here * (height * 8.0 + 0.5).clamp(0.0, 1.0)

    @staticmethod
    def _field(n: int, cells: tuple[int, ...], generator: torch.Generator) -> Tensor:
        return smooth_field((n, 1, HEIGHT, WIDTH), cells[choice(generator, len(cells))], generator)


def _enough(left: Tensor, before: Tensor) -> Tensor:
    """(N, 1, h, w) what is left, or what there was before in charts of which less than ``LEAST`` is."""
    return torch.where(left.mean((1, 2, 3), keepdim=True) >= LEAST, left, before)
