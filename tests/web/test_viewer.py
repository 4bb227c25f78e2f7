"""The head in 3D: maps, normals, light, expressions, turning."""

from __future__ import annotations

import itertools
import json
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from tests.support.browser import (
    PATIENCE_MS,
    Opener,
    Pixels,
    artists,
    difference,
    face,
    make_head,
    opening,
    picture,
    set_light,
    set_slider,
    shapes,
    show,
)  # fmt: skip
from tests.web.archives import leaning
from tests.web.fake_service import serving

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.slow

MAPS = [
    "texture", "diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "displacement", "confidence",
    "shape_normal",
]  # fmt: skip


@pytest.fixture(scope="module")
def head(browser: Browser, archive: Path) -> Iterator[Page]:
    """A head with all maps, opened once; each test leaves it as it was."""
    with serving(archive, step_s=0.05) as fake, opening(browser) as opened:
        page = opened(fake.address)
        make_head(page)
        yield page


def all_different(pictures: dict[str, Pixels], least: float) -> None:
    for (first, one), (second, other) in itertools.combinations(pictures.items(), 2):
        assert difference(one, other) > least, f"{first} and {second} look the same"


def test_there_is_a_switch_for_each_map_of_the_manifest_and_each_looks_different(head: Page, archive: Path) -> None:
    values = head.eval_on_selector_all("#panel input[name=view]", "inputs => inputs.map((input) => input.value)")
    assert values[:9] == ["lit", *MAPS]
    with zipfile.ZipFile(archive) as opened:
        roles = [entry["role"] for entry in json.loads(opened.read("manifest.json"))["maps"]]
    assert sorted(values[1:]) == sorted(roles)
    # Both normals differ by 0.0015 in the maps themselves.
    all_different({name: show(head, name) for name in ("lit", *MAPS)}, 0.001)


def test_a_map_alone_shows_its_codes_whatever_the_light(head: Page) -> None:
    before = show(head, "shape_normal")
    set_light(head, -120, 60)
    assert difference(before, picture(head)) == 0
    nose = face(before).mean((0, 1))
    assert nose[2] > 0.8, "the face looks along +Z, which is blue"
    set_light(head, 35, 30)


def halves(pixels: Pixels) -> float:
    """Brightness of the right half of the face over the left one's."""
    inside = face(pixels).mean(-1)
    middle = inside.shape[1] // 2
    return float(inside[:, middle:].mean() / inside[:, :middle].mean())


def test_the_light_comes_from_where_it_was_put(head: Page) -> None:
    show(head, "lit")
    set_light(head, 80, 0)
    right = halves(picture(head))
    set_light(head, -80, 0)
    left = halves(picture(head))
    assert right > 1.15 * left
    set_light(head, 35, 30)


def drag(page: Page, right: int) -> None:
    """By the mouse, from the middle of the view."""
    box = page.locator("#canvas").bounding_box()
    assert box
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + right, y, steps=4)
    page.mouse.up()


def test_the_light_is_moved_by_dragging_ball_and_head(head: Page) -> None:
    show(head, "lit")
    before = picture(head)
    head.locator(".ball").scroll_into_view_if_needed()
    box = head.locator(".ball").bounding_box()
    assert box
    head.mouse.click(box["x"] + 0.15 * box["width"], box["y"] + 0.5 * box["height"])
    assert float(head.input_value("#light-azimuth")) < -60
    assert abs(float(head.input_value("#light-elevation"))) < 5
    moved = picture(head)
    assert difference(before, moved) > 0.01
    head.check("input[name=drag][value=light]", force=True)
    drag(head, 100)
    assert float(head.input_value("#light-azimuth")) > -60
    assert difference(moved, picture(head)) > 0.01
    head.check("input[name=drag][value=head]", force=True)
    set_light(head, 35, 30)


