"""Reflectance for an external head: its texture and mesh in, the same stages and the same archive out.

::

    texture --gate--> T --(zeta)--> delta --> ...  as in service.reflectance.reflectance
    mesh --check--> vertices --> geometry channels

There is no photo and nothing is fitted; the manifest says so.
"""

from __future__ import annotations

import io
import time
import warnings
from hashlib import sha256
from pathlib import Path

import numpy as np

from service.archive.avatar import Avatar, model_cards
from service.arrays import Float32, Float64, Int64, UInt8
from service.errors import BadAspect, BadMesh, NumericFault, UsageError
from service.face.finder import Face
from service.face.fit.fit import Fit
from service.geometry.camera import Camera
from service.geometry.chart import NO_PART, Chart, nearest_inside
from service.geometry.nearest import Nearest
from service.head.files import load_head
from service.head.model import HeadModel
from service.image_filters import resized
from service.levels import TEXTURE_SIZE
from service.manifest import Given
from service.options import Options, default_maps
from service.photo.gate import read_photo
from service.photo.limits import Limits
from service.photo.photo import Photo
from service.pipeline import Progress
from service.reflectance.reflectance import make_reflectance
from service.reflectance.reflectance_plan import ReflectancePlan
from service.reflectance.subject import Subject
from service.reflectance.surface_maps import surface_maps
from service.runtime.networks import choose_engine
from service.texture.texture import Texture

CHART_TOLERANCE = 5e-4
"""Largest difference of texture coordinates, which exporters round to four decimals or more; the head model's closest
ones are 2.7e-4 apart, and where two are mistaken for each other their edges tell.
"""

SMALLEST_M, LARGEST_M = 0.1, 1.0
"""Height of a head with its neck; a mesh in another unit is off by a factor of ten or more."""

SEAM_M = 1e-5
"""Largest distance of the two sides of a seam, which are one vertex of the model."""

_START = "start from mesh/head.obj of an archive"


def mesh_type(name: str, data: bytes) -> str:
    """The format of a mesh file for ``trimesh``: by its name, and where that says nothing by its first bytes."""
    suffix = Path(name).suffix.lower().lstrip(".")
    return suffix or {b"glTF": "glb", b"ply\n": "ply", b"ply\r": "ply"}.get(data[:4], "obj")


def vertices_of(data: bytes, kind: str, head: HeadModel) -> Float32:
    """(V, 3) float32 vertices of a mesh file in metres, in the order of the head model.

    Each vertex is found by its texture coordinates, of which no two of the chart are the same. So vertices and faces
    may come in any order, split along seams and into triangles, as each format and exporter has it.

    BadMesh: it cannot be read, its chart or topology is not that of the model, or it is not in metres; says how.
    """
    points, uv, triangles = _read_mesh(data, kind)
    distance, row = Nearest(head.uv).one(uv)
    off = np.flatnonzero(distance > CHART_TOLERANCE)
    if len(off):
        raise BadMesh(
            f"the mesh's texture coordinates differ from those of the head model {head.name} by up to "
            f"{distance.max():.3f} ({len(off)} of {len(uv)}); maps belong to the model's chart: {_START}, keep its vt",
            worst=float(distance.max()),
        )  # fmt: skip
    owner = np.zeros(len(head.uv), np.int64)
    given = head.polygon_uv >= 0
    owner[head.polygon_uv[given]] = head.polygons[given]
    vertex = owner[row]
    missing = len(head.mean) - len(np.unique(vertex))
    if missing:
        raise BadMesh(
            f"the mesh lacks {missing} of the {len(head.mean)} vertices of the head model {head.name}; {_START}, and "
            "move vertices without removing or merging any",
            missing=missing,
        )
    _check_faces(vertex[triangles], head)
    found = np.zeros((len(head.mean), 3))
    found[vertex] = points
    height = float(np.ptp(found[:, 1]))
    if not SMALLEST_M <= height <= LARGEST_M:
        raise BadMesh(
            f"the head is {height:.4g} high; with neck it should be {SMALLEST_M:g} to {LARGEST_M:g} metres: export the "
            "mesh in metres, +Y up"
        )
    torn = float(np.abs(found[vertex] - points).max())
    if torn > SEAM_M:
        raise BadMesh(f"the mesh is torn open by {torn * 1000:.2g} mm along a seam of its chart; weld it, and {_START}")
    return found.astype(np.float32)


def _read_mesh(data: bytes, kind: str) -> tuple[Float64, Float64, Int64]:
    """(P, 3) points, (P, 2) texture coordinates with the origin bottom left, and (T, 3) triangles of a mesh file.

    BadMesh: it cannot be read, has no faces, or faces without texture coordinates.
    """
    import trimesh

    points, charts, triangles, count = [], [], [], 0
    try:
        with warnings.catch_warnings(action="ignore"):
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False)
        for node in scene.graph.nodes_geometry:
            transform, name = scene.graph[node]
            mesh = scene.geometry[name]
            uv = getattr(mesh.visual, "uv", None)
            if uv is None:
                raise BadMesh(f"the mesh has faces without texture coordinates (vt); {_START}, and keep its vt")
            points.append(trimesh.transform_points(mesh.vertices, transform))
            charts.append(np.asarray(uv, np.float64))
            triangles.append(np.asarray(mesh.faces, np.int64) + count)
            count += len(mesh.vertices)
    except BadMesh:
        raise
    except Exception as error:  # whatever a reader of some format raises
        raise BadMesh(f"the mesh cannot be read as {kind.upper()}: {type(error).__name__}: {error}") from error
    if not triangles:
        raise BadMesh(f"the {kind.upper()} file has no faces; a mesh is expected")
    found = np.concatenate(points), np.concatenate(charts)
    if not all(np.isfinite(values).all() for values in found):
        raise BadMesh("the mesh has coordinates that are not finite")
    return *found, np.concatenate(triangles)


