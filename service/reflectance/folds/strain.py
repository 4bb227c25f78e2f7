"""How an expression stretches and compresses the skin: the finite strain of the surface on the chart.

With J the Jacobian of a surface over the chart and the neutral tangent frame (t along u, b across it), the right
Cauchy-Green tensor of the motion is C = J0^-T (J^T J) J0^-1; its eigenvalues are the squares of the principal
stretches (Ogden, Non-Linear Elastic Deformations, 2.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Float32


@dataclass(frozen=True)
class Strain:
    """Symmetric (h, w) float32 components of C in the neutral tangent frame: x along u, y up across it; 1, 0, 1 where
    nothing moves or the chart has no area.
    """

    xx: Float32
    xy: Float32
    yy: Float32

    @classmethod
    def of(cls, neutral: Float32, moved: Float32) -> Strain:
        """From first fundamental forms (h, w, 3) of the same chart, as ``Chart.metric`` gives them."""
        e0, f0, g0 = np.moveaxis(neutral.astype(np.float64), 2, 0)
        e, f, g = np.moveaxis(moved.astype(np.float64), 2, 0)
        along = np.sqrt(np.maximum(e0, 0))
        sound = along > 1e-6
        a = np.where(sound, along, 1)
        lean = np.where(sound, f0 / a, 0)
        square = g0 - lean * lean
        sound &= square > 1e-12
        c = np.sqrt(np.where(sound, square, 1))
        parts = (e / a**2, (f - e * lean / a) / (a * c), (g - 2 * lean * f / a + lean**2 * e / a**2) / c**2)
        still = (1.0, 0.0, 1.0)
        xx, xy, yy = (np.where(sound, part, rest).astype(np.float32) for part, rest in zip(parts, still, strict=True))
        return cls(xx, xy, yy)

    def smallest(self) -> tuple[Float32, Float32]:
        """(h, w) smallest principal stretch, and (h, w, 2) float32 unit direction of it; x where all are alike."""
        half, middle = (self.xx - self.yy) / 2, (self.xx + self.yy) / 2
        radius = np.hypot(half, self.xy)
        angle = np.where(radius > 1e-9, np.arctan2(self.xy, half) / 2 + np.pi / 2, 0.0)
        stretch = np.sqrt(np.maximum(middle - radius, 0))
        return stretch.astype(np.float32), np.stack([np.cos(angle), np.sin(angle)], -1).astype(np.float32)

    def along(self, direction: Float32) -> Float32:
        """(h, w) stretch of lines in directions (h, w, 2), unit vectors of the neutral frame."""
        x, y = np.moveaxis(direction, 2, 0)
        return np.asarray(np.sqrt(np.maximum(self.xx * x * x + 2 * self.xy * x * y + self.yy * y * y, 0)), np.float32)
