"""What somebody wears and grows, by seed: hair, brows, lashes, beard, hats, clothes, glasses, things before the face."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from models.lightstage.skin.streams import Stream
from models.people import labels
from models.people.draw import Mesh
from models.people.figure import smooth_normals
from models.people.person import Person
from models.people.skins import Skin
from models.people.wardrobe import Item, Wardrobe
from service.geometry.camera import Camera

Float = npt.NDArray[np.float32]

NO_BEARD = (0.0, 0.0, 0.0, 0.3)


@dataclass
class Outfit:
    """Meshes, the beard's uniform (density, density of the moustache, length 0 to 3, edge), what is put on the picture."""

    meshes: list[Mesh] = field(default_factory=list)
    beard: tuple[float, float, float, float] = NO_BEARD
    screens: list[Callable[[Float, dict[str, npt.NDArray[np.generic]]], Float]] = field(default_factory=list)

    def screen(self, light: Float, truth: dict[str, npt.NDArray[np.generic]]) -> Float:
        """Put flat things before the face; the truth is changed in place."""
        for each in self.screens:
            light = each(light, truth)
        return light


def hair_colour(person: Person, skin: Skin) -> Float:
    """(3,) linear RGB of the person's hair."""
    colour = skin.hair if person.hair is None else person.hair
    grey = max(skin.grey, person.old) * 0.8 if person.old > 0.3 else 0.0
    return np.asarray((1 - grey) * np.asarray(colour) + grey * np.array([0.38, 0.37, 0.36]), np.float32)


def card(item: Item, kind: str, moved: Float, label: int, **more: object) -> Mesh:
    """An item of the wardrobe as a mesh."""
    points = item.worn(moved)
    extra = np.zeros((len(points), 4), np.float32)
    extra[:, :2] = item.uv
    return Mesh(kind, points, smooth_normals(points, item.triangles), item.triangles, extra, label, picture=item.name, **more)  # type: ignore[arg-type]


def _pick(s: Stream, names: list[str]) -> str:
    return names[int(s.one() * len(names))]


def dress(seed: int, person: Person, skin: Skin, hair: Float, wardrobe: Wardrobe, camera: Camera) -> Outfit:
    """All that the person named ``seed`` has on and before the face."""
    s, out = Stream(seed, "dress"), Outfit()
    still, moving = person.neutral - wardrobe.fitted_head, person.vertices - wardrobe.fitted_head
    colour = tuple(float(x) for x in hair)
    if s.chance(0.75):
        item = wardrobe.items[_pick(s, wardrobe.names("hair"))]
        out.meshes.append(card(item, "hair", still, labels.HAIR, uniforms={"colour": colour, "cutoff": s.one(0.3, 0.6)}))
    if s.chance(0.5):
        item = wardrobe.items[_pick(s, wardrobe.names("brow"))]
        out.meshes.append(card(item, "brow", moving, labels.BROW, shadows=False, only_label=True,
                               uniforms={"colour": colour, "lift": 0.002}))  # fmt: skip
    if s.chance(0.8):
        item = wardrobe.items[_pick(s, wardrobe.names("lash"))]
        out.meshes.append(card(item, "lash", moving, labels.SKIN, shadows=False, true=False,
                               uniforms={"colour": (0.01, 0.008, 0.007)}))  # fmt: skip
    item = wardrobe.items[_pick(s, wardrobe.names("cloth"))]
    out.meshes.append(card(item, "cloth", still, labels.CLOTH, uniforms={"tone": (1.0, 1.0, 1.0, 1.0), "colour": (0.2, 0.2, 0.2)}))
    return out
