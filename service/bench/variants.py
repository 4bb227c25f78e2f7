"""Variants of the benchmark: every setting that trades accuracy for time, one at a time from the reference."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from service.bench.losses import UNITS, FittedLine, Loss
from service.bench.sample_head import SampleHead
from service.levels import FULL_SIZE
from service.runtime.network_registry import networks_of
from service.runtime.networks import Engine, RuntimeName, has_bf16
from service.runtime.sessions import has_openvino
from service.runtime.tiles import DEFAULT_TILE

StageName = Literal["zeta", "delta", "psi", "rho", "sigma", "integration", "encoding"]
Precision = Literal["fp32", "bf16"]

STAGES: tuple[StageName, ...] = ("zeta", "delta", "psi", "rho", "sigma", "integration", "encoding")
TRANSLATORS: tuple[StageName, ...] = ("delta", "psi", "rho", "sigma")

NETWORKS: dict[StageName, tuple[str, ...]] = {
    "zeta": networks_of("super_resolution"),
    "delta": networks_of("diffuse_albedo"),
    **{name: (name,) for name in ("psi", "rho", "sigma")},
    "integration": (),
    "encoding": (),
}
"""Networks of each stage."""

SHIPPED = "shipped"
"""Name of the reference family of networks."""


@dataclass(frozen=True)
class Variant:
    """One variant of one stage.

    Attributes:
        stage: which.
        family: of networks; the name of a folder.
        runtime, precision: of the networks.
        tile: inner side of tiles in texels.
        halo: fraction of the network's halo that tiles are padded with; below 1 the result depends on the tiles.
        width: of the maps in texels.
        knob: another setting: "resampled" for zeta, the solver's tolerance, or the coding of a map.
    """

    stage: StageName
    family: str = SHIPPED
    runtime: RuntimeName = "onnxruntime"
    precision: Precision = "fp32"
    tile: int = DEFAULT_TILE
    halo: float = 1.0
    width: int = FULL_SIZE[0]
    knob: str = ""

    @property
    def reference(self) -> bool:
        """Whether this is the reference of its stage."""
        return self == reference(self.stage)

    @property
    def label(self) -> str:
        """The differences to the reference, as text."""
        plain = reference(self.stage)
        words = [self.family] if self.family != plain.family else []
        if self.runtime != plain.runtime:
            words.append({"openvino": "OpenVINO", "onnxruntime": "onnxruntime"}[self.runtime])
        words += [self.precision] if self.precision != plain.precision else []
        words += [f"tile {self.tile}"] if self.tile != plain.tile else []
        words += [f"halo x {self.halo:g}"] if self.halo != plain.halo else []
        words += [f"{self.width} wide"] if self.width != plain.width else []
        words += [self.knob] if self.knob != plain.knob else []
        return ", ".join(words) or "reference"


CLIFFS = ", cliffs kept"
TOLERANCES = (
    "tolerance 1e-06", "tolerance 0.003", f"tolerance 0.003{CLIFFS}", "tolerance 0.03", "tolerance 0.3",
)  # fmt: skip
CODINGS = (
    "normals 16 bits, in strips", "normals 8 bits, in strips", "normals 16 bits, level 1", "normals 8 bits, level 1",
    "normals 8 bits, level 6", "albedo 8 bits, in strips", "albedo 8 bits, level 1", "albedo 8 bits, level 6",
)  # fmt: skip
"""The first of each list is the reference. "Level": OpenCV's encoder, with zlib's level."""


def reference(stage: StageName) -> Variant:
    """fp32 on onnxruntime, full padding, 6144 texels wide, the solver run to convergence, 16 bits."""
    return Variant(stage, knob={"integration": TOLERANCES[0], "encoding": CODINGS[0]}.get(stage, ""))


@dataclass(frozen=True)
class BenchExtent:
    """Extent of a benchmark.

    Attributes:
        side: of the window of the chart, in texels of the full chart, that stages are measured on.
        widths: of maps, other than the reference's.
        tiles: other than the reference's.
        halo_tile: tile at which smaller padding is tried.
        halos: padding shares, other than 1.
        levels: of quality, run from the photo to the archive.
        sizes: widths of maps for the fit of time against size.
        draft: whether draft quality is run with other runtimes, precisions and tiles.
        repeats: runs after the first; the fastest counts.
        knobs: most values of a stage's ``knob``, other than the reference's.
    """

    side: int
    widths: tuple[int, ...]
    tiles: tuple[int, ...]
    halo_tile: int
    halos: tuple[float, ...]
    levels: tuple[str, ...]
    sizes: tuple[int, ...]
    draft: bool
    repeats: int
    knobs: int = 99


FULL = BenchExtent(
    1536, (3072, 1536), (256, 512, 1536), 512, (0.5, 0.0), ("draft", "standard", "high", "reference"),
    (1536, 3072, 6144), True, 1,
)  # fmt: skip
QUICK = BenchExtent(512, (1536,), (256,), 256, (0.0,), (), (384, 768, 1536), False, 0, 1)


def variants(extent: BenchExtent, stages: Sequence[StageName], families: Sequence[str]) -> Iterator[Variant]:
    """Every variant, stage by stage, the reference of each stage first."""
    for stage in stages:
        first = reference(stage)
        yield first
        if stage in TRANSLATORS or stage == "zeta":
            yield from _of_networks(extent, first, families)
        if stage in TRANSLATORS or stage == "integration":
            yield from (replace(first, width=width) for width in extent.widths)
        knobs = {"integration": TOLERANCES[1:], "encoding": CODINGS[1:], "zeta": ("resampled",)}.get(stage, ())
        yield from (replace(first, knob=knob) for knob in knobs[: extent.knobs])


def precisions() -> Iterator[tuple[RuntimeName, Precision]]:
    """Runtimes and precisions of this machine and installation, other than the reference's."""
    if has_openvino():
        yield "openvino", "fp32"
        if has_bf16():
            yield "openvino", "bf16"


