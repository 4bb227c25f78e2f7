"""Colours of teeth and gums: the one place to change them. All are diffuse albedo, linear RGB in [0, 1]."""

from __future__ import annotations

import numpy as np

TOOTH = np.array([0.74, 0.68, 0.60], np.float32)
"""Wet teeth as photos show them: slightly yellow."""

GUMS = np.array([0.41, 0.157, 0.143], np.float32)
"""Wet gums."""

WHITEST = (0.96, 0.92)
"""Largest reflectance of teeth in green and blue, over that in red: even bleached ones are yellower."""
