"""Lay a disc-like patch flat with little distortion: Tutte's embedding, then symmetric Dirichlet energy.

Tutte (1963): with the boundary on a convex curve and every inner vertex at the mean of its neighbours no triangle
flips. From there the symmetric Dirichlet energy (Schreiner et al. 2004; Smith and Schaefer 2015)

    E = sum_t w_t A_t (|J_t|^2 + |J_t^-1|^2)

is lowered by L-BFGS preconditioned with the patch's Laplacian; J_t maps triangle t, laid flat and scaled to its
wanted size, to the image. E is infinite for a flat triangle and every step stops short of one, so no triangle ever
flips.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sparse
from scipy.sparse.linalg import splu, spsolve

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Patch:
    """A disc to be laid flat.

    Attributes:
        triangles: (T, 3) indices, counter-clockwise from outside.
        rest: (T, 2, 2) columns are the two edge vectors of each triangle in its own plane, at the wanted size in
        pixels. weight: (T,) weight of each triangle's distortion, area included. boundary: (B,) vertex indices in
        counter-clockwise order. pinned: indices of the vertices whose first coordinate stays 0 (the midline), or
        empty. walls: (W, 3) lines (a, b, c), a^2 + b^2 = 1; no vertex may leave a x + b y + c > 0 (pixels).
        wall_strength: weight of the barrier along the walls.
    """

    triangles: Int
    rest: Float
    weight: Float
    boundary: Int
    pinned: Int
    walls: Float
    wall_strength: float

    @property
    def count(self) -> int:
        """Number of vertices."""
        return int(self.triangles.max()) + 1


def rest_frames(corners: Float, scale: Float) -> Float:
    """(T, 2, 2) edge matrices of (T, 3, 3) triangles laid flat, times (T,) scale (pixels per unit)."""
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(e1, axis=1)
    along = (e1 * e2).sum(1) / length
    height = np.linalg.norm(np.cross(e1, e2), axis=1) / length
    zero = np.zeros(len(corners))
    return np.stack([np.stack([length, along], 1), np.stack([zero, height], 1)], 1) * scale[:, None, None]


def boundary_loop(triangles: Int) -> Int:
    """The single boundary of a disc in counter-clockwise order, from its lowest vertex index.

    Raises:
        ValueError: the patch has no boundary or more than one.
    """
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    table = {(int(a), int(b)) for a, b in sides}
    follow = {a: b for a, b in table if (b, a) not in table}
    if not follow:
        raise ValueError("the patch is closed: it has no boundary to lay out")
    loop = [min(follow)]
    while follow[loop[-1]] != loop[0]:
        loop.append(follow[loop[-1]])
        if len(loop) > len(follow):
            break
    if len(loop) != len(follow):
        raise ValueError(f"the patch has more than one boundary: walked {len(loop)} of {len(follow)} edges")
    return np.array(loop)


def tutte(patch: Patch, border: Float) -> Float:
    """(N, 2) embedding with the boundary at (B, 2) ``border`` (convex, counter-clockwise)."""
    n = patch.count
    t = patch.triangles
    i = np.concatenate([t[:, 0], t[:, 1], t[:, 2], t[:, 1], t[:, 2], t[:, 0]])
    j = np.concatenate([t[:, 1], t[:, 2], t[:, 0], t[:, 0], t[:, 1], t[:, 2]])
    graph = sparse.coo_matrix((np.ones(len(i)), (i, j)), shape=(n, n)).tocsr()
    graph.data[:] = 1.0
    laplacian = sparse.diags(np.asarray(graph.sum(1)).ravel()) - graph
    inner = np.setdiff1d(np.arange(n), patch.boundary)
    out = np.zeros((n, 2))
    out[patch.boundary] = border
    if len(inner):
        right = -laplacian[inner][:, patch.boundary] @ border
        out[inner] = spsolve(laplacian[inner][:, inner].tocsc(), right)
    return out


def energy(patch: Patch, x: Float) -> tuple[float, Float]:
    """Energy and its (N, 2) gradient; infinite where a triangle is flat or flipped or a vertex behind a wall."""
    t = patch.triangles
    inverse = np.linalg.inv(patch.rest)
    d = np.stack([x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]]], -1)
    j = d @ inverse
    det = j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0]
    zero = np.zeros_like(x)
    if not (det > 0).all():
        return np.inf, zero
    size = (j**2).sum((1, 2))
    value = float((patch.weight * (size + size / det**2)).sum())
    cofactor = np.stack([np.stack([j[:, 1, 1], -j[:, 1, 0]], 1), np.stack([-j[:, 0, 1], j[:, 0, 0]], 1)], 1)
    dj = 2 * j * (1 + 1 / det**2)[:, None, None] - (2 * size / det**3)[:, None, None] * cofactor
    dd = patch.weight[:, None, None] * (dj @ np.swapaxes(inverse, 1, 2))
    gradient = zero
    np.add.at(gradient, t[:, 1], dd[:, :, 0])
    np.add.at(gradient, t[:, 2], dd[:, :, 1])
    np.add.at(gradient, t[:, 0], -dd[:, :, 0] - dd[:, :, 1])
    extra, slope = _barrier(patch, x)
    return value + extra, gradient + slope


WALL_REACH = 60.0
"""Pixels at which the barrier along a wall begins."""


def _barrier(patch: Patch, x: Float) -> tuple[float, Float]:
    """-log of the distance to each wall, on the boundary only, smooth and zero beyond WALL_REACH."""
    gradient = np.zeros_like(x)
    value = 0.0
    for a, b, c in patch.walls:
        gap = (x[patch.boundary] @ np.array([a, b]) + c) / WALL_REACH
        if not (gap > 0).all():
            return np.inf, gradient
        near = np.minimum(gap, 1.0)
        value += patch.wall_strength * float((-np.log(near) * (1 - near) ** 2).sum())
        slope = -((1 - near) ** 2) / near + 2 * np.log(near) * (1 - near)
        np.add.at(gradient, patch.boundary, patch.wall_strength / WALL_REACH * slope[:, None] * np.array([a, b]))
    return value, gradient


def _longest_step(patch: Patch, x: Float, direction: Float) -> float:
    """First step at which a triangle loses its area along a direction (smallest positive root, Smith and Schaefer
    2015).
    """
    t = patch.triangles
    a1, a2 = x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]]
    b1, b2 = direction[t[:, 1]] - direction[t[:, 0]], direction[t[:, 2]] - direction[t[:, 0]]

    def cross(p: Float, q: Float) -> Float:
        return np.asarray(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])

    c, b, a = cross(a1, a2), cross(a1, b2) + cross(b1, a2), cross(b1, b2)
    inside = np.maximum(b * b - 4 * a * c, 0.0)
    real = b * b - 4 * a * c >= 0
    q = -0.5 * (b + np.copysign(np.sqrt(inside), b))
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = np.stack([q / a, c / q])
    roots = np.where(real & np.isfinite(roots) & (roots > 0), roots, np.inf)
    return float(roots.min())


def _preconditioner(patch: Patch) -> tuple[sparse.linalg.SuperLU, sparse.linalg.SuperLU]:
    n = patch.count
    t = patch.triangles
    inverse = np.linalg.inv(patch.rest)
    rows = np.stack([-inverse.sum(1), inverse[:, 0], inverse[:, 1]], 1)  # gradient of each corner's hat function
    local = np.einsum("tia,tja,t->tij", rows, rows, patch.weight) * 4.0
    i = np.repeat(t, 3, axis=1).ravel()
    j = np.tile(t, (1, 3)).ravel()
    laplacian = sparse.coo_matrix((local.ravel(), (i, j)), shape=(n, n)).tocsc()
    soft = laplacian + sparse.identity(n, format="csc") * (1e-4 * laplacian.diagonal().mean())
    fixed = np.zeros(n)
    fixed[patch.pinned] = 1e8 * laplacian.diagonal().max()
    return splu((soft + sparse.diags(fixed)).tocsc()), splu(soft)


def minimise(patch: Patch, start: Float, iterations: int = 400, memory: int = 10, tolerance: float = 1e-7) -> Float:
    """Lower the energy from a start without flipped triangles; returns (N, 2) pixels.

    Raises:
        ValueError: the start has a flat or flipped triangle or leaves the walls.
    """
    x = start.copy()
    x[patch.pinned, 0] = 0.0
    value, gradient = energy(patch, x)
    if not np.isfinite(value):
        raise ValueError("the start has a flipped triangle or leaves the walls")
    solve_x, solve_y = _preconditioner(patch)
    gradient[patch.pinned, 0] = 0.0
    history: deque[tuple[Float, Float, float]] = deque(maxlen=memory)
    for _ in range(iterations):
        q = gradient.copy()
        alphas = []
        for s, y, rho in reversed(history):
            alpha = rho * (s * q).sum()
            q -= alpha * y
            alphas.append(alpha)
        q = np.stack([solve_x.solve(q[:, 0]), solve_y.solve(q[:, 1])], 1)
        for (s, y, rho), alpha in zip(history, reversed(alphas), strict=True):
            q += s * (alpha - rho * (y * q).sum())
        q[patch.pinned, 0] = 0.0
        slope = -float((q * gradient).sum())
        if slope >= 0:
            history.clear()
            continue
        step = min(1.0, 0.8 * _longest_step(patch, x, -q))
        for _ in range(40):
            trial, trial_gradient = energy(patch, x - step * q)
            if trial <= value + 1e-4 * step * slope:
                break
            step *= 0.5
        else:
            if not history:
                break
            history.clear()
            continue
        trial_gradient[patch.pinned, 0] = 0.0
        s, y = -step * q, trial_gradient - gradient
        curvature = float((s * y).sum())
        if curvature > 1e-12 * float(np.sqrt((s * s).sum() * (y * y).sum())):
            history.append((s, y, 1.0 / curvature))
        done = value - trial < tolerance * abs(value)
        x, value, gradient = x + s, trial, trial_gradient
        if done:
            break
    return x
