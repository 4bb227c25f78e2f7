"""Around the head: the photo beside it, what can be corrected and downloaded, how long it is kept."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from service.words import WORDS
from tests.support.browser import PHOTO, Opener, artists, make_head, picture, settle
from tests.web.fake_service import KIT, Fake

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow

EXPECTED = ("Failed to load resource", "net::ERR_FAILED")


@pytest.fixture
def made(fake: Fake, open_page: Opener) -> Page:
    """The page with a head."""
    page = open_page(fake.address, device_scale_factor=1, expected=EXPECTED)
    make_head(page)
    page.wait_for_selector("#inset:not([hidden])")
    return page


def reload(page: Page) -> None:
    page.reload()
    page.wait_for_selector("#canvas[data-shows=lit]")
    page.wait_for_selector("#inset:not([hidden])")


def test_every_warning_is_a_sentence(fake: Fake, open_page: Opener) -> None:
    """Those without one were shown as their code in capitals."""
    fake.warnings = list(WORDS["warnings"])
    page = open_page(fake.address, device_scale_factor=1, expected=EXPECTED)
    make_head(page)
    page.wait_for_selector("#inset:not([hidden])")
    shown = page.locator(".summary li").all_inner_texts()
    assert shown[: len(fake.warnings)] == list(WORDS["warnings"].values())


def compare(page: Page, at: int) -> None:
    page.check("input[name=drag][value=photo]", force=True)
    page.locator("#wipe").fill(str(at))
    settle(page)


def edges(pixels: np.ndarray) -> np.ndarray:
    """(H, W) strength of edges, blurred over the pixels of eyes, mouth and outline."""
    import cv2

    grey = pixels.mean(-1).astype(np.float32)
    strength = np.hypot(cv2.Sobel(grey, -1, 1, 0), cv2.Sobel(grey, -1, 0, 1))
    return np.asarray(cv2.GaussianBlur(strength, (0, 0), 2.0))


@pytest.mark.parametrize("reloaded", [False, True])
def test_photo_and_head_lie_on_each_other(reloaded: bool, made: Page) -> None:
    """With the photo that was handed in, and after a reload with the one in the preview."""
    import cv2

    if reloaded:
        reload(made)
    wanted = "CANVAS" if reloaded else "IMG"
    assert made.evaluate("document.querySelector('#photo-layer > *').tagName") == wanted
    compare(made, 100)
    photo = picture(made)
    compare(made, 0)
    head = picture(made)
    assert np.abs(photo - head).mean() > 0.05
    height, width = photo.shape[:2]
    inner = np.s_[int(0.3 * height) : int(0.6 * height), int(0.38 * width) : int(0.62 * width)]
    outer = np.s_[int(0.25 * height) : int(0.65 * height), int(0.33 * width) : int(0.67 * width)]
    found = cv2.matchTemplate(edges(photo)[outer], edges(head)[inner], cv2.TM_CCOEFF_NORMED)
    _, _, _, (x, y) = cv2.minMaxLoc(found)
    off = (x - (inner[1].start - outer[1].start), y - (inner[0].start - outer[0].start))
    assert np.hypot(*off) < 0.012 * height, f"the head lies {off} pixels beside the photo"


def test_what_there_is_to_download(made: Page, archive: Path) -> None:
    with zipfile.ZipFile(archive) as opened:
        glb = opened.read("mesh/head.glb")
    name = f"avatar-{made.url.partition('=')[2][:8]}"
    kits = {tool: (f"{name}-{tool}.zip", KIT) for tool in ("blender", "unreal", "unity", "maya")}
    files = {"glb": ("head.glb", glb), "all": (f"{name}.zip", archive.read_bytes()), **kits}
    for choice, wanted in files.items():
        made.check(f"input[name=kit][value={choice}]")
        with made.expect_download() as saved:
            made.click("#download")
        assert (saved.value.suggested_filename, saved.value.path().read_bytes()) == wanted
    artists(made)
    made.click("#files > summary")
    with made.expect_download() as saved:
        made.click("text=maps/texture.png")
    assert Path(saved.value.path()).read_bytes().startswith(b"\x89PNG")


def test_a_download_can_be_cancelled_or_break(made: Page) -> None:
    made.route("**/v1/exports/**", lambda route: None)  # never answered
    made.route("**/files/**", lambda route: route.abort())
    made.check("input[name=kit][value=blender]")
    made.click("#download")
    made.wait_for_selector("#download-status:has-text('The server')")
    made.click("#download:has-text('Cancel')")
    made.wait_for_selector("#download-status:has-text('Cancelled')")
    made.check("input[name=kit][value=glb]")
    made.click("#download:has-text('Download')")
    made.wait_for_selector("#download-status:has-text('That did not work')")
    assert made.is_visible("#canvas"), "the head stays"


@pytest.mark.parametrize("reloaded", [False, True])
def test_what_was_read_wrongly_is_corrected(reloaded: bool, made: Page, fake: Fake) -> None:
    """After a reload the page has no photo, and asks for it; the choices start from those of the head."""
    if reloaded:
        reload(made)
    made.click("#correct > summary")
    made.select_option("#correct-hair", "bob")
    made.select_option("#correct-mouth", "shut")
    made.fill("#correct-length", "120")
    assert made.input_value("#correct-quality") == "draft", "as the archive was made"
    if reloaded:
        made.set_input_files("#correct-photo", PHOTO)
    with made.expect_response(lambda answer: answer.request.method == "POST"):
        made.click("#correct button")
    wish = fake.options[-1]
    assert {name: wish.get(name) for name in ("hair", "mouth", "hair_length", "eye_colour", "quality", "size")} == {
        "hair": "bob", "mouth": "shut", "hair_length": 120, "eye_colour": None, "quality": "draft", "size": [384, 256],
    }  # fmt: skip
    assert fake.photos == [[PHOTO.read_bytes()]] * 2


@pytest.mark.parametrize(("colour", "corner"), [("none", 0), ("#ffffff", 255)])
def test_a_picture_is_saved_with_what_is_behind_it(made: Page, colour: str, corner: int) -> None:
    made.click("#pictures > summary")
    made.check(f"input[name=background][value='{colour}']", force=True)
    with made.expect_download() as saved:
        made.click("text=Save picture")
    pixels = np.asarray(Image.open(saved.value.path()).convert("RGBA"))
    assert pixels[0, 0, 3] == corner and pixels[len(pixels) // 2, pixels.shape[1] // 2, 3] == 255


def test_a_rim_of_light_is_seen(made: Page) -> None:
    """Where no other light is, the brightest part of the head is as bright as in the studio."""
    made.click("#pictures > summary")
    made.check("input[name=background][value='#000000']", force=True)
    studio = np.percentile(picture(made), 99)
    made.get_by_role("button", name="Rim").click()
    assert np.percentile(picture(made), 99) > 0.7 * studio
