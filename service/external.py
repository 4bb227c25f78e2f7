"""Reflectance for an external head: its texture and mesh in, the same stages and the same archive out.

::

    texture --gate--> T --(zeta)--> delta --> ...  as in service.reflectance.reflectance
    mesh --check--> vertices --> geometry channels

There is no photo and nothing is fitted; the manifest says so.
"""

from __future__ import annotations

import time
from hashlib import sha256
from pathlib import Path

import numpy as np

from service.archive.avatar import Avatar
from service.archive.licences import model_cards
from service.archive.manifest import Given
from service.archive.read_obj import ObjMesh, read_obj
from service.arrays import AnyFloat, AnyInt, Float32, Float64, Int64, UInt8
from service.diagnosis import peak_rss_mb
from service.errors import BadAspect, BadMesh, NumericFault, UsageError
from service.face.face import Face
from service.face.fit.result import Fit
from service.geometry.camera import Camera
from service.geometry.chart import NO_PART, Chart, nearest_inside
from service.head.files import load_head, split_polygons
from service.head.model import HeadModel
from service.levels import TEXTURE_SIZE
from service.map_registry import MAP_NAMES
from service.options import Options, installed
from service.photo.gate import read_photo
from service.photo.limits import Limits
from service.photo.photo import Photo
from service.pipeline import Progress
from service.reflectance.reflectance import make_reflectance
from service.reflectance.reflectance_plan import ReflectancePlan
from service.reflectance.subject import Subject
from service.reflectance.surface_maps import surface_maps
from service.runtime.networks import choose_engine
from service.texture.texture_maps import Texture, depth_map, shape_normals

CHART_TOLERANCE = 2e-3
"""Largest difference of texture coordinates, which exporters round; a texel of a chart 576 texels wide is 1.7e-3."""

SMALLEST_M, LARGEST_M = 0.1, 1.0
"""Height of a head with its neck; a mesh in another unit is off by a factor of ten or more."""


def vertices_of(mesh: ObjMesh, head: HeadModel) -> Float32:
    """(V, 3) float32 vertices of a mesh in the order of the head model.

    Faces may come in any order, begin at any corner and be split into triangles; vertices have to be in the model's
    order, as in ``mesh/head.obj`` of every archive.

    Raises:
        BadMesh: number of vertices, faces or chart differ, or it is not in metres; says how.
    """
    if len(mesh.vertices) != len(head.mean):
        raise BadMesh(
            f"the mesh has {len(mesh.vertices)} vertices, the head model {head.name} has {len(head.mean)}; start from "
            "mesh/head.obj of an archive, and move vertices without adding, removing or merging any",
            vertices=len(mesh.vertices), wanted=len(head.mean),
        )  # fmt: skip
    _check_faces(mesh, head)
    _check_chart(mesh, head)
    height = float(np.ptp(mesh.vertices[:, 1]))
    if not SMALLEST_M <= height <= LARGEST_M:
        raise BadMesh(
            f"the head is {height:.4g} high; with neck it should be {SMALLEST_M:g} to {LARGEST_M:g} metres: export the "
            "mesh in metres, +Y up"
        )
    return mesh.vertices.astype(np.float32)


def _check_faces(mesh: ObjMesh, head: HeadModel) -> None:
    """Check that the mesh has all edges of the model's faces and as many triangles; quads may be split.

    Raises:
        BadMesh: it has not.
    """
    wanted = _edges(head.polygons)
    missing = len(wanted) - int(np.isin(wanted, _edges(mesh.polygons)).sum())
    triangles = len(split_polygons(mesh.polygons))
    if missing or triangles != len(head.triangles):
        raise BadMesh(
            f"the mesh has other faces than the head model {head.name}: {missing} of its {len(wanted)} edges are "
            f"missing, {triangles} triangles instead of {len(head.triangles)}; start from mesh/head.obj of an archive "
            "and keep its topology",
            edges_missing=missing,
        )


def _edges(polygons: AnyInt) -> Int64:
    """Sorted, distinct directed edges of polygons (P, 4), each as one integer."""
    return _by_edge(polygons, np.zeros_like(polygons), np.zeros((1, 2)))[0]


