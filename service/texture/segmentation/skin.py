"""What the photo shows on each texel: skin, hair, or something in front of the face; and whose light can be told."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.geometry.chart import Chart
from service.ledger import Ledger
from service.texture.inpainting.inpaint import opacity
from service.texture.segmentation.skin_model import SkinModel, fit_skin_model, skin_likelihood
from service.texture.segmentation.small_components import SMALL_COMPONENTS, small_components
from service.texture.segmentation.zones import Zones
from service.texture.unwrap import Unwrapped

Float = npt.NDArray[np.float32]

SQUARELY = 0.3
"""Weight from which the photo's word on a face texel is taken even where it does not look like skin."""


def segment(chart: Chart, unwrapped: Unwrapped, zones: Zones, ledger: Ledger) -> tuple[Float, Float, SkinModel | None]:
    """Trust (N,) for continuing colours, opacity (N,) of the photo, and the skin model behind both."""
    seen: Float = opacity(unwrapped.weight) * (1 - zones.hidden)
    skin = fit_skin_model(unwrapped.colour, unwrapped.normal, unwrapped.weight, zones)
    if skin is None:
        return seen, seen, None
    likely = np.ones_like(seen)
    own = np.flatnonzero(seen > 0)
    likely[own] = skin_likelihood(skin, unwrapped.colour[own], unwrapped.normal[own])
    if skin.cover is not None:  # a cap goes on as skin does, and is the same on both sides
        cover = skin_likelihood(skin.cover, unwrapped.colour[own], unwrapped.normal[own])
        likely[own] = np.maximum(likely[own], cover)
    likely = _calm(chart, likely, seen)
    # Lips, lids and brows are not skin-coloured, and the scalp is expected to be hair: no judgement there.
    excused = np.maximum(zones.features, np.clip((zones.scalp - 0.4) / 0.4, 0, 1))
    likely = excused + (1 - excused) * likely
    # A fringe or make-up on the face belongs to the likeness; at its rim the same colours are background.
    squarely = opacity(unwrapped.weight - SQUARELY)
    kept = np.maximum(np.maximum(zones.face * squarely, zones.scalp), zones.features)
    shown = seen * (kept + (1 - kept) * likely)
    whole = np.ones(len(seen), bool)
    if ledger.runs(SMALL_COMPONENTS):
        whole = ~small_components(chart, shown, zones)
        ledger.count(SMALL_COMPONENTS, int((~whole).sum()), whole.size)
    return np.asarray(whole * seen * likely, np.float32), np.asarray(whole * shown, np.float32), skin


def lit_skin(chart: Chart, unwrapped: Unwrapped, zones: Zones, skin: SkinModel | None) -> Float:
    """(N,) in [0, 1], 0 where what the photo shows is no skin, though it may have skin's place.

    In the face itself dark may be shade and bright a highlight; where hair is to be expected, dark is hair. Lips, lids
    and brows count as skin. Without a model of the skin everything does.
    """
    likely = np.ones(len(unwrapped.weight), np.float32)
    if skin is None:
        return likely
    shown = np.flatnonzero(unwrapped.weight > 0)
    face = (zones.face * (1 - zones.scalp))[shown]
    likely[shown] = skin_likelihood(skin, unwrapped.colour[shown], unwrapped.normal[shown], face)
    calm = _calm(chart, likely, opacity(unwrapped.weight))
    return np.asarray(np.maximum(zones.features * zones.face, calm), np.float32)


def worn_mask(chart: Chart, colour: Float, normal: Float, skin: SkinModel) -> npt.NDArray[np.uint8] | None:
    """(H, W) uint8, 255 where a texture has the colour of what is worn over the face; None where nothing is.

    Args:
        chart: of the head.
        colour: (N, 3) sRGB, seen or made up.
        normal: (N, 3) unit.
        skin: the person's, and what is worn.
    """
    if skin.cover is None:
        return None
    like_cover, like_skin = (skin_likelihood(model, colour, normal, face=1.0) for model in (skin.cover, skin))
    share = np.asarray(like_cover * (1 - like_skin), np.float32)
    return np.rint(255 * np.clip(chart.fill_outside(chart.spread(share[:, None])[..., 0]), 0, 1)).astype(np.uint8)


def _calm(chart: Chart, likely: Float, seen: Float) -> Float:
    """Plausibility (N,) without specks: moles and pores do not count, and what is judged foreign grows a little."""
    import cv2

    sigma = max(chart.width / 576 * 2.5, 0.5)
    stacked = chart.spread(np.stack([likely * seen, seen], 1))
    soft = np.asarray(cv2.GaussianBlur(stacked, (0, 0), sigma)).reshape(-1, 2)[chart.texels]
    mean = soft[:, 0] / np.maximum(soft[:, 1], 1e-6)
    t = np.clip((mean - 0.5) / 0.3, 0, 1)
    return np.asarray(t * t * (3 - 2 * t), np.float32)
