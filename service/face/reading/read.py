"""All that is read off one face: every pixel's place, normal and part; edges of lids and lips; expression scores."""

from __future__ import annotations

import logging
from dataclasses import replace

from service.arrays import Float64, UInt8
from service.errors import NumericFault
from service.face.reading.openings import OpeningsNetwork
from service.face.reading.person import PersonNetwork, with_person
from service.face.reading.reader import AROUND_ABOVE, AROUND_FILL, ReaderNetwork, Reading, crop_of
from service.face.reading.scores import Landmarker

log = logging.getLogger(__name__)


class Readers:
    """The networks that read a face.

    Args:
        pixels: of places, normals and parts; None for the shipped one.
        openings: of lids and lips; None for the shipped ones.
        scores: of points and expression; None for the shipped ones.
        person: that tells a person from what is behind; True for the shipped one, False for none.
    """

    def __init__(
        self, pixels: ReaderNetwork | None = None, openings: OpeningsNetwork | None = None,
        scores: Landmarker | None = None, person: PersonNetwork | bool = True,
    ) -> None:  # fmt: skip
        self.pixels = pixels or ReaderNetwork()
        self.openings = openings or OpeningsNetwork()
        self.scores = scores or Landmarker()
        self.person = (PersonNetwork() if person else None) if isinstance(person, bool) else person


def read_face(pixels: UInt8, landmarks: Float64, readers: Readers) -> Reading | None:
    """Read the face with landmarks (468, 3) in an (H, W, 3) uint8 sRGB photo.

    None where the landmarks give no crop or the network of pixels gives no numbers; openings and scores of which the
    networks give none are missing, and without numbers of the person the parts stay as the first network says.
    """
    region, wide = crop_of(landmarks), crop_of(landmarks, AROUND_FILL, AROUND_ABOVE)
    try:
        reading = None if region is None else readers.pixels(pixels, region)
        around = None if wide is None else readers.pixels(pixels, wide)
    except NumericFault as fault:
        log.warning("the face is not read: %s", fault)
        return None
    if reading is None:
        return None
    reading = replace(reading, around=around)
    if readers.person is not None:
        reading = with_person(pixels, reading, readers.person)
    return replace(
        reading,
        openings=readers.openings(pixels, landmarks),
        scores=readers.scores(pixels, landmarks),
    )
