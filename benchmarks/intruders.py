"""Albedo under what hides skin: ``python -m benchmarks.intruders --photos build/intruders [--count 8]``.

Portraits of ``models.people`` that no network was trained on (seeds below 2048), 512 x 512, turned by less than 30
degrees: each once with nothing before the skin and once with each of ``models.people.dress.INTRUDERS``. An avatar of
each is made by ``service.pipeline.make_avatar``. Over the skin that the intruder hides or whose light it changes:

- **dB without, with**: PSNR of sRGB-coded albedo to the true one, after the one gain that fits best on the rest of the
  face; **cost**: their difference, mean over portraits, and in how many of them it is at most 1 dB.
- **edges**: mean gradient of log luminance of the albedo along the border of that skin, over that of skin elsewhere on
  the face; in brackets the same places of the portrait without the intruder.
- **residue**: 95th percentile of how far the albedo there is off the one without the intruder, in Delta E (CIE 1976).

- **shape**: mean distance of the face's vertices from the true ones, mm after the best similarity, without and with.

``--beside N`` gives the avatar N more pictures of the same person with nothing before the skin, in other lights, by
other cameras, with other expressions: what one of three photos shows is outvoted, what one of two shows is not.

Portraits are kept in the folder: another run needs no OpenGL.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.albedo import albedo_of
from benchmarks.metrics import at_chart, similarity
from models.tables import tell
from service.arrays import Bool, Float32
from service.colour import LUMA, linear_to_srgb, srgb_to_linear
from service.errors import AvatarError
from service.face.reading import part_labels as labels
from service.options import Options
from service.pipeline import make_avatar

Float = npt.NDArray[np.float64]

MARK = ("<!-- intruders -->", "<!-- /intruders -->")
SIZE, MOST_YAW, HELD_OUT = 512, 30.0, 2048
CHART = (768, 512)
CHANGED = 0.15
"""Change of the picture, natural logarithm of luminance, from which on skin beside an intruder counts as changed."""
FEWEST = 150
"""Fewest pixels that an intruder has to hide or change."""
NEAR = 4
"""Half the width of the band along a border, texels of the chart."""
COST_DB = 1.0
NOTHING = "nothing"


@dataclass(frozen=True)
class Sight:
    """A portrait.

    Attributes:
        jpeg: its file.
        image: (H, W, 3) uint8 sRGB as decoded from that.
        chart: (H, W, 2) float32 chart coordinates; NaN where the head's surface does not show.
        part: (H, W) uint8 of ``service.face.reading.part_labels``.
        albedo: (h, w, 3) linear RGB of the skin on the chart.
        neutral: (V, 3) metres, the head at rest.
    """

    jpeg: bytes
    image: npt.NDArray[np.uint8]
    chart: Float32
    part: npt.NDArray[np.uint8]
    albedo: Float32
    neutral: Float32

    @classmethod
    def load(cls, path: Path) -> Sight:
        """Of a file of :func:`shoot`."""
        with np.load(path, allow_pickle=False) as kept:
            fields = (kept[name] for name in ("image", "chart", "part", "albedo", "neutral"))
            return cls(kept["jpeg"].tobytes(), *fields)


def shoot(folder: Path, count: int, wanted: Sequence[str], beside: int) -> dict[int, list[bytes]]:
    """Draw portraits until there are those of ``count`` seeds; of each the files of ``beside`` more pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    found: dict[int, list[bytes]] = {}
    for seed in range(0, HELD_OUT, 37):
        if len(found) == count:
            break
        if not _drawn(folder, seed, seed, NOTHING):
            continue
        for only in wanted:
            _drawn(folder, seed, seed, only)
        taken = (other for other in range(HELD_OUT + seed, 2 * HELD_OUT) if _drawn(folder, seed, other, NOTHING))
        found[seed] = [Sight.load(_file(folder, seed, other, NOTHING)).jpeg for other in islice(taken, beside)]
    return found


def _file(folder: Path, seed: int, taken: int, only: str) -> Path:
    return folder / (f"{seed:04}-{only}.npz" if seed == taken else f"{seed:04}-{only}-{taken}.npz")


def _drawn(folder: Path, seed: int, taken: int, only: str) -> bool:
    """Draw a picture unless it is there; False where it is turned too far or grey."""
    from models.people.make import portrait
    from models.people.person import draw_person
    from models.people.skins import default_folder, load_skin

    file = _file(folder, seed, taken, only)
    if file.is_file():
        return True
    shown = portrait(seed, SIZE, only=only, taken=taken)
    grey = float(np.abs(shown.image.astype(int) - shown.image.mean(-1, keepdims=True)).mean()) < 3
    if abs(shown.camera.yaw_pitch_roll_deg()[0]) > MOST_YAW or grey:
        return False
    person = draw_person(seed)
    skin = load_skin(person.skin, default_folder()).albedo
    albedo = srgb_to_linear(skin.astype(np.float32) / 255) * person.tint
    np.savez_compressed(
        file, jpeg=np.frombuffer(shown.jpeg, np.uint8), image=shown.image, chart=shown.chart, part=shown.part,
        albedo=albedo.astype(np.float16), neutral=person.neutral,
    )  # fmt: skip
    return True


