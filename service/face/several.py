"""Several photos of one person: which of them are usable, whether all show the same person, which tells most.

Photos are brought into an order of their own, by content, so that the order in which they came changes nothing, and the
same photo twice counts once. What is left out is told, with the reason. Of a video the frames count that show the head
from as many sides as it turns: of each direction the sharpest.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from service.arrays import Float64, UInt8
from service.errors import AvatarError, FitFailed, NoFace, NoUsableFace, Strangers, UnreadableInput, UsageError
from service.face.finder import Face, FaceFinder
from service.face.fit.fit import Fit, FitSettings
from service.face.fit.fit_face import fit_views
from service.face.identity import Recogniser, distance
from service.face.profile import turned_further
from service.face.reading.reader import Readers, Reading, View, read_face
from service.head.model import HeadModel
from service.manifest import LeftOut
from service.photo.bundle import MOST
from service.photo.gate import read_photo
from service.photo.photo import Photo
from service.photo.video import is_video, sharp_frames

MOST_FRAMES = 9
"""Frames of a video that are used."""
EARS = (234, 454)
"""Landmarks before the image-left and the image-right ear."""
NOSE = 1


def turn_deg(face: Face) -> float:
    """About how far a head is turned, degrees, by where the nose stands between the ears."""
    left, right, nose = (face.landmarks[k, :2] for k in (*EARS, NOSE))
    across = right - left
    width = float(across @ across)
    if width < 1e-9:
        return 0.0
    place = float((nose - left) @ across) / width
    return float(np.degrees(np.arctan((2 * place - 1) * 1.1)))


def best_frames(frames: Sequence[bytes], finder: FaceFinder) -> list[bytes]:
    """JPEG files of at most ``MOST_FRAMES`` frames, the sharpest of each direction.

    Raises:
        NoFace: no frame shows a face.
    """
    best: dict[int, tuple[float, bytes]] = {}
    for data in frames:
        photo = read_photo(data)
        faces = finder.find(photo.pixels)
        if not faces:
            continue
        # Turn of the head between two of them, about.
        bin_ = round(turn_deg(faces[0]) / 18.0)
        merit = _sharpness(photo.pixels, faces[0])
        if merit > best.get(bin_, (0.0, b""))[0]:
            best[bin_] = (merit, data)
    if not best:
        raise NoFace(f"none of {len(frames)} frames of the video shows a face")
    chosen = sorted(best, key=lambda one: (abs(one), one))[:MOST_FRAMES]
    return [best[one][1] for one in chosen]


def with_frames(files: Sequence[bytes], finder: Callable[[], FaceFinder]) -> list[bytes]:
    """Files in which each video has been replaced by its best frames, no more than ``MOST`` in all.

    Raises:
        UnreadableInput: a video cannot be read.
        NoFace: it shows none.
    """
    photos = [file for file in files if not is_video(file)]
    for video in (file for file in files if is_video(file)):
        photos += best_frames(sharp_frames(video), finder())[: max(MOST - len(photos), 0)]
    return photos


def _sharpness(pixels: UInt8, face: Face) -> float:
    """Variance of the Laplacian over the face, at one scale for all frames; > 0."""
    low = np.maximum(face.box[:2].astype(int), 0)
    high = np.maximum(face.box[2:].astype(int), low + 8)
    grey = cv2.cvtColor(pixels[low[1] : high[1], low[0] : high[0]], cv2.COLOR_RGB2GRAY)
    if min(grey.shape) < 8:
        return 1e-6
    small = cv2.resize(grey, (200, 200), interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(small, cv2.CV_32F).var()) + 1e-6


MOST_PIXELS = 120_000_000
"""Pixels of all photos together, 3 bytes each; several larger ones are made smaller."""
SAME = "same-photo"


@dataclass(frozen=True)
class Gathered:
    """The photos of one person, as far as they are understood.

    Attributes:
        count: how many were given.
        numbers: of those in use, as they were given, from 0.
        photos: those in use.
        left_out: the others.
        views: of the photos, with the face that was found in each, and what was read.
        fits: of one head in them; the first photo is then the best of them.
    """

    count: int
    numbers: tuple[int, ...]
    photos: tuple[Photo, ...]
    left_out: tuple[LeftOut, ...] = ()
    views: tuple[View, ...] = ()
    fits: tuple[Fit, ...] = ()

    @property
    def first(self) -> tuple[Photo, Face, Reading | None, Fit]:
        """The best photo, what was found and read in it, and its fit."""
        view = self.views[0]
        return view.photo, view.face, view.reading, self.fits[0]

    @property
    def others(self) -> tuple[tuple[View, Fit], ...]:
        """The photos beside it, and the same head's fits in them."""
        return tuple(zip(self.views[1:], self.fits[1:], strict=True))

    def only(self, chosen: Sequence[int], further: Sequence[LeftOut]) -> Gathered:
        """Those of some places, in this order, and what is left out besides."""
        return replace(
            self,
            numbers=tuple(self.numbers[k] for k in chosen),
            photos=tuple(self.photos[k] for k in chosen),
            views=tuple(self.views[k] for k in chosen) if self.views else (),
            left_out=tuple(sorted((*self.left_out, *further), key=lambda one: (one.sha256, one.code, one.message))),
        )

    def without(self, errors: Mapping[int, AvatarError]) -> Gathered:
        """The rest, where some places have errors; the first of them is raised where there is no rest."""
        rest = [k for k in range(len(self.photos)) if k not in errors]
        if not rest:
            raise of_photo(next(iter(errors.values())), self.numbers[0], self.count)
        left = [LeftOut(self.photos[k].sha256, error.code, error.message) for k, error in errors.items()]
        return self.only(rest, left)


