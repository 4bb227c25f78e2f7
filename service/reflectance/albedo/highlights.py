"""Highlights that de-lighting leaves: mirrored lamps on oily skin, white or grey when divided by the light of skin.

At a highlight the photo shows the skin's colour plus the lamp's (the dichromatic model, Shafer 1985). Divided by the
light this is albedo plus grey, so a highlight is much less colourful than the skin around it, and was brighter in the
photo. There the skin's usual colour is put back, no brighter than its surroundings. Finer than ``WIDTH`` texels a sheen
is a pattern of bright dots, the sides of pores that mirror the lamp: its colour is taken off the detail, too.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.arrays import Float32
from service.colour import FULL_CODE, LUMA, Codes, linear_to_srgb, luma, srgb_to_linear
from service.corrections import Correction, Ledger, changed_texels
from service.image_filters import blurred, each_around, least, most, ramp, shrunk, stretched_to
from service.levels import TEXTURE_SIZE
from service.reflectance.planes import read_window

WIDTH = TEXTURE_SIZE[0]
"""Texels along the chart where highlights are sought: as many as the texture has, finer detail is the network's."""
AROUND, NEAR = 30.0, 8.0
"""Standard deviations of what is the usual colour, and of what is the brightness around a spot, in these texels."""
ROUNDS, PALE = 4, 0.06
"""Times that pale and red spots are left out of the usual colour, and the grey share of red, more or less, that makes
one. Without pale ones alone the usual colour would be that of the reddest skin around."""
BRIGHTER = (1.03, 1.18)
"""Times of the albedo's luminance around from which on something may be a highlight, and is one; this and the next two
measured on rendered oily skin."""
SHONE = (1.25, 1.8)
"""The same for the photo, over a wider surrounding (``AROUND``): a sheen may have lost its brightness, not its grey."""
GREY = (0.10, 0.20)
"""Share of grey in red, likewise."""
COLOURFUL = (0.20, 0.35)
"""Usual blue below red, as a share of red, from which on skin is colourful enough to tell, and tells all."""
DARKEST = 0.03
"""Red of the darkest skin: of less, a share would be that of rounding."""
GREYEST = 0.1
"""Blue below red, as a share of the brightest channel, below which skin is as grey as a lamp."""
LEAST = 0.3
"""Share of each channel that is left at least."""


def without_highlights(
    albedo: Codes,
    texture: Codes,
    skin: npt.NDArray[np.uint8],
    lit: Float32 | None = None,
    grey: Codes | None = None,
    ledger: Ledger | None = None,
) -> Codes:
    """(H, W, 3) codes of sRGB albedo with the skin's own colour where highlights were, in place.

    Args:
        albedo: codes.
        texture: (H, W, 3) codes that it was made from.
        skin: (H, W) uint8, 255 where a texel is skin, 0 on eyes and teeth.
        lit: (h, w) of any size in [0, 1], where it is skin in the photo's light; None: everywhere.
        grey: (H, W) codes of the same skin in grey, which is to change, in place, as the albedo's luma does.
        ledger: told how many texels of the small map change.
    """
    height, width = albedo.shape[:2]
    size = (min(WIDTH, width), max(1, round(height * min(1.0, WIDTH / width))))
    bare, shown = (srgb_to_linear(shrunk(codes, size) * np.float32(1 / FULL_CODE)) for codes in (albedo, texture))
    weight = shrunk(skin, size) * np.float32(1 / 255)
    if lit is not None:
        weight = weight * stretched_to(lit, size)
    change, told = highlights(bare, shown, np.clip(weight, 0, 1), size[0] / WIDTH)
    marked = most(np.abs(change)) > 0
    changes, colours = (np.moveaxis(image, 2, 0) for image in (change, bare))
    if ledger is not None:
        ledger.count(HIGHLIGHTS, *changed_texels(bare, bare + change))

    def mend(rows: slice, columns: slice) -> None:
        place = rows, columns
        added, coarse, share = (read_window(planes, (width, height), *place) for planes in (changes, colours, [told]))
        chosen = (most(np.abs(added)) > 1e-4) & (skin[place] == 255)
        linear = srgb_to_linear(albedo[place][chosen] * np.float32(1 / FULL_CODE))
        new = coarse[chosen] + added[chosen]
        linear = np.maximum(new + skin_detail(linear - coarse[chosen], new, share[chosen, 0]), LEAST * linear)
        changed = np.rint(linear_to_srgb(linear) * FULL_CODE).astype(np.uint16)
        if grey is not None:
            more = (changed.astype(np.float32) - albedo[place][chosen]) @ LUMA
            grey[place][chosen] = np.clip(grey[place][chosen] + more, 0, FULL_CODE).astype(np.uint16)
        albedo[place][chosen] = changed

    each_around(marked, albedo.shape, mend)
    return albedo


