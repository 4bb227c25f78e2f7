"""Where on our head does the landmark network put its 468 points: ``python -m models.people.calibrate --data SHARDS``.

Runs the very face finder of the service on portraits of synthetic people (``python -m models.people --out SHARDS``) and
carries every landmark back to the surface that its pixel shows. Expressed on the mean head, the robust centre of the
hits of a landmark is its embedding and their scatter its spread. The network's habits (where it thinks a nose tip is,
how far below the hairline a forehead ends) are so part of the embedding and cancel when a photo is fitted. Points of
the face outline slide with the pose; they get one place per 15 degrees of yaw.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from models.head.embedding import CONTOUR, EMBEDDING_FILE, Embedding, save_both
from models.head.nearest import nearest_on_triangles
from models.people.make import Portrait
from models.people.shards import decode, load
from service.face.finder import LANDMARK_COUNT
from service.geometry.mesh import area_normals
from service.geometry.raster import rasterise
from service.head.files import DEFAULT_HEAD, load_head
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]

YAW_BINS = np.arange(-60.0, 61.0, 15.0)
MISSED = 0.03
"""How far beside the head a landmark may lie, over the diagonal of the landmarks' bounding box."""
GROUPS = {
    "eyes": (33, 133, 159, 145, 263, 362, 386, 374, 160, 158, 153, 144, 385, 387, 373, 380),
    "brows": (70, 63, 105, 66, 107, 336, 296, 334, 293, 300),
    "nose": (1, 2, 4, 5, 6, 98, 327, 168, 197, 195, 48, 278),
    "mouth": (61, 291, 0, 17, 13, 14, 37, 267, 84, 314, 40, 270, 91, 321),
    "outline": CONTOUR,
}

log = logging.getLogger(__name__)


@dataclass
class Hits:
    """Back-projected landmarks on the mean head.

    Attributes:
        yaw: (N,) degrees, as ``Camera.yaw_pitch_roll_deg`` has it.
        point: (N, 468, 3) metres on the mean head; NaN where a landmark missed the mesh by more than the allowance.
        facing: (N, V) cosine between each vertex's normal and the direction to the camera.
        tried, found: per yaw bin.
    """

    yaw: list[float] = field(default_factory=list)
    point: list[Float] = field(default_factory=list)
    facing: list[npt.NDArray[np.float32]] = field(default_factory=list)
    tried: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(YAW_BINS), np.int64))
    found: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(YAW_BINS), np.int64))


def back_project(head: HeadModel, person: Portrait, landmarks: Float) -> Float:
    """(468, 3) points on the mean head under (468, 2) pixels of a portrait; NaN beside the head (``MISSED``)."""
    from scipy.spatial import cKDTree

    shown = np.flatnonzero(head.triangle_part != head.part_names.index("lashes"))
    uv, depth = person.camera.project(person.vertices), person.camera.to_camera(person.vertices)[:, 2]
    height, width = person.part.shape
    raster = rasterise(np.asarray(uv, np.float64), depth, head.triangles[shown], width, height, perspective=True)
    rows, columns = np.nonzero(raster.mask)
    distance, nearest = cKDTree(np.c_[columns + 0.5, rows + 0.5]).query(landmarks)
    row, column = rows[nearest], columns[nearest]
    corners = head.mean[head.triangles[shown[raster.triangle[row, column]]]].astype(float)
    point = (raster.barycentric[row, column].astype(float)[..., None] * corners).sum(1)
    point[distance > MISSED * np.linalg.norm(np.ptp(landmarks, axis=0))] = np.nan
    return np.asarray(point)


