"""Reflectance for an external head: its texture and mesh in, the same stages and the same archive out.

::

    texture --gate--> T --(zeta)--> delta --> ...  as in service.reflectance.make
    mesh --check--> vertices --> geometry channels

There is no photo and nothing is fitted; the manifest says so.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from service.archive.avatar import Avatar, Given
from service.archive.cards import model_cards
from service.archive.read_obj import read_obj
from service.arrays import Float32, UInt8
from service.diagnosis import peak_rss_mb
from service.errors import BadAspect, NumericFault, UsageError
from service.external.mesh import vertices_of
from service.face.face import Face
from service.face.fit.result import Fit
from service.geometry.camera import Camera
from service.geometry.chart import NO_PART, Chart, nearest_inside
from service.head.files import load_head
from service.head.model import HeadModel
from service.levels import TEXTURE_SIZE
from service.options import MAP_NAMES, Options, installed
from service.photo.gate import read_photo
from service.photo.limits import Limits
from service.photo.photo import Photo
from service.pipeline import Progress
from service.reflectance.make import make_reflectance
from service.reflectance.plan import Plan
from service.reflectance.subject import Subject
from service.reflectance.surface.make import surface_maps
from service.runtime.networks import choose_engine
from service.texture.result import Texture
from service.texture.shape import depth_map, shape_normals

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
        if name not in NOT_MADE and installed(Plan.of([name], super_resolution=False).networks)
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
    plain = Plan.of(options.maps, super_resolution=False, keep_cliffs=options.level.keep_cliffs)
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
        given=Given.of(texture, mesh, image.size),
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
