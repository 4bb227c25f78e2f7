"""Light and pictures against a reference renderer, Mitsuba 3, direct light only, shadows on, no scattering.

    python -m tests.tools.against_mitsuba light [--size N] [--samples N]
    python -m tests.tools.against_mitsuba archive AVATAR.zip [--size N] [--samples N]

``light``: the light stage's formulas on the neutral head with an even skin (Lambert and one GGX lobe); our texture is
read where each pixel's surface point lies on the chart. ``archive``: an archive's mesh with its albedos and normals, by
``avatarme render``'s code. Mitsuba draws the matt and the mirror-like part apart (``diffuse``, and ``roughconductor``
with a real index, whose Fresnel term is the exact one); the matt part is then lessened by what the mirror takes, as our
model says.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from service.archive.reading import open_avatar
from service.geometry.camera import Camera
from service.geometry.mesh import vertex_normals
from service.head.files import load_head
from service.head.model import HeadModel
from service.light.environment import radiance as environment_radiance
from service.light.formulas import Graphs
from service.light.plan import LightPlan
from service.light.scene import Environment, PointLight, Response, Scene
from service.light.shading import develop
from service.render.draw import SeenHead, see
from service.render.drawn import DrawnHead
from service.render.render import render_head
from service.render.request import RenderRequest
from service.render.surface import LOBES, ROLES, Surface, build_surface
from service.render.visibility import VisibilityDetail

Float = npt.NDArray[np.float64]

ALPHA, INDEX, ALBEDO = 0.3, 1.4, (0.6, 0.4, 0.3)
"""Of the even skin."""
FOV_DEG, VIEW_M = 13.0, (0.0, -0.03, 1.2)
CHART = (768, 512)
LAMPS = (
    PointLight((0.45, 0.35, 0.8), (2.0, 1.8, 1.6)),
    PointLight((-0.7, 0.1, 0.9), (1.0, 1.1, 1.3), 0.08),
    PointLight((0.1, 0.6, 1.4), (1.2, 1.2, 1.2)),
)
ARCHIVE_SCENES = {
    "lamp": Scene(lights=(PointLight((0.5, 0.35, 0.8), (2.0, 1.8, 1.6), 0.05),), response=Response(target=0.8)),
    "environment": Scene(Environment(name="apartment", rotation_deg=40.0), response=Response(target=0.8)),
}


@dataclass(frozen=True)
class Difference:
    """Two pictures (size, size, 3), sRGB coded, in [0, 1], and what counts of them.

    Attributes:
        mean: mean absolute difference over the pixels that count, in 1/255.
        high: its 95th percentile.
        pixels: how many count.
    """

    mean: float
    high: float
    pixels: int

    @classmethod
    def of(cls, ours: Float, theirs: Float, mask: npt.NDArray[np.bool_]) -> Difference:
        """Compare.

        Raises:
            ValueError: no pixel counts.
        """
        if not mask.any():
            raise ValueError("no pixel of the two pictures can be compared: the mask is empty")
        off = np.abs(ours - theirs)[mask].mean(-1) * 255.0
        return cls(float(off.mean()), float(np.percentile(off, 95)), int(mask.sum()))


def table(results: Mapping[str, Difference], what: str) -> str:
    """Markdown; ``what`` is that of which there is a row each."""
    lines = [f"| {what} | mean difference (sRGB/255) | 95th percentile | pixels |", "|---" * 4 + "|"]
    lines += [f"| {name} | {one.mean:.2f} | {one.high:.2f} | {one.pixels} |" for name, one in results.items()]
    return "\n".join(lines)


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
        look = transform().look_at(origin=list(VIEW_M), target=[0.0, -0.03, 0.0], up=[0.0, 1.0, 0.0])
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


def light_scenes(environment: str) -> dict[str, Scene]:
    """The three scenes by name."""
    sky = Environment(name=environment, rotation_deg=40.0, strength=0.8)
    response = Response(target=0.8)
    return {
        "environment": Scene(sky, (), response=response),
        "3 lamps": Scene(Environment(), LAMPS, response=response),
        "both": Scene(sky, LAMPS, response=response),
    }


def compare_light(size: int, samples: int, environment: str, chart: tuple[int, int] = CHART) -> dict[str, Difference]:
    """The neutral head with an even skin, under an environment, three lamps, and both."""
    import torch

    from models.lightstage.light.bake import radiance
    from models.lightstage.light.expose import expose
    from models.lightstage.light.geometry import Geometry
    from models.lightstage.light.lobes import directional_albedo
    from models.lightstage.light.plain import PlainSkin
    from models.lightstage.skin.window import ChartWindow

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
        for name, plain in list(light_scenes(environment).items())[:2]:
            drawn[name] = reference.linear(plain, diffuse, samples, 1) * kept[..., None]
            drawn[name] = drawn[name] + reference.linear(plain, mirror, samples, 2)
    drawn["both"] = drawn["environment"] + drawn["3 lamps"]  # light adds up
    results = {}
    for name, plain in light_scenes(environment).items():
        scene = dataclasses.replace(plain, viewpoints=(VIEW_M,))
        scene = expose(skin, geometry, scene, window)
        chosen = LightPlan.everything(scene).without("scattering")
        ours = radiance(skin, geometry, scene, chosen, window)[0][0].permute(1, 2, 0).numpy().astype(np.float64)
        results[name] = Difference.of(_coded(read(ours, uv), scene), _coded(drawn[name], scene), mask)
    return results


def _coded(linear: Float, scene: Scene) -> Float:
    import torch

    from models.lightstage.light.response import developed

    light = torch.from_numpy(np.ascontiguousarray(linear.transpose(2, 0, 1))).float()
    return np.asarray(developed(light, scene.response).permute(1, 2, 0).numpy(), np.float64)


def camera_of(size: int) -> Camera:
    """The reference's camera, for ``size`` x ``size`` pixels."""
    rotation = np.diag([1.0, -1.0, -1.0])
    focal = size / 2 / np.tan(np.radians(FOV_DEG / 2))
    return Camera(size, size, float(focal), np.full(2, size / 2), rotation, -rotation @ np.array(VIEW_M))


