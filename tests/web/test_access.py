"""The page by keyboard, on a phone, in the dark, and without WebGL."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from tests.support.browser import PHOTO, Opener, difference, make_head, picture, submit
from tests.web.fake_service import Fake

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow

PHONE: dict[str, Any] = {
    "viewport": {"width": 390, "height": 780}, "device_scale_factor": 1, "is_mobile": True, "has_touch": True,
}  # fmt: skip


def tab_to(page: Page, selector: str) -> None:
    for _ in range(80):
        page.keyboard.press("Tab")
        if page.evaluate("(selector) => document.activeElement.matches(selector)", selector):
            return
    raise AssertionError(f"{selector} cannot be reached by Tab")


def test_who_is_quicker_than_the_file_is_read_gets_a_head(fake: Fake, open_page: Opener) -> None:
    """From a slow disk: the page said that there is no photo, took it up a moment later and did nothing more."""
    page = open_page(fake.address)
    page.evaluate("""() => {
        const read = Blob.prototype.arrayBuffer;
        Blob.prototype.arrayBuffer = async function () {
            await new Promise((done) => setTimeout(done, 700));
            return read.call(this);
        };
    }""")
    page.set_input_files("#file", PHOTO)
    page.click("#go")
    page.wait_for_selector("#canvas[data-shows=lit]")
    assert len(fake.options) == 1


def test_keyboard_only(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address)
    page.on("filechooser", lambda chooser: None)  # early: on a busy machine the key would come before the listener
    tab_to(page, "#file")
    assert page.evaluate("getComputedStyle(document.getElementById('file-label')).outlineStyle") == "solid"
    with page.expect_file_chooser() as chooser:
        page.keyboard.press("Enter")
    chooser.value.set_files(PHOTO)
    tab_to(page, "input[name=quality]")
    page.keyboard.press("ArrowLeft")
    tab_to(page, "#go")
    page.keyboard.press("Enter")
    page.wait_for_selector("#canvas[data-shows=lit]")
    assert fake.options == [{"quality": "draft"}]

    tab_to(page, "#canvas")
    front = picture(page)
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    turned = picture(page)
    assert difference(front, turned) > 0.02
    page.keyboard.press("Shift+ArrowLeft")
    assert page.input_value("#light-azimuth") == "30"
    page.keyboard.press("+")
    assert difference(turned, picture(page)) > 0.01
    page.keyboard.press("Home")

    tab_to(page, "#inset")
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "wipe"
    page.keyboard.press("ArrowRight")
    assert page.input_value("#wipe") == "51"
    assert page.evaluate("getComputedStyle(document.getElementById('view')).getPropertyValue('--at')") == "51%"
    tab_to(page, "input[name=drag]")
    page.keyboard.press("ArrowRight")
    assert not page.is_visible("#wipe")

    tab_to(page, "input[name=kit]")
    page.keyboard.press("ArrowDown")
    assert page.is_checked("input[name=kit][value=blender]")
    tab_to(page, "input[name=preset]")
    page.keyboard.press("ArrowRight")
    assert page.is_checked("input[name=preset][value=neutral]")
    tab_to(page, "#alive")
    page.keyboard.press("Space")
    assert page.get_attribute("#alive", "aria-pressed") == "true"
    page.keyboard.press("Space")
    tab_to(page, "#light-elevation")
    page.keyboard.press("ArrowRight")
    assert page.input_value("#light-elevation") == "31"
    tab_to(page, "#artists > summary")
    page.keyboard.press("Enter")
    tab_to(page, "input[name=view]")
    page.keyboard.press("ArrowDown")
    page.wait_for_selector("#canvas[data-shows=texture]")
    tab_to(page, "#delete")
    page.keyboard.press("Enter")
    page.wait_for_selector("#confirm[open]")
    page.keyboard.press("Escape")
    page.wait_for_selector("#confirm", state="hidden")
    assert page.evaluate("document.activeElement.id") == "delete"


def small_targets(page: Page) -> list[str]:
    """Controls that a thumb would miss: under 24 px high (WCAG 2.2, 2.5.8), their label counted with them."""
    return list(
        page.eval_on_selector_all(
            "button, a.button, select, input[type=range], label:has(input), label.button",
            """elements => elements.filter((e) => e.checkVisibility() && e.getBoundingClientRect().height < 24)
                .map((e) => e.outerHTML.slice(0, 60))""",
        )
    )


def test_a_phone(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address, **PHONE)
    assert page.is_visible("label[for=camera]")
    assert page.get_attribute("#camera", "capture") == "user"
    for screen in ("intake", "result"):
        if screen == "result":
            make_head(page)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390, f"{screen} scrolls sideways"
        assert not small_targets(page)
    page.locator("#light-azimuth").scroll_into_view_if_needed()
    box = page.locator("#canvas").bounding_box()
    assert box
    assert box["y"] >= -1, "the head stays in view while the controls are used"
    assert box["height"] < 0.6 * 780
    for selector in ("#alive", "input[name=kit]", "#delete", "#download"):
        page.locator(selector).first.focus()
        here = page.locator(selector).first.bounding_box()
        scene = page.locator(".scene").bounding_box()
        assert here
        assert scene
        assert here["y"] >= scene["y"] + scene["height"] - 1, f"{selector} has the focus and lies under the view"


def test_without_webgl_there_is_the_preview(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address, expected=("WebGL",))
    page.evaluate("HTMLCanvasElement.prototype.getContext = () => null")
    submit(page)
    page.wait_for_selector("img#canvas")
    assert "no 3D" in page.inner_text("#view-status")
    page.wait_for_function("() => document.querySelector('img#canvas').naturalWidth > 100")
    assert page.is_visible("#download")
    assert page.is_visible("#artists")
    assert not page.is_visible("#view-modes")
