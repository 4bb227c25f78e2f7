"""Skin segmentation: how far each texel shows skin, and may be kept, continued or used to measure the light."""

from __future__ import annotations

import numpy as np

from service.arrays import Float32, UInt8
from service.geometry.chart import Chart
from service.ledger import Ledger
from service.texture.inpainting.inpaint import opacity
from service.texture.segmentation.skin_model import SkinModel, fit_skin_model, skin_likelihood
from service.texture.segmentation.small_components import SMALL_COMPONENTS, small_components
from service.texture.segmentation.zones import Zones
from service.texture.unwrap import Unwrapped

FRONTAL = 0.3
"""Weight from which on the photo is kept on the face even where it does not look like skin."""


def segment(
    chart: Chart, unwrapped: Unwrapped, zones: Zones, ledger: Ledger, *, bald: bool = False
) -> tuple[Float32, Float32, SkinModel | None]:
    """Where the photo is kept, and where it may be continued.

    Args:
        chart: of the head.
        unwrapped: the photo on it.
        zones: of the same texels.
        ledger: says which corrections run, and records what they change.
        bald: hair is a mesh of its own, so that the scalp is kept where it has the colour of skin only.

    Returns:
        (N,) float32 trust in [0, 1] with which a texel's colour may be continued and mirrored; (N,) float32 opacity of
        the photo in [0, 1]; and the skin model that both are based on, None where too little skin is seen.
    """
    seen: Float32 = opacity(unwrapped.weight) * (1 - zones.hidden)
    skin = fit_skin_model(unwrapped.colour, unwrapped.normal, unwrapped.weight, zones)
    if skin is None:
        return seen, seen, None
    likely = np.ones_like(seen)
    shown = np.flatnonzero(seen > 0)
    likely[shown] = skin_likelihood(skin, unwrapped.colour[shown], unwrapped.normal[shown])
    if skin.cover is not None:  # a cap may be continued and mirrored as skin is
        cover = skin_likelihood(skin.cover, unwrapped.colour[shown], unwrapped.normal[shown])
        likely[shown] = np.maximum(likely[shown], cover)
    likely = _despeckled(chart, likely, seen)
    # Lips, lids and brows are not skin-coloured, and the scalp is expected to be hair: they count as likely.
    hairy = np.zeros_like(zones.scalp) if bald else zones.scalp
    exempt = np.maximum(zones.features, np.clip((hairy - 0.4) / 0.4, 0, 1))
    likely = exempt + (1 - exempt) * likely
    # A fringe or make-up on the face belongs to the likeness; at the face's outline the same colours are background.
    frontal = opacity(unwrapped.weight - FRONTAL)
    kept = np.maximum(np.maximum(zones.face * (1 - bald * zones.scalp) * frontal, hairy), zones.features)
    visible = seen * (kept + (1 - kept) * likely)
    whole = np.ones(len(seen), bool)
    if ledger.runs(SMALL_COMPONENTS):
        whole = ~small_components(chart, visible, zones)
        ledger.count(SMALL_COMPONENTS, int((~whole).sum()), whole.size)
    return np.asarray(whole * seen * likely, np.float32), np.asarray(whole * visible, np.float32), skin


def lit_skin(chart: Chart, unwrapped: Unwrapped, zones: Zones, skin: SkinModel | None) -> Float32:
    """(N,) in [0, 1], 1 where the photo shows skin whose light can be measured, 0 where it shows anything else.

    On the face, dark texels may be skin in shade and bright ones highlights; where hair is expected, dark ones are
    hair. Lips, lids and brows of the face count as skin. Without a skin model all is 1.
    """
    likely = np.ones(len(unwrapped.weight), np.float32)
    if skin is None:
        return likely
    shown = np.flatnonzero(unwrapped.weight > 0)
    face = (zones.face * (1 - zones.scalp))[shown]
    likely[shown] = skin_likelihood(skin, unwrapped.colour[shown], unwrapped.normal[shown], face)
    smooth = _despeckled(chart, likely, opacity(unwrapped.weight))
    return np.asarray(np.maximum(zones.features * zones.face, smooth), np.float32)


def worn_mask(chart: Chart, colour: Float32, normal: Float32, skin: SkinModel) -> UInt8 | None:
    """(H, W) uint8, 255 where a texture has the colour of a cap or mask worn over the face; None where none is.

    Args:
        chart: of the head.
        colour: (N, 3) sRGB, seen or inpainted.
        normal: (N, 3) unit.
        skin: model of the person's skin and of the cap or mask.
    """
    if skin.cover is None:
        return None
    like_cover, like_skin = (skin_likelihood(model, colour, normal, face=1.0) for model in (skin.cover, skin))
    share = np.asarray(like_cover * (1 - like_skin), np.float32)
    return np.rint(255 * np.clip(chart.fill_outside(chart.spread(share[:, None])[..., 0]), 0, 1)).astype(np.uint8)


def _despeckled(chart: Chart, likely: Float32, seen: Float32) -> Float32:
    """(N,) likelihood, blurred and thresholded softly: moles and pores count as skin, what is not skin grows
    slightly.
    """
    import cv2

    sigma = max(chart.width / 576 * 2.5, 0.5)
    stacked = chart.spread(np.stack([likely * seen, seen], 1))
    soft = np.asarray(cv2.GaussianBlur(stacked, (0, 0), sigma)).reshape(-1, 2)[chart.texels]
    mean = soft[:, 0] / np.maximum(soft[:, 1], 1e-6)
    t = np.clip((mean - 0.5) / 0.3, 0, 1)
    return np.asarray(t * t * (3 - 2 * t), np.float32)
