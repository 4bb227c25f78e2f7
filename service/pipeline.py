"""From the bytes of a photo to an avatar: the whole program on one page.

::

    bytes --gate--> Photo --find--> Face --read--> Reading --fit--> Fit --compare styles--> Hair
    Fit, Hair --unwrap, complete--> Texture
    Texture --networks--> Reflectance
        +---compare-----> Similarity

It runs one way; each stage takes what it names and returns new things. ``service.reflectance.reflectance`` has the
networks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path

from service.anatomy.eye_meshes import eye_parts
from service.anatomy.hair.find_hair import find_hair
from service.anatomy.hair.worn import worn
from service.anatomy.mouth_meshes import mouth_parts
from service.archive.avatar import Avatar, Similarity
from service.archive.licences import model_cards
from service.budget import within_budget
from service.diagnosis import peak_rss_mb
from service.face.face import Face, choose_face
from service.face.finder import FaceFinder
from service.face.fit.fit_face import fit_face
from service.face.identity import Recogniser
from service.face.profile import faces_by_reading
from service.face.reading.read import Readers, read_face
from service.geometry.chart import Chart
from service.head.files import load_head
from service.head.model import HeadModel
from service.likeness import likeness
from service.materials.part import coarser
from service.options import Options, installed
from service.photo.gate import read_photo
from service.reflectance.reflectance import make_reflectance
from service.reflectance.subject import Subject
from service.reflectance.surface_maps import surface_maps
from service.runtime.networks import choose_engine, loading_ahead
from service.runtime.tiles import DEFAULT_TILE
from service.stage_cache import Stages, Unkept
from service.texture.photo_detail import OwnDetail, own_texture_of
from service.texture.texture import make_texture

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of the work that is done, in [0, 1]."""

STAGES = {"decode": 0.15, "detect": 0.35, "fit": 0.55, "hair": 0.6, "texture": 0.75, "compare": 0.85}
"""Stages before the networks in their order, with the share of the work done after each; the rest is writing."""

SMALL_TILES = "small-tiles"
"""Warning: the networks saw smaller tiles than usual."""

BEFORE_NETWORKS = 0.1
"""What the stages above are of the whole where the networks run too; writing is as much again."""


READERS = ("reader", "lids", "lips", "face_landmarker", "face_blendshapes", "person")
"""Networks that read a face; without them the fit follows landmarks, outline and shading."""


