"""Stage B of the fit: the landmark fit refined by the silhouette and the shading of the face in the photo.

Each round finds edges along the occluding contour of the current head (``contour.py``), estimates the light from the
visible skin (``shading.py``), and solves again with the landmark terms kept.
"""

from __future__ import annotations

import numpy as np

from service.arrays import Float32, Float64, UInt8
from service.face.fit.basis import LandmarkModel
from service.face.fit.contour import OutlineFinder, outline_term
from service.face.fit.landmarks import LandmarkFit, bounds
from service.face.fit.shading import light_on_face, shading_term
from service.face.fit.softened import Softened
from service.face.fit.solver import Damping, minimise
from service.face.fit.state import POSE, State, project
from service.face.fit.terms import Term
from service.head.model import HeadModel

REACH_M = (0.008, 0.004)
"""Half length of the contour's search lines in each round, metres on the face."""
BLUR_M = 0.0012
"""Standard deviation of the photo's blur before edges are searched, metres on the face."""
STEPS = 4
"""Solver steps of each round."""


class PixelRefiner:
    """Refines landmark fits of one head model."""

    def __init__(self, head: HeadModel, model: LandmarkModel) -> None:
        self.head, self.model = head, model
        self.outline = OutlineFinder(head)

    def refine(self, initial: LandmarkFit, pixels: UInt8, middle: Float64) -> tuple[State, Float64 | None]:
        """The refined state, and the light on the face there (:func:`light_on_face`).

        Where the photo has neither edges nor shading, the state is that of the landmark fit.

        Args:
            initial: the landmark fit.
            pixels: (H, W, 3) uint8 sRGB.
            middle: (2,) principal point in pixels.
        """
        state = initial.state
        soft = softened(pixels, middle, state, self._vertices(state))
        lower, upper = bounds(self.model)
        active = np.ones(POSE + self.model.shape_count, bool)
        for reach in REACH_M:
            terms = (*initial.terms, *self.terms(soft, middle, state, reach))
            state = minimise(state, terms, lower=lower, upper=upper, damping=Damping(), steps=STEPS, active=active)
        return state, light_on_face(self.head, soft, middle, state, self._vertices(state))

    def terms(self, soft: Softened, middle: Float64, state: State, reach: float) -> list[Term]:
        """The outline's and the shading's terms at a state, as far as the photo shows them.

        Args:
            soft: the photo blurred by ``BLUR_M``.
            middle: (2,) principal point in pixels.
            state: pose and shape.
            reach: half length of the search lines, metres on the face.
        """
        vertices = self._vertices(state)
        found: list[Term | None] = [
            self._outline(soft, middle, state, vertices, reach),
            shading_term(self.head, self.model, soft, middle, state, vertices),
        ]
        return [term for term in found if term is not None]

    def _vertices(self, state: State) -> Float64:
        identity, expression = np.split(state.coefficients, [self.model.identity_count])
        return self.head.shape(identity, expression).astype(np.float64)

    def _outline(self, photo: Softened, middle: Float64, state: State, vertices: Float64, reach: float) -> Term | None:
        outline = self.outline.find(state, vertices)
        ends = outline.vertices
        count = self.model.identity_count
        modes = np.concatenate([self.head.identity[:count, ends].mean(2), self.head.expression[:, ends].mean(2)])
        mean = self.head.mean[ends].mean(1)
        return outline_term(photo, middle, state, outline, mean.astype(np.float64), modes.astype(np.float64), reach)


def vertices_at(head: HeadModel, state: State) -> Float32:
    """(V, 3) metres of a head at a state with all coefficients of its identity."""
    return head.shape(*np.split(state.coefficients, [len(head.identity)]))


def softened(pixels: UInt8, middle: Float64, state: State, vertices: Float64) -> Softened:
    """A photo blurred by ``BLUR_M`` around the head whose vertices (V, 3) are those at a state."""
    return Softened.of(pixels, BLUR_M * state.scale, project(state, vertices).uv + middle)


def light_of(head: HeadModel, state: State, pixels: UInt8, middle: Float64) -> Float64 | None:
    """The light on the face at a state of ``head``, as :meth:`PixelRefiner.refine` gives it."""
    vertices = vertices_at(head, state).astype(np.float64)
    soft = softened(pixels, middle, state, vertices)
    return light_on_face(head, soft, middle, state, vertices)
