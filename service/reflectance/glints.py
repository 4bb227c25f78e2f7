"""Glints that de-lighting leaves: small mirrored lamps on oily skin, which divided by the light of skin become white.

At a glint the photo shows the skin's colour plus the lamp's (the dichromatic model, Shafer 1985). Divided by the light
this is albedo plus grey, so the grey part follows from how much less colourful a spot is than the skin around it. Taken
off is only what is brighter and much paler than its surroundings; broad sheen is left to the network.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.colour import linear_to_srgb, luma, srgb_to_linear
from service.reflectance.planes import FULL_CODE, Codes

Float = npt.NDArray[np.float32]

WIDTH = 576
"""Texels along the chart where glints are sought: the texture's own width, finer detail is the network's."""
AROUND, NEAR = 30.0, 8.0
"""Standard deviations of what is the usual colour, and of what is the brightness around a spot, in these texels."""
ROUNDS, PALE = 4, 0.06
"""Times that pale spots are left out of the usual colour, and the grey share of red that makes one."""
BRIGHTER = (1.03, 1.18)
"""Times of the luminance around from which on something may be a glint, and is one."""
GREY = (0.10, 0.20)
"""Share of grey in red, likewise."""
COLOURFUL = (0.35, 0.55)
"""Usual blue below red, as a share of red, from which on skin is colourful enough to tell, and tells all."""
MOST = 0.7
"""Share of the smallest channel that is taken off at most."""
STRIP = 512
"""Rows of the full map at a time."""


def without_glints(albedo: Codes, skin: npt.NDArray[np.uint8], lit: Float | None = None) -> Codes:
    """(H, W, 3) codes of sRGB albedo with the grey of glints taken off, in place.

    Args:
        albedo: codes.
        skin: (H, W) uint8, 255 where a texel is skin, 0 on eyes and teeth.
        lit: (h, w) of any size in [0, 1], where it is skin in the photo's light; None: everywhere.
    """
    import cv2

    height, width = albedo.shape[:2]
    size = (min(WIDTH, width), max(1, round(height * min(1.0, WIDTH / width))))
    small = np.asarray(cv2.resize(albedo, size, interpolation=cv2.INTER_AREA), np.float32) * np.float32(1 / FULL_CODE)
    weight = np.asarray(cv2.resize(skin, size, interpolation=cv2.INTER_AREA), np.float32) * np.float32(1 / 255)
    if lit is not None:
        weight = weight * np.asarray(cv2.resize(lit, size), np.float32)
    grey = glints(srgb_to_linear(small), np.clip(weight, 0, 1), size[0] / WIDTH)
    if not grey.any():
        return albedo
    full = np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_CUBIC), np.float32)
    for top in range(0, height, STRIP):
        strip, part = albedo[top : top + STRIP], full[top : top + STRIP]
        chosen = (part > 1e-4) & (skin[top : top + STRIP] == 255)
        linear = srgb_to_linear(strip[chosen] * np.float32(1 / FULL_CODE))
        linear -= np.minimum(part[chosen], MOST * linear.min(1))[:, None]
        strip[chosen] = np.rint(linear_to_srgb(linear) * FULL_CODE).astype(np.uint16)
    return albedo


def glints(albedo: Float, skin: Float, scale: float = 1.0) -> Float:
    """(h, w) linear grey that lies on an albedo (h, w, 3), linear; 0 where there is no glint, finite for any input.

    Args:
        albedo: linear, small.
        skin: (h, w) in [0, 1], 0 where colours are not to be compared with skin.
        scale: texels over those of a chart ``WIDTH`` wide.
    """
    usual = _usual_ratios(albedo, skin, scale)
    grey = _grey(albedo, usual)
    bright = luma(albedo)
    around = _blur(bright * skin, NEAR * scale) / np.maximum(_blur(skin, NEAR * scale), 1e-3)
    share = grey / np.maximum(albedo[..., 0], 1e-4)
    told = _rise(bright / np.maximum(around, 1e-3), BRIGHTER) * _rise(share, GREY) * _rise(1 - usual[..., 1], COLOURFUL)
    return _blur(grey * skin * told, scale)


def _usual_ratios(albedo: Float, skin: Float, scale: float) -> Float:
    """(h, w, 2) green and blue over red of the skin around each texel, pale spots left out."""
    logs = np.log(np.maximum(albedo, 1e-4))
    ratios = np.stack([logs[..., 1] - logs[..., 0], logs[..., 2] - logs[..., 0]], -1)
    weight = skin
    usual = np.ones_like(ratios)
    for _ in range(ROUNDS):
        overall = (ratios * weight[..., None]).sum((0, 1)) / max(float(weight.sum()), 1e-6)
        near = _blur(weight, AROUND * scale)[..., None]
        local = _blur(ratios * weight[..., None], AROUND * scale) / np.maximum(near, 1e-6)
        trust = near / (near + 0.05)
        usual = np.exp(trust * local + (1 - trust) * overall).astype(np.float32)
        share = _grey(albedo, usual) / np.maximum(albedo[..., 0], 1e-4)
        weight = skin * np.exp(-((share / PALE) ** 2))
    return usual


def _grey(albedo: Float, usual: Float) -> Float:
    """(h, w) what has to be taken off all channels for the usual ratios; green and blue both have to say so."""
    red = albedo[..., :1]
    found = (albedo[..., 1:] - usual * red) / np.maximum(1 - usual, 0.15)
    return np.asarray(np.clip(found.min(-1), 0, 0.8 * albedo[..., 1:].min(-1)), np.float32)


def _blur(image: Float, sigma: float) -> Float:
    import cv2

    blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), max(sigma, 0.3), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred, np.float32).reshape(image.shape)


def _rise(value: npt.NDArray[np.floating], ramp: tuple[float, float]) -> Float:
    """0 up to the ramp's start, 1 from its end, straight between."""
    return np.asarray(np.clip((value - ramp[0]) / (ramp[1] - ramp[0]), 0, 1), np.float32)
