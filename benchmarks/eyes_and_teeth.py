"""Eyes and teeth against a reference renderer: ``python -m benchmarks.eyes_and_teeth AVATAR.zip``.

An archive's head is drawn by ``avatarme render``'s code and by Mitsuba 3, path traced with several bounces, and the
mean radiance of the teeth, of the sclera and of the pupils (median, as a mirrored lamp may stand in them) is divided by
that of the cheeks. Mitsuba draws skin, teeth, tongue and eyeballs with its ``principled`` model, the cornea as a mirror
that reflects what Fresnel says at normal incidence and lets the rest through unbent. Neither draws hair, lashes, bust.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.render import mitsuba
from service.anatomy.eyes import IRIS_SHARE
from service.archive.reading import open_avatar
from service.archive.rendering import stored_meshes
from service.arrays import AnyFloat
from service.colour import LUMA, bytes_to_linear
from service.geometry.camera import Camera
from service.geometry.mesh import vertex_normals
from service.geometry.raster import Raster, interpolate, rasterise
from service.head.model import HeadModel
from service.light.environment import radiance
from service.light.scene import Environment, PointLight, Response, Scene
from service.materials.material import OwnMap
from service.materials.part import MeshPart, part_normals, part_triangles
from service.render.render import render_head
from service.render.request import RenderRequest
from service.render.surface import ROLES, StoredMap

Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

SCENES = {
    "studio": Environment(name="studio"),
    "overcast": Environment(zenith=(1.0,) * 3, horizon=(0.7,) * 3, ground=(0.25,) * 3),
    "lamp": Environment(zenith=(0.1,) * 3, horizon=(0.1,) * 3, ground=(0.1,) * 3),
}
LAMP = PointLight((0.4, 0.4, 1.1), (1.4, 1.3, 1.2), 0.1)
FOV_DEG, DISTANCE_M = 7.0, 1.2
"""The face from the brows to the chin."""
DRAWN = ("teeth", "tongue", "eye")
"""First words of the parts that are drawn."""
CHEEK_M = 0.010
"""Radius of what counts of each cheek."""
PLACES = ("teeth", "sclera", "pupil")
SKIN_ROUGHNESS, SKIN_SPECULAR = 0.55, 0.325
SCLERA_FROM, PUPIL_UP_TO = 1.05, 0.14
"""Distance from the line of sight on the eyes' picture, over the limbus's, from which all is sclera; and, in halves of
its side, up to which all is pupil."""


def scene_of(name: str) -> Scene:
    """One of ``SCENES``."""
    lights = (LAMP,) if name == "lamp" else ()
    return Scene(SCENES[name], lights, response=Response(exposure=1.0))


@dataclasses.dataclass(frozen=True)
class Bust:
    """A head with what lies in its eyes and mouth, and a camera on the face."""

    head: HeadModel
    vertices: Float
    parts: tuple[MeshPart, ...]
    maps: dict[str, StoredMap]
    camera: Camera

    @classmethod
    def of(cls, archive: Path, size: int) -> Bust:
        """Open an archive; the camera takes pictures of ``size`` x ``size`` pixels."""
        avatar = open_avatar(archive, ROLES)
        head, vertices, parts = stored_meshes(avatar)
        kept = tuple(part for part in parts if part.name.split("_")[0] in DRAWN)
        eyes = _centre(kept, "eye_left_ball"), _centre(kept, "eye_right_ball")
        teeth = _centre(kept, "teeth_upper_gums")
        middle = (eyes[0] + eyes[1] + 2 * teeth) / 4
        origin = np.array([middle[0], middle[1], DISTANCE_M])
        rotation = np.diag([1.0, -1.0, -1.0])
        focal = size / 2 / np.tan(np.radians(FOV_DEG / 2))
        camera = Camera(size, size, float(focal), np.full(2, size / 2), rotation, -rotation @ origin)
        return cls(head, np.asarray(vertices, np.float64), kept, avatar.maps, camera)

    def masks(self) -> dict[str, Mask]:
        """(size, size) pixels of the cheeks and of each of ``PLACES``, of which no other surface is near."""
        import cv2

        found = {name: np.zeros((self.camera.height, self.camera.width), bool) for name in ("cheeks", *PLACES)}
        nearest = np.full(found["cheeks"].shape, np.inf, np.float32)
        seen = self.camera.project(self.vertices), self.camera.to_camera(self.vertices)[:, 2]
        size = (self.camera.width, self.camera.height)
        skin = rasterise(*seen, self.head.triangles, *size, cull=True, perspective=True)
        point = _at(skin, self.vertices, self.head.triangles)
        for side in ("left", "right"):
            cheek = 0.5 * (_centre(self.parts, f"eye_{side}_ball") + _centre(self.parts, "teeth_upper_gums"))
            cheek[0] = 1.1 * _centre(self.parts, f"eye_{side}_ball")[0]
            found["cheeks"] |= skin.mask & (np.linalg.norm((point - cheek)[..., :2], axis=-1) < CHEEK_M)
        nearest = np.where(skin.mask, skin.depth, nearest)
        for part in self.parts:
            if part.material.opacity < 1:
                continue
            flat, depth = self.camera.project(part.vertices), self.camera.to_camera(part.vertices)[:, 2]
            triangles, places = part_triangles(part.polygons), part_triangles(part.polygons_uv, part.polygons)
            drawn = rasterise(flat, depth, triangles, *size, cull=False, perspective=True)
            front = drawn.mask & (drawn.depth < nearest)
            nearest = np.where(front, drawn.depth, nearest)
            for mask in found.values():
                mask &= ~front
            at = _at(drawn, part.uv, places)
            if part.name.endswith("_ball"):
                beside = np.hypot(*np.moveaxis(2 * at - 1, -1, 0))
                found["sclera"] |= front & (beside > SCLERA_FROM * IRIS_SHARE)
                found["pupil"] |= front & (beside < PUPIL_UP_TO)
            elif part.name.startswith("teeth"):
                found["teeth"] |= front & (_colour(part, at)[..., 1] > 0.55 * _colour(part, at)[..., 0])
        kernel = np.ones((3, 3), np.uint8)
        return {name: cv2.erode(mask.astype(np.uint8), kernel) > 0 for name, mask in found.items()}

    def ours(self, scene: Scene) -> Float:
        """(size, size, 3) radiance."""
        request = RenderRequest(scene=scene, size=(self.camera.width, self.camera.height), tolerance=0.0)
        made = render_head(
            self.head, self.vertices, self.maps, request, camera=self.camera, parts=self.parts, without=("scattering",)
        )
        return np.asarray(made.light, np.float64)

    def theirs(self, scene: Scene, samples: int, folder: Path) -> Float:
        """(size, size, 3) radiance by Mitsuba."""
        mi = mitsuba()
        chart = self.maps["diffuse_albedo"].codes()
        skin = _principled(mi, bytes_to_linear(chart), SKIN_ROUGHNESS, SKIN_SPECULAR)
        normals = vertex_normals(self.vertices, self.head.triangles)
        made: dict[str, Any] = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 9, "hide_emitters": True},
            "sensor": _sensor(mi, self.camera, samples),
            "skin": _shape(
                mi, folder / "skin.ply", self.vertices[self.head.triangles], normals[self.head.triangles],
                self.head.uv[self.head.triangle_uv], skin,
            ),
        }  # fmt: skip
        for part in self.parts:
            triangles, places = part_triangles(part.polygons), part_triangles(part.polygons_uv, part.polygons)
            normal = part_normals(part, part.vertices, triangles)
            material = part.material
            picture, relief = material.colour_map, material.normal_map
            colours = np.full((1, 1, 3), material.colour)
            if isinstance(picture, OwnMap):
                colours = bytes_to_linear(picture.pixels[..., :3])
            bsdf = _principled(mi, colours, material.roughness, material.f0 / 0.08)
            if isinstance(relief, OwnMap):
                bitmap = mi.Bitmap(np.ascontiguousarray(relief.pixels[::-1]))
                bumps = {"type": "bitmap", "bitmap": bitmap, "raw": True}
                bsdf = {"type": "normalmap", "normalmap": bumps, "bsdf": bsdf}
            corners = part.vertices[triangles], normal[triangles], part.uv[places]
            made[part.name] = _shape(mi, folder / f"{part.name}.ply", *corners, bsdf)
        sky = radiance(scene.environment)
        made["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(sky[:, ::-1], np.float32))}
        for i, light in enumerate(scene.lights):
            glow = [c / (np.pi * light.radius_m**2) for c in light.intensity]
            emitter = {"type": "area", "radiance": {"type": "rgb", "value": glow}}
            ball = {"type": "sphere", "center": list(light.position_m), "radius": light.radius_m}
            made[f"lamp{i}"] = {**ball, "emitter": emitter}
        return np.asarray(mi.render(mi.load_dict(made), seed=1), np.float64)[..., :3]


def _centre(parts: tuple[MeshPart, ...], name: str) -> Float:
    part = next(part for part in parts if part.name == name)
    centre: Float = np.asarray(part.vertices, np.float64).mean(0)
    return centre


def _at(drawn: Raster, values: npt.NDArray[Any], corners: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """(h, w, C) of values (N, C) at the corners (T, 3) of the triangles drawn, 0 beside them."""
    there = np.flatnonzero(drawn.mask)
    weights = drawn.barycentric.reshape(-1, 3)[there]
    found = np.zeros((drawn.mask.size, values.shape[1]), np.float32)
    found[there] = interpolate(values.astype(np.float32), corners[drawn.triangle.ravel()[there]], weights)
    return found.reshape(*drawn.mask.shape, -1)


def _colour(part: MeshPart, at: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """(h, w, 3) linear colours at places (h, w, 2) of a part's picture."""
    picture = part.material.colour_map
    if not isinstance(picture, OwnMap):
        return np.broadcast_to(np.array(part.material.colour, np.float32), (*at.shape[:2], 3))
    height, width = picture.pixels.shape[:2]
    x, y = (np.clip(c, 0, 1) for c in (at[..., 0], 1 - at[..., 1]))
    codes = picture.pixels[(y * (height - 1)).astype(int), (x * (width - 1)).astype(int), :3]
    return np.asarray(bytes_to_linear(codes), np.float32)


