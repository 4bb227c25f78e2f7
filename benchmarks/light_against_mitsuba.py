"""The light against a reference renderer: ``python -m benchmarks.light_against_mitsuba [--size N] [--samples N]``.

The neutral head with an even skin (Lambert and one GGX lobe, shadows on, no scattering) is rendered by Mitsuba 3 under
an environment, three lamps, and both; our texture is read where each pixel's surface point lies on the chart. Mitsuba
draws the diffuse and the mirror-like part apart (``diffuse`` and ``roughconductor`` with a real index of 1.4, whose
Fresnel term is the exact one); the diffuse part is then lessened by what the mirror takes, as our model says.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from benchmarks.pictures import Difference, draw, table
from models.lightstage.light.bake import radiance
from models.lightstage.light.expose import expose
from models.lightstage.light.geometry import Geometry
from models.lightstage.light.lobes import directional_albedo
from models.lightstage.light.plain import PlainSkin
from models.lightstage.light.response import developed
from models.lightstage.skin.window import ChartWindow
from service.geometry.mesh import vertex_normals
from service.head.files import load_head
from service.head.model import HeadModel
from service.light.environment import radiance as environment_radiance
from service.light.plan import LightPlan
from service.light.scene import Environment, PointLight, Response, Scene

Float = npt.NDArray[np.float64]

ALPHA = 0.3
INDEX = 1.4
ALBEDO = (0.6, 0.4, 0.3)
FOV_DEG = 13.0
LAMPS = (
    PointLight((0.45, 0.35, 0.8), (2.0, 1.8, 1.6)),
    PointLight((-0.7, 0.1, 0.9), (1.0, 1.1, 1.3), 0.08),
    PointLight((0.1, 0.6, 1.4), (1.2, 1.2, 1.2)),
)


def scenes(environment: str) -> dict[str, Scene]:
    """The three scenes by name."""
    sky = Environment(name=environment, rotation_deg=40.0, strength=0.8)
    response = Response(target=0.8)
    return {
        "environment": Scene(sky, (), response=response),
        "3 lamps": Scene(Environment(), LAMPS, response=response),
        "both": Scene(sky, LAMPS, response=response),
    }


def chart_mesh(head: HeadModel) -> tuple[Float, Float, npt.NDArray[np.int64]]:
    """Positions and normals of the chart's vertices, and triangles into them, of skin and eyeballs."""
    vertex = np.zeros(len(head.uv), np.int64)
    vertex[head.triangle_uv.ravel()] = head.triangles.ravel()
    parts = [i for i, name in enumerate(head.part_names) if name in ("skin", "eye_left", "eye_right")]
    triangles = head.triangle_uv[np.isin(head.triangle_part, parts)].astype(np.int64)
    normals = vertex_normals(head.mean, head.triangles)
    return head.mean[vertex].astype(np.float64), normals[vertex], triangles


class Reference:
    """Mitsuba with our head; ``linear`` renders, ``surface`` tells what each pixel shows."""

    def __init__(self, head: HeadModel, size: int, folder: Path) -> None:
        import mitsuba

        mitsuba.set_variant("scalar_rgb")
        self.mi: Any = mitsuba
        self.size = size
        positions, normals, triangles = chart_mesh(head)
        counts = (len(positions), len(triangles))
        mesh = mitsuba.Mesh("head", *counts, has_vertex_normals=True, has_vertex_texcoords=True)
        fields = mitsuba.traverse(mesh)
        fields["vertex_positions"] = positions.astype(np.float32).ravel()
        fields["vertex_normals"] = normals.astype(np.float32).ravel()
        fields["vertex_texcoords"] = head.uv.astype(np.float32).ravel()
        fields["faces"] = triangles.astype(np.uint32).ravel()
        fields.update()
        self.file = str(folder / "head.ply")
        mesh.write_ply(self.file)

    def _scene(self, bsdf: dict[str, Any], emitters: dict[str, Any], integrator: dict[str, Any], samples: int) -> Any:
        transform = self.mi.ScalarTransform4f
        look = transform().look_at(origin=[0.0, -0.03, 1.2], target=[0.0, -0.03, 0.0], up=[0.0, 1.0, 0.0])
        film = {"type": "hdrfilm", "width": self.size, "height": self.size, "pixel_format": "rgb"}
        film["rfilter"] = {"type": "box"}
        sensor = {
            "type": "perspective", "fov": FOV_DEG, "to_world": look, "film": film,
            "sampler": {"type": "independent", "sample_count": samples},
        }  # fmt: skip
        shape = {"type": "ply", "filename": self.file, "bsdf": bsdf}
        whole = {"type": "scene", "integrator": integrator, "sensor": sensor, "head": shape, **emitters}
        return self.mi.load_dict(whole)

    def _emitters(self, scene: Scene) -> dict[str, Any]:
        out: dict[str, Any] = {}
        sky = environment_radiance(scene.environment)
        if sky.any():
            # Mitsuba's panoramas run the other way around.
            bitmap = self.mi.Bitmap(np.ascontiguousarray(sky[:, ::-1], np.float32))
            out["sky"] = {"type": "envmap", "bitmap": bitmap}
        for i, light in enumerate(scene.lights):
            if light.radius_m > 0.0:
                glow = [c / (np.pi * light.radius_m**2) for c in light.intensity]
                emitter = {"type": "area", "radiance": {"type": "rgb", "value": glow}}
                ball = {"type": "sphere", "center": list(light.position_m), "radius": light.radius_m}
                out[f"light{i}"] = {**ball, "emitter": emitter}
            else:
                intensity = {"type": "rgb", "value": list(light.intensity)}
                out[f"light{i}"] = {"type": "point", "position": list(light.position_m), "intensity": intensity}
        return out

    def linear(self, scene: Scene, bsdf: dict[str, Any], samples: int, seed: int) -> Float:
        """(size, size, 3) linear radiance, direct light only; light by light, so that none steals another's samples."""
        total = np.zeros((self.size, self.size, 3))
        for name, emitter in self._emitters(scene).items():
            # A point has no noise but that of the pixel's own area.
            kind = emitter["type"]
            integrator = {"type": "direct", "hide_emitters": True, "emitter_samples": 4, "bsdf_samples": 4}
            if kind == "point":
                integrator |= {"emitter_samples": 1, "bsdf_samples": 0}
            count = {"point": 32, "sphere": 32}.get(kind, samples)
            made = self._scene(bsdf, {name: emitter}, integrator, count)
            total += np.asarray(self.mi.render(made, seed=seed), np.float64)[..., :3]
        return total

    def surface(self, samples: int = 64) -> tuple[Float, Float, Float]:
        """Chart coordinates (size, size, 2), normals and positions (size, size, 3) of what pixels show."""
        integrator = {"type": "aov", "aovs": "uv:uv,n:sh_normal,p:position"}
        made = self._scene({"type": "diffuse"}, {}, integrator, samples)
        image = np.asarray(self.mi.render(made, seed=1), np.float64)[..., -8:]
        return image[..., :2], image[..., 2:5], image[..., 5:8]


