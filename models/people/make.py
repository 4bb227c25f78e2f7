"""A portrait with its truth, by seed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from models.lightstage.skin.streams import Stream
from models.people.cosmetics import places
from models.people.develop import backdrop, develop
from models.people.draw import Mesh, Renderer, renderer
from models.people.dress import dress, hair_colour
from models.people.figure import figure, recessed
from models.people.light import AMBIENT_SIZE, add_ambient, ambient_matrices, draw_light
from models.people.person import draw_person, lid_openings, the_head
from models.people.pose import FRAMINGS, contour, draw_camera, landmarks
from models.people.skins import default_folder, load_beards, load_skin
from models.people.strands import Strands, covered, wear_groom
from models.people.wardrobe import load_wardrobe
from service.anatomy.items import Item
from service.face.reading import part_labels as labels
from service.geometry.camera import Camera
from service.hair.kinds import KINDS, ends_m, kinds_of
from service.hair.style import Style

Float = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Portrait:
    """A picture of somebody and what it shows; H = W = size.

    Attributes:
        seed: names it.
        image: (H, W, 3) uint8 sRGB, row 0 = top; jpeg: the file that it was decoded from.
        chart: (H, W, 2) float32 chart coordinates (u, v) of the surface that the pixel's centre shows, origin bottom
            left; NaN where there is none of the head's surface.
        normal: (H, W, 3) float32 unit normals in camera space (x right, y down, z forward); 0 on the background.
        depth: (H, W) float32 metres along the axis; inf on the background.
        part: (H, W) uint8 index into ``labels.PARTS``.
        points: (478, 2) float32 pixels of MediaPipe's landmarks, the outline's where it is seen from here, then the
            irises; seen: (478,) bool, whether nothing hides them.
        camera: pinhole camera of ``service.geometry.camera``.
        identity, expression: coefficients of the head model.
        vertices: (V, 3) float32 metres in head space, with all that goes beyond the model.
        eyes: state of the eyes: "open", "half", "closed" or "wink".
        lids_mm: (2,) float32 height of the opening of the lids in the middle, the subject's right eye first; negative
            where they overlap.
        hair: (H, W) float32 in [0, 1], share of the pixel that hair covers: strands, mesh, or painted on the scalp.
        direction: (H, W, 2) float32 unit vectors of strands in the picture from root to tip, x right, y down; 0 where
            no strand is seen.
        kinds: the choice of each of ``service.hair.kinds.KINDS``; "" where a mesh is worn, which does not say.
        ends_m: height of the lowest ends in the head's frame, metres; NaN where nothing is known or grows.
    """

    seed: int
    image: npt.NDArray[np.uint8]
    jpeg: bytes
    chart: Float
    normal: Float
    depth: Float
    part: npt.NDArray[np.uint8]
    points: Float
    seen: npt.NDArray[np.bool_]
    camera: Camera
    identity: Float
    expression: Float
    vertices: Float
    eyes: str
    lids_mm: Float
    hair: Float
    direction: Float
    kinds: dict[str, str]
    ends_m: float


def portrait(
    seed: int, size: int = 256, folder: Path | None = None, framing: str = "face", meshes: tuple[str, ...] = (),
    only: str | None = None, taken: int | None = None,
) -> Portrait:  # fmt: skip
    """The portrait named ``seed``, the same every time on the same machine.

    Args:
        seed: >= 0.
        size: side in pixels.
        folder: where skins are kept (``models.people.skins``).
        framing: key of ``models.people.pose.FRAMINGS``.
        meshes: hair of the wardrobe, by name, of which one is worn in place of a groom: another maker's, for tests.
        only: of what hides skin only this one (``models.people.dress.INTRUDERS``), or "nothing"; None: as it comes.
        taken: whose expression, camera, light and background it has; None: their own.

    Raises:
        ModelFault: there is no OpenGL through EGL, or the wardrobe is missing.
    """
    r = renderer()
    folder = folder or default_folder()
    taken = seed if taken is None else taken
    person, light = draw_person(seed, folder, taken), draw_light(taken)
    skin = load_skin(person.skin, folder)
    wardrobe = load_wardrobe()
    head = the_head()
    vertices = recessed(person)
    camera = draw_camera(taken, size, landmarks(head, vertices), FRAMINGS[framing])
    worn = wear_groom(seed, person, skin) if not meshes and only in (None, "hair") else None
    hair = hair_colour(person, skin) if worn is None else worn.mean
    outfit = dress(seed, person, skin, hair, wardrobe, light.level(), meshes, only, framing == "face")
    worn = worn if outfit.groomed else None
    roots = None if worn is None else covered(worn.groom, head.mean)
    scene = [*figure(person, skin, hair, wardrobe, seed, roots), *outfit.meshes]
    _textures(r, seed, person.skin, folder, light.sky, light.gobo, scene)
    shared = {
        "eye": tuple(float(x) for x in camera.centre),
        "cutoff": 0.45,
        "faint": 1.0,
        "lift": 0.0,
        "level": 0.0,
        "beard": outfit.beard,
        "limbus": 0.5,
        "tone": (1.0, 1.0, 1.0, 0.0),
        "gloss": (0.3, 0.5, 0.7, 1.0),
        "colour": (0.5, 0.5, 0.5),
        "transmission": 0.0,
        "graininess": 0.0,
        "eyeLook": (0.35, 0.3, 1.0, 0.0),
        "glare": 1e9,
        "scalp": tuple(float(x) for x in hair),
        **outfit.make_up,
    }
    for mesh in scene:  # a uniform that one mesh sets must not stay for the next
        mesh.uniforms = {**{k: shared[k] for k in _OWN}, **mesh.uniforms}
    strands = None if worn is None else Strands(r.gl, r.strand_programs, worn, light, outfit.hides)
    loaded = r.load(scene)
    try:
        add_ambient(scene, r.depths(scene, loaded, ambient_matrices(), AMBIENT_SIZE, shared, strands), light)
        r.clear()
        loaded = r.load(scene)
        r.shadows(scene, loaded, light.matrices(), shared, strands)
        shared |= light.uniforms()
        where, facing, part = r.truth(scene, loaded, camera, shared)
        radiance, run, turned = r.radiance(scene, loaded, camera, shared, strands)
    finally:
        r.clear()
        if strands is not None:
            strands.release()
    behind = backdrop(taken, camera, light.sky)
    colour = radiance[..., :3] + (1.0 - np.clip(radiance[..., 3:], 0.0, 1.0)) * behind
    truth = _with_strands(_truth(where, facing, part, camera), run, turned, camera)
    bare = truth["part"].copy()
    colour = outfit.screen(colour, truth)
    hidden = (truth["part"] == labels.OTHER) & (bare != labels.OTHER)
    shown = np.where(hidden, np.float32(0), np.maximum(run[..., 3], truth["part"] == labels.HAIR))
    image, jpeg = develop(taken, colour, np.isin(truth["part"], labels.CHARTED))
    points, seen = _points(camera, vertices, truth)
    known = not any(mesh.kind == "hair" for mesh in scene)
    style = Style("none", 0, 0, 0, 0) if worn is None else worn.style
    own = np.zeros((0, 2, 3), np.float32) if worn is None else worn.groom.strands
    if worn is not None and seed % 2:
        own = own * np.array([-1, 1, 1], np.float32)
    return Portrait(
        seed,
        image,
        jpeg,
        truth["chart"],
        truth["normal"],
        truth["depth"],
        truth["part"],
        points,
        seen,
        camera,
        person.identity,
        person.expression,
        vertices,
        person.eyes,
        lid_openings(vertices),
        np.asarray(shown, np.float32),
        np.where((shown > 0)[..., None], _unit(run[..., :2]), np.float32(0)),
        kinds_of(style, own) if known else dict.fromkeys(KINDS, ""),
        ends_m(own) if known else float("nan"),
    )


_OWN = (
    "tone",
    "gloss",
    "colour",
    "transmission",
    "graininess",
    "eyeLook",
    "cutoff",
    "lift",
    "level",
    "glare",
    "beard",
)


def _textures(
    r: Renderer, seed: int, skin: int, folder: Path, sky: Float, gobo: npt.NDArray[np.uint8], meshes: list[Mesh]
) -> None:
    strands, beard_places = load_beards(folder)
    loaded = load_skin(skin, folder)
    items = load_wardrobe().items
    r.put(f"skin{skin}", loaded.albedo)
    r.put("strands", strands)
    r.put("places", beard_places)
    r.put("made", places())
    r.put("layers", loaded.layers, keep=False)
    r.put("sky", np.ascontiguousarray(sky[::-1]), keep=False, repeat=True)
    r.put("iris", items[_iris(seed, items)].picture, keep=False)
    r.put("gobo", gobo[..., None], keep=False)
    for mesh in meshes:
        if mesh.picture in items:
            picture = items[mesh.picture].picture
            # Of grey and alpha the shaders want the alpha as such.
            r.put(mesh.picture, picture if picture.shape[2] != 2 else picture[..., [0, 0, 0, 1]])


def _iris(seed: int, items: dict[str, Item]) -> str:
    """Name of an iris; brown ones are as frequent as all others together."""
    names = sorted(name for name in items if name.startswith("iris/"))
    s = Stream(seed, "iris")
    brown = [name for name in names if "brown" in name]
    return _pick(s, brown if s.chance(0.5) else names)


def _pick(s: Stream, names: list[str]) -> str:
    return names[int(s.one() * len(names))]


def _truth(where: Float, facing: Float, part: Float, camera: Camera) -> dict[str, npt.NDArray[Any]]:
    parts = np.round(part[..., 0]).astype(np.uint8)
    there = parts != labels.BACKGROUND
    charted = there & (where[..., 3] > 0.5) & np.isin(parts, labels.CHARTED)
    return {
        "chart": np.where(charted[..., None], where[..., :2], np.float32(np.nan)).astype(np.float32),
        "normal": np.where(there[..., None], _facing(facing[..., :3], camera), 0.0).astype(np.float32),
        "depth": np.where(there, where[..., 2], np.inf).astype(np.float32),
        "part": parts,
    }


def _facing(normal: Float, camera: Camera) -> Float:
    """(H, W, 3) unit normals, none of which points away: interpolated ones do at outlines, seen edge-on."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack(
        [x - camera.principal_point[0], y - camera.principal_point[1], np.full_like(x, camera.focal_px)], -1
    )
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return _unit(normal - np.maximum((normal * rays).sum(-1, keepdims=True), 0.0) * rays)


