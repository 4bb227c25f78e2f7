"""Whether unseen skin joins the seen without a seam: ``python -m benchmarks.unseen_skin PHOTO...``.

An avatar of each photo is made by ``service.pipeline.make_avatar``. Along the border between skin that the photo shows
and skin that it does not, the mean colours of two bands, one on each side, are compared piece by piece of the border:
CIEDE2000, and the distance in hue and chroma alone (a*, b*). Beside it the same for two bands of which both lie on seen
skin next to that border: what skin and the light left in it differ by over such a distance anyway. A seam is what the
first is more than the second.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer

from benchmarks.corrections.score import delta_e
from models.tables import tell
from service.archive.avatar import Avatar
from service.colour import FULL_CODE
from service.errors import AvatarError
from service.geometry.chart import Chart
from service.map_registry import MIRRORED
from service.options import Options
from service.pipeline import make_avatar

Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

MARK = ("<!-- unseen-skin -->", "<!-- /unseen-skin -->")
SIZE = (768, 512)
BAND = 8
"""Width of a band, texels: 5 mm on the face."""
GAP = 2
"""Texels on each side of the border that belong to neither band, where both are blended."""
PIECE = 32
"""Side of the squares of the chart by which the border is cut into pieces."""
FEWEST = 24
"""Fewest texels of each band in a piece."""


@dataclass(frozen=True)
class Steps:
    """Of each piece of a border: (N,) CIEDE2000 and distance in (a*, b*) between its two bands."""

    delta_e: Float
    hue: Float

    @classmethod
    def between(cls, albedo: Float, first: Mask, second: Mask) -> Steps:
        """Of an albedo (h, w, 3), sRGB-coded in [0, 1], and two bands (h, w)."""
        from skimage.color import rgb2lab

        found = []
        height, width = first.shape
        for top in range(0, height, PIECE // 2):  # overlapping, as a border may run along theirs
            for left in range(0, width, PIECE // 2):
                place = (slice(top, top + PIECE), slice(left, left + PIECE))
                if min(first[place].sum(), second[place].sum()) < FEWEST:
                    continue
                one, other = (albedo[place][band[place]].mean(0)[None] for band in (first, second))
                apart = rgb2lab(one[None])[0, 0] - rgb2lab(other[None])[0, 0]
                found.append((delta_e(one, other), float(np.hypot(*apart[1:]))))
        both = np.array(found, np.float64).reshape(-1, 2)
        return cls(both[:, 0], both[:, 1])


def bands(seen: Mask, skin: Mask) -> tuple[Mask, Mask, Mask]:
    """Band of unseen skin along the border, that of seen skin beside it, and the next one on seen skin, (h, w) each."""
    import cv2

    outwards = np.asarray(cv2.distanceTransform((~(seen & skin)).astype(np.uint8), cv2.DIST_L2, 5))
    inwards = np.asarray(cv2.distanceTransform((~(skin & ~seen)).astype(np.uint8), cv2.DIST_L2, 5))
    unseen = skin & ~seen & (outwards > GAP) & (outwards <= GAP + BAND)
    beside = skin & seen & (inwards > GAP) & (inwards <= GAP + BAND)
    further = skin & seen & (inwards > 2 * GAP + BAND) & (inwards <= 2 * (GAP + BAND))
    return unseen, beside, further


def steps_of(avatar: Avatar) -> tuple[Steps, Steps]:
    """Across the border, and beside it.

    Raises:
        ValueError: the albedo was not made.
    """
    import cv2

    made = avatar.reflectance
    if made is None or made.diffuse_albedo is None:
        raise ValueError("an avatar of this benchmark has to have the diffuse albedo")
    albedo = made.diffuse_albedo.astype(np.float64) / FULL_CODE
    height, width = albedo.shape[:2]
    size = (width, height)
    seen = cv2.resize(avatar.texture.confidence, size, interpolation=cv2.INTER_NEAREST) >= MIRRORED
    head = avatar.head
    hairless = 1 - np.clip(head.region("scalp"), 0, 1) if "scalp" in head.region_names else np.ones(len(head.mean))
    chart = Chart.build(head, width, height)
    skin = (chart.part == head.part_names.index("skin")) & (chart.interpolate(hairless[:, None])[..., 0] > 0.9)
    unseen, beside, further = bands(np.asarray(seen), skin)
    return Steps.between(albedo, unseen, beside), Steps.between(albedo, beside, further)


def row(name: str, across: Steps, control: Steps) -> str:
    """A line of the table."""
    if not len(across.delta_e) or not len(control.delta_e):
        return f"| {name} | 0 | - | - | - | - | - |"
    told = [float(np.median(values)) for values in (across.delta_e, control.delta_e, across.hue, control.hue)]
    told.append(float(np.quantile(across.delta_e, 0.9)))
    return f"| {name} | {len(across.delta_e)} | " + " | ".join(f"{value:.1f}" for value in told) + " |"


def main(
    photos: Annotated[list[Path], typer.Argument(help="Photos, or folders of them.")],
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the table into.")] = None,
) -> None:
    """Print the table."""
    files = sorted(file for one in photos for file in (one.iterdir() if one.is_dir() else [one]))
    options = Options(maps=("diffuse_albedo",), quality="draft", size=SIZE, face="largest")
    lines = ["| photo | pieces | step, Delta E | beside it | step in a*, b* | beside it | nine in ten below, Delta E |"]
    lines.append("|---" * 7 + "|")
    every: list[tuple[Steps, Steps]] = []
    for file in files:
        try:
            every.append(steps_of(make_avatar(file.read_bytes(), options)))
        except AvatarError as error:
            typer.echo(f"{file.name}: left out, {error}", err=True)
            continue
        lines.append(row(file.name, *every[-1]))
        typer.echo(lines[-1], err=True)
    if not every:
        raise SystemExit("no photo has a usable face")
    joined = [
        Steps(*(np.concatenate([getattr(pair[k], name) for pair in every]) for name in ("delta_e", "hue")))
        for k in (0, 1)
    ]
    lines.append(row(f"**all** ({len(every)})", *joined))
    tell("\n".join(lines), MARK, write)


if __name__ == "__main__":
    typer.run(main)
