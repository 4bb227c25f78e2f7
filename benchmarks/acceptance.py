"""Every photo of a folder through every door: ``python -m benchmarks.acceptance FOLDER [--out out/acceptance.html]``.

Each photo goes through the command and through a server of its own by HTTP, whose archives have to be the same bytes;
the page is opened on the server's result, and its picture taken. One HTML file shows, failures first: the photo, the
head from three sides, the head under another light, the page's picture, and what was warned of.

A photo that the program refuses for a reason that lies in the photo (no face, several of them, too small a face) is
no failure where both doors say the same.
"""

from __future__ import annotations

import argparse
import base64
import html
import io
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
from PIL import Image

from service.archive.rendering import render_archive
from service.batch.plan import SUFFIXES
from service.light.scene import Environment, PointLight, Scene
from service.render.request import RenderRequest
from tests.support.browser import launched, settle
from tests.support.server import Server, wait_for

if TYPE_CHECKING:
    from playwright.sync_api import Browser

VIEWS = ("front", "three-quarter", "left")
EVENING = Scene(Environment(name="studio", strength=0.15), lights=(PointLight((0.7, 0.25, 0.5), (1.6, 1.0, 0.5)),))
"""A warm lamp from the subject's left in a dim room."""
SIDE = (270, 340)
"""Width and height of the pictures of a row, in pixels."""

STYLE = """
body { font: 15px/1.4 system-ui, sans-serif; margin: 2rem; background: #f4f5f5 }
article { background: #fff; border: 1px solid #d8dcdc; border-radius: 8px; padding: 1rem; margin: 1rem 0 }
article.failed { border: 3px solid #b3261e } h2 { margin: 0 0 .3rem; font-size: 1.1rem }
div { display: flex; flex-wrap: wrap; gap: 6px } figure { margin: 0 } figcaption { font-size: 12px; color: #555 }
img { display: block; border-radius: 4px }
"""


@dataclass
class Row:
    """What became of one photo.

    Attributes:
        photo: its path.
        failures: what is wrong, in words.
        refused: why the program refuses the photo; "" where it does not.
        facts: what was measured and warned of, in words.
        pictures: (caption, JPEG) in their order.
    """

    photo: Path
    failures: list[str] = field(default_factory=list)
    refused: str = ""
    facts: str = ""
    pictures: list[tuple[str, bytes]] = field(default_factory=list)

    def show(self, caption: str, picture: Image.Image) -> None:
        """Add a picture."""
        small = picture.convert("RGB")
        small.thumbnail(SIDE)
        stream = io.BytesIO()
        small.save(stream, "JPEG", quality=85)
        self.pictures.append((caption, stream.getvalue()))

    def markup(self) -> str:
        """The row as HTML."""
        pictures = "".join(
            f'<figure><img src="data:image/jpeg;base64,{base64.b64encode(data).decode()}" alt="">'
            f"<figcaption>{html.escape(caption)}</figcaption></figure>"
            for caption, data in self.pictures
        )
        wrong = "".join(f"<p><b>{html.escape(failure)}</b></p>" for failure in self.failures)
        state = "failed" if self.failures else "refused" if self.refused else "good"
        facts = html.escape(self.refused or self.facts)
        return (
            f'<article class="{state}"><h2>{html.escape(self.photo.name)}: {state}</h2>{wrong}<p>{facts}</p>'
            f"<div>{pictures}</div></article>"
        )


def by_command(photo: Path, target: Path, options: dict[str, Any]) -> str:
    """Make the archive; returns the code of the error, "" without one."""
    flags = [flag for name, value in options.items() for flag in (f"--{name}", _flag(value))]
    command = [sys.executable, "-m", "service", "make", str(photo), "-o", str(target), "--json", *flags]
    done = subprocess.run(command, capture_output=True, check=False)
    try:
        said = json.loads(done.stdout)
    except ValueError:
        return f"exit status {done.returncode}: {done.stderr.decode()[-200:]}"
    return str(said["error"]["code"]) if "error" in said else ""


def _flag(value: object) -> str:
    return "x".join(map(str, value)) if isinstance(value, list) else str(value)


def by_http(client: httpx.Client, photo: Path, options: dict[str, Any]) -> tuple[str, str]:
    """Hand the photo in and wait; returns the job and the code of the error, "" without one."""
    files: Any = {"image": (photo.name, photo.read_bytes()), "options": (None, json.dumps(options), "application/json")}
    answer = client.post("/v1/avatars", files=files)
    if answer.status_code != 202:
        return "", str(answer.json().get("code", answer.status_code))
    job = str(answer.json()["id"])
    state = wait_for(client, job, within=1800)
    return job, "" if state["state"] == "succeeded" else str((state["error"] or {}).get("code", state["state"]))


