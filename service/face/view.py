"""One photo of a person, and what was found and read in it."""

from __future__ import annotations

from dataclasses import dataclass

from service.face.face import Face
from service.face.reading.reader import Reading
from service.photo.photo import Photo


@dataclass(frozen=True)
class View:
    """One photo of a person.

    Attributes:
        photo: upright.
        face: the person's, landmarks in photo pixels.
        reading: what was read off it (:func:`service.face.reading.read.read_face`); None: nothing.
    """

    photo: Photo
    face: Face
    reading: Reading | None = None
