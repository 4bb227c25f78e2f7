"""Run by Blender's Python: a head from five sides under a key and a rim light, each file as Blender reads it.

    python blender_hair.py FILE OUT [SIZE SAMPLES VIEWS]

FILE is a GLB, a USD file or a kit's avatar.blend. OUT gets PNGs named front, left, three_quarter, back and top, and of
each one named front_hair and so on, whose alpha is the share of a pixel in which the camera sees hair.
"""

import math
import sys
from pathlib import Path
from typing import Any

import bpy
import mathutils

VIEWS = {"front": (0, 4), "three_quarter": (38, 8), "left": (90, 4), "back": (180, 6), "top": (20, 62)}
"""Azimuth towards the subject's left and height of the camera, degrees."""


def opened(path: Path) -> list[Any]:
    if path.suffix == ".blend":
        bpy.ops.wm.open_mainfile(filepath=str(path))
    else:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        (bpy.ops.import_scene.gltf if path.suffix == ".glb" else bpy.ops.wm.usd_import)(filepath=str(path))
    return [one for one in bpy.data.objects if one.type in ("MESH", "CURVES") and not one.hide_render]


def toward(azimuth: float, height: float, distance: float) -> Any:
    a, h = math.radians(azimuth), math.radians(height)
    return distance * mathutils.Vector((math.sin(a) * math.cos(h), -math.cos(a) * math.cos(h), math.sin(h)))


def lamp(name: str, middle: Any, azimuth: float, height: float, watts: float, side: float) -> None:
    one = bpy.data.objects.new(name, bpy.data.lights.new(name, "AREA"))
    one.data.energy, one.data.size = watts, side
    one.location = middle + toward(azimuth, height, 1.2)
    one.rotation_euler = (middle - one.location).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(one)


def main() -> None:
    path, out = Path(sys.argv[1]), Path(sys.argv[2])
    size, samples = (int(value) for value in sys.argv[3:5]) if len(sys.argv) > 3 else (1600, 48)
    views = sys.argv[5].split(",") if len(sys.argv) > 5 else list(VIEWS)
    meshes = opened(path)
    corners = [one.matrix_world @ mathutils.Vector(corner) for one in meshes for corner in one.bound_box]
    top = max(corner.z for corner in corners)
    middle = mathutils.Vector((0.0, 0.075, top - 0.15))
    scene = bpy.context.scene
    for one in list(bpy.data.objects):
        if one.type == "LIGHT":
            bpy.data.objects.remove(one)
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.seed = "CPU", samples, 7
    scene.cycles.use_denoising, scene.cycles.max_bounces = False, 4
    scene.cycles.transparent_max_bounces = 48
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.use_persistent_data = True
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.color_mode = "RGBA"
    world = bpy.data.worlds.new("sky")
    scene.world = world
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs[0].default_value = (0.16, 0.17, 0.18, 1)
    lamp("key", middle, -40, 35, 20, 0.35)
    lamp("fill", middle, 50, 5, 4, 0.8)
    lamp("rim", middle, 150, 40, 22, 0.25)
    camera = bpy.data.objects.new("side", bpy.data.cameras.new("side"))
    camera.data.angle, camera.data.clip_start = math.radians(17.5), 0.01
    scene.collection.objects.link(camera)
    scene.camera = camera
    for name in views:
        camera.location = middle + toward(*VIEWS[name], 1.3)
        camera.rotation_euler = (middle - camera.location).to_track_quat("-Z", "Y").to_euler()
        for ending in ("", "_hair"):
            for one in meshes:
                one.is_holdout = bool(ending) and not one.name.startswith("hair")
            scene.render.film_transparent = bool(ending)
            scene.cycles.samples = max(samples // 4, 4) if ending else samples
            scene.render.filepath = str(out / f"{name}{ending}.png")
            bpy.ops.render.render(write_still=True)


main()