def page_of(browser: Browser, address: str) -> tuple[Image.Image, list[str]]:
    """What the page shows of a job, and what it complains of."""
    context = browser.new_context(viewport={"width": 1000, "height": 760}, reduced_motion="reduce")
    wrong: list[str] = []
    try:
        page = context.new_page()
        page.set_default_timeout(180_000)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(address)
        page.wait_for_selector("#canvas[data-shows=lit]")
        settle(page)
        return Image.open(io.BytesIO(page.locator("#view").screenshot())), wrong
    finally:
        context.close()


def look(
    photo: Path, folder: Path, server: Server, client: httpx.Client, browser: Browser | None, options: dict[str, Any]
) -> Row:
    """Put one photo through all doors."""
    row, archive = Row(photo), folder / f"{photo.name}.zip"
    begin = time.monotonic()
    with ThreadPoolExecutor(1) as other:
        posted = other.submit(by_http, client, photo, options)
        said = by_command(photo, archive, options)
        job, answered = posted.result()
    try:
        row.show("photo", Image.open(photo))
    except OSError:
        row.facts = "this program's own reader alone can show the photo"
    if said != answered:
        row.failures.append(f"the command says {said or 'done'}, the service {answered or 'done'}")
    if said or answered:
        row.refused = said or answered
        if row.refused in ("internal", "crashed") or row.refused.startswith("exit"):
            row.failures.append(row.refused)
        return row
    if client.get(f"/v1/avatars/{job}/archive.zip").content != archive.read_bytes():
        row.failures.append("the archives of command and service differ")
    for view in VIEWS:
        row.show(view, _drawn(archive, RenderRequest(size=SIDE, view=view, background="environment")))
    row.show("relit", _drawn(archive, RenderRequest(scene=EVENING, size=SIDE, view="10")))
    if browser is not None:
        picture, wrong = page_of(browser, f"{server.url}/#avatar={job}")
        row.show("the page", picture)
        row.failures += wrong
    manifest = client.get(f"/v1/avatars/{job}/files/manifest.json").json()
    alike = manifest["fit"]["identity_similarity"]
    likeness = "" if alike is None else f", likeness {alike['centred_cosine']:.2f}"
    row.facts = f"{', '.join(manifest['warnings']) or 'no warnings'}{likeness}, {time.monotonic() - begin:.0f} s"
    return row


def _drawn(archive: Path, request: RenderRequest) -> Image.Image:
    return Image.fromarray(render_archive(archive, request).pixels)


def sheet(rows: Sequence[Row]) -> str:
    """The HTML of all rows: failures first, then refusals."""
    ordered = sorted(rows, key=lambda row: (not row.failures, not row.refused, row.photo.name))
    failed, refused = sum(bool(row.failures) for row in rows), sum(bool(row.refused) for row in rows)
    title = f"{len(rows)} photos: {failed} failed, {refused} refused"
    body = "\n".join(row.markup() for row in ordered)
    head = f'<!doctype html><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
    return f"{head}<h1>{title}</h1>\n{body}\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run from the command line; exit status 1 where a photo failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--out", type=Path, default=Path("out/acceptance.html"))
    parser.add_argument("--quality", default="draft")
    parser.add_argument("--size", help="WIDTHxHEIGHT of the maps")
    asked = parser.parse_args(arguments)
    photos = sorted(path for path in asked.photos.rglob("*") if path.suffix.lower() in SUFFIXES)
    if not photos:
        raise SystemExit(f"{asked.photos}: no photos")
    options: dict[str, Any] = {"quality": asked.quality}
    if asked.size:
        options["size"] = [int(side) for side in asked.size.split("x")]
    rows = []
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch, ExitStack() as held:
        folder = Path(scratch)
        try:
            browser = held.enter_context(launched())
        except (ImportError, FileNotFoundError) as missing:
            print(f"without the page's pictures: {missing}")
            browser = None
        server = Server(folder / "data", {"program": "service.jobs.avatar_process"})
        server.start()
        held.callback(server.stop)
        client = held.enter_context(httpx.Client(base_url=server.url, timeout=300))
        for photo in photos:
            rows.append(look(photo, folder, server, client, browser, options))
            print(f"{photo.name}: {', '.join(rows[-1].failures) or rows[-1].refused or rows[-1].facts}", flush=True)
            (folder / f"{photo.name}.zip").unlink(missing_ok=True)
            asked.out.write_text(sheet(rows), encoding="utf-8")  # a run that is cut off leaves what it saw
    print(asked.out)
    raise SystemExit(1 if any(row.failures for row in rows) else 0)


if __name__ == "__main__":
    main()
