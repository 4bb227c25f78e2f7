"""Stage A of the fit: identity, and for each photo pose, distance and expression, from landmarks.

A maximum a posteriori estimate by damped least squares with iteratively re-weighted residuals: Geman-McClure weights
whose scale is annealed, so that outliers (hidden cheeks, hair, hands) lose their weight.

The shape is linear: the head's components at its landmarks, and smooth modes beyond them. M. Luethi, T. Gerig, C. Jud,
T. Vetter, "Gaussian Process Morphable Models" (PAMI 2018): a smooth random displacement is a sum of modes of unit
variance, so identity and free form are fitted as one linear model with one kind of prior. The process is nearly
symmetric; eyeballs, teeth and tongue move as one piece each, lids with their eyeball.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from service.arrays import AnyFloat, AnyInt, Bool, Float32, Float64, Int32
from service.face.fit.fit import FitSettings
from service.face.fit.solver import POSE, Damping, PointTerm, Prior, State, linear, minimise, project_points, weak_pose
from service.head.model import HeadModel
from service.head.regions import part_vertices
from service.robust import geman_mcclure


def at_barycentric(values: AnyFloat, corners: AnyInt, weights: AnyFloat) -> Float64:
    """(..., V, C) per-vertex values -> (..., L, C) at barycentric points: corners (L, 3) vertices, weights (L, 3)."""
    points = (values[..., corners, :].astype(np.float64) * weights.astype(np.float64)[..., None]).sum(-2)
    return np.ascontiguousarray(points)  # indexing in the middle leaves an order that makes every product copy


def linear_points(
    head: HeadModel, corners: AnyInt, weights: AnyFloat, identities: int | None = None
) -> tuple[Float64, Float32]:
    """Points of a head as a linear function of its coefficients: mean (L, 3) and modes (L, 3, K + E), metres.

    Args:
        head: any head model.
        corners: (L, n) vertices.
        weights: (L, n) of each, barycentric in triangles.
        identities: how many components of identity count; None: all.
    """
    parts, say = (head.identity[:identities], head.expression), weights.astype(np.float32)[..., None]
    each = zip(corners.T, say.swapaxes(0, 1), strict=True)
    modes = sum(np.concatenate([part[:, corner] for part in parts]) * share for corner, share in each)
    return at_barycentric(head.mean, corners, weights), np.ascontiguousarray(np.moveaxis(modes, 0, 2))


@dataclass(frozen=True)
class LandmarkBasis:
    """Landmark positions as a linear function of the coefficients.

    Attributes:
        mean: (L, 3) metres.
        modes: (L, 3, K + E) metres per unit coefficient, identity first.
        normals: (L, 3) unit normals on the average head.
        sigma: (L,) metres, expected scatter of the detector.
    """

    mean: Float64
    modes: Float32
    normals: Float64
    sigma: Float64

    def points(self, coefficients: Float64) -> Float64:
        """(K + E,) -> (L, 3) metres."""
        return linear(self.mean, self.modes, coefficients)


class LandmarkModel:
    """Landmark bases of a head; the contour landmarks slide over the surface with the yaw."""

    def __init__(self, head: HeadModel, identity_components: int) -> None:
        self.identity_count = min(identity_components, len(head.identity))
        self.expression_count = len(head.expression)
        self.expression_names = head.expression_names
        self._contour = head.contour_landmarks
        self._yaw = np.asarray(head.contour_yaw_deg, np.float64)
        corners = head.triangles[head.landmark_triangle]
        self._fixed = self._gather(head, corners, head.landmark_barycentric)
        slide = head.triangles[head.contour_triangle.ravel()]
        self._slide = self._gather(head, slide, head.contour_barycentric.reshape(-1, 3))
        self._sigma = np.asarray(head.landmark_spread, np.float64)

    @property
    def shape_count(self) -> int:
        """Identity and expression coefficients together."""
        return self.identity_count + self.expression_count

    def _gather(self, head: HeadModel, corners: Int32, weights: Float32) -> tuple[Float64, Float32, Float64]:
        """Mean (L, 3), modes (L, 3, K + E) and normals (L, 3) at barycentric points of the mesh."""
        p = head.mean[corners].astype(np.float64)
        normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        points = linear_points(head, corners, weights, self.identity_count)
        return *points, np.where(length > 1e-15, normals / np.maximum(length, 1e-15), 0.0)

    def at_yaw(self, yaw_deg: float) -> LandmarkBasis:
        """The basis for a head turned by ``yaw_deg``; contour landmarks are interpolated between calibrated yaws."""
        mean, modes, normals = own = self._fixed[0].copy(), self._fixed[1].copy(), self._fixed[2].copy()
        count = len(self._contour)
        if count and len(self._yaw):
            yaw = float(np.clip(yaw_deg, self._yaw[0], self._yaw[-1]))
            high = int(np.clip(np.searchsorted(self._yaw, yaw), 1, max(len(self._yaw) - 1, 1)))
            low = high - 1
            gap = self._yaw[high] - self._yaw[low] if high < len(self._yaw) else 0.0
            t = (yaw - self._yaw[low]) / gap if gap > 0 else 0.0
            high = min(high, len(self._yaw) - 1)
            tables: list[tuple[AnyFloat, AnyFloat]] = list(zip(own, self._slide, strict=True))
            for out, table in tables:
                a, b = table[low * count : (low + 1) * count], table[high * count : (high + 1) * count]
                out[self._contour] = (1 - t) * a + t * b
        length = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        return LandmarkBasis(mean, modes, normals / length, self._sigma)


FIELDS = ((0.045, 0.9e-3), (0.022, 0.6e-3), (0.012, 0.3e-3))
"""Length scale and standard deviation, metres, of the processes that are summed."""
ASYMMETRIC = 0.12
"""Share of the variance that differs between left and right."""
RIGID = ("eye_left", "eye_right", "teeth_upper", "teeth_lower", "tongue")
"""Parts that move as one piece, where the head has them."""


def process_places(head: HeadModel) -> Float64:
    """(V, 3) metres where the process is looked up for each vertex: itself, or the middle of its rigid part."""
    points = head.mean.astype(np.float64)
    for members in (part_vertices(head, name) for name in RIGID if name in head.part_names):
        points[members] = 0.5 * (points[members].min(0) + points[members].max(0))
    socket = head.region("eye_socket") > 0.5
    # Lids and sockets go with their eyeball, whatever the field does there.
    for eye in (part_vertices(head, name) for name in ("eye_left", "eye_right") if name in head.part_names):
        centre = points[eye[0]]
        near = np.exp(-((np.linalg.norm(head.mean - centre, axis=1) / 0.020) ** 4))[:, None]
        near[socket & (np.sign(head.mean[:, 0]) == np.sign(centre[0]))] = 1.0
        points = points + near * (centre - points)
    return np.asarray(points)


def kernel(one: Float64, other: Float64) -> Float64:
    """(N, M) square metres: covariance of the displacements of points (N, 3) and (M, 3) along one axis."""
    square = np.maximum((one**2).sum(1)[:, None] + (other**2).sum(1) - 2.0 * one @ other.T, 0.0)
    return np.asarray(sum(sigma**2 * np.exp(-square / (2.0 * length**2)) for length, sigma in FIELDS))


@lru_cache(maxsize=1)
def modes(head: HeadModel, count: int) -> Float32:
    """(count, V, 3) float32 metres: the process's strongest modes on the head, each of unit variance; read only."""
    points = process_places(head)
    flip = np.array([-1.0, 1.0, 1.0])
    face = np.flatnonzero((head.region("face") > 0.5) & (head.mean[:, 0] >= 0.0))
    # Points of half the face on which the process is decomposed.
    handles = points[_spread(points, face, 260)]
    here, across = ([kernel(some, handles * side) for some in (handles, points)] for side in (np.ones(3), flip))
    fields: list[tuple[float, Float64, int, float]] = []
    for sign in (1.0, -1.0):
        direct, on_head = (own + sign * mirrored for own, mirrored in zip(here, across, strict=True))
        values, vectors = np.linalg.eigh(direct)
        strong = values > 1e-6 * values[-1]
        field = on_head @ (vectors[:, strong] / np.sqrt(values[strong]))
        for value, column in zip(values[strong], field.T, strict=True):
            for axis in range(3):
                # An even field is a symmetric displacement along y and z, an odd one along x.
                share = 1.0 - ASYMMETRIC if (axis == 0) == (sign < 0) else ASYMMETRIC
                fields.append((share * float(value), column, axis, np.sqrt(share)))
    fields.sort(key=lambda field: -field[0])
    result = np.zeros((min(count, len(fields)), len(points), 3), np.float32)
    for k, (_, column, axis, share) in enumerate(fields[: len(result)]):
        result[k, :, axis] = share * column
    return result


