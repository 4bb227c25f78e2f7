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
from blender_stage import aimed, camera, corners, cycles, drawn, lamp, opened, sky

ENDS = ("ShaderNodeBsdfPrincipled", "ShaderNodeOutputMaterial")


def imported(path: Path) -> list[Any]:
    """The head's meshes; an OBJ's with those that stand in a file of their own in place of the head's parts."""
    own: list[Any] = opened(path)
    parts = path.with_name("parts.obj")
    if path.suffix != ".obj" or not parts.is_file():
        return own
    drawn = {one["name"] for one in json.loads((path.parents[1] / "manifest.json").read_text())["parts"]}
    for one in own:
        if one.name not in drawn:
            bpy.data.objects.remove(one)
    bpy.ops.wm.obj_import(filepath=str(parts))
    return list(bpy.data.objects)


def posed(meshes: list[Any], weights: dict[str, float]) -> None:
    for one in meshes:
        keys = one.data.shape_keys
        for block in keys.key_blocks if keys else ():
            block.value = weights.get(block.name, block.value)


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
        if kind == "glb":
            box = np.array(corners(meshes))
            told["low"], told["high"] = box.min(0).tolist(), box.max(0).tolist()
            middle, tall = mathutils.Vector((box.min(0) + box.max(0)) / 2), float(np.ptp(box[:, 2]))
        cycles(size * 3 // 4, size, samples, bounces=2).cycles.use_adaptive_sampling = False
        sky(0.35, 0.36, 0.38)
        lamp(middle, (-0.5, -0.8, 0.5), watts=18, side=0.4)
        aimed(camera(2 * math.atan(tall * 0.6 / 1.2)), middle, (0.0, -1.2, 0.0))
        told[kind] = facts(meshes)
        drawn(out / f"{kind}.png")
    (out / "facts.json").write_text(json.dumps(told, indent=1))


main()
