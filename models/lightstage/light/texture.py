"""The baked texture of a whole chart: exposed, planned, and baked in tiles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from models.lightstage.light.bake import bake, footprint
from models.lightstage.light.expose import expose
from models.lightstage.light.geometry import Geometry
from models.lightstage.light.prior import sample_scene
from models.lightstage.light.survey import survey_chart
from models.lightstage.skin.window import ChartWindow
from service.light.plan import plan as choose

if TYPE_CHECKING:
    from models.lightstage.skin.synthesis import Skin
    from models.lightstage.stage import Stage

TILE = 1024
"""Side of a tile in texels. Tiles of any size give the same texture."""


def bake_texture(skin: Skin, stage: Stage, width: int, height: int, seed: int) -> npt.NDArray[np.uint8]:
    """(height, width, 3) uint8 sRGB texture of a whole chart under the light named ``seed``."""
    scale = skin.subject.gloss.scatter_scale
    geometry = Geometry.of(stage.head, stage.vertices(skin), device=skin.device)
    small = ChartWindow.whole(192, 128)
    maps = skin.maps(small)
    scene = expose(maps, geometry, sample_scene(seed), small)
    chosen = choose(scene, survey_chart(skin.maps, geometry, width, height))
    result = np.zeros((height, width, 3), np.uint8)
    for y in range(0, height, TILE):
        for x in range(0, width, TILE):
            tile = ChartWindow(x, y, min(TILE, width - x), min(TILE, height - y), width, height)
            outer = footprint(tile, geometry, chosen, scale)
            image = bake(skin.maps(outer), geometry, scene, chosen, tile, maps_window=outer, scatter_scale=scale)
            coded = (image * 255.0).round().byte().cpu().numpy().transpose(1, 2, 0)
            result[y : y + tile.height, x : x + tile.width] = coded
    return result
