"""Around the head: the photo beside it, what can be downloaded, how long it is kept."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from tests.support.browser import PHOTO, Opener, artists, make_head, picture, settle
from tests.web.fake_service import KIT, Fake

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow

REFUSED = "Failed to load resource"
SURFACE = ["diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "displacement"]


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
def test_photo_and_head_lie_on_each_other(reloaded: bool, fake: Fake, open_page: Opener) -> None:
    """With the photo that was handed in, and after a reload with the one in the preview."""
    import cv2

    page = open_page(fake.address, device_scale_factor=1)
    make_head(page)
    if reloaded:
        page.reload()
        page.wait_for_selector("#canvas[data-shows=lit]")
    page.wait_for_selector("#inset:not([hidden])")
    wanted = "CANVAS" if reloaded else "IMG"
    assert page.evaluate("document.querySelector('#photo-layer > *').tagName") == wanted
    compare(page, 100)
    photo = picture(page)
    compare(page, 0)
    head = picture(page)
    assert np.abs(photo - head).mean() > 0.05
    height, width = photo.shape[:2]
    inner = np.s_[int(0.3 * height) : int(0.6 * height), int(0.38 * width) : int(0.62 * width)]
    outer = np.s_[int(0.25 * height) : int(0.65 * height), int(0.33 * width) : int(0.67 * width)]
    found = cv2.matchTemplate(edges(photo)[outer], edges(head)[inner], cv2.TM_CCOEFF_NORMED)
    _, _, _, (x, y) = cv2.minMaxLoc(found)
    off = (x - (inner[1].start - outer[1].start), y - (inner[0].start - outer[0].start))
    assert np.hypot(*off) < 0.012 * height, f"the head lies {off} pixels beside the photo"


def test_comparing_ends_where_it_began(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address)
    make_head(page)
    before, lamp = picture(page), page.input_value("#light-azimuth")
    page.click("#inset")
    settle(page)
    assert page.input_value("#light-azimuth") != lamp, "the lamp goes to where the photo's light is"
    assert page.get_attribute("#canvas", "tabindex") == "-1"
    page.check("input[name=drag][value=head]", force=True)
    assert page.input_value("#light-azimuth") == lamp
    assert np.abs(before - picture(page)).max() < 0.02


def download(page: Page, kit: str) -> tuple[str, Path]:
    page.check(f"input[name=kit][value={kit}]")
    with page.expect_download() as saved:
        page.click("#download")
    return saved.value.suggested_filename, Path(saved.value.path())


def test_what_there_is_to_download(fake: Fake, archive: Path, open_page: Opener) -> None:
    page = open_page(fake.address)
    make_head(page)
    with zipfile.ZipFile(archive) as opened:
        members = {name: opened.read(name) for name in opened.namelist()}
    name, path = download(page, "glb")
    assert name == "head.glb"
    assert path.read_bytes() == members["mesh/head.glb"]
    name, path = download(page, "all")
    assert name == "avatar.zip"
    assert path.read_bytes() == archive.read_bytes()
    for tool in ("blender", "unreal", "unity", "maya"):
        name, path = download(page, tool)
        assert name == f"head-for-{tool}.zip"
        assert path.read_bytes() == KIT


def test_a_download_can_be_cancelled(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address)
    make_head(page)
    page.route("**/v1/exports/**", lambda route: None)  # never answered
    page.check("input[name=kit][value=blender]")
    page.click("#download")
    page.wait_for_function("() => document.getElementById('download-status').textContent.startsWith('The server')")
    assert page.inner_text("#download") == "Cancel"
    page.click("#download")
    page.wait_for_function("() => document.getElementById('download-status').textContent === 'Cancelled'")
    assert page.inner_text("#download") == "Download"


def test_a_download_over_a_broken_connection(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address, expected=("net::ERR_FAILED",))
    make_head(page)
    page.route("**/files/**", lambda route: route.abort())
    page.click("#download")
    page.wait_for_selector("#download-status:has-text('That did not work')")
    assert page.is_visible("#canvas"), "the head stays"


def test_every_file_can_be_downloaded(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address)
    make_head(page)
    artists(page)
    page.click("#files > summary")
    with page.expect_download() as saved:
        page.click("text=maps/texture.png")
    assert Path(saved.value.path()).read_bytes().startswith(b"\x89PNG")


def test_delete_is_far_from_download(fake: Fake, open_page: Opener) -> None:
    """Not beside it, not the next stop of the Tab key, and after everything else in the panel."""
    page = open_page(fake.address)
    make_head(page)
    download_at, delete_at = page.locator("#download").bounding_box(), page.locator("#delete").bounding_box()
    assert download_at and delete_at
    assert delete_at["y"] - download_at["y"] > 300
    page.locator("#download").focus()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.id") != "delete"
    assert page.eval_on_selector_all("#panel button", "buttons => buttons.at(-1).id") == "delete"


def test_how_long_the_head_is_kept(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address)
    page.set_input_files("#file", PHOTO)
    page.click("#go")
    page.wait_for_selector(".keep")
    assert "2046" in page.inner_text(".keep")


def test_what_was_read_wrongly_is_corrected(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address)
    make_head(page)
    page.click("#correct > summary")
    page.select_option("#correct-hair", "bob")
    page.select_option("#correct-mouth", "shut")
    page.fill("#correct-length", "120")
    page.click("#correct button")
    page.wait_for_selector("#work:not([hidden])")
    page.wait_for_selector("#result:not([hidden])")
    assert {name: fake.options[-1].get(name) for name in ("hair", "mouth", "hair_length", "eye_colour")} == {
        "hair": "bob", "mouth": "shut", "hair_length": 120, "eye_colour": None,
    }  # fmt: skip
    assert fake.photos[0] == fake.photos[1]


def test_without_the_photo_nothing_can_be_corrected(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address)
    make_head(page)
    page.reload()
    page.wait_for_selector("#inset:not([hidden])")
    page.click("#correct > summary")
    assert "erased the photo" in page.inner_text("#correct")


@pytest.mark.parametrize(("colour", "corner"), [("none", 0), ("#ffffff", 255)])
def test_a_picture_is_saved_with_what_is_behind_it(fake: Fake, open_page: Opener, colour: str, corner: int) -> None:
    page = open_page(fake.address)
    make_head(page)
    page.click("#pictures > summary")
    page.check(f"input[name=background][value='{colour}']", force=True)
    with page.expect_download() as saved:
        page.click("text=Save picture")
    pixels = np.asarray(Image.open(saved.value.path()).convert("RGBA"))
    assert pixels[0, 0, 3] == corner and pixels[len(pixels) // 2, pixels.shape[1] // 2, 3] == 255


def test_a_file_that_is_no_photo_is_named_when_it_is_chosen(fake: Fake, open_page: Opener, tmp_path: Path) -> None:
    (tmp_path / "bad.jpg").write_text("not a photo")
    (tmp_path / "phone.heic").write_bytes(b"\0\0\0\x18ftypheic" + bytes(40))
    page = open_page(fake.address)
    page.wait_for_selector("#quality:not([hidden])")
    for name, words in (("bad.jpg", "bad.jpg is not a photo"), ("phone.heic", "does not read HEIC")):
        page.set_input_files("#file", tmp_path / name)
        page.wait_for_selector(f"#fault:has-text('{words}')")
    assert page.get_attribute("#file", "accept") == "image/jpeg,image/png,image/webp"
    page.set_input_files("#file", PHOTO)
    page.wait_for_selector("#preview:not([hidden])")
    assert page.is_hidden("#fault") and not fake.photos
