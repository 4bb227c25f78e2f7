"""Real spherical harmonics up to degree 2 on tensors; ``service.light.formulas`` is the definition, in numpy."""

from __future__ import annotations

import torch
from torch import Tensor


def basis(d: Tensor) -> Tensor:
    """(9, ...) values at unit directions (3, ...), in the order of ``service.light.formulas.basis``."""
    x, y, z = d
    one = torch.ones_like(x)
    first = [0.28209479177387814 * one, 0.4886025119029199 * y, 0.4886025119029199 * z, 0.4886025119029199 * x]
    second = [1.0925484305920792 * x * y, 1.0925484305920792 * y * z, 0.31539156525252005 * (3.0 * z * z - 1.0)]
    third = [1.0925484305920792 * x * z, 0.5462742152960396 * (x * x - y * y)]
    return torch.stack(first + second + third)