@pytest.mark.parametrize(("slope", "lamp"), [((0.6, 0.0), (70, 0)), ((0.0, 0.6), (0, 60)), ((0.0, 0.0), (0, 60))])
def test_normals_lean_where_their_map_says(
    slope: tuple[float, float], lamp: tuple[float, float], archive: Path, tmp_path: Path, open_page: Opener
) -> None:
    """Tangent space with +Y up: leaning to +u turns the face to the viewer's right, to +v upwards, to a lamp there.

    Code 128 is zero; decoding it as n / 2 + 1/2 would tilt the whole face.
    """
    leaning(archive, tmp_path / "leaning.zip", slope)
    with serving(tmp_path / "leaning.zip", step_s=0.05) as fake:
        page = open_page(fake.address)
        make_head(page)
        artists(page)
        set_slider(page, "light-room", 0)
        set_light(page, *lamp)
        towards = face(picture(page)).mean()
        page.uncheck("#use-normals")
        straight = face(picture(page)).mean()
        page.check("#use-normals")
        set_light(page, -lamp[0], -lamp[1])
        away = face(picture(page)).mean()
    if slope == (0.0, 0.0):
        assert abs(towards - straight) < 2e-4
    else:
        assert towards > 1.1 * straight and away < 0.9 * towards


def test_expressions(head: Page) -> None:
    before = show(head, "lit")
    shapes(head)
    assert head.locator("input[id^=shape-]").count() == 52
    set_slider(head, "shape-jawOpen", 1)
    assert head.locator("input[name=preset]:checked").count() == 0, "it is no preset any more"
    opened = picture(head)
    height = before.shape[0]
    lower = np.abs(opened - before)[height // 2 : int(0.85 * height)].mean()
    upper = np.abs(opened - before)[: int(0.4 * height)].mean()
    assert lower > 10 * upper, "opening the jaw moves the lower face"
    head.check("input[name=preset][value=neutral]", force=True)
    assert head.input_value("#shape-jawOpen") == "0"
    neutral = picture(head)
    head.check("input[name=preset][value=photo]", force=True)
    assert difference(neutral, picture(head)) > 0.002
    assert difference(before, picture(head)) == 0


def test_the_live_loop_moves_the_head_until_it_is_stopped(head: Page) -> None:
    before = show(head, "lit")
    assert head.get_attribute("#alive", "aria-pressed") == "false", "nothing moves before it is asked to"
    head.click("#alive")
    assert head.get_attribute("#alive", "aria-pressed") == "true"
    frames = int(head.get_attribute("#canvas", "data-frames") or 0)
    head.wait_for_function(f"() => Number(document.getElementById('canvas').dataset.frames) > {frames + 5}")
    head.click("#alive")
    assert difference(before, picture(head)) == 0, "stopping leaves the expression that was chosen"


def test_words_for_what_was_measured(head: Page) -> None:
    text = head.inner_text(".summary")
    assert "Face: very like the photo" in text and "Hair: " in text
    assert "The photo shows most of the face" in text  # hair hides the temples, and skin beside it is not believed
    assert not any(character.isdigit() for character in text), "numbers are for artists"


def test_gloss_and_pores_come_from_their_maps(head: Page) -> None:
    """The file's pictures of both, which are coded as glTF wants them, were taken for the maps."""
    full = show(head, "lit")
    for name, least in (("use-specular", 0.001), ("use-normals", 0.0003)):
        head.click(f"#{name}")
        assert difference(full, picture(head)) > least, name
        head.click(f"#{name}")
    assert difference(full, picture(head)) == 0


def test_a_film_of_the_turn_can_be_saved(head: Page, tmp_path: Path) -> None:
    before = show(head, "lit")
    head.click("#pictures > summary")
    with head.expect_download(timeout=PATIENCE_MS) as waiting:
        head.click("text=Save turntable")
    path = tmp_path / waiting.value.suggested_filename
    waiting.value.save_as(path)
    film, frames = cv2.VideoCapture(str(path)), []
    while (read := film.read())[0]:
        frames.append(read[1].astype(float))
    assert len(frames) >= 30, "a turn by at most 6 degrees a frame has 60, of which a slow machine may drop some"
    assert max(np.abs(frames[0] - frame).mean() for frame in frames) > 3, "the head turns"
    head.click("#reset-view")
    assert difference(before, picture(head)) < 0.002
