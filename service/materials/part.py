"""Meshes with their materials: the head's own parts, and those beside it: hair, brows, lashes, teeth, eyes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from service.arrays import AnyFloat, AnyInt, Float32, Int32, Int64, UInt8
from service.errors import NumericFault
from service.geometry.mesh import area_normals, normalise
from service.head.files import split_polygons
from service.head.model import HeadModel
from service.materials.material import ChartMap, Material, OwnMap, checked_name

LEAST_M = 1e-6
"""Units that move a part by less are left out of its targets."""

Bone = Literal["neck", "head", "jaw", "eye_left", "eye_right"]
"""Joints of the skeleton."""


@dataclass(frozen=True, eq=False)
class MeshPart:
    """One mesh with one material, in metres, head space. Arrays are not to be changed.

    Attributes:
        name: of the mesh in every format, unlike all other parts of the avatar and of the head.
        vertices: (N, 3) float32 in the photo's expression; OBJ and previews show them.
        neutral: (N, 3) float32 without expression; GLB shows them.
        faces: (F, 3) or (F, 4) int32 vertex indices, counter-clockwise from outside; -1 in a fourth column marks a
            triangle. They are drawn in this order, so blended cards go from the inside out.
        uv: (U, 2) float32, origin bottom left. Of the part's own textures, or of the head's chart where the material's
            maps are ``ChartMap``; outside [0, 1] the texture's border is repeated.
        material: its surface.
        uv_faces: as ``faces``, indices into ``uv``; None where every vertex has one place on the texture, N = U.
        targets: (N, 3) float32 offsets from ``neutral`` at full activation, by ARKit's name of the unit; a unit that
            does not move the part is left out.
        bone: the joint that carries the part.
        replaces: names of the head's own parts in place of which this one stands; files and pictures leave those out.
        normals: (N, 3) float32 unit, with which a part is lit in every pose in place of those of its surface: cards of
            hair lie at all angles, and have those of the body of hair that they make up; the bust has the neck's where
            it meets that.
    """

    name: str
    vertices: Float32
    neutral: Float32
    faces: Int32
    uv: Float32
    material: Material
    uv_faces: Int32 | None = None
    targets: Mapping[str, Float32] = field(default_factory=dict)
    bone: Bone = "head"
    replaces: tuple[str, ...] = ()
    normals: Float32 | None = None

    def __post_init__(self) -> None:
        checked_name(self.name, "a part")
        count = len(self.vertices)
        if self.normals is not None and self.normals.shape != (count, 3):
            raise NumericFault(f"normals of the part {self.name} are {self.normals.shape}; ({count}, 3) is right")
        shaped = {"vertices": self.vertices, "neutral": self.neutral, **self.targets}
        for what, rows in shaped.items():
            if rows.shape != (count, 3) or not np.isfinite(rows).all():
                raise NumericFault(f"{what} of the part {self.name} is {rows.shape}; finite ({count}, 3) is right")
        if self.uv.ndim != 2 or self.uv.shape[1] != 2 or not np.isfinite(self.uv).all():
            raise NumericFault(f"uv of the part {self.name} has shape {self.uv.shape}; finite (U, 2) is right")
        _check_indices(self.name, self.faces, count)
        if self.uv_faces is None and len(self.uv) != count:
            raise NumericFault(f"the part {self.name} has {len(self.uv)} uv for {count} vertices, and no uv_faces")
        if self.uv_faces is not None:
            _check_indices(self.name, self.uv_faces, len(self.uv))
            if self.uv_faces.shape != self.faces.shape:
                raise NumericFault(f"faces and uv_faces of the part {self.name} differ in shape")

    @property
    def polygons(self) -> Int32:
        """(F, 4) int32 faces, -1 in the last column marks a triangle."""
        return _four(self.faces)

    @property
    def polygons_uv(self) -> Int32:
        """(F, 4) int32 as :attr:`polygons`, indices into ``uv``."""
        return _four(self.faces if self.uv_faces is None else self.uv_faces)

    @cached_property
    def turned(self) -> dict[str, Float32]:
        """(N, 3) offsets of the neutral unit normals at full activation, by unit; kept, as each format has them."""
        corners = split_polygons(self.polygons)
        still = part_normals(self, self.neutral, corners)
        return dict(zip(self.targets, normal_offsets(self, corners, still, list(self.targets.values())), strict=True))

    @property
    def own_maps(self) -> tuple[OwnMap, ...]:
        """Textures that become files of the archive."""
        return tuple(one for one in self.material.maps if isinstance(one, OwnMap))


def targets_of(head: HeadModel, moved: Callable[[Float32], AnyFloat], least_m: float = LEAST_M) -> dict[str, Float32]:
    """Targets of a mesh that follows a head, by unit; those that move it by less than ``least_m`` are left out.

    ``moved`` gives, for offsets (V, 3) of the head, those (N, 3) of the mesh, metres. Vertices that move less stay.
    """
    targets = {}
    for unit, offsets in zip(head.expression_names, head.expression, strict=True):
        own = np.asarray(moved(offsets), np.float32)
        own[np.abs(own).max(1) <= least_m] = 0
        if own.any():
            targets[unit] = own
    return targets


def check_parts(parts: Sequence[MeshPart], taken: Sequence[str]) -> None:
    """NumericFault where extra parts, their materials or textures share a name, or a part has one that is ``taken``."""
    names = [*taken, *(part.name for part in parts)]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise NumericFault(f"two parts of the avatar are named {doubled[0]}")
    for things in ([part.material for part in parts], [one for part in parts for one in part.own_maps]):
        known: dict[str, object] = {}
        for thing in things:
            if known.setdefault(thing.name, thing) != thing:
                raise NumericFault(f"two materials or two textures of the avatar's parts are named {thing.name}")


def coarser(parts: Sequence[MeshPart], step: int) -> tuple[MeshPart, ...]:
    """Parts whose own textures are reduced by area, ``step`` texels of a side to one; textures that are shared stay so.

    Colours are weighted by alpha, so that what is transparent does not bleed into the rest. Strands of hair are left as
    they are: their texture was drawn in the size that is wanted.
    """
    if step == 1:
        return tuple(parts)
    larger = (part for part in parts if part.material.strand_map is None)
    textures = {id(one): replace(one, pixels=_reduced(one.pixels, step)) for part in larger for one in part.own_maps}
    materials: dict[str, Material] = {}
    for part in parts:
        maps = part.material.slots.items()
        changed: dict[str, Any] = {f"{slot}_map": textures[id(one)] for slot, one in maps if id(one) in textures}
        materials.setdefault(part.material.name, replace(part.material, **changed))
    return tuple(replace(part, material=materials[part.material.name]) for part in parts)


def _reduced(pixels: UInt8, step: int) -> UInt8:
    height, width = (max(side // step, 1) for side in pixels.shape[:2])
    rows = pixels[: height * step, : width * step].reshape(height, step, width, step, -1).astype(np.float32)
    if rows.shape[-1] < 4:
        return np.asarray(np.rint(rows.mean((1, 3))), np.uint8).reshape(height, width, *pixels.shape[2:])
    weight = rows[..., 3:] + np.float32(1e-3)
    colour = (rows[..., :3] * weight).sum((1, 3)) / weight.sum((1, 3))
    return np.asarray(np.rint(np.concatenate([colour, rows[..., 3:].mean((1, 3))], -1)), np.uint8)


ROUND = 0.6
"""Share of the direction from the part's middle in the normals of masked cards."""


