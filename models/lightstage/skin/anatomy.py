"""Where on the template's chart the regions of the face are, and how to find points that are given in millimetres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from models.lightstage.skin.atlas import Atlas

Float = npt.NDArray[np.float32]
Points = npt.NDArray[np.float64]

PAIRED = ("cheek", "eyelid_upper", "eyelid_lower", "brow", "ear")
SINGLE = ("face", "forehead", "nose", "nose_tip", "lips", "chin", "neck", "scalp", "beard", "mouth_inner", "eye_socket")


def smoothstep(value: npt.NDArray[np.floating], low: float, high: float) -> Float:
    """0 at ``low`` to 1 at ``high`` with zero slope at both; ``low`` > ``high`` turns it round."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t), np.float32)


@dataclass(frozen=True)
class Anatomy:
    """Maps of the template at the atlas' size.

    Attributes:
        atlas: the chart.
        maps: (H, W) float32 each. Masks in [0, 1] (see ``PAIRED`` without side, ``SINGLE``, and ``alae``,
            ``under_eye``, ``perioral``, ``moustache``, ``temple``), and distances in mm: ``lip_distance`` (negative on
            the vermilion) and ``eye_distance`` (from the rim of the lids).
        points: (3,) float64 mm on the subject's left side or the midline: ``eye_inner``, ``eye_outer``,
            ``mouth_corner``, ``mouth``, ``nose_tip``, ``ala``, ``chin``, ``brow_inner``, ``brow_outer``.
    """

    atlas: Atlas
    maps: dict[str, Float]
    points: dict[str, Points]

    def __getitem__(self, name: str) -> Float:
        """A map by name."""
        return self.maps[name]

    @classmethod
    def of(cls, atlas: Atlas) -> Anatomy:
        """From the regions of the atlas' head model."""
        head, chart = atlas.head, atlas.chart
        if head is None or chart is None:
            raise ValueError("a flat atlas has no anatomy of its own; use Anatomy.uniform")
        masks = chart.interpolate(head.regions.T)
        named = {name: np.ascontiguousarray(masks[..., i]) for i, name in enumerate(head.region_names)}
        maps = {name: named[name] for name in SINGLE}
        for name in PAIRED:
            maps[name] = np.maximum(named[f"{name}_left"], named[f"{name}_right"])
        # Vertex masks end in a sawtooth where the mesh is coarse: a blur of one polygon's size removes it.
        maps = {name: _soft(mask, atlas.inside, 3.0 if name in ("lips", "ear") else 7.0) for name, mask in maps.items()}
        maps["lips"] *= 1.0 - smoothstep(maps["mouth_inner"], 0.2, 0.6)
        x, y, z = atlas.position
        hidden = np.maximum(maps["mouth_inner"], maps["eye_socket"])
        points = _points(atlas, maps, hidden)
        side = np.abs(x)
        texel_mm = np.sqrt(np.maximum(atlas.area_mm2, 1e-4))
        maps["lip_distance"] = _signed_mm(_without_gap(maps["lips"] > 0.5), texel_mm)
        maps["lip_distance"] = np.maximum(maps["lip_distance"], _beyond_lips(atlas, points, maps["lip_distance"]))
        maps["eye_distance"] = _eye_distance(atlas, points)
        tip, corner, outer = points["nose_tip"], points["mouth_corner"], points["eye_outer"]
        seen = atlas.inside * (1.0 - smoothstep(hidden, 0.3, 0.7))
        maps["alae"] = _blob(atlas, points["ala"], (7.0, 7.0, 9.0)) * seen
        eye = 0.5 * (points["eye_inner"] + outer)
        maps["under_eye"] = _blob(atlas, eye + np.array([-2.0, -13.0, 0.0]), (17.0, 7.0, 18.0)) * seen
        lip_away = maps["lip_distance"]
        maps["perioral"] = smoothstep(lip_away, 16.0, 3.0) * smoothstep(lip_away, -1.0, 1.0) * seen
        above = smoothstep(y, corner[1] + 1.0, corner[1] + 5.0) * smoothstep(y, tip[1] - 8.0, tip[1] - 13.0)
        maps["moustache"] = (
            above * smoothstep(side, 30.0, 20.0) * (1.0 - maps["lips"]) * smoothstep(z, tip[2] - 45, tip[2] - 35)
        )
        maps["moustache"] = _soft(maps["moustache"], atlas.inside, 3.0) * seen
        maps["temple"] = _blob(atlas, outer + np.array([18.0, 14.0, -22.0]), (16.0, 22.0, 28.0)) * seen
        maps["nostril"] = _nostril(atlas, points) * seen
        maps["seen"] = seen
        return cls(atlas, {k: np.ascontiguousarray(v, np.float32) for k, v in maps.items()}, points)

    @classmethod
    def uniform(cls, atlas: Atlas, **masks: float) -> Anatomy:
        """The same everywhere, for flat pieces of skin: ``Anatomy.uniform(atlas, face=1.0, cheek=1.0)``."""
        names = (*PAIRED, *SINGLE, "alae", "under_eye", "perioral", "moustache", "temple", "nostril")
        shape = atlas.inside.shape
        maps = {name: np.full(shape, masks.get(name, 0.0), np.float32) for name in names}
        maps["lip_distance"] = np.full(shape, -4.0 if masks.get("lips", 0.0) > 0.5 else 100.0, np.float32)
        maps["eye_distance"] = np.full(shape, 100.0, np.float32)
        maps["seen"] = np.ones(shape, np.float32)
        return cls(atlas, maps, {})

    @cached_property
    def _tree(self) -> tuple[cKDTree, npt.NDArray[np.int64]]:
        texels = np.flatnonzero(self.maps["seen"].ravel() > 0.5)
        return cKDTree(self.atlas.position.reshape(3, -1).T[texels]), texels

    def in_front(self, xy_mm: npt.NDArray[np.floating]) -> Points:
        """(N, 2) chart coordinates of the skin that a front view shows at (N, 2) template x and y.

        Found by following the surface: the depth of the nearest point is taken over until it stands still.
        """
        points = np.concatenate([xy_mm, np.full((len(xy_mm), 1), 60.0)], 1)
        for _ in range(6):
            uv = self.project(points)
            points[:, 2] = self.atlas.sample(self.atlas.position[2:], uv)[:, 0]
        return self.project(points)

    def project(self, points_mm: npt.NDArray[np.floating]) -> Points:
        """(N, 2) chart coordinates of the skin nearest to (N, 3) template points, to a fraction of a texel.

        The offset to the nearest texel is turned into a step on the chart by the inverse of the local derivative.
        """
        tree, texels = self._tree
        height, width = self.atlas.inside.shape
        nearest = texels[tree.query(points_mm)[1]]
        row, column = np.divmod(nearest, width)
        position = self.atlas.position
        offset = points_mm - position[:, row, column].T
        right, left = np.minimum(column + 1, width - 1), np.maximum(column - 1, 0)
        low, high = np.minimum(row + 1, height - 1), np.maximum(row - 1, 0)
        du = (position[:, row, right] - position[:, row, left]).T / 2.0
        dv = (position[:, low, column] - position[:, high, column]).T / 2.0
        e, f, g = (du * du).sum(1), (du * dv).sum(1), (dv * dv).sum(1)
        a, b = (du * offset).sum(1), (dv * offset).sum(1)
        det = np.maximum(e * g - f * f, 1e-9)
        step = np.clip(np.stack([g * a - f * b, e * b - f * a], 1) / det[:, None], -0.5, 0.5)
        return np.stack([(column + 0.5 + step[:, 0]) / width, 1.0 - (row + 0.5 + step[:, 1]) / height], 1)