def collect(head: HeadModel, people: Iterable[Portrait]) -> Hits:
    """Detect and back-project the landmarks of portraits."""
    from service.face.finder import FaceFinder

    finder, hits = FaceFinder(), Hits()
    for person in people:
        yaw = float(person.camera.yaw_pitch_roll_deg()[0])
        slot = int(np.argmin(np.abs(YAW_BINS - yaw)))
        hits.tried[slot] += 1
        faces = finder.find(person.image)
        if not faces:
            continue
        hits.found[slot] += 1
        vertices = person.vertices.astype(np.float64)
        ray = person.camera.centre - vertices
        cosine = (area_normals(vertices, head.triangles) * ray).sum(1) / np.linalg.norm(ray, axis=1)
        hits.yaw.append(yaw)
        hits.point.append(back_project(head, person, faces[0].landmarks[:, :2]))
        hits.facing.append(cosine.astype(np.float32))
    return hits


def robust_centre(points: Float, start: Float | None = None) -> tuple[Float, float]:
    """Geometric median of (N, 3) points (Weiszfeld 1937) and their scatter: the Rayleigh sigma of the distances.

    Raises:
        ValueError: there is no point.
    """
    points = points[np.isfinite(points).all(1)]
    if not len(points):
        raise ValueError("no point to take the centre of")
    centre = np.median(points, axis=0) if start is None else start
    for _ in range(30):
        weight = 1.0 / np.maximum(np.linalg.norm(points - centre, axis=1), 1e-5)
        centre = weight @ points / weight.sum()
    distance = np.linalg.norm(points - centre, axis=1)
    return np.asarray(centre), float(np.median(distance) / 1.1774)


UPPER_INNER = (191, 80, 81, 82, 13, 312, 311, 310, 415)
LOWER_INNER = (95, 88, 178, 87, 14, 317, 402, 318, 324)
"""Landmarks of the inner edge of each lip. On closed lips they fall on one line, so the hits cannot tell them apart."""


class Surface:
    """The outside of the mean head's skin, to put points back onto it."""

    def __init__(self, head: HeadModel, lip: Literal["upper", "lower"] | None = None) -> None:
        """The skin's triangles without mouth lining and sockets, or those of one lip; the lower goes with the jaw."""
        from scipy.spatial import cKDTree

        inner = head.region("mouth_inner") + head.region("eye_socket")
        outside = (head.triangle_part == 0) & (inner[head.triangles] < 0.5).all(1)
        if lip is not None:
            outside &= (head.region("lips")[head.triangles] > 0.5).all(1)
            drop = -head.expression[head.expression_names.index("jawOpen")][:, 1]
            moving = (drop > 0.25 * drop.max())[head.triangles]
            outside &= moving.all(1) if lip == "lower" else ~moving.any(1)
        self.index = np.flatnonzero(outside)
        self.corner = head.mean[head.triangles[self.index]].astype(float)
        self.tree = cKDTree(self.corner.mean(1))

    def project(self, point: Float) -> tuple[int, Float]:
        """Triangle and barycentric coordinates of the surface point nearest to (3,) a point."""
        near = self.tree.query(point, k=min(24, len(self.index)))[1]
        weights = nearest_on_triangles(self.corner[near], np.repeat(point[None], len(near), axis=0))
        foot = np.einsum("nk,nkc->nc", weights, self.corner[near])
        best = int(np.argmin(np.linalg.norm(foot - point, axis=1)))
        return int(self.index[near[best]]), weights[best]


def mirror_pairs(centres: Float) -> npt.NDArray[np.int64]:
    """(L,) index of each landmark's mirror image: the assignment with the least total distance."""
    from scipy.optimize import linear_sum_assignment

    image = centres * np.array([-1.0, 1.0, 1.0])
    cost = np.linalg.norm(centres[:, None] - image[None], axis=2)
    cost = cost + cost.T
    pairs = linear_sum_assignment(cost)[1]
    return np.where(pairs[pairs] == np.arange(len(pairs)), pairs, np.arange(len(pairs)))