@dataclass(frozen=True)
class Made:
    """An avatar: (h, w, 3) linear RGB of its albedo, and how far its head at rest is off the true one, mm."""

    albedo: Float32
    shape_mm: float


def avatar_of(jpegs: Sequence[bytes], truth: Float32) -> Made | None:
    """The avatar of pictures of somebody whose head at rest is (V, 3); None where no face is found."""
    options = Options(maps=("diffuse_albedo",), quality="draft", size=CHART, face="largest", leave_out="strangers")
    try:
        avatar = make_avatar(list(jpegs), options)
    except AvatarError:
        return None
    face = avatar.head.region("face") > 0.5
    ours, true = avatar.fit.neutral[face].astype(np.float64), truth[face].astype(np.float64)
    scale, rotation, offset = similarity(ours, true)
    off = np.linalg.norm(scale * ours @ rotation + offset - true, axis=1)
    return Made(srgb_to_linear(albedo_of(avatar.reflectance)), 1e3 * float(off.mean()))


def luminance(linear: Float32) -> Float:
    """(N,) of (N, 3), at least a thousandth."""
    return np.maximum(linear.astype(np.float64) @ LUMA, 1e-3)


def touched(bare: Sight, other: Sight) -> tuple[Bool, Bool]:
    """(H, W) bare skin that an intruder hides or whose light it changes, and the rest of the skin."""
    skin = (bare.part == labels.SKIN) & np.isfinite(bare.chart[..., 0])
    hidden = skin & ((other.part != bare.part) | ~np.isfinite(other.chart[..., 0]))
    # Brightness as it is after the exposure of each picture.
    logs = [np.log(luminance(srgb_to_linear(s.image.astype(np.float32) / 255))) for s in (bare, other)]
    apart = cv2.GaussianBlur(np.asarray(logs[1] - logs[0], np.float32), (0, 0), 1.5)
    free = skin & ~hidden
    shift = float(np.median(apart[free])) if free.any() else 0.0
    changed = skin & (hidden | (np.abs(apart - shift) > CHANGED))
    return changed, skin & ~np.asarray(cv2.dilate(changed.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0)


def psnr(albedo: Float32, truth: Float32, chosen: Bool, rest: Bool) -> float:
    """PSNR of sRGB-coded values (N, 3) at chosen ones after the gain of linear values that fits best at the rest."""
    gain = float((albedo[rest] * truth[rest]).sum() / max(float((albedo[rest] ** 2).sum()), 1e-9))
    off = linear_to_srgb(np.clip(gain * albedo[chosen], 0, 1)) - linear_to_srgb(np.clip(truth[chosen], 0, 1))
    return float(-10 * np.log10(max(float((off**2).mean()), 1e-9)))


def edges(albedo: Float32, chart: Float32, changed: Bool, rest: Bool) -> float:
    """Mean gradient along the border of changed skin over that at the rest.

    Args:
        albedo: (h, w, 3) linear.
        chart: (N, 2) coordinates of skin.
        changed: (N,) which of it an intruder changed.
        rest: (N,) and which is far from that.
    """
    width, height = CHART
    column = np.clip((chart[:, 0] * width).astype(int), 0, width - 1)
    row = np.clip(((1 - chart[:, 1]) * height).astype(int), 0, height - 1)
    own, far = np.zeros((height, width), np.uint8), np.zeros((height, width), np.uint8)
    own[row[changed], column[changed]], far[row[rest], column[rest]] = 1, 1
    shown = np.zeros((height, width), np.uint8)
    shown[row, column] = 1
    close = np.ones((7, 7), np.uint8)
    own, far, shown = (np.asarray(cv2.morphologyEx(m, cv2.MORPH_CLOSE, close), np.uint8) for m in (own, far, shown))
    band = np.ones((2 * NEAR + 1,) * 2, np.uint8)
    border = np.asarray(cv2.dilate(own, band) - cv2.erode(own, band)) > 0
    inside = np.asarray(cv2.erode(shown, np.ones((5, 5), np.uint8))) > 0
    log = cv2.GaussianBlur(np.log(luminance(albedo)).astype(np.float32), (0, 0), 1.0)
    steep = np.hypot(cv2.Sobel(log, cv2.CV_32F, 1, 0), cv2.Sobel(log, cv2.CV_32F, 0, 1))
    along, elsewhere = border & inside, (far > 0) & inside & ~border
    if not along.any() or not elsewhere.any():
        return float("nan")
    return float(steep[along].mean() / max(float(steep[elsewhere].mean()), 1e-6))


@dataclass(frozen=True)
class Pair:
    """A portrait with an intruder beside the one without."""

    intruder: str
    seed: int
    without_db: float
    with_db: float
    edge: float
    bare_edge: float
    residue: float
    bare_mm: float
    worn_mm: float

    @property
    def cost(self) -> float:
        """Decibels."""
        return self.without_db - self.with_db


def compared(intruder: str, seed: int, bare: Sight, changed: Bool, rest: Bool, clean: Made, worn: Made) -> Pair:
    """Of avatars without the intruder and with it, over skin (H, W) that it changed and the rest."""
    from skimage.color import rgb2lab

    skin = changed | rest
    chart, one, far = bare.chart[skin], changed[skin], rest[skin]
    planes = (bare.albedo, clean.albedo, worn.albedo)
    truth, a, b = (at_chart(plane, chart.astype(np.float64)).astype(np.float32) for plane in planes)
    gain = float(np.median(luminance(a[far]) / luminance(b[far])))
    labs = [rgb2lab(linear_to_srgb(np.clip(c[one], 0, 1))[None])[0] for c in (a, gain * b)]
    residue = float(np.quantile(np.linalg.norm(labs[0] - labs[1], axis=1), 0.95))
    return Pair(
        intruder, seed, psnr(a, truth, one, far), psnr(b, truth, one, far),
        edges(worn.albedo, chart, one, far), edges(clean.albedo, chart, one, far), residue,
        clean.shape_mm, worn.shape_mm,
    )  # fmt: skip


def pairs(
    folder: Path, people: Mapping[int, Sequence[bytes]], wanted: Sequence[str], sheet: Path | None
) -> Iterator[Pair]:
    """Measure, one after the other; ``people``: seeds with the files of further pictures of them."""
    for seed, beside in people.items():
        bare = Sight.load(_file(folder, seed, seed, NOTHING))
        clean = avatar_of([bare.jpeg, *beside], bare.neutral)
        if clean is None:
            continue
        for intruder in wanted:
            other = Sight.load(_file(folder, seed, seed, intruder))
            changed, rest = touched(bare, other)
            if changed.sum() < FEWEST or rest.sum() < FEWEST:
                continue
            worn = avatar_of([other.jpeg, *beside], bare.neutral)
            if worn is None:
                continue
            yield compared(intruder, seed, bare, changed, rest, clean, worn)
            if sheet is not None:
                _draw(sheet / f"{seed:04}-{intruder}.jpg", other.image, clean.albedo, worn.albedo)


def _draw(path: Path, image: npt.NDArray[np.uint8], clean: Float32, worn: Float32) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    columns = slice(CHART[0] // 5, -CHART[0] // 5)
    maps = [np.rint(255 * linear_to_srgb(np.clip(m[:, columns], 0, 1))).astype(np.uint8) for m in (clean, worn)]
    cv2.imwrite(str(path), np.concatenate([image, *maps], 1)[..., ::-1])


def table(found: list[Pair]) -> list[str]:
    """Markdown, a row for each intruder."""
    rows = ["| | pairs | dB without | with | cost, dB | at most 1 dB | edges | residue | shape, mm |", "|---" * 9 + "|"]
    for name in (*dict.fromkeys(pair.intruder for pair in found), "all"):
        own = [pair for pair in found if name in (pair.intruder, "all")]
        without, worn, cost, edge, bare, residue, bare_mm, worn_mm = (
            float(np.nanmean([getattr(pair, field) for pair in own]))
            for field in ("without_db", "with_db", "cost", "edge", "bare_edge", "residue", "bare_mm", "worn_mm")
        )
        few = sum(pair.cost <= COST_DB for pair in own)
        rows.append(
            f"| {name} | {len(own)} | {without:.1f} | {worn:.1f} | **{cost:.2f}** | {few} of {len(own)} "
            f"| **{edge:.2f}** ({bare:.2f}) | {residue:.1f} | {bare_mm:.2f}, {worn_mm:.2f} |"
        )
    return rows


def main() -> None:
    """Entry point."""
    from models.people.dress import INTRUDERS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=Path, required=True, help="folder of the portraits")
    parser.add_argument("--count", type=int, default=8)
    parser.add_argument("--only", default=",".join(INTRUDERS), help="intruders with commas between")
    parser.add_argument("--beside", type=int, default=0, help="further pictures of each person")
    parser.add_argument("--each", action="store_true", help="a line for each pair")
    parser.add_argument("--sheet", type=Path, help="folder for pictures: portrait, albedo without it, albedo with it")
    parser.add_argument("--write", type=Path, help="Markdown file to put the table into")
    chosen = parser.parse_args()
    found = []
    wanted = chosen.only.split(",")
    people = shoot(chosen.photos, chosen.count, wanted, chosen.beside)
    for pair in pairs(chosen.photos, people, wanted, chosen.sheet):
        found.append(pair)
        if chosen.each:
            print(f"{pair.seed:04} {pair.intruder}: {pair.without_db:.1f} {pair.with_db:.1f} "
                  f"edges {pair.edge:.2f} ({pair.bare_edge:.2f}) residue {pair.residue:.1f}", flush=True)  # fmt: skip
    tell("\n".join(table(found)), MARK, chosen.write)


if __name__ == "__main__":
    main()
