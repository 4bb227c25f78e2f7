"""Which texels are treated how: the head's soft region masks brought to the chart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.geometry.chart import Chart
from service.head.regions import vertex_mask

Float = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Zones:
    """Masks at the inner texels (N,) in the order of ``chart.texels``; the soft ones are float32 in [0, 1].

    Attributes:
        skin: bool, texel of the part "skin".
        face: the face proper, where hair and make-up are part of the likeness.
        middle: cheeks and nose, which hats, fringes and beards leave free.
        features: lips and lids, which are not skin-coloured by right.
        scalp: where hair is expected.
        neck: below the jaw.
        mouth: the inside of the mouth.
        hidden: inside of the mouth and of the eye sockets.
    """

    skin: npt.NDArray[np.bool_]
    face: Float
    middle: Float
    features: Float
    scalp: Float
    neck: Float
    mouth: Float
    hidden: Float

    @classmethod
    def of(cls, chart: Chart) -> Zones:
        """Bring the head's regions to the chart."""
        head = chart.head
        lids = vertex_mask(head, "eyelid_left", "eyelid_right")
        brows = vertex_mask(head, "brow_left", "brow_right")
        rows = [
            vertex_mask(head, "face"),
            vertex_mask(head, "cheek_left", "cheek_right", "nose"),
            np.maximum(np.maximum(vertex_mask(head, "lips"), brows), lids),
            vertex_mask(head, "scalp"),
            vertex_mask(head, "neck"),
            vertex_mask(head, "mouth_inner"),
            vertex_mask(head, "mouth_inner", "eye_socket"),
        ]
        skin = chart.part.ravel()[chart.texels] == head.part_names.index("skin")
        return cls(skin, *np.ascontiguousarray(chart.inside(np.stack(rows, 1)).T))
