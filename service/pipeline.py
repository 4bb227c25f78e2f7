"""From the bytes of photos of one person to an avatar: the whole program on one page.

::

    bytes --gate--> Photo --find--> Face --read--> Reading      for each photo
    Readings --fit--> Fits of one head --read, compare--> SeenHair --choose, grow--> WornHair
    Fits, SeenHair --unwrap, blend, complete--> Texture
    Texture --networks--> Reflectance
        +---compare-----> Similarity

It runs one way; each stage takes what it names and returns new things. ``service.reflectance.reflectance`` has the
networks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from service import ahead
from service.ahead import FaceNetworks
from service.anatomy.eyes import eye_parts
from service.anatomy.items import read_insets, read_items
from service.anatomy.mouth import mouth_parts
from service.anatomy.wearables import (
    BROWS,
    find_brows,
    hides_brows,
    in_albedo,
    made_up_brows,
    small_albedo,
    to_albedo,
    worn,
)
from service.archive.avatar import Avatar, Drawn, Shapes, Source, model_cards
from service.archive.pack import draw, draw_shapes
from service.budget import within_budget
from service.face.features.eye_colours import NAMED_IRISES
from service.face.features.mouth import with_mouth_shut
from service.face.finder import Face, choose_face
from service.face.identity import population
from service.face.profile import faces_by_reading
from service.face.several import Gathered, check_count, decoded, fitted, of_one_person, read_all, with_frames
from service.geometry.chart import islands
from service.hair.asked import NONE
from service.hair.bank import read_bank
from service.hair.beard import NAME as BEARD
from service.hair.beard import beard_cards, grow_beard
from service.hair.find_hair import grow_hair, see_hair
from service.hair.worn_hair import groom_in_albedo, hair_cards, hair_in_albedo, over_skin
from service.head.model import HeadModel
from service.levels import Size
from service.light.formulas import session
from service.likeness import likeness
from service.manifest import IdentitySimilarity
from service.materials.part import coarser
from service.options import Options
from service.photo.photo import Photo
from service.reflectance.albedo.albedo_prior import albedo_prior, error_model
from service.reflectance.reflectance import make_reflectance
from service.reflectance.reflectance_maps import Reflectance
from service.reflectance.relief.folds import AGES
from service.reflectance.subject import Subject, coarse_chart
from service.reflectance.surface_maps import flesh_mm, surface_maps
from service.runtime.networks import Ahead, choose_engine, loading_ahead
from service.runtime.tiles import DEFAULT_TILE, SMALL_MAP
from service.stage_cache import NoCache, StageCache
from service.texture.photo_detail import OwnDetail, own_texture_of
from service.texture.texture import Texture, Unwrappings, left_by_roots, make_texture

T = TypeVar("T")

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of the work that is done, in [0, 1]."""

STAGES = {"decode": 0.15, "detect": 0.35, "fit": 0.55, "hair": 0.6, "texture": 0.75, "compare": 0.85}
"""Stages before the networks in their order, with the share of the work done after each; the rest is writing."""

BEFORE_NETWORKS = 0.1
"""What the stages above are of the whole where the networks run too; writing is as much again."""

FIRST_ONLY = ("expression", "eyes", "hair")
"""What the first photo alone is used for."""
LEAST_SHARE = 0.005
"""Share of the seen texture below which a photo does not count as used for it."""


