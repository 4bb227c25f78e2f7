"""Eyes and mouths told right: ``python -m benchmarks.states --photos build/states [--count 48]``.

Portraits of ``models.people`` that no network was trained on (seeds below 2048), 640 x 640, turned by less than 35
degrees, with nothing before eyes and mouth: open, half closed, closed and winking eyes, shut and open mouths, in the
light of their seeds. Each goes through finder, readers and fit as in the program. Openings are those of the fitted and
of the true mesh, millimetres at 63 mm between the eyes. Portraits are kept in the folder: another run needs no OpenGL.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from service.face.features.rims import RIMS
from service.face.finder import FaceFinder
from service.face.fit.fit import Fit
from service.face.fit.fit_face import fit_views
from service.face.reading.reader import Readers, View, read_face
from service.head.files import load_head
from service.head.model import HeadModel
from service.head.regions import inter_ocular_m, lid_edges, lip_edges
from service.photo.gate import read_photo

SIZE, MOST_YAW, HELD_OUT = 640, 35.0, 2048
STATES = ("open", "half", "closed", "wink")
SHUT_MM, OPEN_MM = 1.0, 3.0
"""An opening up to the first is shut, from the second on open; between them nothing is told right or wrong."""
SIDES = ("right", "left")


@dataclass(frozen=True)
class Told:
    """One opening: what it is ("right", "left", "mouth"), and its height in truth and in the fit, millimetres."""

    name: str
    true_mm: float
    found_mm: float

    @property
    def off(self) -> float:
        """Error, millimetres."""
        return abs(self.found_mm - self.true_mm)

    @property
    def right(self) -> bool | None:
        """Whether shut was told from open; None where the truth is neither."""
        if SHUT_MM < self.true_mm < OPEN_MM:
            return None
        return (self.found_mm < 0.5 * (SHUT_MM + OPEN_MM)) == (self.true_mm <= SHUT_MM)


def openings_mm(head: HeadModel, vertices: npt.NDArray[np.floating]) -> dict[str, float]:
    """Heights of the openings in their middle, along the head's y axis; 0 where the edges meet or pass each other."""
    found = {}
    scale = 63.0 / inter_ocular_m(head, vertices)
    for name in (*SIDES, "mouth"):
        edges = lip_edges(head) if name == "mouth" else lid_edges(head, name)
        if edges is None:
            raise ValueError(f"the head has no edges of {name}")
        found[name] = max(edges.height(vertices) * scale, 0.0)
    return found


def make(folder: Path, count: int) -> None:
    """Draw portraits until there are ``count``, the states of the eyes in turn."""
    from models.people.make import portrait
    from models.people.person import draw_person

    folder.mkdir(parents=True, exist_ok=True)
    kept = [path.stem.split("-")[1] for path in folder.glob("*.npz")]
    missing = {state: count // len(STATES) - kept.count(state) for state in STATES}
    for seed in range(HELD_OUT):
        state = draw_person(seed).eyes
        if missing[state] <= 0 or (folder / f"{seed:04}-{state}.npz").is_file():
            continue
        person = portrait(seed, SIZE)
        rims = [point for rim in RIMS.values() for point in rim]
        turned = abs(person.camera.yaw_pitch_roll_deg()[0])
        if turned > MOST_YAW or person.seen[rims].mean() < 0.9:
            continue
        jpeg = np.frombuffer(person.jpeg, np.uint8)
        np.savez_compressed(folder / f"{seed:04}-{state}.npz", jpeg=jpeg, vertices=person.vertices)
        missing[state] -= 1


def fits(folder: Path, head: HeadModel, reads: bool = True) -> Iterator[tuple[str, Fit, npt.NDArray[np.float64]]]:
    """Name, fit and true vertices (V, 3) of each portrait whose face is found.

    Without ``reads`` lids, lips and expression are those of the landmarks.
    """
    finder, readers = FaceFinder(), Readers()
    for path in sorted(folder.glob("*.npz")):
        with np.load(path, allow_pickle=False) as data:
            photo, vertices = read_photo(data["jpeg"].tobytes()), data["vertices"].astype(np.float64)
        faces = finder.find(photo.pixels)
        if not faces:
            print(f"{path.stem}: no face")
            continue
        face = faces[0]
        reading = read_face(photo.pixels, face.landmarks, readers)
        if reading is not None and not reads:
            reading = replace(reading, openings={}, scores=None)
        yield path.stem, fit_views([View(photo, face, reading)], head)[0], vertices


def measured(folder: Path, reads: bool) -> Iterator[tuple[str, list[Told]]]:
    """State and openings of each portrait whose face is found."""
    head = load_head()
    for stem, fit, vertices in fits(folder, head, reads):
        true, found = openings_mm(head, vertices), openings_mm(head, fit.vertices.astype(np.float64))
        yield stem, [Told(name, true[name], found[name]) for name in true]


def table(results: list[tuple[str, list[Told]]]) -> list[str]:
    """Rows by state of the eyes, and of the mouth."""
    rows = ["| | openings | told right | mean error, mm | 90th percentile |", "|---|---|---|---|---|"]
    groups: dict[str, list[Told]] = {}
    for stem, told in results:
        for one in told:
            state = f"mouth {_height(one.true_mm)}" if one.name == "mouth" else "eyes " + stem.split("-")[1]
            groups.setdefault(state, []).append(one)
            groups.setdefault("all mouths" if one.name == "mouth" else "all eyes", []).append(one)
    for name, group in sorted(groups.items()):
        judged = [one.right for one in group if one.right is not None]
        off = np.array([one.off for one in group])
        right = f"{sum(judged)} of {len(judged)}"
        rows.append(f"| {name} | {len(group)} | {right} | {off.mean():.2f} | {np.percentile(off, 90):.2f} |")
    return rows


def _height(mm: float) -> str:
    return "shut" if mm <= SHUT_MM else "open" if mm >= OPEN_MM else "between"


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=Path, required=True, help="folder of the portraits")
    parser.add_argument("--count", type=int, default=48)
    parser.add_argument("--without", action="store_true", help="lids, lips and expression from landmarks, to compare")
    parser.add_argument("--each", action="store_true", help="a line for each portrait")
    chosen = parser.parse_args()
    make(chosen.photos, chosen.count)
    results = list(measured(chosen.photos, not chosen.without))
    if chosen.each:
        for stem, told in results:
            print(stem, *(f"{one.name} {one.true_mm:.1f} {one.found_mm:.1f}" for one in told))
    print("\n".join(table(results)))


if __name__ == "__main__":
    main()