def _principled(mi: Any, colours: npt.NDArray[np.floating[Any]], roughness: float, specular: float) -> dict[str, Any]:
    # Row 0 of Mitsuba's images is v = 0 here.
    bitmap = mi.Bitmap(np.ascontiguousarray(colours[::-1], np.float32))
    colour = {"type": "bitmap", "bitmap": bitmap, "raw": True}
    inner = {"type": "principled", "base_color": colour, "roughness": roughness, "specular": min(specular, 1.0)}
    return {"type": "twosided", "bsdf": inner}


def _shape(
    mi: Any, path: Path, points: AnyFloat, normals: AnyFloat, uv: AnyFloat, bsdf: dict[str, Any]
) -> dict[str, Any]:
    """A mesh of corners (T, 3, 3), (T, 3, 3) and (T, 3, 2)."""
    count = 3 * len(points)
    mesh = mi.Mesh("part", count, len(points), has_vertex_normals=True, has_vertex_texcoords=True)
    fields = mi.traverse(mesh)
    fields["vertex_positions"] = points.astype(np.float32).ravel()
    fields["vertex_normals"] = normals.astype(np.float32).ravel()
    fields["vertex_texcoords"] = uv.astype(np.float32).ravel()
    fields["faces"] = np.arange(count, dtype=np.uint32)
    fields.update()
    mesh.write_ply(str(path))
    return {"type": "ply", "filename": str(path), "bsdf": bsdf}


