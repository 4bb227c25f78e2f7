"""The start screen: what to expect, the gallery, the sample photo."""

from __future__ import annotations

import pytest

from tests.support.browser import Opener, submit
from tests.web.fake_service import LARGE, QUALITY, STATIC, Fake
from tests.web.test_access import PHONE

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("items", "times", "note"),
    [
        # 54.2 s and 77.3 s on two cores at the pace of the two that were measured, (8.2 / 8.1 + 41 / 55.4) / 2 = 0.876
        (QUALITY["items"], ["about 8 s", "about 41 s", "roughly 45 s", "roughly 70 s"], "worked out"),
        ([], ["roughly 8 s", "roughly 55 s", "roughly 55 s", "roughly 75 s"], "two cores"),
    ],
)
def test_measured_times_are_told_and_others_are_worked_out(
    items: list[dict[str, object]], times: list[str], note: str, fake: Fake, open_page: Opener
) -> None:
    fake.quality = {**QUALITY, "items": items}
    page = open_page(fake.address)
    page.wait_for_selector("#quality:not([hidden])")
    assert page.locator("#quality-choices .time").all_inner_texts() == times
    assert note in page.inner_text("#quality-note")


def test_the_time_follows_the_options_and_stays_in_sight(fake: Fake, open_page: Opener) -> None:
    fake.step_s = 1.0
    page = open_page(fake.address)
    page.wait_for_selector("#estimate:has-text('Takes about 41 s.')")
    page.click("#more > summary")
    for choice, told in (("quality][value=draft", "about 8 s"), ("which][value=fast", "roughly 4 s")):
        page.check(f"input[name={choice}]")
        assert page.inner_text("#estimate") == f"Takes {told}."
    page.check("input[name=which][value=all]")
    submit(page)
    page.wait_for_function("() => document.getElementById('work-time').textContent.endsWith('of about 8 s')")


def test_a_server_that_tells_no_times(fake: Fake, open_page: Opener) -> None:
    fake.quality = {}
    page = open_page(fake.address)
    page.wait_for_load_state("networkidle")
    assert page.inner_text("#estimate") == ""
    submit(page)
    page.wait_for_selector("#work:not([hidden])")


def test_a_job_that_takes_longer_than_told(fake: Fake, open_page: Opener) -> None:
    fake.quality = {**QUALITY, "items": [{"quality": "standard", "size": LARGE, "median_s": 1.0}]}
    fake.step_s = 2.0
    page = open_page(fake.address)
    page.wait_for_selector("#quality:not([hidden])")
    submit(page)
    page.wait_for_function("() => document.getElementById('work-time').textContent.endsWith('was to take about 1 s')")


@pytest.mark.parametrize("button", ["#try", "#try-too"])
def test_the_sample_is_made_at_once(button: str, fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address)
    assert "about 8 s" in page.inner_text("#try")
    page.click(button)
    page.wait_for_url("**/#avatar=*")
    assert fake.photos == [[(STATIC / "sample.jpg").read_bytes()]]
    assert fake.options == [{"quality": "draft"}]


@pytest.mark.parametrize("screen", ["wide", "phone"])
def test_all_pictures_of_the_gallery_come(screen: str, fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address, **(PHONE if screen == "phone" else {}))
    images = page.locator("#gallery img")
    assert images.count() == 8
    for index in range(8):
        images.nth(index).scroll_into_view_if_needed()
        page.wait_for_function(f"() => document.querySelectorAll('#gallery img')[{index}].naturalWidth > 300")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


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
