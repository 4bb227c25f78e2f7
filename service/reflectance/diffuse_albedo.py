"""delta: texture without its light (AvatarMe, section 4.3).

What light the photo was taken in is seen from the whole head, not from a tile. A small network therefore looks at the
whole chart once and leaves its findings as coarse planes that every tile reads.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes.paint import BRIGHTEST
from service.colour import FULL_CODE, Codes, from_codes, linear_to_srgb, srgb_to_linear, to_codes
from service.ledger import SEEN_CHANGE, Correction, Ledger
from service.reflectance.chart_light import Found, found_by
from service.reflectance.corrections.clipped_blue import CLIPPED_BLUE, missing, with_blue
from service.reflectance.corrections.hair_hue import HAIR_HUE, like_hair
from service.reflectance.subject import BROWS, HAIR
from service.reflectance.translate import Job, translate
from service.runtime.networks import Engine, describe, open_network

Float = npt.NDArray[np.float32]

NAME, CONTEXT = "delta", "delta_context"
PREFIX = "context_"
LID_SHADE = "lid_shade"
"""Channel of what the lids leave of the light on the eyes, on sRGB values; 1 on all else."""


def needs_context(engine: Engine) -> bool:
    """Whether the network reads planes of the context network."""
    return any(channel.startswith(PREFIX) for channel in describe(NAME, engine.folder).channels)


def without(light: Float, coded: Float, shade: Float | None = None) -> Float:
    """(h, w, 3) texture in [-1, 1] without a (3,) log light; white where that would be brighter than ``BRIGHTEST``.

    Args:
        light: of the whole part.
        coded: texture.
        shade: (h, w) positive, what of it reaches each texel, on sRGB values; None: all.
    """
    bright = coded * np.float32(0.5) + np.float32(0.5)
    if shade is not None:
        bright = np.minimum(bright / np.maximum(shade, np.float32(0.1))[..., None], np.float32(1))
    linear = srgb_to_linear(bright) * np.exp(-np.clip(light, -6, 6))
    return linear_to_srgb(np.minimum(linear, np.float32(BRIGHTEST))) * np.float32(2) - np.float32(1)


def diffuse_albedo(
    texture: Codes, job: Job, white: npt.NDArray[np.floating] | None = None, ledger: Ledger | None = None
) -> Codes:
    """(H, W, 3) sRGB codes of the albedo of a texture (H, W, 3), which is among the job's planes as ``texture_*``.

    Eyes, teeth, tongue, lashes and the inside of the mouth lose one light, the same all over: the network has seen skin
    only. It is the light that they were painted in, so that they come out in the colours of their kind.

    Args:
        texture: codes.
        job: what the network is given.
        white: (3,) linear RGB, positive, of a white surface in the light of the parts that are not skin; None: the
            light of the face, less what the lids shade.
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
    between = None if found is None else found.between
    between = between if white is None else np.log(np.asarray(white, np.float32))
    result = np.zeros_like(texture)
    shade = job.planes.read([LID_SHADE]) if LID_SHADE in job.planes.channels else None
    hairy = job.planes.read([BROWS, HAIR]) if {BROWS, HAIR} <= set(job.planes.channels) else None

    def keep(place: tuple[slice, slice], values: npt.NDArray[np.float32], skin: npt.NDArray[np.float32]) -> None:
        albedo = np.moveaxis(np.clip(values, -1, 1), 0, 2)
        if found is not None and found.blue is not None:
            albedo = _counted(CLIPPED_BLUE, albedo, _blue_again(albedo, texture[place], found.blue), ledger)
        rows, columns = (np.arange(s.start, s.stop) for s in place)
        if hairy is not None and ledger.runs(HAIR_HUE):
            albedo = _counted(HAIR_HUE, albedo, like_hair(albedo, *hairy(rows, columns)), ledger)
        if skin.min() < 1:
            kept = from_codes(texture[place])
            if between is not None:
                kept = without(between, kept, None if shade is None else shade(rows, columns)[0])
            albedo = kept + skin[..., None] * (albedo - kept)
        result[place] = to_codes(albedo)

    translate(NAME, job, 3, keep)
    return result


def _counted(correction: Correction, before: Float, after: Float, ledger: Ledger) -> Float:
    """``after``; the ledger is told how many texels (h, w, 3) in [-1, 1] differ."""
    changed = 0 if after is before else int((np.abs(after - before).max(-1) > 2 * SEEN_CHANGE).sum())
    ledger.count(correction, changed, before.shape[0] * before.shape[1])
    return after


def _blue_again(albedo: Float, texture: Codes, blue: float) -> Float:
    """(h, w, 3) albedo in [-1, 1] with its blue where the texture's codes have lost it."""
    lost = missing(texture * np.float32(1 / FULL_CODE))
    chosen = lost > 0
    if chosen.any():
        albedo = np.ascontiguousarray(albedo)
        albedo[chosen] = with_blue(albedo[chosen] * np.float32(0.5) + np.float32(0.5), lost[chosen], blue) * 2 - 1
    return albedo
