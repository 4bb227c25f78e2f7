"""delta: texture without its light (AvatarMe, section 4.3).

What light the photo was taken in is seen from the whole head, not from a tile. A small network therefore looks at the
whole chart once and leaves its findings as coarse planes that every tile reads.

Rules correct what it finds, and what is left after it: ``REGISTRY`` has all of them in the order in which they run.
``avatarme make --without NAME,...`` switches them off; ``benchmarks.corrections`` takes each on trial.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from service.anatomy.eyes import BRIGHTEST
from service.arrays import Float32
from service.colour import FULL_CODE, LUMA, Codes, from_codes, linear_to_srgb, srgb_to_linear, to_codes
from service.corrections import Correction, Ledger
from service.face.features.eye_colours import BETWEEN_LIDS
from service.image_filters import blurred, each_around, shrunk
from service.light.scene import BRIGHT
from service.reflectance.albedo.albedo_prior import DARKEST, clues, error_model
from service.reflectance.albedo.beside_skin import CODED_LIFT, as_told, pad_skin
from service.reflectance.albedo.corrections import (
    GREY_HAIR,
    LIGHT_CONTRAST,
    SKIN_HUE,
    UNSEEN_SKIN,
    WHITE_CLOTH,
    ChartLight,
    LightCorrection,
    beside_lit,
    corrected,
    evenness,
)
from service.reflectance.albedo.highlights import HIGHLIGHTS
from service.reflectance.planes import Planes, read_window
from service.reflectance.subject import Subject
from service.reflectance.translate import MapInputs, open_translator, resample, translate
from service.robust import agreement, smoothstep
from service.runtime.network_registry import EYES, INPAINTED, LIDS, LIT, PARTS, SHOWN, TEXTURE, networks_of
from service.runtime.networks import Network, open_network
from service.runtime.tiles import run_whole
from service.texture.texture import PhotoTexture

ON_LIT_SKIN: tuple[LightCorrection, ...] = (WHITE_CLOTH, SKIN_HUE, LIGHT_CONTRAST)
"""Corrections of the light where the photo shows skin in it, in order."""

EVERYWHERE: tuple[LightCorrection, ...] = (UNSEEN_SKIN, GREY_HAIR)
"""Corrections of the light that is continued from there to the whole chart, in order."""


TOLD_LIGHT = Correction(
    name="told-light",
    mends="The network that takes off the light tile by tile takes lids, brows and chins for shade a second time.",
    cases=("soft", "hard", "brows", "beard"),
)
AS_TOLD = 0.01
"""Change of log albedo from which a texel of the context counts as changed by it."""


@dataclass(frozen=True)
class Found:
    """What the context network tells of a whole chart.

    Attributes:
        light: (C, h, w) log light on skin, gone on with into all that is not lit skin.
        albedo: (3, h, w) natural logarithm of the texture less that light, at most ``BRIGHTEST``.
        believed: (h, w) in [0, 1], 1 on lit skin and on what is narrow in it, brows and lids, where the light is even.
        between: (3,) log light on eyes, teeth and tongue, should the texture not tell.
        clues: (K, h, w) to how sure the albedo is, ``service.reflectance.albedo.albedo_prior``.
    """

    light: Float32
    albedo: Float32
    believed: Float32
    between: Float32
    clues: Float32


def light_between_lids(light: Float32, lit: Float32) -> Float32:
    """(3,) log light on eyes, teeth and tongue of a texture that does not tell: the face's less shade.

    Args:
        light: (3, h, w) log light of the skin.
        lit: (h, w) in [0, 1], where it is to be believed; nowhere counts as everywhere.
    """
    weight = lit if float(lit.sum()) >= 1 else np.ones_like(lit)
    mean = (light * weight).sum((1, 2)) / np.float32(weight.sum())
    return np.asarray(mean + np.float32(np.log(BETWEEN_LIDS)), np.float32)


def found_by(
    network: Network,
    planes: Planes,
    ledger: Ledger | None = None,
    photos: Sequence[PhotoTexture] = (),
    cloth: float = 0.0,
) -> Found:
    """Ask the context network about the planes of a whole chart.

    Planes of ``service.reflectance.subject.CLUES`` may be missing: then all skin is lit, none is inpainted, and there
    are no lids. Of several photos each is asked about by itself, too (``service.reflectance.albedo.diffuse_albedo``).
    """
    ledger = ledger or Ledger()
    start, lids, white_seen = asked(network, planes, cloth)
    on_skin = corrected(start, ON_LIT_SKIN, ledger)
    if photos:

        def delit(photo: PhotoTexture) -> tuple[ChartLight, Float32]:
            own, _, white = asked(network, photo_planes(planes, photo), photo.cloth)
            told = corrected(own, ON_LIT_SKIN, Ledger(ledger.without))
            return told, error_model().stated(clues(told.light, own.texture, own.weight, lids, None, white))

        on_skin = agreed_light(on_skin, photos, delit)
    whole = corrected(replace(on_skin, found=on_skin.light), EVERYWHERE, ledger)
    prior = start.prior
    apart = None if prior is None else prior.apart(start.shown)
    clue_planes = clues(whole.light, start.texture, start.weight, lids, apart, white_seen)
    albedo = np.log(np.clip(start.texture, DARKEST, None)) - np.clip(whole.light, -6, 6)
    albedo = np.minimum(albedo, np.float32(np.log(BRIGHTEST)))
    between = light_between_lids(on_skin.light, start.lit)
    believed = beside_lit(start.weight)
    return Found(whole.light, albedo, believed * evenness(whole.light, believed), between, clue_planes)


EXPOSED = 0.52
"""Linear luminance of the ``BRIGHT`` quantile of lit skin, the middle of what photographers expose it for and networks
have learnt from (sRGB values of 0.55 to 0.95, ``models.lightstage.light.prior``)."""


def exposure(texture: Float32, lit: Float32) -> float:
    """Gain under which a linear texture (3, h, w) is as bright where skin is lit (h, w) as photographers expose it.

    Without it the skin of a dim photo counts as dark. Where none is lit the gain is 1.
    """
    shown = np.tensordot(LUMA, texture, 1)[lit > 0.5]
    return EXPOSED / max(float(np.quantile(shown, BRIGHT)), DARKEST) if shown.size else 1.0


def asked(network: Network, planes: Planes, cloth: float = 0.0) -> tuple[ChartLight, Float32, bool]:
    """What the network says of planes, (h, w) how far a texel is lid, and whether a white is known.

    ``cloth`` is the linear luminance of the brightest cloth in their photo; 0: none is seen.
    """
    what = network.description
    size = what.whole or planes.size
    inside = planes.shrunk(["mask"], size)[0]

    def clue(name: str, usual: float) -> Float32:
        shown = planes.shrunk([name], size)[0] if name in planes.channels else np.full(inside.shape, usual)
        return np.asarray(shown, np.float32)

    lit, lids = clue(LIT, 1.0), clue(LIDS, 0.0)
    texture = srgb_to_linear(planes.shrunk(TEXTURE, size) * np.float32(0.5) + np.float32(0.5))
    gain = np.float32(exposure(texture, lit * inside))
    exposed = Planes(size, dict(planes.channels))
    exposed.add_coarse(TEXTURE, linear_to_srgb(np.minimum(gain * texture, 1)) * np.float32(2) - np.float32(1))
    white_seen = True
    if EYES[-1] in planes.channels:
        white = planes.shrunk(EYES, size)
        white_seen = bool(white[-1].any())
        white[:-1] += white[-1] * np.log(gain)
        exposed.add_coarse(EYES, white)
    light = run_whole(network, exposed.shrunk(what.channels, size)) - np.log(gain)
    shown = np.maximum(lit, clue(SHOWN, 0.0)) * inside
    return ChartLight(light, light, texture, lit, inside, clue(INPAINTED, 0.0), shown, cloth), lids, white_seen


LIFTED = np.float32(1 + 2 * CODED_LIFT / FULL_CODE)
"""Added to codes in [-1, 1], so that a factor on them is one on linear values (``beside_skin.scaled``)."""


def halved_light(delta: Network, texture: Codes, job: MapInputs, subject: Subject) -> Float32:
    """(3, H / 2, W / 2) float32 factors on lifted codes by which the network takes the light off at half the size.

    That light is smooth where no photo shows the skin; what detail is drawn there is the texture's.
    """
    size = (job.planes.size[0] // 2, job.planes.size[1] // 2)
    planes, small = job.planes.coarse_at(size), resample(texture, size)
    planes.add_codes("texture", small)
    factor = np.zeros(small.shape, np.float32)

    def keep(place: tuple[slice, slice], values: Float32, skin: Float32) -> None:
        factor[place] = (np.moveaxis(np.clip(values, -1, 1), 0, 2) + LIFTED) / (from_codes(small[place]) + LIFTED)

    whole = np.full(small.shape[:2], 255, np.uint8)
    translate(delta, replace(job, planes=planes, skin=whole, progress=lambda done: None), keep)
    return np.moveaxis(pad_skin(factor, subject), 2, 0)


LIGHT_NETWORK, NETWORK = networks_of("diffuse_albedo")
"""The first sees the light of the whole chart, the second takes it off."""


@dataclass(frozen=True)
class Delit:
    """A texture without its light.

    Attributes:
        albedo: (H, W, 3) sRGB codes.
        error: (h, w) float32 of ``service.reflectance.albedo.albedo_prior``.
    """

    albedo: Codes
    error: Float32


def without(light: Float32, coded: Float32) -> Float32:
    """(h, w, 3) texture in [-1, 1] without a (3,) log light, at most ``BRIGHTEST``."""
    linear = srgb_to_linear(coded * np.float32(0.5) + np.float32(0.5)) * np.exp(-np.clip(light, -6, 6))
    return linear_to_srgb(np.minimum(linear, np.float32(BRIGHTEST))) * np.float32(2) - np.float32(1)


def diffuse_albedo(texture: Codes, job: MapInputs, subject: Subject, ledger: Ledger) -> Delit:
    """The albedo of a texture (H, W, 3), which is among the job's planes as ``texture_*``.

    The network has seen skin only. What is no skin has the albedo of the planes ``PARTS``; without them the texture
    loses the light of the face there, less what the lids shade.

    Args:
        texture: codes.
        job: what the network is given.
        subject: whose texture it is; where it is ``unseen``, the light is that at half the size.
        ledger: which corrections run; it counts what they change.

    Raises:
        ModelFault: a network is missing, changed, or does not fit.
    """
    with open_network(LIGHT_NETWORK, job.engine) as network:
        found = found_by(network, job.planes, ledger, subject.photos, subject.cloth)
        job.planes.add_coarse(network.description.planes(len(found.light)), found.light)
    result = np.zeros_like(texture)
    parts = job.planes.read(PARTS) if set(PARTS) <= set(job.planes.channels) else None

    def beside_parts(place: tuple[slice, slice], albedo: Float32, skin: Float32) -> Codes:
        rows, columns = (np.arange(s.start, s.stop) for s in place)
        if skin.min() < 1:
            if parts is not None:
                kept = np.moveaxis(parts(rows, columns), 0, 2)
            else:
                kept = without(found.between, from_codes(texture[place]))
            albedo = kept + skin[..., None] * (albedo - kept)
        return to_codes(albedo)

    def keep(place: tuple[slice, slice], values: Float32, skin: Float32) -> None:
        result[place] = beside_parts(place, np.moveaxis(np.clip(values, -1, 1), 0, 2), skin)

    with open_translator(NETWORK, job.engine, 3) as delta:
        translate(delta, job, keep, None if subject.unseen is None else subject.unseen < 1)
        halved = None if subject.unseen is None else (*halved_light(delta, texture, job, subject), subject.unseen)

    def fade(planes: Sequence[Float32], rows: slice, columns: slice) -> None:
        place = (rows, columns)
        light, share = (read_window(some, job.planes.size, *place) for some in (planes[:-1], planes[-1:]))
        told, own = (from_codes(texture[place]) + LIFTED) * light - LIFTED, from_codes(result[place])
        mixed = beside_parts(place, own + share * (told - own), job.skin[place] * np.float32(1 / 255))
        np.copyto(result[place], mixed, where=share > 0)

    if halved is not None:
        each_around(halved[-1] > 0, result.shape, partial(fade, halved))
    if ledger.runs(TOLD_LIGHT):
        skin = shrunk(job.skin, found.believed.shape[::-1]) * np.float32(1 / 255)
        result, factor = as_told(result, found.albedo, found.believed * skin)
        ledger.count(TOLD_LIGHT, int((np.abs(np.log(factor)).max(0) > AS_TOLD).sum()), factor[0].size)
    return Delit(result, error_model().stated(found.clues))


REGISTRY: tuple[Correction, ...] = (*ON_LIT_SKIN, *EVERYWHERE, TOLD_LIGHT, HIGHLIGHTS)

NAMES = tuple(one.name for one in REGISTRY)


ASTRAY = 0.25
"""Difference of log luminance from the middle of all photos at which a photo's say is quartered."""
ROUNDS = 4
"""Rounds in which photos are brought to one brightness."""
KNOWN = (0.02, 0.3)
"""Lit skin of all photos together from which on the albedo counts, and from which on alone."""
SOFT = 1.5
"""Standard deviation, texels of the context, below which light has no detail."""


