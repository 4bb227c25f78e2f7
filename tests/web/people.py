"""Portraits of synthetic people with a wide smile and with an open mouth: ``python -m tests.web.people``.

A head is made of a portrait in ``tests/data/people`` at high quality, opened in the page's own viewer, given the
expression by its sliders and drawn; the pictures go beside the portrait.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from tests.support.browser import ROOT, launched, make_head, set_light, set_slider, settle, shapes
from tests.web.fake_service import serving

PEOPLE = ROOT / "tests" / "data" / "people"
SIDE = 640
"""Width and height in pixels."""

SMILE = {
    "mouthSmileLeft": 1.0, "mouthSmileRight": 0.9, "cheekSquintLeft": 0.9, "cheekSquintRight": 0.8,
    "mouthUpperUpLeft": 0.5, "mouthUpperUpRight": 0.5, "eyeSquintLeft": 0.4, "eyeSquintRight": 0.4,
}  # fmt: skip
SPEECH = {"jawOpen": 0.75, "mouthLowerDownLeft": 0.3, "mouthLowerDownRight": 0.3, "browInnerUp": 0.4}

CASES: dict[str, tuple[Path, dict[str, float], tuple[int, int]]] = {
    "wide_smile": (ROOT / "service" / "data" / "sample" / "astronaut.png", SMILE, (45, 25)),
    "mouth_open": (PEOPLE / "open.jpg", SPEECH, (-25, 30)),
}
"""Portrait, weights of the blendshapes, and where the light stands, degrees to the right of the camera and up."""


def draw(source: Path, weights: dict[str, float], light: tuple[int, int]) -> Image.Image:
    """(SIDE, SIDE) picture of the head of a portrait with an expression."""
    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "head.zip"
        command = [sys.executable, "-m", "service", "make", str(source), "-o", str(archive), "--size", "3072x2048"]
        subprocess.run(command, cwd=ROOT, check=True)
        with launched() as browser, serving(archive, step_s=0.05) as fake:
            page = browser.new_page(viewport={"width": 1200, "height": 900}, reduced_motion="reduce", bypass_csp=True)
            page.set_default_timeout(300_000)
            page.goto(fake.address)
            make_head(page)
            page.add_style_tag(
                content=f"#view {{ width: {SIDE}px !important; height: {SIDE}px !important; border: 0 }}"
                "#canvas { background: linear-gradient(#8fa3ad, #59666e); border-radius: 0; outline: 0 !important }"
                "#reset-view, #inset { display: none !important }"
            )
            page.check("input[name=preset][value=neutral]", force=True)
            shapes(page)
            for name, value in weights.items():
                set_slider(page, f"shape-{name}", value)
            set_light(page, *light)
            settle(page)
            return Image.open(io.BytesIO(page.locator("#canvas").screenshot())).convert("RGB")


def main() -> None:
    """Write all cases."""
    for name, case in CASES.items():
        draw(*case).save(PEOPLE / f"{name}.jpg", quality=92)


if __name__ == "__main__":
    main()