def _soft(mask: Float, inside: Float, sigma: float) -> Float:
    """Blur within the island."""
    weight = cv2.GaussianBlur(inside, (0, 0), sigma)
    return np.asarray(cv2.GaussianBlur(mask * inside, (0, 0), sigma) / np.maximum(weight, 1e-3) * inside, np.float32)


def _blob(atlas: Atlas, centre: Points, radii: tuple[float, float, float]) -> Float:
    """Gaussian bump about a point of the left side and its mirror image."""
    x, y, z = atlas.position
    q = (
        ((np.abs(x) - centre[0]) / radii[0]) ** 2
        + ((y - centre[1]) / radii[1]) ** 2
        + ((z - centre[2]) / radii[2]) ** 2
    )
    return np.asarray(np.exp(-q), np.float32)


def _beyond_lips(atlas: Atlas, points: dict[str, Points], distance: Float) -> Float:
    """Distance in mm to an almond between the corners of the mouth; the painted region ends round and too wide."""
    x, y, _ = atlas.position
    middle, corner = points["mouth"], points["mouth_corner"]
    near = distance < 25.0
    share = np.abs(x) / (corner[0] + 1.0)
    line = middle[1] + (corner[1] - middle[1]) * np.minimum(share, 1.0) ** 2
    half = np.where(share < 1.0, 13.0 * (1.0 - np.minimum(share, 1.0) ** 2.4), -12.0 * (share - 1.0))
    return np.asarray(np.where(near, np.abs(y - line) - half, distance), np.float32)


