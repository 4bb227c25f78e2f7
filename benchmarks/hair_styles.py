"""Styles of hair found again: ``python -m benchmarks.hair_styles --photos build/hair_styles [--count 48]``.

Portraits of ``models.people`` that no network was trained on, 384 x 384, turned by less than 45 degrees, with nothing
on or before the head, at most an eighth of them in each style. They are read by the product's reader; camera and shape
are the true ones. Each row leaves one thing out of the choice. Bald heads, hair painted on and fur count as cropped.
Portraits are kept in the folder: another run needs no OpenGL.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from models.people.dress import dress, hair_colour
from models.people.figure import recessed
from models.people.light import draw_light
from models.people.make import portrait
from models.people.person import Person, draw_person, the_head
from models.people.pose import draw_camera, landmarks
from models.people.skins import load_skin
from models.people.wardrobe import load_wardrobe
from service.anatomy.hair import find_hair as choosing
from service.anatomy.hair.find_hair import Seen
from service.anatomy.hair.wearables import Frame, Skull, read_items
from service.arrays import UInt8
from service.face.reading import parts as labels
from service.face.reading.reader import AROUND_ABOVE, AROUND_FILL, ReaderNetwork, crop_of
from service.head.regions import vertex_mask
from service.photo.photo import Photo

SIZE, MOST_YAW, FIRST = 384, 45.0, 500_001
SKINS = (1, 6, 9, 14)
"""Skins of the people, as drawing one takes long."""
CROPPED = "cropped"
ROWS: dict[str, dict[str, object]] = {
    "all": {},
    "without waste": {"WASTE": 0.0},
    "without thickness": {"CROPPED_MM": -1e9},
    "without fitted outlines": {"to_outline": lambda points, *_: (points, 0.0)},
    "without the wider crop": {},
}  # fmt: skip
"""What of ``service.anatomy.hair.find_hair`` is replaced."""


@dataclass(frozen=True)
class Worn:
    """Somebody, and the style that they wear: a name, or "cropped"."""

    seed: int
    style: str
    image: UInt8


def style_of(seed: int, person: Person, folder: Path) -> str | None:
    """What a person wears; None where something else is on or before the head."""
    skin = load_skin(person.skin, folder)
    outfit = dress(seed, person, skin, hair_colour(person, skin), load_wardrobe(), draw_light(seed).level())
    if outfit.screens or any(mesh.label in (labels.HAT, labels.OTHER) for mesh in outfit.meshes):
        return None
    cards = [mesh.picture for mesh in outfit.meshes if mesh.picture and mesh.picture.startswith("hair/")]
    return cards[0] if cards else CROPPED


def people(folder: Path, count: int) -> Iterator[Worn]:
    """``count`` portraits, drawn where they are not in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    found: dict[str, int] = {}
    seed = FIRST
    while sum(found.values()) < count:
        seed += 1
        person, path = draw_person(seed), folder / f"{seed}.npz"
        if person.skin not in SKINS:
            continue
        camera = draw_camera(seed, SIZE, landmarks(the_head(), recessed(person)))
        style = style_of(seed, person, folder) if abs(camera.yaw_pitch_roll_deg()[0]) < MOST_YAW else None
        if style is None or found.get(style, 0) >= count / 8:
            continue
        if not path.is_file():
            np.savez_compressed(path, image=portrait(seed, SIZE, folder).image)
        found[style] = found.get(style, 0) + 1
        with np.load(path) as kept:
            yield Worn(seed, style, kept["image"])


def chosen(worn: Worn, reader: ReaderNetwork, without: str) -> str | None:
    """The style that is chosen for a portrait; None where too little of the hair is seen to tell."""
    head, person = the_head(), draw_person(worn.seed)
    vertices = recessed(person)
    points = landmarks(head, vertices)
    camera = draw_camera(worn.seed, SIZE, points)
    flat = camera.project(points)[:468]
    narrow, wide = crop_of(flat), crop_of(flat, AROUND_FILL, AROUND_ABOVE)
    if narrow is None or wide is None:
        return None
    around = None if without == "without the wider crop" else reader(worn.image, wide)
    seen = Seen.of(Photo(worn.image), replace(reader(worn.image, narrow), around=around))
    side = len(seen.hair)
    frame = Frame.of(
        camera, lambda at: seen.region.to_crop(at, side), side, head, vertices, vertex_mask(head, "scalp")
    )
    with ExitStack() as held:
        for name, value in ROWS[without].items():
            held.enter_context(patch.object(choosing, name, value))
        skull = Skull.of(head, person.neutral)
        found = choosing.choose(read_items(), skull, frame, seen.hair, seen.skin, seen.known)
    return None if "hair-unseen" in found.doubts else found.name or CROPPED


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hair_styles", description=__doc__)
    parser.add_argument("--photos", type=Path, required=True)
    parser.add_argument("--count", type=int, default=48)
    parser.add_argument("--only", nargs="*", choices=list(ROWS), default=list(ROWS), help="rows to print")
    asked = parser.parse_args()
    crowd, reader = list(people(asked.photos, asked.count)), ReaderNetwork()
    print("| choice | styles found again | cropped heads told | portraits that tell |\n|---|---|---|---|")
    for row in asked.only:
        told = [(worn.style, found) for worn in crowd if (found := chosen(worn, reader, row)) is not None]
        hair, bare = ([pair for pair in told if (pair[0] == CROPPED) == cropped] for cropped in (False, True))
        right = [sum(style == found for style, found in pairs) for pairs in (hair, bare)]
        counts = f"{right[0]} of {len(hair)} | {right[1]} of {len(bare)} | {len(told)} of {len(crowd)}"
        print(f"| {row} | {counts} |", flush=True)


if __name__ == "__main__":
    main()
