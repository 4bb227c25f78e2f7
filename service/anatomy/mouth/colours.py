"""Colours inside the mouth: the one place to change them. All are diffuse albedo, linear RGB in [0, 1]."""

from __future__ import annotations

import numpy as np

TONGUE = np.array([0.357, 0.114, 0.107], np.float32)
"""Top of the tongue."""

LINING = np.array([0.23, 0.052, 0.046], np.float32)
"""Mucosa that lines the mouth: inside of lips and cheeks, palate."""