def compare_archive(
    archive: Path,
    size: int,
    samples: int,
    detail: VisibilityDetail = VisibilityDetail(),  # noqa: B008
) -> dict[str, Difference]:
    """Render an archive both ways under all scenes."""
    avatar = open_avatar(archive, ROLES)
    model = DrawnHead.of(avatar.mesh.as_head("archive", "unknown"), avatar.mesh.vertices)
    head = model.head
    surface = build_surface(head, avatar.mesh.vertices, avatar.maps, CHART)
    camera = camera_of(size)
    seen = see(model, camera, 1)
    skin = np.zeros(size * size, bool)
    skin[seen.index] = seen.read(surface.skin.astype(np.float32))[:, 0] > 0.999
    mask = skin.reshape(size, size)
    results = {}
    with tempfile.TemporaryDirectory() as folder:
        reference = Reference(head, size, Path(folder))
        for name, scene in ARCHIVE_SCENES.items():
            theirs = _reference(reference, surface, head, seen, scene, samples)
            request = RenderRequest(scene=scene, size=(size, size), samples=3 if size <= 512 else 2, tolerance=0.0)
            picture = render_head(
                head, avatar.mesh.vertices, avatar.maps, request, detail=detail, camera=camera, without=("scattering",)
            )  # fmt: skip
            whole = mask & (picture.covered == 1.0)
            ours = develop(np.asarray(picture.light, np.float64), picture.scene.response)
            results[name] = Difference.of(ours, develop(theirs, picture.scene.response), whole)
    return results


def _reference(
    reference: Reference, surface: Surface, head: HeadModel, seen: SeenHead, scene: Scene, samples: int
) -> Float:
    """(size, size, 3) linear light by Mitsuba."""
    axes = (surface.tangent, surface.bitangent, surface.normal)

    def mapped(normal: npt.NDArray[np.float32], bsdf: dict[str, Any]) -> dict[str, Any]:
        local = np.stack([np.einsum("hwi,hwi->hw", normal, axis) for axis in axes], -1)
        return {"type": "normalmap", "normalmap": _bitmap(reference, 0.5 + 0.5 * local), "bsdf": bsdf}

    matt = mapped(surface.diffuse_normal, {"type": "diffuse", "reflectance": _bitmap(reference, surface.albedo)})
    total = reference.linear(scene, matt, samples, 1) * _kept(reference.size, surface, seen)[..., None]
    grey = _bitmap(reference, np.repeat(surface.specular[..., None], 3, 2))
    for alpha, weight in ((LOBES[0], LOBES[2]), (LOBES[1], 1.0 - LOBES[2])):
        mirror = {
            "type": "roughconductor", "distribution": "ggx", "alpha": alpha, "eta": 1.5, "k": 0.0,
            "specular_reflectance": grey,
        }  # fmt: skip
        total = total + weight * reference.linear(scene, mapped(surface.specular_normal, mirror), samples, 2)
    return np.asarray(total)


def _bitmap(reference: Reference, image: npt.NDArray[np.floating]) -> dict[str, Any]:
    """Row 0 of the reference's images is v = 0."""
    bitmap = reference.mi.Bitmap(np.ascontiguousarray(image[::-1], np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True}


def _kept(size: int, surface: Surface, seen: SeenHead) -> Float:
    """(size, size) share of the matt light that the mirror leaves."""
    offset = np.array(VIEW_M, np.float32) - seen.position_m
    view = offset / np.linalg.norm(offset, axis=1, keepdims=True)
    points = {
        "view": view.T, "normal": seen.read(surface.specular_normal).T,
        "specular": seen.read(surface.specular)[:, 0],
    }  # fmt: skip
    kept = np.ones(size * size)
    for alpha, weight in ((LOBES[0], LOBES[2]), (LOBES[1], 1.0 - LOBES[2])):
        lobe = np.full(len(view), alpha, np.float32)
        kept[seen.index] -= weight * Graphs(1).at_points("kept", {**points, "alpha": lobe})
    return kept.reshape(size, size)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.tools.against_mitsuba", description=__doc__)
    parser.add_argument("what", choices=["light", "archive"])
    parser.add_argument("archive", type=Path, nargs="?")
    parser.add_argument("--size", type=int, default=112, help="pixels of the square pictures")
    parser.add_argument("--samples", type=int, default=128, help="samples per pixel of the reference")
    chosen = parser.parse_args()
    if chosen.what == "light":
        print(table(compare_light(chosen.size, chosen.samples, "apartment"), "scene"))
    else:
        print(table(compare_archive(chosen.archive, chosen.size, chosen.samples), "light"))


if __name__ == "__main__":
    main()
