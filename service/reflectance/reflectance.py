"""From texture and head to reflectance, stage by stage (AvatarMe, figure 3).

::

    T --zeta--> T^ --delta--> diffuse albedo --psi--> specular albedo
          |
          `- less the light that delta's context tells --rho, shade--> specular normals --integrate--> displacement
                                                       --sigma--> diffuse normals

Full-size maps are there as 16-bit codes only; networks see tiles. So memory is that of the maps and of two tiles. Of
maps that are small (``SMALL_MAP``) stages run side by side, where neither needs the other.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, TypeVar, TypeVarTuple

import numpy as np
import numpy.typing as npt

from service import manifest
from service.arrays import UInt8
from service.colour import Codes
from service.corrections import Ledger
from service.geometry.chart import NO_PART
from service.levels import TEXTURE_SIZE
from service.reflectance.albedo.albedo_prior import error_map
from service.reflectance.albedo.beside_skin import close_seam, pad_parts, pad_skin, scaled
from service.reflectance.albedo.diffuse_albedo import diffuse_albedo
from service.reflectance.albedo.highlights import HIGHLIGHTS, without_highlights
from service.reflectance.planes import Planes
from service.reflectance.reflectance_maps import Reflectance, Wrinkle
from service.reflectance.reflectance_plan import ReflectancePlan
from service.reflectance.relief.displacement import (
    MOST_MM,
    Seams,
    Steps,
    displacement,
    encode_heights,
    join,
    pad_heights,
)
from service.reflectance.relief.folds import aged, folds_in, unfolded, unfolded_albedo, wrinkles_of
from service.reflectance.relief.normal_inputs import (
    READERS,
    bare,
    drawn_detail,
    shaded_grey,
    with_shade,
    without_border,
)
from service.reflectance.subject import Subject
from service.reflectance.translate import Grain, MapInputs, enlarge, resample, specular_albedo, tangent_normals
from service.runtime.network_registry import (
    CLUES,
    DRAWN_DETAIL,
    FINE_ALBEDO,
    FINE_SHADED,
    GEOMETRY,
    PARTS,
    SHADED_GREY,
)
from service.runtime.networks import Engine, lacks_openvino
from service.runtime.sessions import release
from service.runtime.tiles import DEFAULT_TILE, SMALL_MAP
from service.stage_cache import NoCache, StageCache
from service.texture.photo_detail import OwnDetail

T = TypeVar("T")
Given = TypeVarTuple("Given")

Unlit = tuple[Codes, Codes | None, tuple[manifest.CorrectionEntry, ...], manifest.Detail | None, UInt8 | None]
"""Albedo, shaded grey, corrections that ran, what of the detail is the photo's, and how far the albedo may be off."""

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of all the reflectance work that is done."""


Beside = Callable[[Callable[[], T]], Callable[[], T]]
"""Takes work, and gives a function that returns its result."""


def make_reflectance(
    texture: npt.NDArray[np.uint8],
    subject: Subject,
    plan: ReflectancePlan,
    size: tuple[int, int],
    engine: Engine,
    *,
    seed: int = 0,
    detail: float = 1.0,
    without: Collection[str] = (),
    own: OwnDetail | None = None,
    tile: int = DEFAULT_TILE,
    progress: Progress = lambda stage, done: None,
    stages: StageCache = NoCache(),  # noqa: B008 - holds nothing
    roots: Callable[[], npt.NDArray[np.uint8] | None] = lambda: None,
    coloured: Callable[[Reflectance], None] = lambda made: None,
) -> Reflectance:
    """Make the maps that a plan asks for.

    Args:
        texture: (h, w, 3) uint8 sRGB with the photo's light in it, filled outside the islands.
        subject: the head that the texture lies on.
        plan: the stages to run.
        size: (width, height) of the maps.
        engine: what the networks run on.
        seed: of made-up detail.
        detail: its strength in [0, 1]; 0 gives the likeliest maps, which have next to none.
        without: names of corrections that do not run (``service.reflectance.albedo.diffuse_albedo``).
        own: the photo's detail beyond the texture; None: there is no photo.
        tile: inner side of tiles in texels; the result does not depend on it.
        progress: told when a stage begins and after each tile.
        stages: keeps the maps of finished stages.
        roots: asked once the albedo is made for what the shadow of hair roots leaves of it, (h, w, 3) uint8, linear,
            255 = 1; None: all of it.
        coloured: told as soon as the diffuse albedo is as it will be, where that is before the other maps are made, in
            a thread of its own.

    Raises:
        ModelFault: a network is missing, changed, or does not fit.
        NumericFault: a network's output is not finite.
    """
    if size[0] * size[1] <= SMALL_MAP:
        subject = replace(subject, unseen=None)
    plain = replace(subject, wrinkles=1.0)  # networks make the same maps, whatever is corrected of these
    given = texture, plain, plan, size, seed, detail, tuple(without), own
    run = _Run(plan, stages, given, progress, small=size[0] * size[1] <= SMALL_MAP and tile >= DEFAULT_TILE)
    chart, depth = subject.chart, subject.wrinkles

    def colour(made: Reflectance) -> Codes | None:
        found = made.diffuse_albedo
        if found is not None and subject.creases is not None:
            # Only now: the networks read relief from the dark lines of folds.
            found = unfolded_albedo(found, subject.creases)
        shade = None if found is None else roots()
        if found is not None and shade is not None and (shade < 255).any():
            factor = np.moveaxis(shade, 2, 0) * np.float32(1 / 255)
            found = scaled(found.copy() if found is made.diffuse_albedo else found, factor)
        if run.small and found is not None:
            coloured(replace(made, diffuse_albedo=found))
        return found

    def relief(made: Reflectance) -> dict[str, Any]:
        if made.specular_normal is None:
            return {}
        normal = aged(made.specular_normal, chart, depth)
        if "displacement" not in plan.stages:
            return {"specular_normal": normal}
        heights, how = run("displacement", _displaced, normal, plain, size)
        return {"specular_normal": normal, "displacement": heights, "integration": how}

    with _beside(run.small) as beside:
        early: dict[str, Callable[[], Any]] = {}

        def known(made: Reflectance) -> None:
            if made.specular_normal is None:
                early["colour"] = beside(lambda: colour(made))
            else:
                early["relief"] = beside(lambda: relief(made))

        made = _by_networks(*given, engine, tile, run, beside, known if run.small else lambda made: None)
        if made.diffuse_normal is not None:
            made = replace(made, diffuse_normal=aged(made.diffuse_normal, chart, depth))
        made = replace(made, **(early["relief"]() if "relief" in early else relief(made)))
        made = replace(made, diffuse_albedo=early["colour"]() if "colour" in early else colour(made))
    return replace(made, timings_s=run.timings)


@contextmanager
def _beside(together: bool) -> Iterator[Beside[Any]]:
    """Work is done in a thread for it, or else at once."""
    with ThreadPoolExecutor(2) as pool:

        def take(work: Callable[[], Any]) -> Callable[[], Any]:
            if together:
                return pool.submit(work).result
            done = work()
            return lambda: done

        yield take


def _by_networks(
    texture: npt.NDArray[np.uint8], subject: Subject, plan: ReflectancePlan, size: tuple[int, int], seed: int,
    detail: float, without: Collection[str], own: OwnDetail | None, engine: Engine, tile: int, run: _Run,
    beside: Beside[Any], known: Callable[[Reflectance], None],
) -> Reflectance:  # fmt: skip
    """The maps without displacement. Its stages are found by all of this up to ``own``.

    ``known`` is told of the maps when they have the diffuse albedo, and when they have the specular normals.
    """
    geometry = subject.geometry
    source = texture.astype(np.uint16) * np.uint16(257)
    if "super_resolution" in plan.stages:
        small = Planes((texture.shape[1], texture.shape[0]))
        small.add_codes("texture", source)
        small.add_coarse(GEOMETRY, geometry)
        source = run("super_resolution", lambda told: enlarge(source, small, Grain(seed, detail), engine, tile, told))
        del small
    planes = Planes(size)
    planes.add_coarse(GEOMETRY, geometry)
    planes.add_coarse(CLUES, subject.clues)
    skin = subject.skin(size)
    made = Reflectance(
        size=size,
        runtime=engine.runtime,
        precision=engine.precision,
        tile=tile,
        super_resolution="super_resolution" in plan.stages,
        fallbacks=_fallbacks(plan, engine, subject),
        engines=engine.told(plan.networks),
    )

    def job(told: Callable[[float], None]) -> MapInputs:
        return MapInputs(planes, skin, engine, tile, told)

    if "diffuse_albedo" in plan.stages:
        full = resample(source, size)
        del source
        planes.add_codes("texture", full)
        if subject.parts is not None:
            planes.add_coarse(PARTS, np.moveaxis(subject.parts, 2, 0) * np.float32(2 / 255) - np.float32(1))

        def unlit(told: Callable[[float], None]) -> Unlit:
            ledger = Ledger(without)
            enlarged = "super_resolution" in plan.stages
            told_of = own.onto(full) if own is not None and enlarged else None
            delit = diffuse_albedo(full, job(told), subject, ledger)
            plain = delit.albedo
            unsure = error_map(delit.error, skin, min(size, TEXTURE_SIZE))
            grey = shaded_grey(planes) if READERS & set(plan.stages) else None
            if ledger.runs(HIGHLIGHTS):
                plain = without_highlights(plain, full, skin, subject.lit, grey, ledger)
            if grey is not None:
                grey = without_border(grey, planes)
            plain = pad_parts(close_seam(pad_skin(plain, subject), subject), subject)
            return plain, grey, ledger.applied, told_of, unsure

        albedo, grey, corrections, found, error = run("diffuse_albedo", unlit)
        made = replace(made, diffuse_albedo=albedo, corrections=corrections, detail=found, albedo_error=error)
        planes.drop("texture")
        del full
        planes.add_codes("albedo", albedo)
        planes.add_fine(FINE_ALBEDO)
        if grey is not None:
            planes.add_grey(SHADED_GREY, grey)
            planes.add_fine(FINE_SHADED)
            seen, octaves = None if own is None else own.all_seen, () if found is None else found.octaves
            drawn = drawn_detail(seen, octaves, detail if "super_resolution" in plan.stages else 0.0)
            planes.add_coarse([DRAWN_DETAIL], drawn[None])
        known(made)

    if run.small:  # a core for each of the networks that run side by side, which would wait for each other's threads
        engine = replace(engine, threads=1)

    def gloss() -> Codes | None:
        wanted = "specular_albedo" in plan.stages
        return run("specular_albedo", lambda told: specular_albedo(job(told))) if wanted else None

    def bumps(told: Callable[[float], None]) -> tuple[npt.NDArray[np.int16], tuple[Wrinkle, ...]]:
        bent = tangent_normals("specular_normal", job(told))
        if own is not None and found is not None and grey is not None and subject.slope is not None:
            shares = tuple(octave.share for octave in found.octaves)
            trust = bare(own.seen, planes)
            bent = with_shade(bent, grey, subject.slope, trust, shares)
        if subject.creases is None:
            return bent, ()
        fold = folds_in(bent, subject.creases)
        return unfolded(bent, fold), wrinkles_of(fold, subject.creases)

    def form(told: Callable[[float], None]) -> npt.NDArray[np.int16]:
        bent = tangent_normals("diffuse_normal", job(told))
        return bent if subject.creases is None else unfolded(bent, folds_in(bent, subject.creases))

    def soft() -> npt.NDArray[np.int16] | None:
        return run("diffuse_normal", form) if "diffuse_normal" in plan.stages else None

    specular, diffuse = beside(gloss), beside(soft) if run.small else None
    if "specular_normal" in plan.stages:
        normal, wrinkles = run("specular_normal", bumps)
        made = replace(made, specular_normal=normal, wrinkles=wrinkles)
        known(made)
    return replace(made, specular_albedo=specular(), diffuse_normal=(diffuse or beside(soft))())


def _fallbacks(plan: ReflectancePlan, engine: Engine, subject: Subject) -> tuple[str, ...]:
    delighted = "diffuse_albedo" in plan.stages
    told = {
        "texture-resampled": "super_resolution" not in plan.stages,
        "unseen-light-halved": delighted and subject.unseen is not None,
        "light-from-skin-alone": delighted and subject.eye_light is None,
        "bf16-needs-openvino": engine.precision == "fp32" and lacks_openvino(),
    }
    return tuple(code for code, so in told.items() if so)


class _Run:
    """Runs stages: times them, keeps their results by what all see and each is given, tells how far all of it is.

    Attributes:
        timings: seconds by name.
        small: run them side by side, as memory is no matter.
    """

    def __init__(
        self, plan: ReflectancePlan, stages: StageCache, seen: tuple[Any, ...], progress: Progress, *, small: bool
    ) -> None:
        self.timings: dict[str, float] = {}
        self._shares = plan.shares()
        self._stages, self._seen = stages, seen
        self._progress = progress
        self.small = small
        self._done = self._told = 0.0

    def __call__(self, name: str, make: Callable[[Callable[[float], None], *Given], T], *given: *Given) -> T:
        share = self._shares[name]

        def told(done: float) -> None:
            self._told = max(self._told, self._done + share * done)  # of two stages at a time one may be far behind
            self._progress(name, self._told)

        told(0.0)
        begin = time.perf_counter()
        result = self._stages.get_or_compute(name, lambda seen, *given: make(told, *given), self._seen, *given)
        if not self.small:
            release()  # what the stage's strips and networks left
        self.timings[name] = time.perf_counter() - begin
        self._done += share
        return result


def _displaced(
    told: Callable[[float], None],
    bumps: npt.NDArray[np.int16],
    subject: Subject,
    size: tuple[int, int],
) -> tuple[Codes, manifest.Integration]:
    """Displacement codes, and how the integration went."""
    steps = Steps.of(subject.chart, subject.vertices)
    part = subject.head.part_names.index("skin")
    surface = (subject.islands(size) == part) & (subject.skin(size) > 0)
    height, facts = displacement(bumps, steps, surface)
    height *= subject.skin(size) * np.float32(1 / 255)
    texel_mm = steps.texel_mm() * np.float32(steps.width / size[0])
    join(height, Seams.of(subject.head, part, surface), surface, texel_mm)
    np.clip(height, -MOST_MM, MOST_MM, out=height)
    pad_heights(height, surface, subject.islands(size) == NO_PART)
    return encode_heights(height), facts
