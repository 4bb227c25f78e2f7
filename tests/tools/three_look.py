"""Pictures of an unpacked archive by three.js, through its own loaders of GLB, OBJ and USD: ``python -m
tests.tools.three_look FOLDER OUT [SIZE]``.

Writes ``glb.png``, ``obj.png``, and ``neutral_glb.png`` and ``neutral_usd.png``, as three's USD loader knows no
blendshapes. Light and camera are those of ``blender_look.py``, but three's area lamps throw no shadows.
``tests/tools/three_look.html`` says what its loaders leave out.
"""

from __future__ import annotations

import base64
import functools
import http.server
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from tests.support.browser import launched
from tests.tools.mitsuba_look import LAMP_M, RADIANCE, SKY

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

TOOLS = Path(__file__).resolve().parent
THREE = TOOLS / "node_modules" / "three"
PICTURES = {"glb": ("glb", False), "obj": ("obj", False), "neutral_glb": ("glb", True), "neutral_usd": ("usd", True)}


class _Folders(http.server.SimpleHTTPRequestHandler):
    """``/three``, ``/archive`` and this folder."""

    def __init__(self, *arguments: object, archive: Path, **named: object) -> None:
        self.archive = archive
        super().__init__(*arguments, directory=str(TOOLS), **named)  # type: ignore[arg-type]

    def translate_path(self, path: str) -> str:
        for prefix, folder in (("/three/", THREE), ("/archive/", self.archive)):
            if path.startswith(prefix):
                return str(folder / path.removeprefix(prefix).split("?")[0])
        return super().translate_path(path)

    def log_message(self, format: str, *arguments: object) -> None:
        """Say nothing."""


@contextmanager
def serving(folder: Path) -> Iterator[str]:
    """Address of a server of the page and of an unpacked archive."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Folders, archive=folder))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()


@contextmanager
def opened(browser: Browser, folder: Path) -> Iterator[Page]:
    """The page with an unpacked archive.

    Raises:
        AssertionError: the page logged an error.
    """
    wrong: list[str] = []
    with serving(folder) as address:
        page = browser.new_page()
        page.set_default_timeout(300_000)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(f"{address}/three_look.html")
        page.wait_for_function("window.ready")
        yield page
        page.close()
    assert not wrong, wrong


def write(picture: str, path: Path) -> None:
    """A data URL as a file."""
    path.write_bytes(base64.b64decode(picture.split(",", 1)[1]))


def look_at_an_eye(browser: Browser, folder: Path, path: Path, watts: float) -> None:
    """Draw the right eye as ``blender_eye.py`` does."""
    side = 0.5
    wish = {"size": 128, "sky": (0.1, 0.1, 0.11), "lamp": {"radiance": watts / (4 * side**2), "side": side}}
    with opened(browser, folder) as page:
        write(page.evaluate("(wish) => window.eye(wish)", wish), path)


def look(browser: Browser, folder: Path, out: Path, size: int) -> dict[str, str]:
    """Draw the pictures; the answer is the type of material of each mesh in the last."""
    materials: dict[str, str] = {}
    with opened(browser, folder) as page:
        box = None
        for name, (kind, neutral) in PICTURES.items():
            wish = {
                "size": size, "sky": SKY, "lamp": {"radiance": RADIANCE, "side": LAMP_M}, "box": box,
                "neutral": neutral,
            }  # fmt: skip
            told = page.evaluate("([kind, wish]) => window.look(kind, wish)", [kind, wish])
            box, materials = told["box"], told["materials"]
            write(told["picture"], out / f"{name}.png")
    return materials


def main() -> None:
    folder, out = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    with launched() as browser:
        look(browser, folder, out, int(sys.argv[3]) if len(sys.argv) > 3 else 256)
    drawn = {name: np.asarray(cv2.imread(str(out / f"{name}.png")), float) for name in PICTURES}
    for one, other in (("glb", "obj"), ("neutral_glb", "neutral_usd")):
        sys.stdout.write(f"{one} and {other}: {np.abs(drawn[one] - drawn[other]).mean():.2f} of 255\n")


if __name__ == "__main__":
    main()
