"""The fit of one photo alone."""

from __future__ import annotations

from service.face.finder import Face
from service.face.fit.fit import Fit, FitSettings
from service.face.fit.fit_face import fit_views
from service.face.reading.reader import Reading, View
from service.head.model import HeadModel
from service.photo.photo import Photo


def fit_face(
    face: Face, photo: Photo, head: HeadModel, settings: FitSettings | None = None, reading: Reading | None = None
) -> Fit:
    """Place the head model in one photo: :func:`fit_views` of it alone."""
    return fit_views([View(photo, face, reading)], head, settings)[0]
