"""Sharp photos of the sitters with the truth of each pixel, by Mitsuba 3; each is rendered once and kept."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.corrections.sitters import HIFI3D, whole_skin
from benchmarks.heads import EYE_RADIUS_M, IctHeads, Skin, subdivided
from benchmarks.render import Shot, emitter, environment, eyeball, lamps_of, mitsuba, write_ply
from benchmarks.shoot import FFHQ_EYES_M, ffhq_head, ict_places, landmarks_on
from benchmarks.subjects import BEHIND_LIDS_M, PUPILS_M, SCAN_LIDS
from models.lightstage.references import linear, normals, read
from service.geometry.mesh import vertex_normals

Float = npt.NDArray[np.float64]

SHAPES = {"hifi3d 1": 100, "hifi3d 2": 102, "hifi3d 3": 103}
"""Seed of the head of ICT-FaceKit that wears each skin."""
NAMES = ("scan", *SHAPES)
LIDS_M, LIPS_M = 0.021, 0.012
"""Distance from eyeballs' centres and from the lips' outline within which a carried skin does not fit."""
SMOOTHED = 12
"""Rounds in which the places on the chart, which were carried vertex by vertex, are brought nearer to their
neighbours': else the texture would be crumpled."""


@dataclass(frozen=True)
class Sitter:
    """One head.

    Attributes:
        name: one of ``NAMES``.
        vertices: (V, 3) metres, +Y up, +Z forward, origin between the eyes.
        triangles: (T, 3).
        uv: (V, 2), origin at the bottom left.
        albedo: (H, W, 3) linear RGB.
        normal: (H', W', 3) unit, tangent space, +Y up.
        eyes: (2, 3) eyeball centres, subject's left first.
        eye_radius: metres.
        unfit: (K, 4) centres and radii, metres, of balls in which a carried skin does not fit: lids and lips.
    """

    name: str
    vertices: Float
    triangles: npt.NDArray[np.int64]
    uv: Float
    albedo: Float
    normal: Float
    eyes: Float
    eye_radius: float
    unfit: Float


def sitter(name: str, data: Path, out: Path) -> Sitter:
    """A head out of the folder ``data`` of reference heads; ``out`` keeps what takes long to make.

    Raises:
        KeyError: the name is none of ``NAMES``.
        UsageError: a file is missing.
    """
    return _scan(data) if name == "scan" else _carried(name, data, out)


def _scan(data: Path) -> Sitter:
    import trimesh

    folder = data / "lee_perry_smith"
    mesh: Any = trimesh.load(folder / "head.glb", force="mesh", process=False)
    # The file counts v from the bottom, where glTF counts it from the top.
    uv = np.asarray(mesh.visual.uv, np.float64) * [1, -1] + [0, 1]
    metres = PUPILS_M / float(np.linalg.norm(SCAN_LIDS[0] - SCAN_LIDS[1]))
    eyes = metres * SCAN_LIDS - [0, 0, BEHIND_LIDS_M]
    vertices, triangles = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    colour, relief = linear(read(folder / "color.jpg")), normals(read(folder / "normal.jpg"))
    middle = eyes.mean(0)
    return Sitter("scan", metres * vertices - middle, triangles, uv, colour, relief, eyes - middle, 0.0115,
                  np.zeros((0, 4)))  # fmt: skip


def _carried(name: str, data: Path, out: Path) -> Sitter:
    skin, ict = Skin.load(data / "ffhq_uv_head"), IctHeads(data / "ict_facekit_head.npz")
    cached = (out / "places.npy").is_file()
    landmarks = np.zeros((0, 3)) if cached else landmarks_on(ffhq_head(skin), out, "reference_skin")
    places = ict_places(ict, skin, landmarks, FFHQ_EYES_M.mean(0), out)
    vertices, eyes = ict.sample(SHAPES[name])
    fine, triangles = subdivided(vertices, ict.triangles, 2)
    albedo = whole_skin(linear(read(data / "hifi3d_uv" / HIFI3D[name])), skin.texture)
    relief = normals(read(data / "hifi3d_uv" / HIFI3D[name].replace("albedo", "normal")))
    flat = relief[..., 2] < 0.2  # beside the face the file is black
    relief[flat] = (0.0, 0.0, 1.0)
    mouth = vertices[ict.landmarks[48:60]]
    balls = [*((eye, LIDS_M) for eye in eyes), *((corner, LIPS_M) for corner in mouth)]
    unfit = np.array([[*centre, radius] for centre, radius in balls])
    return Sitter(name, fine, triangles, smoothed(places, triangles), albedo, relief, eyes, EYE_RADIUS_M, unfit)


