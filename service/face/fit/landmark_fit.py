"""Stage A of the fit: identity, and for each photo pose, distance and expression, from landmarks.

A maximum a posteriori estimate by damped least squares with iteratively re-weighted residuals: Geman-McClure weights
whose scale is annealed, so that outliers (hidden cheeks, hair, hands) lose their weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.arrays import Bool, Float64
from service.face.fit.basis import LandmarkBasis, LandmarkModel
from service.face.fit.pose_state import POSE, State, project_points, weak_pose
from service.face.fit.settings import FitSettings
from service.face.fit.solver import Damping, PointTerm, Prior, minimise
from service.robust import geman_mcclure

DISTANCE_M = (0.15, 20.0)
"""Bounds of the camera's distance, metres; they also stop a focal length that diverges."""
IDENTITY_BOX = 4.0
"""Bound of the magnitude of identity coefficients, standard deviations."""
DETECTOR_SIGMA_M = 0.0016
"""Scatter of a landmark on real photos in addition to that on rendered heads, metres on the face."""
EFFECTIVE_SHARE = 0.5
"""Effective over actual number of landmarks: errors of neighbours are correlated."""
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
    lower[6], upper[6] = np.log(DISTANCE_M)
    split = POSE + model.identity_count
    lower[POSE:split], upper[POSE:split] = -IDENTITY_BOX, IDENTITY_BOX
    lower[split:], upper[split:] = 0.0, 1.0
    return lower, upper


def weigh_landmarks(state: State, basis: LandmarkBasis, seen: Observed, c: float) -> tuple[Float64, PointTerm]:
    """(L,) weights of the landmarks at a state, and their term with these weights."""
    points = basis.points(state.coefficients)
    projection = project_points(state, points)
    residual = np.linalg.norm(projection.uv - seen.pixels, axis=1)
    sigma = state.scale * np.hypot(basis.sigma, DETECTOR_SIGMA_M)
    # Where all landmarks are off by more than expected (blur, sketches), the scale of the weights follows.
    typical = float(np.median(residual[seen.trust > 0])) if (seen.trust > 0).any() else 0.0
    robust = geman_mcclure(residual, c * np.maximum(np.maximum(sigma, 0.5 * typical), 1e-12))
    weight = seen.trust * robust * facing(basis.normals, projection.position, state.rotation)
    precision = EFFECTIVE_SHARE * weight / np.maximum(sigma, 1e-9) ** 2
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