def _without_gap(lips: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """The lips with the line between them filled, so that the distance to their border ignores it."""
    size = max(3, lips.shape[1] // 40) | 1
    kernel = cv2.getStructuringElement(cv2.MORPH_RECT, (3, size))
    return np.asarray(cv2.morphologyEx(lips.astype(np.uint8), cv2.MORPH_CLOSE, kernel) > 0)


def _signed_mm(mask: npt.NDArray[np.bool_], texel_mm: Float) -> Float:
    """Distance to the border of a mask in mm, negative inside, with the local size of a texel."""
    if not mask.any():
        return np.full(mask.shape, 100.0, np.float32)
    within = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    beyond = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    scale = float(np.median(texel_mm[mask]))
    return cv2.GaussianBlur(np.where(mask, 0.5 - within, beyond - 0.5).astype(np.float32), (0, 0), 1.5) * scale


def _rim(atlas: Atlas, near: npt.NDArray[np.bool_]) -> Points:
    """(N, 3) points of the island's border where ``near`` holds."""
    chosen = near & (atlas.inside > 0.5) & (np.abs(atlas.edge) < 5.0)
    return np.asarray(atlas.position[:, chosen].T, np.float64)


def _eye_distance(atlas: Atlas, points: dict[str, Points]) -> Float:
    """Distance in mm to the rim of the nearer eye's lids."""
    x, y, z = atlas.position
    centre = 0.5 * (points["eye_inner"] + points["eye_outer"])
    near = np.hypot(np.abs(x) - centre[0], y - centre[1]) < 45.0
    near &= (z > centre[2] - 40.0) & (atlas.inside > 0.5)
    rim = _rim(atlas, np.hypot(np.abs(x) - centre[0], y - centre[1]) < 20.0)
    distance = np.full(x.shape, 100.0, np.float32)
    if len(rim):
        distance[near] = cKDTree(rim).query(atlas.position[:, near].T)[0]
    return distance


def _points(atlas: Atlas, maps: dict[str, Float], hidden: Float) -> dict[str, Points]:
    """Anchors of the left side (x > 0) and the midline."""
    x, y, z = atlas.position
    seen = (atlas.inside > 0.5) & (hidden < 0.5)

    def extreme(mask: npt.NDArray[np.bool_], value: npt.NDArray[np.floating]) -> Points:
        index = np.flatnonzero(mask.ravel())
        best = index[np.argmax(value.ravel()[index])]
        return np.asarray(atlas.position.reshape(3, -1)[:, best], np.float64)

    lid = seen & (np.maximum(maps["eyelid_upper"], maps["eyelid_lower"]) > 0.3) & (x > 0) & (np.abs(atlas.edge) < 8.0)
    tip = extreme(seen & (maps["nose_tip"] > 0.5), z)
    mouth = seen & (maps["lips"] > 0.3) & (np.abs(atlas.edge) < 8.0) & (x > 0)
    brow = seen & (maps["brow"] > 0.4) & (x > 0)
    flank = seen & (x > 0) & (x < 28) & (np.abs(y - tip[1] + 2.0) < 5.0) & (z > tip[2] - 24)
    return {
        "eye_inner": extreme(lid, -x),
        "eye_outer": extreme(lid, x),
        "mouth_corner": extreme(mouth, x),
        "mouth": extreme(mouth, -x),
        "nose_tip": tip,
        "ala": extreme(flank & (maps["nose"] > 0.2), x),
        "chin": extreme(seen & (maps["chin"] > 0.3) & (np.abs(x) < 1.0), maps["chin"]),
        "brow_inner": extreme(brow, -x),
        "brow_outer": extreme(brow, x),
    }


def _nostril(atlas: Atlas, points: dict[str, Points]) -> Float:
    """Openings of the nose: pits under and behind the tip."""
    tip = points["nose_tip"]
    inner = np.array([0.56 * points["ala"][0], tip[1] - 4.0, tip[2] - 16.0])
    return _soft(smoothstep(_blob(atlas, inner, (4.2, 4.2, 6.5)), 0.3, 0.6), atlas.inside, 2.0)
