"""What the person's network is worth to the reader: ``python -m benchmarks.person --people FOLDER [--photos FOLDER]``.

``--people`` has shards of portraits that the reader was not trained on (``models.people.factory``), with the truth of
every pixel. Printed are, over the cells of the reader's wider crop that lie in a portrait, for several ways to join the
two networks: intersection over union of hair (probability above 0.3), its recall and precision; the share of background
that is taken for hair; the share of cells whose likeliest part is the true one, and the mean logarithm of its
probability. ``--photos`` draws what changes on photos: crop, what the network says, hair before, hair after, and what
was taken away in pink.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from models.people.shards import decode
from service.arrays import Float32, UInt8
from service.errors import AvatarError
from service.face.finder import FaceFinder
from service.face.reading import person
from service.face.reading.parts import BACKGROUND, HAIR
from service.face.reading.read import Readers, read_face
from service.face.reading.reader import PART_CELLS, Reading, middles
from service.face.reading.sampled import parts_at_pixels
from service.photo.gate import read_photo

SHOWN = 0.3
"""Probability from which a cell counts as hair: the middle of ``service.anatomy.hair.seen.RAMP``."""
EDGE = 3.0
"""Pixels of a portrait's border that are left out."""
TILE = 320

Way = Callable[[UInt8, Reading], Reading]


def ways(network: person.PersonNetwork) -> dict[str, Way]:
    """Ways to join the networks, by name."""

    def believed(pixels: UInt8, reading: Reading) -> Reading:
        """The parts of the person times the mask, whatever it misses."""
        around = _around(reading)
        seen = network(pixels, around.region)

        def cut(one: Reading) -> Reading:
            mask = person.sampled(seen, around.region, middles(one.region, PART_CELLS))[..., None]
            parts = one.parts * np.where(np.isin(np.arange(one.parts.shape[-1]), person.OWN), mask, 1)
            parts[..., BACKGROUND] += 1 - parts.sum(-1)
            return replace(one, parts=parts)

        return replace(cut(reading), around=cut(around))

    return {
        "reader alone": lambda _, reading: reading,
        "times the mask": believed,
        "Bayes, errors of the photo": lambda pixels, reading: person.with_person(pixels, reading, network),
    }


def _around(reading: Reading) -> Reading:
    if reading.around is None:
        raise ValueError("the reading has no wider crop")
    return reading.around


def on_people(folder: Path, most: int, readers: Readers, joined: dict[str, Way]) -> None:
    """Print the table of the portraits."""
    found: dict[str, list[Float32]] = {name: [] for name in joined}
    true, count = [], 0
    for shard in sorted(folder.glob("*.npz")):
        with np.load(shard) as arrays:
            portraits = decode(dict(arrays))
        for portrait in portraits:
            pixels = portrait.image
            reading = read_face(pixels, portrait.points[:468].astype(np.float64), readers) if count < most else None
            if reading is None or reading.around is None:
                continue
            count += 1
            at = middles(_around(reading).region, PART_CELLS)
            at = at[((at >= EDGE) & (at < np.array(pixels.shape[1::-1]) - EDGE)).all(1)]
            true.append(portrait.part[at[:, 1].astype(int), at[:, 0].astype(int)])
            for name, way in joined.items():
                found[name].append(parts_at_pixels(way(pixels, reading), at))
    shown = np.concatenate(true)
    hair = shown == HAIR
    sys.stdout.write(f"{count} portraits, {len(shown)} cells\n\n")
    sys.stdout.write("| | hair: overlap | recall | precision | background as hair | right parts | mean log |\n")
    sys.stdout.write("|---|---|---|---|---|---|---|\n")
    for name, each in found.items():
        parts = np.concatenate(each)
        said = parts[:, HAIR] > SHOWN
        both, background = (said & hair).sum(), shown == BACKGROUND
        shares = (
            both / max((said | hair).sum(), 1), both / max(hair.sum(), 1), both / max(said.sum(), 1),
            (said & background).sum() / max(background.sum(), 1), (parts.argmax(1) == shown).mean(),
        )  # fmt: skip
        log = float(np.log(np.maximum(parts[np.arange(len(shown)), shown], 1e-3)).mean())
        sys.stdout.write(f"| {name} | {' | '.join(f'{100 * share:.1f} %' for share in shares)} | {log:.3f} |\n")


def on_photos(folder: Path, sheet: Path, readers: Readers, network: person.PersonNetwork) -> None:
    """Draw what changes, a row a photo."""
    import cv2

    finder, rows = FaceFinder(), []
    for path in sorted(folder.iterdir()):
        try:
            pixels = read_photo(path.read_bytes()).pixels
        except (AvatarError, OSError):
            continue
        faces = finder.find(pixels)
        before = read_face(pixels, faces[0].landmarks, readers) if faces else None
        if before is None or before.around is None:
            continue
        after = person.with_person(pixels, before, network)
        region = _around(before).region
        crop = region.cut(pixels, TILE).astype(np.float32)
        at = middles(region, TILE)
        old, new = (parts_at_pixels(one, at)[:, HAIR].reshape(TILE, TILE, 1) for one in (before, after))
        mask = np.repeat(person.sampled(network(pixels, region), region, at)[..., None], 3, -1)
        green, pink = np.array([0, 255, 60], np.float32), np.array([255, 0, 255], np.float32)
        drawn = [crop + 0.6 * (green - crop) * hair for hair in (old, new)]
        drawn[1] += 0.7 * (pink - drawn[1]) * np.clip(old - new, 0, 1)
        rows.append(np.hstack([crop, 255 * mask, *drawn]))
    if rows:
        cv2.imwrite(str(sheet), np.ascontiguousarray(np.vstack(rows)[..., ::-1]).astype(np.uint8))


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=Path)
    parser.add_argument("--most", type=int, default=96, help="portraits")
    parser.add_argument("--photos", type=Path)
    parser.add_argument("--sheet", type=Path, default=Path("person.png"))
    chosen = parser.parse_args()
    readers, network = Readers(person=False), person.PersonNetwork()
    if chosen.people:
        on_people(chosen.people, chosen.most, readers, ways(network))
    if chosen.photos:
        on_photos(chosen.photos, chosen.sheet, readers, network)


if __name__ == "__main__":
    main()
