"""Similarity of the finished head and the photo by the identity network.

The head is rendered from the front whatever the pose in the photo, so that the score depends on shape and texture;
rendered in the photo's own pose, any shape would reproduce the photo that was projected onto it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.arrays import UInt8
from service.colour import bytes_to_linear
from service.face.finder import Face
from service.face.fit.fit import Fit
from service.face.fit.landmark_fit import at_barycentric
from service.face.identity import Recogniser, centred_cosine, distance, population
from service.head.model import HeadModel
from service.manifest import IdentitySimilarity
from service.materials.part import MeshPart
from service.photo.photo import Photo
from service.render.draw import see
from service.render.drawn import DrawnHead
from service.render.sketch import over, sketch
from service.render.view import turned_camera

SIZE = (240, 300)
"""Width and height of the render, pixels; the network takes a crop of 150 pixels."""
SAMPLES = 1.5
"""Samples per pixel and axis."""
GREY = np.full((1, 1, 3), 0.5, np.float32)


def likeness(
    photo: Photo, face: Face, head: HeadModel, fit: Fit, texture: UInt8, recogniser: Recogniser,
    parts: Sequence[MeshPart] = (),
) -> IdentitySimilarity:  # fmt: skip
    """Distance and centred cosine between the photo, with the face's landmarks in it, and a frontal render of the head.

    The texture is (h, w, 3) uint8 sRGB on the chart; hair and other ``parts`` are coloured as in the photo's light.
    """
    camera = turned_camera(fit.vertices, 0.0, *SIZE)
    colours = bytes_to_linear(texture)
    seen = see(DrawnHead.of(head, fit.vertices, parts), camera, SAMPLES, colours)
    picture = over(*sketch(seen, seen.read(colours)), GREY)
    pixels = (picture * 255.0 + 0.5).astype(np.uint8)
    corners = head.triangles[head.landmark_triangle]
    landmarks = camera.project(at_barycentric(fit.vertices, corners, head.landmark_barycentric))
    theirs = recogniser.embed(photo.pixels, face.landmarks)
    ours = recogniser.embed(pixels, landmarks)
    return IdentitySimilarity(distance(theirs, ours), centred_cosine(theirs, ours), population().impostor)
