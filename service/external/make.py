"""Reflectance for a head of one's own: texture and mesh in, the same stages and the same archive out.

::

    texture --gate--> T --(zeta)--> delta --> ...  as in service.reflectance.make
    mesh --check--> vertices --> geometry channels

No photo is looked at and nothing is fitted; the manifest says so.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import numpy.typing as npt

from service.archive.avatar import Avatar, Given
from service.archive.cards import model_cards
from service.archive.read_obj import read_obj
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
from service.runtime.networks import choose_engine
from service.texture.result import Texture
from service.texture.shape import depth_map, shape_normals

LIMITS = Limits(max_bytes=200_000_000, max_aspect=2.0, cpu_seconds=60, wall_seconds=120.0)
"""Textures are larger than photos, and nearly 3:2."""

WIDEST = 6144

NOT_MADE = ("confidence",)
"""Maps that speak of a photo."""

_OPTIONS = ("maps", "quality", "size", "bits", "normals", "runtime", "detail", "seed")


def default_maps() -> tuple[str, ...]:
    """Every map that a texture and a mesh can give."""
    return tuple(
        name for name in MAP_NAMES
        if name not in NOT_MADE and installed(Plan.of([name], super_resolution=False).networks)
    )  # fmt: skip


def make_own(
    texture: bytes,
    mesh: bytes,
    options: Options,
    progress: Progress = lambda stage, done: None,
    head_file: Path | None = None,
) -> Avatar:
    """Make the maps of a head from its texture and mesh.

    Args:
        texture: a JPEG, PNG or WebP file on the head's chart, 3:2, light baked in.
        mesh: an OBJ file with the head model's topology and chart.
        options: what to make; those that speak of a photo are not looked at.
        progress: told when a stage begins.
        head_file: head model that the mesh belongs to; None for the one in the box.

    Raises:
        UsageError: a map is asked for that only a photo gives.
        BadMesh: the mesh is not on the model's topology and chart.
        UnreadableInput: the texture cannot be decoded, or is not 3:2.
        AvatarError: whatever a stage finds wrong.
    """
    refused = [name for name in options.maps if name in NOT_MADE]
    if refused:
        raise UsageError(f"maps has {refused[0]!r}, which speaks of a photo; without one there is none", field="maps")
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
    source = _filled(subject, _fitting(image.pixels, (min(image.size[0], WIDEST), 0) if fine else TEXTURE_SIZE))
    made = _texture(source, head, vertices, options.texture_size)
    timings["texture"] = time.perf_counter() - begin
    # What is finer than zeta's input keeps its own detail.
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
        given=Given.of(texture, mesh, image.size),
        timings_s=timings,
        peak_rss_mb=peak_rss_mb(),
    )


def unfitted(head: HeadModel, vertices: npt.NDArray[np.float32]) -> Fit:
    """The shape alone, at rest; camera, light and errors of this fit mean nothing and are written nowhere."""
    camera = Camera(1, 1, 1.0, np.zeros(2), np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.2]))
    still = np.zeros(len(head.expression_names))
    return Fit(camera, np.zeros(0), still, vertices, vertices, None, 0.0, 0.0)


def check_aspect(width: int, height: int) -> None:
    """Refuse a texture that is not 3:2, to the pixel.

    Raises:
        BadAspect: states the size and the nearest one that is right.
    """
    if abs(2 * width - 3 * height) > 3:
        raise BadAspect(
            f"the texture is {width} x {height} pixels; the chart is 3:2, for example {width} x {round(width * 2 / 3)}",
            width=width, height=height,
        )  # fmt: skip


def _warnings(image: Photo) -> tuple[str, ...]:
    """What the gate noticed, but for what matters to photos only."""
    return tuple(code for code in image.warnings if code != "focal-ignored")


def _fitting(pixels: npt.NDArray[np.uint8], size: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """(H, W, 3) of a width and two thirds of it, by area where that is smaller."""
    import cv2

    width = size[0] // 3 * 3
    wanted = (width, width // 3 * 2)
    if wanted == (pixels.shape[1], pixels.shape[0]):
        return pixels
    way = cv2.INTER_AREA if width < pixels.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(pixels, wanted, interpolation=way), np.uint8)


def _filled(subject: Subject, pixels: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """The same with the colour of the nearest texel of the head outside its islands, whatever was painted there."""
    inside = subject.islands((pixels.shape[1], pixels.shape[0])) != NO_PART
    return np.asarray(pixels.reshape(-1, 3)[nearest_inside(inside)])


def _texture(
    source: npt.NDArray[np.uint8], head: HeadModel, vertices: npt.NDArray[np.float32], size: tuple[int, int]
) -> Texture:
    """The maps of a texture stage that need no photo, at a size."""
    chart = Chart.build(head, *size)
    exact, tangent = shape_normals(chart, vertices)
    for name, values in (("normals", exact), ("tangent normals", tangent)):
        if not np.isfinite(values).all():
            raise NumericFault(f"{name} of the mesh are not finite")
    everywhere = np.full(size[::-1], 255, np.uint8)
    depth = depth_map(chart, vertices)
    return Texture(_fitting(source, size), everywhere, everywhere, exact, tangent, depth, chart.mask, 1.0)
