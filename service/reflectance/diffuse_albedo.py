"""delta: texture without its light (AvatarMe, section 4.3).

What light the photo was taken in is seen from the whole head, not from a tile. A small network therefore looks at the
whole chart once and leaves its findings as coarse planes that every tile reads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes.paint import BRIGHTEST
from service.anatomy.eyes.sclera import BETWEEN_LIDS
from service.colour import FULL_CODE, Codes, from_codes, linear_to_srgb, srgb_to_linear, to_codes
from service.reflectance.corrections.albedo_ceiling import not_aglow
from service.reflectance.corrections.brows import under_brows
from service.reflectance.corrections.clipped_blue import missing, usual_blue, with_blue
from service.reflectance.corrections.exposure import less_overexposed, mean_light
from service.reflectance.corrections.grading import even_hue
from service.reflectance.corrections.hair_hue import like_hair
from service.reflectance.corrections.skin_hue import within_skin
from service.reflectance.corrections.unseen_light import continued, like_seen_skin, not_deeper, seamless
from service.reflectance.planes import Planes
from service.reflectance.subject import BROWS, EYES, HAIR, LIDS, LIT, MADE_UP
from service.reflectance.translate import Job, translate
from service.runtime.networks import Engine, Network, describe, open_network
from service.runtime.tiles import run_whole

Float = npt.NDArray[np.float32]

NAME, CONTEXT = "delta", "delta_context"
PREFIX = "context_"
TEXTURE = ("texture_r", "texture_g", "texture_b")
LID_SHADE = "lid_shade"
"""Channel of what the lids leave of the light on the eyes, on sRGB values; 1 on all else."""


def needs_context(engine: Engine) -> bool:
    """Whether the network reads planes of the context network."""
    return any(channel.startswith(PREFIX) for channel in describe(NAME, engine.folder).channels)


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
        blue: blue over red and green of the skin (``service.reflectance.corrections.clipped_blue``); None: not known.
    """

    light: Float
    between: Float
    blue: float | None


def found_by(network: Network, planes: Planes) -> Found:
    """Ask the context network about the planes of a whole chart.

    Of the planes of ``service.reflectance.subject.CLUES`` any may be missing: then all of it is lit, nothing made up,
    and there are no brows and lids.
    """
    what = network.description
    size = what.whole or planes.size
    light = run_whole(network, planes.shrunk(what.channels, size))
    lit = planes.shrunk([LIT], size)[0] if LIT in planes.channels else np.ones(light.shape[1:], np.float32)
    weight = lit * planes.shrunk(["mask"], size)[0]
    coded = np.moveaxis(planes.shrunk(TEXTURE, size), 0, 2).reshape(-1, 3) * np.float32(0.5) + np.float32(0.5)
    linear = srgb_to_linear(coded)
    texture = linear.T.reshape(3, *lit.shape)
    if EYES[-1] in planes.channels and not planes.shrunk(EYES[-1:], size).any():
        light = less_overexposed(light, weight)
    light = within_skin(even_hue(light, texture, weight), texture, weight)
    lids = planes.shrunk([LIDS], size)[0] if LIDS in planes.channels else np.zeros_like(lit)
    light = not_aglow(light, texture, weight, lids)
    albedo = linear * np.exp(-np.clip(np.moveaxis(light, 0, 2).reshape(-1, 3), -6, 6))
    everywhere = not_deeper(continued(light, lit), light, weight)
    if MADE_UP in planes.channels:
        # Lids are small and have lashes: brought to the albedo of skin, they would glow beside the lashes.
        made_up = planes.shrunk([MADE_UP], size)[0] * (1 - lids)
        everywhere = like_seen_skin(everywhere, texture, light, lit, made_up)
    if BROWS in planes.channels:
        everywhere = under_brows(everywhere, light, lit, planes.shrunk([BROWS], size)[0])
    return Found(seamless(everywhere), light_between_lids(light, lit), usual_blue(albedo, coded, weight.ravel()))


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
    shade = job.planes.read([LID_SHADE]) if LID_SHADE in job.planes.channels else None
    hairy = job.planes.read([BROWS, HAIR]) if {BROWS, HAIR} <= set(job.planes.channels) else None

    def keep(place: tuple[slice, slice], values: npt.NDArray[np.float32], skin: npt.NDArray[np.float32]) -> None:
        albedo = np.moveaxis(np.clip(values, -1, 1), 0, 2)
        if found is not None and found.blue is not None:
            albedo = _blue_again(albedo, texture[place], found.blue)
        rows, columns = (np.arange(s.start, s.stop) for s in place)
        if hairy is not None:
            albedo = like_hair(albedo, *hairy(rows, columns))
        if skin.min() < 1:
            kept = from_codes(texture[place])
            if between is not None:
                kept = without(between, kept, None if shade is None else shade(rows, columns)[0])
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