def skin_detail(detail: Float32, colour: Float32, share: Float32) -> Float32:
    """(N, 3) detail of linear albedo without what a lamp adds to it, by a share of it.

    Detail is a number times the skin's colour plus a number times the lamp's, which is grey: red less blue tells the
    first.

    Args:
        detail: (N, 3) of linear albedo.
        colour: (N, 3) linear RGB of the skin.
        share: (N,) in [0, 1] of highlight; where skin is as grey as the lamp nothing is told apart, and all of it goes.
    """
    apart = colour[:, 0] - colour[:, 2]
    clear = apart > GREYEST * most(np.abs(colour))
    strength = np.where(clear, (detail[:, 0] - detail[:, 2]) / np.where(clear, apart, 1), 0)
    skin = np.clip(strength, -1, 1)[:, None] * colour
    return np.asarray(detail + share[:, None] * (skin - detail), np.float32)


def highlights(albedo: Float32, texture: Float32, skin: Float32, scale: float = 1.0) -> tuple[Float32, Float32]:
    """What has to be added to a linear albedo, and how much of a highlight there is: (h, w, 3), and (h, w) in [0, 1].

    Both are 0 where there is no highlight, and finite for any input.

    Args:
        albedo: (h, w, 3) linear, small.
        texture: (h, w, 3) linear, the photo's light in it.
        skin: (h, w) in [0, 1], 0 where colours are not to be compared with skin.
        scale: texels over those of a chart ``WIDTH`` wide.
    """
    usual = _usual_ratios(albedo, skin, scale)
    bright = luma(albedo)
    around = _mean(bright, skin, NEAR * scale)
    brighter = ramp(bright / np.maximum(around, 1e-3), BRIGHTER)
    photo = luma(texture)
    shone = ramp(photo / np.maximum(_mean(photo, skin, AROUND * scale), 1e-3), SHONE)
    pale = ramp(_grey_share(albedo, usual), GREY) * ramp(1 - usual[..., 1], COLOURFUL)
    told = skin * np.maximum(brighter, shone) * pale
    # Light that was cut off at white is less than the network takes it for: there it comes out too dark as well.
    wanted = np.minimum(bright, around) + shone * np.maximum(around - bright, 0)
    colour = np.concatenate([np.ones_like(usual[..., :1]), usual], -1)
    colour = colour * (wanted / np.maximum(luma(colour), 1e-3))[..., None]
    return _blur(told[..., None] * (colour - albedo), scale), np.clip(_blur(told, scale), 0, 1)


def _usual_ratios(albedo: Float32, skin: Float32, scale: float) -> Float32:
    """(h, w, 2) green and blue over red of the skin around each texel, pale and red spots left out."""
    logs = np.log(np.maximum(albedo, 1e-3))
    ratios = np.stack([logs[..., 1] - logs[..., 0], logs[..., 2] - logs[..., 0]], -1)
    weight = skin
    usual = np.ones_like(ratios)
    for _ in range(ROUNDS):
        overall = (ratios * weight[..., None]).sum((0, 1)) / max(float(weight.sum()), 1e-6)
        near = _blur(weight, AROUND * scale)[..., None]
        local = _blur(ratios * weight[..., None], AROUND * scale) / np.maximum(near, 1e-6)
        trust = near / (near + 0.05)
        usual = np.exp(trust * local + (1 - trust) * overall).astype(np.float32)
        weight = skin * np.exp(-((_grey_share(albedo, usual) / PALE) ** 2))
    return usual


def _grey_share(albedo: Float32, usual: Float32) -> Float32:
    """(h, w) share of red to be taken off all channels for the usual ratios; negative where skin is more colourful than
    usual. Green and blue both have to say so.
    """
    red = albedo[..., :1]
    found = (albedo[..., 1:] - usual * red) / np.maximum(1 - usual, 0.15)
    grey = np.clip(least(found), 0, 0.8 * least(albedo[..., 1:])) + np.minimum(most(found), 0)
    return np.asarray(grey / np.maximum(red[..., 0], DARKEST), np.float32)


def _mean(values: Float32, weight: Float32, sigma: float) -> Float32:
    """(h, w) weighted mean around each texel; 0 where there is no weight far and wide."""
    return np.asarray(_blur(values * weight, sigma) / np.maximum(_blur(weight, sigma), 1e-3), np.float32)


def _blur(image: npt.NDArray[np.floating], sigma: float) -> Float32:
    return blurred(image.astype(np.float32), max(sigma, 0.3)).reshape(image.shape)


HIGHLIGHTS = Correction(
    name="highlights",
    mends="Highlights of oily skin and flash stay in the albedo as pale spots.",
    cases=("oily",),
)