def part_triangles(polygons: Int32, like: Int32 | None = None) -> Int32:
    """(T, 3) triangles of polygons (F, 4), in their order; ``like``, of the same length, says which are triangles."""
    quads = (polygons if like is None else like)[:, 3] >= 0
    both = np.stack([polygons[:, [0, 1, 2]], polygons[:, [0, 2, 3]]], 1)
    return np.ascontiguousarray(both[np.stack([np.ones_like(quads), quads], 1)])


def is_cards(part: MeshPart) -> bool:
    """Whether a part is cards, which are lit with other normals than those of their surface."""
    return part.material.alpha == "mask" or (part.normals is not None and part.material.alpha == "blend")


def part_normals(part: MeshPart, vertices: AnyFloat, triangles: AnyInt) -> Float32:
    """(..., N, 3) unit normals that a part is lit with, of vertices (..., N, 3) metres in any number of poses.

    Those of its surface, triangles (T, 3); of masked cards, which lie at all angles, those of the body that they make
    up: with their own, hair has facets and slits.
    """
    if part.normals is not None:
        return np.broadcast_to(part.normals, vertices.shape)
    normals = area_normals(vertices, triangles)
    if not is_cards(part):
        return normals
    points = np.asarray(vertices, np.float64)
    away = normalise(points - points.mean(-2, keepdims=True), (0.0, 1.0, 0.0))
    outward = np.where((normals * away).sum(-1, keepdims=True) < 0, -normals, normals)
    return np.asarray(normalise((1 - ROUND) * outward + ROUND * away, (0.0, 1.0, 0.0)), np.float32)


POSES = 8
"""Whose normals are computed at a time: those of 52 blendshapes take 100 MB more for a moment."""