def _sensor(mi: Any, camera: Camera, samples: int) -> dict[str, Any]:
    x, y, z = (float(value) for value in camera.centre)
    look = mi.ScalarTransform4f().look_at(origin=[x, y, z], target=[x, y, 0.0], up=[0.0, 1.0, 0.0])
    film = {"type": "hdrfilm", "width": camera.width, "height": camera.height, "pixel_format": "rgb"}
    film["rfilter"] = {"type": "box"}
    sampler = {"type": "independent", "sample_count": samples}
    return {"type": "perspective", "fov": FOV_DEG, "to_world": look, "film": film, "sampler": sampler}


def ratios(picture: Float, masks: dict[str, Mask]) -> dict[str, float]:
    """Luminance of each of ``PLACES`` over that of the cheeks; NaN where there is none."""
    light = picture @ np.asarray(LUMA, np.float64)
    cheek = float(light[masks["cheeks"]].mean())
    found = {}
    for name in PLACES:
        seen = light[masks[name]]
        value = float(np.median(seen) if name == "pupil" else seen.mean()) if len(seen) else float("nan")
        found[name] = value / cheek
    return found


def compare(archive: Path, size: int, samples: int) -> tuple[dict[str, Float], list[str]]:
    """Both pictures of each scene, side by side, and rows of a table."""
    bust = Bust.of(archive, size)
    masks = bust.masks()
    pictures, rows = {}, []
    with tempfile.TemporaryDirectory() as folder:
        for name in SCENES:
            ours, theirs = bust.ours(scene_of(name)), bust.theirs(scene_of(name), samples, Path(folder))
            pictures[name] = np.concatenate([ours, theirs], 1) / (2 * theirs[masks["cheeks"]].mean())
            mine, reference = ratios(ours, masks), ratios(theirs, masks)
            for place in PLACES:
                off = mine[place] / reference[place] - 1
                count = int(masks[place].sum())
                rows.append(f"| {name} | {place} | {mine[place]:.3f} | {reference[place]:.3f} | {off:+.0%} | {count} |")
    return pictures, rows


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.eyes_and_teeth", description=__doc__)
    parser.add_argument("archive", type=Path)
    parser.add_argument("--size", type=int, default=384, help="pixels of the square picture")
    parser.add_argument("--samples", type=int, default=256, help="samples per pixel of the reference")
    parser.add_argument("--image", type=Path, help="write ours and theirs here")
    chosen = parser.parse_args()
    pictures, rows = compare(chosen.archive, chosen.size, chosen.samples)
    print("\n".join(["| light | over the cheeks | ours | Mitsuba | difference | pixels |", "|---" * 6 + "|", *rows]))
    if chosen.image:
        import cv2

        whole = np.concatenate(list(pictures.values())).clip(0, 1) ** (1 / 2.2)
        cv2.imwrite(str(chosen.image), np.rint(255 * whole[..., ::-1]).astype(np.uint8))


if __name__ == "__main__":
    main()
