"""Corrections (``service.corrections``) of the light that delta's context network finds on the whole chart.

**How red and how yellow skin can be.** Skin alone does not tell warm light from warm skin, nor a photo's saturation
from either. But melanin and blood leave little choice: as spectrophotometers find it, the reddest fair cheek has twice
as much red as green, and only dark skin has more. What a network finds beyond that is the light's or the camera's.

**How much of a photo's contrast from region to region is light**: less than a network of even skins takes it for. Where
shade and pigment cannot be told apart, the best estimate divides the contrast between both by their variances (Wiener).
The light stage's skin varies less from region to region than real skin does, whose lids are darker than its cheeks by a
quarter to a half and whose cheeks and forehead are paler: so the network gives light too large a share. Within two
centimetres a share of what it found is light, and the rest is the skin's. The overall form of the light, which is
wider, stays.

**Light where the photo shows no skin**: under hair and hats, and where the texture was inpainted. The network has seen
lit skin only, and would take other colours for brightly lit or shaded skin. There its light is replaced: by the light
continued from lit skin; on inpainted skin by the light under which the albedo is that of the seen skin around.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from service.arrays import Float32
from service.colour import LUMA, linear_to_srgb
from service.corrections import SEEN_CHANGE, Correction, Ledger
from service.image_filters import blurred
from service.reflectance.albedo.albedo_prior import DARKEST, AlbedoPrior, albedo_prior, certainty
from service.robust import smoothstep

BORDER = 3
"""Width of the border over which lit skin fades out, texels of the context's chart, 1.5 mm each."""
LEAST_BEARD = 40.0
"""Such texels of beard from which a head counts as bearded: a square centimetre."""


@dataclass(frozen=True)
class ChartLight:
    """Light on the chart, and what tells where it is to be believed.

    Attributes:
        light: (3, h, w) float32 natural logarithm of the linear RGB light, as far as it has been corrected.
        found: (3, h, w) the same as it is on lit skin, before it was continued to all else.
        texture: (3, h, w) float32 linear RGB, the photo's light in it.
        lit: (h, w) in [0, 1], skin in the photo's light.
        inside: (h, w) in [0, 1], islands of the chart.
        inpainted: (h, w) in [0, 1], skin that no photo showed.
        shown: (h, w) in [0, 1], at least :attr:`weight`: what of the head's own surface the photo shows, beards too.
        cloth: linear luminance of the brightest cloth in the photo; 0: none is seen.
    """

    light: Float32
    found: Float32
    texture: Float32
    lit: Float32
    inside: Float32
    inpainted: Float32
    shown: Float32
    cloth: float = 0.0

    @property
    def weight(self) -> Float32:
        """(h, w) in [0, 1]: lit skin inside the islands."""
        return self.lit * self.inside

    @property
    def bearded(self) -> bool:
        """Whether the photo shows a beard: what is shown beside lit skin and its soft border."""
        skin = cv2.dilate(self.lit, np.ones((2 * BORDER + 1, 2 * BORDER + 1), np.uint8))
        return float(np.clip((self.shown - skin) * self.inside, 0, None).sum()) > LEAST_BEARD

    @property
    def prior(self) -> AlbedoPrior | None:
        """What completes albedo like this head's; None on another chart than the one that it was learnt on."""
        found = albedo_prior(self.bearded)
        return found if found.is_of(self.inside) else None

    @property
    def coded_albedo(self) -> Float32:
        """(3, h, w) sRGB in [0, 1] of the albedo that the light leaves of the texture."""
        return linear_to_srgb(self.texture * np.exp(-np.clip(self.light, -6, 6)))


@dataclass(frozen=True, kw_only=True)
class LightCorrection(Correction):
    """A correction of light.

    Attributes:
        apply: (3, h, w) log light in place of ``ChartLight.light``.
    """

    apply: Callable[[ChartLight], Float32]


def corrected(state: ChartLight, corrections: Sequence[LightCorrection], ledger: Ledger) -> ChartLight:
    """The light after all corrections that are switched on, in order; the ledger counts texels of the chart."""
    for one in corrections:
        if not ledger.runs(one):
            continue
        after = replace(state, light=one.apply(state))
        if after.light is not state.light:
            moved = np.abs(after.coded_albedo - state.coded_albedo).max(0) > SEEN_CHANGE
            ledger.count(one, int((moved & (state.inside > 0.5)).sum()), state.lit.size)
        else:
            ledger.count(one, 0, state.lit.size)
        state = after
    return state


