"""Teeth, gums and tongue as meshes with pictures of their own, in the photo's tooth colour."""

from __future__ import annotations

import numpy as np

from service.anatomy.canvas import Canvas, smooth_noise
from service.anatomy.items import Inset, fits, following, read_insets
from service.anatomy.mouth_painting import GUMS, TONGUE
from service.arrays import Float32, UInt8
from service.face.features.mouth import TOOTH
from service.face.fit.fit import Fit
from service.head.model import HeadModel
from service.materials.material import Material, OwnMap
from service.materials.part import MeshPart

SIZE, TONGUE_SIZE = 1024, 512
"""Sides of the pictures of teeth and gums, and of the tongue, texels."""
REPLACES = {"teeth_upper_gums": "teeth_upper", "teeth_lower_gums": "teeth_lower", "tongue_body": "tongue"}
"""Meshes of the file, and the head's own part in place of which each stands."""

NECK, NECK_COLOUR = (0.62, 1.0), (0.10, 0.16, 0.26)
"""Places along a crown between which dentine shows through, and the share of red, green and blue that is lost there."""
EDGE, EDGE_COLOUR = 0.16, (0.16, 0.10, 0.04)
"""Length of the translucent biting edge along a crown, and the share lost at its end: the dark mouth shines through."""
BETWEEN = (0.50, 0.62, 0.66)
"""Share of red, green and blue that is lost deep between two teeth."""
MARGIN, MARGIN_LIGHT = 0.35, 0.25
"""Gums next to teeth are paler: how much, and the noise on gums, both as shares of their colour."""
GROOVE, PAPILLAE, UNDERSIDE = 0.22, 0.10, (1.0, 0.82, 0.86)
"""Depth of the median groove of the tongue and amplitude of its papillae as shares of the colour; factors on its
underside, whose thin mucosa is redder."""
ENAMEL_MM, MUCOSA_MM = (0.9, 0.75, 0.55), (2.2, 0.8, 0.5)
"""Mean free paths of red, green and blue in teeth, whose edges glow, and in the wet flesh of the mouth."""
ROOT = 0.35
"""Share of the tongue's light that is lost at its root, which is coated and lies in the throat."""


def mouth_parts(head: HeadModel, fit: Fit, tooth: Float32 | None, step: int = 1) -> tuple[MeshPart, ...]:
    """Teeth, gums and tongue; nothing for a head that they were not made for.

    Args:
        head: topology, chart and units.
        fit: vertices of the head.
        tooth: (3,) linear albedo of the teeth; None: the usual one.
        step: by which the sides of the pictures are divided.
    """
    insets = read_insets()
    if not fits(insets, head):
        return ()
    rows = [mesh for mesh in insets.meshes if mesh.name.startswith("teeth")]
    tongue = next(mesh for mesh in insets.meshes if mesh.name.startswith("tongue"))
    crowns = teeth_picture(rows, TOOTH if tooth is None else tooth, SIZE // step)
    mucosa = OwnMap("tongue", tongue_picture(tongue, TONGUE_SIZE // step))
    enamel = Material("teeth", colour_map=OwnMap("teeth", crowns), roughness=0.18, ior=1.6, subsurface_mm=ENAMEL_MM)
    flesh = Material("tongue", colour_map=mucosa, roughness=0.35, ior=1.4, subsurface_mm=MUCOSA_MM)
    return tuple(
        following(
            mesh.name, head, fit, insets.fitted_head, mesh.rest, mesh.moved, mesh.faces, mesh.uv,
            flesh if mesh is tongue else enamel, uv_faces=mesh.uv_faces,
            bone="head" if mesh.name == "teeth_upper_gums" else "jaw", replaces=(REPLACES[mesh.name],),
        )
        for mesh in (*rows, tongue)
    )  # fmt: skip


def teeth_picture(rows: list[Inset], tooth: Float32, size: int = SIZE) -> UInt8:
    """(size, size, 3) uint8 sRGB of both rows on their common picture.

    Args:
        rows: upper and lower row.
        tooth: (3,) linear albedo.
        size: of a side, texels.
    """
    canvas = Canvas(size)
    for row in rows:
        at, values = canvas.texels(row.uv, row.uv_faces, row.faces, np.c_[row.along, row.shade, row.rest * 1e3])
        along, shade, place = values[:, 0], values[:, 1], values[:, 2:]
        neck = np.clip((along - NECK[0]) / (NECK[1] - NECK[0]), 0, 1)[:, None] ** 1.5
        edge = np.exp(-((np.maximum(along, 0) / EDGE) ** 2))[:, None]
        between = ((1 - np.clip(shade, 0, 1)) ** 1.5)[:, None]
        enamel = tooth * (1 - neck * np.array(NECK_COLOUR)) * (1 - edge * np.array(EDGE_COLOUR))
        enamel = enamel * (1 - between * np.array(BETWEEN))
        noise = smooth_noise(place, (0.5, 1.1, 2.4), seed=1)[:, None]
        gums = GUMS * (1 + MARGIN_LIGHT * noise) * (1 + MARGIN * np.clip(1 + along, 0, 1)[:, None])
        canvas.put(at, np.where(along[:, None] < 0, gums, enamel))
    return canvas.picture()


def tongue_picture(tongue: Inset, size: int = TONGUE_SIZE) -> UInt8:
    """(size, size, 3) uint8 sRGB of the tongue."""
    canvas = Canvas(size)
    at, values = canvas.texels(tongue.uv, tongue.uv_faces, tongue.faces, np.c_[tongue.along, tongue.rest * 1e3])
    along, place = values[:, 0], values[:, 1:]
    below = (at % size) >= size // 2
    groove = GROOVE * np.exp(-((place[:, 0] / 1.2) ** 2)) * np.clip(along * 4, 0, 1)
    papillae = PAPILLAE * smooth_noise(place, (4.5, 7.0, 11.0), seed=2)
    light = (1 - groove) * (1 + papillae) * (1 - ROOT * along**2)
    top = TONGUE * light[:, None]
    under = TONGUE * np.array(UNDERSIDE) * (1 - ROOT * along[:, None] ** 2)
    canvas.put(at, np.where(below[:, None], under, top))
    return canvas.picture()
