"""Run by Blender's Python: a head from five sides under a key and a rim light, each file as Blender reads it.

    python blender_hair.py FILE OUT [SIZE SAMPLES VIEWS]

FILE is a GLB, a USD file or a kit's avatar.blend. OUT gets PNGs named front, left, three_quarter, back and top, none of
them where SAMPLES is 0; and front_depth.npy and so on, (2, SIZE, SIZE) float32 metres along the view to the nearest
card of hair and to the nearest of all else, infinite where there is none. Its cap and its single hairs are neither.
And front_rays.npy and so on, (SIZE, SIZE, 2, 3) float32 metres in glTF's frame: where the camera is, and how far along
each pixel's ray a metre of depth goes.
"""

import math
import sys
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np
from blender_stage import aimed, camera, corners, cycles, drawn, lamp, opened, seen_from, sky

VIEWS = {"front": (0, 4), "three_quarter": (38, 8), "left": (90, 4), "back": (180, 6), "top": (20, 62)}
"""Azimuth towards the subject's left and height of the camera, degrees."""
UNTOLD = ("hair_cap", "hair_edge", "lash_cards")
"""Meshes whose depth is not told: they are blended."""


def main() -> None:
    path, out = Path(sys.argv[1]), Path(sys.argv[2])
    size, samples = (int(value) for value in sys.argv[3:5]) if len(sys.argv) > 3 else (1600, 48)
    views = sys.argv[5].split(",") if len(sys.argv) > 5 else list(VIEWS)
    meshes = opened(path)
    middle = mathutils.Vector((0.0, 0.075, max(corner.z for corner in corners(meshes)) - 0.15))
    for one in list(bpy.data.objects):
        if one.type == "LIGHT":
            bpy.data.objects.remove(one)
    scene = cycles(size, size, samples, bounces=4)
    scene.render.use_persistent_data = True
    scene.render.image_settings.color_mode = "RGBA"
    sky(0.16, 0.17, 0.18)
    for azimuth, height, watts, side in ((-40, 35, 20, 0.35), (50, 5, 4, 0.8), (150, 40, 22, 0.25)):
        lamp(middle, seen_from(azimuth, height, 1.2), watts, side)
    view = camera(math.radians(17.5))
    for name in views if samples else ():
        aimed(view, middle, seen_from(*VIEWS[name], 1.3))
        drawn(out / f"{name}.png")
    told_as_depth(scene)
    for name in views:
        aimed(view, middle, seen_from(*VIEWS[name], 1.3))
        planes = []
        for cards in (True, False):
            for one in meshes:
                one.hide_render = (one.name == "hair") != cards or one.name.startswith(UNTOLD)
            drawn(out / "depth.exr")
            planes.append(depth_in(out / "depth.exr"))
        np.save(out / f"{name}_depth.npy", np.stack(planes))
        np.save(out / f"{name}_rays.npy", rays(view, size))


def told_as_depth(scene: Any) -> None:
    """Let the scene's pictures tell the distance of what is opaque, whatever its light."""
    scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.filter_width = 1, 0, 0.01
    scene.render.film_transparent = True
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    for material in bpy.data.materials:
        for shader in [node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED"]:
            links = material.node_tree.links
            for name in ("Base Color", "Specular IOR Level"):
                for link in list(shader.inputs[name].links):
                    links.remove(link)
            shader.inputs["Base Color"].default_value = (0, 0, 0, 1)
            shader.inputs["Specular IOR Level"].default_value = 0
            shader.inputs["Emission Strength"].default_value = 1
            seen = material.node_tree.nodes.new("ShaderNodeCameraData")
            links.new(seen.outputs["View Z Depth"], shader.inputs["Emission Color"])


def rays(view: Any, size: int) -> Any:
    """As of the head of this file."""
    at = math.tan(view.data.angle / 2) * (2 * (np.arange(size) + 0.5) / size - 1)
    x, y = np.meshgrid(at, -at)
    world = np.array(view.matrix_world)
    along = np.stack([x, y, np.full_like(x, -1.0)], -1) @ world[:3, :3].T
    both = np.stack([np.broadcast_to(world[:3, 3], along.shape), along], 2)
    return np.stack([both[..., 0], both[..., 2], -both[..., 1]], -1).astype(np.float32)


def depth_in(path: Path) -> Any:
    """(H, W) float32 metres that a picture tells; infinite where it is transparent."""
    picture = bpy.data.images.load(str(path))
    picture.colorspace_settings.name = "Non-Color"
    width, height = picture.size
    pixels = np.array(picture.pixels[:], np.float32).reshape(height, width, 4)[::-1]
    bpy.data.images.remove(picture)
    path.unlink()
    return np.where(pixels[..., 3] > 0.5, pixels[..., 0], np.float32(np.inf))


main()
