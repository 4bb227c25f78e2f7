"""Error of the fit against its cost: ``python -m benchmarks.fit [--photos build/bench] [--write docs] [--reader DIR]``.

Takes the photos of ``benchmarks.shoot``, finds and reads each face once, fits it with a list of settings and prints
for every setting two errors in mm at 63 mm between the pupils: the distance to the nearest point after a similarity
ICP, and that at the same pixel without one; and their ratios to the average head's with pose only on the same photos.
For the default also by yaw, by light and for the heads that no default was chosen on. ``--write`` puts the tables into
``fit-accuracy.md`` with a plot beside it. ``--reader`` compares other networks on the same photos: folders with a
``reader.onnx`` each (``python -m export.networks.reader RUN --data HELD -o DIR``).

``--views 1,2,3,5,8`` fits heads to the first so many of the photos that ``benchmarks.shoot --views`` took of them, from
all sides, and prints the same errors of each head where its first photo, a frontal one, shows it, and over all photos.

``--real DIR`` fits the largest face of each photo in a folder and prints how far its landmarks lie from the photo's, as
a share of the distance between the eyes, and the mean of those turned by less than 20 degrees.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the program itself does

import numpy as np

from benchmarks.metrics import Score, Truth, score
from service.errors import AvatarError
from service.face.finder import Face, FaceFinder, choose_face
from service.face.fit.fit import Fit, FitSettings
from service.face.fit.fit_face import fit_views
from service.face.profile import faces_by_reading
from service.face.reading.reader import ReaderNetwork, Readers, Reading, View, read_face
from service.face.several import read_view
from service.head.files import load_head
from service.head.model import HeadModel
from service.photo.gate import read_photo
from service.photo.photo import Photo
from service.runtime.sessions import load_session

FRONTAL_DEG = 20.0
"""Yaw below which a photo is a frontal one."""
HELD_OUT = range(110, 1000)
"""ICT heads on which no setting was looked at while defaults were chosen."""
DEFAULT = "+ free form (full)"
AVERAGE = "average head, pose only"
SETTINGS: dict[str, dict[str, Any]] = {
    AVERAGE: {"identity_components": 0, "refine": "landmarks"},
    "landmarks (not read)": {"refine": "landmarks"},
    "landmarks, outline (not read)": {},
    "landmarks + scores": {"refine": "landmarks"},
    "+ places": {"refine": "dense", "normals": False},
    "+ normals (dense)": {"refine": "dense"},
    DEFAULT: {},
    "full without normals": {"normals": False},
    "full, 40 components": {"identity_components": 40},
    "full, 150 modes of free form": {"beyond": 150},
    "full, identity prior 0.3": {"identity_prior": 0.3},
    "full, identity prior 3": {"identity_prior": 3.0},
}
NOT_READ = "not read"
"""Settings whose names hold this are fitted without a reading."""


@dataclass(frozen=True)
class Shot:
    """A photo with its face and truth."""

    name: str
    photo: Photo
    face: Face
    reading: Reading | None
    truth: Truth

    @property
    def head_number(self) -> int:
        """Number of the ICT head, -1 for another head."""
        head = self.name.split("_")[0]
        return int(head[3:]) if head.startswith("ict") else -1


@dataclass(frozen=True)
class Result:
    """One fit, scored."""

    shot: Shot
    score: Score
    landmark_percent: float
    pose_error_deg: float
    seconds: float


def load_shots(folder: Path, readers: Readers | None = None) -> tuple[list[Shot], int]:
    """Photos in which a face was found, read by ``readers`` (None: the shipped ones), and how many have none."""
    import cv2

    finder, networks, head, shots, missed = FaceFinder(), readers or Readers(), load_head(), [], 0
    for path in sorted(folder.glob("*_*_*.npz")):
        image = cv2.imread(str(path.with_suffix(".png")))
        if image is None:
            raise SystemExit(f"{path}: its photo is missing")
        pixels = np.ascontiguousarray(image[..., ::-1]).astype(np.uint8, copy=False)
        faces = finder.find(pixels)
        faces = faces or faces_by_reading(pixels, finder.doubted(pixels), head, networks.pixels)
        missed += not faces
        if faces:
            view = read_view(View(Photo(pixels), faces[0]), networks, head)
            shots.append(Shot(path.stem, view.photo, view.face, view.reading, Truth.load(str(path))))
    return shots, missed


def run(shots: list[Shot], head: HeadModel, settings: FitSettings, *, read: bool = True) -> tuple[list[Result], int]:
    """Fit and score every shot, with its reading or without; the number that could not be fitted comes second."""
    results, failed = [], 0
    for shot in shots:
        begin = time.process_time()
        try:
            [fit] = fit_views([View(shot.photo, shot.face, shot.reading if read else None)], head, settings)
            seconds = time.process_time() - begin
            scored = score(fit, head, shot.truth)
        except (AvatarError, ValueError):
            failed += 1
            continue
        pose = abs(-fit.camera.yaw_pitch_roll_deg()[0] - shot.truth.yaw)
        percent = 100 * fit.landmark_rms_px / fit.inter_ocular_px
        results.append(Result(shot, scored, percent, pose, seconds))
    return results, failed


def people(folder: Path, readers: Readers | None = None) -> dict[str, list[Shot]]:
    """Photos of each head by ``benchmarks.shoot --views``, in the order in which they are used."""
    shots, missed = load_shots(folder, readers)
    found: dict[str, list[Shot]] = {}
    for shot in shots:
        found.setdefault(shot.name.split("_")[0], []).append(shot)
    if missed:
        print(f"no face found in {missed} photos", flush=True)
    return {name: sorted(own, key=lambda shot: int(shot.name.split("_")[1])) for name, own in sorted(found.items())}


VIEWS_HEADER = (
    "| photos of each head | nearest in the first, mm | over the average head's | same pixel, mm | over it | nearest "
    "in all, mm | over it | CPU s of each further photo |\n|---|" + "---|" * 7
)


def by_views(folder: Path, counts: Sequence[int], head: HeadModel) -> None:
    """Print a table: the joint fit of each head's first so many photos, beside the average head's in the same ones."""
    everybody, average = people(folder), FitSettings(**SETTINGS[AVERAGE])
    print(f"{len(everybody)} heads, each from all sides in other lights by other cameras.\n", flush=True)
    print(VIEWS_HEADER, flush=True)
    usual = {
        shot.name: _scored(fit_views([View(shot.photo, shot.face)], head, average)[0], head, shot)
        for shots in everybody.values()
        for shot in shots
    }
    alone = 0.0
    for count in counts:
        pairs: list[list[tuple[Score | None, Score | None]]] = []
        begin = time.process_time()
        for shots in everybody.values():
            fits = fit_views([View(s.photo, s.face, s.reading) for s in shots[:count]], head)
            scored = zip(fits, shots, strict=False)
            pairs.append([(_scored(fit, head, shot), usual[shot.name]) for fit, shot in scored])
        seconds = (time.process_time() - begin) / len(everybody)
        alone = alone or seconds
        first = np.array([[(s.median_mm, s.same_pixel_mm) for s in own[0] if s] for own in pairs]).mean(0)
        every = np.array([[s.median_mm for s in pair if s] for own in pairs for pair in own if all(pair)]).mean(0)
        (near, pixel), (near_over, pixel_over) = first[0], first[0] / first[1]
        print(
            f"| {count} | {near:.3f} | **{near_over:.3f}** | {pixel:.3f} | **{pixel_over:.3f}** | {every[0]:.3f} "
            f"| {every[0] / every[1]:.3f} | {(seconds - alone) / max(count - 1, 1):.2f} |", flush=True,
        )  # fmt: skip


def _scored(fit: Fit, head: HeadModel, shot: Shot) -> Score | None:
    """None where fit and truth share no pixels: the average head lies far off in some profiles."""
    try:
        return score(fit, head, shot.truth)
    except ValueError:
        return None


def read_by(folder: Path, shots: list[Shot]) -> list[Shot]:
    """The same shots, read by the ``reader.onnx`` of a folder."""
    readers = Readers(pixels=ReaderNetwork(load_session("reader", folder=folder)))
    return [replace(s, reading=read_face(s.photo.pixels, s.face.landmarks, readers)) for s in shots]


def row(name: str, results: list[Result], average: dict[str, Score]) -> str:
    """One line of a Markdown table; ``average``: the average head's scores by photo."""
    same = [r for r in results if r.shot.name in average]
    if not same:
        return f"| {name} | 0 |" + " |" * (HEADER.split("\n")[0].count("|") - 3)

    def mean(value: Callable[[Score], float], results: list[Result] = same) -> float:
        values = np.array([value(r.score) for r in results])
        return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")

    def ratio(value: Callable[[Score], float]) -> float:
        return mean(value) / float(np.mean([value(average[r.shot.name]) for r in same]))

    nearest, pixel = (lambda s: s.median_mm), (lambda s: s.same_pixel_mm)
    columns = [
        f"{mean(nearest):.2f}", f"**{ratio(nearest):.3f}**", f"{mean(pixel):.2f}", f"**{ratio(pixel):.3f}**",
        f"{mean(lambda s: s.normal_deg):.1f}", f"{mean(lambda s: s.silhouette_iou):.3f}",
        f"{mean(lambda s: s.jaw_iou):.3f}", f"{mean(lambda s: abs(s.width_percent)):.1f}",
        f"{np.mean([r.landmark_percent for r in same]):.2f}", f"{np.median([r.pose_error_deg for r in same]):.1f}",
        f"{np.median([r.seconds for r in same]):.2f}",
    ]  # fmt: skip
    return f"| {name} | {len(same)} | " + " | ".join(columns) + " |"


