"""Photos of one person: chosen, dropped, taken with the camera, refused; and which was used for what."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.browser import PHOTO, Opener, settle
from tests.web.archives import rewritten
from tests.web.fake_service import STATIC, Fake, problem, serving

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow

OTHER = STATIC / "sample.jpg"


def count(page: Page, photos: int) -> None:
    page.wait_for_function(f"() => document.querySelectorAll('#thumbs img').length === {photos}")


def test_photos_are_gathered_and_taken_away(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address)
    page.set_input_files("#file", PHOTO)
    count(page, 1)
    page.set_input_files("#file", [OTHER, PHOTO])
    count(page, 2)
    assert page.inner_text("#photo-name") == "2 photos of one person"
    page.get_by_role("button", name=f"Take {PHOTO.name} away").click()
    count(page, 1)
    page.evaluate(
        """async () => {
            const data = new DataTransfer();
            const file = await (await fetch('gallery/photo.jpg')).blob();
            data.items.add(new File([file], 'dropped.jpg'));
            document.body.dispatchEvent(new DragEvent('drop', {dataTransfer: data, bubbles: true}));
        }"""
    )
    count(page, 2)
    page.click("#go")
    page.wait_for_url("**/#avatar=*")
    assert fake.photos == [[OTHER.read_bytes(), (STATIC / "gallery/photo.jpg").read_bytes()]]


def test_files_that_are_no_photos_are_named_when_they_are_chosen(fake: Fake, open_page: Opener, tmp_path: Path) -> None:
    (tmp_path / "bad.jpg").write_text("not a photo")
    (tmp_path / "phone.heic").write_bytes(b"\0\0\0\x18ftypheic" + bytes(40))
    page = open_page(fake.address)
    page.wait_for_selector("#quality:not([hidden])")
    page.set_input_files("#file", [tmp_path / "bad.jpg", PHOTO, tmp_path / "phone.heic"])
    page.wait_for_selector("#fault:has-text('bad.jpg is not a photo')")
    assert "phone.heic is HEIC, which this server does not read" in page.inner_text("#fault")
    assert page.get_attribute("#file", "accept") == "image/jpeg,image/png,image/webp"
    count(page, 1)
    page.set_input_files("#file", OTHER)
    count(page, 2)
    assert page.is_hidden("#fault") and not fake.photos


def test_of_several_photos_the_one_that_is_refused_is_named(fake: Fake, open_page: Opener) -> None:
    fake.error = problem("strangers", 422, "Another person", "photo 2 of 2: it shows another person", photo=1)
    page = open_page(fake.address)
    page.set_input_files("#file", [PHOTO, OTHER])
    page.click("#go")
    page.wait_for_selector("#fault:has-text('sample.jpg: it shows another person')")
    assert page.locator("#thumbs .bad img").get_attribute("alt") == OTHER.name


def two_photos(name: str, data: bytes) -> bytes:
    """The manifest as if another photo had been given before its own, and a third were of no use."""
    if name != "manifest.json":
        return data
    manifest: dict[str, Any] = json.loads(data)
    (first,) = manifest["photos"]
    camera = {**first["camera"], "yaw_pitch_roll_deg": [34.0, 0, 0]}
    other = {**first, "sha256": hashlib.sha256(OTHER.read_bytes()).hexdigest(), "camera": camera}
    first["texture_share"], other["texture_share"], other["used_for"] = 0.6, 0.4, ["shape", "texture"]
    unused = {"sha256": "0" * 64, "code": "no-face", "message": "no face was found"}
    return json.dumps(manifest | {"photos": [first, other], "left_out": [unused]}).encode()


def test_which_photo_was_used_for_what(archive: Path, tmp_path: Path, open_page: Opener) -> None:
    rewritten(archive, tmp_path / "two.zip", two_photos)
    with serving(tmp_path / "two.zip", step_s=0.05) as fake:
        page = open_page(fake.address)
        page.set_input_files("#file", [OTHER, PHOTO])
        page.click("#go")
        page.wait_for_selector("#inset:not([hidden])")
        settle(page)
        rows = page.locator("#photos li").all_inner_texts()
        pictures = page.eval_on_selector_all("#photos img", "images => images.map((image) => image.alt)")
        compared = page.evaluate("document.getElementById('compare-photo').naturalHeight")
    assert [" ".join(row.split()) for row in rows] == [
        "From the front astronaut.png: shape, 60 % of the texture; expression, eyes and hair",
        "Turned 34° to the left sample.jpg: shape, 40 % of the texture",
        "Not used no face was found",
    ]
    assert pictures == [PHOTO.name, OTHER.name], "found by their hashes, not by their order"
    assert compared == 512, "the head is compared with the photo that its camera belongs to"
