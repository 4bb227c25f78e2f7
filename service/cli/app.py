"""The command ``avatarme``: its commands and options. Each command's module is imported when it runs."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Collection
from typing import Annotated, Any

import typer

from service import __version__
from service.cli.failures import reported
from service.map_registry import MAP_NAMES


def with_options_of(
    command: Callable[..., None], other: Callable[..., None], *, leave_out: Collection[str]
) -> Callable[..., None]:
    """``command`` whose signature has the parameters of ``other`` in place of its ``**`` parameter, for typer.

    Args:
        command: a function whose last parameter is ``**``.
        other: the function whose parameters are to be taken as well.
        leave_out: names of parameters of ``other`` to leave out.
    """
    own = inspect.signature(command, eval_str=True)
    plain = [item for item in own.parameters.values() if item.kind is not inspect.Parameter.VAR_KEYWORD]
    shared = inspect.signature(other, eval_str=True).parameters
    taken = [
        item.replace(kind=inspect.Parameter.KEYWORD_ONLY) for name, item in shared.items() if name not in leave_out
    ]
    command.__signature__ = own.replace(parameters=[*plain, *taken])  # type: ignore[attr-defined]
    return command


app = typer.Typer(
    name="avatarme",
    help="Photos of one face in, a renderable head out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # square brackets in help are literal, and rich need not be imported
)

MAPS_HELP = f"Maps to write, joined by commas: {', '.join(MAP_NAMES)}. [default: all]"

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object for machines.")]
Maps = Annotated[str | None, typer.Option(help=MAPS_HELP)]
Quality = Annotated[str | None, typer.Option(help="draft, standard, high or reference. [default: standard]")]
Size = Annotated[str | None, typer.Option(help="Size of the maps, WIDTHxHEIGHT, 3:2. [default: the quality's]")]
Bits = Annotated[int | None, typer.Option(help="Bits of normal maps, 8 or 16. [default: the quality's]")]
Normals = Annotated[
    str | None, typer.Option(help="Space of specular and diffuse normals: tangent or object. [default: tangent]")
]
Runtime = Annotated[
    str | None,
    typer.Option(help="Of networks: auto, onnxruntime, openvino, cuda, tensorrt or openvino-gpu. [default: auto]"),
]
Detail = Annotated[
    float | None, typer.Option(help="How much detail finer than the photo is made up, 0 to 1. [default: 1]")
]
Seed = Annotated[int | None, typer.Option(help="Seed of every random choice. [default: 0]")]


def main() -> None:
    """Entry point of the console script; always ends in SystemExit with the status of ``service.cli.failures``."""
    # OpenBLAS reads this when numpy loads. The fit's matrices are too small to gain from threads, and OpenBLAS waits
    # for its threads by spinning: a fit of 0.13 s took 9 s while another process used the second core.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    app(prog_name="avatarme")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"avatarme {__version__}")
        raise typer.Exit


@app.callback()
def avatarme(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """One photo of a face in, a renderable head out."""


@app.command()
def make(
    photos: Annotated[
        list[str] | None,
        typer.Argument(metavar="PHOTO...", help="1 to 24 photos of one person: JPEG, PNG, WebP, HEIC; - for a pipe."),
    ] = None,
    video: Annotated[
        str | None, typer.Option(metavar="FILE", help="A video in which the person turns the head: MP4, MOV, WebM.")
    ] = None,
    output: Annotated[
        str | None, typer.Option("-o", "--output", help="Archive to write, or - for a pipe. [default: beside PHOTO]")
    ] = None,
    leave_out: Annotated[
        str | None, typer.Option(metavar="strangers", help="Leave out photos of another person; else they are refused.")
    ] = None,
    maps: Maps = None,
    quality: Quality = None,
    size: Size = None,
    texture_size: Annotated[
        str | None,
        typer.Option(metavar="auto|WIDTHxHEIGHT", help="Size of the texture map, 3:2. [default: what the photo holds]"),
    ] = None,
    budget: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Take the best quality that fits into so many seconds.")
    ] = None,
    bits: Bits = None,
    normals: Normals = None,
    runtime: Runtime = None,
    face: Annotated[
        str | None, typer.Option(help="Which face to take where there are several: an index, or 'largest'.")
    ] = None,
    detail: Detail = None,
    seed: Seed = None,
    fit: Annotated[str | None, typer.Option(help="Where the fit stops: 'landmarks', 'dense' or 'full'.")] = None,
    identity_components: Annotated[int | None, typer.Option(help="Identity components to fit.")] = None,
    iterations: Annotated[int | None, typer.Option(help="Steps of the landmark fit.")] = None,
    hair: Annotated[
        str | None,
        typer.Option(metavar="auto|none|NAME|FILE", help="As the photo shows, none, a style (bob ...), a JSON file."),
    ] = None,
    hair_colour: Annotated[
        str | None, typer.Option(metavar="auto|NAME|#rrggbb", help="Of the hair: the photo's, blond ..., or sRGB.")
    ] = None,
    hair_length: Annotated[
        str | None, typer.Option(metavar="auto|MM", help="Length of the longest strands in millimetres.")
    ] = None,
    eye_colour: Annotated[
        str | None, typer.Option(metavar="auto|NAME", help="Of the irises: the photo's, or brown, blue ...")
    ] = None,
    mouth: Annotated[
        str | None, typer.Option(metavar="auto|shut", help="As in the photo, or shut where it came out open.")
    ] = None,
    without: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="For experts: corrections not to make; docs/corrections.md.")
    ] = None,
    head: Annotated[
        str | None, typer.Option(metavar="FILE", help="Head model to fit instead of the one in the box.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Make an avatar from photos of one person, in any order.

    Prints the path of the archive. Exit status: 0 done, 2 usage, 3 no usable face, 4 unreadable input, 1 anything else.
    """
    with reported(as_json=as_json):
        from service.cli.make_and_maps import asked
        from service.cli.make_and_maps import make as run
        from service.options import Options

        given = asked(
            leave_out=leave_out,
            maps=maps,
            quality=quality,
            size=size,
            texture_size=texture_size,
            budget=budget,
            bits=bits,
            normals=normals,
            runtime=runtime,
            face=face,
            detail=detail,
            seed=seed,
            fit=fit,
            identity_components=identity_components,
            iterations=iterations,
            hair=hair,
            hair_colour=hair_colour,
            hair_length=hair_length,
            eye_colour=eye_colour,
            mouth=mouth,
            without=without,
        )
        run(photos or (), output, Options(**given), video=video, head=head, as_json=as_json)


