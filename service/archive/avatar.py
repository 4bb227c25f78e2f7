"""What goes into an archive: one photo's results, gathered by the pipeline."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from service.face.face import Face
from service.face.fit.result import Fit
from service.head.model import HeadModel
from service.photo.photo import Photo
from service.reflectance.result import Reflectance
from service.texture.result import Texture


@dataclass(frozen=True)
class ModelCard:
    """One data file that took part.

    Attributes:
        name: as a user would look it up.
        sha256: hex digest of the file.
        licence: SPDX identifier.
        role: what it did ("head model", "face detector", ...).
    """

    name: str
    sha256: str
    licence: str
    role: str = ""


@dataclass(frozen=True)
class Similarity:
    """How alike the rendered head and the photo look to the identity network.

    A raw cosine of this network says nothing by itself (all faces score high), so the numbers come with the
    distribution of the same numbers between different people.

    Attributes:
        distance: Euclidean distance of the two descriptors; the network's authors call < 0.6 the same person.
        centred_cosine: cosine after subtracting the population mean, in [-1, 1].
        impostor: facts of the distribution between different people, for example ``centred_cosine_mean``,
            ``centred_cosine_p95``, ``distance_mean``, ``distance_p05``, ``pairs``.
    """

    distance: float
    centred_cosine: float
    impostor: Mapping[str, float]


@dataclass(frozen=True)
class Given:
    """What a head of one's own was made of, in place of a photo.

    Attributes:
        texture_sha256, mesh_sha256: hex digests of both files as they came in.
        size: (width, height) of the texture in pixels.
    """

    texture_sha256: str
    mesh_sha256: str
    size: tuple[int, int]

    @classmethod
    def of(cls, texture: bytes, mesh: bytes, size: tuple[int, int]) -> Given:
        """Of the bytes of both files."""
        return cls(hashlib.sha256(texture).hexdigest(), hashlib.sha256(mesh).hexdigest(), size)


@dataclass(frozen=True)
class Avatar:
    """Everything that one photo gave, or a texture and a mesh.

    Attributes:
        photo: the upright photo; its pixels go into ``preview/overlay.jpg`` only.
        face: the face that was fitted.
        head: the head model; ``fit`` indexes its vertices.
        fit: pose, shape, expression, light.
        texture: the maps.
        options: what the caller asked for, JSON values only.
        seed: of every random choice.
        models: data files that took part.
        reflectance: what the networks made of the texture, or None where nothing of it was asked for.
        given: None for a photo. Else there was none and nothing was fitted: of ``photo``, ``face`` and ``fit`` only the
            texture's pixels and the vertices mean something, and the manifest has null for them.
        similarity: identity check, or None where it did not run.
        effects: names of the effects that were simulated in the previews, empty while there are none.
        warnings: stable codes of the run; those of photo, face, fit and texture are added by themselves.
        timings_s: seconds per stage; only written to the archive when asked for, see ``docs/archive.md``.
        peak_rss_mb: the same for memory.
    """

    photo: Photo
    face: Face
    head: HeadModel
    fit: Fit
    texture: Texture
    options: Mapping[str, Any]
    seed: int
    models: tuple[ModelCard, ...]
    similarity: Similarity | None = None
    given: Given | None = None
    reflectance: Reflectance | None = None
    effects: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    timings_s: Mapping[str, float] = field(default_factory=dict)
    peak_rss_mb: float | None = None

    def all_warnings(self) -> tuple[str, ...]:
        """Warnings of every stage in the order of the pipeline, each once."""
        stages = (self.photo, self.face, self.fit, self.texture, self)
        return tuple(dict.fromkeys(code for stage in stages for code in stage.warnings))