def _check_faces(triangles: Int64, head: HeadModel) -> None:
    """BadMesh where triangles (T, 3) of the model's vertices lack one of its edges; quads may be split either way."""
    sides = [(0, 1), (1, 2), (2, 0)]
    have = np.concatenate([triangles[:, pair] for pair in sides])
    polygons = np.asarray(head.polygons, np.int64)
    quads = polygons[:, 3] >= 0
    parts = [polygons[~quads][:, pair] for pair in sides]
    parts += [polygons[quads][:, pair] for pair in [(0, 1), (1, 2), (2, 3), (3, 0)]]
    wanted = np.unique(np.sort(np.concatenate(parts), 1), axis=0)
    keys, there = (pairs[:, 0] << 32 | pairs[:, 1] for pairs in (wanted, np.sort(have, 1)))
    missing = len(wanted) - int(np.isin(keys, there).sum())
    if missing or len(triangles) != len(head.triangles):
        raise BadMesh(
            f"the mesh has other faces than the head model {head.name}: {missing} of its {len(wanted)} edges are "
            f"missing, {len(triangles)} triangles instead of {len(head.triangles)}; {_START}, and keep its topology",
            edges_missing=missing,
        )


LIMITS = Limits(max_bytes=200_000_000, max_aspect=2.0, cpu_seconds=60, wall_seconds=120.0)
"""Limits of texture files, which are larger than photos and have an aspect of 3:2."""

WIDEST = 6144
"""Width in pixels to which wider textures are reduced."""

NOT_MADE = ("confidence",)
"""Maps that only a photo gives."""

_OPTIONS = ("maps", "quality", "size", "bits", "normals", "runtime", "detail", "seed")


def external_maps() -> tuple[str, ...]:
    """Every map that can be made from a texture and a mesh with the installed networks."""
    return tuple(name for name in default_maps() if name not in NOT_MADE)


def make_external(
    texture: bytes,
    mesh: bytes,
    options: Options,
    progress: Progress = lambda stage, done: None,
    head_file: Path | None = None,
    kind: str = "obj",
) -> Avatar:
    """Make the maps of a head from its texture and mesh.

    Args:
        texture: a JPEG, PNG or WebP file on the head's chart, 3:2, with light baked in.
        mesh: a mesh file with the head model's topology and chart, of any format that ``trimesh`` reads.
        options: what to make; those that concern a photo are ignored.
        progress: called with its name and the share done when a stage begins.
        head_file: head model that the mesh belongs to; None for the shipped one.
        kind: format of the mesh, as :func:`mesh_type` gives it.

    Raises:
        UsageError: a map is requested that only a photo gives.
        BadMesh, UnreadableInput, BadAspect: the mesh or the texture cannot be used.
        AvatarError: a stage fails.
    """
    refused = [name for name in options.maps if name in NOT_MADE]
    if refused:
        raise UsageError(f"maps has {refused[0]!r}, which can only be made from a photo; leave it out", field="maps")
    timings: dict[str, float] = {}
    begin = time.perf_counter()
    progress("mesh", 0.0)
    head = load_head(head_file)
    vertices = vertices_of(mesh, kind, head)
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
    plain = ReflectancePlan.of(options.maps, super_resolution=False)
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
        photo=Photo(image.pixels, None, image.sha256, tuple(w for w in image.warnings if w != "focal-ignored")),
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
    )


def unfitted(head: HeadModel, vertices: Float32) -> Fit:
    """A fit that holds the shape alone, without expression; its camera, light and errors are placeholders, never
    written.
    """
    camera = Camera(1, 1, 1.0, np.zeros(2), np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.2]))
    still = np.zeros(len(head.expression_names))
    return Fit(camera, np.zeros(0), still, vertices, vertices, None, 0.0, 0.0)


def check_aspect(width: int, height: int) -> None:
    """BadAspect where a texture is not 3:2, to the pixel; states the size and the nearest valid one."""
    if abs(2 * width - 3 * height) > 3:
        raise BadAspect(
            f"the texture is {width} x {height} pixels; the chart is 3:2, for example {width} x {round(width * 2 / 3)}",
            width=width, height=height,
        )  # fmt: skip


def _resized(pixels: UInt8, size: tuple[int, int]) -> UInt8:
    """(H, W, 3) resized to the width of ``size``, as a multiple of 3, and 2/3 of it: by area down, linearly up."""
    thirds = size[0] // 3
    wanted = (3 * thirds, 2 * thirds)
    return pixels if wanted == pixels.shape[1::-1] else resized(pixels, wanted)


def _padded(subject: Subject, pixels: UInt8) -> UInt8:
    """(H, W, 3) with texels outside the head's islands replaced by the nearest one inside."""
    inside = subject.islands((pixels.shape[1], pixels.shape[0])) != NO_PART
    return np.asarray(pixels.reshape(-1, 3)[nearest_inside(inside)])


def _texture(source: UInt8, head: HeadModel, vertices: Float32, size: tuple[int, int]) -> Texture:
    """Result of the texture stage at a size (width, height), without what needs a photo."""
    chart = Chart.build(head, *size)
    normals = chart.fill_outside(chart.normals(vertices))
    if not np.isfinite(normals).all():
        raise NumericFault("normals of the mesh are not finite")
    everywhere = np.full(size[::-1], 255, np.uint8)
    return Texture(_resized(source, size), everywhere, everywhere, normals, chart.mask, 1.0)
