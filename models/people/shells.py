"""Things that lie on the head like a second skin: cloth, masks, and fur for beards and short hair."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt
import scipy.sparse as sparse

from models.lightstage.skin.streams import Stream
from models.people.draw import Mesh
from models.people.figure import layouts, smooth_normals
from models.people.glasses import tube
from models.people.person import the_head
from service.face.reading import part_labels as labels
from service.geometry.mesh import vertex_normals

Float = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]

FUR_LAYERS = 6


@functools.lru_cache(maxsize=1)
def _skin() -> tuple[npt.NDArray[np.int64], sparse.csr_matrix]:
    """Triangles of the outer skin, and the matrix that moves every vertex to the middle of its neighbours."""
    head = the_head()
    inner = np.maximum(head.region("mouth_inner"), head.region("eye_socket")) > 0.5
    triangles = head.triangles[head.triangle_part == 0].astype(np.int64)
    triangles = triangles[~inner[triangles].all(1)]
    i = np.concatenate([triangles[:, a] for a in (0, 1, 2, 1, 2, 0)])
    k = np.concatenate([triangles[:, b] for b in (1, 2, 0, 0, 1, 2)])
    graph = sparse.coo_matrix((np.ones(len(i), np.float32), (i, k)), shape=(len(head.mean),) * 2).tocsr()
    graph.data[:] = 1.0
    degree = np.asarray(graph.sum(1)).ravel()
    return triangles, (sparse.diags(1.0 / np.maximum(degree, 1.0)) @ graph).tocsr()


def shell(vertices: Float, value: Array, thickness: float, rounds: int, label: int, look: dict[str, object]) -> Mesh:
    """Cloth over the skin where ``value`` (V,) >= 0, smoothed and at least as thick as said (metres)."""
    triangles, smooth = _skin()
    points = vertices.astype(np.float64)
    normals = vertex_normals(vertices, triangles).astype(np.float64)
    soft = points + normals * thickness
    for _ in range(rounds):  # a membrane: it evens out, but stays off the skin
        soft = smooth @ soft
        soft = soft + normals * np.maximum(thickness - ((soft - points) * normals).sum(1, keepdims=True), 0.0)
    points = soft
    kept = triangles[(value[triangles] > 0).any(1)]
    used, local = np.unique(kept, return_inverse=True)
    out = points[used].astype(np.float32)
    extra = np.zeros((len(used), 4), np.float32)
    extra[:, :2] = out[:, :2] * 4.0
    extra[:, 2] = value[used]
    faces = np.asarray(local.reshape(-1, 3), np.int32)
    return Mesh(
        "cloth", out, smooth_normals(out, faces), faces, extra, label, uniforms={"colour": (0.5, 0.5, 0.5), **look}
    )


def fabric(s: Stream, share: float) -> dict[str, object]:
    """Uniforms of a piece of cloth: its colour and how much of the pattern shows."""
    colour = np.clip(s.uniform(0.02, 0.8, 3) ** 1.6, 0.01, 0.8)
    if s.chance(0.5):
        colour = np.full(3, colour.mean()) * np.exp(s.normal(0, 0.1, 3))
    return {"colour": tuple(float(c) for c in colour), "tone": (1.0, 1.0, 1.0, share)}


def mask(s: Stream, vertices: Float) -> list[Mesh]:
    """A mask over nose and mouth with its straps; now and then worn below the nose."""
    head = the_head()
    p = head.mean.astype(np.float64)
    top = -0.020 if s.chance(0.85) else -0.056
    wide, low = s.one(0.055, 0.068), s.one(-0.125, -0.112)
    upper = top - 0.35 * np.abs(p[:, 0]) - p[:, 1]
    value = np.minimum(np.minimum(upper, p[:, 1] - low + 0.15 * np.abs(p[:, 0])), wide - np.abs(p[:, 0])) * 20.0
    value = np.minimum(value, (p[:, 2] + 0.06) * 20.0)
    look = fabric(s, 0.0)
    if s.chance(0.5):
        look["colour"] = (0.35, 0.55, 0.65) if s.chance(0.5) else (0.75, 0.75, 0.75)
    covered = shell(vertices, value, s.one(0.003, 0.007), 80, labels.OTHER, look)
    meshes = [covered]
    for name, sign in (("ear_left", 1.0), ("ear_right", -1.0)):
        ear = vertices[head.region(name) > 0.5].astype(np.float64)
        edge = covered.position[(sign * covered.position[:, 0] > 0.8 * wide)].astype(np.float64)
        if not len(edge):
            continue
        behind = np.array([np.median(ear[:, 0]), 0.0, np.quantile(ear[:, 2], 0.4)])
        for start, y in (
            (edge[edge[:, 1].argmax()], np.quantile(ear[:, 1], 0.8)),
            (edge[edge[:, 1].argmin()], np.quantile(ear[:, 1], 0.2)),
        ):
            end = behind + np.array([0.0, y, 0.0])
            path = start + (end - start) * np.linspace(0, 1, 6)[:, None]
            path[1:-1, 0] += sign * 0.006
            points, triangles = tube(path, 0.0012, False, 4)
            meshes.append(
                Mesh(
                    "plain",
                    points,
                    smooth_normals(points, triangles),
                    triangles,
                    np.zeros((len(points), 4), np.float32),
                    labels.OTHER,
                    shadows=False,
                    uniforms={"colour": look["colour"]},
                )
            )
    return meshes


def fur(
    vertices: Float,
    normals: Float,
    length: float,
    droop: float,
    label: int,
    value: Array | None,
    look: dict[str, object],
) -> list[Mesh]:
    """Layers of strands, ``length`` metres long, over the beard (``value`` None) or where ``value`` (V,) is above 0."""
    layout, head = layouts()["skin"], the_head()
    own = head.region("beard") if value is None else value.astype(np.float32)
    if value is None:
        p = head.mean
        around = (p[:, 1] < -0.03) & (p[:, 2] > -0.06) & (head.region("mouth_inner") < 0.5)
        chosen = around[layout.source]
    else:
        chosen = own[layout.source] > 0.02
    kept = layout.triangles[chosen[layout.triangles].all(1)]
    used, local = np.unique(kept, return_inverse=True)
    faces = np.asarray(local.reshape(-1, 3), np.int32)
    source = layout.source[used]
    extra = np.zeros((len(used), 4), np.float32)
    extra[:, :2] = layout.chart[used]
    extra[:, 2], extra[:, 3] = value is not None, own[source]
    meshes = []
    for k in range(1, FUR_LAYERS + 1):
        level = k / FUR_LAYERS
        way = normals[source] * (1 - droop * level) + np.array([0, -droop * level, 0.3 * droop * level], np.float32)
        points = vertices[source] + np.float32(length * level) * way
        meshes.append(
            Mesh(
                "fur",
                points.astype(np.float32),
                normals[source],
                faces,
                extra,
                label,
                shadows=k == FUR_LAYERS - 2,
                uniforms={**look, "level": level},
            )
        )
    return meshes
