"""Variants of the benchmark: every setting that trades accuracy for time, one at a time from the reference."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from service.levels import FULL_SIZE
from service.runtime.network_registry import networks_of
from service.runtime.networks import RuntimeName, has_bf16
from service.runtime.sessions import has_openvino
from service.runtime.tiles import DEFAULT_TILE

StageName = Literal["zeta", "delta", "psi", "rho", "sigma", "integration", "encoding"]
Precision = Literal["fp32", "bf16", "int8 dynamic", "int8 static"]

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

INT8: tuple[Precision, ...] = ("int8 dynamic", "int8 static")


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
class Extent:
    """Extent of a benchmark.

    Attributes:
        side: of the window of the chart, in texels of the full chart, that stages are measured on.
        widths: of maps, other than the reference's.
        tiles: other than the reference's.
        halo_tile: tile at which smaller padding is tried.
        halos: padding shares, other than 1.
        int8: ways to quantise networks.
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
    int8: tuple[Precision, ...]
    levels: tuple[str, ...]
    sizes: tuple[int, ...]
    draft: bool
    repeats: int
    knobs: int = 99


FULL = Extent(
    1536, (3072, 1536), (256, 512, 1536), 512, (0.5, 0.0), ("int8 static",), ("draft", "standard", "high", "reference"),
    (1536, 3072, 6144), True, 1,
)  # fmt: skip
"""Without dynamic quantisation, whose convolutions are as slow as fp32."""
QUICK = Extent(512, (1536,), (256,), 256, (0.0,), (), (), (384, 768, 1536), False, 0, 1)


def variants(extent: Extent, stages: Sequence[StageName], families: Sequence[str]) -> Iterator[Variant]:
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


def precisions(extent: Extent) -> Iterator[tuple[RuntimeName, Precision]]:
    """Runtimes and precisions of this machine and installation, other than the reference's."""
    if has_openvino():
        yield "openvino", "fp32"
        if has_bf16():
            yield "openvino", "bf16"
    yield from (("onnxruntime", precision) for precision in extent.int8)


def _of_networks(extent: Extent, first: Variant, families: Sequence[str]) -> Iterator[Variant]:
    for runtime, precision in precisions(extent):
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