def photo_planes(planes: Planes, photo: PhotoTexture) -> Planes:
    """Planes of a whole chart with one photo's texture, lit skin and white in place of the blended texture's."""
    own = Planes(planes.size, dict(planes.channels))
    coded = np.moveaxis(photo.texture, 2, 0) * np.float32(2 / 255) - np.float32(1)
    own.add_coarse(TEXTURE, np.asarray(coded, np.float32))
    lit = photo.lit_skin * np.float32(1 / 255)
    own.add_coarse([LIT], lit[None])
    if EYES[0] in planes.channels:
        white = planes.shrunk(EYES, (photo.lit_skin.shape[1], photo.lit_skin.shape[0]))
        if photo.white is not None:
            white[:3], white[3] = np.log(photo.white)[:, None, None], 1
        else:  # as bright as another photo's beside the same skin
            level = (photo.gain * lit[..., None]).sum((0, 1)) / max(float(lit.sum()), 1e-6)
            white[:3] -= white[3] * level.astype(np.float32)[:, None, None]
        own.add_coarse(EYES, white)
    return own


def agreed_light(
    blended: ChartLight, photos: Sequence[PhotoTexture], delit: Callable[[PhotoTexture], tuple[ChartLight, Float32]]
) -> ChartLight:
    """The light in a blended texture under which its albedo is what the photos agree on.

    Skin in one light cannot be told from paler skin in less light; photos in other lights can. What a network takes off
    each of them leaves the same albedo, but for its errors, which differ with the light. So each is de-lit by itself,
    and the logarithms of what is left are averaged, weighted by how sure each is; a highlight or a cast shadow that one
    photo has and the others have not is outvoted. How pale the whole skin is, each says on its own, and all together.

    Args:
        blended: of the blended texture, its light as a network found it, where no photo tells.
        photos: what each shows.
        delit: of one photo its light on lit skin, corrected, and (h, w) how far its albedo may be off.
    """
    size = (blended.lit.shape[1], blended.lit.shape[0])
    albedos, weights, levels = [], [], []
    for photo in photos:
        own, error = delit(photo)
        seen = shrunk(photo.seen, size) * np.float32(1 / 255)
        albedos.append(np.log(np.maximum(own.texture, np.float32(DARKEST))) - own.light)
        weights.append(own.weight * seen / np.maximum(error, np.float32(0.02)) ** 2)
        levels.append(own.weight * seen)
    albedo, weight = np.stack(albedos), np.stack(weights)
    level = np.stack(levels).sum((1, 2))
    if not float(level.sum()) > 1:
        return blended
    offset: Float32 = np.zeros((len(photos), 3), np.float32)
    for _ in range(ROUNDS):
        trust = weight * _agreed(albedo + offset[..., None, None], weight)
        for one in range(len(photos)):
            rest = trust.copy()
            rest[one] = 0
            total = rest.sum(0)
            mean = (rest[:, None] * (albedo + offset[..., None, None])).sum(0) / np.maximum(total, np.float32(1e-6))
            shared = trust[one] * total / np.maximum(trust[one] + total, np.float32(1e-6))
            if float(shared.sum()) > 0:
                offset[one] = (shared * (mean - albedo[one])).sum((1, 2)) / shared.sum()
    offset -= (level[:, None] * offset).sum(0) / level.sum()
    said = albedo + offset[..., None, None]
    trust = weight * _agreed(said, weight)
    mean = (trust[:, None] * said).sum(0) / np.maximum(trust.sum(0), np.float32(1e-6))
    light = np.log(np.maximum(blended.texture, np.float32(DARKEST))) - mean
    told = np.asarray(smoothstep(np.stack(levels).sum(0), *KNOWN) * (blended.lit > 0), np.float32)
    near = np.maximum(blurred(told, SOFT), np.float32(1e-3))
    smooth = np.stack([blurred(plane * told, SOFT) / near for plane in light])
    return replace(blended, light=np.asarray(blended.light + told * (smooth - blended.light), np.float32))


def _agreed(said: Float32, weight: Float32) -> Float32:
    """(K, h, w) in (0, 1] how near each photo's albedo (K, 3, h, w), in logarithms, is to the middle of all."""
    return agreement(np.tensordot(said, LUMA, ((1,), (0,))), weight, weight > 0, ASTRAY)
