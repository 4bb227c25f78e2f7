"""Take the benchmark's photos: ``python -m benchmarks.shoot --data DIR [--out build/bench] [--heads 20]``.

DIR holds ``ict_facekit_head.npz`` and ``ffhq_uv_head/``. Every ICT head is photographed at yaw 0, 25 and 45 under
two lights, the FFHQ-UV head likewise from near and from far. ``--views`` instead photographs heads that are held out
from all sides, each view in another light and by another camera, into the folder ``views`` below. Photos that exist are
kept, so a run can be broken off and resumed.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.heads import EYE_RADIUS_M, IctHeads, Skin, TexturedHead, carry_skin, places_of, subdivided
from benchmarks.render import LIGHTS, Shot, take, take_once
from service.face.finder import FaceFinder

Float = npt.NDArray[np.float64]

YAWS = (0, 25, 45)
FIRST_SEED = 100
VIEWS = (
    (0, "soft"), (-35, "left"), (35, "right"), (-75, "soft"), (75, "overhead"), (0, "harsh"), (-90, "soft"),
    (90, "warm"),
)  # fmt: skip
"""Yaw and light of the photos of one person, in the order in which ``benchmarks.fit --views`` takes them."""
FIRST_VIEWED = 110
"""The first head of them: held out."""
FFHQ_SCALE_M = 0.1
"""Metres per unit of the FFHQ-UV head."""
FFHQ_EYES_M = np.array([[0.0321, 0.0357, 0.0310], [-0.0310, 0.0360, 0.0313]])
"""Its eyeball centres, left first."""


def data_folder(given: str | None) -> Path:
    """The folder of reference heads: an argument, else the environment variable AVATARME_BENCH_DATA.

    Raises:
        SystemExit: neither names a folder with the heads.
    """
    folder = Path(given or os.environ.get("AVATARME_BENCH_DATA", ""))
    if not (folder / "ict_facekit_head.npz").is_file():
        raise SystemExit(f"{folder}: no ict_facekit_head.npz; name the folder by --data or AVATARME_BENCH_DATA")
    return folder


def landmarks_on(head: TexturedHead, folder: Path, name: str) -> Float:
    """(468, 3) surface points under the detected landmarks of a frontal photo; NaN where a landmark misses the head."""
    import cv2

    shot = Shot(0, "soft", 1.6, 16.0)
    path = folder / name
    take(head, shot, path)
    photo = np.asarray(cv2.imread(f"{path}.png"), np.uint8)[..., ::-1].copy()
    faces = FaceFinder().find(photo)
    if not faces:
        raise SystemExit(f"no face found in the reference photo {path}.png")
    with np.load(f"{path}.npz") as truth:
        x, y = np.clip(faces[0].landmarks[:, :2].astype(int), 0, shot.size - 1).T
        return np.where(truth["mask"][y, x][:, None], truth["position"][y, x], np.nan).astype(np.float64)


def ffhq_head(skin: Skin) -> TexturedHead:
    """The skin's own head in metres, centred between its eyes."""
    middle = FFHQ_EYES_M.mean(0)
    vertices, triangles, colours = skin.dense(1)
    return TexturedHead("ffhq", vertices * FFHQ_SCALE_M - middle, triangles, colours, FFHQ_EYES_M - middle, 0.0122)


def ict_places(heads: IctHeads, skin: Skin, skin_landmarks: Float, skin_middle: Float, folder: Path) -> Float:
    """(V', 2) coordinates of the skin's chart for the subdivided ICT mesh, so that any skin of that chart fits it."""
    cache = folder / "places.npy"
    if not cache.is_file():
        eyes = heads.eyes_of(heads.neutral)
        vertices, triangles = subdivided(heads.neutral - eyes.mean(0), heads.triangles, 2)
        colours = ict_colours(heads, skin, skin_landmarks, skin_middle, folder)
        carried = TexturedHead("ict", vertices, triangles, colours, eyes - eyes.mean(0), EYE_RADIUS_M)
        mine = landmarks_on(carried, folder, "reference_2")
        there = (skin_landmarks + skin_middle) / FFHQ_SCALE_M
        np.save(cache, carry_skin(vertices, mine, places_of(skin), there)[:, :2])
    return np.asarray(np.load(cache))


