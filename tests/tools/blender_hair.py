"""Run by Blender's Python: a head from five sides under a key and a rim light, each file as Blender reads it.

    python blender_hair.py FILE OUT [SIZE SAMPLES VIEWS]

FILE is a GLB, a USD file or a kit's avatar.blend. OUT gets PNGs named front, left, three_quarter, back and top, and of
each one named front_hair and so on, whose alpha is the share of a pixel in which the camera sees hair.
"""

import math
import sys
from pathlib import Path

import bpy
import mathutils
from blender_stage import aimed, camera, corners, cycles, drawn, lamp, opened, seen_from, sky

VIEWS = {"front": (0, 4), "three_quarter": (38, 8), "left": (90, 4), "back": (180, 6), "top": (20, 62)}
"""Azimuth towards the subject's left and height of the camera, degrees."""


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
    scene.cycles.transparent_max_bounces = 48
    scene.render.use_persistent_data = True
    scene.render.image_settings.color_mode = "RGBA"
    sky(0.16, 0.17, 0.18)
    for azimuth, height, watts, side in ((-40, 35, 20, 0.35), (50, 5, 4, 0.8), (150, 40, 22, 0.25)):
        lamp(middle, seen_from(azimuth, height, 1.2), watts, side)
    view = camera(math.radians(17.5))
    for name in views:
        aimed(view, middle, seen_from(*VIEWS[name], 1.3))
        for ending in ("", "_hair"):
            for one in meshes:
                one.is_holdout = bool(ending) and not one.name.startswith("hair")
            scene.render.film_transparent = bool(ending)
            scene.cycles.samples = max(samples // 4, 4) if ending else samples
            drawn(out / f"{name}{ending}.png")


main()
