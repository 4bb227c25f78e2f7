"""Pupils of portraits of which they are known: ``python -m benchmarks.pupils --photos build/pupils [--count 24]``.

Portraits of ``models.people`` that no network was trained on, 1024 pixels wide, turned by less than 30 degrees, with
eyes that are open and nothing before them. The irises are looked for as in the product, with the true rim of the lids
and the true camera. Portraits are kept in the folder: another run needs no OpenGL.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from models.people.dress import hair_colour
from models.people.figure import figure, recessed
from models.people.make import portrait
from models.people.person import draw_person, the_head
from models.people.pose import draw_camera, landmarks
from models.people.skins import load_skin
from models.people.wardrobe import load_wardrobe
from service.anatomy.eyes.eyeball import IRIS_RADIUS_M
from service.anatomy.eyes.gaze import find_gaze

SIZE, MOST_YAW, FIRST = 1024, 30.0, 510_001
SKINS = (1, 6, 9, 14)
"""Skins of the people, as drawing one takes long."""
MOST_BLINK = 0.25


def truth(seed: int, folder: Path) -> float | None:
    """Radius of the pupils in metres; None for somebody whose eyes are not seen well."""
    person = draw_person(seed)
    if person.skin not in SKINS:
        return None
    camera = draw_camera(seed, SIZE, landmarks(the_head(), recessed(person)))
    units = dict(zip(the_head().expression_names, person.expression, strict=True))
    blinks = max(units["eyeBlinkLeft"], units["eyeBlinkRight"])
    if abs(camera.yaw_pitch_roll_deg()[0]) > MOST_YAW or blinks > MOST_BLINK:
        return None
    skin = load_skin(person.skin, folder)
    meshes = figure(person, skin, hair_colour(person, skin), load_wardrobe(), seed)
    look = next(mesh.uniforms["eyeLook"] for mesh in meshes if "eyeLook" in mesh.uniforms)
    return IRIS_RADIUS_M * float(look[0])


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pupils", description=__doc__)
    parser.add_argument("--photos", type=Path, required=True)
    parser.add_argument("--count", type=int, default=24)
    asked = parser.parse_args()
    asked.photos.mkdir(parents=True, exist_ok=True)
    pairs: list[tuple[float, float]] = []
    head, untold, seed = the_head(), 0, FIRST
    while len(pairs) + untold < asked.count:
        seed += 1
        wanted = truth(seed, asked.photos)
        if wanted is None:
            continue
        path = asked.photos / f"{seed}.npz"
        if not path.is_file():
            np.savez_compressed(path, image=portrait(seed, SIZE, asked.photos).image)
        with np.load(path) as kept:
            image = kept["image"]
        person = draw_person(seed)
        points = landmarks(head, recessed(person))
        camera = draw_camera(seed, SIZE, points)
        gaze = find_gaze(image, camera.project(points)[:468], head, person.neutral, camera)
        found = None if gaze is None else gaze.pupil_m
        untold += found is None
        pairs += [] if found is None else [(wanted, found)]
    true, told = 1e3 * np.array(pairs).reshape(-1, 2).T
    constant = np.abs(true - np.median(true)).mean() if len(true) else float("nan")
    sys.stdout.write(
        f"{len(pairs)} of {asked.count} told: mean error {np.abs(told - true).mean():.2f} mm of the radius, a constant "
        f"{constant:.2f} mm; median {np.median(np.abs(told - true)):.2f} mm\n"
    )


if __name__ == "__main__":
    main()