def ict_colours(heads: IctHeads, skin: Skin, skin_landmarks: Float, skin_middle: Float, folder: Path) -> Float:
    """Linear colours for the subdivided ICT mesh: landmarks are found on plain skin first, then on the carried one."""
    cache = folder / "skin.npy"
    if cache.is_file():
        return np.asarray(np.load(cache))
    eyes = heads.eyes_of(heads.neutral)
    vertices, triangles = subdivided(heads.neutral - eyes.mean(0), heads.triangles, 2)
    colours = np.tile([0.45, 0.28, 0.2], (len(vertices), 1))
    for round_ in range(2):
        plain = TexturedHead("ict", vertices, triangles, colours, eyes - eyes.mean(0), EYE_RADIUS_M)
        mine = landmarks_on(plain, folder, f"reference_{round_}")
        points = carry_skin(vertices, mine, skin, (skin_landmarks + skin_middle) / FFHQ_SCALE_M)
        colours = points
    np.save(cache, colours)
    return colours


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data")
    parser.add_argument("--out", type=Path, default=Path("build/bench"))
    parser.add_argument("--heads", type=int, default=20)
    parser.add_argument("--views", action="store_true", help="several photos of each head, from all sides")
    arguments = parser.parse_args()
    data, out = data_folder(arguments.data), arguments.out
    out.mkdir(parents=True, exist_ok=True)
    os.nice(10)
    skin = Skin.load(data / "ffhq_uv_head")
    reference = ffhq_head(skin)
    middle = FFHQ_EYES_M.mean(0)
    heads = IctHeads(data / "ict_facekit_head.npz")
    skin_landmarks = landmarks_on(reference, out, "reference_skin")
    colours = ict_colours(heads, skin, skin_landmarks, middle, out)
    if arguments.views:
        seeds = range(FIRST_VIEWED, FIRST_VIEWED + arguments.heads)
        people = (reference, *(heads.textured(f"ict{seed}", seed, colours) for seed in seeds))
        shoot_views(people, out / "views")
        return
    for number, yaw in enumerate(YAWS):
        for light in LIGHTS:
            for distance, fov in ((0.5, 36.0), (1.5, 14.0)):
                side = -1 if number % 2 else 1
                shoot(reference, Shot(side * yaw, light, distance, fov, seed=number), out, f"d{distance}")
    for seed in range(FIRST_SEED, FIRST_SEED + arguments.heads):
        head = heads.textured(f"ict{seed}", seed, colours)
        rng = np.random.default_rng(seed)
        distance = float(np.exp(rng.uniform(np.log(0.5), np.log(1.8))))
        fov = float(np.degrees(2 * np.arctan(0.19 / distance)))
        side = 1 if rng.random() < 0.5 else -1
        for yaw in YAWS:
            for light in LIGHTS:
                shoot(head, Shot(side * yaw, light, distance, fov, seed=seed), out, "")


def shoot_views(people: Iterable[TexturedHead], out: Path) -> None:
    """Photos ``HEAD_VIEW_YAW_LIGHT`` of heads from all sides, unless they are there already."""
    out.mkdir(parents=True, exist_ok=True)
    for head in people:
        rng = np.random.default_rng(sum(head.name.encode()))
        for number, (yaw, light) in enumerate(VIEWS):
            distance = float(np.exp(rng.uniform(np.log(0.5), np.log(1.8))))
            fov = float(np.degrees(2 * np.arctan(rng.uniform(0.19, 0.23) / distance)))
            shot = Shot(yaw, light, distance, fov, seed=int(rng.integers(1000)))
            name = f"{head.name}_{number}_{yaw}_{light}"
            if take_once(head, shot, out / name):
                print(name, flush=True)


def shoot(head: TexturedHead, shot: Shot, out: Path, tag: str) -> None:
    """Take one photo unless it is there already."""
    path = out / f"{head.name}{tag}_{abs(shot.yaw):.0f}_{shot.light}"
    if take_once(head, shot, path):
        print(path.name, flush=True)


if __name__ == "__main__":
    main()
