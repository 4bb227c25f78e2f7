"""``mesh/hair.usda``: the strands of hair as BasisCurves, for tools that render or groom strands.

Linear curves from root to tip on the head at rest, metres, +Y up, with a width and a colour at each point: what Blender
reads as hair curves, and Houdini and Unreal (with its plug-ins for USD and for hair) as grooms.
"""

from __future__ import annotations

import numpy as np

from service.archive.usd_text import Prim, fixed_tuples, integers, numbers
from service.hair.groom import Groom
from service.hair.guides import resampled

MOST_POINTS = 48
"""Of a strand in the file."""
WIDTH_M = 8e-5
"""Of a hair at its root: 0.05 to 0.1 mm (Robbins 2012, "Chemical and Physical Behavior of Human Hair", table 1.1)."""
TIP = 0.3
"""Width of the tip over that of the root."""

_STAGE = '#usda 1.0\n(\n    defaultPrim = "Hair"\n    doc = "{title}"\n    metersPerUnit = 1\n    upAxis = "Y"\n)\n\n'


def curves_bytes(groom: Groom, title: str) -> bytes:
    """USD text of strands, positions to 10 micrometres.

    Args:
        groom: at least one strand.
        title: for the stage's documentation.
    """
    count = min(groom.strands.shape[1], MOST_POINTS)
    strands = resampled(groom.strands, np.ones(len(groom), np.float32), count)
    colour = groom.colour.linear(count).reshape(-1, 3)
    along = np.linspace(0, 1, count)
    width = WIDTH_M * (1 - (1 - TIP) * along**3)
    points, half = strands.reshape(-1, 3), 0.5 * WIDTH_M
    values: dict[str, str | None] = {
        "uniform token type": '"linear"',
        "uniform token wrap": '"nonperiodic"',
        "float3[] extent": f"[{fixed_tuples([points.min(0) - half, points.max(0) + half], 6)}]",
        "int[] curveVertexCounts": f"[{integers(np.full(len(groom), count))}]",
        "point3f[] points": f"[{fixed_tuples(points, 5)}]",
        "float[] widths": f"[{','.join([numbers(width, 2)] * len(groom))}]",
        "color3f[] primvars:displayColor": f"[{fixed_tuples(colour, 3)}]",
    }
    vertex = ('interpolation = "vertex"',)
    facts = {"float[] widths": vertex, "color3f[] primvars:displayColor": vertex}
    return (_STAGE.format(title=title) + Prim("BasisCurves", "Hair", values, facts).text("")).encode("ascii")
