"""One capture of the light stage as training data: the whole chart small in many lights, and windows in full size."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from models.colour import srgb
from models.lightstage.light.bake import bake
from models.lightstage.light.expose import expose
from models.lightstage.light.geometry import Geometry
from models.lightstage.light.prior import sample_hard_scene, sample_scene
from models.lightstage.light.sclera import Whites
from models.lightstage.light.survey import survey
from models.lightstage.skin.streams import Stream
from models.lightstage.skin.synthesis import Skin, SkinMaps
from models.lightstage.skin.window import CHART_WIDTH, ChartWindow
from models.lightstage.split import light_part
from models.lightstage.stage import Stage
from service.geometry.chart import Chart
from service.light.environment import illumination, names
from service.light.plan import plan as choose
from service.light.scene import Scene
from service.reflectance.subject import GEOMETRY_SIZE, drawn_geometry

WHOLE = (288, 192)
LIGHTS = 6
SMALL = ChartWindow.whole(192, 128)
MARGIN = 1
"""Cells of geometry around a window, for bilinear enlargement."""

Arrays = dict[str, npt.NDArray[np.generic]]


@dataclass(frozen=True)
class Recipe:
    """How much is drawn of each capture.

    Attributes:
        lights: scenes the whole chart is baked under; every other one is hard light. 0 for no whole chart.
        patch: side of a window.
        block: patches along each side of the block that is drawn at full resolution at once; 0 for none.
        lit: patches of the block that are baked, each under a scene of its own; those of its lower row in hard light.
            With 0 the patch at low resolution is not baked either.
        draft_width: chart width of the extra patch at low resolution, whose scale draft quality works at; 0 for none.
    """

    lights: int = LIGHTS
    patch: int = 512
    block: int = 2
    lit: int = 2
    draft_width: int = 1536


@dataclass(frozen=True)
class Studio:
    """The light stage, and the chart that the geometry channels are drawn on, set up once for all sittings."""

    stage: Stage
    chart: Chart

    @classmethod
    @lru_cache(maxsize=1)
    def open(cls) -> Studio:
        """Takes some seconds, once a process."""
        stage = Stage.open()
        return cls(stage, Chart.build(stage.head, *GEOMETRY_SIZE))


@dataclass(frozen=True)
class Sitting:
    """One subject in one expression, ready to be drawn and lit."""

    seed: int
    pose: str
    part: str
    skin: Skin
    geometry: Geometry
    small: SkinMaps
    channels: npt.NDArray[np.float32]
    whites: Whites

    @classmethod
    def of(cls, studio: Studio, seed: int, pose: str, part: str, device: torch.device | str = "cpu") -> Sitting:
        """Set up; several seconds on a CPU core."""
        stage = studio.stage
        skin = stage.skin(seed, pose, device)
        vertices = stage.vertices(skin)
        geometry = Geometry.of(stage.head, vertices, directions=160, device=device)
        channels = drawn_geometry(studio.chart, vertices)
        whites = Whites.of(stage.head, vertices)
        return cls(seed, pose, part, skin, geometry, skin.maps(SMALL), channels, whites)

    def scene(self, number: int, hard: bool = False) -> Scene:
        """The ``number``-th scene of this sitting that belongs to its part of the split, exposed.

        With ``hard`` it is lit by one small lamp (:func:`~models.lightstage.light.prior.sample_hard_scene`).
        """
        found, candidate = -1, 0
        while True:
            seed = (self.seed * 8191 + candidate) * 31 + sum(self.pose.encode()) % 31
            scene = (sample_hard_scene if hard else sample_scene)(seed)
            name = scene.environment.name if scene.environment.name in names() else f"procedural-{seed}"
            found += light_part(str(name)) == self.part
            if found == number:
                return expose(self.small, self.geometry, scene, SMALL)
            candidate += 1

    def baked(self, maps: SkinMaps, window: ChartWindow, scene: Scene) -> Tensor:
        """(3, h, w) sRGB-coded texture of a window; light from beyond the window is that of its border."""
        # Planned at the size that is baked: a small copy of the skin has no relief to cast shadows.
        plan = choose(scene, survey(maps, self.geometry, window))
        scale = self.skin.subject.gloss.scatter_scale
        return bake(maps, self.geometry, scene, plan, window, scatter_scale=scale)


def capture(sitting: Sitting, recipe: Recipe | None = None) -> Arrays:
    """Typed arrays of one capture; keys ``whole_*`` and ``patch<i>_*``."""
    recipe = recipe or Recipe()
    result = _lit_chart(sitting, recipe.lights) if recipe.lights else {}
    patches = [*_block(sitting, recipe), *_draft(sitting, recipe)]
    for i, patch in enumerate(patches):
        result.update({f"patch{i}_{name}": values for name, values in patch.items()})
    result["patches"] = np.array(len(patches))
    return result


def _lit_chart(sitting: Sitting, lights: int) -> Arrays:
    """The whole chart in some lights."""
    window = ChartWindow.whole(*WHOLE)
    maps = sitting.skin.maps(window)
    scenes = [sitting.scene(i, hard=i % 2 == 1) for i in range(lights)]
    lit = torch.stack([sitting.baked(maps, window, scene) for scene in scenes])
    return {
        "whole_albedo": _byte(srgb(maps.diffuse_albedo)),
        "whole_texture": _byte(lit),
        "whole_geometry": _whole(sitting.channels),
        "whole_whites": np.stack([sitting.whites.beside_lids(illumination(scene)) for scene in scenes]),
    }


def _block(sitting: Sitting, recipe: Recipe) -> list[Arrays]:
    """Patches of one block somewhere on the face."""
    if not recipe.block:
        return []
    side = recipe.patch * recipe.block
    window = _somewhere(sitting, side, CHART_WIDTH)
    maps = sitting.skin.maps(window)
    result = []
    for i in range(recipe.block**2):
        row, column = divmod(i, recipe.block)
        x, y = window.x + column * recipe.patch, window.y + row * recipe.patch
        inner = ChartWindow(x, y, recipe.patch, recipe.patch, window.chart_width, window.chart_height)
        cut = SkinMaps(*(inner.cut(getattr(maps, f), window) for f in SkinMaps.__dataclass_fields__))
        lit = i % 2 < recipe.lit / 2
        result.append(_patch(sitting, cut, inner, sitting.scene(100 + i, hard=row % 2 == 1) if lit else None))
    return result


def _draft(sitting: Sitting, recipe: Recipe) -> list[Arrays]:
    if not recipe.draft_width:
        return []
    window = _somewhere(sitting, recipe.patch, recipe.draft_width)
    return [_patch(sitting, sitting.skin.maps(window), window, sitting.scene(200) if recipe.lit else None)]


def _somewhere(sitting: Sitting, side: int, width: int) -> ChartWindow:
    """A window round a random texel, four in five times of the face."""
    stream = Stream(sitting.seed, f"place {sitting.pose} {width}")
    height = width * 2 // 3
    face = sitting.geometry.face[0].cpu().numpy() > 0.5
    skin = sitting.geometry.mask[0].cpu().numpy() > 0.5
    chosen = np.argwhere(face if stream.chance(0.8) and face.any() else skin)
    row, column = chosen[min(int(stream.one() * len(chosen)), len(chosen) - 1)]
    x = int((column + 0.5) / face.shape[1] * width) - side // 2
    y = int((row + 0.5) / face.shape[0] * height) - side // 2
    x, y = min(max(x, 0), width - side), min(max(y, 0), height - side)
    return ChartWindow(x // 8 * 8, y // 8 * 8, side, side, width, height)


def _patch(sitting: Sitting, maps: SkinMaps, window: ChartWindow, scene: Scene | None) -> Arrays:
    """One window: maps, the geometry around it, and its texture under a scene if it has one."""
    patch: Arrays = {
        "albedo": _byte(srgb(maps.diffuse_albedo)),
        "specular": _byte(maps.specular_albedo),
        "specular_normal": _slanted(maps.specular_normal),
        "diffuse_normal": _slanted(maps.diffuse_normal),
        "mask": _byte(maps.mask),
        "hair": _byte(maps.regions[1:2]),
        "geometry": _around(sitting.channels, window),
        "window": np.array([window.x, window.y, window.width, window.height, window.chart_width]),
    }
    if scene is not None:
        patch["texture"] = _byte(sitting.baked(maps, window, scene))
    return patch


def _around(channels: npt.NDArray[np.float32], window: ChartWindow) -> npt.NDArray[np.generic]:
    """Geometry cells under a window with ``MARGIN`` cells more on each side, float16."""
    scale = window.chart_width // GEOMETRY_SIZE[0]
    padded = np.pad(channels, ((0, 0), (MARGIN, MARGIN), (MARGIN, MARGIN)), mode="edge")
    row, column = window.y // scale, window.x // scale
    rows, columns = window.height // scale + 2 * MARGIN, window.width // scale + 2 * MARGIN
    return padded[:, row : row + rows, column : column + columns].astype(np.float16)


def _whole(channels: npt.NDArray[np.float32]) -> npt.NDArray[np.generic]:
    """Geometry channels at the size of the whole chart, by area, float16."""
    small = [cv2.resize(channel, WHOLE, interpolation=cv2.INTER_AREA) for channel in channels]
    return np.stack(small).astype(np.float16)


def _byte(values: Tensor) -> npt.NDArray[np.generic]:
    return (values.float().clamp(0.0, 1.0) * 255.0).round().byte().cpu().numpy()


def _slanted(normal: Tensor) -> npt.NDArray[np.generic]:
    """X and y of unit normals as int16 of 1/32767."""
    return (normal[:2].float().clamp(-1.0, 1.0) * 32767.0).round().short().cpu().numpy()
