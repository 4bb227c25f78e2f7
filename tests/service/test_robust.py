from __future__ import annotations

import numpy as np

from service.robust import geman_mcclure


def test_weights_fall_from_one_and_do_not_depend_on_the_sign() -> None:
    weights = geman_mcclure(np.array([0.0, -2.0, 2.0, 200.0]), 2.0)
    np.testing.assert_allclose(weights[:3], [1.0, 0.25, 0.25])
    assert 0 < weights[3] < 1e-7