def _check_chart(mesh: ObjMesh, head: HeadModel) -> None:
    """Check that every corner has the model's chart coordinates; a vertex on a seam has several, by face.

    Raises:
        BadMesh: a corner has none or others.
    """
    if (mesh.polygon_uv[:, :3] < 0).any():
        raise BadMesh("the mesh has faces without texture coordinates (vt); export it with those of mesh/head.obj")
    wanted, found = (_by_edge(polygons, chart, uv) for polygons, chart, uv in (
        (head.polygons, head.polygon_uv, head.uv), (mesh.polygons, mesh.polygon_uv, mesh.uv),
    ))  # fmt: skip
    shared = np.isin(found[0], wanted[0])
    place = np.searchsorted(wanted[0], found[0][shared])
    off = np.abs(found[1][shared] - wanted[1][place]).max(1)
    worst = float(off.max(initial=0.0))
    if worst > CHART_TOLERANCE:
        corners = int((off > CHART_TOLERANCE).sum())
        raise BadMesh(
            f"the mesh's texture coordinates differ from the head model's by up to {worst:.3f} ({corners} corners); "
            "maps belong to the model's chart: keep the vt of mesh/head.obj",
            worst=worst,
        )


def _by_edge(
    polygons: AnyInt, chart: AnyInt, uv: AnyFloat
) -> tuple[Int64, Float64]:
    """(E,) sorted directed edges as integers, and (E, 2) chart coordinates of the corner at which each begins.

    Args:
        polygons: (P, 4) vertices; the fourth is -1 in triangles.
        chart: (P, 4) rows of ``uv``.
        uv: (U, 2) chart coordinates.
    """
    corners, at = np.asarray(polygons, np.int64), np.asarray(chart, np.int64)
    quad = corners[:, 3] >= 0
    last = np.where(quad, corners[:, 3], corners[:, 2])
    last_at = np.where(quad, at[:, 3], at[:, 2])
    starts = np.concatenate([corners[:, 0], corners[:, 1], corners[quad][:, 2], last])
    stops = np.concatenate([corners[:, 1], corners[:, 2], corners[quad][:, 3], corners[:, 0]])
    places = np.concatenate([at[:, 0], at[:, 1], at[quad][:, 2], last_at])
    keys, first = np.unique((starts << 32) | stops, return_index=True)
    return keys, np.asarray(uv, np.float64)[places[first]]


LIMITS = Limits(max_bytes=200_000_000, max_aspect=2.0, cpu_seconds=60, wall_seconds=120.0)
"""Limits of texture files, which are larger than photos and have an aspect of 3:2."""

WIDEST = 6144
"""Width in pixels to which wider textures are reduced."""

NOT_MADE = ("confidence",)
"""Maps that only a photo gives."""

_OPTIONS = ("maps", "quality", "size", "bits", "normals", "runtime", "detail", "seed")


def default_maps() -> tuple[str, ...]:
    """Every map that can be made from a texture and a mesh with the installed networks."""
    return tuple(
        name for name in MAP_NAMES
        if name not in NOT_MADE and installed(ReflectancePlan.of([name], super_resolution=False).networks)
    )  # fmt: skip


