"""How well hair is read: ``python -m benchmarks.hair_reading --data SHARDS --meshes DIR --photos DIR --table CSV``.

    python -m models.people --framing hair --count 128 --size 192 --out SHARDS       # grooms that are never trained on
    for m in short01 ...; do python -m models.people --framing hair --meshes $m --count 8 --out DIR/$m; done

Portraits are read by the product's own way, from their pixels: faces are found, read, and their hair after them; those
in which no face is found count as unread. Of photos a table by eye tells the kinds; its columns are photo, face (0 is
the leftmost), and any of the kinds; what is empty is not asked.
"""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from models.people.make import Portrait
from models.people.shards import decode, load
from service.arrays import Float32, UInt8
from service.errors import AvatarError
from service.face.finder import FaceFinder
from service.face.reading.part_labels import HAIR
from service.face.reading.reader import Readers, parts_at_pixels, read_face
from service.hair.kinds import KINDS, LENGTHS, length_of
from service.hair.reading import CELLS, HairNetwork, HairReading, read_hair
from service.photo.gate import read_photo

MESH_KINDS = {
    "short01": "short", "short02": "short", "short03": "short", "short04": "short", "afro01": "ear", "bob01": "jaw",
    "bob02": "jaw", "long01": "longer", "braid01": "plaits", "ponytail01": "tied",
}  # fmt: skip
"""What the meshes of the wardrobe are, by eye."""


def kind_of(kinds: dict[str, str]) -> str:
    """What somebody would call it first: how it is gathered, or else how long it is."""
    return kinds["length"] if kinds["gathered"] in ("none", "half", "") else kinds["gathered"]


def _asked(name: str) -> str:
    return "length" if name in LENGTHS else "gathered"


def kind_said(reading: HairReading) -> tuple[str, float]:
    """The likeliest of lengths and ways of gathering, and its probability."""
    gathered = reading.kinds["gathered"]
    tied = gathered["tied"] + gathered["plaits"]
    chances = {name: p * (1 - tied) for name, p in reading.kinds["length"].items()}
    chances |= {name: gathered[name] for name in ("tied", "plaits")}
    return max(chances.items(), key=lambda item: item[1])


@dataclass
class Tally:
    """Sums over portraits."""

    overlap: list[float] = field(default_factory=list)
    before: list[float] = field(default_factory=list)
    degrees: list[float] = field(default_factory=list)
    ends_mm: list[float] = field(default_factory=list)
    right: dict[str, list[bool]] = field(default_factory=lambda: defaultdict(list))
    sure: list[float] = field(default_factory=list)
    missed: int = 0

    def lines(self, name: str) -> str:
        """A row of the table."""
        kinds = "  ".join(f"{kind} {np.mean(v):.2f}" for kind, v in self.right.items() if v)
        return (
            f"{name:<12} n {len(self.overlap):>4} unread {self.missed:>3}  "
            f"overlap {_mean(self.overlap)} (parts alone {_mean(self.before)})  "
            f"direction {_mean(self.degrees, 1)}  "
            f"ends {_median(self.ends_mm)} mm  {kinds}  mean probability {_mean(self.sure)}"
        )


def _mean(values: list[float], digits: int = 3) -> str:
    return f"{np.mean(values):.{digits}f}" if values else "-"


def _median(values: list[float]) -> str:
    return f"{np.median(values):.0f}" if values else "-"


class Eyes:
    """The networks of the product."""

    def __init__(self) -> None:
        self.finder, self.readers, self.hair = FaceFinder(), Readers(), HairNetwork()

    def read(self, pixels: UInt8, near: Float32 | None = None) -> tuple[HairReading, Float32] | None:
        """Hair of the face nearest to a pixel (the largest without), and the reader's own mask; None without a face."""
        try:
            faces = self.finder.find(pixels)
        except AvatarError:
            return None
        if not faces:
            return None
        if near is not None:
            faces = sorted(faces, key=lambda f: float(np.linalg.norm(f.landmarks[:, :2].mean(0) - near)))
        read = read_face(pixels, faces[0].landmarks, self.readers)
        if read is None:
            return None
        found = read_hair(pixels, read, self.hair)
        if found is None:
            return None
        own = parts_at_pixels(read, found.cells)[:, HAIR].reshape(CELLS, CELLS)
        return found, own


def likeliest(chances: Mapping[str, float]) -> tuple[str, float]:
    """The likeliest of some choices, and its probability."""
    return max(chances.items(), key=lambda item: item[1])


