"""Stage B of the fit: the landmark fit refined by what the photo shows at its pixels.

Pose, identity, expression and free form are solved together, on landmarks, outline and, where the photo was read,
places and normals; every round weighs them anew at the state that the round before has found.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.arrays import Float64, UInt8
from service.face.fit.basis import LandmarkModel, extended
from service.face.fit.dense import Correspondences, DenseTerms
from service.face.fit.face_light import Softened, light_on_face
from service.face.fit.landmark_fit import ANNEAL, LandmarkFit, Observed, bounds, weigh_landmarks
from service.face.fit.outline import OutlineFinder
from service.face.fit.pose_state import POSE, State
from service.face.fit.solver import Damping, Prior, Term, minimise
from service.head.model import HeadModel

REACH_M = (0.008, 0.004)
"""Half length of the outline's search lines in each round, metres on the face."""
STEPS = 4
"""Solver steps of each round."""


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

    def refine(
        self, initial: LandmarkFit, observed: Observed, photo: UInt8, prior: Prior, found: Correspondences | None,
        normals: bool,
    ) -> tuple[LandmarkFit, Float64 | None]:  # fmt: skip
        """The refined fit, its coefficients those of the extended head, and the light on the face there.

        Args:
            initial: the landmark fit of the plain head.
            observed: the landmarks.
            photo: (H, W, 3) uint8 sRGB; the principal point is its middle.
            prior: of the plain head's fit.
            found: places of the head that were read off the photo; None: they were not.
            normals: whether their normals are followed, too.
        """
        middle = np.array([photo.shape[1] / 2, photo.shape[0] / 2])
        state = replace(initial.state, coefficients=self._widened(initial.state.coefficients, 0.0))
        prior = replace(
            prior, shape_precision=self._widened(prior.shape_precision, 1.0),
            shape_mean=self._widened(prior.shape_mean, 0.0),
        )  # fmt: skip
        dense = None if found is None else DenseTerms(self.head, found)
        lower, upper = bounds(self.model)
        soft = Softened.around(photo, middle, state, self._vertices(state))
        for reach in REACH_M:
            vertices = self._vertices(state)
            basis = self.model.at_yaw(state.yaw_deg)
            terms: list[Term] = [weigh_landmarks(state, basis, observed, ANNEAL[-1])[1], prior]
            if dense is not None:
                terms += [dense.points(state), *([dense.normals(state, vertices)] if normals else [])]
            outline = self.outline.term(soft, middle, state, vertices, reach)
            terms += [] if outline is None else [outline]
            active = np.ones(POSE + self.model.shape_count, bool)
            state = minimise(state, terms, lower=lower, upper=upper, damping=Damping(), steps=STEPS, active=active)
        basis = self.model.at_yaw(state.yaw_deg)
        light = light_on_face(self.head, state, self._vertices(state), photo, middle)
        return LandmarkFit(state, basis, weigh_landmarks(state, basis, observed, ANNEAL[-1])[0]), light

    def _widened(self, coefficients: Float64, beyond: float) -> Float64:
        """Values (K + E,) of the plain head's coefficients with one for each mode beyond its components."""
        identity, expression = np.split(coefficients, [self.components])
        return np.concatenate([identity, np.full(self.beyond, beyond), expression])

    def _vertices(self, state: State) -> Float64:
        """(V, 3) metres at a state."""
        return self.head.shape(*np.split(state.coefficients, [len(self.head.identity)])).astype(np.float64)