def of_photo(error: AvatarError, number: int, count: int) -> AvatarError:
    """The error as one of several photos has it: its message names the photo, counted from 1 as people do."""
    if count == 1:
        return error
    return type(error)(f"photo {number + 1} of {count}: {error.message}", **{**error.extra, "photo": number})


def check_count(count: int) -> None:
    """Refuse no photos, and more than ``MOST``.

    Raises:
        UsageError: of either.
    """
    if not 1 <= count <= MOST:
        raise UsageError(f"{count} photos were given; 1 to {MOST} of one person are taken")


def decoded(files: Sequence[bytes]) -> Gathered:
    """The photos of files, by content, no larger together than ``MOST_PIXELS``.

    Raises:
        UnreadableInput: no file is a photo.
        AvatarError: the installation is broken.
    """
    found: list[tuple[int, Photo]] = []
    left: list[LeftOut] = []
    errors: list[AvatarError] = []
    for number, data in enumerate(files):
        try:
            found.append((number, read_photo(data)))
        except UnreadableInput as error:
            errors.append(of_photo(error, number, len(files)))
            left.append(LeftOut(hashlib.sha256(data).hexdigest(), error.code, error.message))
    if not found:
        raise errors[0]
    found.sort(key=lambda one: (one[1].sha256, one[0]))
    kept: list[tuple[int, Photo]] = []
    thumbnails: list[UInt8] = []
    for number, photo in found:
        # Side of what is compared to find the same photo twice.
        small = np.asarray(cv2.resize(photo.pixels, (64,) * 2, interpolation=cv2.INTER_AREA), np.uint8)
        if any(_same(photo, small, other, its) for (_, other), its in zip(kept, thumbnails, strict=True)):
            left.append(LeftOut(photo.sha256, SAME, "another photo is the same"))
            continue
        kept.append((number, photo))
        thumbnails.append(small)
    most = MOST_PIXELS // len(kept)
    numbers, photos = zip(*kept, strict=True)
    if len(photos) > 1:
        photos = tuple(smaller(photo, most) for photo in photos)
    return Gathered(len(files), numbers, photos).only(range(len(photos)), left)


def _same(one: Photo, small: UInt8, other: Photo, its: UInt8) -> bool:
    # Mean difference of two thumbnails, of 255, below which they are one photo saved twice.
    return one.size == other.size and float(np.abs(small.astype(np.int16) - its).mean()) < 1.5


