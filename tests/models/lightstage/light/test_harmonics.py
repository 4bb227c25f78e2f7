"""Spherical harmonics on tensors are those of the service."""

from __future__ import annotations

import numpy as np
import pytest

from service.light.environment import pixel_directions
from service.light.formulas import basis

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")

from models.lightstage.light import harmonics  # noqa: E402

pytestmark = pytest.mark.train


def test_the_basis_is_that_of_the_service() -> None:
    directions = pixel_directions(8, 12)
    found = harmonics.basis(torch.from_numpy(directions).permute(2, 0, 1))
    np.testing.assert_allclose(found.permute(1, 2, 0).numpy(), basis(directions), rtol=0, atol=1e-15)
