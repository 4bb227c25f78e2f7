"""``avatarme bench``: accuracy against time on this machine."""

from __future__ import annotations

import json
from pathlib import Path

import typer

from service.bench.variants import FULL, NETWORKS, QUICK, SHIPPED, Family
from service.cli.files import progress_bar
from service.errors import OutputFault, UsageError
from service.runtime.sessions import MODELS, TABLE, model_table

NAME = "accuracy-time"


def bench(*, quick: bool, as_json: bool, output: str | None, networks: str | None) -> None:
    """Measure, then print tables or JSON, or write Markdown and plot into a folder and print the path.

    Args:
        quick: fewer variants, smaller maps.
        as_json: print JSON.
        output: folder for ``accuracy-time.md`` and ``.png``; the text around the marks of an existing file is kept.
        networks: folder of further networks.

    Raises:
        UsageError: a folder has no networks, or the plot cannot be drawn.
        OutputFault: the files cannot be written.
        ModelFault: there are no networks, or they fail.
    """
    families = find_families(None if networks is None else Path(networks))
    target = None if output is None else Path(output)
    if target is not None:
        from service.bench.report import require_matplotlib

        require_matplotlib()
        if not target.is_dir():
            raise UsageError(f"there is no folder {target}; name one for the table and the plot", field="output")
    with progress_bar() as progress:
        from service.bench.run import run_bench as run

        found = run(QUICK if quick else FULL, families, progress=progress)
    if target is not None:
        from service.bench.report import as_markdown, draw, put

        path = target / f"{NAME}.md"
        try:
            text = path.read_text(encoding="utf-8") if path.exists() else "# What accuracy costs in time\n"
            path.write_text(put(text, as_markdown(found)), encoding="utf-8")
            draw(found, target / f"{NAME}.png")
        except OSError as error:
            raise OutputFault(f"{path} cannot be written ({error.strerror})") from error
    if as_json:
        typer.echo(json.dumps(found.to_json(), allow_nan=False, default=str))
    elif target is not None:
        typer.echo(str(target / f"{NAME}.md"))
    else:
        from service.bench.report import as_markdown

        typer.echo(as_markdown(found), nl=False)


def find_families(folder: Path | None, shipped: Path = MODELS) -> list[Family]:
    """The shipped networks, then those of ``folder``, which has a models.json or subfolders with one.

    Without shipped networks, those of ``folder`` alone.

    Raises:
        UsageError: ``folder`` has no networks.
        ModelFault: a models.json cannot be read.
    """
    known = {name for names in NETWORKS.values() for name in names}
    families = [_family(SHIPPED, shipped)] if known & set(model_table(shipped)) else []
    if folder is not None:
        places = [folder] if (folder / TABLE).is_file() else sorted(path.parent for path in folder.glob(f"*/{TABLE}"))
        if not places:
            raise UsageError(f"{folder} has no {TABLE}, and neither has any of its subfolders", field="networks")
        families += [_family(place.resolve().name, place) for place in places]
    if not families:
        raise UsageError(
            f"{shipped} lists no network of maps; name a folder that does with --networks", field="networks"
        )
    return families


def _family(name: str, folder: Path) -> Family:
    return Family(name, folder, tuple(model_table(folder)))
