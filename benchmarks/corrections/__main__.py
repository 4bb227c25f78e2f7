"""What each correction is worth: ``python -m benchmarks.corrections --data DIR [-o docs/corrections.md]``.

Takes each rule that alters what the networks gave out of ``make_avatar``, and all together, and tells what is lost on
rendered photos of known albedo, and how much of real photos changes. DIR holds ``ict_facekit_head.npz``,
``ffhq_uv_head/``, ``hifi3d_uv/`` and ``lee_perry_smith/``; what is rendered of them is kept in ``--cache``.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.corrections.photos import names, photos
from benchmarks.corrections.rules import SIZE, Product, Rules
from benchmarks.corrections.score import Judge
from benchmarks.corrections.table import page
from benchmarks.corrections.trial import Verdicts, tried
from benchmarks.shoot import data_folder
from service.errors import AvatarError

CACHE = Path.home() / ".cache" / "avatarme-bench"
ENDINGS = (".jpg", ".jpeg", ".png", ".webp")
FEW_REAL = 2
"""Real photos of a trial in a hurry."""


def on_rendered(data: Path, cache: Path, wanted: tuple[str, ...], rules: Rules) -> list[Verdicts]:
    """Verdicts on rendered photos, in order."""
    found = []
    for photo in photos(data, cache, wanted):
        begin = time.perf_counter()
        one = tried(photo.name, photo.groups, photo.data, rules, partial(Judge.of, photo))
        _say(f"{photo.name}: {one.score.best if one.score else 0:.1f} dB, {time.perf_counter() - begin:.0f} s")
        found.append(one)
    return found


def on_real(files: tuple[Path, ...], rules: Rules) -> list[Verdicts]:
    """Verdicts on real photos, without those that have no usable face."""
    found = []
    for file in files:
        begin = time.perf_counter()
        try:
            found.append(tried(file.name, (), file.read_bytes(), rules, None))
            _say(f"{file.name}: {time.perf_counter() - begin:.0f} s")
        except AvatarError as error:
            _say(f"{file.name}: left out, {error}")
    return found


def real_files(folder: Path | None) -> tuple[Path, ...]:
    """Photos of a folder by name; none without a folder.

    Raises:
        SystemExit: the folder has no photo.
    """
    if folder is None:
        return ()
    files = tuple(sorted(file for file in folder.glob("*") if file.suffix.lower() in ENDINGS))
    if not files:
        raise SystemExit(f"{folder} has no file that ends in {', '.join(ENDINGS)}")
    return files


def trial(
    data: Path, cache: Path, files: tuple[Path, ...], rules: Rules, wanted: tuple[str, ...], jobs: int = 1
) -> tuple[list[Verdicts], list[Verdicts]]:
    """Verdicts on the rendered photos of the wanted names, and on real photos."""
    cache.mkdir(parents=True, exist_ok=True)
    if jobs == 1:
        return on_rendered(data, cache, wanted, rules), on_real(files, rules)
    for _ in photos(data, cache, wanted):
        pass  # rendered before processes ask for the same sitting
    with ProcessPoolExecutor(jobs) as pool:
        rendered = [pool.submit(on_rendered, data, cache, (name,), rules) for name in wanted]
        real = [pool.submit(on_real, (file,), rules) for file in files]
        return list(_joined(rendered)), list(_joined(real))


def _joined(futures: list) -> Iterator[Verdicts]:  # type: ignore[type-arg]
    for future in futures:
        yield from future.result()


def _say(text: str) -> None:
    typer.echo(text, err=True)


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Markdown page to write.")] = None,
    photos_folder: Annotated[Path | None, typer.Option("--photos", help="Folder of real photos.")] = None,
    cache: Annotated[Path, typer.Option(help="Folder that keeps what was rendered.")] = CACHE,
    jobs: Annotated[int, typer.Option(min=1, help="Processes; times are fit to be told with 1 only.")] = 1,
    quick: Annotated[bool, typer.Option(help="A few photos.")] = False,
    with_rendered: Annotated[bool, typer.Option("--rendered/--no-rendered", help="Rendered photos too.")] = True,
) -> None:
    """Print the page, and write it."""
    begin = time.perf_counter()
    folder, rules = data_folder(None if data is None else str(data)), Product()
    files = real_files(photos_folder)[: FEW_REAL if quick else None]
    rendered, real = trial(folder, cache, files, rules, names(quick) if with_rendered else (), jobs)
    text = page(rules.registry, rendered, real, SIZE)
    typer.echo(text)
    _say(f"{time.perf_counter() - begin:.0f} s in all")
    if output is not None:
        output.write_text(text, "utf-8")


if __name__ == "__main__":
    typer.run(main)