def smaller(photo: Photo, most: int) -> Photo:
    """The photo with at most so many pixels; ``photo-made-smaller`` among its warnings where it had more."""
    width, height = photo.size
    if width * height <= most:
        return photo
    scale = (most / (width * height)) ** 0.5
    size = (max(int(width * scale), 1), max(int(height * scale), 1))
    pixels = np.asarray(cv2.resize(photo.pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
    return replace(photo, pixels=pixels, warnings=(*photo.warnings, "photo-made-smaller"), steps=None)


STRANGE = 0.58
"""Distance of descriptors from which on two photos show two people (``benchmarks.strangers``)."""
SQUARELY_DEG = 52.0
"""Turn of the head up to which the identity network knows people: photos of one person are 0.45 apart at most up to
there, in profile up to 0.88, as far as strangers."""


def strangers_among(views: Sequence[View], recogniser: Recogniser) -> list[int]:
    """Indices of those who are not the person that most photos show; of profiles it cannot be told."""
    squarely = [k for k, view in enumerate(views) if abs(turn_deg(view.face)) < SQUARELY_DEG]
    if len(squarely) < 2:
        return []
    faces = ((views[k].photo.pixels, views[k].face.landmarks) for k in squarely)
    codes = [recogniser.embed(*face).astype(np.float64) for face in faces]
    return [squarely[k] for k in apart_from_most(codes, STRANGE)]


def apart_from_most(codes: Sequence[Float64], threshold: float) -> list[int]:
    """Indices of the descriptors (128,) that belong to nobody of the largest group; of two that differ, the second.

    One belongs to the group if it is close to any of it: photos from the left and from the right know each other only
    by those in between.
    """
    from scipy.sparse.csgraph import connected_components

    apart = np.array([[distance(one, other) for other in codes] for one in codes])
    near = apart < threshold
    middle = max(range(len(codes)), key=lambda k: (int(near[k].sum()), -float(np.median(apart[k])), -k))
    group = connected_components(near, directed=False)[1]
    return [k for k in range(len(codes)) if group[k] != group[middle]]


def of_one_person(
    gathered: Gathered,
    find: Callable[[Photo], Face],
    recogniser: Callable[[], Recogniser],
    leave_out: Literal["strangers"] | None,
) -> Gathered:
    """The face in each photo, all of one person.

    Args:
        gathered: the photos.
        find: the face in one of them; may refuse it.
        recogniser: the identity network, asked for only where there are several photos.
        leave_out: whether strangers are left out, not refused.

    Raises:
        NoUsableFace: no photo shows one, or one of its subclasses; ``Strangers`` where some show another person.
    """
    faces: list[Face] = []
    errors: dict[int, AvatarError] = {}
    for place, photo in enumerate(gathered.photos):
        try:
            faces.append(find(photo))
        except NoUsableFace as error:
            errors[place] = error
    gathered = gathered.without(errors)
    views = tuple(View(photo, face) for photo, face in zip(gathered.photos, faces, strict=True))
    gathered = replace(gathered, views=views)
    strange = strangers_among(views, recogniser()) if len(views) > 1 else []
    if not strange:
        return gathered
    if leave_out is None:
        named = ", ".join(str(number + 1) for number in sorted(gathered.numbers[k] for k in strange))
        raise Strangers(
            f"photo {named} of {gathered.count} shows another person than the rest; take it away, or leave strangers "
            "out",
            photos=sorted(gathered.numbers[k] for k in strange),
        )
    other = Strangers("it shows another person than the rest")
    return gathered.without(dict.fromkeys(strange, other))


def read_view(view: View, readers: Readers, head: HeadModel) -> View:
    """With all that is read off a photo; again, where that shows that the landmarks of a profile are a guess."""
    pixels, face = view.photo.pixels, view.face
    reading = read_face(pixels, face.landmarks, readers)
    if reading is not None and (turned := turned_further(face, reading, head)) is not face:
        face, reading = turned, read_face(pixels, turned.landmarks, readers)
    return replace(view, face=face, reading=reading)


def read_all(gathered: Gathered, readers: Readers, head: HeadModel) -> Gathered:
    """:func:`read_view` of each photo."""
    return replace(gathered, views=tuple(read_view(view, readers, head) for view in gathered.views))


def fitted(gathered: Gathered, head: HeadModel, settings: FitSettings) -> Gathered:
    """The head in each photo that can be fitted, the best photo first, the others by content.

    Raises:
        FitFailed: none can; why the last cannot.
    """
    while True:
        try:
            fits = fit_views(gathered.views, head, settings)
        except FitFailed as error:
            gathered = gathered.without({int(error.extra.pop("view")): error})
            continue
        best = best_view(gathered.views, fits)
        places = [best, *(k for k in range(len(fits)) if k != best)]
        return replace(gathered.only(places, ()), fits=tuple(fits[k] for k in places))


def best_view(views: Sequence[View], fits: Sequence[Fit]) -> int:
    """The photo that shows most of the face, large and squarely: its expression, eyes and light are the avatar's."""

    def merit(index: int) -> float:
        fit = fits[index]
        squarely = max(-float(fit.camera.rotation[2, 2]), 0.0)
        # Distance of the eyes, pixels, beyond which a larger face tells no more.
        size = min(fit.inter_ocular_px, 250.0)
        doubt = 0.5 if {"low-confidence", "gaze-not-seen"} & set(fit.warnings) else 1.0
        hidden = 0.5 if "eyes-covered" in views[index].face.warnings else 1.0
        return squarely**2 * size * doubt * hidden

    return max(range(len(fits)), key=lambda index: (merit(index), -index))
