"""Every screen of the page and the states that it has, one after another."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from tests.support.browser import PHOTO, artists, make_head, settle, shapes, submit
from tests.web.fake_service import STATIC, Fake, problem

if TYPE_CHECKING:
    from playwright.sync_api import Page

TWO_FACES = problem(
    "multiple-faces",
    422,
    "Several faces in the photo",
    "the photo shows 2 faces; choose one by its index (0 is the largest) or 'largest'",
    boxes=[[170, 70, 280, 180], [10, 20, 60, 80], [400, 300, 420, 320]],
)
"""Three boxes: the service counts two that matter, and the choice goes through all of them."""


def before(page: Page, fake: Fake) -> Iterator[str]:
    """States before there is a head; ends on the start screen."""
    page.goto(fake.address)
    page.wait_for_selector("#quality:not([hidden])")
    yield "start"
    page.click("#more > summary")
    page.check("input[name=which][value=some]")
    page.set_input_files("#file", PHOTO)
    page.wait_for_selector("#thumbs img")
    yield "photo and options"
    page.set_input_files("#file", STATIC / "sample.jpg")
    page.wait_for_selector("#thumbs li >> nth=1")
    yield "several photos"
    page.click("#guide-open")
    page.wait_for_selector("#guide[open]")
    yield "guide"
    page.click("#guide-close")
    page.get_by_role("button", name="Take sample.jpg away").click()
    page.uncheck("#maps-choices input >> nth=0")
    page.check("input[name=which][value=all]")
    fake.error = problem("no-face", 422, "No face in the photo", "no face was found")
    page.click("#go")
    page.wait_for_selector("#fault:not([hidden])")
    yield "fault"
    fake.key = "secret"
    page.click("#go")
    page.wait_for_selector("#key-form:not([hidden])")
    yield "key"
    fake.key = ""
    fake.error = TWO_FACES
    submit(page)
    page.wait_for_selector(".frame >> nth=2")
    yield "faces"
    fake.step_s = 2.0
    page.click(".frame >> nth=0")
    page.wait_for_selector("#work-done li")
    yield "work"
    page.click("#cancel")
    page.wait_for_selector("#intake:not([hidden])")  # before that the page would take the next address away again
    fake.step_s = 0.05
    fake.gone["job-over"] = "expired"
    page.goto(f"{fake.address}/#avatar=job-over")
    page.reload()
    page.wait_for_selector("#gone:not([hidden])")
    yield "gone"
    page.click("#restart-gone")


def after(page: Page, fake: Fake) -> Iterator[str]:
    """States of a head that is shown."""
    make_head(page)
    page.wait_for_selector("#inset:not([hidden])")
    yield "head"
    page.click("#inset")
    settle(page)
    yield "compare"
    page.check("input[name=drag][value=head]", force=True)
    shapes(page)
    artists(page)
    for part in ("#measured", "#files", "#correct", "#pictures"):
        page.click(f"{part} > summary")
    yield "everything open"
    page.check("input[name=view][value=confidence]")
    page.wait_for_selector("#canvas[data-shows=confidence]")
    page.locator("#canvas").scroll_into_view_if_needed()
    yield "confidence"
    page.click("#delete")
    page.wait_for_selector("#confirm[open]")
    yield "delete?"
    page.click("#confirm button[value=keep]")


STATES: tuple[Callable[[Page, Fake], Iterator[str]], ...] = (before, after)