def _spread(points: Float64, among: np.ndarray, count: int) -> list[int]:
    """Indices of at most ``count`` points of ``among``, each as far from those before as can be."""
    chosen = [int(among[0])]
    distance = np.linalg.norm(points[among] - points[chosen[0]], axis=1)
    while len(chosen) < min(count, len(among)):
        chosen.append(int(among[int(distance.argmax())]))
        distance = np.minimum(distance, np.linalg.norm(points[among] - points[chosen[-1]], axis=1))
    return chosen


def extended(head: HeadModel, components: int, beyond: int) -> HeadModel:
    """The head with its first ``components`` of identity and ``beyond`` modes of the process after them.

    Args:
        head: any head model.
        components: as in ``FitSettings``; more than the head has means all.
        beyond: number of modes.
    """
    further = [modes(head, beyond)] if beyond else []
    return replace(head, identity=np.concatenate([head.identity[:components], *further]))


IDENTITY_BOX = 4.0
"""Bound of the magnitude of identity coefficients, standard deviations."""
ANNEAL = (6.0, 6.0, 4.0, 3.0, 2.5)
"""Geman-McClure scale in standard deviations of each round; the first round moves the pose alone."""
GRAZING = 0.1
"""Half width of the ramp from hidden (0) to visible (1), in the cosine between normal and viewing direction."""


