"""Who sits for the photos: real shapes with real skins, some of them with painted beards and brows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from benchmarks.corrections import hair
from benchmarks.heads import EYE_RADIUS_M, IctHeads, Skin, TexturedHead, at_places, subdivided, varied
from benchmarks.shoot import FFHQ_EYES_M, ffhq_head, ict_places, landmarks_on
from benchmarks.subjects import scan
from models.lightstage.references import linear, read

Float = npt.NDArray[np.float64]

SkinName = Literal["ffhq", "hifi3d 1", "hifi3d 2", "hifi3d 3"]
HIFI3D: Mapping[str, str] = {"hifi3d 1": "albedo.png", "hifi3d 2": "albedo_1.png", "hifi3d 3": "albedo_2.png"}
DARK_TONE = 113
"""Seed of ``benchmarks.heads.varied`` whose skin is among its darkest."""
BORDER = 32.0
"""Texels over which the faces of hifi3d go over into the rest of a head."""
SHUT: Mapping[str, float] = {"eyeBlink_L": 1.0, "eyeBlink_R": 1.0}
SMILE: Mapping[str, float] = {
    f"{unit}_{side}": weight
    for unit, weight in (("mouthSmile", 0.9), ("cheekSquint", 0.6), ("cheekRaiser", 0.5), ("mouthDimple", 0.3))
    for side in "LR"
}
BEHIND_LIDS_M = 0.006
"""By how much eyeballs stand back behind shut lids, so that nothing of them shows."""


@dataclass(frozen=True)
class Sitter:
    """One person.

    Attributes:
        shape: "ffhq" and "scan" are one head each; else a seed of ICT-FaceKit's identities, none with remainder 2 when
            divided by 3, as those come with expressions of their own.
        skin: whose albedo; the scan has its own.
        dark: the same skin in a dark tone.
        expression: ICT-FaceKit's units by weight.
        beard, brows: linear albedo of the hair; None: what the skin has.
    """

    shape: int | Literal["ffhq", "scan"]
    skin: SkinName = "ffhq"
    dark: bool = False
    expression: Mapping[str, float] = field(default_factory=dict)
    beard: tuple[float, float, float] | None = None
    brows: tuple[float, float, float] | None = None


class Studio:
    """Makes sitters out of a folder of reference heads.

    Args:
        data: the folder.
        out: keeps what takes long to make.
    """

    def __init__(self, data: Path, out: Path) -> None:
        self._data, self._out = data, out

    def head(self, sitter: Sitter) -> TexturedHead:
        """The head of a sitter, in metres, with linear colours."""
        if sitter.shape == "scan":
            return scan(self._data, self._out)[0]
        if sitter.shape == "ffhq":
            return ffhq_head(replace(self._skin, texture=self._texture(sitter.skin)))
        vertices, eyes = self._ict.posed(sitter.shape, sitter.expression)
        landmarks = vertices[self._ict.landmarks]
        colours = at_places(self._texture(sitter.skin), self._places)
        colours = varied(colours, DARK_TONE) if sitter.dark else colours
        back = BEHIND_LIDS_M if sitter.expression == SHUT else 0.0
        fine, triangles = subdivided(vertices, self._ict.triangles, 2)
        head = TexturedHead(f"ict{sitter.shape}", fine, triangles, colours, eyes - [0, 0, back], EYE_RADIUS_M)
        rng = np.random.default_rng(sitter.shape)
        if sitter.brows is not None:
            head = hair.painted(head, hair.brows(landmarks, rng), sitter.brows)
        if sitter.beard is not None:
            head = hair.painted(head, hair.beard(landmarks, rng), sitter.beard)
        return head

    @cached_property
    def _skin(self) -> Skin:
        return Skin.load(self._data / "ffhq_uv_head")

    @cached_property
    def _ict(self) -> IctHeads:
        return IctHeads(self._data / "ict_facekit_head.npz")

    @cached_property
    def _places(self) -> Float:
        cached = (self._out / "places.npy").is_file()
        reference = ffhq_head(self._skin)
        landmarks = np.zeros((0, 3)) if cached else landmarks_on(reference, self._out, "reference_skin")
        return ict_places(self._ict, self._skin, landmarks, FFHQ_EYES_M.mean(0), self._out)

    def _texture(self, skin: str) -> Float:
        if skin == "ffhq":
            return self._skin.texture
        return whole_skin(linear(read(self._data / "hifi3d_uv" / HIFI3D[skin])), self._skin.texture)


def whole_skin(face: Float, rest: Float) -> Float:
    """(H, W, 3) linear skin of a face (H, W, 3), and where that is 0, of a whole head in the tone of the face."""
    import cv2

    around = cv2.resize(rest, face.shape[1::-1], interpolation=cv2.INTER_CUBIC).clip(0, 1)
    painted = face.max(2) > 0
    tone = np.median(face[painted], 0) / np.median(around[painted], 0)
    inside = cv2.distanceTransform(painted.astype(np.uint8), cv2.DIST_L2, 3)
    share = np.clip(inside / BORDER, 0, 1)[..., None]
    return np.asarray(np.clip(share * face + (1 - share) * around * tone, 0, 1), np.float64)
