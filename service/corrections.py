"""All corrections in the order in which they run: rules that alter what a network or the photo gave.

``avatarme make --without NAME,...`` switches them off; ``benchmarks.corrections`` takes each on trial.
"""

from __future__ import annotations

from service.ledger import Correction
from service.reflectance.chart_light import EVERYWHERE, ON_LIT_SKIN
from service.reflectance.corrections.highlights import HIGHLIGHTS

REGISTRY: tuple[Correction, ...] = (
    *ON_LIT_SKIN,
    *EVERYWHERE,
    HIGHLIGHTS,
)

NAMES = tuple(one.name for one in REGISTRY)
