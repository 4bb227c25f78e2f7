"""Toy heads with maps, small enough for seconds."""

from __future__ import annotations

from typing import Any

import numpy as np

from service.archive.images import encode_normals8
from service.light.scene import Environment, PointLight, Response, Scene
from service.render.render import RenderedPicture, render_head
from service.render.request import RenderRequest
from service.render.surface import StoredMap
from service.render.visibility import VisibilityDetail
from tests.toyhead import sphere_head

HEAD = sphere_head(16, 24)
ROUGH = VisibilityDetail(64, sky_size=(48, 32), shadow_size=(96, 64), casters_mm=(3, 5), recess_mm=2.0, narrowest=96)
EVEN = Environment(zenith=(1.0,) * 3, horizon=(1.0,) * 3, ground=(1.0,) * 3)
LAMP = PointLight((0.5, 0.3, 0.9), (2.0, 1.6, 1.2), 0.05)


def stored(role: str, image: np.ndarray, *, frame: str | None = None) -> StoredMap:
    normal = role.endswith("normal")
    codes = np.repeat(image[..., None], 3, 2) if image.ndim == 2 else image
    return StoredMap(lambda: codes, 8, 128.0 if normal else 0.0, 127.0 if normal else 255.0, frame)  # type: ignore[arg-type]


def albedo(code: int = 180) -> dict[str, StoredMap]:
    return {"diffuse_albedo": stored("diffuse_albedo", np.full((16, 24, 3), code, np.uint8))}


def flat_normals(frame: str = "tangent") -> np.ndarray:
    return encode_normals8(np.tile(np.array([0.0, 0.0, 1.0]), (16, 24, 1)))


def scene(environment: Environment | None = None, *lights: PointLight, exposure: float | None = 1.0) -> Scene:
    return Scene(environment or Environment(), lights, response=Response(exposure=exposure))


def toy_picture(
    what: Scene, maps: dict[str, StoredMap] | None = None, vertices: np.ndarray | None = None, **options: Any
) -> RenderedPicture:
    given: dict[str, Any] = {"size": (48, 56), "samples": 1, **options}
    request = RenderRequest(scene=what, **given)
    posed = HEAD.mean if vertices is None else vertices
    return render_head(HEAD, posed, albedo() if maps is None else maps, request, threads=1, detail=ROUGH)