def normal_offsets(part: MeshPart, triangles: AnyInt, still: Float32, offsets: Sequence[Float32]) -> Iterator[Float32]:
    """(N, 3) by how much :func:`part_normals` differ from those of the neutral part, ``still``, with each of several
    offsets (N, 3) of its vertices.
    """
    for first in range(0, len(offsets), POSES):
        posed = part.neutral + np.stack(offsets[first : first + POSES])
        yield from part_normals(part, posed, triangles) - still


def framed(vertices: AnyFloat, parts: Sequence[MeshPart]) -> AnyFloat:
    """(N, 3) points that a picture shows: the head, and its hair as far as it does not hang below the neck."""
    lowest = float(vertices[:, 1].min())
    sheets = [part.vertices for part in parts if part.material.double_sided]
    return np.concatenate([vertices, *(points[points[:, 1] >= lowest] for points in sheets)])


def _four(faces: Int32) -> Int32:
    if faces.shape[1] == 4:
        return faces
    return np.concatenate([faces, np.full((len(faces), 1), -1, np.int32)], 1)


def _check_indices(name: str, faces: Int32, count: int) -> None:
    if faces.ndim != 2 or faces.shape[1] not in (3, 4) or not np.issubdtype(faces.dtype, np.integer) or not len(faces):
        raise NumericFault(f"faces of the part {name} have shape {faces.shape}; (F, 3) or (F, 4) integers are right")
    least = np.array([0, 0, 0, -1])[: faces.shape[1]]
    if (faces < least).any() or (faces >= count).any():
        raise NumericFault(f"a face of the part {name} points outside its {count} vertices")


COLOUR = ChartMap("diffuse_albedo")
"""Colours of the chart: the diffuse albedo, or the texture where there is none."""

SKIN = Material(
    "skin",
    colour_map=COLOUR,
    roughness=0.55,
    specular=0.65,
    specular_map=ChartMap("specular_albedo"),
    normal_map=ChartMap("specular_normal"),
    roughness_map=ChartMap("roughness"),
    displacement_map=ChartMap("displacement"),
    cavity_map=ChartMap("cavity"),
    thickness_map=ChartMap("thickness"),
    # Diffuse mean free path of skin (Jensen et al. 2001, "skin1": 1 / sigma_tr).
    subsurface_mm=(3.67, 1.37, 0.68),
)
_BY_PREFIX = {
    "skin": SKIN,
    "eye": Material("eye", colour_map=COLOUR, roughness=0.1),
    "teeth": Material("teeth", colour_map=COLOUR, roughness=0.25),
    "tongue": Material("tongue", colour_map=COLOUR, roughness=0.35),
    # Cards without an alpha cut-out look like a mask; the texture shows the photo's lashes on the lids.
    "lashes": Material("lashes", (0.012, 0.009, 0.007), roughness=0.7, opacity=0.0, double_sided=True),
}


def material_of(part: str) -> Material:
    """Material of a head's part by the first word of its name; unknown parts (of an imported head) are skin."""
    return _BY_PREFIX.get(part.split("_")[0], SKIN)


_BONES: dict[str, Bone] = {
    "eye_left": "eye_left", "eye_right": "eye_right", "teeth_lower": "jaw", "tongue": "jaw",
}  # fmt: skip
"""The joint that carries a part; the head carries the others."""


def head_parts(head: HeadModel, vertices: AnyFloat, neutral: AnyFloat) -> list[MeshPart]:
    """The head's own parts that have faces, in the order of ``part_names``, each with its own vertices.

    ``vertices`` (V, 3) metres have the photo's expression. NumericFault: a vertex or a blendshape is not finite.
    """
    parts = []
    for index, name in enumerate(head.part_names):
        chosen = head.polygon_part == index
        if not chosen.any():
            continue
        own, faces = renumbered(head.polygons[chosen])
        places, uv_faces = renumbered(head.polygon_uv[chosen])
        moved = {unit: head.expression[number, own] for number, unit in enumerate(head.expression_names)}
        parts.append(
            MeshPart(
                name=name,
                vertices=np.asarray(vertices, np.float32)[own],
                neutral=np.asarray(neutral, np.float32)[own],
                faces=faces,
                uv=head.uv[places],
                uv_faces=uv_faces,
                material=material_of(name),
                targets={unit: offsets for unit, offsets in moved.items() if offsets.any()},
                bone=_BONES.get(name, "head"),
            )
        )
    return parts


def renumbered(polygons: Int32) -> tuple[Int64, Int32]:
    """The indices that polygons (Q, 4) use, ascending, and the polygons as positions among them; -1 stays."""
    used, place = np.unique(polygons[polygons >= 0], return_inverse=True)
    made = np.full(polygons.shape, -1, np.int32)
    made[polygons >= 0] = place
    return used.astype(np.int64), made