def batch(
    folder: Annotated[str, typer.Argument(metavar="IN", help="Folder with photos, in folders of its own too, or s3://")],
    out: Annotated[str, typer.Argument(metavar="OUT", help="Folder or s3:// for archives and report.jsonl.")],
    server: Annotated[
        str | None,
        typer.Option(
            metavar="URL", envvar="AVATARME_SERVER", help="Server that makes them; its key: AVATARME_API_KEY."
        ),
    ] = None,
    database: Annotated[
        str, typer.Option(metavar="URL", help="Postgres of workers on other machines that make them.")
    ] = "",
    jobs: Annotated[
        int | None, typer.Option(help="Photos at the same time. [default: 4, here one for two processors]")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the report in OUT.")] = False,
    watch: Annotated[bool, typer.Option("--watch", help="Look for new photos until Ctrl-C.")] = False,
    group_by: Annotated[
        str | None,
        typer.Option(metavar="folder|prefix", help="One avatar of the photos in a folder, or of ada-1, ada-2 ..."),
    ] = None,
    shard: Annotated[
        str | None, typer.Option(metavar="K/N", help="Only the K-th of N parts, for array jobs; then --resume merges.")
    ] = None,
    timeout: Annotated[float, typer.Option(metavar="SECONDS", help="Longest time of one photo.")] = 1800.0,
    keep: Annotated[bool, typer.Option("--keep", help="Leave archives on the server until they expire.")] = False,
    as_json: Json = False,
    **options_of_make: Any,
) -> None:
    """Make avatars of all photos in a folder or a store.

    Takes the options of 'make' too. Prints the path of the report, which has one JSON object for each photo. Exit
    status: 0 every photo has an archive, 1 some have not, 2 usage, 130 interrupted (go on with --resume).
    """
    with reported(as_json=as_json):
        from service.cli.batch import batch as run
        from service.cli.batch import grouped_source
        from service.cli.make_and_maps import as_json as json_values
        from service.cli.make_and_maps import asked

        head = options_of_make.pop("head")
        run(
            grouped_source(folder, group_by), out, json_values(asked(**options_of_make)), jobs=jobs, shard=shard,
            head=head, as_json=as_json, server=server, database=database, resume=resume, watch=watch,
            timeout_s=timeout, keep=keep,
        )  # fmt: skip


app.command()(with_options_of(batch, make, leave_out={"photos", "video", "output", "as_json"}))


@app.command()
def maps(
    texture: Annotated[str, typer.Option(metavar="T.png", help="Texture on the head's chart, 3:2, or - for a pipe.")],
    mesh: Annotated[
        str, typer.Option(metavar="HEAD.obj", help="Mesh (OBJ, GLB, PLY ...) with the topology of mesh/head.obj, or -.")
    ],
    output: Annotated[str, typer.Option("-o", "--output", metavar="OUT.zip", help="Archive to write, or -.")],
    maps: Maps = None,
    quality: Quality = None,
    size: Size = None,
    bits: Bits = None,
    normals: Normals = None,
    runtime: Runtime = None,
    detail: Detail = None,
    seed: Seed = None,
    head: Annotated[
        str | None, typer.Option(metavar="FILE", help="Head model of the mesh instead of the one in the box.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Make reflectance maps for an external mesh and texture, without a photo.

    Exit status: 0 done, 2 usage, 4 texture or mesh cannot be used, 1 anything else.
    """
    with reported(as_json=as_json):
        from service.cli.make_and_maps import asked
        from service.cli.make_and_maps import maps as run

        given = asked(
            maps=maps,
            quality=quality,
            size=size,
            bits=bits,
            normals=normals,
            runtime=runtime,
            detail=detail,
            seed=seed,
        )
        run(texture, mesh, output, given, head=head, as_json=as_json)


@app.command()
def render(
    archive: Annotated[str, typer.Argument(metavar="AVATAR.zip", help="Archive of 'make', or - for a pipe.")],
    output: Annotated[str, typer.Option("-o", "--output", metavar="IMAGE.png", help="PNG to write, or - for a pipe.")],
    scene: Annotated[
        str | None, typer.Option(metavar="SCENE.json", help="Light and camera, docs/render.md. [default: a studio]")
    ] = None,
    size: Annotated[str | None, typer.Option(help="WIDTHxHEIGHT in pixels. [default: 768x1024]")] = None,
    view: Annotated[
        str | None,
        typer.Option(help="front, three-quarter, left, right, back, or degrees. [default: the scene's viewpoint]"),
    ] = None,
    background: Annotated[
        str | None, typer.Option(help="Behind the head: black, transparent or environment. [default: black]")
    ] = None,
    samples: Annotated[int | None, typer.Option(help="Samples a pixel and axis, 1 to 3. [default: 2]")] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(metavar="N", help="Mean error in 1/255 that leaving out effects may cost. [default: 1]"),
    ] = None,
    turntable: Annotated[
        int | None,
        typer.Option(metavar="N", help="N pictures around the head, as a film; OUTPUT ends in .gif or .mp4."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Render an avatar under the light of a scene.

    Computes only the effects that the scene calls for, and says on standard error which and why. Exit status: 0 done,
    2 usage (also a scene that is not right), 4 unreadable archive, 1 anything else.
    """
    with reported(as_json=as_json):
        from service.cli.render_and_export import render as run
        from service.options import parse_size

        run(
            archive,
            output,
            scene=scene,
            size=None if size is None else parse_size(size),
            view=view,
            background=background,
            samples=samples,
            tolerance=tolerance,
            turntable=turntable,
            as_json=as_json,
        )


@app.command()
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
    with reported(as_json=as_json):
        from service.cli.render_and_export import export as run

        run(archive, tool, output, as_json=as_json)


@app.command()
def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on. [default: 127.0.0.1]")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on. [default: 8000]")] = None,
    data: Annotated[
        str | None, typer.Option(metavar="DIR", help="Folder of jobs and results. [default: avatarme-data]")
    ] = None,
    jobs: Annotated[int | None, typer.Option(help="Photos computed at the same time. [default: 1]")] = None,
    database: Annotated[
        str | None, typer.Option(metavar="URL", help="Postgres that several machines share. [default: SQLite in DIR]")
    ] = None,
    artifacts: Annotated[
        str | None, typer.Option(metavar="URL", help="Store that several machines share. [default: files in DIR]")
    ] = None,
    keys: Annotated[str | None, typer.Option(metavar="FILE", help="File of API keys. [default: none needed]")] = None,
    anybody: Annotated[
        bool | None, typer.Option("--anybody", help="Serve others than this machine without keys.")
    ] = None,
    worker: Annotated[bool, typer.Option(help="Run a worker beside the server.")] = True,
) -> None:
    """Take photos over HTTP.

    Every setting can also come from the environment: AVATARME_PORT, AVATARME_RESULT_HOURS ...; docs/service.md has all.
    """
    with reported(as_json=False):
        from service.cli.serve_and_worker import serve as run

        flags = {"host": host, "port": port, "data": data, "jobs": jobs, "anybody": anybody}
        run(flags | {"database": database, "artifacts": artifacts, "keys": keys}, with_worker=worker)


@app.command()
def worker(
    name: Annotated[str | None, typer.Option(help="Name of this worker, unlike all others and lasting.")] = None,
    data: Annotated[str | None, typer.Option(metavar="DIR", help="Folder for work. [default: avatarme-data]")] = None,
    jobs: Annotated[int | None, typer.Option(help="Photos computed at the same time. [default: 1]")] = None,
    batches: Annotated[int | None, typer.Option(help="Photos of batches computed beside them. [default: 0]")] = None,
    database: Annotated[str | None, typer.Option(metavar="URL", help="Postgres that all machines share.")] = None,
    artifacts: Annotated[str | None, typer.Option(metavar="URL", help="Store that all machines share.")] = None,
) -> None:
    """Compute jobs that a server elsewhere takes, and shards of batches."""
    with reported(as_json=False):
        from service.cli.serve_and_worker import work as run

        flags = {"worker": name, "data": data, "jobs": jobs, "batches": batches}
        run(flags | {"database": database, "artifacts": artifacts})


@app.command()
def bench(
    quick: Annotated[bool, typer.Option("--quick", help="Three small runs: a minute at most.")] = False,
    output: Annotated[
        str | None, typer.Option("-o", "--output", metavar="DIR", help="Folder for accuracy-time.md and its plot.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Measure what accuracy costs in time, on this machine.

    Makes the sample's avatar at every quality, on every runtime and at several sizes, and prints time, memory and the
    loss of its maps as a Markdown table. Takes about five minutes on two cores; let nothing else run meanwhile.
    """
    with reported(as_json=as_json):
        from service.cli.bench import bench as run

        run(quick=quick, as_json=as_json, output=output)


@app.command()
def doctor(as_json: Json = False) -> None:
    """Check this installation, and try it out.

    Prints versions, processor, memory, data files against their checksums, and a trial run on the sample photo.
    Exit status: 0 all is well, 1 something is not.
    """
    with reported(as_json=as_json):
        from service.cli.doctor import doctor as run

        run(as_json=as_json)
