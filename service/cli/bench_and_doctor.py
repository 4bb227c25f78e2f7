"""``avatarme bench`` and ``avatarme doctor``: what this machine can do, and whether all is well."""

from __future__ import annotations

import io
import json
import platform
import time
from typing import Annotated, Any

import typer

from service import __version__, diagnosis
from service.cli.files import progress_bar
from service.cli.flags import Json
from service.errors import AvatarError
from service.options import Options


def bench(
    quick: Annotated[bool, typer.Option("--quick", help="Three small runs: a minute at most.")] = False,
    as_json: Json = False,
) -> None:
    """Measure what accuracy costs in time, on this machine.

    Makes the sample's avatar at every quality, on every runtime and at several sizes, and prints time, memory and the
    loss of its maps as a Markdown table. Takes about five minutes on two cores; let nothing else run meanwhile.
    """
    from service.bench.report import as_markdown
    from service.bench.runs import run_bench, runs

    with progress_bar() as progress:
        found = run_bench(runs(quick=quick), progress=progress)
    text = json.dumps(found.to_json(), allow_nan=False, default=str) if as_json else as_markdown(found)
    typer.echo(text, nl=as_json)


def doctor(as_json: Json = False) -> None:
    """Check this installation, and try it out.

    Prints versions, processor, memory, data files against their checksums, and a trial run on the sample photo.
    Exit status: 0 all is well, 1 something is not.
    """
    findings = examine()
    typer.echo(json.dumps(findings) if as_json else as_text(findings))
    if findings["faults"]:
        raise typer.Exit(1)


def examine() -> dict[str, Any]:
    """Facts of the machine and the installation, and ``faults``, one sentence each."""
    libraries = diagnosis.library_versions()
    faults = [f"{name} is not installed" for name in diagnosis.REQUIRED if libraries[name] is None]
    files: list[str] = []
    try:
        files = list(diagnosis.shipped_files())
        faults += diagnosis.data_faults()
    except AvatarError as error:
        faults.append(error.message)
    trial, trouble = self_test()
    from service.runtime import compiled_networks

    count, size = compiled_networks.kept()
    place = compiled_networks.folder()
    compiled = {"folder": None if place is None else str(place), "files": count, "megabytes": round(size, 1)}
    return {
        "avatarme": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": diagnosis.cpu(),
        "memory_mb": diagnosis.memory_mb(),
        "libraries": libraries,
        "runtimes": diagnosis.runtimes(),
        "data_files": files,
        "compiled_networks": compiled,
        "self_test": trial,
        "faults": faults + trouble,
    }


def self_test() -> tuple[dict[str, Any], list[str]]:
    """Run the pipeline on the sample photo, imports included; gives facts (``seconds``, ``archive_bytes``,
    ``landmark_rms_px``, ``warnings``; empty if it failed), and the faults.
    """
    begin = time.perf_counter()
    try:
        from service.archive.pack import write_archive
        from service.pipeline import make_avatar

        stream = io.BytesIO()
        avatar = make_avatar(diagnosis.SAMPLE.read_bytes(), Options(quality="draft", size=(384, 256)))
        write_archive(avatar, stream)
    except Exception as error:  # the doctor reports every fault, bugs included
        return {}, [f"self-test failed: {type(error).__name__}: {error}"]
    return {
        "seconds": round(time.perf_counter() - begin, 3),
        "archive_bytes": stream.tell(),
        "landmark_rms_px": avatar.fit.landmark_rms_px,
        "warnings": list(avatar.all_warnings()),
    }, []


def as_text(findings: dict[str, Any]) -> str:
    """The findings as text, one line each, faults last."""
    cpu, memory, trial = findings["cpu"], findings["memory_mb"], findings["self_test"]
    cache = findings["compiled_networks"]
    versions = ", ".join(f"{name} {version or 'not installed'}" for name, version in findings["libraries"].items())
    lines = [
        f"avatarme   {findings['avatarme']}, Python {findings['python']}, {findings['platform']}",
        f"processor  {cpu['model']}, {cpu['cores']} cores, {' '.join(cpu['features']) or 'no vector features known'}",
        f"memory     {_mb(memory['total'])} MiB, {_mb(memory['available'])} available",
        f"libraries  {versions}",
        f"runtimes   {', '.join(findings['runtimes']) or 'none'}",
        f"data       {len(findings['data_files'])} files listed",
        f"compiled   {cache['files']} networks, {cache['megabytes']} MB in {cache['folder'] or 'no folder'}",
    ]
    if trial:
        lines.append(
            f"self-test  {trial['seconds']:.2f} s, {trial['archive_bytes']} bytes, "
            f"landmarks {trial['landmark_rms_px']:.2f} px, warnings: {', '.join(trial['warnings']) or 'none'}"
        )
    lines += [f"FAULT      {fault}" for fault in findings["faults"]] or ["all is well"]
    return "\n".join(lines)


def _mb(value: int | None) -> str:
    return "unknown" if value is None else str(value)
