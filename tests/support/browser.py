"""A browser without a screen, and what tests of the page do in it again and again."""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROOT = Path(__file__).parents[2]
PHOTO = ROOT / "service" / "data" / "sample" / "astronaut.png"

CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# WebGL without a graphics card, and a camera that shows a test picture.
ARGUMENTS = [
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
    "--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream",
]  # fmt: skip
PATIENCE_MS = 120_000

# Half the pixels each way: drawing without a graphics card takes its time.
MODEST = {"viewport": {"width": 900, "height": 600}, "device_scale_factor": 0.5, "reduced_motion": "reduce"}

Opener = Callable[..., "Page"]
Pixels = npt.NDArray[np.float64]


@contextmanager
def launched() -> Iterator[Browser]:
    """Headless Chromium.

    Raises:
        FileNotFoundError: there is none on this machine.
    """
    from playwright.sync_api import sync_playwright

    names = (os.environ.get("AVATARME_CHROMIUM", ""), *CHROMIUM)
    found = next((path for path in map(shutil.which, names) if path), None)
    with sync_playwright() as session:
        path = found or session.chromium.executable_path
        if not Path(path).exists():
            raise FileNotFoundError("no Chromium here: apt-get install chromium, or name one in AVATARME_CHROMIUM")
        program = session.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield program
        program.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """A browser for the tests of a file: while Playwright is open, its event loop counts as running in this thread."""
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed (make setup)")
    with ExitStack() as stack:
        try:
            program = stack.enter_context(launched())
        except FileNotFoundError as missing:
            pytest.skip(str(missing))
        yield program


@contextmanager
def opening(browser: Browser) -> Iterator[Opener]:
    """Opens pages; at the end none may have logged an error or broken the content security policy.

    ``expected`` are texts of errors that the test brings about, such as a refused request.
    """
    wrong: list[str] = []
    contexts = []

    def opened(address: str, *, expected: tuple[str, ...] = (), **wishes: Any) -> Page:
        context = browser.new_context(**{**MODEST, **wishes})
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)

        def said(kind: str, text: str) -> None:
            known = (*expected, "GPU stall due to ReadPixels")  # Chromium about screenshots without a graphics card
            if kind in ("error", "warning") and not any(part in text for part in known):
                wrong.append(f"{kind}: {text}")

        page.on("console", lambda message: said(message.type, message.text))
        page.on("pageerror", lambda error: said("error", str(error)))
        page.goto(address)
        return page

    try:
        yield opened
    finally:
        for context in contexts:
            context.close()
    assert not wrong


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Opener]:
    """One page or several for one test; see :func:`opening`."""
    with opening(browser) as opened:
        yield opened


def submit(page: Page) -> None:
    page.set_input_files("#file", PHOTO)
    page.wait_for_selector("#thumbs li")
    page.click("#go")


def make_head(page: Page) -> None:
    """From the empty form to the head on the screen."""
    submit(page)
    page.wait_for_selector("#canvas[data-shows=lit]")
    settle(page)


def settle(page: Page) -> None:
    """Until nothing is loaded and no more frames are drawn."""
    page.wait_for_function("() => document.getElementById('view-status').textContent === ''")
    page.evaluate(
        """async () => {
            const canvas = document.getElementById('canvas');
            const frame = () => new Promise((done) => requestAnimationFrame(done));
            for (let last = '', still = 0; still < 4; still = canvas.dataset.frames === last ? still + 1 : 0) {
                last = canvas.dataset.frames;
                await frame();
            }
        }"""
    )


def artists(page: Page) -> None:
    """Open the part of the panel with maps, numbers and files."""
    if page.get_attribute("#artists", "open") is None:
        page.click("#artists > summary")


def shapes(page: Page) -> None:
    """Open the list of the 52 sliders."""
    if page.get_attribute("#shapes", "open") is None:
        page.click("#shapes > summary")
    page.wait_for_selector("#shape-jawOpen")


def show(page: Page, view: str) -> Pixels:
    """The head with one of the switches of the maps on."""
    artists(page)
    page.check(f"#panel input[name=view][value={view}]")
    page.wait_for_selector(f"#canvas[data-shows={view}]")
    return picture(page)


def picture(page: Page) -> Pixels:
    """(H, W, 3) sRGB in [0, 1] of the view of the head."""
    settle(page)
    image = Image.open(io.BytesIO(page.locator("#view").screenshot()))
    return np.asarray(image.convert("RGB"), np.float64) / 255


def face(pixels: Pixels) -> Pixels:
    """The middle of the view, where the face is."""
    height, width = pixels.shape[:2]
    return pixels[int(0.35 * height) : int(0.65 * height), int(0.4 * width) : int(0.6 * width)]


def difference(first: Pixels, second: Pixels) -> float:
    """Mean over the face of the difference of two pictures."""
    return float(np.abs(face(first) - face(second)).mean())


def set_slider(page: Page, name: str, value: float) -> None:
    page.locator(f"#{name}").fill(str(value))


def set_light(page: Page, azimuth: float, elevation: float) -> None:
    """Degrees to the right of the viewer and up."""
    set_slider(page, "light-azimuth", azimuth)
    set_slider(page, "light-elevation", elevation)


def posts(requests: list[tuple[str, str, dict[str, str]]]) -> list[dict[str, Any]]:
    """Headers of the photos that were handed in."""
    return [headers for method, _, headers in requests if method == "POST"]
