"""The head's soft region masks on the chart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float32
from service.geometry.chart import Chart
from service.head.regions import vertex_mask


@dataclass(frozen=True)
class Zones:
    """Masks at the inner texels (N,), in the order of ``chart.texels``: float32 in [0, 1] except ``skin``.

    Attributes:
        skin: bool, texel of the part "skin".
        face: the face proper, where hair and make-up are part of the likeness.
        scalp: where hair is expected.
        neck: below the jaw.
        mouth: the inside of the mouth.
        hidden: inside of the mouth and of the eye sockets.
    """

    skin: Bool
    face: Float32
    scalp: Float32
    neck: Float32
    mouth: Float32
    hidden: Float32

    @classmethod
    def of(cls, chart: Chart) -> Zones:
        """Interpolate the head's region masks to the texels of the chart."""
        head = chart.head
        rows = [
            vertex_mask(head, "face"),
            vertex_mask(head, "scalp"),
            vertex_mask(head, "neck"),
            vertex_mask(head, "mouth_inner"),
            vertex_mask(head, "mouth_inner", "eye_socket"),
        ]
        skin = chart.part.ravel()[chart.texels] == head.part_names.index("skin")
        return cls(skin, *np.ascontiguousarray(chart.inside(np.stack(rows, 1)).T))
