"""Pictures of the page's gallery: ``python -m tests.web.gallery [--archive AVATAR.zip]``, then ``make web``.

Makes a head of the sample photo (or takes an archive of it), opens it in the page itself, and writes what the viewer
shows, and cuts of the photo, to ``web/gallery``. With ``--docs`` it writes the pictures of ``docs/web.md`` instead, so
after ``make web``; with ``--people`` portraits of synthetic people with a wide smile and with an open mouth, drawn in
the page's viewer from heads of high quality, to ``tests/data/people``.
"""

from __future__ import annotations

import argparse
import io
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image

from tests.support.browser import PHOTO, ROOT, artists, launched, make_head, set_light, set_slider, settle, shapes
from tests.web.fake_service import serving
from tests.web.test_access import PHONE

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

OUT = ROOT / "web" / "gallery"
TILE = 360
"""Side of a small picture in pixels."""
WIDE = (540, 800)
"""Width and height of the two pictures with the slider."""
QUALITY = 84
"""Of the JPEGs."""
PEOPLE = ROOT / "tests" / "data" / "people"
SIDE = 640
"""Width and height of a portrait in pixels."""
SMILE = {
    "mouthSmileLeft": 1.0, "mouthSmileRight": 0.9, "cheekSquintLeft": 0.9, "cheekSquintRight": 0.8,
    "mouthUpperUpLeft": 0.5, "mouthUpperUpRight": 0.5, "eyeSquintLeft": 0.4, "eyeSquintRight": 0.4,
}  # fmt: skip
SPEECH = {"jawOpen": 0.75, "mouthLowerDownLeft": 0.3, "mouthLowerDownRight": 0.3, "browInnerUp": 0.4}
PORTRAITS: dict[str, tuple[Path, dict[str, float], tuple[int, int]]] = {
    "wide_smile": (PHOTO, SMILE, (45, 25)),
    "mouth_open": (PEOPLE / "open.jpg", SPEECH, (-25, 30)),
}
"""Photo, weights of the blendshapes, and where the light stands, degrees to the right of the camera and up."""
STUDIO = "background: radial-gradient(circle at 50% 42%, #fdfdfd, #ccd2d0)"
OUTSIDE = "background: linear-gradient(#8fa3ad, #59666e)"


def save(picture: Image.Image, name: str, quality: int = QUALITY) -> None:
    """Write a JPEG and check that it is small enough for the page."""
    path = OUT / f"{name}.jpg"
    picture.convert("RGB").save(path, quality=quality, optimize=True, progressive=True)
    if path.stat().st_size > 70_000:
        raise SystemExit(f"{path}: {path.stat().st_size} bytes are too many for the page")


def cuts_of_the_photo() -> None:
    """The photo as the page hands it in, and its thumbnail."""
    photo = Image.open(PHOTO).convert("RGB")
    save(photo, "sample", 90)
    save(photo.crop((125, 15, 325, 215)).resize((144, 144), Image.Resampling.LANCZOS), "thumb")


def grab(page: Page, size: tuple[int, int]) -> Image.Image:
    """The view without what lies over it, at that size."""
    settle(page)
    picture = Image.open(io.BytesIO(page.locator("#view").screenshot()))
    inner = picture.crop((2, 2, picture.width - 2, picture.height - 2))  # a rim may show what lies beside the view
    return inner.convert("RGB").resize(size, Image.Resampling.LANCZOS)


def framed(page: Page, width: int, height: int, background: str = STUDIO) -> None:
    """Make the view that large, in pixels of the page."""
    page.add_style_tag(
        content=f"#canvas {{ {background}; border: 0 }}"
        f"#view {{ width: {width}px !important; height: {height}px !important; border: 0 }}"
        "#view, #canvas { border-radius: 0 !important; outline: 0 !important; min-height: 0 }"
        "#reset-view, #inset, .wipe-line, .wipe-tag { display: none !important }"
    )