def smoothed(values: Float, triangles: npt.NDArray[np.int64], rounds: int = SMOOTHED) -> Float:
    """(V, C) values, each brought to the mean of itself and its neighbours' mean, ``rounds`` times; borders stay."""
    from scipy.sparse import coo_matrix, diags

    count = len(values)
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    both = np.concatenate([sides, sides[:, ::-1]])
    once = coo_matrix((np.ones(len(both)), both.T), (count, count)).tocsr()
    border = np.unique(np.argwhere(once == 1).ravel()) if once.nnz else np.zeros(0, int)
    once.data[:] = 1
    mean = diags(1 / np.maximum(np.asarray(once.sum(1)).ravel(), 1)) @ once
    result = values.copy()
    for _ in range(rounds):
        nearer = 0.5 * (result + mean @ result)
        nearer[border] = values[border]
        result = nearer
    return result


Single = npt.NDArray[np.float32]

DISTANCE_M, WIDTH_M = 1.2, 0.19
"""Of the camera, and what the picture is wide there: a head fills it."""
SAMPLES, LEAST_SAMPLES, LARGE = 16, 4, 2048
"""Paths per pixel, stratified: as many in all in larger pictures than ``LARGE`` as there, but no fewer than the second.
"""
MOST_PATHS = 2**25
"""Paths that Mitsuba follows at once: each takes some 100 bytes."""
ROUGHNESS, SPECULAR = 0.42, 0.35
"""Of the skin, in Disney's principled model."""


@dataclass(frozen=True)
class Taken:
    """One square photo, (H, W, ...).

    Attributes:
        radiance: float32 linear RGB as it comes through the lens.
        albedo: float32 linear RGB, averaged over the pixel.
        normal: float32 unit, head frame, with the relief of the texture.
        position: float32 metres, head frame.
        skin: bool, the pixel shows the head, not its eyes and not the background.
        axes: (3, 3) float64 rows: the camera's right, down and forward in the head's frame.
    """

    radiance: Single
    albedo: Single
    normal: Single
    position: Single
    skin: npt.NDArray[np.bool_]
    axes: npt.NDArray[np.float64]

    @property
    def per_mm(self) -> float:
        """Pixels per millimetre at the distance of the face."""
        return float(self.skin.shape[1]) / WIDTH_M / 1000


def shot(light: str, yaw: float, size: int) -> Shot:
    """The camera of all photos."""
    fov = float(np.degrees(2 * np.arctan(WIDTH_M / 2 / DISTANCE_M)))
    return Shot(yaw, light, DISTANCE_M, fov, size, seed=7)


def taken(head: Sitter, view: Shot, out: Path) -> Taken:
    """The kept photo of a sitter, rendered where there is none."""
    file = out / f"detail_{head.name.replace(' ', '')}_{view.light}_{view.yaw:g}_{view.size}.npz"
    if not file.is_file():
        found = render(head, view, out)
        halves = {"radiance", "albedo", "normal"}
        fields = {name: value.astype(np.float16) if name in halves else value for name, value in vars(found).items()}
        part = file.with_name(f"{file.stem}.{os.getpid()}.part.npz")
        np.savez(part, **fields)
        part.replace(file)
    with np.load(file) as kept:
        fields = {name: kept[name] for name in kept.files}
    fields["axes"] = axes_of(view)
    return Taken(**{k: v if k in ("skin", "axes") else v.astype(np.float32) for k, v in fields.items()})