@dataclass(frozen=True)
class LandmarkFit:
    """Result of the landmark stage.

    Attributes:
        state: pose and coefficients.
        basis: landmark basis at the final yaw.
        weight: (L,) in [0, 1] of each landmark: visibility times robust weight; 0 where it is not finite.
    """

    state: State
    basis: LandmarkBasis
    weight: Float64


@dataclass(frozen=True)
class Observed:
    """Landmarks as the fit takes them.

    Attributes:
        pixels: (L, 2) relative to the principal point; 0 where one is not finite.
        trust: (L,) 1, or 0 where one is not finite.
    """

    pixels: Float64
    trust: Float64

    @classmethod
    def of(cls, landmarks: Float64, middle: Float64) -> Observed:
        """From (L, 3) photo pixels and the principal point (2,); the networks' depth is not followed: it misleads."""
        good: Bool = np.asarray(np.isfinite(landmarks).all(1))
        known = np.where(good[:, None], landmarks, 0.0)
        return cls(known[:, :2] - middle, good.astype(np.float64))


def facing(normals: Float64, positions: Float64, rotation: Float64) -> Float64:
    """(N,) in [0, 1]: 1 where a surface faces the camera, 0 where it is turned away.

    Args:
        normals: (N, 3) unit, head space.
        positions: (N, 3) camera space.
        rotation: (3, 3) head to camera.
    """
    view = positions / np.maximum(np.linalg.norm(positions, axis=1, keepdims=True), 1e-9)
    cosine = -((normals @ rotation.T) * view).sum(1)
    return np.asarray(np.clip((cosine + GRAZING) / (2 * GRAZING), 0.0, 1.0))


def start_state(model: LandmarkModel, pixels: Float64, trust: Float64, log_distance: float) -> State:
    """Initial pose on the average head, solved twice, since its yaw selects the contour landmarks."""
    yaw = 0.0
    for _ in range(2):
        basis = model.at_yaw(yaw)
        pose = weak_pose(basis.mean, pixels, trust / basis.sigma**2)
        scale = max(pose.scale, 1e-3)
        state = State(
            pose.rotation, pose.offset / scale, float(np.log(scale)), log_distance, np.zeros(model.shape_count)
        )
        yaw = state.yaw_deg
    return state


