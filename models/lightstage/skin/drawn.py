"""What is drawn of a window before its maps are computed: the layers that colour, gloss and relief are made from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from models.lightstage.skin.atlas import Metric
from models.lightstage.skin.hair import HairMaps
from models.lightstage.skin.pores import PorePits
from models.lightstage.skin.spots import LineMaps, SpotMaps


@dataclass(frozen=True)
class Drawn:
    """Layers of a window, (h, w) where not said otherwise."""

    position: Tensor
    metric: Metric
    texel_mm: Tensor
    base: dict[str, Tensor]
    lips: Tensor
    pits: PorePits
    spots: SpotMaps
    lines: LineMaps
    folds: Tensor
    brows: HairMaps
    stubble: HairMaps
    height: Tensor
    edge: Tensor
    mottle: Tensor
    grain: Tensor

    @cached_property
    def hair(self) -> HairMaps:
        """Brows and stubble together."""
        pairs = ((getattr(self.brows, f), getattr(self.stubble, f)) for f in ("dark", "grey", "height", "shadow"))
        return HairMaps(*(torch.maximum(x, y) for x, y in pairs))

    @property
    def hair_cover(self) -> Tensor:
        """Cover by any strand."""
        return self.hair.cover