def make_avatar(
    data: bytes,
    options: Options,
    progress: Progress = lambda stage, done: None,
    head_file: Path | None = None,
    stages: Stages = Unkept(),  # noqa: B008 - holds nothing
    tile: int = DEFAULT_TILE,
) -> Avatar:
    """Make an avatar from the bytes of an image file.

    Args:
        data: a JPEG, PNG or WebP file, or HEIC where the extra ``heic`` is installed.
        options: what to make.
        progress: told when a stage begins.
        head_file: head model to fit; None for the one in the box.
        stages: keeps the results of finished stages for a run that was cut off and begins again.
        tile: inner side of the tiles that networks see, in texels. Smaller ones take less memory and more time; no
            texel changes by more than rounding, and the warning ``small-tiles`` says that bytes may.

    Raises:
        AvatarError: any of its subclasses; see ``service.errors``.
    """
    timings: dict[str, float] = {}
    options, warnings = within_budget(options, stages)
    plan = options.plan()
    if plan.stages and tile < DEFAULT_TILE:
        warnings += (SMALL_TILES,)
    scale = BEFORE_NETWORKS if plan.stages else 1.0

    @contextmanager
    def stage(name: str) -> Iterator[None]:
        order = list(STAGES)
        progress(name, scale * STAGES[order[order.index(name) - 1]] if name != order[0] else 0.0)
        begin = time.perf_counter()
        yield
        timings[name] = time.perf_counter() - begin

    engine = choose_engine(options.runtime, precision=options.level.precision)
    # The gate decodes in a process of its own; meanwhile this one loads what the later stages need.
    with ThreadPoolExecutor(3) as pool, ExitStack() as held:
        finder_job = pool.submit(FaceFinder)
        recogniser_job = pool.submit(Recogniser)
        reads = options.fit != "landmarks" and installed(READERS)
        reader_job = pool.submit(Readers) if reads else None
        head_job = pool.submit(_head_and_chart, options, head_file)
        pool.submit(import_module, "scipy.optimize")
        with stage("decode"):
            photo = stages.keep("decode", lambda: read_photo(data))
        with stage("detect"):

            def find() -> Face:
                faces = finder_job.result().find(photo.pixels)
                if not faces and reader_job is not None:
                    doubted = finder_job.result().doubted(photo.pixels)
                    faces = faces_by_reading(photo.pixels, doubted, head_job.result()[0], reader_job.result().pixels)
                return choose_face(faces, options.face, photo.size)

            face = stages.keep("detect", find)
        # Only now, as many a photo is refused; and not at all where tiles are small, for want of memory.
        early = plan.networks if tile >= DEFAULT_TILE else ()
        engine = held.enter_context(loading_ahead(early, engine))
        with stage("fit"):
            head, chart = head_job.result()
            reading = None
            if reader_job is not None:
                reading = stages.keep("read", lambda: read_face(photo.pixels, face.landmarks, reader_job.result()))
            fit = stages.keep("fit", lambda: fit_face(face, photo, head, options.fit_settings(), reading))
        with stage("hair"):
            hair = stages.keep("hair", lambda: find_hair(photo, head, fit, reading, options.hair))
        with stage("texture"):
            make = lambda: make_texture(photo, head, fit, chart, reading, hair)  # noqa: E731
            texture = stages.keep("texture", make)

        def compare(recogniser: Recogniser) -> Similarity:
            parts = worn(hair, head, fit, texture.texture, texture.lit_skin, None, brows=False)
            return likeness(photo, face, head, fit, texture.texture, recogniser, parts)

        with stage("compare"):
            similarity = stages.keep("compare", lambda: compare(recogniser_job.result()))
        reflectance, own_texture, own = None, None, None
        if options.level.super_resolution or options.texture_size != "auto":
            own = OwnDetail.of(photo, head, fit, texture)
            if "texture" in options.maps:
                asked = options.texture_size
                wanted = own.texture_size(options.most_texture_width) if asked == "auto" else asked
                own_texture = stages.keep("own_texture", lambda: own_texture_of(texture, own, wanted))
        if plan.stages:
            reflectance = make_reflectance(
                texture.texture,
                Subject.in_photo(head, fit, texture),
                plan,
                options.map_size,
                engine,
                seed=options.seed,
                detail=options.detail,
                without=options.without,
                own=own if options.level.super_resolution else None,
                tile=tile,
                progress=lambda name, done: progress(name, scale + (1 - 2 * scale) * done),
                stages=stages,
            )
            timings |= reflectance.timings_s
        surface = surface_maps(head, fit.vertices, reflectance, options.maps, options.map_size)
    albedo = None if reflectance is None else reflectance.diffuse_albedo
    parts = worn(hair, head, fit, texture.texture, texture.lit_skin, albedo, brows=options.level.fine_mesh)
    parts += (*mouth_parts(head, fit, texture.parts), *eye_parts(head, fit, texture.iris))
    parts = coarser(parts, options.level.part_texture_step)
    return Avatar(
        photo=photo,
        face=face,
        head=head,
        fit=fit,
        texture=texture,
        options=options.to_json(),
        seed=options.seed,
        models=model_cards(head, head_file, plan.networks),
        parts=parts,
        hair=hair,
        similarity=similarity,
        reflectance=reflectance,
        surface=surface,
        own_texture=own_texture,
        warnings=warnings,
        timings_s=timings,
        peak_rss_mb=peak_rss_mb(),
    )


def _head_and_chart(options: Options, head_file: Path | None) -> tuple[HeadModel, Chart]:
    head = load_head(head_file)
    return head, Chart.build(head, *options.base_size)
