"""What somebody wears and grows, by seed: hair, brows, lashes, beard, hats, clothes, glasses, occluders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from models.lightstage.skin.streams import Stream
from models.people.cosmetics import NO_MAKE_UP, earrings, make_up
from models.people.draw import Mesh
from models.people.figure import neck_colour, smooth_normals
from models.people.glasses import glasses
from models.people.headwear import beanie, hat, headscarf, neck_scarf
from models.people.occluders import hand, screen, shade
from models.people.person import Person, the_head
from models.people.shells import fur, mask
from models.people.skins import Skin
from models.people.strands import Hides
from service.anatomy.items import Item, Items
from service.face.reading import part_labels as labels
from service.geometry.mesh import vertex_normals

Float = npt.NDArray[np.float32]

NO_BEARD = (0.0, 0.0, 0.0, 0.3)
INTRUDERS = ("hair", "cap", "glasses", "hand", "thing")
"""What may hide skin: a groom, a knitted cap, glasses, a hand, any flat thing before the picture."""
FEDORA, BEANIE, HAT, HEADSCARF = 0.03, 0.11, 0.17, 0.2
"""Summed shares of people who wear one on the head."""
NECK_SCARF = 0.1
"""Share of people with a scarf round the neck."""
GROOMED = 0.93
"""Share of people with hair, of those whom no scarf covers."""


@dataclass
class Outfit:
    """What somebody has on.

    Attributes:
        meshes: to be drawn with the head.
        beard: density, density of the moustache, length from 0 to 3, edge; for the shaders.
        make_up: uniforms of the shader of skin.
        screens: what is put on the picture.
        groomed: whether hair grows on the head; hides: which of points (N, 3) a hat hides, where it does.
    """

    meshes: list[Mesh] = field(default_factory=list)
    beard: tuple[float, float, float, float] = NO_BEARD
    make_up: dict[str, tuple[float, ...]] = field(default_factory=lambda: NO_MAKE_UP)
    screens: list[Callable[[Float, dict[str, npt.NDArray[Any]]], Float]] = field(default_factory=list)
    groomed: bool = False
    hides: Hides | None = None

    def screen(self, light: Float, truth: dict[str, npt.NDArray[Any]]) -> Float:
        """Put flat things before the face; the truth is changed in place."""
        for each in self.screens:
            light = each(light, truth)
        return light


def hair_colour(person: Person, skin: Skin) -> Float:
    """(3,) linear RGB of the person's hair where it is no groom."""
    colour = skin.hair if person.hair is None else person.hair
    grey = max(skin.grey, person.old) * 0.8 if person.old > 0.3 else 0.0
    return np.asarray((1 - grey) * np.asarray(colour, np.float64) + grey * np.array([0.38, 0.37, 0.36]), np.float32)


def card(item: Item, kind: str, moved: Float, label: int, **more: Any) -> Mesh:
    """An item of the wardrobe as a mesh."""
    points = item.worn(moved)
    extra = np.zeros((len(points), 4), np.float32)
    extra[:, :2] = item.uv
    return Mesh(
        kind, points, smooth_normals(points, item.triangles), item.triangles, extra, label, picture=item.name, **more
    )


def _pick(s: Stream, names: list[str]) -> str:
    return names[int(s.one() * len(names))]


def dress(
    seed: int, person: Person, skin: Skin, hair: Float, wardrobe: Items, light_level: float,
    meshes: tuple[str, ...] = (), only: str | None = None, hidden: bool = True,
) -> Outfit:  # fmt: skip
    """All that the person named ``seed`` has on and before the face.

    Args:
        seed: names the outfit.
        person: who it is.
        skin: theirs.
        hair: (3,) linear RGB.
        wardrobe: what there is to wear.
        light_level: radiance of skin in the portrait's light, about.
        meshes: styles of the wardrobe of which one is worn in place of a groom; none for grooms.
        only: of what hides skin only this one of ``INTRUDERS``, or "nothing"; None: as it comes. With it nobody has a
            beard, make-up or earrings: the albedo is the skin's own.
        hidden: whether masks, hands and flat things hide as many faces as they may; else, in pictures that show all of
            the hair, they hide a third of these, and hats are worn twice as often.

    Raises:
        ValueError: ``only`` is none of them.
    """
    if only not in (None, "nothing", *INTRUDERS):
        raise ValueError(f"only is {only!r}; it has to be None, 'nothing' or one of {', '.join(INTRUDERS)}")
    s, out = Stream(seed, "dress"), Outfit()
    still, moving = person.neutral - wardrobe.fitted_head, person.vertices - wardrobe.fitted_head
    colour = tuple(float(x) for x in hair)
    if only is None:
        out.groomed = _head_wear(s, out, person, wardrobe, 1.0 if hidden else 2.0) and s.chance(GROOMED)
    out.groomed |= only == "hair"
    if meshes and out.groomed:
        out.groomed = False
        out.meshes += _mesh_hair(s, meshes, person, wardrobe, colour, out.hides)
    if person.skin % 4 == 0 and s.chance(0.95):  # the other skins have brows of their own
        item = wardrobe.items[_pick(s, wardrobe.names("brow"))]
        out.meshes.append(card(item, "brow", moving, labels.BROW, shadows=False, only_label=True,
                               uniforms={"colour": colour, "lift": 0.002}))  # fmt: skip
    if s.chance(0.8):
        item = wardrobe.items[_pick(s, wardrobe.names("lash"))]
        out.meshes.append(card(item, "lash", moving, labels.SKIN, shadows=False, true=False,
                               uniforms={"colour": (0.01, 0.008, 0.007)}))  # fmt: skip
    if only is None:
        _beard(s, out, person, skin, colour)
        out.make_up = make_up(seed, skin.male)
        out.meshes += earrings(seed, skin.male, person.neutral)
    if s.chance(0.85):
        item = wardrobe.items[_cloth(s, skin.male, wardrobe)]
        tint = tuple(float(x) for x in np.exp(s.normal(0.0, 0.5, 3)))
        plain = tuple(float(x) for x in s.uniform(0.02, 0.8, 3) ** 1.5)
        out.meshes.append(card(item, "cloth", still, labels.CLOTH, shadows=False,
                               uniforms={"tone": (*tint, float(s.chance(0.6))), "colour": plain}))  # fmt: skip
    if only is None and s.chance(NECK_SCARF):
        out.meshes += neck_scarf(s, person.neutral)
    if only == "cap":
        out.meshes += beanie(s, person.neutral).meshes
    if only == "glasses" or (only is None and s.chance(0.25)):
        out.meshes += glasses(seed, person.vertices, light_level)
    if only == "hand":
        out.meshes.append(hand(seed, wardrobe, neck_colour(skin, person)))
    if only == "thing":
        out.screens.append(screen(seed))
    if only is not None or not (hidden or s.chance(1 / 3)):
        return out
    if s.chance(0.08):
        out.meshes += mask(s, person.vertices)
    if s.chance(0.10):
        out.meshes.append(hand(seed, wardrobe, neck_colour(skin, person)))
    if s.chance(0.25):
        out.screens.append(shade(seed))
    if s.chance(0.2):
        out.screens.append(screen(seed))
    return out


