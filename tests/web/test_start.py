"""The start screen: what to expect, the gallery, the sample photo."""

from __future__ import annotations

import pytest

from tests.support.browser import Opener
from tests.web.fake_service import STATIC, Fake

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("button", ["#try", "#try-too"])
def test_the_sample_is_made_at_once(button: str, fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address)
    assert "about 6 s" in page.inner_text("#try")
    page.click(button)
    page.wait_for_url("**/#avatar=*")
    assert fake.photos == [[(STATIC / "sample.jpg").read_bytes()]]
    assert fake.options == [{"quality": "draft"}]


def test_the_gallery_wipes_from_photo_to_head(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address)
    page.locator("#gallery-wipe").scroll_into_view_if_needed()
    box = page.locator("#gallery-wipe").bounding_box()
    assert box
    page.mouse.click(box["x"] + 0.25 * box["width"], box["y"] + 0.7 * box["height"])
    at = page.evaluate("getComputedStyle(document.getElementById('gallery-wipe')).getPropertyValue('--at')")
    assert abs(float(at.rstrip("%")) - 25) <= 2
    page.locator("#gallery-wipe input").press("End")
    assert page.get_attribute("#gallery-wipe input", "aria-valuetext") == "100 % photo, 0 % head"
