"""Contents of an archive: the results of the photos of one person, or of an external mesh and texture; the data files
they were computed with, and the terms of use (``LICENSES.md``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

from service import GENERATOR
from service.anatomy.items import FILE as ITEMS_FILE
from service.arrays import UInt8
from service.face.finder import Face
from service.face.fit.fit import Fit
from service.hair.bank import FILE as BANK_FILE
from service.hair.groom import Groom
from service.hair.worn_hair import WornHair
from service.head.files import DEFAULT_HEAD
from service.head.model import HeadModel
from service.manifest import Given, IdentitySimilarity, LeftOut, ModelEntry
from service.materials.part import MeshPart, check_parts, head_parts
from service.photo.photo import Photo
from service.reflectance.albedo.albedo_prior import FILE as PRIOR_FILE
from service.reflectance.albedo.diffuse_albedo import LIGHT_NETWORK
from service.reflectance.reflectance_maps import Reflectance
from service.reflectance.surface_maps import SurfaceMaps
from service.runtime.network_registry import REGISTRY, networks_of
from service.runtime.sessions import model_table
from service.texture.texture import Texture
from service.words import WarningCode


@dataclass(frozen=True)
class Source:
    """One of the photos, upright, that an avatar was made from, with the person's face in it and the fit of the head.

    ``used_for`` is what it told: "shape", "texture", "albedo", "detail", and of the first "expression", "eyes", "hair";
    ``share`` how much of the seen texture it shows, in [0, 1].
    """

    photo: Photo
    face: Face
    fit: Fit
    used_for: tuple[str, ...]
    share: float


View = tuple[str, UInt8]
"""Caption and (h, w, 3) uint8 sRGB picture."""


@dataclass(frozen=True)
class Drawn:
    """What an archive shows of an avatar and packs of its parts, without any map but texture and albedo.

    Attributes:
        overlay: (h, w, 3) uint8 sRGB, the head over the photo; None without a photo.
        textured: views of the head in the photo's light.
        in_lamps: in other light; empty without albedo.
        clay: of its shape.
        textures: PNG of each texture of a part's own, by its name.
    """

    overlay: UInt8 | None
    textured: tuple[View, ...]
    in_lamps: tuple[View, ...]
    clay: tuple[View, ...]
    textures: Mapping[str, bytes]


@dataclass(frozen=True)
class Shapes:
    """Meshes that are drawn, and their text: OBJ of the head, and of its parts, and USD up to the materials."""

    drawn: list[MeshPart]
    head: bytes
    parts: bytes
    usda: str


@dataclass(frozen=True)
class Avatar:
    """All results of the photos of one person, or of an external mesh and texture.

    Attributes:
        photo: the upright photo whose expression, eyes, hair and light the avatar has; of several the best. Its pixels
            go into ``preview/overlay.jpg`` only.
        face: the face that was fitted in it.
        head: the head model; ``fit`` indexes its vertices.
        fit: pose, shape, expression, light in that photo.
        texture: the maps.
        sources: all photos that were used, ``photo`` first; empty for an external mesh.
        left_out: photos that were given and not used.
        options: as requested, JSON values only.
        seed: of every random choice.
        models: data files that were used.
        reflectance: maps computed by the networks, or None where none was requested.
        surface: roughness, cavity and thickness, or None where none was requested.
        given: None for a photo. Otherwise nothing was fitted: of ``photo``, ``face`` and ``fit`` only the texture's
            pixels and the vertices are meaningful, and the manifest has null for them.
        parts: meshes beside the head's own: hair, lashes, teeth and the like; ``check_parts`` holds for them.
        hair: what the photo told of the hair; None for an external mesh.
        beard: its strands; None without one.
        own_texture: (H, W, 3) sRGB, the texture at the photo's resolution; None: it has no more than the texture.
        similarity: identity check, or None where it did not run.
        warnings: stable codes of the run; :meth:`all_warnings` adds those of photo, face, fit and texture.
        drawn, shapes: what was drawn and written of it while its maps were made; None: nothing was.
        timings_s: seconds per stage; not written to the archive, see ``docs/archive.md``.
    """

    photo: Photo
    face: Face
    head: HeadModel
    fit: Fit
    texture: Texture
    options: Mapping[str, Any]
    seed: int
    models: tuple[ModelEntry, ...]
    sources: tuple[Source, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    parts: tuple[MeshPart, ...] = ()
    hair: WornHair | None = None
    beard: Groom | None = None
    similarity: IdentitySimilarity | None = None
    given: Given | None = None
    reflectance: Reflectance | None = None
    surface: SurfaceMaps | None = None
    own_texture: UInt8 | None = None
    warnings: tuple[WarningCode, ...] = ()
    drawn: Drawn | None = None
    shapes: Shapes | None = None
    timings_s: Mapping[str, float] = field(default_factory=dict)

    def all_warnings(self) -> tuple[WarningCode, ...]:
        """Warnings of every stage in the order of the pipeline, each once."""
        stages = (self.photo, self.face, self.fit, self.texture, self)
        return tuple(dict.fromkeys(code for stage in stages for code in stage.warnings))


def drawn_parts(avatar: Avatar) -> list[MeshPart]:
    """The head's own parts, without those that others replace, and the others.

    NumericFault: a vertex is not finite, or names are ambiguous.
    """
    own = head_parts(avatar.head, avatar.fit.vertices, avatar.fit.neutral)
    check_parts(avatar.parts, [part.name for part in own])
    replaced = {name for part in avatar.parts for name in part.replaces}
    return [*(part for part in own if part.name not in replaced), *avatar.parts]


_TEXT = """\
# Licences