def embed(head: HeadModel, hits: Hits) -> tuple[Embedding, Float]:
    """The embedding, and (468,) spreads of the near-frontal centres in metres for the report."""
    flip = np.array([-1.0, 1.0, 1.0])
    surface = Surface(head)
    yaw, point = np.array(hits.yaw), np.stack(hits.point)
    frontal = np.abs(yaw) <= 25
    first = np.stack([robust_centre(point[frontal, k])[0] for k in range(LANDMARK_COUNT)])
    pairs = mirror_pairs(first)
    both = np.concatenate([point, point[:, pairs] * flip])
    both_yaw = np.concatenate([yaw, -yaw])
    facing = np.stack(hits.facing)
    centres, spreads = first.copy(), np.zeros(LANDMARK_COUNT)
    for _ in range(2):
        vertex = np.array([head.triangles[surface.project(c)[0]][0] for c in centres])
        seen = np.concatenate([facing[:, vertex], facing[:, vertex[pairs]]])
        for k in range(LANDMARK_COUNT):
            near = np.linalg.norm(both[:, k] - centres[k], axis=1) < 0.015
            use = (seen[:, k] > 0.35) & near & (np.abs(both_yaw) < 50)
            if use.sum() < 20:
                use = near & (np.abs(both_yaw) <= 25)
            centres[k], spreads[k] = robust_centre(both[use, k] if use.any() else both[:, k])
        centres = 0.5 * (centres + centres[pairs] * flip)
        spreads = 0.5 * (spreads + spreads[pairs])
    upper, lower = Surface(head, "upper"), Surface(head, "lower")
    lips = {**dict.fromkeys(UPPER_INNER, upper), **dict.fromkeys(LOWER_INNER, lower)}
    places = [lips.get(k, surface).project(c) for k, c in enumerate(centres)]
    table, weights = [], []
    for middle in YAW_BINS:
        inside = np.abs(both_yaw - middle) <= 10.0
        row = []
        for landmark in CONTOUR:
            points = both[inside, landmark]
            finite = np.isfinite(points).all(1)
            row.append(surface.project(robust_centre(points)[0] if finite.sum() >= 3 else centres[landmark]))
        table.append([place[0] for place in row])
        weights.append([place[1] for place in row])
    embedding = Embedding(
        np.array([p[0] for p in places], np.int32),
        np.array([p[1] for p in places], np.float32),
        np.maximum(spreads, 3e-4).astype(np.float32),
        np.array(CONTOUR, np.int32),
        YAW_BINS.astype(np.float32),
        np.array(table, np.int32),
        np.array(weights, np.float32),
    )
    return embedding, spreads


def report(hits: Hits, spreads: Float) -> None:
    """Log detection by yaw and scatter by group of landmarks."""
    for middle, tried, found in zip(YAW_BINS, hits.tried, hits.found, strict=True):
        log.info("yaw %+4.0f: %d of %d heads found", middle, found, tried)
    for name, members in GROUPS.items():
        log.info("%-8s scatter %.2f mm", name, 1e3 * float(np.median(spreads[list(members)])))
    log.info("%-8s scatter %.2f mm (90 %%: %.2f)", "all", 1e3 * np.median(spreads), 1e3 * np.percentile(spreads, 90))


def portraits(folder: Path, most: int) -> Iterator[Portrait]:
    """At most so many portraits of a folder's shards.

    Raises:
        SystemExit: there are no shards.
    """
    paths = sorted(folder.glob("people-*.npz"))
    if not paths:
        raise SystemExit(f"{folder}: no shards; draw them by python -m models.people --out {folder}")
    everyone = (person for path in paths for person in decode(load(path)))
    return (person for _, person in zip(range(most), everyone, strict=False))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of shards")
    parser.add_argument("--most", type=int, default=1000, help="portraits at most")
    parser.add_argument("--head", type=Path, default=DEFAULT_HEAD)
    parser.add_argument("--out", type=Path, default=EMBEDDING_FILE, help="embedding file that the builder takes over")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    head = load_head(arguments.head)
    hits = collect(head, portraits(arguments.data, arguments.most))
    embedding, spreads = embed(head, hits)
    report(hits, spreads)
    save_both(replace(head, **embedding.fields()), arguments.head, arguments.out)


if __name__ == "__main__":
    main()
