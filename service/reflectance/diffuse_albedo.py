"""delta: texture without its light (AvatarMe, section 4.3).

What light the photo was taken in is seen from the whole head, not from a tile. A small network therefore looks at the
whole chart once and leaves its findings as coarse planes that every tile reads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.colour import linear_to_srgb, srgb_to_linear
from service.fit.eye_white import BETWEEN_LIDS
from service.reflectance.exposure import less_overexposed, mean_light
from service.reflectance.missing_blue import missing, usual_blue, with_blue
from service.reflectance.planes import FULL_CODE, Codes, Planes, from_codes, to_codes
from service.reflectance.subject import EYES
from service.reflectance.translate import Job, translate
from service.runtime.networks import Engine, Network, describe, open_network
from service.runtime.tiles import run_whole

Float = npt.NDArray[np.float32]

NAME, CONTEXT = "delta", "delta_context"
PREFIX = "context_"
TEXTURE = ("texture_r", "texture_g", "texture_b")
LIT = "lit_skin"
"""Channel that is 1 where the texture shows skin in the photo's light, 0 where it shows hair or was made up."""

BRIGHTEST = 0.85
"""Largest albedo of an eye or a tooth."""

WIDEST = 64
"""Standard deviation of the widest blur that carries light into made-up parts, texels of the context."""


SEAM = 0.12
"""Share of the chart's width and height over which the two sides of the seam go over into each other."""


def needs_context(engine: Engine) -> bool:
    """Whether the network reads planes of the context network."""
    return any(channel.startswith(PREFIX) for channel in describe(NAME, engine.folder).channels)


def continued(light: Float, lit: Float) -> Float:
    """(C, h, w) light that goes on smoothly from lit skin to all else; unchanged where nothing or all is lit skin.

    Colour that was made up was continued from the photo's and carries the light of its source, not that of its place.
    A network that has seen lit skin only would take it for a brightly lit or shaded surface, and dark hair for shade.

    Args:
        light: what the context network found.
        lit: (h, w) in [0, 1], where the light is to be believed.
    """
    import cv2

    weight = np.clip(lit, 0, 1).astype(np.float32)
    total = float(weight.sum())
    if total < 1:
        return light
    planes = np.ascontiguousarray(np.moveaxis(light, 0, 2), np.float32)
    weighted = planes * weight[..., None]
    filled: Float = np.broadcast_to(weighted.sum((0, 1)) / np.float32(total), planes.shape).astype(np.float32)
    sigma = WIDEST
    while sigma >= 2:
        near = np.asarray(cv2.GaussianBlur(weight, (0, 0), sigma), np.float32)[..., None]
        spread = np.asarray(cv2.GaussianBlur(weighted, (0, 0), sigma), np.float32).reshape(planes.shape)
        trust = near / (near + np.float32(0.02))
        filled = np.asarray(trust * spread / np.maximum(near, np.float32(1e-6)) + (1 - trust) * filled, np.float32)
        sigma //= 2
    soft = np.minimum(np.asarray(cv2.GaussianBlur(weight, (0, 0), 2), np.float32), weight)[..., None]
    return np.asarray(np.moveaxis(soft * planes + (1 - soft) * filled, 2, 0), np.float32)


def seamless(light: Float) -> Float:
    """(C, h, w) light that is the same on both sides of the head's seam, which runs along three borders of the chart.

    The chart is symmetric: a point of the seam lies at (x, y) and at (w - x, y). Towards it both sides go over into
    their mean; light from the left would else end at the middle of the crown.
    """
    _, height, width = light.shape
    x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
    near = np.minimum(np.minimum(x, width - x)[None] / (width * SEAM), y[:, None] / (height * SEAM))
    far = np.clip(near, 0, 1).astype(np.float32)
    share = np.float32(0.5) * (1 - far * far * (3 - 2 * far))
    return np.asarray(light + share * (light[..., ::-1] - light), np.float32)


def light_between_lids(light: Float, lit: Float) -> Float:
    """(3,) log light on eyes, teeth and tongue of a texture that does not tell: the face's less shade.

    Args:
        light: (3, h, w) log light of the skin.
        lit: (h, w) in [0, 1], where it is to be believed; nowhere counts as everywhere.
    """
    return np.asarray(mean_light(light, lit) + np.float32(np.log(BETWEEN_LIDS)), np.float32)


