"""``LICENSES.md``: terms of use of an archive, and the data files it was computed with."""

from __future__ import annotations

from service.archive.avatar import Avatar
from service.archive.version import GENERATOR

COPYRIGHT = "No rights are claimed by the makers of this program; those of the person shown remain. See LICENSES.md"

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
