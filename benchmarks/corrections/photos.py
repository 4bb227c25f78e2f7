"""The photos of the trial: who sat, in what light, before what camera; rendered once, then kept."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.corrections.sitters import BLACK, DARK_BROWN, SHUT, SMILE, Sitter, Studio, cap, glasses, shirt
from benchmarks.heads import TexturedHead
from benchmarks.render import Exposure, Look, Shot, expose
from service.colour import LUMA, linear_to_srgb

Float = npt.NDArray[np.float32]

FACE_LEVEL, FACE_SHARE = 0.55, 0.9
"""Linear luminance that automatic exposure gives to this quantile of the face: sRGB 0.77."""


@dataclass(frozen=True)
class Lens:
    """One camera's ways.

    Attributes:
        stops: exposure beside the automatic one, in powers of two.
        balance: gain of each linear channel before it clips: below 1 in blue is warm light that was left warm.
        bend: exponent of each coded channel: above 1 its shades are darker; all alike is contrast, apart is a hue that
            follows the light, as films and filters have.
        contrast: strength in [0, 1] of an S-shaped curve on all coded channels.
        ceiling: coded value at which each channel is cut off and stretched to 1 (a blown channel).
        size: pixels of the square photo; None: as rendered.
        noise: standard deviation of the sensor's noise, codes of 255.
        jpeg: quality of JPEG, 0 to 100; None: PNG.
    """

    stops: float = 0.0
    balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    bend: tuple[float, float, float] = (1.0, 1.0, 1.0)
    contrast: float = 0.0
    ceiling: tuple[float, float, float] = (1.0, 1.0, 1.0)
    size: int | None = None
    noise: float = 0.0
    jpeg: int | None = None


def automatic(radiance: Float, face: npt.NDArray[np.bool_]) -> float:
    """Gain that a camera which meters the face would take."""
    return FACE_LEVEL / float(np.quantile(radiance[face] @ LUMA, FACE_SHARE))


def develop(radiance: Float, face: npt.NDArray[np.bool_], camera: Lens, seed: int = 0) -> npt.NDArray[np.uint8]:
    """(h, w, 3) uint8 sRGB photo of linear radiance (H, W, 3) with a face somewhere."""
    import cv2

    gain = automatic(radiance, face) * 2**camera.stops * np.array(camera.balance)
    linear = radiance * gain.astype(np.float32)
    if camera.size is not None:
        small = cv2.resize(linear, (camera.size, camera.size), interpolation=cv2.INTER_AREA)
        linear = np.asarray(small, np.float32)
    coded = linear_to_srgb(np.clip(linear, 0, 1).astype(np.float32))
    coded = np.minimum(coded / np.array(camera.ceiling, np.float32), 1) ** np.array(camera.bend, np.float32)
    coded = coded + np.float32(camera.contrast) * (coded * coded * (3 - 2 * coded) - coded)
    noise = np.random.default_rng(seed).normal(0, camera.noise, coded.shape) if camera.noise else 0.0
    return np.asarray(np.clip(np.rint(coded * 255 + noise), 0, 255), np.uint8)


def encoded(pixels: npt.NDArray[np.uint8], camera: Lens) -> bytes:
    """The file that the camera writes."""
    import cv2

    ending, settings = (".png", []) if camera.jpeg is None else (".jpg", [cv2.IMWRITE_JPEG_QUALITY, camera.jpeg])
    done, data = cv2.imencode(ending, pixels[..., ::-1], settings)
    if not done:
        raise RuntimeError(f"a photo of {pixels.shape} could not be encoded as {ending}")
    return data.tobytes()


GROUPS = (
    "soft", "hard", "graded", "clipped", "warm", "overexposed", "underexposed", "beard", "brows", "oily", "smile",
    "small", "no-eyes", "glasses", "cap", "shirt",
)  # fmt: skip
"""What a photo may have; corrections name those on which they have to gain."""

SIZE = 640
SEEDS = (1, 7, 8, 10, 22, 27, 29, 39, 40)
"""Of ``benchmarks.render.environment``, whose skies are nearly white."""
DIM = Lens(stops=-1.0)
"""Exposed for a scene, not for the dark face in it."""
WHITE = Lens(stops=-2.6)
"""Exposed for a white shirt beside a dark face."""
WARM = (1.25, 0.80, 0.30)
FILM = Lens(bend=(0.85, 1.0, 1.22), contrast=0.7)
"""Shades redder and yellower than lights."""
TEAL = Lens(stops=-0.5, bend=(1.30, 1.0, 0.92), contrast=0.5)
SMALL = Lens(size=224, noise=3.0, jpeg=45)
OILY = Look(roughness=0.22, specular=0.9)
SOFT, HARD, SHIRT = ("soft",), ("hard",), ("shirt", "no-eyes")


@dataclass(frozen=True)
class Sitting:
    """What is rendered: one head in one light.

    Attributes:
        name: of the files.
        sitter: whose head.
        light: one of ``benchmarks.render``.
        yaw: degrees of the camera round the head.
        groups: what its photos have.
        look: how skin shines.
        glasses, cap, shirt: whether they are worn.
        camera: that takes the first photo.
    """

    name: str
    sitter: Sitter
    light: str
    yaw: float
    groups: tuple[str, ...]
    look: Look = Look()  # noqa: RUF009 - frozen
    glasses: bool = False
    cap: bool = False
    shirt: bool = False
    camera: Lens = Lens()

    @property
    def shot(self) -> Shot:
        """Lens and light."""
        return Shot(self.yaw, self.light, 1.2, 18.0, SIZE, seed=SEEDS[sum(self.name.encode()) % len(SEEDS)])

    def dressed(self, head: TexturedHead) -> Look:
        """Skin, and what is worn on this head."""
        wardrobe = (self.glasses, glasses), (self.cap, cap), (self.shirt, shirt)
        return replace(self.look, worn=tuple(thing for worn, make in wardrobe if worn for thing in make(head)))


SITTINGS = (
    Sitting("ffhq_soft", Sitter("ffhq"), "soft", 8, SOFT),
    Sitting("ffhq_left", Sitter("ffhq"), "left", -12, HARD),
    Sitting("hifi1_soft", Sitter(100, "hifi3d 1"), "soft", -8, SOFT),
    Sitting("hifi2_left", Sitter(102, "hifi3d 2"), "left", 6, HARD),
    Sitting("hifi3_overhead", Sitter(103, "hifi3d 3"), "overhead", 4, HARD),
    Sitting("dark_soft", Sitter(105, dark=True), "soft", -10, SOFT, camera=DIM),
    Sitting("dark_right", Sitter(106, "hifi3d 2", dark=True), "right", 10, HARD, camera=DIM),
    Sitting("scan_soft", Sitter("scan"), "soft", 8, (*SOFT, "no-eyes")),
    Sitting("scan_right", Sitter("scan"), "right", 8, (*HARD, "no-eyes")),
    Sitting("beard_soft", Sitter(108, "hifi3d 1", beard=DARK_BROWN), "soft", 5, (*SOFT, "beard")),
    Sitting("beard_harsh", Sitter(109, "hifi3d 2", beard=BLACK, brows=BLACK), "harsh", -6, (*HARD, "beard", "brows")),
    Sitting("brows_soft", Sitter(111, "hifi3d 3", brows=BLACK), "soft", 12, (*SOFT, "brows")),
    Sitting("brows_left", Sitter(112, "ffhq", brows=DARK_BROWN), "left", -4, (*HARD, "brows")),
    Sitting("oily_left", Sitter(114, "hifi3d 1"), "left", 6, (*HARD, "oily"), OILY),
    Sitting("oily_overhead", Sitter(115, "hifi3d 2"), "overhead", -8, (*HARD, "oily"), OILY),
    Sitting("smile_soft", Sitter(117, "hifi3d 3", expression=SMILE), "soft", 6, (*SOFT, "smile")),
    Sitting("smile_left", Sitter(118, "ffhq", expression=SMILE), "left", 0, (*HARD, "smile")),
    Sitting("shut_overhead", Sitter(120, "hifi3d 1", expression=SHUT), "overhead", 4, (*HARD, "no-eyes")),
    Sitting("glasses_soft", Sitter(121, "hifi3d 2"), "soft", -6, (*SOFT, "glasses"), glasses=True),
    Sitting("shirt_soft", Sitter(105, dark=True, expression=SHUT), "soft", -10, SHIRT, camera=WHITE, shirt=True),
    Sitting("shirt_left", Sitter(124, "hifi3d 3", expression=SHUT), "left", 6, SHIRT, camera=DIM, shirt=True),
    Sitting("cap_overhead", Sitter(123, "hifi3d 3"), "overhead", 8, (*HARD, "cap"), cap=True),
)

DEVELOPED: tuple[tuple[str, str, Lens, tuple[str, ...]], ...] = (
    ("ffhq_soft", "film", FILM, ("graded",)),
    ("hifi2_left", "film", FILM, ("graded",)),
    ("dark_right", "teal", TEAL, ("graded",)),
    ("hifi3_overhead", "blown", Lens(stops=0.5, ceiling=(0.78, 0.78, 0.78)), ("clipped",)),
    ("ffhq_left", "red blown", Lens(balance=(1.5, 1.0, 0.85)), ("clipped",)),
    ("hifi1_soft", "warm", Lens(balance=WARM), ("warm",)),
    ("hifi3_overhead", "warm", Lens(balance=(1.25, 0.74, 0.16), contrast=0.6), ("warm", "clipped")),
    ("ffhq_soft", "over", Lens(stops=1.0), ("overexposed",)),
    ("scan_right", "over", Lens(stops=0.8), ("overexposed",)),
    ("hifi1_soft", "under", Lens(stops=-2.2, noise=1.5), ("underexposed",)),
    ("dark_soft", "under", Lens(stops=-2.8, noise=1.5), ("underexposed",)),
    ("oily_left", "small", SMALL, ("small",)),
    ("smile_soft", "small", SMALL, ("small",)),
)
"""Further photos of the same sittings by other cameras: sitting, ending of the name, camera, what it adds."""

QUICK = ("ffhq_soft", "hifi2_left", "scan_right", "beard_harsh", "hifi1_soft warm")
"""Photos of a trial in a hurry."""


@dataclass(frozen=True)
class Photo:
    """One photo with its truth.

    Attributes:
        name: for tables.
        groups: of ``GROUPS``.
        data: the file.
        truth: what each pixel of the sitting shows, at ``SIZE``; the photo may be smaller.
        head: who sat.
        shot: the camera's place.
    """

    name: str
    groups: tuple[str, ...]
    data: bytes
    truth: Exposure
    head: TexturedHead
    shot: Shot


def names(quick: bool = False) -> tuple[str, ...]:
    """Names of all photos, or of those of a trial in a hurry; photos of one sitting follow each other."""
    if quick:
        return QUICK
    return tuple(name for sitting in SITTINGS for name, _, _ in _taken_of(sitting))


def photos(data: Path, out: Path, wanted: Collection[str]) -> Iterator[Photo]:
    """Photos of these names, sitting by sitting; what is not kept in ``out`` is rendered first."""
    studio = Studio(data, out)
    for sitting in SITTINGS:
        taken = [one for one in _taken_of(sitting) if one[0] in wanted]
        if not taken:
            continue
        head = studio.head(sitting.sitter)
        truth = exposure(sitting, head, out)
        for name, camera, groups in taken:
            pixels = develop(truth.radiance, truth.skin, camera)
            yield Photo(name, groups, encoded(pixels, camera), truth, head, sitting.shot)


def _taken_of(sitting: Sitting) -> Iterator[tuple[str, Lens, tuple[str, ...]]]:
    """Name, camera and groups of each photo of a sitting."""
    yield sitting.name, sitting.camera, sitting.groups
    for who, ending, camera, more in DEVELOPED:
        if who == sitting.name:
            yield f"{who} {ending}", camera, sitting.groups + more


def exposure(sitting: Sitting, head: TexturedHead, out: Path) -> Exposure:
    """The kept exposure of a sitting, rendered where there is none."""
    return kept_exposure(out / f"sitting_{sitting.name}.npz", head, sitting.shot, sitting.dressed(head))


def kept_exposure(file: Path, head: TexturedHead, shot: Shot, look: Look = Look()) -> Exposure:  # noqa: B008 - frozen
    """The exposure in a file; rendered into it where it is not there."""
    if not file.is_file():
        found = expose(head, shot, look, file.with_suffix(""))
        calmed = replace(found, radiance=calm(found.radiance, found.albedo))
        part = file.with_name(f"{file.stem}.{os.getpid()}.part.npz")
        np.savez_compressed(part, **vars(calmed))
        part.replace(file)
    with np.load(file) as kept:
        return Exposure(**{name: kept[name] for name in kept.files})


def calm(radiance: npt.NDArray[np.float32], albedo: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Radiance (H, W, 3) without the renderer's noise: its ratio to the albedo is smoothed, edges of it kept."""
    import cv2

    base = np.maximum(albedo, np.float32(0.02))
    ratio = np.log(np.maximum(radiance, 1e-4) / base).astype(np.float32)
    smooth = cv2.bilateralFilter(cv2.medianBlur(ratio, 3), 7, 0.25, 2.0)
    return np.asarray(np.exp(smooth) * base, np.float32)
