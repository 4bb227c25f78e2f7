"""Small components of the neck: too little shows between jaw and collar to tell skin from cloth or shadow."""

from __future__ import annotations

import numpy as np

from service.arrays import Bool, Float32
from service.geometry.chart import Chart
from service.ledger import Constant, Correction
from service.texture.segmentation.zones import Zones

OF_NECK = 0.3
"""Mean of the neck's mask over a component from which on it belongs to the neck; one that begins in the face has
less."""

LEAST_SHARE = 0.12
"""Share of the neck's texels below which a component is small. In sixteen photos collars and hair left 10 % at most,
and open necks 15 % and more."""

OPAQUE = 0.5
"""Opacity above which texels form components; fainter ones belong to the nearest component."""


def small_components(chart: Chart, seen: Float32, zones: Zones) -> Bool:
    """(N,) bool: texels of isolated small components of the neck.

    Args:
        chart: of the head.
        seen: (N,) opacity in [0, 1] at the texels.
        zones: of the same texels; all is False for a head without a region "neck".
    """
    import cv2

    neck = zones.neck * zones.skin
    least = LEAST_SHARE * float(neck.sum())
    shown = chart.spread((seen * zones.skin > OPAQUE).astype(np.float32)[:, None])[..., 0] > 0.5
    if least == 0.0 or not shown.any():
        return np.zeros(len(seen), bool)
    # Each texel gets the component of the nearest opaque texel; component 0 is the background.
    _, component = cv2.connectedComponents(shown.astype(np.uint8))
    _, nearest = cv2.distanceTransformWithLabels(
        (~shown).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    component_of = np.zeros(int(nearest.max()) + 1, np.int64)
    component_of[nearest[shown]] = component[shown]
    label, inside = component_of[nearest].ravel()[chart.texels], shown.ravel()[chart.texels]
    area = np.bincount(label[inside], minlength=len(component_of))
    share = np.bincount(label[inside], neck[inside], minlength=len(component_of)) / np.maximum(area, 1)
    small = (share > OF_NECK) & (area < least)
    return np.asarray(small[label] & zones.skin & (seen > 0))


SMALL_COMPONENTS = Correction(
    name="small-components",
    mends="Small components of collar and background between jaw and clothes are taken for skin of the neck.",
    source="texture",
    constants={
        "smallest share": Constant(LEAST_SHARE, "share of the neck", "16 photos: collars 0.10 at most, necks 0.15"),
    },
    cases=("soft",),
)