HEADER = (
    "| | photos | nearest, mm | over the average head's | same pixel, mm | over the average head's | normals, deg "
    "| overlap | overlap, eyes to chin | width at the mouth, % off | landmark rms, % of eye distance | yaw error, deg "
    "| CPU s |\n|---|" + "---|" * 12
)


def parts(results: list[Result]) -> list[tuple[str, list[Result]]]:
    """The default's results by yaw, light and set of heads."""
    out = [(f"yaw {yaw}", [r for r in results if f"_{yaw}_" in r.shot.name]) for yaw in (0, 25, 45)]
    out += [(f"{light} light", [r for r in results if r.shot.name.endswith(light)]) for light in ("soft", "harsh")]
    frontal = [r for r in results if "_0_" in r.shot.name and r.shot.head_number in HELD_OUT]
    out.append(("ICT heads, held out, frontal", frontal))
    out.append(("FFHQ-UV head", [r for r in results if r.shot.head_number < 0]))
    out.append(("ICT heads", [r for r in results if r.shot.head_number >= 0]))
    out.append(("ICT heads, held out", [r for r in results if r.shot.head_number in HELD_OUT]))
    return out


def plot(points: dict[str, tuple[float, float]], path: Path) -> None:
    """Error against time, one point a setting, the default marked."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7.5, 4.5))
    for name, (seconds, error) in points.items():
        chosen = name == DEFAULT
        axes.plot(seconds, error, "o", color="tab:red" if chosen else "tab:blue", markersize=9 if chosen else 5)
        axes.annotate(name, (seconds, error), xytext=(5, 4), textcoords="offset points", fontsize=7)
    axes.set_xlabel("CPU seconds per photo")
    axes.set_ylabel("median surface error, mm")
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def of_real(folder: Path, head: HeadModel) -> list[str]:
    """A line for each photo of a folder, and one of the frontal ones: root mean square distance of landmarks."""
    finder, readers, lines, frontal = FaceFinder(), Readers(), [], []
    for path in sorted(folder.iterdir()):
        try:
            photo = read_photo(path.read_bytes())
            face = choose_face(finder.find(photo.pixels), "largest", photo.pixels.shape[1::-1])
            [fit] = fit_views([read_view(View(photo, face), readers, head)], head, FitSettings())
        except (AvatarError, ValueError) as error:
            lines.append(f"{path.name}: {error}")
            continue
        yaw, percent = fit.camera.yaw_pitch_roll_deg()[0], 100 * fit.landmark_rms_px / fit.inter_ocular_px
        frontal += [percent] if abs(yaw) < FRONTAL_DEG else []
        lines.append(f"{path.name}: yaw {yaw:.0f} degrees, landmarks {percent:.2f} %")
    mean = np.mean(frontal) if frontal else np.nan
    return [*lines, f"{len(frontal)} frontal photos: {mean:.2f} % of the distance between the eyes"]


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=Path, default=Path("build/bench"))
    parser.add_argument("--write", type=Path)
    parser.add_argument("--reader", type=Path, action="append", default=[], help="folder of another reader; repeatable")
    parser.add_argument("--compare", type=int, default=60, help="compare settings on this many photos at most")
    parser.add_argument("--views", help="numbers of photos of each head, 1,2,3,5,8")
    parser.add_argument("--real", type=Path, help="folder of photos of real people")
    arguments = parser.parse_args()
    if arguments.real:
        print("\n".join(of_real(arguments.real, load_head())))
        return
    if arguments.views:
        counts = [int(count) for count in arguments.views.split(",")]
        by_views(arguments.photos / "views", counts, load_head())
        return
    shots, missed = load_shots(arguments.photos)
    if not shots:
        raise SystemExit(f"{arguments.photos}: no photos; take them by python -m benchmarks.shoot")
    heads = len({shot.name.split("_")[0] for shot in shots if shot.head_number >= 0})
    head = load_head()
    lines = [f"{len(shots) + missed} photos ({heads} ICT heads and the FFHQ-UV head); no face found in {missed}.", ""]
    average = {r.shot.name: r.score for r in run(shots, head, FitSettings(**SETTINGS[AVERAGE]), read=False)[0]}
    default, failed = run(shots, head, FitSettings())
    lines += [f"## The default ({failed} photos could not be fitted)", "", HEADER, row("all", default, average)]
    lines += [row(name, part, average) for name, part in parts(default)]
    print("\n".join(lines), flush=True)
    open_shots = [shot for shot in shots if shot.head_number not in HELD_OUT]
    order = np.random.default_rng(0).permutation(len(open_shots))[: max(1, arguments.compare)]
    some = [open_shots[k] for k in sorted(order)]
    lines += ["", f"## By setting, on {len(some)} random photos of heads that are not held out", "", HEADER]
    points: dict[str, tuple[float, float]] = {}
    for name, values in SETTINGS.items():
        results, failed = run(some, head, FitSettings(**values), read=NOT_READ not in name)
        lines.append(row(name + (f" ({failed} failed)" if failed else ""), results, average))
        print(lines[-1], flush=True)
        points[name] = (_median([r.seconds for r in results]), _median([r.score.median_mm for r in results]))
    for folder in arguments.reader:
        results, failed = run(read_by(folder, some), head, FitSettings())
        lines.append(row(f"full, reader {folder.name}" + (f" ({failed} failed)" if failed else ""), results, average))
        print(lines[-1], flush=True)
    if arguments.write:
        plot(points, arguments.write / "fit-accuracy.png")
        text = "# Accuracy of the fit\n\nWritten by `python -m benchmarks.fit --write docs`"
        text += " on photos of `python -m benchmarks.shoot`.\n\n![error against time](fit-accuracy.png)\n\n"
        (arguments.write / "fit-accuracy.md").write_text(text + "\n".join(lines) + "\n", encoding="utf-8")


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else float("nan")


if __name__ == "__main__":
    main()
