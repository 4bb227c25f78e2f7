"""Photos with known truth, by Mitsuba 3.

A photo is written with a ``.npz`` beside it: ``position`` (H, W, 3) and ``normal`` in the head's frame, metres;
``mask``; ``eyes`` (2, 2) pixels of the pupils, image-left first; ``fov``, ``yaw`` degrees; ``centre`` and ``distance``
of the camera.
"""

from __future__ import annotations

import glob
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.heads import TexturedHead
from service.colour import linear_to_srgb
from service.geometry.mesh import vertex_normals

Float = npt.NDArray[np.float64]

LIGHTS = ("soft", "harsh")

Lamp = tuple[tuple[float, float, float], float, tuple[float, float, float]]
"""A ball: centre in metres (+X is the subject's left), radius, radiance."""

LAMPS: dict[str, Lamp] = {
    "left": ((1.6, 0.4, 1.0), 0.25, (12.0, 11.4, 10.6)),
    "right": ((-1.6, 0.4, 1.0), 0.25, (12.0, 11.4, 10.6)),
    "overhead": ((0.0, 1.9, 0.9), 0.25, (14.0, 13.3, 12.3)),
    "warm": ((0.9, 0.1, 1.7), 0.5, (3.6, 2.3, 1.2)),
}
"""Lights of one lamp in a dim room."""

FURTHER_LAMPS: dict[str, Lamp] = {
    "cool": ((-0.9, 0.3, 1.6), 0.5, (1.7, 2.4, 3.4)),
    "flash": ((0.17, 0.18, 1.26), 0.06, (80.0, 78.0, 74.0)),
}
"""Two more: light of a window, and a flash above the camera's lens."""

_OLDEST_LLVM = 16


@dataclass(frozen=True)
class Shot:
    """One photo to take.

    Attributes:
        yaw: degrees by which the camera goes round the head, positive towards the subject's left.
        light: "soft" (a bright sky and a dim floor), "harsh" (a key from one side, little else), or one of ``LAMPS`` or
            ``FURTHER_LAMPS``.
        distance: metres to the middle of the face.
        fov: degrees, of the whole width.
        size: pixels of the square photo.
        seed: turns the light.
    """

    yaw: float
    light: str
    distance: float
    fov: float
    size: int = 512
    seed: int = 0

    @property
    def origin(self) -> Float:
        """Camera position, metres."""
        y = np.radians(self.yaw)
        return self.target + self.distance * np.array([np.sin(y), 0.05, np.cos(y)])

    @property
    def target(self) -> Float:
        """What the camera looks at: the middle of the face."""
        return np.array([0.0, -0.02, 0.03])

    def pixels_of(self, points: Float) -> Float:
        """(N, 2) pixels of (N, 3) points."""
        forward = self.target - self.origin
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        up = np.cross(right, forward)
        d = points - self.origin
        focal = self.size / 2 / np.tan(np.radians(self.fov / 2))
        z = d @ forward
        return np.stack([self.size / 2 + focal * (d @ right) / z, self.size / 2 - focal * (d @ up) / z], 1)


@dataclass(frozen=True)
class Worn:
    """Something on the head that is no part of it: (V, 3) vertices, metres, (T, 3) triangles, linear RGB, roughness."""

    vertices: Float
    triangles: npt.NDArray[np.int64]
    colour: tuple[float, float, float]
    roughness: float = 0.5


@dataclass(frozen=True)
class Look:
    """How the skin shines, and what the head wears.

    Attributes:
        roughness, specular: of Disney's principled model, which Mitsuba has; small and large is oily.
        worn: meshes.
    """

    roughness: float = 0.42
    specular: float = 0.35
    worn: tuple[Worn, ...] = field(default=())


