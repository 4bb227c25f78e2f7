"""Stage C of the fit: the landmark fit refined by what the reader sees at every pixel.

Pose, identity, expression and free form are solved together, on landmarks, correspondences, normals, outline and
shading; every round weighs them anew at the state that the round before has found.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.arrays import Bool, Float64, UInt8
from service.face.fit.basis import LandmarkModel
from service.face.fit.beyond import extended
from service.face.fit.dense import DenseTerms, correspondences, seen_share
from service.face.fit.landmarks import LandmarkFit, bounds, weigh
from service.face.fit.pixels import REACH_M, PixelRefiner, softened, vertices_at
from service.face.fit.settings import FitSettings
from service.face.fit.solver import Damping, minimise
from service.face.fit.state import POSE, State
from service.face.fit.terms import Prior, Term
from service.face.reading.reader import Reading
from service.head.model import HeadModel

STEPS = 4
"""Solver steps of each round."""
FEWEST_CELLS = 150
"""Fewest cells with a place on the head from which a reading is followed."""
LEAST_AGREEMENT = 0.3
"""Least share of them that has to agree with the landmark fit: below it, reader and landmarks see different faces."""


class Refiner:
    """Refines landmark fits of one head model by readings.

    Args:
        head: the head model.
        settings: identity components, number of the modes beyond them, whether normals are followed.
    """

    def __init__(self, head: HeadModel, settings: FitSettings) -> None:
        self.plain, self.normals = head, settings.normals
        self.components = min(settings.identity_components, len(head.identity))
        self.head = extended(head, self.components, settings.beyond if settings.refine == "full" else 0)
        self.beyond = len(self.head.identity) - self.components
        self.model = LandmarkModel(self.head, len(self.head.identity))
        self.edges = PixelRefiner(self.head, self.model)

    def refine(
        self, initial: LandmarkFit, face: Float64, photo: UInt8, reading: Reading, prior: Prior
    ) -> LandmarkFit | None:
        """The refined fit, its coefficients those of the extended head; None where the reading is not understood.

        Args:
            initial: the landmark fit of the plain head.
            face: (L, 3) landmarks, photo pixels.
            photo: (H, W, 3) uint8 sRGB; the principal point is its middle.
            reading: of the same photo.
            prior: of the plain head's fit.
        """
        middle = np.array([photo.shape[1] / 2, photo.shape[0] / 2])
        state = self._widened(initial.state)
        found = correspondences(self.head, reading, state, middle)
        if len(found.pixels) < FEWEST_CELLS:
            return None
        dense = DenseTerms(self.head, found)
        if seen_share(found, state, dense) < LEAST_AGREEMENT:
            return None
        prior = self._prior(prior)
        good: Bool = np.asarray(np.isfinite(face).all(1))
        known = np.where(good[:, None], face, 0.0)
        trust = good.astype(np.float64)
        lower, upper = bounds(self.model)
        soft = softened(photo, middle, state, vertices_at(self.head, state).astype(np.float64))
        for reach in REACH_M:
            vertices = vertices_at(self.head, state)
            basis = self.model.at_yaw(state.yaw_deg)
            near = weigh(state, basis, known[:, :2] - middle, known[:, 2], trust, 2.5)[1]
            read = (dense.points(state), *((dense.normals(state, vertices),) if self.normals else ()))
            terms: tuple[Term, ...] = (*near, prior, *read, *self.edges.terms(soft, middle, state, reach))
            active = np.ones(POSE + self.model.shape_count, bool)
            state = minimise(state, terms, lower=lower, upper=upper, damping=Damping(), steps=STEPS, active=active)
        basis = self.model.at_yaw(state.yaw_deg)
        weight, near = weigh(state, basis, known[:, :2] - middle, known[:, 2], trust, 2.5)
        return LandmarkFit(state, basis, weight, (*near, prior))

    def _widened(self, state: State) -> State:
        identity, expression = np.split(state.coefficients, [self.components])
        return replace(state, coefficients=np.concatenate([identity, np.zeros(self.beyond), expression]))

    def _prior(self, prior: Prior) -> Prior:
        def widened(values: Float64, beyond: float) -> Float64:
            identity, expression = np.split(values, [self.components])
            return np.concatenate([identity, np.full(self.beyond, beyond), expression])

        return replace(
            prior, shape_precision=widened(prior.shape_precision, 1.0), shape_mean=widened(prior.shape_mean, 0.0)
        )
