"""What the tests of the page do again and again."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from tests.web.conftest import PHOTO

if TYPE_CHECKING:
    from playwright.sync_api import Page

Pixels = npt.NDArray[np.float64]


def submit(page: Page) -> None:
    page.set_input_files("#file", PHOTO)
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
