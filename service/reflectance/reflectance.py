"""From texture and head to reflectance, stage by stage (AvatarMe, figure 3).

::

    T --zeta--> T^ --delta--> diffuse albedo --psi--> specular albedo
          |
          `- less the light that delta's context tells --rho, shade--> specular normals --integrate--> displacement
                                                       --sigma--> diffuse normals

Full-size maps are there as 16-bit codes only; networks see tiles. So memory is that of the maps and of two tiles.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import TypeVar, TypeVarTuple

import numpy as np
import numpy.typing as npt

from service import manifest
from service.arrays import UInt8
from service.colour import Codes
from service.geometry.chart import NO_PART
from service.levels import TEXTURE_SIZE
from service.reflectance.albedo.albedo_error import error_map
from service.reflectance.albedo.beside_skin import darkened, pad_parts, pad_skin
from service.reflectance.albedo.corrections import Ledger
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
from service.reflectance.relief.normal_inputs import READERS, drawn_detail, shaded_grey, without_border
from service.reflectance.relief.shade_update import bare, with_shade
from service.reflectance.subject import Subject
from service.reflectance.super_resolution import Grain, enlarge, resample
from service.reflectance.translate import MapInputs, specular_albedo, tangent_normals
from service.runtime.network_registry import CLUES, DRAWN_DETAIL, GEOMETRY, PARTS, SHADED_GREY
from service.runtime.networks import Engine, lacks_openvino
from service.runtime.sessions import release
from service.runtime.tiles import DEFAULT_TILE
from service.stage_cache import Depending, NoCache, StageCache
from service.texture.photo_detail import OwnDetail

T = TypeVar("T")
Given = TypeVarTuple("Given")

Unlit = tuple[Codes, Codes | None, tuple[manifest.CorrectionEntry, ...], manifest.Detail | None, UInt8 | None]
"""Albedo, shaded grey, corrections that ran, what of the detail is the photo's, and how far the albedo may be off."""

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of all the reflectance work that is done."""


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

    Raises:
        ModelFault: a network is missing, changed, or does not fit.
        NumericFault: a network's output is not finite.
    """
    plain = replace(subject, roots=None, wrinkles=1.0)  # networks make the same maps, whatever is corrected of these
    given = texture, plain, plan, size, seed, detail, tuple(without), own
    run = _Run(plan, Depending(stages, given), progress)
    made = _by_networks(*given, engine, tile, run)
    chart, depth = subject.chart, subject.wrinkles
    if made.specular_normal is not None:
        made = replace(made, specular_normal=aged(made.specular_normal, chart, depth))
    if made.diffuse_normal is not None:
        made = replace(made, diffuse_normal=aged(made.diffuse_normal, chart, depth))
    if "displacement" in plan.stages and made.specular_normal is not None:
        heights, how = run("displacement", _displaced, made.specular_normal, plain, size, plan.keep_cliffs)
        made = replace(made, displacement=heights, integration=how)
    if made.diffuse_albedo is not None and subject.creases is not None:
        # Only now: the networks read relief from the dark lines of folds.
        made = replace(made, diffuse_albedo=unfolded_albedo(made.diffuse_albedo, subject.creases))
    if made.diffuse_albedo is not None and subject.roots is not None:
        made = replace(made, diffuse_albedo=darkened(made.diffuse_albedo.copy(), subject.roots))
    return replace(made, timings_s=run.timings)