@dataclass(frozen=True)
class Found:
    """What the context network tells of a whole chart.

    Attributes:
        light: (C, h, w) log light on skin, gone on with into all that is not lit skin.
        between: (3,) log light on eyes, teeth and tongue, should the texture not tell.
        blue: blue over red and green of the skin (``service.reflectance.missing_blue``); None: not known.
    """

    light: Float
    between: Float
    blue: float | None


def found_by(network: Network, planes: Planes) -> Found:
    """Ask the context network about the planes of a whole chart, where ``LIT`` may be missing: all of it is lit."""
    what = network.description
    size = what.whole or planes.size
    light = run_whole(network, planes.shrunk(what.channels, size))
    lit = planes.shrunk([LIT], size)[0] if LIT in planes.channels else np.ones(light.shape[1:], np.float32)
    weight = lit * planes.shrunk(["mask"], size)[0]
    if EYES[-1] in planes.channels and not planes.shrunk(EYES[-1:], size).any():
        light = less_overexposed(light, weight)
    coded = np.moveaxis(planes.shrunk(TEXTURE, size), 0, 2).reshape(-1, 3) * np.float32(0.5) + np.float32(0.5)
    albedo = srgb_to_linear(coded) * np.exp(-np.clip(np.moveaxis(light, 0, 2).reshape(-1, 3), -6, 6))
    return Found(
        seamless(continued(light, lit)), light_between_lids(light, lit), usual_blue(albedo, coded, weight.ravel())
    )


def without(light: Float, coded: Float) -> Float:
    """(h, w, 3) texture in [-1, 1] without a (3,) log light; white where that would be brighter than ``BRIGHTEST``."""
    linear = srgb_to_linear(coded * np.float32(0.5) + np.float32(0.5)) * np.exp(-np.clip(light, -6, 6))
    return linear_to_srgb(np.minimum(linear, np.float32(BRIGHTEST))) * np.float32(2) - np.float32(1)


def diffuse_albedo(texture: Codes, job: Job, white: npt.NDArray[np.floating] | None = None) -> Codes:
    """(H, W, 3) sRGB codes of the albedo of a texture (H, W, 3), which is among the job's planes as ``texture_*``.

    Eyes, teeth, tongue, lashes and the inside of the mouth lose one light, the same all over: the network has seen skin
    only. It is the light that they were painted in, so that they come out in the colours of their kind.

    Args:
        texture: codes.
        job: what the network is given.
        white: (3,) linear RGB, positive, of a white surface in the light of the parts that are not skin; None: the
            light of the face, less what the lids shade.

    Raises:
        ModelFault: a network is missing, changed, or does not fit.
    """
    found: Found | None = None
    if needs_context(job.engine):
        with open_network(CONTEXT, job.engine) as network:
            found = found_by(network, job.planes)
            job.planes.add_coarse(network.description.planes(len(found.light)), found.light)
    between = None if found is None else found.between
    between = between if white is None else np.log(np.asarray(white, np.float32))
    result = np.zeros_like(texture)

    def keep(place: tuple[slice, slice], values: npt.NDArray[np.float32], skin: npt.NDArray[np.float32]) -> None:
        albedo = np.moveaxis(np.clip(values, -1, 1), 0, 2)
        if found is not None and found.blue is not None:
            albedo = _blue_again(albedo, texture[place], found.blue)
        if skin.min() < 1:
            kept = from_codes(texture[place])
            if between is not None:
                kept = without(between, kept)
            albedo = kept + skin[..., None] * (albedo - kept)
        result[place] = to_codes(albedo)

    translate(NAME, job, 3, keep)
    return result


def _blue_again(albedo: Float, texture: Codes, blue: float) -> Float:
    """(h, w, 3) albedo in [-1, 1] with its blue where the texture's codes have lost it."""
    lost = missing(texture * np.float32(1 / FULL_CODE))
    chosen = lost > 0
    if chosen.any():
        albedo = np.ascontiguousarray(albedo)
        albedo[chosen] = with_blue(albedo[chosen] * np.float32(0.5) + np.float32(0.5), lost[chosen], blue) * 2 - 1
    return albedo
