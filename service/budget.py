"""``--budget``: the best quality level that this machine can do in so many seconds, from a measurement of a second."""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from timeit import repeat
from typing import NamedTuple

import numpy as np

from service.arrays import Float32
from service.levels import LEVELS, TEXTURE_SIZE
from service.options import Options
from service.reflectance.reflectance_plan import ReflectancePlan
from service.runtime.networks import ENLARGING, Engine, Network, choose_engine, open_network
from service.runtime.tiles import DEFAULT_TILE
from service.stage_cache import NoCache, StageCache
from service.words import WarningCode

SAMPLE = 256
"""Inner side of the tile that is measured."""

FIT_WORK, FINE_MESH_WORK = 90.0, 75.0
"""Everything before the networks, and meshes and previews after them; and the fine mesh with its 16-bit normals: in
units of :func:`_yardstick`, as the next."""

PACKING_WORK, DISPLACEMENT_WORK = 0.66, 4.0
"""Of a megatexel: packing one map, and integrating the displacement (``docs/accuracy-time.md``)."""

SAFETY = 1.15


class NetworkSpeed(NamedTuple):
    """What one network takes.

    Attributes:
        opening: seconds that loading takes, and its first run more than others.
        seconds: per megapixel of input, margin and all; of one run where it takes a whole map.
        tiles: margin and scale; None where it takes a whole map.
    """

    opening: float
    seconds: float
    tiles: tuple[int, int] | None = None


@dataclass(frozen=True)
class Speed:
    """What this machine does.

    Attributes:
        yardstick: seconds of a fixed piece of numpy work.
        networks: by name.
    """

    yardstick: float
    networks: Mapping[str, NetworkSpeed]


def within_budget(
    options: Options,
    stages: StageCache = NoCache(),  # noqa: B008
) -> tuple[Options, tuple[WarningCode, ...]]:
    """Options with the level that the budget allows, and warnings; unchanged without a budget.

    ModelFault: a network is missing or changed. UsageError: the runtime that is asked for is not there.
    """
    if options.budget is None or not options.plan().stages:
        return options, ()
    chosen = stages.get_or_compute("level", _choose, options.uncorrected())
    warnings: tuple[WarningCode, ...] = ("over-budget",) if chosen.startswith("!") else ()
    return replace(options, quality=chosen.removeprefix("!"), budget=options.budget), warnings  # type: ignore[arg-type]


def _choose(options: Options) -> str:
    """Name of the level; with a mark of exclamation where even the fastest is expected to take longer."""
    fits = [name for name, seconds in expected(options).items() if seconds <= float(options.budget or 0)]
    return fits[-1] if fits else "!" + next(iter(LEVELS))


def expected(options: Options) -> dict[str, float]:
    """Seconds that each level should take on this machine for the maps of ``options``."""
    asked = {name: replace(options, quality=name) for name in LEVELS}  # type: ignore[arg-type]
    networks = tuple({network: None for each in asked.values() for network in each.plan().networks})
    speeds: dict[Engine, Speed] = {}
    result = {}
    for name, each in asked.items():
        engine = choose_engine(options.runtime, precision=each.level.precision)
        if engine not in speeds:
            speeds[engine] = measure_speed(engine, networks)
        result[name] = SAFETY * estimate_seconds(speeds[engine], each, each.plan())
    return result


def estimate_seconds(speed: Speed, options: Options, plan: ReflectancePlan) -> float:
    """Seconds for one avatar."""
    width, height = options.map_size
    texels = width * height / 1e6
    work = FIT_WORK + PACKING_WORK * texels * len(set(plan.stages) & set(options.maps))
    work += DISPLACEMENT_WORK * texels * ("displacement" in plan.stages)
    work += FINE_MESH_WORK * (options.level.fine_mesh and "displacement" in options.maps)
    networks = sum(_network_seconds(name, speed.networks[name], texels) for name in plan.networks)
    return work * speed.yardstick + networks


def measure_speed(engine: Engine, networks: tuple[str, ...]) -> Speed:
    """Time one small tile of each network, and a piece of other work."""
    costs: dict[str, NetworkSpeed] = {}
    for name in networks:
        begin = time.perf_counter()
        with open_network(name, engine) as network:
            opened = time.perf_counter() - begin
            what = network.description
            small = name in ENLARGING or what.whole is not None
            side = (SAMPLE // what.scale // what.stride * what.stride if small else SAMPLE) + 2 * what.margin
            shape = (side, side) if what.whole is None else what.whole[::-1]
            maps = np.zeros((len(what.channels), *shape), np.float32)
            first, second = repeat(lambda: _run(network, maps), number=1, repeat=2)  # noqa: B023 - called at once
            seconds = min(first, second)
            tiles = (what.margin, what.scale) if what.whole is None else None
            area = shape[0] * shape[1] / 1e6 * network.lanes if tiles else 1.0
            costs[name] = NetworkSpeed(opened + first - seconds, seconds / area, tiles)
    return Speed(yardstick=min(repeat(_yardstick, number=1, repeat=2)), networks=costs)


def _run(network: Network, maps: Float32) -> None:
    """Compute as many tiles at once as the network does in a run."""
    with ThreadPoolExecutor(network.lanes) as pool:
        list(pool.map(network.run, [maps] * network.lanes))


def _network_seconds(name: str, speed: NetworkSpeed, texels: float) -> float:
    if speed.tiles is None:
        return speed.opening + speed.seconds
    margin, scale = speed.tiles
    area = TEXTURE_SIZE[0] * TEXTURE_SIZE[1] / 1e6 if name in ENLARGING else texels
    side = DEFAULT_TILE / scale
    return speed.opening + speed.seconds * area * ((side + 2 * margin) / side) ** 2


def _yardstick() -> float:
    """Numpy work of the kind that fitting and unwrapping are made of: a few hundredths of a second."""
    values = np.linspace(0.0, 1.0, 1_000_000)
    for _ in range(5):
        values = np.sqrt(values * values + 1.0) - np.sin(values)
    return float(values[0])