def render(head: Sitter, view: Shot, scratch: Path) -> Taken:
    """Render a sitter; ``scratch`` is a folder for meshes that are removed again."""
    mi = mitsuba()
    scene = mi.load_dict(_scene(mi, head, view, scratch))
    sensors = [mi.load_dict(_sensor(mi, view, strip)) for strip in strips(view.size)]
    path = mi.load_dict({"type": "path", "max_depth": 4})
    radiance = _rendered(mi, scene, sensors, path, samples(view.size))[..., :3]
    wanted = "p:position,n:sh_normal,u:uv,d:dp_du"
    found = _rendered(mi, scene, sensors, mi.load_dict({"type": "aov", "aovs": wanted}), 1)[..., -11:]
    position, base, uv, along = np.split(found, [3, 6, 8], -1)
    colours = mi.load_dict({"type": "aov", "aovs": "a:albedo"})
    albedo = _rendered(mi, scene, sensors, colours, samples(view.size))[..., -3:]
    apart = np.stack([np.linalg.norm(position - eye, axis=-1) for eye in head.eyes]).min(0)
    skin = (np.linalg.norm(base, axis=-1) > 0.9) & (apart > 1.05 * head.eye_radius)
    normal = _with_relief(head, base, along, uv)
    return Taken(calm(radiance, albedo, normal, skin), albedo, normal, position, skin, axes_of(view))


GUIDED = 9
"""Side in pixels of the windows in which light is taken for a linear function of the normal."""
CALMED_ROWS = 512
"""Rows at a time."""
RIDGE = 2e-4
"""Variance of normals below which they tell nothing."""


def calm(radiance: Single, albedo: Single, normal: Single, skin: npt.NDArray[np.bool_]) -> Single:
    """Radiance (H, W, 3) without the renderer's noise: over the albedo it is light, and that depends on the normal.

    Irradiance is a smooth function of the normal, which in a small window is taken for a linear one (the guided filter
    of He et al. 2013 with the normals as its guide). So relief keeps its shade and colour its edges.
    """
    calmed = np.empty_like(radiance)
    for top in range(0, len(radiance), CALMED_ROWS):
        rows = slice(max(top - GUIDED, 0), top + CALMED_ROWS + GUIDED)
        part = _calm_rows(radiance[rows], albedo[rows], normal[rows], skin[rows])
        calmed[top : top + CALMED_ROWS] = part[top - rows.start :][:CALMED_ROWS]
    return calmed


def _calm_rows(radiance: Single, albedo: Single, normal: Single, skin: npt.NDArray[np.bool_]) -> Single:
    import cv2

    weight = skin.astype(np.float32)

    def mean(image: npt.NDArray[np.floating]) -> Single:
        return np.asarray(cv2.boxFilter(image.astype(np.float32), -1, (GUIDED, GUIDED)), np.float32)

    whole = np.maximum(mean(weight), 1e-3)[..., None]

    def inside(image: npt.NDArray[np.floating]) -> Single:
        found = mean(image * weight[..., None])
        return np.asarray((found if found.ndim == 3 else found[..., None]) / whole, np.float32)

    light = radiance / np.maximum(albedo, 0.02)
    guide: Single = np.concatenate([normal, np.ones((*skin.shape, 1), np.float32)], -1)
    square = inside((guide[..., :, None] * guide[..., None, :])[..., _UPPER[0], _UPPER[1]])
    matrix = np.zeros((*skin.shape, 4, 4), np.float32)
    matrix[..., _UPPER[0], _UPPER[1]] = matrix[..., _UPPER[1], _UPPER[0]] = square
    matrix += np.diag([RIDGE, RIDGE, RIDGE, 1e-6]).astype(np.float32)
    calmed = radiance.copy()
    for channel in range(3):
        target = inside(guide * light[..., channel : channel + 1])
        slope = np.linalg.solve(matrix, target[..., None])[..., 0]
        smooth = (inside(slope) * guide).sum(-1)
        calmed[..., channel] = np.where(skin, smooth * np.maximum(albedo[..., channel], 0.02), radiance[..., channel])
    return np.maximum(calmed, 0)


_UPPER = np.triu_indices(4)