def read(texture: Float, uv: Float) -> Float:
    """(..., C) bilinear values of a chart image (H, W, C) at uv."""
    height, width = texture.shape[:2]
    x = np.clip(uv[..., 0] * width - 0.5, 0, width - 1.001)
    y = np.clip((1.0 - uv[..., 1]) * height - 0.5, 0, height - 1.001)
    c, r = x.astype(int), y.astype(int)
    fx, fy = (x - c)[..., None], (y - r)[..., None]
    top = texture[r, c] * (1 - fx) + texture[r, c + 1] * fx
    low = texture[r + 1, c] * (1 - fx) + texture[r + 1, c + 1] * fx
    return np.asarray(top * (1 - fy) + low * fy)


def compare(size: int, samples: int, environment: str, chart: tuple[int, int] = (768, 512)) -> dict[str, Difference]:
    """Render all scenes both ways."""
    head = load_head()
    window = ChartWindow.whole(*chart)
    geometry = Geometry.of(head, head.mean, size=chart, sky_size=(384, 256), casters_mm=(0.9, 1.2))
    f0 = ((INDEX - 1.0) / (INDEX + 1.0)) ** 2
    skin = PlainSkin.even(window, ALBEDO, f0 / 0.04, (ALPHA, ALPHA))
    with tempfile.TemporaryDirectory() as folder:
        reference = Reference(head, size, Path(folder))
        uv, normal, position = reference.surface()
        covered = np.linalg.norm(normal, axis=-1) > 0.97
        face_map = geometry.face.permute(1, 2, 0).numpy().astype(np.float64)
        mask = covered & (read(face_map, uv)[..., 0] > 0.5)
        view = np.array([0.0, -0.03, 1.2]) - position
        cosine = (normal * view).sum(-1) / np.maximum(np.linalg.norm(view, axis=-1), 1e-9)
        n_v = torch.from_numpy(np.clip(cosine, 1e-3, 1.0)).float()
        kept = 1.0 - directional_albedo(torch.full_like(n_v, f0), torch.full_like(n_v, ALPHA), n_v).numpy()
        diffuse = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(ALBEDO)}}
        mirror = {"type": "roughconductor", "distribution": "ggx", "alpha": ALPHA, "eta": INDEX, "k": 0.0}
        drawn: dict[str, Float] = {}
        for name, plain in list(scenes(environment).items())[:2]:
            drawn[name] = reference.linear(plain, diffuse, samples, 1) * kept[..., None]
            drawn[name] = drawn[name] + reference.linear(plain, mirror, samples, 2)
    drawn["both"] = drawn["environment"] + drawn["3 lamps"]  # light adds up
    results = {}
    for name, plain in scenes(environment).items():
        scene = dataclasses.replace(plain, viewpoints=((0.0, -0.03, 1.2),))
        scene = expose(skin, geometry, scene, window)
        chosen = LightPlan.everything(scene).without("scattering")
        ours = radiance(skin, geometry, scene, chosen, window)[0][0].permute(1, 2, 0).numpy().astype(np.float64)
        results[name] = Difference.of(_coded(read(ours, uv), scene), _coded(drawn[name], scene), mask)
    return results


def _coded(linear: Float, scene: Scene) -> Float:
    light = torch.from_numpy(np.ascontiguousarray(linear.transpose(2, 0, 1))).float()
    return np.asarray(developed(light, scene.response).permute(1, 2, 0).numpy(), np.float64)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.light_against_mitsuba", description=__doc__)
    parser.add_argument("--size", type=int, default=160, help="pixels of the square render")
    parser.add_argument("--samples", type=int, default=256, help="samples per pixel of the reference")
    parser.add_argument("--environment", default="apartment")
    parser.add_argument("--image", type=Path, help="write ours, theirs and the difference times 8 here")
    chosen = parser.parse_args()
    results = compare(chosen.size, chosen.samples, chosen.environment)
    print(table(results, "scene"))
    if chosen.image:
        draw(results, chosen.image)


if __name__ == "__main__":
    main()
