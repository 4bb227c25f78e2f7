"""One run from a photo to an archive, timed by stage, and the window of its maps for comparison."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from service.bench.loss import Kind
from service.bench.material import Material
from service.diagnosis import peak_rss_mb
from service.levels import SMALLEST_ENLARGED
from service.reflectance.plan import ROLES, Plan
from service.runtime.network_registry import networks_of
from service.runtime.networks import Engine
from service.runtime.sessions import model_table
from service.runtime.tiles import DEFAULT_TILE

COMPARED: dict[str, Kind] = {
    "diffuse_albedo": "colour", "specular_albedo": "colour", "specular_normal": "normal", "diffuse_normal": "normal",
}  # fmt: skip
"""Maps whose loss is reported."""

WRITING = "write"
"""Name of the time of writing the archive."""


@dataclass(frozen=True)
class Whole:
    """One run.

    Attributes:
        label: its name.
        quality: a level, which decides on super-resolution, bits and the fine mesh.
        width: of the maps; None for the level's.
        engine: of the networks.
        tile: inner side of tiles.
    """

    label: str
    quality: str
    engine: Engine
    width: int | None = None
    tile: int = DEFAULT_TILE


@dataclass(frozen=True)
class Made:
    """Result of a run: seconds in total and by stage, peak memory in MiB, archive in MB, width of the maps."""

    seconds: float
    timings_s: Mapping[str, float]
    peak_mb: float
    megabytes: float
    width: int


def make(run: Whole, photo: bytes, folder: Path, output: Path) -> Made:
    """Make an avatar, write its archive, and write the window of its maps to ``output`` (``.npz``).

    Raises:
        AvatarError: as ``service.pipeline.make_avatar``.
    """
    begin = time.perf_counter()
    from service.archive.pack import write_archive
    from service.options import TEXTURE_MAPS, Options
    from service.pipeline import make_avatar
    from service.reflectance.reflectance import make_reflectance
    from service.reflectance.subject import Subject

    there = set(model_table(run.engine.folder))
    roles = tuple(role for role in ROLES if set(Plan.of([role], super_resolution=False).networks) <= there)
    size = None if run.width is None else (run.width, run.width * 2 // 3)
    options = Options(maps=(*roles, *TEXTURE_MAPS), quality=run.quality, size=size, face="largest")  # type: ignore[arg-type]
    enlarged = options.level.super_resolution and options.map_size[0] >= SMALLEST_ENLARGED
    plan = Plan.of(
        roles,
        super_resolution=enlarged and set(networks_of("super_resolution")) <= there,
        keep_cliffs=options.level.keep_cliffs,
    )
    avatar = make_avatar(photo, replace(options, maps=TEXTURE_MAPS, size=options.base_size))
    subject = Subject.in_photo(avatar.head, avatar.fit, avatar.texture)
    reflectance = make_reflectance(
        avatar.texture.texture, subject, plan, options.map_size, run.engine, tile=run.tile
    )  # fmt: skip
    avatar = replace(avatar, reflectance=reflectance, options=options.to_json())
    writing = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        target = Path(scratch) / "avatar.zip"
        write_archive(avatar, target)
        megabytes = target.stat().st_size / 1e6
    end = time.perf_counter()
    timings = {**avatar.timings_s, **reflectance.timings_s, WRITING: end - writing}
    peak = peak_rss_mb()
    window = Material.load(folder).window
    maps: dict[str, npt.NDArray[Any]] = {
        name: window.of(values) for name in COMPARED if (values := getattr(reflectance, name)) is not None
    }
    np.savez(output, **maps)  # type: ignore[arg-type]
    return Made(end - begin, timings, peak, megabytes, options.map_size[0])
