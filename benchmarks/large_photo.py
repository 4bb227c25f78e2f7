"""What a photo of many megapixels costs more than a small one: ``python -m benchmarks.large_photo``.

The sample's face is enlarged until the picture has so many megapixels, and coded as JPEG; each makes an avatar in a
process of its own. Time is the processor's, of all threads and of the decoding process, so that other work on the
machine hardly counts; memory is the peak of the process, beside that of the decoder.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer

from models.tables import tell
from service.diagnosis import SAMPLE, peak_rss_mb
from service.options import Options, parse_maps
from service.pipeline import make_avatar

MARK = ("<!-- large-photo -->", "<!-- /large-photo -->")
QUALITY = 90
"""Of the JPEG: 48 megapixels stay below the gate's 25 MB."""
NOISE = 2.0
"""Standard deviation of grain, 255 = white, so that the file is no smaller than a camera's."""
WATCHED = ("decode", "detect", "fit", "texture", "own_texture", "super_resolution", "diffuse_albedo")


def photo_of(megapixels: float, image: np.ndarray) -> bytes:
    """A JPEG of so many pixels, the same picture at any size."""
    scale = float(np.sqrt(1e6 * megapixels / (image.shape[0] * image.shape[1])))
    large = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    random = np.random.default_rng(1)
    for row in large:  # one at a time: all of it would take gigabytes
        row[:] = np.clip(row + NOISE * random.standard_normal(row.shape, np.float32), 0, 255)
    return cv2.imencode(".jpg", large, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()


@dataclass(frozen=True)
class Cost:
    """Of one avatar: processor seconds, seconds by stage, MB of the process and of its decoder."""

    cpu_s: float
    stages: dict[str, float]
    peak_mb: float
    decoder_mb: float


def cost(file: Path, options: Options) -> Cost:
    """Make an avatar in this process and say what it took."""
    begin = time.process_time()
    made = make_avatar(file.read_bytes(), options)
    decoder = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = time.process_time() - begin + decoder.ru_utime + decoder.ru_stime
    return Cost(cpu, dict(made.timings_s), peak_rss_mb(), decoder.ru_maxrss / 1024)


def apart(file: Path, quality: str, maps: str) -> Cost:
    """:func:`cost` in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.large_photo", "--file", str(file), "--quality", quality]
    command += ["--maps", maps] if maps else []
    return Cost(**json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout))


def table(found: dict[float, Cost]) -> str:
    """Markdown; seconds by stage are of the wall clock."""
    stages = [name for name in WATCHED if any(name in one.stages for one in found.values())]
    titles = ["megapixels", "processor s", "peak MB", "decoder MB", *stages]
    lines = [f"| {' | '.join(titles)} |", "|---" * (4 + len(stages)) + "|"]
    for size, one in found.items():
        spent = " | ".join(f"{one.stages.get(name, 0.0):.1f}" for name in stages)
        lines.append(f"| {size:g} | {one.cpu_s:.1f} | {one.peak_mb:.0f} | {one.decoder_mb:.0f} | {spent} |")
    return "\n".join(lines)


def main(
    megapixels: Annotated[str, typer.Option(help="Sizes, with commas between.")] = "1,48",
    quality: Annotated[str, typer.Option(help="draft, standard, high or reference.")] = "standard",
    maps: Annotated[str, typer.Option(help="Maps to make, with commas between; '' for all.")] = "",
    photo: Annotated[Path, typer.Option(help="Picture that is enlarged.")] = SAMPLE,
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the table into.")] = None,
    file: Annotated[Path | None, typer.Option(hidden=True)] = None,
) -> None:
    """Print the table."""
    if file is not None:
        some: dict[str, Any] = {"maps": parse_maps(maps)} if maps else {}
        typer.echo(json.dumps(vars(cost(file, Options(quality=quality, face="largest", **some)))))  # type: ignore[arg-type]
        return
    image = cv2.imread(str(photo), cv2.IMREAD_COLOR)
    if image is None:
        raise typer.BadParameter(f"{photo} is no picture that can be read")
    found = {}
    with tempfile.TemporaryDirectory() as scratch:
        for size in (float(one) for one in megapixels.split(",")):
            target = Path(scratch) / f"{size:g}.jpg"
            target.write_bytes(photo_of(size, image))
            found[size] = apart(target, quality, maps)
    tell(table(found), MARK, write)


if __name__ == "__main__":
    typer.run(main)