def make_external(
    texture: bytes,
    mesh: bytes,
    options: Options,
    progress: Progress = lambda stage, done: None,
    head_file: Path | None = None,
) -> Avatar:
    """Make the maps of a head from its texture and mesh.

    Args:
        texture: a JPEG, PNG or WebP file on the head's chart, 3:2, with light baked in.
        mesh: an OBJ file with the head model's topology and chart.
        options: what to make; those that concern a photo are ignored.
        progress: called with its name and the share done when a stage begins.
        head_file: head model that the mesh belongs to; None for the shipped one.

    Raises:
        UsageError: a map is requested that only a photo gives.
        BadMesh: the mesh is not on the model's topology and chart.
        UnreadableInput: the texture cannot be decoded.
        BadAspect: the texture is not 3:2.
        AvatarError: a stage fails.
    """
    refused = [name for name in options.maps if name in NOT_MADE]
    if refused:
        raise UsageError(f"maps has {refused[0]!r}, which can only be made from a photo; leave it out", field="maps")
    timings: dict[str, float] = {}
    begin = time.perf_counter()
    progress("mesh", 0.0)
    head = load_head(head_file)
    vertices = vertices_of(read_obj(mesh), head)
    timings["mesh"], begin = time.perf_counter() - begin, time.perf_counter()
    progress("decode", 0.03)
    image = read_photo(texture, LIMITS)
    check_aspect(*image.size)
    timings["decode"], begin = time.perf_counter() - begin, time.perf_counter()
    progress("texture", 0.06)
    fine = image.size[0] > TEXTURE_SIZE[0]
    subject = Subject.of(head, vertices)
    source = _padded(subject, _resized(image.pixels, (min(image.size[0], WIDEST), 0) if fine else TEXTURE_SIZE))
    made = _texture(source, head, vertices, options.base_size)
    timings["texture"] = time.perf_counter() - begin
    # A texture finer than the input of super-resolution keeps its own detail.
    plain = ReflectancePlan.of(options.maps, super_resolution=False, keep_cliffs=options.level.keep_cliffs)
    plan = plain if fine else options.plan()
    reflectance = None
    if plan.stages:
        engine = choose_engine(options.runtime, precision=options.level.precision)
        reflectance = make_reflectance(
            source, subject, plan, options.map_size, engine, seed=options.seed, detail=options.detail,
            progress=lambda name, done: progress(name, 0.1 + 0.8 * done),
        )  # fmt: skip
        timings |= reflectance.timings_s
    stated = options.to_json()
    return Avatar(
        photo=Photo(image.pixels, None, image.sha256, _warnings(image)),
        face=Face(np.zeros(4), 0.0, np.zeros((6, 2)), np.zeros((468, 3)), 0.0),
        head=head,
        fit=unfitted(head, vertices),
        texture=made,
        options={name: stated[name] for name in _OPTIONS},
        seed=options.seed,
        models=model_cards(head, head_file, plan.networks, photo=False),
        reflectance=reflectance,
        surface=surface_maps(head, vertices, reflectance, options.maps, options.map_size),
        given=Given(sha256(texture).hexdigest(), sha256(mesh).hexdigest(), *image.size),
        timings_s=timings,
        peak_rss_mb=peak_rss_mb(),
    )


def unfitted(head: HeadModel, vertices: Float32) -> Fit:
    """A fit that holds the shape alone, without expression; its camera, light and errors are placeholders, never
    written.
    """
    camera = Camera(1, 1, 1.0, np.zeros(2), np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.2]))
    still = np.zeros(len(head.expression_names))
    return Fit(camera, np.zeros(0), still, vertices, vertices, None, 0.0, 0.0)


def check_aspect(width: int, height: int) -> None:
    """Check that a texture is 3:2, to the pixel.

    Raises:
        BadAspect: it is not; states the size and the nearest valid one.
    """
    if abs(2 * width - 3 * height) > 3:
        raise BadAspect(
            f"the texture is {width} x {height} pixels; the chart is 3:2, for example {width} x {round(width * 2 / 3)}",
            width=width, height=height,
        )  # fmt: skip


def _warnings(image: Photo) -> tuple[str, ...]:
    """Warnings of the gate, without those that concern photos only."""
    return tuple(code for code in image.warnings if code != "focal-ignored")


def _resized(pixels: UInt8, size: tuple[int, int]) -> UInt8:
    """(H, W, 3) resized to the width of ``size``, as a multiple of 3, and 2/3 of it: by area down, linearly up."""
    import cv2

    width = size[0] // 3 * 3
    wanted = (width, width // 3 * 2)
    if wanted == (pixels.shape[1], pixels.shape[0]):
        return pixels
    way = cv2.INTER_AREA if width < pixels.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(pixels, wanted, interpolation=way), np.uint8)


def _padded(subject: Subject, pixels: UInt8) -> UInt8:
    """(H, W, 3) with texels outside the head's islands replaced by the nearest one inside."""
    inside = subject.islands((pixels.shape[1], pixels.shape[0])) != NO_PART
    return np.asarray(pixels.reshape(-1, 3)[nearest_inside(inside)])


def _texture(
    source: UInt8, head: HeadModel, vertices: Float32, size: tuple[int, int]
) -> Texture:
    """Result of the texture stage at a size (width, height), without what needs a photo."""
    chart = Chart.build(head, *size)
    exact, tangent = shape_normals(chart, vertices)
    for name, values in (("normals", exact), ("tangent normals", tangent)):
        if not np.isfinite(values).all():
            raise NumericFault(f"{name} of the mesh are not finite")
    everywhere = np.full(size[::-1], 255, np.uint8)
    depth = depth_map(chart, vertices)
    return Texture(_resized(source, size), everywhere, everywhere, exact, tangent, depth, chart.mask, 1.0)
