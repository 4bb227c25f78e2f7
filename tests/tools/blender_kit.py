"""Run by Blender's Python: opens a kit's avatar.blend, poses it by its properties, and tells what moved.

    python blender_kit.py AVATAR.blend OUT [SIZE SAMPLES]

OUT gets facts.json and, where SIZE is given, one PNG per pose.
"""

import json
import math
import sys
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np
from blender_stage import aimed, camera, cycles, drawn, opened, seen_from

POSES: dict[str, dict[str, float]] = {
    "neutral": {},
    "blink": {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0},
    "smile": {"mouthSmileLeft": 0.9, "mouthSmileRight": 0.9, "cheekSquintLeft": 0.5, "cheekSquintRight": 0.5},
    "jawOpen": {"jawOpen": 1.0},
    "tongueOut": {"tongueOut": 1.0},
    "photo": {"photo": 1.0},
    "profile": {},
    "back": {},
}
YAWS = {"profile": 90.0, "back": 180.0}


def points(mesh: Any) -> np.ndarray:
    """Vertices as evaluated, before subdivision, in the world."""
    shown = [(one, one.show_viewport) for one in mesh.modifiers if one.type == "SUBSURF"]
    for one, _ in shown:
        one.show_viewport = False
    evaluated = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
    flat = np.zeros(3 * len(evaluated.data.vertices))
    evaluated.data.vertices.foreach_get("co", flat)
    for one, was in shown:
        one.show_viewport = was
    world = np.array(mesh.matrix_world)
    return np.asarray(flat.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3])


def units_of(armature: Any) -> list[str]:
    """Names of the properties that drive it; an object of Blender has keys, but cannot be iterated."""
    return [name for name, value in armature.items() if isinstance(value, float)]


def posed(armature: Any, weights: dict[str, float]) -> None:
    for unit in units_of(armature):
        armature[unit] = float(weights.get(unit, 0.0))
    armature.update_tag()
    bpy.context.view_layer.update()


def border_mm() -> float | None:
    """Largest distance of the skin's open border, subdivided twice, from what it was before; None without a border."""
    skin = bpy.data.objects["skin"]
    smooth = next(one for one in skin.modifiers if one.type == "SUBSURF")
    was, smooth.levels = smooth.levels, 2

    def border() -> tuple[np.ndarray, np.ndarray]:
        mesh = skin.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        sides = np.bincount([loop.edge_index for loop in mesh.loops], minlength=len(mesh.edges))
        edges = np.array([edge.vertices[:] for edge in mesh.edges])[sides == 1]
        return np.array([point.co[:] for point in mesh.vertices]), edges

    fine, own = border()
    smooth.show_viewport = False
    coarse, edges = border()
    smooth.show_viewport, smooth.levels = True, was
    if not len(edges):
        return None
    points, (a, b) = fine[np.unique(own)], (coarse[edges[:, k]] for k in (0, 1))
    along = np.einsum("pei,ei->pe", points[:, None] - a, b - a) / np.maximum(np.square(b - a).sum(1), 1e-18)
    nearest = a + np.clip(along, 0, 1)[..., None] * (b - a)
    return float(1e3 * np.linalg.norm(points[:, None] - nearest, axis=2).min(1).max())


def folds() -> dict[str, float]:
    """Strength of each map of wrinkles on the skin."""
    skin = bpy.data.materials["skin"].evaluated_get(bpy.context.evaluated_depsgraph_get())
    values = [one for one in skin.node_tree.nodes if one.bl_idname == "ShaderNodeValue"]
    return {one.label: float(one.outputs[0].default_value) for one in values if one.label.startswith("wrinkle")}


def main() -> None:
    out = Path(sys.argv[2])
    meshes = {one.name: one for one in opened(Path(sys.argv[1])) if one.type == "MESH"}
    armature = bpy.data.objects["avatar"]
    posed(armature, {})
    still = {name: points(mesh) for name, mesh in meshes.items()}
    both = np.concatenate(list(still.values()))
    low, high = both.min(0), both.max(0)
    photo = bpy.context.scene.camera
    told: dict[str, Any] = {
        "units": len(units_of(armature)),
        "bones": sorted(bone.name for bone in armature.data.bones),
        "drivers": {name: len(mesh.data.shape_keys.animation_data.drivers) for name, mesh in meshes.items()
                    if mesh.data.shape_keys},
        "missing": [one.name for one in bpy.data.images
                    if one.source == "FILE" and not Path(bpy.path.abspath(one.filepath)).is_file()],
        "displaced": [one.name for one in bpy.data.materials if one.use_nodes and any(
            link.to_socket.name == "Displacement" for link in one.node_tree.links)],
        "subdivided": [name for name, mesh in meshes.items() if any(m.type == "SUBSURF" for m in mesh.modifiers)],
        "moved_mm": {}, "border_mm": border_mm(), "folds": {},
        "cards_deep": bpy.context.scene.cycles.transparent_max_bounces,
        "camera": None if photo is None else {"lens": photo.data.lens},
    }
    if len(sys.argv) > 3:
        size, samples = (int(value) for value in sys.argv[3:5])
        scene = cycles(size * 3 // 4, size, samples, bounces=3)
        scene.cycles.use_denoising = True
        scene.render.use_persistent_data = True
        view = camera(2 * math.atan(float(high[2] - low[2]) * 0.58 / 1.3))
    poses = sys.argv[5].split(",") if len(sys.argv) > 5 else list(POSES)
    for pose in poses:
        posed(armature, POSES[pose])
        now = {name: points(mesh) for name, mesh in meshes.items()}
        told["moved_mm"][pose] = {name: float(np.abs(now[name] - still[name]).max() * 1e3) for name in meshes}
        told["folds"][pose] = folds()
        if pose == "photo":
            np.savez(out / "photo.npz", allow_pickle=False, **now)
        if len(sys.argv) > 3:
            aimed(view, mathutils.Vector((low + high) / 2), seen_from(YAWS.get(pose, 0.0), 0.0, 1.3))
            drawn(out / f"{pose}.png")
    (out / "facts.json").write_text(json.dumps(told, indent=1))


main()
