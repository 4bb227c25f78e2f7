"""Pictures of the sample in the docs: ``python -m tests.tools.pictures AVATAR.zip [NAME ...] [--out docs]``.

AVATAR.zip is ``make run``'s. The names are overlay, sheet, render, blender and renderers; without any, all are made.
``blender`` wants Blender (``docs/blender.md``), ``renderers`` that, Mitsuba, and Chromium with three.js; where one is
missing its picture is left out, and that is said. ``renderers`` also prints, for each renderer, how far its pictures of
the three formats are apart.
"""

from __future__ import annotations

import argparse
import io
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from service.archive.preview.sheet import GREY, blank, write_text
from service.kits.export import blender, export_kit
from tests.support.browser import launched
from tests.tools.mitsuba_look import bounds, draw, shown
from tests.tools.surfaces import FORMATS, surfaces
from tests.tools.three_look import THREE, look

TOOLS = Path(__file__).resolve().parent
POSES = ("neutral", "blink", "smile", "jawOpen", "tongueOut", "profile", "back")
VIEWS = ("three-quarter", "10")
CAPTION = 26


def say(text: str) -> None:
    sys.stdout.write(text + "\n")


def save(picture: Image.Image, path: Path) -> None:
    picture.convert("RGB").save(path, quality=86, optimize=True, progressive=True)
    say(f"{path}: {picture.width} x {picture.height}, {path.stat().st_size // 1000} kB")


def preview(archive: Path, name: str, width: int) -> Image.Image:
    """A preview of the archive, at most so wide."""
    with zipfile.ZipFile(archive) as stored:
        picture = Image.open(io.BytesIO(stored.read(f"preview/{name}.jpg")))
        picture.load()
    return picture.resize((width, picture.height * width // picture.width), Image.Resampling.LANCZOS)


def rendered(archive: Path, folder: Path) -> Image.Image:
    """The head under the studio's light from two sides, beside each other."""
    both = []
    for view in VIEWS:
        target = folder / f"{view}.png"
        command = [sys.executable, "-m", "service", "render", str(archive), "-o", str(target), "--view", view]
        subprocess.run([*command, "--size", "450x600"], check=True)
        both.append(np.asarray(Image.open(target).convert("RGB")))
    return Image.fromarray(np.concatenate(both, 1))


def in_blender(tool: str, *arguments: object) -> None:
    command = blender()
    assert command is not None
    dashes = ["--"] if command[1:] else []
    subprocess.run([*command, str(TOOLS / tool), *dashes, *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


def poses(archive: Path, folder: Path) -> Image.Image:
    """The kit's scene in Blender, in seven poses."""
    kit = export_kit(archive, "blender", folder / "kit")
    assert kit.scene is not None
    (folder / "poses").mkdir()
    in_blender("blender_kit.py", kit.scene, folder / "poses", 384, 12, ",".join(POSES))
    tiles = [np.asarray(Image.open(folder / "poses" / f"{pose}.png").convert("RGB")) for pose in POSES]
    return captioned([*tiles, np.full_like(tiles[0], tiles[0][0, 0])], (*POSES, ""), 4)


def captioned(tiles: list[np.ndarray], captions: tuple[str, ...], columns: int) -> Image.Image:
    """Tiles of one size, captions beneath them."""
    rows = []
    for first in range(0, len(tiles), columns):
        line = np.concatenate(tiles[first : first + columns], 1)
        foot = blank(line.shape[1], CAPTION)
        for k, caption in enumerate(captions[first : first + columns]):
            write_text(foot, caption, k * tiles[0].shape[1] + 8, 18, 14, GREY)
        rows.append(np.concatenate([line, foot]))
    return Image.fromarray(np.concatenate(rows))


def renderers(archive: Path, folder: Path, size: int = 360, samples: int = 16) -> Image.Image:
    """The archive's GLB in each renderer that is here; what its formats differ by is printed."""
    with zipfile.ZipFile(archive) as stored:
        stored.extractall(folder / "in")
    found: dict[str, dict[str, np.ndarray]] = {}
    if blender() is None:
        say("Blender is not here: AVATARME_BLENDER does not name it")
    else:
        (folder / "blender").mkdir()
        in_blender("blender_look.py", folder / "in", folder / "blender", size, samples)
        found["Blender Cycles"] = _read(folder / "blender")
    read = {kind: surfaces(folder / "in", kind) for kind in FORMATS}
    box = bounds(read["glb"])
    drawn = {kind: shown(draw(one, box, size, samples)) for kind, one in read.items()}
    found["Mitsuba 3"] = {kind: np.rint(one).astype(np.uint8) for kind, one in drawn.items()}
    if THREE.is_dir():
        (folder / "three").mkdir()
        try:
            with launched() as browser:
                look(browser, folder / "in", folder / "three", size)
            found["three.js"] = _read(folder / "three")
        except FileNotFoundError as missing:
            say(str(missing))
    else:
        say("three.js is not in tests/tools/node_modules (make setup, with npm)")
    for name, pictures in found.items():
        pairs = [("glb", "obj"), ("glb", "usd"), ("obj", "usd"), ("neutral_glb", "neutral_usd")]
        told = ", ".join(
            f"{one} and {other} {np.abs(pictures[one].astype(float) - pictures[other].astype(float)).mean():.2f}"
            for one, other in pairs if one in pictures and other in pictures
        )  # fmt: skip
        say(f"{name}: {told} of 255")
    return captioned([pictures["glb"] for pictures in found.values()], tuple(found), len(found))


def _read(folder: Path) -> dict[str, np.ndarray]:
    return {path.stem: np.asarray(cv2.imread(str(path)))[..., ::-1] for path in sorted(folder.glob("*.png"))}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.tools.pictures", description=__doc__)
    parser.add_argument("archive", type=Path)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--out", type=Path, default=Path("docs"))
    wish = parser.parse_args()
    makers: dict[str, tuple[str, Callable[[Path], Image.Image]]] = {
        "overlay": ("sample-overlay.jpg", lambda _: preview(wish.archive, "overlay", 1440)),
        "sheet": ("sample-sheet.jpg", lambda _: preview(wish.archive, "sheet", 1364)),
        "render": ("sample-render.jpg", lambda folder: rendered(wish.archive, folder)),
        "blender": ("blender.jpg", lambda folder: poses(wish.archive, folder)),
        "renderers": ("renderers.jpg", lambda folder: renderers(wish.archive, folder)),
    }
    for name in wish.names or makers:
        file, make = makers[name]
        if name == "blender" and blender() is None:
            say("blender.jpg is left out: AVATARME_BLENDER does not name Blender")
            continue
        with tempfile.TemporaryDirectory() as folder:
            save(make(Path(folder)), wish.out / file)


if __name__ == "__main__":
    main()
