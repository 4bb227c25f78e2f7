"""Pictures of an unpacked archive by Mitsuba 3, as read from GLB, OBJ and USD: ``python -m tests.tools.mitsuba_look
FOLDER OUT [SIZE SAMPLES]``.

Mitsuba has no loaders of materials: ``tests.tools.surfaces`` reads the files, and each material becomes ``principled``
blended by F0 with one that mirrors nothing. Light and camera are those of ``blender_look.py``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.tools.surfaces import FORMATS, Float, Surface, surfaces

LARGEST_F0 = 0.08
"""Of ``principled`` at ``specular`` 1."""
SKY = (0.35, 0.36, 0.38)
LAMP_W, LAMP_M = 18.0, 0.4
RADIANCE = LAMP_W / (4 * LAMP_M**2)
"""Of Blender's area lamps, W/(m^2 sr)."""


def bounds(all_of_them: list[Surface]) -> Float:
    """(2, 3) lowest and highest coordinates."""
    both = np.concatenate([one.points for one in all_of_them])
    return np.stack([both.min(0), both.max(0)])


def draw(all_of_them: list[Surface], box: Float, size: int, samples: int) -> Float:
    """(size, size * 3 // 4, 3) linear light.

    Args:
        all_of_them: what is drawn.
        box: (2, 3) in the middle of which the camera looks.
        size: height, pixels.
        samples: per pixel.
    """
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    middle = box.mean(0)
    to = mi.ScalarTransform4f
    eye = (middle + np.array([0, 0, 1.2])).tolist()
    lamp = (middle + np.array([-0.5, 0.5, 0.8])).tolist()
    half = LAMP_M / 2
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": list(SKY)}},
        "lamp": {
            "type": "rectangle",
            "to_world": to().look_at(origin=lamp, target=middle.tolist(), up=[0, 1, 0]) @ to().scale([half, half, 1]),
            "light": {"type": "area", "radiance": {"type": "rgb", "value": [RADIANCE] * 3}},
        },
        "camera": {
            "type": "perspective", "fov_axis": "y",
            "fov": float(np.degrees(2 * np.arctan((box[1, 1] - box[0, 1]) * 0.6 / 1.2))),
            "to_world": to().look_at(origin=eye, target=middle.tolist(), up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size * 3 // 4, "height": size, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": samples, "seed": 7},
        },
    }  # fmt: skip
    for one in all_of_them:
        scene[one.name] = _mesh(mi, one)
    return np.asarray(mi.render(mi.load_dict(scene)), np.float64)[..., :3]


def _mesh(mi: Any, one: Surface) -> Any:
    kept = mi.Properties()
    kept["bsdf"] = mi.load_dict(_bsdf(mi, one))
    counts = len(one.points), len(one.triangles)
    mesh = mi.Mesh(one.name, *counts, has_vertex_normals=True, has_vertex_texcoords=True, props=kept)
    fields = mi.traverse(mesh)
    fields["vertex_positions"] = one.points.astype(np.float32).ravel()
    fields["vertex_normals"] = one.normals.astype(np.float32).ravel()
    fields["vertex_texcoords"] = one.uv.astype(np.float32).ravel()
    fields["faces"] = one.triangles.astype(np.uint32).ravel()
    fields.update()
    return mesh


def _bsdf(mi: Any, one: Surface) -> dict[str, Any]:
    def image(values: Float) -> dict[str, Any]:
        """Row 0 of Mitsuba's images is v = 0."""
        bitmap = mi.Bitmap(np.ascontiguousarray(np.atleast_3d(values)[::-1], np.float32))
        return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}

    base, rough = np.clip(one.colour, 0, 1), np.clip(one.roughness, 0.02, 1)
    matt, glossy = (
        {"type": "principled", "base_color": image(base), "roughness": image(rough), "specular": level}
        for level in (1e-3, 1.0)
    )
    made: dict[str, Any] = {
        "type": "blendbsdf", "weight": image(np.clip(one.f0 / LARGEST_F0, 0, 1)), "matt": matt, "glossy": glossy,
    }  # fmt: skip
    if one.normal is not None:
        made = {"type": "normalmap", "normalmap": image(0.5 + 0.5 * one.normal), "bsdf": made}
    made = {"type": "twosided", "bsdf": made}
    if one.opacity.min() < 1:
        made = {"type": "mask", "opacity": image(np.clip(one.opacity, 0, 1)), "bsdf": made}
    return made


def shown(light: Float) -> Float:
    """Linear light as sRGB codes in [0, 255]."""
    value = np.clip(light, 0, 1)
    return np.asarray(255 * np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055))


def main() -> None:
    folder, out = Path(sys.argv[1]), Path(sys.argv[2])
    size, samples = (int(value) for value in sys.argv[3:5]) if len(sys.argv) > 3 else (256, 32)
    read = {kind: surfaces(folder, kind) for kind in FORMATS}
    box = bounds(read["glb"])
    drawn = {kind: shown(draw(one, box, size, samples)) for kind, one in read.items()}
    for kind, one in drawn.items():
        cv2.imwrite(str(out / f"{kind}.png"), np.rint(one).astype(np.uint8)[..., ::-1])
        sys.stdout.write(f"glb and {kind}: {np.abs(one - drawn['glb']).mean():.2f} of 255\n")


if __name__ == "__main__":
    main()