def bounds(model: LandmarkModel) -> tuple[Float64, Float64]:
    """(n,) lower and upper bounds of the unknowns."""
    upper = np.full(POSE + model.shape_count, np.inf)
    lower = -upper
    # Bounds of the camera's distance, metres; they also stop a focal length that diverges.
    lower[6], upper[6] = np.log((0.15, 20.0))
    split = POSE + model.identity_count
    lower[POSE:split], upper[POSE:split] = -IDENTITY_BOX, IDENTITY_BOX
    lower[split:], upper[split:] = 0.0, 1.0
    return lower, upper


def weigh_landmarks(state: State, basis: LandmarkBasis, seen: Observed, c: float) -> tuple[Float64, PointTerm]:
    """(L,) weights of the landmarks at a state, and their term with these weights."""
    points = basis.points(state.coefficients)
    projection = project_points(state, points)
    residual = np.linalg.norm(projection.uv - seen.pixels, axis=1)
    # Scatter of a landmark on real photos in addition to that on rendered heads, metres on the face.
    sigma = state.scale * np.hypot(basis.sigma, 0.0016)
    # Where all landmarks are off by more than expected (blur, sketches), the scale of the weights follows.
    typical = float(np.median(residual[seen.trust > 0])) if (seen.trust > 0).any() else 0.0
    robust = geman_mcclure(residual, c * np.maximum(np.maximum(sigma, 0.5 * typical), 1e-12))
    weight = seen.trust * robust * facing(basis.normals, projection.position, state.rotation)
    # Effective over actual number of landmarks: errors of neighbours are correlated.
    precision = 0.5 * weight / np.maximum(sigma, 1e-9) ** 2
    return weight, PointTerm(basis.mean, basis.modes, seen.pixels, precision)


def fit_landmarks(
    model: LandmarkModel, observed: Sequence[Observed], priors: Sequence[Prior], settings: FitSettings
) -> list[LandmarkFit]:
    """Fit one head to the landmarks of photos.

    Args:
        model: landmark bases of the head.
        observed: the landmarks of each photo.
        priors: on distance, focal length and shape, for each photo.
        settings: number of iterations.

    Returns:
        A finite fit for each photo, all with the same identity.
    """
    own = once(priors, model.identity_count)
    states = [start_state(model, seen.pixels, seen.trust, prior.log_distance)
              for seen, prior in zip(observed, priors, strict=True)]  # fmt: skip
    lower, upper = bounds(model)
    damping = Damping()
    share = -(-settings.iterations // (len(ANNEAL) - 1))
    for round_, c in enumerate(ANNEAL):
        active = np.ones(len(lower), bool)
        active[POSE:] = round_ > 0
        terms = [
            (weigh_landmarks(state, model.at_yaw(state.yaw_deg), seen, c)[1], prior)
            for state, seen, prior in zip(states, observed, own, strict=True)
        ]
        states = minimise(
            states, terms, shared=identity_of(model), lower=lower, upper=upper, damping=damping,
            steps=share if round_ else 8, active=active,
        )  # fmt: skip
    return [landmark_fit(model, state, seen) for state, seen in zip(states, observed, strict=True)]


def landmark_fit(model: LandmarkModel, state: State, seen: Observed) -> LandmarkFit:
    """The result at a state."""
    basis = model.at_yaw(state.yaw_deg)
    return LandmarkFit(state, basis, weigh_landmarks(state, basis, seen, ANNEAL[-1])[0])


def identity_of(model: LandmarkModel) -> slice:
    """Place of the identity among the unknowns: what all photos share."""
    return slice(POSE, POSE + model.identity_count)


def once(priors: Sequence[Prior], identity_count: int) -> list[Prior]:
    """The priors of photos of one person: of the identity, only the first one's counts."""
    own = [*priors[:1]]
    for prior in priors[1:]:
        precision = prior.shape_precision.copy()
        precision[:identity_count] = 0.0
        own.append(replace(prior, shape_precision=precision))
    return own