HAIRY = 0.5
"""Share of a pixel from which on strands are what it shows."""


def _with_strands(
    truth: dict[str, npt.NDArray[Any]], run: Float, turned: Float, camera: Camera
) -> dict[str, npt.NDArray[Any]]:
    """The truth of all else, and of the strands before it where they cover most of a pixel."""
    share = np.maximum(run[..., 3], 1e-6)
    hairy = run[..., 3] > HAIRY
    normal = _facing(_unit(turned[..., :3]), camera)
    return {
        "chart": np.where(hairy[..., None], np.float32(np.nan), truth["chart"]),
        "normal": np.where(hairy[..., None], normal, truth["normal"]).astype(np.float32),
        "depth": np.where(hairy, run[..., 2] / share, truth["depth"]).astype(np.float32),
        "part": np.where(hairy, np.uint8(labels.HAIR), truth["part"]),
    }


def _unit(vectors: npt.NDArray[np.floating]) -> Float:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-6), np.float32)


def _points(camera: Camera, vertices: Float, truth: dict[str, npt.NDArray[Any]]) -> tuple[Float, npt.NDArray[np.bool_]]:
    head = the_head()
    points = landmarks(head, vertices)
    index, outline = contour(head, vertices, camera.yaw_pitch_roll_deg()[0])
    points[index] = outline
    at, depth = camera.project(points), camera.to_camera(points)[:, 2]
    row, column = np.floor(at[:, 1]).astype(int), np.floor(at[:, 0]).astype(int)
    size = camera.width
    inside = (row >= 0) & (row < size) & (column >= 0) & (column < size)
    r, c = np.clip(row, 0, size - 1), np.clip(column, 0, size - 1)
    near = np.asarray(truth["depth"], np.float32)[r, c] > depth - 0.006
    bare = np.isfinite(np.asarray(truth["chart"], np.float32)[r, c, 0])
    return np.asarray(at, np.float32), np.asarray(inside & near & bare)
