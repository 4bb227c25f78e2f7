"""Run by Blender's Python: pictures of the same head as Blender's own importers read it from GLB, OBJ and USD.

    python blender_look.py FOLDER OUT [SIZE SAMPLES]

FOLDER holds an unpacked archive; OUT gets glb.png, obj.png, usd.png, their linear colours as .npy and facts.json.
"""

import json
import math
import sys
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np

ENDS = ("ShaderNodeBsdfPrincipled", "ShaderNodeOutputMaterial")


def imported(path: Path) -> list[Any]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if path.suffix == ".obj":
        bpy.ops.wm.obj_import(filepath=str(path))
        own = [one for one in bpy.data.objects if one.type == "MESH"]
        parts = path.with_name("parts.obj")
        if parts.is_file():  # what stands in it in place of the head's own parts
            drawn = {one["name"] for one in json.loads((path.parents[1] / "manifest.json").read_text())["parts"]}
            for one in own:
                if one.name not in drawn:
                    bpy.data.objects.remove(one)
            bpy.ops.wm.obj_import(filepath=str(parts))
    elif path.suffix == ".glb":
        bpy.ops.import_scene.gltf(filepath=str(path))
    else:
        bpy.ops.wm.usd_import(filepath=str(path))
    return [one for one in bpy.data.objects if one.type == "MESH"]


def posed(meshes: list[Any], weights: dict[str, float]) -> None:
    for one in meshes:
        keys = one.data.shape_keys
        for block in keys.key_blocks if keys else ():
            block.value = weights.get(block.name, block.value)


def lit(size: int, samples: int, low: list[float], high: list[float]) -> None:
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.seed = "CPU", samples, 7
    scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = False, False
    scene.cycles.max_bounces = 2
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    scene.render.resolution_x, scene.render.resolution_y = size * 3 // 4, size
    scene.view_settings.view_transform = "Standard"
    scene.render.film_transparent = False
    world = bpy.data.worlds.new("sky")
    scene.world = world
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs[0].default_value = (0.35, 0.36, 0.38, 1)
    middle = mathutils.Vector([(a + b) / 2 for a, b in zip(low, high, strict=True)])
    lamp = bpy.data.objects.new("key", bpy.data.lights.new("key", "AREA"))
    lamp.data.energy, lamp.data.size = 18, 0.4
    lamp.location = middle + mathutils.Vector((-0.5, -0.8, 0.5))
    lamp.rotation_euler = (middle - lamp.location).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(lamp)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = middle + mathutils.Vector((0.0, -1.2, 0.0))
    camera.rotation_euler = (math.pi / 2, 0, 0)
    camera.data.sensor_fit, camera.data.angle = "VERTICAL", 2 * math.atan((high[2] - low[2]) * 0.6 / 1.2)
    scene.collection.objects.link(camera)
    scene.camera = camera


def facts(meshes: list[Any]) -> dict[str, Any]:
    found = {}
    for one in meshes:
        material = one.active_material
        wires = [] if material is None or not material.use_nodes else [
            f"{link.from_node.bl_idname} -> {link.to_socket.name}"
            for link in material.node_tree.links if link.to_node.bl_idname in ENDS
        ]
        missing = [] if material is None else [
            node.image.name for node in material.node_tree.nodes
            if node.bl_idname == "ShaderNodeTexImage" and node.image and not len(node.image.pixels)
        ]
        keys = one.data.shape_keys
        found[one.name] = {
            "material": None if material is None else material.name, "wires": sorted(set(wires)), "missing": missing,
            "keys": [] if keys is None else [block.name for block in keys.key_blocks][1:],
        }
    return found


def main() -> None:
    folder, out = Path(sys.argv[1]), Path(sys.argv[2])
    size, samples = (int(value) for value in sys.argv[3:5]) if len(sys.argv) > 3 else (256, 16)
    weights = json.loads((folder / "manifest.json").read_text())["fit"]["expression"]
    told: dict[str, Any] = {}
    for kind, name in (("glb", "head.glb"), ("obj", "head.obj"), ("usd", "head.usda")):
        meshes = imported(folder / "mesh" / name)
        posed(meshes, weights)
        bpy.context.view_layer.update()
        corners = np.array([one.matrix_world @ mathutils.Vector(c) for one in meshes for c in one.bound_box])
        if kind == "glb":
            told["low"], told["high"] = corners.min(0).tolist(), corners.max(0).tolist()
        lit(size, samples, told["low"], told["high"])
        told[kind] = facts(meshes)
        bpy.context.scene.render.filepath = str(out / f"{kind}.png")
        bpy.ops.render.render(write_still=True)
    (out / "facts.json").write_text(json.dumps(told, indent=1))


main()
