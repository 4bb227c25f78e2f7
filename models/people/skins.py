"""Skins of the light stage at a size for portraits, drawn once and kept in a folder.

A synthesis takes about ten seconds of a core, a portrait a third of one; so portraits share ``COUNT`` skins, and vary
them (``models.people.person``). A skin is made when it is first asked for.
"""

from __future__ import annotations

import dataclasses
import functools
import os
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from torch import Tensor

    from models.lightstage.stage import Stage

Bytes = npt.NDArray[np.uint8]

COUNT = 40
"""Skins in all; their tones are spread evenly over the typology angles of the light stage."""
WIDTH, HEIGHT = 1056, 704
"""Texels of the chart: two and a half per mm on the face."""
FIRST = 500_000
"""Subject of the light stage that skin 0 looks for its tone from; training and tests of the networks use lower ones."""
BEARDS = 4
"""Strand pictures for beards: shadow, stubble of 1.5 mm, 4 mm and 8 mm."""
BARE_BROWS = 6
"""Hairs in the brows of every fourth skin; these get brows of the wardrobe."""
LAYERS = ("lips", "brow", "stubble", "scalp")


@dataclass(frozen=True)
class Skin:
    """One skin in the chart.

    Attributes:
        albedo: (704, 1056, 3) uint8 sRGB.
        layers: (704, 1056, 4) uint8 cover by ``LAYERS``.
        hair: (3,) float64 linear RGB of its hair.
        grey: share of grey hair.
        roughness: (3,) GGX alpha of the narrow and broad lobe and the share of the narrow one.
        angle_deg: individual typology angle of its tone.
        male: whether the subject was drawn as a man.
    """

    albedo: Bytes
    layers: Bytes
    hair: npt.NDArray[np.float64]
    grey: float
    roughness: npt.NDArray[np.float64]
    angle_deg: float
    male: bool


def default_folder() -> Path:
    """Where skins are kept: ``$AVATARME_PEOPLE`` or ``out/people`` in the working directory."""
    return Path(os.environ.get("AVATARME_PEOPLE", "out/people"))


@functools.lru_cache(maxsize=COUNT)
def load_skin(number: int, folder: Path) -> Skin:
    """Skin ``number`` < COUNT, drawn and stored first if need be (about ten seconds of a core; needs torch)."""
    path = folder / f"skin-{number:02d}.npz"
    if not path.is_file():
        _store(path, _draw(number))
    with np.load(path, allow_pickle=False) as a:
        return Skin(
            a["albedo"],
            a["layers"],
            a["hair"],
            float(a["grey"]),
            a["roughness"],
            float(a["angle_deg"]),
            bool(a["male"]),
        )


def prepare(folder: Path | None = None) -> None:
    """Draw what is missing of the skins and beards: about seven minutes of a core for all."""
    folder = folder or default_folder()
    load_beards(folder)
    for number in range(COUNT):
        load_skin(number, folder)


@functools.lru_cache(maxsize=1)
def load_beards(folder: Path) -> tuple[Bytes, Bytes]:
    """Strands (704, 1056, 4) of four lengths over the whole beard, and (704, 1056, 2) densities: beard, moustache."""
    path = folder / "beards.npz"
    if not path.is_file():
        _store(path, _draw_beards())
    with np.load(path, allow_pickle=False) as a:
        return a["strands"], a["places"]


def _store(path: Path, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.part")
    with part.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    if not zipfile.is_zipfile(part):
        raise OSError(f"{part} was not written whole")
    part.replace(path)


def _draw(number: int) -> dict[str, npt.NDArray[np.generic]]:
    import torch

    from models.colour import srgb
    from models.lightstage.skin.subject import ANGLE_RANGE, Subject
    from models.lightstage.skin.synthesis import Skin as Drawn
    from models.lightstage.skin.window import ChartWindow
    from models.lightstage.stage import Stage

    low, high = ANGLE_RANGE
    wanted = low + (high - low) * (number * 0.6180339887 % 1.0)
    candidates = (Subject.sample(FIRST + number * 64 + k) for k in range(64))
    subject = min(candidates, key=lambda s: abs(s.tone.typology_angle_deg - wanted))
    if number % 4 == 0:
        subject = dataclasses.replace(subject, hair=dataclasses.replace(subject.hair, brow_count=BARE_BROWS))
    stage = Stage.open()
    drawn = Drawn.of(subject, stage.anatomy)
    window = ChartWindow.whole(WIDTH, HEIGHT)
    maps = drawn.maps(window)
    lips, hair, _, _, scalp = maps.regions
    above = torch.from_numpy(_template_height(stage) > -0.012)
    layers = torch.stack([
        lips, hair * above * (1 - scalp), hair * ~above * (1 - scalp), scalp * subject.hair.scalp_cover
    ])  # fmt: skip
    h, g = subject.hair, subject.gloss
    return {
        "albedo": _bytes(srgb(maps.diffuse_albedo)), "layers": _bytes(layers), "grey": np.array(h.grey),
        "hair": np.array([h.colour_red, h.colour_green, h.colour_blue]),
        "roughness": np.array([g.alpha_narrow, g.alpha_broad, g.mix]),
        "angle_deg": np.array(subject.tone.typology_angle_deg), "male": np.array(subject.masculine > 0.5),
    }  # fmt: skip


def _template_height(stage: Stage) -> npt.NDArray[np.float32]:
    """(704, 1056) y (metres) of the mean head at each texel."""
    from service.geometry.chart import Chart

    return Chart.build(stage.head, WIDTH, HEIGHT).interpolate(stage.head.mean[:, 1])[..., 0]


def _draw_beards() -> dict[str, npt.NDArray[np.generic]]:
    import torch

    from models.lightstage.skin.atlas import enlarge
    from models.lightstage.skin.hair import beard_cover, draw_strands, list_stubble
    from models.lightstage.skin.subject import Subject
    from models.lightstage.skin.window import ChartWindow
    from models.lightstage.stage import Stage

    stage, window = Stage.open(), ChartWindow.whole(WIDTH, HEIGHT)
    strands, places = [], []
    for length, density in ((0.2, 60.0), (1.5, 90.0), (4.0, 90.0), (8.0, 110.0)):
        subject = Subject.sample(FIRST)
        hair = dataclasses.replace(
            subject.hair, beard_density=density, beard_length=length, moustache=1.0, grey=0.0, beard_shadow=0.0
        )
        subject = dataclasses.replace(subject, hair=hair)
        strands.append(draw_strands(list_stubble(subject, stage.anatomy), window).cover)
    for moustache in (0.0, 1.0):
        hair = dataclasses.replace(subject.hair, moustache=moustache)
        cover = beard_cover(dataclasses.replace(subject, hair=hair), stage.anatomy)
        places.append(enlarge(torch.from_numpy(np.ascontiguousarray(cover, np.float32))[None], window)[0])
    places[1] = places[1] - places[0]
    return {"strands": _bytes(torch.stack(strands)), "places": _bytes(torch.stack(places))}


def _bytes(values: Tensor) -> Bytes:
    """(C, h, w) in [0, 1] -> (h, w, C) uint8."""
    return np.asarray((values.float().clamp(0.0, 1.0) * 255.0).round().byte().permute(1, 2, 0).contiguous().numpy())
