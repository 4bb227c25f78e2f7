"""How well the whites of the eyes tell the light: ``python -m benchmarks.eye_whites --data DIR``.

With ``--photos FOLDER`` it tells instead in how many faces of a folder's photos the whites are seen, and how strong the
light on the lids is by them.

Heads with skins and eyes are photographed under sky and hard lamps, each a second time with skin of known albedo. The
light that ``service.light.white_reference`` reads off the first photo is set beside the light that the lids show in the
second.
DIR is that of ``benchmarks.shoot``, whose photos have to have been taken (they bring the skin).

Beside their ratio stands the one that ``models.lightstage.light.sclera`` computes from head and light. Slope, shift and
spread of what is left are ``FAITH``, ``LESS`` (of a zone that is nearer to the eye, and darker) and ``ERROR`` of
``models.training.eyes``. Heads are of ICT-FaceKit, or with ``--stage`` held-out subjects of the light stage, whose eyes
lie deeper.
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.heads import IctHeads, TexturedHead
from benchmarks.render import LAMPS, LIGHTS, Shot, environment, eyeball, lamps_of, take_once
from benchmarks.shoot import data_folder
from benchmarks.subjects import stage_head
from models.lightstage.light.sclera import CAMERA_M, Whites, eye_in, reached
from models.lightstage.split import HELD_OUT
from models.training.factory import seeds_of
from service.anatomy.eyes.eyeball import IRIS_RADIUS_M
from service.anatomy.eyes.iris import Iris
from service.anatomy.eyes.sclera import BETWEEN_LIDS, sclera_light
from service.colour import bytes_to_linear
from service.errors import UnreadableInput
from service.face.finder import FaceFinder
from service.face.fit.fit import fit_face
from service.face.fit.settings import FitSettings
from service.geometry.normals import normalise, vertex_normals
from service.head.files import load_head
from service.head.model import HeadModel
from service.light.environment import HEIGHT, WIDTH, Illumination
from service.light.scene import PointLight
from service.light.sphere import pixel_directions, pixel_of
from service.photo.gate import read_photo

Float = npt.NDArray[np.float64]

FIRST_SEED = 300
KNOWN_ALBEDO = 0.5
YAWS = (0, 25, -20)
AROUND = (3.4, 2.6)
"""Half axes of the region of the lids round an eye, in radii of the iris."""


def lid_light(radiance: Float, irises: tuple[Iris, ...]) -> Float:
    """(3,) log of the mean light on the skin round the eyes, from linear (H, W, 3) of a head of known albedo."""
    import cv2

    found = []
    for iris in irises:
        y, x = np.indices(radiance.shape[:2])
        middle = iris.rim.mean(0)
        near = np.hypot(*((at - c) / (a * iris.radius) for at, c, a in zip((x, y), middle, AROUND, strict=True))) < 1
        opening = np.zeros(near.shape, np.uint8)
        cv2.fillPoly(opening, [np.rint(iris.rim).astype(np.int32)], 1)
        lids = near & (cv2.dilate(opening, np.ones((5, 5), np.uint8)) == 0)
        found.append(np.log(np.maximum(radiance[lids].mean(0) / KNOWN_ALBEDO, 1e-4)))
    return np.asarray(np.mean(found, 0))


def lights_of(light: str, seed: int) -> Illumination:
    """A light of ``benchmarks.render`` as the light stage has it."""
    image = environment(light, seed)
    # Mitsuba's columns begin behind the head and go round the other way.
    at_pixel = pixel_of(pixel_directions(HEIGHT, WIDTH) * [-1, 1, 1], *image.shape[:2])
    rows, columns = np.moveaxis(np.rint(at_pixel).astype(int), 2, 0) % np.array(image.shape[:2])[:, None, None]
    lamps = []
    for at, radius, radiance in lamps_of(light, seed):
        sent = math.pi * radius**2 * np.array(radiance)
        lamps.append(PointLight(at, (float(sent[0]), float(sent[1]), float(sent[2])), radius))
    return Illumination(tuple(lamps), image[rows, columns].astype(np.float64))


def whites_of(head: TexturedHead) -> Whites:
    """The eyes of a head as the light stage looks at them."""
    import trimesh

    balls = [eyeball(centre, head.eye_radius, np.zeros(3))[:2] for centre in head.eyes]
    meshes = [trimesh.Trimesh(v, t, process=False) for v, t in ((head.vertices, head.triangles), *balls)]
    mesh: Any = trimesh.util.concatenate(meshes)
    normals, camera = vertex_normals(head.vertices, head.triangles), normalise(np.array(CAMERA_M) - head.vertices)
    eyes = []
    for index in np.argsort(-head.eyes[:, 0]):
        apart = (head.vertices - head.eyes[index]) / (IRIS_RADIUS_M * np.array([*AROUND, np.inf]))
        near = np.flatnonzero((np.linalg.norm(apart, axis=1) < 1) & (head.vertices[:, 2] > head.eyes[index, 2]))
        lids = near[reached(mesh, head.vertices[near], normals[near], camera[near]) > 0]
        eyes.append(eye_in(mesh, balls[index], head.eyes[index], head.vertices[lids], normals[lids]))
    return Whites(tuple(eyes))


def sittings(count: int, staged: bool, data: Path, out: Path) -> Iterator[tuple[TexturedHead, list[Shot]]]:
    """Heads and photos to take: of ICT-FaceKit under sky and key lamp, or of the light stage in five lights."""
    if staged:
        for head in map(stage_head, islice(seeds_of(HELD_OUT), count)):
            yield head, [Shot(8.0, light, 1.2, 18.0, size=640) for light in ("soft", *LAMPS)]
        return
    heads, colours = IctHeads(data / "ict_facekit_head.npz"), np.asarray(np.load(out / "skin.npy"))
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        head = heads.textured(f"{seed}", seed, colours)
        yield head, [Shot(YAWS[seed % len(YAWS)], light, 0.9, 22.0, size=640, seed=seed) for light in LIGHTS]


def print_fit(computed: Float, measured: Float, tint: Float) -> None:
    """How both (N,) hang together."""
    slope, shift = np.polyfit(computed, measured, 1)
    rest = float((measured - slope * computed - shift).std())
    print(f"log(eyes / lids): mean {measured.mean():.2f}, standard deviation {measured.std():.2f}, ", end="")
    print(f"tint {tint.std():.2f}; computed {computed.mean():.2f}, {computed.std():.2f}; slope {slope:.2f}, ", end="")
    print(f"shift {shift:.2f}, correlation {np.corrcoef(computed, measured)[0, 1]:.2f}, left {rest:.2f}; ", end="")
    print(f"{len(measured)} photos")


def read_off(photo_bytes: bytes, plain: Float, finder: FaceFinder, model: HeadModel) -> Float | None:
    """(3,) log(light that the program reads off the whites / light on the lids); None where it sees no white."""
    photo = read_photo(photo_bytes)
    faces = finder.find(photo.pixels)
    fit = fit_face(faces[0], photo, model, FitSettings(refine="landmarks")) if faces else None
    if fit is None or fit.eye_light is None or fit.gaze is None:
        return None
    told = [iris for iris in fit.gaze.irises if sclera_light(photo.pixels, iris) is not None]
    return np.asarray(np.log(fit.eye_light) - lid_light(plain, tuple(told) or fit.gaze.irises))


def shot_pair(head: TexturedHead, shot: Shot, path: Path) -> tuple[bytes, Float]:
    """PNG of the head, and linear radiance of the same head in known albedo; taken unless they are there."""
    import cv2

    plain = replace(head, colours=np.full_like(head.colours, KNOWN_ALBEDO))
    for name, subject in (("skin", head), ("plain", plain)):
        target = path.with_name(f"{path.name}_{name}")
        take_once(subject, shot, target, samples=32)
    image = np.asarray(cv2.imread(f"{path}_plain.png"), np.uint8)[..., ::-1]
    return Path(f"{path}_skin.png").read_bytes(), bytes_to_linear(image).astype(np.float64)


def light_of_photos(folder: Path) -> None:
    """Print log(light on the lids) of each face in a folder's photos whose whites are seen, and the mean of all."""
    finder, model, found, faces_seen = FaceFinder(), load_head(), [], 0
    for path in sorted(p for p in folder.iterdir() if p.is_file()):
        try:
            photo = read_photo(path.read_bytes())
        except UnreadableInput as refused:
            print(f"| {path.name} | {refused} | |")
            continue
        for face in finder.find(photo.pixels):
            fit = fit_face(face, photo, model, FitSettings(refine="landmarks"))
            faces_seen += 1
            if fit.eye_light is None:
                print(f"| {path.name} | not seen | |")
                continue
            light = np.log(fit.eye_light / BETWEEN_LIDS)
            found.append(float(light.mean()))
            print(f"| {path.name} | {light.mean():.2f} | {np.round(light - light.mean(), 2).tolist()} |", flush=True)
    middle, spread = (float(np.mean(found)), float(np.std(found))) if found else (math.nan, math.nan)
    print(f"log(light on the lids): mean {middle:.2f}, standard deviation {spread:.2f}; ", end="")
    print(f"{len(found)} of {faces_seen} faces")


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data")
    parser.add_argument("--photos", type=Path)
    parser.add_argument("--stage", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("build/bench"))
    parser.add_argument("--heads", type=int, default=10)
    arguments = parser.parse_args()
    os.nice(10)
    if arguments.photos:
        return light_of_photos(arguments.photos)
    data, out = data_folder(arguments.data), arguments.out
    if not (out / "skin.npy").is_file():
        raise SystemExit(f"{out}/skin.npy is missing; run benchmarks.shoot first")
    model, finder = load_head(), FaceFinder()
    rows: list[tuple[float, float, Float]] = []
    for head, taken in sittings(arguments.heads, arguments.stage, data, out):
        whites = whites_of(head)
        for shot in taken:
            photo_bytes, plain = shot_pair(head, shot, out / f"eyes_{head.name}_{shot.light}")
            beside = whites.beside_lids(lights_of(shot.light, shot.seed))
            ratio = read_off(photo_bytes, plain, finder, model)
            if ratio is None or not np.isfinite(beside).any():
                print(f"| {head.name} | {shot.light} | not seen | |", flush=True)
                continue
            rows.append((float(np.nanmean(beside)), float(ratio.mean()), ratio - ratio.mean()))
            print(f"| {head.name} | {shot.light} | {rows[-1][1]:.2f} | computed {rows[-1][0]:.2f} |", flush=True)
    if len(rows) < 3:
        raise SystemExit("the whites are seen in fewer than three photos; take more with --heads")
    computed, measured, tint = (np.array(column) for column in zip(*rows, strict=True))
    print_fit(computed, measured, tint)


if __name__ == "__main__":
    main()