FAIR, DARK = float(np.log(0.25)), float(np.log(0.11))
"""Log luminance of the albedo from which on skin counts as fair, and down to which as dark; between them, between."""

REDDEST = (0.70, 1.1)
"""Log of red over green of linear albedo that hardly anyone's fair, dark skin exceeds: CIELAB a* of about 17 and 19, by
spectrophotometry."""

YELLOWEST = (0.50, 0.87)
"""The same of green over blue: b* of about 22 and 25."""

BEYOND = 0.2
"""What is left of an excess, chosen by eye: redder findings stay redder than others."""

FEW = 50
"""Fewest texels of lit skin by whose median the hue is told."""


def within_skin(light: Float32, linear: Float32, lit: Float32) -> Float32:
    """(3, h, w) log light with another tint, so that the skin is no redder or yellower than skin can be.

    Half of what the skin's luminance would lose with its red comes back: red that is in excess makes skin too bright,
    but the network also takes redder skin for darker skin. Skin is judged by its median, so lips and brows do not
    matter.

    Args:
        light: (3, h, w) log light that was found.
        linear: (3, h, w) linear RGB texture.
        lit: (h, w) in [0, 1], where the light is to be believed.
    """
    log_albedo = np.log(np.maximum(linear, np.float32(1e-4))) - light
    chosen = log_albedo[:, lit > 0.5]
    if chosen.shape[1] < FEW:
        return light
    red, green, blue = (float(value) for value in np.median(chosen, 1))
    luminance = float(np.log(LUMA @ np.exp([red, green, blue])))
    share = float(np.clip((FAIR - luminance) / (FAIR - DARK), 0.0, 1.0))
    tint = np.array([_excess(red - green, REDDEST, share), 0.0, -_excess(green - blue, YELLOWEST, share)])
    tint += 0.5 * (np.log(LUMA @ np.exp([red, green, blue] - tint)) - luminance)
    return np.asarray(light + tint.astype(np.float32)[:, None, None], np.float32)


def _excess(found: float, limits: tuple[float, float], share: float) -> float:
    fair, dark = limits
    return (1.0 - BEYOND) * max(found - (fair + share * (dark - fair)), 0.0)


SKIN_HUE = LightCorrection(
    name="skin-hue",
    mends="Warm light or a saturated photo leaves skin redder or yellower than skin is.",
    cases=("warm", "graded"),
    apply=lambda at: within_skin(at.light, at.texture, at.weight),
)


WHITEST, BRIGHTLY = 0.9, 0.9
"""Albedo of the whitest cloth. Quantile of the light on lit skin that counts as the light on cloth: it hangs upright,
as the brighter side of the face does."""


def no_whiter_cloth(light: Float32, lit: Float32, cloth: float) -> Float32:
    """(3, h, w) log light under which no cloth is whiter than white.

    A photo's exposure is unknown, so dark skin in usual light looks like fair skin in dim light. A white shirt tells
    them apart: the light is at least as bright as it. Of other cloth nothing follows.

    Args:
        light: (3, h, w) log light that was found.
        lit: (h, w) in [0, 1], where it is to be believed.
        cloth: linear luminance of the brightest cloth.
    """
    chosen = light[:, lit > 0.5]
    if chosen.shape[1] < FEW or cloth <= 0:
        return light
    bright = float(np.quantile(LUMA @ np.exp(np.clip(chosen, -6, 6)), BRIGHTLY))
    return np.asarray(light + np.float32(max(np.log(cloth / (WHITEST * bright)), 0.0)), np.float32)


WHITE_CLOTH = LightCorrection(
    name="white-cloth",
    mends="Dark skin is taken for fair skin in dim light, beside a shirt that would be whiter than white in it.",
    cases=("shirt",),
    apply=lambda at: no_whiter_cloth(at.light, at.weight, at.cloth),
)


KEPT = 0.75
"""Share of the light's contrast that is light, chosen on photos of rendered heads, none of which was learnt from."""
WIDE = 14.0
"""Standard deviation of what counts as its overall form, texels of the context: 2 cm on the face."""
LEAST = 1e-3
"""Share of lit skin in the surroundings with less of which the light stays as it is."""


