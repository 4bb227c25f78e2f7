"""``avatarme render`` and ``avatarme export``: an archive in; a picture, a film or a kit for a tool out."""

from __future__ import annotations

import io
import time
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any

import typer

from service.cli.files import check_paths, expect_output, progress_bar, tell_result, write_bytes
from service.cli.flags import Flag, Json, parsed, with_flags
from service.errors import UsageError
from service.options import parse_size
from service.photo.limits import PIPE, read_file

if TYPE_CHECKING:
    from service.render.request import RenderRequest


PICTURE = {
    "scene": Flag("Light and camera, docs/render.md. [default: a studio]", metavar="SCENE.json"),
    "size": Flag("WIDTHxHEIGHT in pixels. [default: 768x1024]", parse=parse_size),
    "view": Flag("front, three-quarter, left, right, back, or degrees. [default: the scene's viewpoint]"),
    "background": Flag("Behind the head: black, transparent or environment. [default: black]"),
    "samples": Flag("Samples a pixel and axis, 1 to 3. [default: 2]", int),
    "tolerance": Flag("Mean error in 1/255 that leaving out effects may cost. [default: 1]", float, "N"),
    "turntable": Flag("N pictures around the head, as a film; OUTPUT ends in .gif or .mp4.", int, "N"),
}
"""How a picture is made; all but the last are fields of ``RenderRequest``."""


@with_flags(PICTURE)
def render(
    archive: Annotated[str, typer.Argument(metavar="AVATAR.zip", help="Archive of 'make', or - for a pipe.")],
    output: Annotated[str, typer.Option("-o", "--output", metavar="IMAGE.png", help="PNG to write, or - for a pipe.")],
    as_json: Json = False,
    **flags: Any,
) -> None:
    """Render an avatar under the light of a scene.

    Computes only the effects that the scene calls for, and says on standard error which and why. Exit status: 0 done,
    2 usage (also a scene that is not right), 4 unreadable archive, 1 anything else.
    """
    from service.light.scene import Scene

    begin, wanted = time.perf_counter(), parsed(PICTURE, flags)
    inputs = {"archive": archive} | {name: wanted[name] for name in ("scene",) if name in wanted}
    film = "FILM.gif" if output.lower().endswith(".gif") else "FILM.mp4"
    what, example = ("film", film) if "turntable" in wanted else ("picture", "IMAGE.png")
    check_paths(output, inputs, what=what, example=example, as_json=as_json)
    if "scene" in wanted:
        text = read_file(wanted["scene"], "scene", 1 << 20).decode("utf-8", "replace")
        wanted["scene"] = Scene.from_json(text)
    from service.archive.images import encode_png
    from service.archive.rendering import render_archive
    from service.light.plan import report
    from service.render.request import RenderRequest

    turntable = wanted.pop("turntable", None)
    request = RenderRequest(**wanted)
    expect_output(output)
    if turntable is not None:
        _film(archive, output, request, turntable, begin, as_json=as_json)
        return
    source: Path | IO[bytes] = io.BytesIO(read_file(PIPE, "archive", 2 << 30)) if archive == PIPE else Path(archive)
    picture = render_archive(source, request)
    png = encode_png(picture.pixels, srgb=True)
    write_bytes(output, png)
    typer.echo(report(picture.plan), err=True)
    for code in picture.fallbacks:
        typer.echo(f"avatarme: fallback: {code}", err=True)
    facts = {"image": output, "bytes": len(png), **picture.facts(), "seconds": round(time.perf_counter() - begin, 3)}
    tell_result(output, facts, as_json=as_json)


def _film(archive: str, output: str, request: RenderRequest, count: int, begin: float, *, as_json: bool) -> None:
    """Render a turntable, with a progress bar, and report it."""
    from service.archive.rendering import turntable

    if PIPE in (archive, output):
        raise UsageError("a turntable is made from a file to a file, not through pipes", field="turntable")
    with progress_bar() as progress:
        size = turntable(Path(archive), Path(output), request, count, progress)
    facts = {"film": output, "pictures": count, "bytes": size, "seconds": round(time.perf_counter() - begin, 3)}
    tell_result(output, facts, as_json=as_json)


def export(
    archive: Annotated[str, typer.Argument(metavar="AVATAR.zip", help="Archive of 'make'.")],
    tool: Annotated[str, typer.Option("--for", metavar="TOOL", help="blender, unreal, unity or maya.")],
    output: Annotated[
        str | None, typer.Option("-o", "--output", metavar="DIR", help="Folder. [default: AVATAR-TOOL]")
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a kit for a tool: scene, levels of detail, textures as it wants them.

    docs/blender.md, unreal.md, unity.md and maya.md say how to import it. Exit status: 0 done, 2 usage, 4 unreadable
    archive, 1 anything else.
    """
    from service.kits.export import export_kit

    begin = time.perf_counter()
    source = Path(archive)
    folder = source.with_name(f"{source.stem}-{tool}") if output is None else Path(output)
    kit = export_kit(source, tool, folder)
    if tool == "blender" and kit.scene is None:
        typer.echo("avatarme: Blender is not installed here; run avatar_scene.py in Blender, docs/blender.md", err=True)
    facts = {**kit.facts(), "seconds": round(time.perf_counter() - begin, 3)}
    tell_result(str(kit.folder), facts, as_json=as_json)
