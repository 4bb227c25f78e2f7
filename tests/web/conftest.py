from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.web.archives import with_reflectance
from tests.web.fake_service import Fake, serving

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROOT = Path(__file__).parents[2]
PHOTO = ROOT / "service" / "data" / "sample" / "astronaut.png"

CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# WebGL without a graphics card.
ARGUMENTS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
PATIENCE_MS = 120_000

# Half the pixels each way: drawing without a graphics card takes its time.
MODEST = {"viewport": {"width": 900, "height": 600}, "device_scale_factor": 0.5, "reduced_motion": "reduce"}

Opener = Callable[..., "Page"]


@contextmanager
def launched() -> Iterator[Browser]:
    """Headless Chromium.

    Raises:
        FileNotFoundError: there is none on this machine.
    """
    from playwright.sync_api import sync_playwright

    names = (os.environ.get("AVATARME_CHROMIUM", ""), *CHROMIUM)
    found = next((path for path in map(shutil.which, names) if path), None)
    with sync_playwright() as session:
        path = found or session.chromium.executable_path
        if not Path(path).exists():
            raise FileNotFoundError("no Chromium here: apt-get install chromium, or name one in AVATARME_CHROMIUM")
        program = session.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield program
        program.close()


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed (make setup)")
    with ExitStack() as stack:
        try:
            program = stack.enter_context(launched())
        except FileNotFoundError as missing:
            pytest.skip(str(missing))
        yield program


@pytest.fixture(scope="session")
def plain_archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archive of the program itself, with the maps that need no networks."""
    target = tmp_path_factory.mktemp("archive") / "plain.zip"
    maps = ("--maps", "texture,confidence,shape_normal")
    command = [sys.executable, "-m", "service", "make", str(PHOTO), "-o", str(target), *maps]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    assert zipfile.is_zipfile(target)
    return target


@pytest.fixture(scope="session")
def archive(plain_archive: Path) -> Path:
    """The same with all maps that there are."""
    target = plain_archive.with_name("full.zip")
    with_reflectance(plain_archive, target)
    return target


@pytest.fixture
def fake(archive: Path) -> Iterator[Fake]:
    with serving(archive) as service:
        yield service


@contextmanager
def opening(browser: Browser) -> Iterator[Opener]:
    """Opens pages; at the end none may have logged an error or broken the content security policy.

    ``expected`` are texts of errors that the test brings about, such as a refused request.
    """
    wrong: list[str] = []
    contexts = []

    def opened(address: str, *, expected: tuple[str, ...] = (), **wishes: Any) -> Page:
        context = browser.new_context(**{**MODEST, **wishes})
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)

        def said(kind: str, text: str) -> None:
            known = (*expected, "GPU stall due to ReadPixels")  # Chromium about screenshots without a graphics card
            if kind in ("error", "warning") and not any(part in text for part in known):
                wrong.append(f"{kind}: {text}")

        page.on("console", lambda message: said(message.type, message.text))
        page.on("pageerror", lambda error: said("error", str(error)))
        page.goto(address)
        return page

    try:
        yield opened
    finally:
        for context in contexts:
            context.close()
    assert not wrong


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Opener]:
    """One page or several for one test; see :func:`opening`."""
    with opening(browser) as opened:
        yield opened