Made by {generator} from one photo.

## What you may do with these files

- **Geometry, chart and blendshapes** come from the head model *{head}*, licence {licence}. {head_terms}
- **Textures and previews** hold what your photo shows. The makers of this program claim no right in them; what you may
  do with them is what you may do with the photo. The person shown has a right to their own likeness: ask before you
  publish or animate it.
- **Parts that the photo did not show** are mirrored or made up; `maps/confidence.png` says where. This is a synthetic
  image of a person: say so where people could take it for a photograph.
- `preview/overlay.jpg` contains a part of the photo itself.

## What made them

| data file | role | licence | sha256 |
|---|---|---|---|
{rows}

The networks were run, not copied: none of their weights are in this archive. The landmark and identity networks are not
meant for identifying people.
"""

_GIVEN = (
    _TEXT[: _TEXT.index("- **Textures")].replace("one photo", "a texture and a mesh that were given")
    + """\
- **Shape, textures and previews** are made of the texture and the mesh that you gave. The makers of this program claim
  no right in them; what you may do with them is what you may do with those two.

"""
    + _TEXT[_TEXT.index("## What made them") : _TEXT.index(" The landmark")]
    + "\n"
)

_PUBLIC_DOMAIN = "You may use, change and sell them without asking and without naming anyone."
_OTHER = "Its terms hold for them too."


def licences_text(avatar: Avatar) -> str:
    """Markdown for the archive."""
    head = avatar.head
    rows = [f"| {card.name} | {card.role} | {card.licence} | `{card.sha256}` |" for card in avatar.models]
    return (_GIVEN if avatar.given else _TEXT).format(
        generator=GENERATOR,
        head=head.name,
        licence=head.licence,
        head_terms=_PUBLIC_DOMAIN if head.licence == "CC0-1.0" else _OTHER,
        rows="\n".join(rows),
    )


def model_cards(
    head: HeadModel, head_file: Path | None = None, networks: tuple[str, ...] = (), *, photo: bool = True
) -> tuple[ModelEntry, ...]:
    """Cards of the head model and of the networks that ran, with ``photo`` of those that see photos too.

    ``head_file`` is where the head model was read from, None for the shipped one. ModelFault: the table of networks is
    broken.
    """
    table = model_table()
    digest = sha256((head_file or DEFAULT_HEAD).read_bytes()).hexdigest()
    cards = [ModelEntry(head.name, digest, head.licence, "head model")]
    if photo:
        cards += [
            ModelEntry(name, sha256(file.read_bytes()).hexdigest(), licence, role)
            for name, file, licence, role in (
                ("makehuman-wearables", ITEMS_FILE, "CC0-1.0", "lashes, brows, bust"),
                ("hair-styles", BANK_FILE, "Apache-2.0", "styles of hair"),
            )
        ]
    ran = {*networks, *(networks_of("detect", "read", "compare") if photo else ())}
    for one in REGISTRY:
        if one.name in ran and one.name in table:
            cards.append(ModelEntry(one.name, table[one.name]["sha256"], table[one.name]["licence"], one.role))
    if LIGHT_NETWORK in networks:
        digest = sha256(PRIOR_FILE.read_bytes()).hexdigest()
        cards.append(ModelEntry("albedo-prior", digest, "Apache-2.0", "AvatarMe's texture prior: unseen albedo"))
    return tuple(cards)