def take(page: Page) -> None:
    """All pictures that the viewer shows."""
    framed(page, WIDE[0] // 2, WIDE[1] // 2)
    page.check("input[name=drag][value=photo]", force=True)
    page.evaluate("document.getElementById('view').style.setProperty('--at', '0%')")
    save(grab(page, WIDE), "head")
    page.evaluate("document.getElementById('view').style.setProperty('--at', '100%')")
    save(grab(page, WIDE), "photo")

    page.check("input[name=drag][value=head]", force=True)
    framed(page, TILE, TILE)
    page.get_by_role("button", name="Studio").click()
    turn(page, -10)
    page.keyboard.press("+")
    page.keyboard.press("+")
    save(grab(page, (TILE, TILE)), "side")
    turn(page, 14)
    set_light(page, -65, 20)
    save(grab(page, (TILE, TILE)), "light")
    turn(page, -2)
    page.get_by_role("button", name="Studio").click()
    page.check("input[name=preset][value=surprise]", force=True)
    save(grab(page, (TILE, TILE)), "surprise")
    page.check("input[name=preset][value=smile]", force=True)
    artists(page)
    page.select_option("#colour", "")
    page.check("#use-normals")
    set_light(page, 60, 25)
    save(grab(page, (TILE, TILE)), "relief")
    page.select_option("#colour", "diffuse_albedo")
    page.check("#wireframe")
    page.get_by_role("button", name="Studio").click()
    turn(page, -8)
    save(grab(page, (TILE, TILE)), "mesh")


def turn(page: Page, steps: int) -> None:
    """Turn the head by arrow keys, 5 degrees each."""
    page.locator("#canvas").focus()
    for _ in range(abs(steps)):
        page.keyboard.press("ArrowRight" if steps > 0 else "ArrowLeft")


def charts(archive: Path) -> None:
    """The face in the middle of four maps, as quarters of one picture."""
    half = TILE // 2
    made = Image.new("RGB", (TILE, TILE))
    with zipfile.ZipFile(archive) as opened:
        for index, role in enumerate(("diffuse_albedo", "specular_albedo", "specular_normal", "displacement")):
            chart: Image.Image = Image.open(io.BytesIO(opened.read(f"maps/{role}.png")))
            if chart.mode.startswith("I"):  # 16 bits; relief shown to 0.15 mm of 1.6 mm
                chart = chart.point(lambda code: (code - 32768) / 24 + 128).convert("L")
            width, height = chart.size
            side = int(0.8 * height)
            left, top = (width - side) // 2, int(0.08 * height)
            quarter = chart.convert("RGB").crop((left, top, left + side, top + side)).resize((half, half))
            made.paste(quarter, (index % 2 * half, index // 2 * half))
    save(made, "maps")


def screens(browser: Browser, address: str) -> None:
    """The pictures of ``docs/web.md``: the start, the comparison with the photo, the head on a phone in the dark."""
    wide: dict[str, Any] = {"viewport": {"width": 1280, "height": 800}, "reduced_motion": "reduce"}
    page = browser.new_page(**wide)
    page.goto(address)
    page.wait_for_selector("#quality:not([hidden])")
    page.evaluate("for (const image of document.images) image.loading = 'eager'")
    page.wait_for_load_state("networkidle")
    shoot(page, "start", full_page=True)
    make_head(page)
    page.click("#inset")
    settle(page)
    page.locator("#view").hover()
    shoot(page, "light")
    phone = browser.new_page(**PHONE, color_scheme="dark", reduced_motion="reduce")
    phone.goto(address)
    make_head(phone)
    phone.click("label.surprise")
    phone.locator("#alive").focus()
    phone.evaluate("document.activeElement.blur(); scrollBy(0, 110)")
    settle(phone)
    shoot(phone, "phone")


def shoot(page: Page, name: str, **wishes: Any) -> None:
    """Write a screenshot of the page to ``docs``."""
    picture = Image.open(io.BytesIO(page.screenshot(**wishes))).convert("RGB")
    picture.save(ROOT / "docs" / f"web-{name}.jpg", quality=QUALITY, optimize=True, progressive=True)


@contextmanager
def made(photo: Path, *flags: str) -> Iterator[Path]:
    """An archive of the head of a photo."""
    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "head.zip"
        subprocess.run(
            [sys.executable, "-m", "service", "make", str(photo), "-o", str(archive), *flags], cwd=ROOT, check=True
        )
        yield archive


@contextmanager
def shown(archive: Path, sharpness: int) -> Iterator[Page]:
    """The page with the head of an archive."""
    with launched() as browser, serving(archive, step_s=0.05) as fake:
        page = browser.new_page(
            viewport={"width": 1200, "height": 900}, device_scale_factor=sharpness, reduced_motion="reduce",
            bypass_csp=True,
        )  # fmt: skip
        page.set_default_timeout(300_000)
        page.goto(fake.address)
        make_head(page)
        yield page


def portraits() -> None:
    """People with an expression that no portrait there has."""
    for name, (photo, weights, light) in PORTRAITS.items():
        with made(photo, "--size", "3072x2048") as archive, shown(archive, 1) as page:
            framed(page, SIDE + 4, SIDE + 4, OUTSIDE)
            page.check("input[name=preset][value=neutral]", force=True)
            shapes(page)
            for shape, value in weights.items():
                set_slider(page, f"shape-{shape}", value)
            set_light(page, *light)
            grab(page, (SIDE, SIDE)).save(PEOPLE / f"{name}.jpg", quality=92)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--archive", type=Path, help="a head of the sample photo that is made already")
    parser.add_argument("--docs", action="store_true", help="write the pictures of docs/web.md instead")
    parser.add_argument("--people", action="store_true", help="write two portraits of tests/data/people instead")
    given = parser.parse_args()
    if given.people:
        return portraits()
    with nullcontext(given.archive) if given.archive else made(PHOTO) as archive:
        if given.docs:
            with launched() as browser, serving(archive, step_s=0.05) as fake:
                return screens(browser, fake.address)
        OUT.mkdir(parents=True, exist_ok=True)
        cuts_of_the_photo()
        charts(archive)
        with shown(archive, 2) as page:
            take(page)


if __name__ == "__main__":
    main()