def make_avatar(
    data: bytes | Sequence[bytes],
    options: Options,
    progress: Progress = lambda stage, done: None,
    head_file: Path | None = None,
    stages: StageCache = NoCache(),  # noqa: B008 - holds nothing
    tile: int = DEFAULT_TILE,
    loaded: FaceNetworks | None = None,
) -> Avatar:
    """Make an avatar from the bytes of image files.

    Args:
        data: a JPEG, PNG or WebP file, or several that show one person, in any order; a video among them counts as its
            sharpest frames from each side.
        options: what to make.
        progress: told when a stage begins.
        head_file: head model to fit; None for the one in the box.
        stages: keeps the results of finished stages for a run that was cut off and begins again.
        tile: inner side of the tiles that networks see, in texels. Smaller ones take less memory and more time; no
            texel changes by more than rounding, and the warning ``small-tiles`` says that bytes may.
        loaded: networks of faces, loaded ahead for this one photo; None to load them now.

    Returns:
        The avatar; photos that were of no use are in ``left_out``, and the warning is ``photos-left-out``.

    Raises:
        AvatarError: any of its subclasses; see ``service.errors``. What concerns one of several photos has its number,
            from 0, in ``extra["photo"]``.
    """
    files = [data] if isinstance(data, bytes) else list(data)
    check_count(len(files))
    options, warnings = within_budget(options, stages)
    plan, kept = options.plan(), stages.get_or_compute
    if plan.stages and tile < DEFAULT_TILE:
        warnings += ("small-tiles",)
    early = plan.networks if tile >= DEFAULT_TILE else ()  # where tiles are small, memory is scarce
    engine = choose_engine(options.runtime, precision=options.level.precision)
    networks = FaceNetworks(options, head_file) if loaded is None else loaded
    reads = networks.reads and options.fit != "landmarks"
    stage = _Timed(progress, BEFORE_NETWORKS if plan.stages else 1.0)
    with ThreadPoolExecutor(4) as pool, ExitStack() as held:
        # The gate decodes in a process of its own; meanwhile this one loads what the later stages need.
        placed = pool.submit(ahead.head_and_chart, options.base_size, head_file, ahead.modes_of(options, len(files)))

        with stage("decode"):
            gathered = kept("decode", _decoded, files, networks)
        with stage("detect"):
            doubted = (options.base_size, head_file) if reads else None
            gathered = kept("detect", _detected, gathered, options.face, options.leave_out, networks, doubted)
        engine = held.enter_context(loading_ahead(early, engine, networks.maps()))  # only now: many are refused
        with stage("fit"):
            head, chart = placed.result()
            pool.submit(_read_tables, head, options.map_size)  # while the fit leaves a core idle
            if reads:
                gathered = kept("read", read_all, gathered, networks.readers(), head)
            gathered = kept("fit", fitted, gathered, head, options.fit_settings())
            photo, face, reading, fit = gathered.first
            if options.mouth == "shut":
                fit = with_mouth_shut(head, fit)
        with stage("hair"):
            # What needs no hair is made beside it.
            others = [(view.photo, other, view.reading) for view, other in gathered.others]
            known = pool.submit(Unwrappings.of, chart, [(photo, fit, reading), *others])
            subject = pool.submit(Subject.fitted, head, fit) if plan.stages else None
            small = options.map_size[0] * options.map_size[1] <= SMALL_MAP
            flesh = pool.submit(flesh_mm, head, fit.vertices) if "thickness" in options.maps and small else None
            wish = options.asked_hair()
            seen = see_hair(photo, head, fit, reading, wish, networks.hair() if reads else None)
            networks.drop(recogniser=False)
        wanted = seen, photo, fit, wish, options.level.strands, options.seed
        hair = stage.beside("hair", pool, lambda: kept("hair", grow_hair, *wanted))
        cards = pool.submit(lambda: hair_cards(hair.result(), seen.skin, options.quality, options.seed))
        grown = pool.submit(grow_beard, photo, head, fit, reading, seen.skin, options.level.strands, options.seed)
        bristles = pool.submit(lambda: beard_cards(grown.result(), head, fit, options.quality, options.seed))
        with stage("texture"):
            brows = find_brows(photo, head, fit, reading) if options.level.fine_mesh else None
            bald = not seen.without or wish.style == NONE
            given = photo, fit, chart, reading, bald, gathered.others
            texture = kept("texture", make_texture, *given, known.result())
            del known  # its memory
            if brows is None and hides_brows(chart, texture.confidence):
                brows = made_up_brows(hair.result().root_colour)
                warnings += ("brows-made-up",)
            if options.eye_colour != "auto":
                texture = replace(texture, iris=NAMED_IRISES[options.eye_colour])
        step = options.level.part_texture_step
        mouth = pool.submit(mouth_parts, head, fit, texture.tooth, step)  # made while the networks run
        eyes = pool.submit(eye_parts, head, fit, texture.iris, step)
        parts = pool.submit(lambda: (*cards.result(), *bristles.result(), *worn(head, fit, texture.texture, brows)))

        def compared() -> IdentitySimilarity:
            shown = [part for part in parts.result() if part.name != BROWS]  # the texture has the photo's own
            try:
                return kept("compare", likeness, photo, face, head, fit, texture.texture, networks.recogniser(), shown)
            finally:
                networks.drop()

        similarity = stage.beside("compare", pool, compared)

        def so_far(made: Reflectance | None) -> Avatar:
            """The avatar with maps as far as they are made, its parts without the photo's light."""
            own_hair, own_parts = hair.result(), parts.result()
            beard = None if (shown := grown.result()) is None else shown.groom
            if made is not None and made.diffuse_albedo is not None:
                albedo = small_albedo(made.diffuse_albedo, texture.texture.shape[1::-1])
                light = to_albedo(texture.texture, albedo, texture.lit_skin)
                own_parts = in_albedo(own_parts, brows, head, albedo, light)
                above = light / over_skin(own_hair.groom, fit)
                own_hair, own_parts = hair_in_albedo(own_hair, own_parts, above, beard)
                if beard is not None:
                    beard, own_parts = groom_in_albedo(beard, own_parts, light, BEARD)
            return Avatar(
                photo=photo,
                face=face,
                head=head,
                fit=fit,
                texture=texture,
                sources=_sources(gathered, texture, detail=own is not None),
                left_out=gathered.left_out,
                options=options.to_json(),
                seed=options.seed,
                models=model_cards(head, head_file, plan.networks),
                parts=(*coarser(own_parts, step), *mouth.result(), *eyes.result()),
                hair=own_hair,
                beard=beard,
                own_texture=own_texture,
                warnings=(*warnings, *(("photos-left-out",) if gathered.left_out else ())),
            )

        begun: list[tuple[Avatar, Future[Drawn], Future[Shapes]]] = []

        def draw_early(made: Reflectance) -> None:
            avatar = so_far(made)
            begun.append(
                (avatar, pool.submit(draw, replace(avatar, reflectance=made)), pool.submit(draw_shapes, avatar))
            )

        reflectance, own_texture, own = None, None, None
        if options.level.super_resolution or options.texture_size != "auto":
            sights = [(photo, fit), *((view.photo, other) for view, other in gathered.others)]
            own = OwnDetail.of_all(sights, head, texture)
            if "texture" in options.maps:
                asked = options.texture_size
                size = own.texture_size(options.most_texture_width) if asked == "auto" else asked
                own_texture = kept("own_texture", own_texture_of, texture, own, size)
        if subject is not None:
            reflectance = make_reflectance(
                texture.legible,
                replace(
                    subject.result().wearing(texture, halved=options.level.unseen_halved),
                    wrinkles=AGES[options.wrinkles],
                ),
                plan,
                options.map_size,
                engine,
                seed=options.seed,
                detail=options.detail,
                without=options.without,
                own=own if options.level.super_resolution else None,
                tile=tile,
                progress=lambda name, done: progress(name, BEFORE_NETWORKS + (1 - 2 * BEFORE_NETWORKS) * done),
                stages=stages,
                roots=lambda: left_by_roots(texture, hair.result()),
                coloured=draw_early,
            )
            stage.timings |= reflectance.timings_s
        thick = None if flesh is None else flesh.result()
        surface = surface_maps(head, fit.vertices, reflectance, options.maps, options.map_size, thick)

        avatar, drawn, shapes = begun[0] if begun else (so_far(reflectance), None, None)
        return replace(
            avatar,
            reflectance=reflectance,
            surface=surface,
            similarity=similarity.result(),
            drawn=None if drawn is None else drawn.result(),
            shapes=None if shapes is None else shapes.result(),
            timings_s=stage.timings,
        )