def write_ply(path: Path, vertices: Float, triangles: npt.NDArray[np.int64], colours: Float) -> None:
    """Binary PLY with normals and a linear colour per vertex, in the layout that Mitsuba reads as ``vertex_color``."""
    names = ("x", "y", "z", "nx", "ny", "nz", "r", "g", "b")
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {n}" for n in names]
    header += [f"element face {len(triangles)}", "property list uchar int vertex_indices", "end_header", ""]
    table = np.concatenate([vertices, vertex_normals(vertices, triangles), colours], 1).astype("<f4")
    faces = np.zeros(len(triangles), dtype=[("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, triangles
    path.write_bytes("\n".join(header).encode() + table.tobytes() + faces.tobytes())


def eyeball(centre: Float, radius: float, iris: Float) -> tuple[Float, npt.NDArray[np.int64], Float]:
    """Vertices, triangles and colours of an eye that looks along +Z."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=5)
    angle = np.degrees(np.arccos(np.clip(ball.vertices[:, 2], -1, 1)))
    white, black = np.array([0.62, 0.58, 0.55]), np.array([0.01, 0.01, 0.01])
    ring = np.clip((angle - 27.0) / 3.0, 0, 1)[:, None]
    pupil = np.clip((angle - 9.0) / 1.5, 0, 1)[:, None]
    colours = pupil * (ring * white + (1 - ring) * iris) + (1 - pupil) * black
    return np.asarray(ball.vertices) * radius + centre, np.asarray(ball.faces), colours


def environment(light: str, seed: int) -> npt.NDArray[np.float32]:
    """(32, 64, 3) radiance of the surroundings."""
    rng = np.random.default_rng(seed)
    up = np.cos(np.linspace(0, np.pi, 32))[:, None, None]
    around = np.linspace(0, 2 * np.pi, 64, endpoint=False)[None, :, None]
    tint = 1 + 0.1 * rng.normal(size=3)
    sky = (0.35 + 0.45 * np.clip(up + 0.3, 0, 1)) * np.ones((32, 64, 3)) * tint
    sky = sky * (1 + 0.35 * np.cos(around - rng.uniform(0, 2 * np.pi)))
    return np.asarray(sky if light == "soft" else 0.12 * sky, np.float32)


def lamps_of(light: str, seed: int) -> list[Lamp]:
    """Lamps of a light: none, one of ``LAMPS``, or a key from one side and a weak fill from the other."""
    lamps = LAMPS | FURTHER_LAMPS
    if light in lamps:
        return [lamps[light]]
    if light != "harsh":
        return []
    side = 1 if seed % 2 else -1
    key, fill = (45.0, 45.0 * 0.95, 45.0 * 0.88), (1.0, 0.95, 0.88)
    return [((side * 1.2, 0.7, 1.2), 0.12, key), ((-side * 2.6, 0.2, 2.8), 0.6, fill)]


def take(head: TexturedHead, shot: Shot, out: Path, samples: int = 48) -> None:
    """Render ``out.png`` and ``out.npz`` (written last, so that its presence means done)."""
    import cv2

    mi = mitsuba()
    scene = _scene(mi, head, shot, out)
    image = _radiance(mi, scene, samples)
    coded = (linear_to_srgb(np.clip(image, 0, 1)) * 255).astype(np.uint8)
    calm = cv2.fastNlMeansDenoisingColored(coded, None, 2, 2, 5, 15)
    normal, position = _geometry(mi, scene)
    pupils = head.eyes + np.array([0.0, 0.0, head.eye_radius])
    eyes = shot.pixels_of(pupils)[np.argsort(shot.pixels_of(pupils)[:, 0])]
    cv2.imwrite(f"{out}.png", calm[..., ::-1])
    np.savez_compressed(
        f"{out}.npz", normal=normal.astype(np.float16), position=position.astype(np.float32),
        mask=np.linalg.norm(normal, axis=-1) > 0.9, eyes=np.clip(np.rint(eyes), 0, shot.size - 1).astype(int),
        fov=shot.fov, yaw=shot.yaw, distance=shot.distance,
    )  # fmt: skip


def _radiance(mi: Any, scene: Any, samples: int) -> npt.NDArray[np.float32]:
    integrator = mi.load_dict({"type": "path", "max_depth": 4})
    return np.array(mi.render(scene, integrator=integrator, spp=samples), np.float32)[..., :3]


def _geometry(mi: Any, scene: Any) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Normals and positions (H, W, 3) of what pixels show."""
    integrator = mi.load_dict({"type": "aov", "aovs": "n:sh_normal,p:position"})
    truth = np.array(mi.render(scene, integrator=integrator, spp=1), np.float32)
    return truth[..., -6:-3], truth[..., -3:]


@dataclass(frozen=True)
class Exposure:
    """What came through the lens, before any camera, and what each pixel shows; all (H, W, ...) of one square photo.

    Attributes:
        radiance: float32 linear RGB, any scale, with the noise of the renderer.
        albedo: float32 linear RGB diffuse albedo, averaged over the pixel.
        position: float32 metres, head frame.
        normal: float32 unit, head frame.
        skin: bool, the head itself shows at the pixel's centre: neither eyes nor anything that it wears.
    """

    radiance: npt.NDArray[np.float32]
    albedo: npt.NDArray[np.float32]
    position: npt.NDArray[np.float32]
    normal: npt.NDArray[np.float32]
    skin: npt.NDArray[np.bool_]


ALBEDO_SAMPLES = 16
SAME_PLACE_M = 0.004
"""A pixel shows the skin where a vertex of it is not further, and the head has no larger triangles."""


def expose(head: TexturedHead, shot: Shot, look: Look, scratch: Path, samples: int = 32) -> Exposure:
    """Render a head with all that is known of it; ``scratch`` is a path for meshes that are removed again."""
    from scipy.spatial import cKDTree

    mi = mitsuba()
    scene = _scene(mi, head, shot, scratch, look)
    radiance = _radiance(mi, scene, samples)
    colours = mi.load_dict({"type": "aov", "aovs": "a:albedo"})
    albedo = np.array(mi.render(scene, integrator=colours, spp=ALBEDO_SAMPLES), np.float32)[..., -3:]
    normal, position = _geometry(mi, scene)
    skin = np.linalg.norm(normal, axis=-1) > 0.9
    near = cKDTree(head.vertices).query(position[skin], distance_upper_bound=SAME_PLACE_M)[0] < SAME_PLACE_M
    for mesh in look.worn:  # its own vertices are denser than skin is near
        near &= cKDTree(mesh.vertices).query(position[skin], distance_upper_bound=SAME_PLACE_M)[0] > SAME_PLACE_M / 2
    eyes = np.linalg.norm(position[skin][:, None] - head.eyes, axis=2).min(1) < 1.05 * head.eye_radius
    skin[skin] = near & ~eyes
    return Exposure(radiance, albedo, position, normal, skin)


def take_once(head: TexturedHead, shot: Shot, out: Path, samples: int = 48) -> bool:
    """The same unless the photo is there; whether it was taken now."""
    missing = not Path(f"{out}.npz").is_file()
    if missing:
        take(head, shot, out, samples)
    return missing


def newest_llvm(folders: tuple[str, ...] = ("/usr/lib/*-linux-gnu", "/usr/lib64", "/usr/lib/llvm-*/lib")) -> str | None:
    """Path of the newest LLVM library of at least version 16, by the version in its name; None where there is none."""
    found = []
    for folder in folders:
        for path in glob.glob(f"{folder}/libLLVM*.so*"):
            version = re.search(r"libLLVM(?:-|\.so\.)(\d+)", path)
            if version and int(version[1]) >= _OLDEST_LLVM:
                found.append((int(version[1]), path))
    return max(found)[1] if found else None


def _llvm(mi: Any) -> bool:
    """True where the vectorised variant finds an LLVM library that it can use: older ones abort the process."""
    library = os.environ.get("DRJIT_LIBLLVM_PATH") or newest_llvm()
    if library is None:
        return False
    os.environ.setdefault("DRJIT_LIBLLVM_PATH", library)
    try:
        mi.set_variant("llvm_ad_rgb")
        import drjit

        return bool(drjit.any(mi.Float(1) + 1 == 2))
    except Exception:  # drjit raises various errors without the library
        return False


def mitsuba() -> Any:
    """Mitsuba with its variant chosen: vectorised where an LLVM library allows it."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb" if _llvm(mi) else "scalar_rgb")
    return mi


def _scene(mi: Any, head: TexturedHead, shot: Shot, out: Path, look: Look = Look()) -> Any:
    colour = {"type": "mesh_attribute", "name": "vertex_color"}

    def shiny(roughness: float, specular: float) -> dict[str, Any]:
        inner = {"type": "principled", "roughness": roughness, "specular": specular, "base_color": colour}
        return {"type": "twosided", "b": inner}

    skin = shiny(look.roughness, look.specular)
    wet = {"type": "principled", "roughness": 0.1, "specular": 0.5, "base_color": colour}
    meshes: dict[str, tuple[Any, ...]] = {"head": (head.vertices, head.triangles, head.colours, skin)}
    iris = np.random.default_rng(shot.seed).uniform([0.02, 0.02, 0.01], [0.12, 0.10, 0.12])
    for i, centre in enumerate(head.eyes):
        meshes[f"eye{i}"] = (*eyeball(centre, head.eye_radius, iris), wet)
    for i, mesh in enumerate(look.worn):
        colours = np.tile(mesh.colour, (len(mesh.vertices), 1))
        meshes[f"worn{i}"] = (mesh.vertices, mesh.triangles, colours, shiny(mesh.roughness, 0.5))
    camera = mi.ScalarTransform4f().look_at(origin=shot.origin.tolist(), target=shot.target.tolist(), up=[0, 1, 0])
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": shot.fov,
            "to_world": camera,
            "film": {"type": "hdrfilm", "width": shot.size, "height": shot.size, "rfilter": {"type": "box"}},
        },
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(environment(shot.light, shot.seed))},
    }
    for name, (vertices, triangles, colours, bsdf) in meshes.items():
        path = out.with_name(f"{out.name}.{name}.ply")
        write_ply(path, vertices, triangles, colours)
        scene[name] = {"type": "ply", "filename": str(path), "bsdf": bsdf}
    for number, (where, radius, radiance) in enumerate(lamps_of(shot.light, shot.seed)):
        lamp = {"type": "sphere", "center": list(where), "radius": radius, "emitter": emitter(radiance)}
        scene[f"lamp{number}"] = lamp
    loaded = mi.load_dict(scene)
    for name in meshes:
        out.with_name(f"{out.name}.{name}.ply").unlink()
    return loaded


def emitter(radiance: tuple[float, float, float]) -> dict[str, Any]:
    """Mitsuba's description of a surface that emits this radiance."""
    return {"type": "area", "radiance": {"type": "rgb", "value": list(radiance)}}