def _by_networks(
    texture: npt.NDArray[np.uint8], subject: Subject, plan: ReflectancePlan, size: tuple[int, int], seed: int,
    detail: float, without: Collection[str], own: OwnDetail | None, engine: Engine, tile: int, run: _Run,
) -> Reflectance:  # fmt: skip
    """The maps without displacement. Its stages are found by all of this but engine and tile."""
    geometry = subject.geometry
    source = texture.astype(np.uint16) * np.uint16(257)
    if "super_resolution" in plan.stages:
        small = Planes((texture.shape[1], texture.shape[0]))
        small.add_codes("texture", source)
        small.add_coarse(GEOMETRY, geometry)
        source = run("super_resolution", lambda told: enlarge(small, Grain(seed, detail), engine, tile, told))
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
        fallbacks=_fallbacks(plan, engine, subject, texture),
        models=plan.networks,
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
            delit = diffuse_albedo(full, job(told), ledger, subject.photos)
            plain = delit.albedo
            unsure = None if delit.error is None else error_map(delit.error, skin, min(size, TEXTURE_SIZE))
            grey = shaded_grey(planes, plain) if READERS & set(plan.stages) else None
            if ledger.runs(HIGHLIGHTS):
                plain = without_highlights(plain, full, skin, subject.lit, grey, ledger)
            if grey is not None:
                grey = without_border(grey, planes)
            return pad_parts(pad_skin(plain, subject), subject), grey, ledger.applied, told_of, unsure

        albedo, grey, corrections, found, error = run("diffuse_albedo", unlit)
        made = replace(made, diffuse_albedo=albedo, corrections=corrections, detail=found, albedo_error=error)
        planes.drop("texture")
        del full
        planes.add_codes("albedo", albedo)
        if grey is not None:
            planes.add_grey(SHADED_GREY, grey)
            seen, octaves = None if own is None else own.all_seen, () if found is None else found.octaves
            drawn = drawn_detail(seen, octaves, detail if "super_resolution" in plan.stages else 0.0)
            planes.add_coarse([DRAWN_DETAIL], drawn[None])
    if "specular_albedo" in plan.stages:
        made = replace(made, specular_albedo=run("specular_albedo", lambda told: specular_albedo(job(told))))
    if "specular_normal" in plan.stages:

        def specular(told: Callable[[float], None]) -> tuple[npt.NDArray[np.int16], tuple[Wrinkle, ...]]:
            bent = tangent_normals("specular_normal", job(told))
            if own is not None and found is not None and grey is not None and subject.slope is not None:
                shares = tuple(octave.share for octave in found.octaves)
                trust = bare(own.seen, planes)
                bent = with_shade(bent, grey, subject.slope, trust, shares)
            if subject.creases is None:
                return bent, ()
            fold = folds_in(bent, subject.creases)
            return unfolded(bent, fold), wrinkles_of(fold, subject.creases, bent.shape)

        normal, wrinkles = run("specular_normal", specular)
        made = replace(made, specular_normal=normal, wrinkles=wrinkles)
    if "diffuse_normal" in plan.stages:

        def diffuse(told: Callable[[float], None]) -> npt.NDArray[np.int16]:
            bent = tangent_normals("diffuse_normal", job(told))
            return bent if subject.creases is None else unfolded(bent, folds_in(bent, subject.creases))

        made = replace(made, diffuse_normal=run("diffuse_normal", diffuse))
    return made


def _fallbacks(
    plan: ReflectancePlan, engine: Engine, subject: Subject, texture: npt.NDArray[np.uint8]
) -> tuple[str, ...]:
    delighted = "diffuse_albedo" in plan.stages
    told = {
        "texture-resampled": "super_resolution" not in plan.stages,
        "light-from-skin-alone": delighted and subject.eye_light is None,
        "bf16-needs-openvino": engine.precision == "fp32" and lacks_openvino(),
    }
    return tuple(code for code, so in told.items() if so)


class _Run:
    """Runs stages one after the other: times them, keeps their results, tells how far all of it is."""

    def __init__(self, plan: ReflectancePlan, stages: StageCache, progress: Progress) -> None:
        self.timings: dict[str, float] = {}
        self._shares = plan.shares()
        self._stages = stages
        self._progress = progress
        self._done = 0.0

    def __call__(self, name: str, make: Callable[[Callable[[float], None], *Given], T], *given: *Given) -> T:
        share = self._shares[name]
        self._progress(name, self._done)
        begin = time.perf_counter()
        told = lambda done: self._progress(name, self._done + share * done)  # noqa: E731
        result = self._stages.get_or_compute(name, lambda *given: make(told, *given), *given)
        release()  # what the stage's strips and networks left
        self.timings[name] = time.perf_counter() - begin
        self._done += share
        return result


def _displaced(
    told: Callable[[float], None],
    bumps: npt.NDArray[np.int16],
    subject: Subject,
    size: tuple[int, int],
    keep_cliffs: bool,
) -> tuple[Codes, manifest.Integration]:
    """Displacement codes, and how the integration went."""
    steps = Steps.of(subject.chart, subject.vertices)
    part = subject.head.part_names.index("skin")
    islands, skin = subject.islands(size), subject.skin(size)
    surface = (islands == part) & (skin > 0)
    height, facts = displacement(bumps, steps, surface, keep_cliffs=keep_cliffs)
    height *= skin * np.float32(1 / 255)
    texel_mm = steps.texel_mm() * np.float32(steps.width / size[0])
    height = join(height, Seams.of(subject.head, part, surface), surface, texel_mm)
    np.clip(height, -MOST_MM, MOST_MM, out=height)
    pad_heights(height, surface, islands == NO_PART)
    return encode_heights(height), facts