class _Timed:
    """Reports each stage before the networks as it begins, and times it."""

    def __init__(self, progress: Progress, scale: float) -> None:
        """``scale`` is the share of these stages in all of the work."""
        self.timings: dict[str, float] = {}
        self._progress, self._scale, self._done = progress, scale, 0.0

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        self._progress(name, self._scale * self._done)
        begin = time.perf_counter()
        yield
        self._took(name, begin)
        self._done = STAGES[name]

    def _took(self, name: str, begin: float) -> None:
        self.timings[name] = self.timings.get(name, 0.0) + time.perf_counter() - begin

    def beside(self, name: str, pool: ThreadPoolExecutor, work: Callable[[], T]) -> Future[T]:
        """A stage that a thread of a pool makes beside the next ones."""

        def timed() -> T:
            begin = time.perf_counter()
            try:
                return work()
            finally:
                self._took(name, begin)

        with self(name):
            return pool.submit(timed)


def _decoded(files: list[bytes], networks: FaceNetworks) -> Gathered:
    return decoded(with_frames(files, networks.finder))


def _detected(
    gathered: Gathered,
    chosen: int | Literal["largest"] | None,
    leave_out: Literal["strangers"] | None,
    networks: FaceNetworks,
    doubted: tuple[Size, Path | None] | None,
) -> Gathered:
    """The face to take in each photo; where none is found and a head to try is named, one that the reader makes out."""

    def find(photo: Photo) -> Face:
        faces = networks.finder().find(photo.pixels)
        if not faces and doubted is not None:
            head, _ = ahead.head_and_chart(*doubted)
            found = networks.finder().doubted(photo.pixels)
            faces = faces_by_reading(photo.pixels, found, head, networks.readers().pixels)
        return choose_face(faces, chosen, photo.size)

    return of_one_person(gathered, find, networks.recogniser, leave_out)


