"""``LICENSES.md``: terms of use of an archive, and the data files it was computed with."""

from __future__ import annotations

from pathlib import Path

from service import GENERATOR
from service.anatomy.items import FILE as ITEMS_FILE
from service.archive.avatar import Avatar
from service.archive.manifest import Model
from service.hair.bank import FILE as BANK_FILE
from service.head.files import DEFAULT_HEAD
from service.head.model import HeadModel
from service.reflectance.albedo.albedo_prior import FILE as PRIOR_FILE
from service.reflectance.albedo.diffuse_albedo import LIGHT_NETWORK
from service.runtime.network_registry import REGISTRY, networks_of
from service.runtime.sessions import model_table

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
) -> tuple[Model, ...]:
    """Cards of the head model and of the networks that ran.

    Args:
        head: the head model.
        head_file: where it was read from; None for the shipped one.
        networks: names of the reflectance networks that ran.
        photo: whether the networks that see photos ran.

    Raises:
        ModelFault: the table of networks is broken.
    """
    from hashlib import sha256

    table = model_table()
    digest = sha256((head_file or DEFAULT_HEAD).read_bytes()).hexdigest()
    cards = [Model(head.name, digest, head.licence, "head model")]
    if photo:
        cards += [
            Model("makehuman-wearables", sha256(ITEMS_FILE.read_bytes()).hexdigest(), "CC0-1.0", "lashes, brows, bust"),
            Model("hair-styles", sha256(BANK_FILE.read_bytes()).hexdigest(), "Apache-2.0", "styles of hair"),
        ]
    ran = {*networks, *(networks_of("detect", "read", "compare") if photo else ())}
    for one in REGISTRY:
        if one.name in ran and one.name in table:
            cards.append(Model(one.name, table[one.name]["sha256"], table[one.name]["licence"], one.role))
    if LIGHT_NETWORK in networks:
        digest = sha256(PRIOR_FILE.read_bytes()).hexdigest()
        cards.append(Model("albedo-prior", digest, "Apache-2.0", "AvatarMe's texture prior: unseen albedo"))
    return tuple(cards)