def _cloth(s: Stream, male: bool, wardrobe: Items) -> str:
    """Name of what somebody wears: mostly what was made for their sex; the rest of the wardrobe for one in four."""
    names = wardrobe.names("cloth")
    own = [name for name in names if ("female" not in name) == male]
    return _pick(s, names if s.chance(0.25) else own)


def _head_wear(s: Stream, out: Outfit, person: Person, wardrobe: Items, often: float) -> bool:
    """A hat, cap or scarf, ``often`` times as often as usual; whether hair may be seen beside it."""
    kind = s.one() / often
    if kind < FEDORA:
        item = wardrobe.items[_pick(s, wardrobe.names("hat"))]
        tint = tuple(float(x) for x in np.exp(s.normal(-0.3, 0.5, 3)))
        out.meshes.append(card(item, "cloth", person.neutral - wardrobe.fitted_head, labels.HAT,
                               uniforms={"tone": (*tint, 1.0)}))  # fmt: skip
        rim = float(np.quantile(out.meshes[-1].position[:, 1], 0.15))
        out.hides = lambda points: points[:, 1] > rim
        return True
    for kinds, make in ((BEANIE, beanie), (HAT, hat), (HEADSCARF, headscarf)):
        if kind < kinds:
            worn = make(s, person.neutral)
            out.meshes += worn.meshes
            out.hides = worn.hides
            return worn.hides is not None
    return True


def _mesh_hair(
    s: Stream,
    names: tuple[str, ...],
    person: Person,
    wardrobe: Items,
    colour: tuple[float, ...],
    hides: Hides | None,
) -> list[Mesh]:
    """One of some meshes of the wardrobe, without what a hat hides."""
    item = wardrobe.items["hair/" + _pick(s, list(names))]
    mesh = card(item, "hair", person.neutral - wardrobe.fitted_head, labels.HAIR,
                uniforms={"colour": colour, "cutoff": s.one(0.3, 0.6)})  # fmt: skip
    if hides is not None:
        mesh.triangles = np.ascontiguousarray(mesh.triangles[~hides(mesh.position)[mesh.triangles].any(1)])
    return [mesh] if len(mesh.triangles) else []


def _beard(s: Stream, out: Outfit, person: Person, skin: Skin, colour: tuple[float, ...]) -> None:
    """A beard drawn on the skin, and for some longer ones fur; mostly on men."""
    if not s.chance(0.65 if skin.male else 0.01):
        return
    kind, length = s.one(), s.one(0.3, 3.0)
    beard, moustache = (
        (1.0, 1.0) if kind < 0.6 else (0.0, 1.0) if kind < 0.75 else (1.0, 0.0) if kind < 0.85 else (0.6, 0.9)
    )
    dense = s.one(0.5, 1.1)
    out.beard = (beard * dense, moustache * dense, length, s.one(0.1, 0.45))
    if length > 2.0 and s.chance(0.7):
        normals = np.asarray(vertex_normals(person.vertices, the_head().triangles.astype(np.int64)), np.float32)
        reach = float(np.exp(s.one(np.log(0.003), np.log(0.018))))
        look: dict[str, object] = {"colour": colour, "beard": out.beard}
        out.meshes += fur(person.vertices, normals, reach, s.one(0.2, 0.7), labels.BEARD, None, look)
