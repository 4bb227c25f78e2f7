"""Hair on a head: it follows identity, keeps off the skin, and is as full and as long as the photo's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from service.anatomy.hair.item import Item, Items
from service.arrays import AnyFloat, Float32, Float64, Int64
from service.geometry.normals import area_normals
from service.head.model import HeadModel
from service.head.regions import vertex_mask

CLEARANCE_M = 0.002
"""Least distance of hair from the skin: less, and the skin shows through between the vertices."""
DEEPEST_M = 0.025
"""Distance from the skin up to which volume counts: a ponytail is not the body of the hair."""
REACH_M = 0.03
"""Hair further inside the head than this is not pushed out: it belongs to the inside of a style."""
EAR_M = -0.035
"""Height of the ears' lobes below the eyes, from where on hair hangs."""


@dataclass(frozen=True)
class Cut:
    """How a style is worn.

    Attributes:
        volume: factor on the distance of hair from the skull, within 25 mm of it.
        length: factor on how far hair hangs below the ears.
        mirrored: left and right exchanged, for a parting on the other side.
    """

    volume: float = 1.0
    length: float = 1.0
    mirrored: bool = False


def fits(items: Items, head: HeadModel) -> bool:
    """Whether a head has the vertices that the items follow, where they were fitted: other heads wear nothing."""
    if items.fitted_head.shape != head.mean.shape:
        return False
    return bool(np.abs(items.fitted_head - head.mean).max() < 0.02)


def mirrored(item: Item, head: HeadModel) -> Item:
    """The item with left and right exchanged; the head's two halves have to be each other's mirror image."""
    return replace(
        item,
        rest=item.rest * np.array([-1, 1, 1], np.float32),
        follow=head.mirror[item.follow],
        triangles=np.ascontiguousarray(item.triangles[:, ::-1]),
    )


@dataclass(frozen=True)
class Skull:
    """The skin of one head that hair is kept off.

    Attributes:
        head: topology.
        neutral: (V, 3) float32 metres, without expression.
        skin: (M, 3) points of the outer skin without ears, over or behind which hair lies; normals: (M, 3) unit.
        tree: nearest of these points.
    """

    head: HeadModel
    neutral: Float32
    skin: Float64
    normals: Float64
    tree: cKDTree

    @classmethod
    def of(cls, head: HeadModel, neutral: AnyFloat) -> Skull:
        """Of a head (V, 3) without expression."""
        own = np.unique(head.triangles[head.triangle_part == 0])
        own = own[vertex_mask(head, "mouth_inner", "eye_socket", "ear_left", "ear_right")[own] < 0.5]
        points = np.asarray(neutral, np.float32)
        skin = points[own].astype(np.float64)
        return cls(head, points, skin, area_normals(points, head.triangles)[own].astype(np.float64), cKDTree(skin))

    def nearest(self, points: AnyFloat) -> tuple[Int64, Float64, Float64]:
        """Index of the nearest point of the skin, distance above it along its normal, and that normal."""
        index = np.asarray(self.tree.query(points)[1], np.int64)
        normal = self.normals[index]
        return index, np.asarray(np.einsum("ni,ni->n", points - self.skin[index], normal)), normal


def hair_on(item: Item, items: Items, skull: Skull, cut: Cut = Cut()) -> Float32:
    """(N, 3) float32 metres of a style on a head, off its skin.

    Args:
        item: the style.
        items: the file that it is from.
        skull: of the head.
        cut: volume and length.
    """
    item = mirrored(item, skull.head) if cut.mirrored else item
    points = item.worn(skull.neutral - items.fitted_head).astype(np.float64)
    if cut.length != 1.0:
        points[:, 1] += (cut.length - 1.0) * np.minimum(points[:, 1] - EAR_M, 0.0)
    _, away, normal = skull.nearest(points)
    # What hangs is not nearer the neck for being thinner.
    thicker = (cut.volume - 1.0) * np.clip(away, 0.0, DEEPEST_M)
    moved = np.where(points[:, 1] > EAR_M, away + thicker, away)
    moved = np.where((moved < CLEARANCE_M) & (away > -REACH_M), CLEARANCE_M, moved)
    return np.asarray(points + (moved - away)[:, None] * normal, np.float32)
