"""Teeth, gums and tongue as meshes with pictures of their own, in the photo's tooth colour, and their file."""

from __future__ import annotations

import functools
import zipfile
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from service.anatomy.canvas import Canvas, smooth_noise
from service.anatomy.mouth_painting import GUMS, TONGUE
from service.arrays import AnyFloat, Float32, Int32, UInt8
from service.errors import ModelFault
from service.face.features.mouth import TOOTH
from service.face.fit.fit import Fit
from service.head.model import HeadModel
from service.materials.material import Material, OwnMap
from service.materials.part import MeshPart, targets_of

FILE = Path(__file__).resolve().parents[1] / "data" / "head" / "mouth.npz"
"""Teeth, gums and tongue; made by ``python -m models.people.inside``."""


@dataclass(frozen=True, eq=False)
class Inset:
    """One mesh.

    Attributes:
        name: of the part.
        rest: (N, 3) float32 metres in head space, on the head that it was made for.
        follow: (N, k) int32 vertices of the head; share: (N, k) float32 their weights, sum 1.
        faces: (F, 3) or (F, 4) int32, counter-clockwise from outside; uv_faces: the same into ``uv``.
        uv: (U, 2) float32 in [0, 1], origin bottom left.
        along: (N,) float32 in [0, 1] from the biting edge of a tooth to its gum, -1 on gums; on the tongue from the tip
            to the root.
        shade: (N,) float32 in [0, 1], 0 deep between two teeth and 1 in the open.
    """

    name: str
    rest: Float32
    follow: Int32
    share: Float32
    faces: Int32
    uv: Float32
    uv_faces: Int32
    along: Float32
    shade: Float32

    def moved(self, offsets: AnyFloat) -> Float32:
        """(N, 3) float32 metres by which it follows offsets (V, 3) of the head."""
        out = np.zeros((len(self.rest), 3))
        for k in range(self.follow.shape[1]):
            out += self.share[:, k : k + 1].astype(np.float64) * offsets[self.follow[:, k]]
        return np.asarray(out, np.float32)


@dataclass(frozen=True, eq=False)
class Insets:
    """Meshes, and the mean head (V, 3) float32 metres that they were made for."""

    meshes: tuple[Inset, ...]
    fitted_head: Float32


@functools.lru_cache(maxsize=2)
def read_insets(path: Path = FILE) -> Insets:
    """Read a file.

    Raises:
        ModelFault: it is missing or cannot be read.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        names = list(dict.fromkeys(key.partition(":")[0] for key in arrays if ":" in key))
        keys = [field.name for field in fields(Inset) if field.name != "name"]
        meshes = tuple(Inset(name, *(arrays[f"{name}:{key}"] for key in keys)) for name in names)
        return Insets(meshes, arrays["fitted_head"])
    except FileNotFoundError:
        raise ModelFault(f"{path} is missing; build it with python -m models.people.inside --assets FOLDER") from None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as fault:
        raise ModelFault(f"{path} cannot be read: {fault}") from fault


SIZE, TONGUE_SIZE = 1024, 512
"""Sides of the pictures of teeth and gums, and of the tongue, texels."""
REPLACES = {"teeth_upper_gums": "teeth_upper", "teeth_lower_gums": "teeth_lower", "tongue_body": "tongue"}
"""Meshes of the file, and the head's own part in place of which each stands."""
FITS_M = 0.02
"""Largest distance of a mean head's vertices from those of the head that the meshes were made for."""

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


def mouth_parts(head: HeadModel, fit: Fit, tooth: Float32 | None) -> tuple[MeshPart, ...]:
    """Teeth, gums and tongue; nothing for a head that they were not made for.

    Args:
        head: topology, chart and units.
        fit: vertices of the head.
        tooth: (3,) linear albedo of the teeth; None: the usual one.
    """
    insets = read_insets()
    if not _fits(insets, head):
        return ()
    rows = [mesh for mesh in insets.meshes if mesh.name.startswith("teeth")]
    tongue = next(mesh for mesh in insets.meshes if mesh.name.startswith("tongue"))
    crowns = teeth_picture(rows, TOOTH if tooth is None else tooth)
    enamel = Material("teeth", colour_map=OwnMap("teeth", crowns), roughness=0.18, ior=1.6, subsurface_mm=ENAMEL_MM)
    flesh = Material(
        "tongue", colour_map=OwnMap("tongue", tongue_picture(tongue)), roughness=0.35, ior=1.4, subsurface_mm=MUCOSA_MM
    )
    return tuple(_following(mesh, insets, head, fit, flesh if mesh is tongue else enamel) for mesh in (*rows, tongue))


def _fits(insets: Insets, head: HeadModel) -> bool:
    """Whether a head has the vertices that the meshes follow; other heads keep their own parts."""
    same = insets.fitted_head.shape == head.mean.shape
    return bool(same and np.abs(insets.fitted_head - head.mean).max() < FITS_M)


def _following(mesh: Inset, insets: Insets, head: HeadModel, fit: Fit, material: Material) -> MeshPart:
    """A mesh on the fitted head, with the units that move it."""
    return MeshPart(
        name=mesh.name,
        vertices=mesh.rest + mesh.moved(fit.vertices - insets.fitted_head),
        neutral=mesh.rest + mesh.moved(fit.neutral - insets.fitted_head),
        faces=mesh.faces,
        uv=mesh.uv,
        uv_faces=mesh.uv_faces,
        material=material,
        targets=targets_of(head, mesh.moved),
        bone="jaw" if mesh.name != "teeth_upper_gums" else "head",
        replaces=(REPLACES[mesh.name],),
    )


def teeth_picture(rows: list[Inset], tooth: Float32) -> UInt8:
    """(SIZE, SIZE, 3) uint8 sRGB of both rows on their common picture.

    Args:
        rows: upper and lower row.
        tooth: (3,) linear albedo.
    """
    canvas = Canvas(SIZE)
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


def tongue_picture(tongue: Inset) -> UInt8:
    """(TONGUE_SIZE, TONGUE_SIZE, 3) uint8 sRGB of the tongue."""
    canvas = Canvas(TONGUE_SIZE)
    at, values = canvas.texels(tongue.uv, tongue.uv_faces, tongue.faces, np.c_[tongue.along, tongue.rest * 1e3])
    along, place = values[:, 0], values[:, 1:]
    below = (at % TONGUE_SIZE) >= TONGUE_SIZE // 2
    groove = GROOVE * np.exp(-((place[:, 0] / 1.2) ** 2)) * np.clip(along * 4, 0, 1)
    papillae = PAPILLAE * smooth_noise(place, (4.5, 7.0, 11.0), seed=2)
    light = (1 - groove) * (1 + papillae) * (1 - ROOT * along**2)
    top = TONGUE * light[:, None]
    under = TONGUE * np.array(UNDERSIDE) * (1 - ROOT * along[:, None] ** 2)
    canvas.put(at, np.where(below[:, None], under, top))
    return canvas.picture()
