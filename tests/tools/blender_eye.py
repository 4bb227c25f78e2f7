"""Run by Blender's Python: an eye of a GLB, close, under a key light of half a metre, in Cycles and in EEVEE.

    python blender_eye.py HEAD.glb OUT WATTS

OUT gets CYCLES.png and EEVEE.png, 16 mm of the face wide, the right eye's centre in their middle.
"""

import math
import sys
from pathlib import Path

import bpy
import mathutils

SIZE, FIELD_M, AWAY_M = 128, 0.016, 1.0
KEY_AT, KEY_M, SKY = (-0.4, -0.8, 0.18), 0.5, (0.1, 0.1, 0.11, 1.0)


def main() -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=sys.argv[1])
    ball = next(one for one in bpy.data.objects if one.type == "MESH" and one.name.startswith("eye_right_ball"))
    corners = [ball.matrix_world @ mathutils.Vector(corner) for corner in ball.bound_box]
    eye = sum(corners, mathutils.Vector()) / 8
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = SKY
    key = bpy.data.objects.new("key", bpy.data.lights.new("key", "AREA"))
    key.data.energy, key.data.size = float(sys.argv[3]), KEY_M
    key.location = eye + mathutils.Vector(KEY_AT)
    key.rotation_euler = (eye - key.location).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(key)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = eye + mathutils.Vector((0.0, -AWAY_M, 0.0))
    camera.rotation_euler = (math.pi / 2, 0.0, 0.0)
    camera.data.angle = 2 * math.atan(FIELD_M / 2 / AWAY_M)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    scene.cycles.device, scene.cycles.samples, scene.cycles.seed = "CPU", 48, 3
    scene.cycles.use_denoising, scene.cycles.max_bounces = False, 3
    for engine in ("CYCLES", "BLENDER_EEVEE"):
        scene.render.engine = engine
        scene.render.filepath = str(Path(sys.argv[2]) / f"{engine.removeprefix('BLENDER_')}.png")
        bpy.ops.render.render(write_still=True)


main()
