"""What the context network tells of the light on a whole chart, corrected."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.anatomy.eyes.sclera import BETWEEN_LIDS
from service.arrays import Float32
from service.colour import srgb_to_linear
from service.ledger import Ledger
from service.reflectance.albedo_error import clues
from service.reflectance.corrections.light_contrast import LIGHT_CONTRAST
from service.reflectance.corrections.on_light import ChartLight, LightCorrection, corrected
from service.reflectance.corrections.skin_hue import SKIN_HUE
from service.reflectance.corrections.unseen_light import UNSEEN_SKIN
from service.reflectance.planes import Planes
from service.reflectance.subject import EYES, INPAINTED, LIDS, LIT, SHOWN
from service.runtime.networks import Network
from service.runtime.tiles import run_whole

TEXTURE = ("texture_r", "texture_g", "texture_b")

ON_LIT_SKIN: tuple[LightCorrection, ...] = (SKIN_HUE, LIGHT_CONTRAST)
"""Corrections of the light where the photo shows skin in it, in order."""

EVERYWHERE: tuple[LightCorrection, ...] = (UNSEEN_SKIN,)
"""Corrections of the light that is continued from there to the whole chart, in order."""


@dataclass(frozen=True)
class Found:
    """What the context network tells of a whole chart.

    Attributes:
        light: (C, h, w) log light on skin, gone on with into all that is not lit skin.
        between: (3,) log light on eyes, teeth and tongue, should the texture not tell.
        clues: (K, h, w) to how sure the albedo is, ``service.reflectance.albedo_error``.
    """

    light: Float32
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


def found_by(network: Network, planes: Planes, ledger: Ledger | None = None) -> Found:
    """Ask the context network about the planes of a whole chart.

    Planes of ``service.reflectance.subject.CLUES`` may be missing: then all skin is lit, none is
    inpainted, and there are no lids.
    """
    ledger = ledger or Ledger()
    what = network.description
    size = what.whole or planes.size
    light = run_whole(network, planes.shrunk(what.channels, size))

    def clue(name: str, usual: float) -> Float32:
        shown = planes.shrunk([name], size)[0] if name in planes.channels else np.full(light.shape[1:], usual)
        return np.asarray(shown, np.float32)

    lit, inside, lids = clue(LIT, 1.0), planes.shrunk(["mask"], size)[0], clue(LIDS, 0.0)
    coded = np.moveaxis(planes.shrunk(TEXTURE, size), 0, 2).reshape(-1, 3) * np.float32(0.5) + np.float32(0.5)
    linear = srgb_to_linear(coded)
    white_seen = EYES[-1] not in planes.channels or bool(planes.shrunk(EYES[-1:], size).any())
    # Lids are small and have lashes: brought to the albedo of skin, they would glow beside the lashes.
    inpainted = clue(INPAINTED, 0.0) * (1 - lids)
    shown = np.maximum(lit, clue(SHOWN, 0.0)) * inside
    start = ChartLight(light, light, linear.T.reshape(3, *lit.shape), lit, inside, inpainted, shown)
    on_skin = corrected(start, ON_LIT_SKIN, ledger)
    whole = corrected(replace(on_skin, found=on_skin.light), EVERYWHERE, ledger)
    prior = start.prior
    apart = None if prior is None else prior.apart(start.shown)
    clue_planes = clues(whole.light, start.texture, start.weight, lids, apart, white_seen)
    return Found(whole.light, light_between_lids(on_skin.light, lit), clue_planes)
