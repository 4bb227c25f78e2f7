"""Stage C of the fit: the landmark fit refined by what the reader sees at every pixel.

Pose, identity, expression and free form are solved together; every round weighs the correspondences and normals anew at
the state that the round before has found.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.arrays import Float64
from service.face.fit.basis import LandmarkModel
from service.face.fit.beyond import extended
from service.face.fit.dense import DenseTerms, correspondences, seen_share
from service.face.fit.landmarks import LandmarkFit, bounds, weigh
from service.face.fit.settings import FitSettings
from service.face.fit.solver import Damping, minimise
from service.face.fit.state import POSE, State
from service.face.fit.terms import Prior, Term
from service.face.reading.reader import Reading
from service.head.model import HeadModel

ROUNDS, STEPS = 3, 4
"""Rounds, and solver steps of each."""
FEWEST_CELLS = 150
"""Fewest cells with a place on the head from which a reading is followed."""
LEAST_AGREEMENT = 0.3
"""Least share of them that has to agree with the landmark fit: below it, reader and landmarks see different faces."""
LANDMARK_SHARE = 0.5
"""What the landmarks weigh beside the cells, over what they weigh alone."""


class Refiner:
    """Refines landmark fits of one head model by readings.

    Args:
        head: the head model.
        settings: identity components, number and strength of the modes beyond them.
    """

    def __init__(self, head: HeadModel, settings: FitSettings) -> None:
        self.plain = head
        self.components = min(settings.identity_components, len(head.identity))
        self.head = extended(head, self.components, settings.beyond)
        self.beyond = len(self.head.identity) - self.components
        self.model = LandmarkModel(self.head, len(self.head.identity))

    def refine(
        self, initial: LandmarkFit, landmarks: Float64, reading: Reading, prior: Prior, middle: Float64
    ) -> tuple[State, LandmarkFit] | None:
        """The refined state, its coefficients those of the extended head; None where the reading is not understood.

        Args:
            initial: the landmark fit of the plain head.
            landmarks: (L, 3) photo pixels.
            reading: of the same photo.
            prior: of the plain head's fit.
            middle: (2,) principal point, photo pixels.
        """
        state = self._widened(initial.state)
        found = correspondences(self.head, reading, state, middle)
        if len(found.pixels) < FEWEST_CELLS:
            return None
        dense = DenseTerms(self.head, found)
        if seen_share(found, state, dense) < LEAST_AGREEMENT:
            return None
        prior = self._prior(prior)
        good = np.isfinite(landmarks).all(1)
        known = np.where(good[:, None], landmarks, 0.0)
        trust = LANDMARK_SHARE * good.astype(np.float64)
        lower, upper = bounds(self.model)
        for _ in range(ROUNDS):
            vertices = self.head.shape(*np.split(state.coefficients, [len(self.head.identity)]))
            basis = self.model.at_yaw(state.yaw_deg)
            near = weigh(state, basis, known[:, :2] - middle, known[:, 2], trust, 2.5)[1]
            terms: tuple[Term, ...] = (*near, prior, dense.points(state), dense.normals(state, vertices))
            active = np.ones(POSE + self.model.shape_count, bool)
            state = minimise(state, terms, lower=lower, upper=upper, damping=Damping(), steps=STEPS, active=active)
        basis = self.model.at_yaw(state.yaw_deg)
        weight, near = weigh(state, basis, known[:, :2] - middle, known[:, 2], good.astype(np.float64), 2.5)
        return state, LandmarkFit(state, basis, weight, (*near, prior))

    def _widened(self, state: State) -> State:
        identity, expression = np.split(state.coefficients, [self.components])
        return replace(state, coefficients=np.concatenate([identity, np.zeros(self.beyond), expression]))

    def _prior(self, prior: Prior) -> Prior:
        identity, expression = np.split(prior.shape_precision, [self.components])
        return replace(prior, shape_precision=np.concatenate([identity, np.ones(self.beyond), expression]))
