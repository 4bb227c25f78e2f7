"""What scripts run by Blender's Python share: reading a file, Cycles, sky, lamps and a camera."""

import math
from pathlib import Path
from typing import Any

import bpy
import mathutils


def opened(path: Path) -> list[Any]:
    """Meshes and curves that a GLB, an OBJ, a USD file or a scene of Blender's shows."""
    if path.suffix == ".blend":
        bpy.ops.wm.open_mainfile(filepath=str(path))
    else:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        read = {".glb": bpy.ops.import_scene.gltf, ".obj": bpy.ops.wm.obj_import}
        read.get(path.suffix, bpy.ops.wm.usd_import)(filepath=str(path))
    return [one for one in bpy.data.objects if one.type in ("MESH", "CURVES") and not one.hide_render]


def corners(shown: list[Any]) -> list[Any]:
    """Corners of the objects' boxes in the world."""
    return [one.matrix_world @ mathutils.Vector(corner) for one in shown for corner in one.bound_box]


def cycles(width: int, height: int, samples: int, bounces: int, seed: int = 7) -> Any:
    """The scene, set to be drawn by two threads without denoising, so that two drawings are alike."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.seed = "CPU", samples, seed
    scene.cycles.use_denoising, scene.cycles.max_bounces = False, bounces
    scene.cycles.transparent_max_bounces = 64  # as the kit's script has it
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.view_settings.view_transform = "Standard"
    return scene


def sky(red: float, green: float, blue: float) -> None:
    """Light of one colour from all sides."""
    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs[0].default_value = (red, green, blue, 1.0)
    bpy.context.scene.world = world


def aimed(one: Any, middle: Any, away: Any) -> None:
    """Put it ``away`` from the middle, towards which it looks."""
    one.location = middle + mathutils.Vector(away)
    one.rotation_euler = (middle - one.location).to_track_quat("-Z", "Y").to_euler()


def lamp(middle: Any, away: Any, watts: float, side: float) -> None:
    """A square lamp."""
    one = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "AREA"))
    one.data.energy, one.data.size = watts, side
    aimed(one, middle, away)
    bpy.context.scene.collection.objects.link(one)


def camera(angle: float) -> Any:
    """The scene's camera, new, with its vertical field of view in radians."""
    one = bpy.data.objects.new("view", bpy.data.cameras.new("view"))
    one.data.sensor_fit, one.data.angle, one.data.clip_start = "VERTICAL", angle, 0.01
    bpy.context.scene.collection.objects.link(one)
    bpy.context.scene.camera = one
    return one


def drawn(path: Path) -> None:
    """Draw the scene into a picture."""
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


def seen_from(azimuth: float, height: float, distance: float) -> Any:
    """Vector to a point at an azimuth towards the subject's left and at a height, in degrees."""
    a, h = math.radians(azimuth), math.radians(height)
    return distance * mathutils.Vector((math.sin(a) * math.cos(h), -math.cos(a) * math.cos(h), math.sin(h)))