def _of_networks(extent: BenchExtent, first: Variant, families: Sequence[str]) -> Iterator[Variant]:
    for runtime, precision in precisions():
        yield replace(first, runtime=runtime, precision=precision)
    yield from (replace(first, family=family) for family in families)
    yield from (replace(first, tile=tile) for tile in extent.tiles)
    if first.stage in TRANSLATORS:
        yield from (replace(first, tile=extent.halo_tile, halo=halo) for halo in extent.halos)


@dataclass(frozen=True)
class Family:
    """Networks of one size: folder and names."""

    name: str
    folder: Path
    networks: tuple[str, ...]


Progress = Callable[[str, float], None]
Launch = Callable[..., Any]

STAGES_SHARE = 0.5
"""Share of the progress bar for the stages; the rest is for whole runs."""


@dataclass
class Setting:
    """Context of the measurements of one run: extent, networks, material, machine; notes and caches are added to."""

    extent: BenchExtent
    families: Sequence[Family]
    folder: Path
    launch: Launch
    photo: bytes
    threads: int
    head: SampleHead
    notes: list[str] = field(default_factory=list)

    @property
    def first(self) -> Family:
        """The family that is the reference."""
        return self.families[0]

    def family(self, variant: Variant) -> Family:
        """The family of a variant's networks."""
        return next((family for family in self.families if family.name == variant.family), self.first)

    def engine(self, variant: Variant) -> Engine:
        """Engine of a variant's networks."""
        return Engine(variant.runtime, variant.precision, self.threads, self.family(variant).folder)


@dataclass(frozen=True)
class MeasuredStage:
    """Time and memory of a variant.

    Attributes:
        seconds: for the whole chart, extrapolated from the window by the number of pixels computed, padding included.
        window_s: as measured.
        peak_mb: largest resident memory of the process.
        megabytes: of the file, where the stage writes one.
    """

    seconds: float
    window_s: float
    peak_mb: float
    megabytes: float | None = None


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


@dataclass(frozen=True)
class Row:
    """One variant of one stage.

    Attributes:
        variant: what was run.
        measured: time and memory; None where it failed.
        loss: against the stage's reference; None where it failed.
        front: whether it is on the Pareto front of its stage.
        fault: why it failed.
    """

    variant: Variant
    measured: MeasuredStage | None = None
    loss: Loss | None = None
    front: bool = False
    fault: str = ""


@dataclass(frozen=True)
class WholeRow:
    """One run from photo to archive; ``losses`` by map, against the reference run."""

    run: Whole
    made: Made | None = None
    losses: Mapping[str, Loss] | None = None
    front: bool = False
    fault: str = ""


@dataclass(frozen=True)
class Bench:
    """All results of one benchmark.

    Attributes:
        machine: facts of machine and installation.
        rows: of all stages.
        wholes: runs from photo to archive.
        line: seconds without super-resolution against megatexels of the map.
        notes: what was left out, and why.
        seconds: duration of the benchmark.
    """

    machine: Mapping[str, Any]
    rows: Sequence[Row]
    wholes: Sequence[WholeRow]
    line: FittedLine | None
    notes: Sequence[str]
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """JSON values; numbers that are not finite are null."""
        return {
            "machine": dict(self.machine),
            "stages": [_row(row) for row in self.rows],
            "whole": [_whole(row) for row in self.wholes],
            "line": None if self.line is None else asdict(self.line),
            "notes": list(self.notes),
            "seconds": self.seconds,
        }


def _row(row: Row) -> dict[str, Any]:
    return {
        **asdict(row.variant),
        "label": row.variant.label,
        **(_taken(row.measured, row.fault)),
        "loss": None if row.loss is None else loss_json(row.loss),
        "pareto": row.front,
    }


def _whole(row: WholeRow) -> dict[str, Any]:
    engine = row.run.engine
    return {
        "label": row.run.label, "quality": row.run.quality, "runtime": engine.runtime, "precision": engine.precision,
        "tile": row.run.tile, **_taken(row.made, row.fault),
        "loss": {name: loss_json(loss) for name, loss in (row.losses or {}).items()}, "pareto": row.front,
    }  # fmt: skip


def _taken(taken: MeasuredStage | Made | None, fault: str) -> dict[str, Any]:
    return {"fault": fault} if taken is None else asdict(taken)


def loss_json(loss: Loss) -> dict[str, Any]:
    """Numbers and their unit."""
    shown = {"at_own_size": loss.shown(loss.at_own), "at_full_size": loss.shown(loss.at_full)}
    return {"unit": UNITS[loss.kind], **{key: value if math.isfinite(value) else None for key, value in shown.items()}}
