"""Scraps of neck: what shows between jaw and collar is too little to tell skin from cloth and shadow from stain."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.geometry.chart import Chart
from service.ledger import Correction
from service.texture.segmentation.zones import Zones

Float = npt.NDArray[np.float32]

OF_NECK = 0.3
"""Mean of the neck's mask from which a patch counts as one of the neck; one that begins in the face has less."""

LEAST = 0.12
"""Share of the neck's texels below which a patch is a scrap. In sixteen photos collars and hair left 10 % at most, and
open necks 15 % and more."""

SHOWS = 0.5
"""Opacity of the cores by which patches are told apart; what is fainter goes with the core next to it."""


def small_components(chart: Chart, seen: Float, zones: Zones) -> npt.NDArray[np.bool_]:
    """(N,) bool: texels of patches of the neck that stand alone and are small.

    Args:
        chart: of the head.
        seen: (N,) opacity in [0, 1] at the texels.
        zones: of the same texels; a head without a region "neck" has no small_components.
    """
    import cv2

    neck = zones.neck * zones.skin
    least = LEAST * float(neck.sum())
    shown = chart.spread((seen * zones.skin > SHOWS).astype(np.float32)[:, None])[..., 0] > 0.5
    if least == 0.0 or not shown.any():
        return np.zeros(len(seen), bool)
    # The label of the nearest core: 0 is the background's.
    _, core = cv2.connectedComponents(shown.astype(np.uint8))
    _, nearest = cv2.distanceTransformWithLabels(
        (~shown).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_core = np.zeros(int(nearest.max()) + 1, np.int64)
    of_core[nearest[shown]] = core[shown]
    label, inside = of_core[nearest].ravel()[chart.texels], shown.ravel()[chart.texels]
    area = np.bincount(label[inside], minlength=len(of_core))
    share = np.bincount(label[inside], neck[inside], minlength=len(of_core)) / np.maximum(area, 1)
    scrap = (share > OF_NECK) & (area < least)
    return np.asarray(scrap[label] & zones.skin & (seen > 0))


SMALL_COMPONENTS = Correction(
    name="small-components",
    mends="Scraps of collar and background between jaw and clothes are taken for skin of the neck.",
    source="texture",
    cases=("soft",),
)