def less_contrast(light: Float32, lit: Float32, kept: float = KEPT) -> Float32:
    """(C, h, w) log light with a share of its local contrast where skin is lit; as it is far from all lit skin.

    Args:
        light: as it was found.
        lit: (h, w) in [0, 1], where it is to be believed.
        kept: share of the contrast, in [0, 1].
    """
    near = blurred(lit, WIDE)
    form = np.stack([blurred(plane * lit, WIDE) for plane in light]) / np.maximum(near, np.float32(LEAST))
    return np.asarray(np.where(near > LEAST, form + np.float32(kept) * (light - form), light), np.float32)


UNEVEN, NEARBY = 0.3, 5.0
"""Local contrast of the light, natural logarithm, in which it is believed half as much as in even light; chosen on
photos of rendered heads. Standard deviation over which that is measured, texels of the context: 7 mm."""


def evenness(light: Float32, lit: Float32) -> Float32:
    """(h, w) in [0, 1], 1 where a (3, h, w) log light is as bright as around: where it is not, it is as far off."""
    bright = np.tensordot(LUMA, light, 1)[None].astype(np.float32)
    contrast = np.square(bright - less_contrast(bright, lit, kept=0.0))[0]
    near = blurred(contrast * lit, NEARBY) / np.maximum(blurred(lit, NEARBY), np.float32(LEAST))
    return np.asarray(1 / (1 + near / np.float32(UNEVEN**2)), np.float32)


LIGHT_CONTRAST = LightCorrection(
    name="light-contrast",
    mends="Regions of the skin that are darker or paler than the rest are taken for shade and light.",
    cases=("soft", "hard"),
    apply=lambda at: less_contrast(at.light, at.weight),
)


WIDEST = 64
"""Standard deviation of the widest blur that continues light, texels of the context: a third of the chart's width."""

GRAIN = 3.0
"""Standard deviation of the blur below which inpainted skin keeps its own detail, texels of the context: finer than any
shade of a fold."""

BEARD_END = 8.0
"""Standard deviation of the blur over which a beard fades beyond what is seen of it, texels of the context: 14 mm. How
far it goes on is for the prior to tell."""

BEARDED = 0.45
"""Share of the chart's height below which a beard may go on: below the eyes. Brows do not go on."""

NEAR_LIT = (6.0, 3.0)
"""Standard deviation of the blur, texels of the context, 9 mm, by which lit skin reaches over brows; and its gain."""


def continued(light: Float32, lit: Float32) -> Float32:
    """(C, h, w) light continued smoothly from lit skin to all else; unchanged where nothing or all is lit skin.

    Inpainted colour carries the light of the place that it came from, not that of its own place.

    Args:
        light: what the context network found.
        lit: (h, w) in [0, 1], where the light is to be believed.
    """
    weight = np.clip(lit, 0, 1).astype(np.float32)
    total = float(weight.sum())
    if total < 1:
        return light
    planes = np.ascontiguousarray(np.moveaxis(light, 0, 2), np.float32)
    weighted = planes * weight[..., None]
    filled: Float32 = np.broadcast_to(weighted.sum((0, 1)) / np.float32(total), planes.shape).astype(np.float32)
    sigma = WIDEST
    while sigma >= 2:
        near = blurred(weight, sigma)[..., None]
        spread = blurred(weighted, sigma).reshape(planes.shape)
        trust = near / (near + np.float32(0.02))
        filled = np.asarray(trust * spread / np.maximum(near, np.float32(1e-6)) + (1 - trust) * filled, np.float32)
        sigma //= 2
    soft = np.minimum(blurred(weight, 2), weight)[..., None]
    return np.asarray(np.moveaxis(soft * planes + (1 - soft) * filled, 2, 0), np.float32)


def beside_lit(lit: Float32) -> Float32:
    """(h, w) in [0, 1], 1 on lit skin (h, w) and on what is narrow in it, as brows are."""
    return np.asarray(np.clip(NEAR_LIT[1] * blurred(np.clip(lit, 0, 1), NEAR_LIT[0]), 0, 1), np.float32)


