"""From the photo to the finished job: progress, broken connections, refusals, faces, keys."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.support.browser import PHOTO, Opener, make_head, posts, submit
from tests.web.fake_service import Fake, problem
from tests.web.states import TWO_FACES

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow

REFUSED = "Failed to load resource"  # what Chromium logs for each answer of 400 and more


def done(page: Page) -> None:
    page.wait_for_selector("#result:not([hidden])")


def fault_text(page: Page) -> str:
    page.wait_for_selector("#fault:not([hidden])")
    return page.inner_text("#fault")


def test_a_photo_becomes_a_head(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address)
    page.evaluate(
        """() => { window.said = []; window.shares = [];
        new MutationObserver(() => said.push(document.getElementById('live').textContent))
            .observe(document.getElementById('live'), {childList: true});
        new MutationObserver(() => shares.push(document.getElementById('work-bar').value))
            .observe(document.getElementById('work-bar'), {attributes: true}); }"""
    )
    make_head(page)
    said = page.evaluate("said")
    assert [text for text in said if text in ("Finding the face", "Fitting the head", "The head is ready")] == [
        "Finding the face", "Fitting the head", "The head is ready",
    ]  # fmt: skip
    shares = page.evaluate("shares")
    assert len(set(shares)) >= 4
    assert shares == sorted(shares), "the bar went back"
    assert fake.photos == [[PHOTO.read_bytes()]]
    assert fake.options == [{"quality": "standard"}]
    assert page.url.endswith(f"#avatar={next(iter(fake.jobs))}")


def test_options_are_those_that_were_chosen(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address)
    page.click("#more > summary")
    page.check("input[name=quality][value=draft]")
    page.check("input[name=which][value=some]")
    for name in ("displacement", "confidence", "texture"):
        page.uncheck(f"#maps-choices input[value={name}]")
    page.check("input[name=face][value=largest]")
    page.select_option("#make-hair", "bob")
    page.fill("#make-length", "120")
    submit(page)
    page.wait_for_url("**/#avatar=*")
    maps = ["diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "shape_normal"]
    looks = {"hair": "bob", "hair_length": 120}
    assert fake.options == [{"quality": "draft", "maps": maps, "face": "largest", **looks}]


def test_a_broken_stream_goes_on_where_it_was(fake: Fake, open_page: Opener) -> None:
    fake.cut_after = 2
    fake.step_s = 0.5
    page = open_page(fake.address)
    submit(page)
    done(page)
    last = [headers.get("last-event-id") for _, path, headers in fake.requests if path.endswith("/events")]
    assert last[0] is None
    assert len(last) > 1
    assert all(value is not None and int(value) >= 2 for value in last[1:])


def test_a_failed_job_says_why_and_keeps_the_photo(fake: Fake, open_page: Opener) -> None:
    fake.error = problem("face-too-small", 422, "<img src=x onerror=alert(1)>", "the face is <b>31</b> pixels wide")
    page = open_page(fake.address)
    submit(page)
    text = fault_text(page)
    assert "<img src=x" in text and "<b>31</b> pixels" in text, "words of the service are text"
    assert page.is_visible("#thumbs img")
    assert page.evaluate("document.activeElement.id") == "fault"
    page.click("#go")
    done(page)


def test_trying_again_after_a_lost_answer_makes_one_job(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address, expected=("net::ERR_FAILED",))
    page.route("**/v1/avatars", lambda route: (route.fetch(), route.abort()))
    submit(page)
    assert "cannot be reached" in fault_text(page)
    page.unroute("**/v1/avatars")
    page.click("#again")
    done(page)
    keys = [headers["idempotency-key"] for headers in posts(fake.requests)]
    assert len(keys) == 2
    assert keys[0] == keys[1]


def test_choosing_a_face_is_a_question_and_no_error(fake: Fake, open_page: Opener) -> None:
    """Faces are counted as the boxes are: the service's text counts the two that matter of three."""
    fake.error = TWO_FACES
    page = open_page(fake.address)
    submit(page)
    page.wait_for_selector(".frame >> nth=2")
    assert not page.is_visible("#fault")
    assert page.evaluate("document.activeElement.id") == "faces-title"
    assert "3 faces" in page.inner_text("#faces") and "index" not in page.inner_text("#faces")
    labels = page.eval_on_selector_all(".frame", "frames => frames.map((frame) => frame.getAttribute('aria-label'))")
    assert labels == ["Face 1, the largest", "Face 2", "Face 3"]
    photo, frame = page.locator("#boxes-photo").bounding_box(), page.locator(".frame").first.bounding_box()
    assert photo and frame
    scale = photo["width"] / 512
    assert abs(frame["x"] - photo["x"] - 170 * scale) < 1 and abs(frame["height"] - 110 * scale) < 1
    page.get_by_role("button", name="Face 2").click()
    done(page)
    assert [options.get("face") for options in fake.options] == [None, 1]
    assert [options["quality"] for options in fake.options] == ["standard"] * 2, "the other options stay"


def test_cancel(fake: Fake, open_page: Opener) -> None:
    fake.step_s = 3
    page = open_page(fake.address)
    submit(page)
    page.wait_for_url("**/#avatar=*")
    with page.expect_response(lambda answer: answer.request.method == "DELETE"):
        page.click("#cancel")
    page.wait_for_selector("#intake:not([hidden])")
    page.wait_for_function("!location.hash")
    assert fake.deleted == list(fake.jobs)


def test_a_reloaded_page_goes_on_with_its_job(fake: Fake, open_page: Opener) -> None:
    fake.step_s = 0.6
    page = open_page(fake.address)
    submit(page)
    page.wait_for_url("**/#avatar=*")
    page.reload()
    page.wait_for_selector("#work:not([hidden])")
    done(page)
    assert len(fake.jobs) == 1


@pytest.mark.parametrize(
    ("reason", "words"),
    [("expired", "has expired"), ("erased", "was deleted"), ("lost", "are lost"), (None, "no head")],
)
def test_a_link_to_a_head_that_is_gone_says_why(reason: str | None, words: str, fake: Fake, open_page: Opener) -> None:
    if reason:
        fake.gone["never-was"] = reason
    page = open_page(f"{fake.address}/#avatar=never-was", expected=(REFUSED,))
    page.wait_for_selector("#gone:not([hidden])")
    assert words in page.inner_text("#gone-title")
    assert not page.is_visible("#fault")
    assert page.evaluate("document.activeElement.id") == "gone-title"
    page.click("#restart-gone")
    assert page.is_visible("#intake")
    assert page.evaluate("document.activeElement.id") == "file"


def test_delete_asks_first(fake: Fake, open_page: Opener) -> None:
    page = open_page(fake.address)
    make_head(page)
    page.click("#delete")
    page.click("#confirm button[value=keep]")
    assert not fake.deleted
    page.click("#delete")
    page.click("#confirm button[value=delete]")
    page.wait_for_selector("#intake:not([hidden])")
    assert fake.deleted == list(fake.jobs)


def test_a_service_that_wants_a_key(fake: Fake, open_page: Opener) -> None:
    fake.key = "secret-key"
    page = open_page(fake.address, expected=(REFUSED,))
    submit(page)
    assert "A key is needed" in fault_text(page)
    page.fill("#key", "secret-key")
    page.press("#key", "Enter")
    done(page)
    page.check("input[name=kit][value=all]")
    with page.expect_download() as download:
        page.click("#download")
    assert download.value.path().read_bytes() == fake.archive.read_bytes()
