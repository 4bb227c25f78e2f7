"""How far to trust the reader's own uncertainty: ``python -m benchmarks.calibration --data SHARDS [--most 48]``.

Reads portraits of synthetic people that no network was trained on (shards whose first seed is below 2048, or those of
``--start``) in the way of the program, mirror image and floors included, and prints for every range of the stated
standard deviation how large the errors of chart coordinates and normals are beside it: a two-dimensional Gaussian has
39 % of its errors within one and a median of 1.18 of them. Below it the correlation of the errors of cells by their
distance on the face: what the fit's ``POINT_SHARE`` and ``NORMAL_SHARE`` stand for.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from models.people.make import Portrait
from models.people.shards import decode, load
from service.face.fit.dense import FLOOR_MM, FLOOR_SINE, LEAST_SHARE
from service.face.reading.parts import READ
from service.face.reading.reader import CELLS, CHART_MM, ReaderNetwork, Reading, crop_of

Float = npt.NDArray[np.float64]

HELD_OUT_BELOW = 2048
"""Seeds of people that no network is trained on."""
RANGES_MM = (0.0, 1.5, 2.0, 3.0, 5.0, np.inf)
RANGES_SINE = (0.0, 0.1, 0.15, 0.2, 0.3, np.inf)
DISTANCES_MM = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 90.0)
PAIRS = 20_000
"""Random pairs of cells of one face whose errors are compared."""


@dataclass(frozen=True)
class Errors:
    """Of the N cells of one face whose truth is known.

    Attributes:
        place: (N, 2) millimetres on the chart; off: (N, 2) read less true place, millimetres; sigma_mm: (N,).
        turn: (N,) distance of the read from the true unit normal; sine: (N,) stated deviation of each component.
    """

    place: Float
    off: Float
    sigma_mm: Float
    turn: Float
    sine: Float


def errors(reading: Reading, person: Portrait) -> Errors:
    """Of one portrait, with the floors of the fit, in the cells that the fit uses and whose truth is known."""
    share = reading.parts[..., list(READ)].sum(-1).astype(np.float32)
    used = cv2.resize(share, (CELLS, CELLS), interpolation=cv2.INTER_AREA).ravel() > LEAST_SHARE
    height, width = person.part.shape
    x, y = np.floor(reading.cells).astype(int).T
    inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    true = person.chart[y, x].astype(np.float64)
    known = used & inside & np.isin(person.part[y, x], READ) & np.isfinite(true).all(1) & (true[:, 0] > 0)
    read = reading.chart.reshape(-1, 2)[known]
    camera = person.camera
    normal = reading.camera_normals(camera.focal_px, camera.principal_point).reshape(-1, 3)[known]
    turn = np.linalg.norm(normal - person.normal[y, x][known], axis=1)
    return Errors(
        true[known] * CHART_MM, (read - true[known]) * CHART_MM,
        np.hypot(reading.chart_mm.ravel()[known], FLOOR_MM),
        turn, np.hypot(reading.normal_sine.ravel()[known], FLOOR_SINE),
    )  # fmt: skip


def table(name: str, ratio: Float, sigma: Float, edges: tuple[float, ...], dof: int) -> list[str]:
    """Rows of a Markdown table: error over stated deviation by ranges of the latter; empty ranges are left out."""
    due = {2: "0.39, 1.18", 3: "0.20, 1.54"}[dof]
    rows = [f"| {name} | cells | within one | median error over it | ({due} if right) |", "|---|---|---|---|---|"]
    for low, high in itertools.pairwise(edges):
        here = ratio[(sigma >= low) & (sigma < high)]
        if len(here):
            rows.append(f"| {low:g} to {high:g} | {len(here)} | {(here < 1).mean():.2f} | {np.median(here):.2f} | |")
    return rows


def correlation(faces: list[Errors], seed: int = 0) -> list[tuple[float, float]]:
    """(distance in mm, correlation of the errors over their deviations) of cells of one face; NaN without pairs."""
    random = np.random.default_rng(seed)
    sums = np.zeros((len(DISTANCES_MM) - 1, 2))
    square = 0.0
    count = 0
    for face in (face for face in faces if len(face.off) > 1):
        scaled = np.clip(face.off / face.sigma_mm[:, None], -4.0, 4.0)
        square, count = square + float((scaled**2).sum()), count + len(scaled)
        i, k = random.integers(len(scaled), size=(2, PAIRS))
        i, k = i[i != k], k[i != k]
        bin_ = np.digitize(np.linalg.norm(face.place[i] - face.place[k], axis=1), DISTANCES_MM) - 1
        for b in range(len(sums)):
            sums[b] += [(scaled[i] * scaled[k]).sum(1)[bin_ == b].sum(), (bin_ == b).sum()]
    variance = square / max(count, 1)
    middle = 0.5 * (np.array(DISTANCES_MM[:-1]) + DISTANCES_MM[1:])
    with np.errstate(invalid="ignore", divide="ignore"):
        values = sums[:, 0] / sums[:, 1] / variance if variance > 0 else np.full(len(sums), np.nan)
    return [(float(m), float(v)) for m, v in zip(middle, values, strict=True)]


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of shards")
    parser.add_argument("--start", type=int, default=0, help="first seed of the people")
    parser.add_argument("--most", type=int, default=48, help="people at most")
    chosen = parser.parse_args()
    network = ReaderNetwork()
    faces: list[Errors] = []
    for path in sorted(chosen.data.glob("people-*.npz")):
        first = int(path.stem.split("-")[2])
        if first < chosen.start or (first >= HELD_OUT_BELOW) != (chosen.start >= HELD_OUT_BELOW):
            continue
        for person in decode(load(path)):
            region = crop_of(np.concatenate([person.points[:468], np.zeros((468, 1))], 1).astype(np.float64))
            if region is not None and len(faces) < chosen.most:
                faces.append(errors(network(person.image, region), person))
        if len(faces) >= chosen.most:
            break
    if not faces:
        raise SystemExit(f"{chosen.data}: no people to read; make some with python -m models.people")
    sys.stdout.write("\n".join(report(faces)) + "\n")


def report(faces: list[Errors]) -> list[str]:
    """All lines that are printed."""
    off = np.concatenate([np.linalg.norm(face.off, axis=1) for face in faces])
    turn = np.concatenate([face.turn for face in faces])
    mm, sine = np.concatenate([face.sigma_mm for face in faces]), np.concatenate([face.sine for face in faces])
    lines = [f"{len(faces)} people, {len(off)} cells: chart {np.median(off):.2f} mm, normals "
             f"{np.degrees(2 * np.arcsin(np.clip(np.median(turn) / 2, 0, 1))):.1f} degrees (medians).", ""]  # fmt: skip
    lines += [*table("stated, mm", off / mm, mm, RANGES_MM, 2), ""]
    lines += [*table("stated, sine", turn / sine, sine, RANGES_SINE, 3), ""]
    lines += ["| distance on the face, mm | correlation of the chart's errors |", "|---|---|"]
    return lines + [f"| {distance:.1f} | {value:.2f} |" for distance, value in correlation(faces)]


if __name__ == "__main__":
    main()
