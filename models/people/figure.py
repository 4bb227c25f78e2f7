"""The head itself as meshes: skin, eyeballs, teeth, tongue, and the chest below."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from models.head.eyes import sphere
from models.head.settle import LIMBUS_DEG, SETTLED_RINGS_DEG
from models.lightstage.skin.streams import Stream
from models.people.draw import Mesh
from models.people.person import Person, lid_openings, the_head
from models.people.skins import Skin
from service.anatomy.items import Items
from service.colour import srgb_to_linear
from service.face.reading import part_labels as labels
from service.geometry.mesh import vertex_normals

Float = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Layout:
    """A part of the head with a vertex for each chart point.

    Attributes:
        source: (M,) vertex of the head; chart: (M, 2) float32; triangles: (T, 3) int32; extra: (M, 4) float32 uv.
    """

    source: npt.NDArray[np.int64]
    chart: Float
    triangles: npt.NDArray[np.int32]
    extra: Float


@functools.lru_cache(maxsize=1)
def layouts() -> dict[str, Layout]:
    """Layouts of "skin", "eye_left", "eye_right" and "tongue"."""
    head = the_head()
    mouth, socket = head.region("mouth_inner"), head.region("eye_socket")
    directions = sphere(SETTLED_RINGS_DEG)[0].astype(np.float32)
    result = {}
    for name in ("skin", "eye_left", "eye_right", "tongue", "teeth_upper", "teeth_lower"):
        chosen = head.triangle_part == head.part_names.index(name)
        pairs = np.stack([head.triangles[chosen].ravel(), head.triangle_uv[chosen].ravel()], 1)
        unique, index = np.unique(pairs, axis=0, return_inverse=True)
        source, chart = unique[:, 0].astype(np.int64), head.uv[unique[:, 1]]
        extra = np.zeros((len(source), 4), np.float32)
        extra[:, :2] = chart
        if name == "skin":
            extra[:, 2] = np.maximum(mouth, socket)[source]
            extra[:, 3] = mouth[source]
        elif name.startswith("eye"):
            first = int(pairs[:, 0].min())
            extra[:, :3] = directions[source - first]
        result[name] = Layout(source, chart, index.reshape(-1, 3).astype(np.int32), extra)
    return result


def part(name: str, kind: str, vertices: Float, normals: Float, label: int, **more: Any) -> Mesh:
    """A part of the head as a mesh."""
    layout = layouts()[name]
    return Mesh(
        kind,
        vertices[layout.source],
        normals[layout.source],
        layout.triangles,
        layout.extra,
        label,
        chart=layout.chart,
        charted=True,
        **more,
    )


def smooth_normals(points: Float, triangles: npt.NDArray[np.int32]) -> Float:
    """(N, 3) float32 unit normals of a mesh."""
    return np.asarray(vertex_normals(points, triangles.astype(np.int64)), np.float32)


def neck_colour(skin: Skin, person: Person) -> Float:
    """(3,) linear albedo of the skin low on the neck."""
    rows = skin.albedo[int(0.86 * len(skin.albedo)) : int(0.95 * len(skin.albedo)), 400:650]
    colour = srgb_to_linear(rows.reshape(-1, 3).astype(np.float32) / 255).mean(0)
    return np.asarray(colour * person.tint, np.float32)


def figure(
    person: Person, skin: Skin, hair: Float, wardrobe: Items, seed: int, roots: Float | None = None
) -> list[Mesh]:
    """Meshes of the head and the chest; ``roots`` (V,) in [0, 1] tells where a groom grows."""
    s = Stream(seed, "figure")
    head = the_head()
    vertices = recessed(person)
    normals = np.asarray(vertex_normals(vertices, head.triangles.astype(np.int64)), np.float32)
    narrow, broad, mix = (float(x) for x in skin.roughness)
    oil = s.one(0.3, 1.2)
    tone = (*(float(x) for x in person.tint), 0.0)
    colour = tuple(float(x) for x in hair)
    meshes = [
        part(
            "skin",
            "skin",
            vertices,
            normals,
            labels.SKIN,
            picture=f"skin{person.skin}",
            uniforms={
                "tone": tone,
                "colour": colour,
                "gloss": (narrow, broad, mix, 0.7 * oil),
                "graininess": s.one(0.0, 1.5),
            },
        )
    ]
    if roots is not None:
        meshes[0].uv = meshes[0].uv.copy()
        meshes[0].uv[:, 3] -= roots[layouts()["skin"].source]
    look = (s.one(0.22, 0.6), s.one(0.0, 0.8) ** 2, s.one(0.75, 1.15), 0.0)
    for name in ("eye_left", "eye_right"):
        meshes.append(
            part(
                name,
                "eye",
                vertices,
                normals,
                labels.SCLERA,
                shadows=False,
                uniforms={"eyeLook": look, "limbus": float(np.radians(LIMBUS_DEG))},
            )
        )
    meshes.append(
        part("tongue", "mouth", vertices, normals, labels.MOUTH, shadows=False, uniforms={"colour": (0.42, 0.15, 0.14)})
    )
    teeth = wardrobe.items[wardrobe.names("teeth")[int(s.one() * len(wardrobe.names("teeth")))]]
    points = teeth.worn(person.vertices - wardrobe.fitted_head)
    white = s.one(0.6, 1.1)
    extra = np.zeros((len(points), 4), np.float32)
    extra[:, :2], extra[:, 2] = teeth.uv, 1.0
    meshes.append(
        Mesh(
            "mouth",
            points,
            smooth_normals(points, teeth.triangles),
            teeth.triangles,
            extra,
            labels.MOUTH,
            picture=teeth.name,
            shadows=False,
            uniforms={"tone": (white, white * s.one(0.9, 1.0), white * s.one(0.7, 1.0), 0.0)},
        )
    )
    torso = wardrobe.items["torso/body"]
    points = torso.worn(person.neutral - wardrobe.fitted_head)
    meshes.append(
        Mesh(
            "plain",
            points,
            smooth_normals(points, torso.triangles),
            torso.triangles,
            np.zeros((len(points), 4), np.float32),
            labels.SKIN,
            shadows=False,
            uniforms={"colour": tuple(float(x) for x in neck_colour(skin, person)), "gloss": (narrow, broad, mix, 0.6)},
        )
    )
    return meshes


def recessed(person: Person) -> Float:
    """(V, 3) vertices with the eyeballs of shut eyes drawn back, so that skin shows between lids that do not meet.

    The units close the lids of the average head over its eyeballs; those of others would let a line of iris through.
    """
    head = the_head()
    vertices = person.vertices.copy()
    for name, opening in zip(("eye_right", "eye_left"), lid_openings(vertices), strict=True):
        members = np.unique(head.triangles[head.triangle_part == head.part_names.index(name)])
        vertices[members, 2] -= np.float32(0.006 * np.clip((1.0 - opening) / 0.8, 0.0, 1.0))
    return vertices