def compare(tally: Tally, portrait: Portrait, found: HairReading, own: Float32, kinds: dict[str, str]) -> None:
    """Take in one portrait."""
    size = CELLS
    matrix = found.region.matrix(size)
    shift = matrix[:, 2] + matrix[:, :2] @ [0.5, 0.5] - 0.5
    warp = np.concatenate([matrix[:, :2], shift[:, None]], 1)

    def cut(image: Float32) -> Float32:
        return np.asarray(cv2.warpAffine(image, warp, (size, size), flags=cv2.INTER_AREA | cv2.WARP_INVERSE_MAP))

    true, way = cut(portrait.hair) > 0.5, cut(portrait.direction)
    if true.sum() < 20:
        return
    inside = cut(np.ones_like(portrait.hair)) > 0.5
    for values, mask in ((tally.overlap, found.mask), (tally.before, own)):
        said = (mask > 0.5) & inside
        values.append(float((said & true).sum() / max((said | true).sum(), 1)))
    cos, sin = np.cos(found.region.angle), np.sin(found.region.angle)
    way = way @ np.array([[cos, -sin], [sin, cos]])
    strands = true & (np.linalg.norm(way, axis=2) > 0.5)
    if strands.sum() > 20:
        way = way[strands] / np.linalg.norm(way[strands], axis=1, keepdims=True)
        cosine = np.clip((found.direction[strands] * way).sum(1), -1, 1)
        tally.degrees.append(float(np.degrees(np.arccos(cosine)).mean()))
    if np.isfinite(portrait.ends_m) and kinds["gathered"] in ("none", "half"):
        tally.ends_mm.append(1000 * abs(found.ends_m[0] - portrait.ends_m))
    said_kind, chance = kind_said(found)
    tally.right["kind"].append(said_kind == kind_of(kinds))
    tally.sure.append(chance)
    for kind, name in kinds.items():
        if name and not (kind == "curl" and kinds["length"] == "cropped"):
            tally.right[kind].append(likeliest(found.kinds[kind])[0] == name)


def of_portraits(data: Path, most: int, eyes: Eyes, mesh: str = "") -> dict[str, Tally]:
    """Tallies of all, and by curl; of a mesh, whose kind is known by its name, by that name."""
    tallies: dict[str, Tally] = defaultdict(Tally)
    for path in sorted(data.glob("people-*.npz")):
        for portrait in decode(load(path)):
            if most <= 0:
                return tallies
            most -= 1
            kinds = dict(portrait.kinds)
            if kinds["length"] not in ("", "cropped"):  # by today's borders, whatever they were when it was drawn
                kinds["length"] = length_of(portrait.ends_m)
            if mesh:
                if (portrait.hair > 0.5).sum() < 40:  # under a scarf
                    continue
                kinds = dict.fromkeys(KINDS, "") | {_asked(MESH_KINDS[mesh]): MESH_KINDS[mesh]}
            read = eyes.read(portrait.image, portrait.points[:468].mean(0))
            for name in ("all", mesh or kinds["curl"]):
                if read is None:
                    tallies[name].missed += 1
                else:
                    compare(tallies[name], portrait, *read, kinds)
    return tallies


def of_photos(photos: Path, table: Path, eyes: Eyes) -> str:
    """Right and wrong by a table that somebody wrote by eye."""
    lines, right = [], defaultdict(list)
    with table.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            pixels = read_photo((photos / row["photo"]).read_bytes()).pixels
            faces = sorted(eyes.finder.find(pixels), key=lambda f: float(f.landmarks[:, 0].mean()))
            face = faces[int(row.get("face") or 0)] if len(faces) > 1 else faces[0]
            read = read_face(pixels, face.landmarks, eyes.readers)
            found = None if read is None else read_hair(pixels, read, eyes.hair)
            if found is None:
                lines.append(f"{row['photo']}: not read")
                continue
            asked = dict.fromkeys(KINDS, "") | {name: row[name] for name in KINDS if row.get(name)}
            said, chance = kind_said(found)
            true = kind_of(asked)
            right["kind"].append(said == true)
            told = []
            for kind, name in asked.items():
                if name:
                    choice, p = likeliest(found.kinds[kind])
                    right[kind].append(choice == name)
                    told.append(f"{kind} {choice} {p:.2f}" + ("" if choice == name else f" (is {name})"))
            ends = f"ends {found.ends_m[0]:.3f}+-{found.ends_m[1]:.3f} ({length_of(found.ends_m[0])})"
            mark = "ok" if said == true else f"NO: {true}"
            lines.append(f"{row['photo']:<34} {said:<9}{chance:.2f} {mark:<13} {ends}  {', '.join(told)}")
    sums = "  ".join(f"{kind} {sum(v)}/{len(v)}" for kind, v in right.items())
    return "\n".join([*lines, sums])


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of shards of people with grooms.")] = None,
    meshes: Annotated[Path | None, typer.Option(help="Folder of folders of shards, each named like its mesh.")] = None,
    photos: Annotated[Path | None, typer.Option(help="Folder of photos.")] = None,
    table: Annotated[Path | None, typer.Option(help="CSV of their kinds by eye.")] = None,
    most: Annotated[int, typer.Option(min=1, help="Portraits of each folder.")] = 256,
) -> None:
    """Measure what is given."""
    eyes = Eyes()
    if data is not None:
        for name, tally in of_portraits(data, most, eyes).items():
            print(tally.lines(name or "no hair"))
    if meshes is not None:
        for folder in sorted(path for path in meshes.iterdir() if path.name in MESH_KINDS):
            print(of_portraits(folder, most, eyes, folder.name)["all"].lines(folder.name))
    if photos is not None and table is not None:
        print(of_photos(photos, table, eyes))


if __name__ == "__main__":
    typer.run(main)
