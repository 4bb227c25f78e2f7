"""Portraits that are hard to read, for the tests: ``python -m models.people.cases [--out tests/data/people]``.

Each is a person by seed, none that a network is trained on, with what makes the photo hard; ``truth.json`` beside them
has what the tests ask for.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from models.people.make import Portrait, portrait

Picture = npt.NDArray[np.uint8]

FOLDER = Path(__file__).parents[2] / "tests" / "data" / "people"
SEEDS = {
    "profile": 237, "half_hidden": 10, "hair_over_brow": 80, "glasses": 84, "mirroring_lenses": 87, "beard": 132,
    "full_beard": 210, "closed": 129, "winking": 79, "open": 57,
    "turned_away": 787, "dim_profile": 596,
}  # fmt: skip
QUALITY = 92


def plain(person: Portrait) -> dict[str, object]:
    """What is true of a portrait: yaw in degrees, state of the eyes, heights of the lid openings in mm, right first."""
    return {
        "seed": person.seed, "yaw_deg": round(float(person.camera.yaw_pitch_roll_deg()[0]), 2), "eyes": person.eyes,
        "lids_mm": [round(float(max(mm, 0.0)), 2) for mm in person.lids_mm],
    }  # fmt: skip


def made_of(image: Picture) -> dict[str, Picture]:
    """A (256, 256, 3) portrait as a drawing, without colour, with a face of some 40 pixels, and half clipped."""
    small = cv2.resize(image, (72, 72), interpolation=cv2.INTER_AREA)
    wall = np.full((256, 256, 3), 150, np.uint8)
    wall[100:172, 90:162] = small
    ramp = np.where(np.arange(256) < 128, 1.0, 6.0)[None, :, None]
    return {
        "cartoon": np.asarray(cv2.stylization(image, sigma_s=60, sigma_r=0.6), np.uint8),
        "grey": np.repeat(image.mean(2, keepdims=True).astype(np.uint8), 3, 2),
        "forty_pixels": wall,
        "clipped": np.clip(image * ramp, 0, 255).astype(np.uint8),
    }


def write(folder: Path) -> None:
    """Draw all cases."""
    folder.mkdir(parents=True, exist_ok=True)
    truth: dict[str, object] = {}
    for name, seed in SEEDS.items():
        person = portrait(seed)
        (folder / f"{name}.jpg").write_bytes(person.jpeg)
        truth[name] = plain(person)
        if name == "open":
            for other, image in made_of(person.image).items():
                cv2.imwrite(str(folder / f"{other}.jpg"), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
                truth[other] = plain(person)
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=FOLDER)
    write(parser.parse_args().out)


if __name__ == "__main__":
    main()