def _sources(gathered: Gathered, texture: Texture, *, detail: bool) -> tuple[Source, ...]:
    """The photos of an avatar and what each was used for."""
    found = []
    for place, (view, fit) in enumerate(zip(gathered.views, gathered.fits, strict=True)):
        share = 1.0
        if texture.photos:
            seen = np.stack([one.share.astype(np.float64) for one in texture.photos])
            share = float(seen[place].sum() / max(float(seen.sum()), 1.0))
        used = ["shape", *(("texture", "albedo") if share > LEAST_SHARE else ())]
        used += ["detail"] if detail and share > LEAST_SHARE else []
        used += FIRST_ONLY if place == 0 else []
        found.append(Source(view.photo, view.face, fit, tuple(used), share))
    return tuple(found)


def made_ahead() -> Ahead:
    """What drafts on the head in the box have in common, kept where it is made, and the networks of their maps."""
    draft = Options(quality="draft")
    _read_tables(ahead.head_and_chart(draft.base_size, None, ahead.modes_of(draft))[0], draft.map_size)
    previews = import_module("service.archive.preview.overlay")
    previews.write_text(previews.blank(1, 1), "0", 0, 1, 1)  # reads the typeface
    return Ahead(draft.plan().networks, choose_engine(draft.runtime, precision=draft.level.precision))


def _read_tables(head: HeadModel, size: Size) -> None:
    """What all photos have in common beside the head, kept where it is read."""
    for read in (read_bank, read_items, read_insets, population, error_model):
        read()
    albedo_prior(False)
    coarse_chart(head)
    islands(head, size)
    session("irradiance", 1)
