"""Stage B of the fit: the landmark fit refined by what the photos show at their pixels.

Poses, expressions, identity and free form are solved together, on landmarks, outline and, where a photo was read,
places and normals; every round weighs them anew at the state that the round before has found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.arrays import Float64, UInt8
from service.face.fit.basis import LandmarkModel, extended
from service.face.fit.dense import Correspondences, DenseTerms
from service.face.fit.face_light import Softened, light_on_face
from service.face.fit.landmark_fit import (
    ANNEAL,
    LandmarkFit,
    Observed,
    bounds,
    identity_of,
    landmark_fit,
    once,
    weigh_landmarks,
)
from service.face.fit.outline import OutlineFinder
from service.face.fit.pose_state import POSE, State
from service.face.fit.solver import Damping, PointTerm, Prior, Term, minimise
from service.face.fit.stereo import Picture, stereo_terms
from service.head.model import HeadModel
from service.robust import smoothstep

REACH_M = (0.008, 0.004)
"""Half length of the outline's search lines in each round, metres on the face."""
STEPS = 4
"""Solver steps of each round."""
PROFILE_DEG = (68.0, 52.0)
"""Yaw from which on landmarks and the normals that were read are not followed where places were read, and up to which
they are: the landmark network draws the hidden half of profiles, and both turn these some degrees to the camera."""
HARDLY = 0.02
"""Least weight of what is still followed."""
STEREO_ROUNDS = 5
"""Further rounds, of several photos, with the spots that these have in common."""


@dataclass(frozen=True)
class Sight:
    """One photo as the fit sees it.

    Attributes:
        photo: (H, W, 3) uint8 sRGB; the principal point is its middle.
        observed: the landmarks.
        prior: of the plain head's fit.
        initial: the landmark fit of the plain head.
        found: places of the head that were read off the photo; None: they were not.
    """

    photo: UInt8
    observed: Observed
    prior: Prior
    initial: LandmarkFit
    found: Correspondences | None

    @property
    def middle(self) -> Float64:
        """(2,) the principal point, pixels."""
        return middle_of(self.photo)


def middle_of(photo: UInt8) -> Float64:
    """(2,) the principal point of a photo (H, W, 3), pixels."""
    return np.array([photo.shape[1] / 2, photo.shape[0] / 2])


class PixelFit:
    """Refines landmark fits of one head model.

    Args:
        head: the head model.
        components: how many of its identity components are fitted.
        beyond: number of modes of free form beyond them.
    """

    def __init__(self, head: HeadModel, components: int, beyond: int) -> None:
        self.components = min(components, len(head.identity))
        self.head = extended(head, self.components, beyond)
        self.beyond = len(self.head.identity) - self.components
        self.model = LandmarkModel(self.head, len(self.head.identity))
        self.outline = OutlineFinder(self.head)

    def refine(self, sights: Sequence[Sight], *, normals: bool) -> list[tuple[LandmarkFit, Float64 | None]]:
        """For each photo the refined fit, its coefficients those of the extended head, and the light on the face there.

        Args:
            sights: the photos, all of one identity.
            normals: whether the normals that were read are followed, too.
        """
        states, priors = [], []
        for sight in sights:
            widened = self._widened(sight.initial.state.coefficients, 0.0)
            states.append(replace(sight.initial.state, coefficients=widened))
            precision, mean = sight.prior.shape_precision, sight.prior.shape_mean
            priors.append(
                replace(sight.prior, shape_precision=self._widened(precision, 1.0), shape_mean=self._widened(mean, 0.0))
            )
        priors = once(priors, self.model.identity_count)
        dense = [None if sight.found is None else DenseTerms(self.head, sight.found) for sight in sights]
        lower, upper = bounds(self.model)
        soft = [
            Softened.around(sight.photo, sight.middle, state, self._vertices(state))
            for sight, state in zip(sights, states, strict=True)
        ]
        rounds = REACH_M if len(sights) == 1 else (*REACH_M, *(REACH_M[-1:] * STEREO_ROUNDS))
        for round_, reach in enumerate(rounds):
            seen: list[list[PointTerm]] = [[] for _ in sights]
            if round_ >= len(REACH_M):
                pictures = [
                    Picture.of(sight.photo, sight.middle, self.head, state, self._vertices(state))
                    for sight, state in zip(sights, states, strict=True)
                ]
                seen = stereo_terms(self.head, pictures)
            terms: list[list[Term]] = []
            for sight, state, prior, read, image, spots in zip(sights, states, priors, dense, soft, seen, strict=True):
                vertices = self._vertices(state)
                basis = self.model.at_yaw(state.yaw_deg)
                points = weigh_landmarks(state, basis, sight.observed, ANNEAL[-1])[1]
                own: list[Term] = [points, prior]
                if read is not None:
                    squarely = max(float(smoothstep(np.array(abs(state.yaw_deg)), *PROFILE_DEG)), HARDLY)
                    own[0] = replace(points, precision=points.precision * squarely)
                    own.append(read.points(state))
                    own += [read.normals(state, vertices)] if normals and squarely > HARDLY else []
                outline = self.outline.term(image, sight.middle, state, vertices, reach)
                terms.append([*own, *([] if outline is None else [outline]), *spots])
            states = minimise(
                states, terms, shared=identity_of(self.model), lower=lower, upper=upper, damping=Damping(),
                steps=STEPS, active=np.ones(POSE + self.model.shape_count, bool),
            )  # fmt: skip
        return [
            (
                landmark_fit(self.model, state, sight.observed),
                light_on_face(self.head, state, self._vertices(state), sight.photo, sight.middle),
            )
            for sight, state in zip(sights, states, strict=True)
        ]

    def _widened(self, coefficients: Float64, beyond: float) -> Float64:
        """Values (K + E,) of the plain head's coefficients with one for each mode beyond its components."""
        identity, expression = np.split(coefficients, [self.components])
        return np.concatenate([identity, np.full(self.beyond, beyond), expression])

    def _vertices(self, state: State) -> Float64:
        """(V, 3) metres at a state."""
        return self.head.shape(*np.split(state.coefficients, [len(self.head.identity)])).astype(np.float64)