def as_seen_skin(
    light: Float32,
    texture: Float32,
    found: Float32,
    lit: Float32,
    inpainted: Float32,
    shown: Float32,
    prior: AlbedoPrior | None = None,
) -> Float32:
    """(3, h, w) light under which inpainted skin has the albedo that goes with the seen skin, but for its own grain.

    Inpainted colour is continued from the photo's, with the shade of a jaw or a fringe in it, and ends in the median
    colour of the lit face. No smooth light takes both off. The albedo is the likeliest given the seen skin; what that
    has beside it is continued, so there is no step between both.

    Args:
        light: log light continued from lit skin (:func:`continued`).
        texture: (3, h, w) linear.
        found: (3, h, w) log light as the network found it, to be believed where lit.
        lit: (h, w) in [0, 1]; without any lit skin the light is returned as it is.
        inpainted: (h, w) in [0, 1], inpainted skin.
        shown: (h, w) in [0, 1], at least ``lit``: what the photo shows. A beard tells no light and is part of the
            albedo: beyond the border of what is seen it goes on.
        prior: of whole albedo maps of this chart; None: the albedo of seen skin is continued alone.
    """
    if float(lit.sum()) < 1 or not inpainted.any():
        return light
    sure = certainty(found, texture, lit)
    lit, shown = lit * sure, shown - lit * (1 - sure)
    colour = np.log(np.maximum(texture, np.float32(DARKEST)))
    seen = np.asarray(colour - (lit * found + (1 - lit) * light), np.float32)
    usual = np.zeros_like(seen) if prior is None else prior.complete(seen, shown)
    skin = continued(seen - usual, lit)
    beard = (shown - lit) * (np.arange(lit.shape[0]) > BEARDED * lit.shape[0])[:, None]
    wanted = usual + skin + _nearby(beard * (seen - usual - skin), shown)
    plain = _blurred(colour * inpainted, GRAIN) / np.maximum(blurred(inpainted, GRAIN), np.float32(1e-6))
    share = np.minimum(blurred(inpainted, 2.0), inpainted)
    return np.asarray(light + share * (plain - wanted - light), np.float32)


def _nearby(planes: Float32, shown: Float32) -> Float32:
    """(C, h, w) what is shown, 0 where nothing is to be added, gone on with and faded out over ``BEARD_END``."""
    near = blurred(shown, BEARD_END)
    return np.asarray(_blurred(planes, BEARD_END) / np.maximum(near, np.float32(1e-3)) * np.minimum(2 * near, 1))


def _blurred(planes: Float32, sigma: float) -> Float32:
    """(C, h, w) Gaussian blur of each plane."""
    return np.stack([blurred(plane, sigma) for plane in planes])


def everywhere(at: ChartLight) -> Float32:
    """(3, h, w) log light of the whole chart: that of lit skin, continued to all else.

    Inpainted skin has the albedo of the prior in the box, where the chart is the one that it was learnt on.
    """
    light = continued(at.light, at.lit)
    if not at.inpainted.any():
        return light
    return as_seen_skin(light, at.texture, at.found, at.weight, at.inpainted, at.shown, at.prior)


UNSEEN_SKIN = LightCorrection(
    name="unseen-skin",
    mends="The network takes inpainted colour, hair and caps for lit or shaded skin.",
    cases=("cap", "beard", "hard"),
    apply=everywhere,
)


INKY = (0.12, 0.06)
"""Luminance of linear albedo below which what is blue is taken for hair in warm light; paler eye shadow may be blue."""


def no_bluer(at: ChartLight) -> Float32:
    """(3, h, w) log light under which beards, unseen skin and what is dark are nowhere bluer than grey, as no hair and
    no skin is.

    White hair shows the light's own colour. Where the skin's hue made the network tell a warmer light than that, or a
    photo's colours were made stronger, white beards came out blue; and so did black brows in warm light, whose little
    light is the lens's veil.
    """
    albedo = np.log(np.maximum(at.texture, np.float32(DARKEST))) - at.light
    bluer = np.maximum(albedo - albedo[:1], 0)
    dark = at.inside * smoothstep(-np.tensordot(LUMA, np.exp(albedo), 1), -INKY[0], -INKY[1])
    no_skin = np.clip(at.shown - at.weight + at.inpainted + dark, 0, 1)
    return np.asarray(at.light + no_skin * bluer, np.float32)


GREY_HAIR = LightCorrection(
    name="grey-hair",
    mends="White beards and black brows come out blue where the skin tells a warmer light than there is.",
    cases=("beard",),
    apply=no_bluer,
)
