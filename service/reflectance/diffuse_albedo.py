"""delta: texture without its light (AvatarMe, section 4.3).

What light the photo was taken in is seen from the whole head, not from a tile. A small network therefore looks at the
whole chart once and leaves its findings as coarse planes that every tile reads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes.colours import BRIGHTEST
from service.arrays import Float32
from service.colour import Codes, from_codes, linear_to_srgb, srgb_to_linear, to_codes
from service.ledger import Ledger
from service.reflectance.albedo_error import error_model
from service.reflectance.chart_light import Found, found_by
from service.reflectance.translate import MapInputs, translate
from service.runtime.networks import Engine, describe, open_network

NAME, CONTEXT = "delta", "delta_context"
PREFIX = "context_"
PARTS = ("parts_r", "parts_g", "parts_b")
"""Channels of the albedo of eyes, teeth and all else that is no skin, sRGB-coded in [-1, 1]."""


@dataclass(frozen=True)
class Delit:
    """A texture without its light.

    Attributes:
        albedo: (H, W, 3) sRGB codes.
        error: (h, w) float32 of ``service.reflectance.albedo_error``; None: the network reads no context.
    """

    albedo: Codes
    error: Float32 | None


def needs_context(engine: Engine) -> bool:
    """Whether the network reads planes of the context network."""
    return any(channel.startswith(PREFIX) for channel in describe(NAME, engine.folder).channels)


def without(light: Float32, coded: Float32) -> Float32:
    """(h, w, 3) texture in [-1, 1] without a (3,) log light, at most ``BRIGHTEST``."""
    linear = srgb_to_linear(coded * np.float32(0.5) + np.float32(0.5)) * np.exp(-np.clip(light, -6, 6))
    return linear_to_srgb(np.minimum(linear, np.float32(BRIGHTEST))) * np.float32(2) - np.float32(1)


def diffuse_albedo(texture: Codes, job: MapInputs, ledger: Ledger | None = None) -> Delit:
    """The albedo of a texture (H, W, 3), which is among the job's planes as ``texture_*``.

    The network has seen skin only. What is no skin has the albedo of the planes ``PARTS``; without them the texture
    loses the light of the face there, less what the lids shade.

    Args:
        texture: codes.
        job: what the network is given.
        ledger: which corrections run; it counts what they change.

    Raises:
        ModelFault: a network is missing, changed, or does not fit.
    """
    ledger = ledger or Ledger()
    found: Found | None = None
    if needs_context(job.engine):
        with open_network(CONTEXT, job.engine) as network:
            found = found_by(network, job.planes, ledger)
            job.planes.add_coarse(network.description.planes(len(found.light)), found.light)
    result = np.zeros_like(texture)
    parts = job.planes.read(PARTS) if set(PARTS) <= set(job.planes.channels) else None

    def keep(place: tuple[slice, slice], values: npt.NDArray[np.float32], skin: npt.NDArray[np.float32]) -> None:
        albedo = np.moveaxis(np.clip(values, -1, 1), 0, 2)
        rows, columns = (np.arange(s.start, s.stop) for s in place)
        if skin.min() < 1:
            if parts is not None:
                kept = np.moveaxis(parts(rows, columns), 0, 2)
            else:
                kept = from_codes(texture[place])
                kept = kept if found is None else without(found.between, kept)
            albedo = kept + skin[..., None] * (albedo - kept)
        result[place] = to_codes(albedo)

    translate(NAME, job, 3, keep)
    return Delit(result, None if found is None else error_model().stated(found.clues))
