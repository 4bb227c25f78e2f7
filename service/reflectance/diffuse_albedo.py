"""delta: texture without its light (AvatarMe, section 4.3).

What light the photo was taken in is seen from the whole head, not from a tile. A small network therefore looks at the
whole chart once and leaves its findings as coarse planes that every tile reads.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.colour import linear_to_srgb, srgb_to_linear
from service.fit.eye_white import BETWEEN_LIDS
from service.reflectance.planes import Codes, Planes, from_codes, to_codes
from service.reflectance.subject import EYES
from service.reflectance.translate import Job, translate
from service.runtime.networks import Network, describe, open_network
from service.runtime.tiles import run_whole

Float = npt.NDArray[np.float32]

NAME, CONTEXT = "delta", "delta_context"
PREFIX = "context_"
LIT = "lit_skin"
"""Channel that is 1 where the texture shows skin in the photo's light, 0 where it shows hair or was made up."""

BRIGHTEST = 0.85
"""Largest albedo of an eye or a tooth."""

WIDEST = 64
"""Standard deviation of the widest blur that carries light into made-up parts, texels of the context."""


def needs_context(job: Job) -> bool:
    """Whether the network reads planes of the context network."""
    return any(channel.startswith(PREFIX) for channel in describe(NAME, job.engine.folder).channels)


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


def light_between_lids(light: Float, lit: Float, eyes: Float) -> Float:
    """(3,) log light on eyes, teeth and tongue: that of the whites where they were seen, else the face's less shade.

    Args:
        light: (3, h, w) log light of the skin.
        lit: (h, w) in [0, 1], where it is to be believed; nowhere counts as everywhere.
        eyes: (4,) values of the channels ``EYES``.
    """
    if eyes[3] > 0.5:
        return np.asarray(eyes[:3], np.float32)
    weight = lit if float(lit.sum()) >= 1 else np.ones_like(lit)
    mean = (light * weight).sum((1, 2)) / np.float32(weight.sum())
    return np.asarray(mean + np.float32(np.log(BETWEEN_LIDS)), np.float32)


def light_on(planes: Planes, network: Network) -> tuple[Float, Float]:
    """What the context network finds in the planes of a whole chart, where ``LIT`` may be missing: all of it is lit.

    Returns:
        (C, h, w) light on skin, gone on with into all that is not lit skin, and (3,) log light between the lids.
    """
    what = network.description
    size = what.whole or planes.size
    found = run_whole(network, planes.shrunk(what.channels, size))
    lit = planes.shrunk([LIT], size)[0] if LIT in planes.channels else np.ones(found.shape[1:], np.float32)
    between = light_between_lids(found, lit, planes.shrunk(EYES, (1, 1))[:, 0, 0])
    return continued(found, lit), between


def without(light: Float, coded: Float) -> Float:
    """(h, w, 3) texture in [-1, 1] without a (3,) log light; white where that would be brighter than ``BRIGHTEST``."""
    linear = srgb_to_linear(coded * np.float32(0.5) + np.float32(0.5)) * np.exp(-np.clip(light, -6, 6))
    return linear_to_srgb(np.minimum(linear, np.float32(BRIGHTEST))) * np.float32(2) - np.float32(1)


def diffuse_albedo(texture: Codes, job: Job) -> Codes:
    """(H, W, 3) sRGB codes of the albedo of a texture (H, W, 3), which is among the job's planes as ``texture_*``.

    Eyes, teeth, tongue, lashes and the inside of the mouth lose one light, the same all over: the network has seen skin
    only.

    Raises:
        ModelFault: a network is missing, changed, or does not fit.
    """
    between: Float | None = None
    if needs_context(job):
        with open_network(CONTEXT, job.engine) as network:
            light, between = light_on(job.planes, network)
            job.planes.add_coarse(network.description.planes(len(light)), light)
    result = np.zeros_like(texture)

    def keep(place: tuple[slice, slice], values: npt.NDArray[np.float32], skin: npt.NDArray[np.float32]) -> None:
        albedo = np.moveaxis(np.clip(values, -1, 1), 0, 2)
        if skin.min() < 1:
            kept = from_codes(texture[place])
            if between is not None:
                kept = without(between, kept)
            albedo = kept + skin[..., None] * (albedo - kept)
        result[place] = to_codes(albedo)

    translate(NAME, job, 3, keep)
    return result