def axes_of(view: Shot) -> npt.NDArray[np.float64]:
    """(3, 3) rows: right, down and forward of a camera."""
    forward = (view.target - view.origin) / np.linalg.norm(view.target - view.origin)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def samples(size: int) -> int:
    """Paths per pixel of a square picture."""
    return max(SAMPLES * LARGE**2 // max(size, LARGE) ** 2, LEAST_SAMPLES)


def strips(size: int) -> list[tuple[int, int]]:
    """First row and number of rows of the strips that a square picture is rendered in."""
    rows = max(MOST_PATHS // (samples(size) * size), 1)
    return [(top, min(rows, size - top)) for top in range(0, size, rows)]


def _rendered(mi: Any, scene: Any, sensors: list[Any], integrator: Any, samples: int) -> Single:
    parts = [mi.render(scene, sensor=sensor, integrator=integrator, spp=samples) for sensor in sensors]
    return np.concatenate([np.array(part, np.float32) for part in parts])


def _sensor(mi: Any, view: Shot, strip: tuple[int, int]) -> dict[str, Any]:
    """The camera of some rows of the picture."""
    camera = mi.ScalarTransform4f().look_at(origin=view.origin.tolist(), target=view.target.tolist(), up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": view.size, "height": view.size, "rfilter": {"type": "box"}}
    if strip[1] < view.size:
        film |= {"crop_offset_x": 0, "crop_offset_y": strip[0], "crop_width": view.size, "crop_height": strip[1]}
    sampler = {"type": "multijitter", "sample_count": samples(view.size)}
    return {"type": "perspective", "fov": view.fov, "to_world": camera, "film": film, "sampler": sampler}


def _with_relief(head: Sitter, base: Single, along: Single, uv: Single) -> Single:
    """(H, W, 3) unit normals: those of the texture in the frame that Mitsuba builds on the mesh's."""
    import cv2

    height, width = head.normal.shape[:2]
    at = np.array([width, height], np.float32) * uv - np.float32(0.5)  # v counts down here
    local = cv2.remap(head.normal.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    tangent = along - base * (base * along).sum(-1, keepdims=True)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-9)
    axes = (tangent, np.cross(base, tangent), base)
    normal: Single = sum(local[..., k : k + 1] * axis for k, axis in enumerate(axes))
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9), np.float32)


def _scene(mi: Any, head: Sitter, view: Shot, scratch: Path) -> dict[str, Any]:
    def bitmap(pixels: npt.NDArray[np.floating]) -> dict[str, Any]:
        return {"type": "bitmap", "bitmap": mi.Bitmap(pixels.astype(np.float32)), "raw": True}

    skin = {"type": "principled", "roughness": ROUGHNESS, "specular": SPECULAR, "base_color": bitmap(head.albedo)}
    relief = {"type": "normalmap", "normalmap": bitmap(head.normal * 0.5 + 0.5), "b": skin}
    scene: dict[str, Any] = {
        "type": "scene",
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(environment(view.light, view.seed))},
        "head": _mesh(mi, head.vertices, head.triangles, head.uv, {"type": "twosided", "b": relief}),
    }
    for number, centre in enumerate(head.eyes):
        ball, faces, colours = eyeball(centre, head.eye_radius, np.array([0.06, 0.05, 0.05]))
        path = scratch / f"eye{number}.{os.getpid()}.ply"
        write_ply(path, ball, faces, colours)
        colour = {"type": "mesh_attribute", "name": "vertex_color"}
        wet = {"type": "principled", "roughness": 0.1, "specular": 0.5, "base_color": colour}
        scene[f"eye{number}"] = mi.load_dict({"type": "ply", "filename": str(path), "bsdf": wet})
        path.unlink()
    for number, (where, radius, radiance) in enumerate(lamps_of(view.light, view.seed)):
        scene[f"lamp{number}"] = {
            "type": "sphere", "center": list(where), "radius": radius, "emitter": emitter(radiance),
        }  # fmt: skip
    return scene


def _mesh(mi: Any, vertices: npt.NDArray[np.float64], triangles: npt.NDArray[np.int64],
          uv: npt.NDArray[np.float64], bsdf: dict[str, Any]) -> Any:  # fmt: skip
    """A Mitsuba mesh with normals and texture coordinates; v is turned to count down, as its bitmaps do."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    mesh = mi.Mesh("head", len(vertices), len(triangles), has_vertex_normals=True, has_vertex_texcoords=True,
                   props=properties)  # fmt: skip
    values = mi.traverse(mesh)
    values["vertex_positions"] = vertices.astype(np.float32).ravel()
    values["vertex_normals"] = vertex_normals(vertices, triangles).astype(np.float32).ravel()
    values["vertex_texcoords"] = (uv * [1, -1] + [0, 1]).astype(np.float32).ravel()
    values["faces"] = triangles.astype(np.uint32).ravel()
    values.update()
    mesh.set_id("head")
    return mesh
