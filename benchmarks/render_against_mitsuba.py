"""A picture of an archive against a reference renderer: ``python -m benchmarks.render_against_mitsuba AVATAR.zip``.

The archive's mesh with its albedos and normals is drawn by ``avatarme render``'s code and by Mitsuba 3 under one lamp
and under one environment, shadows on, no scattering. As in ``benchmarks.light_against_mitsuba`` Mitsuba draws the matt
and the mirror-like part apart; the matt part is lessened by what the mirror takes, as our model says. Its mirror is a
``roughconductor`` with a real index of 1.5, whose exact Fresnel term the specular albedo scales.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.light_against_mitsuba import FOV_DEG, Reference
from benchmarks.pictures import Difference, draw, table
from service.archive.reading import open_avatar
from service.geometry.camera import Camera
from service.head.model import HeadModel
from service.light.formulas import Graphs
from service.light.scene import Environment, PointLight, Response, Scene
from service.light.shading import develop
from service.render.draw import DrawnHead, SeenHead, see
from service.render.render import render_head
from service.render.request import RenderRequest
from service.render.surface import LOBES, ROLES, Surface, build_surface
from service.render.visibility import VisibilityDetail

Float = npt.NDArray[np.float64]
CHART = (768, 512)
VIEW = (0.0, -0.03, 1.2)
SCENES = {
    "lamp": Scene(lights=(PointLight((0.5, 0.35, 0.8), (2.0, 1.8, 1.6), 0.05),), response=Response(target=0.8)),
    "environment": Scene(Environment(name="apartment", rotation_deg=40.0), response=Response(target=0.8)),
}


def camera_of(size: int) -> Camera:
    """The reference's camera, for ``size`` x ``size`` pixels."""
    rotation = np.diag([1.0, -1.0, -1.0])
    focal = size / 2 / np.tan(np.radians(FOV_DEG / 2))
    return Camera(size, size, float(focal), np.full(2, size / 2), rotation, -rotation @ np.array(VIEW))


def compare(
    archive: Path, size: int, samples: int, detail: VisibilityDetail = VisibilityDetail()  # noqa: B008
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
        for name, scene in SCENES.items():
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
    offset = np.array(VIEW, np.float32) - seen.position_m
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
    parser = argparse.ArgumentParser(prog="python -m benchmarks.render_against_mitsuba", description=__doc__)
    parser.add_argument("archive", type=Path)
    parser.add_argument("--size", type=int, default=128, help="pixels of the square picture")
    parser.add_argument("--samples", type=int, default=128, help="samples per pixel of the reference")
    parser.add_argument("--image", type=Path, help="write ours, theirs and the difference times 8 here")
    chosen = parser.parse_args()
    results = compare(chosen.archive, chosen.size, chosen.samples)
    print(table(results, "light"))
    if chosen.image:
        draw(results, chosen.image)


if __name__ == "__main__":
    main()
