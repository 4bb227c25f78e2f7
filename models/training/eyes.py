"""What the whites of the eyes tell delta's context of a chart's light in training, with a photo's errors."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from models.colour import linear, srgb
from models.training.albedo import log_light
from models.training.regions import region_planes
from models.training.tasks import uniform
from service.face.features.eye_colours import BEST_LIT, BETWEEN_LIDS, SCLERA

KNOWN = 0.7
"""Share of training charts with whites of the eyes to be seen, if the eyes are open."""

FAITH, LESS = 0.95, -0.3
"""How the light that the program reads off the whites goes with the computed one (``models.lightstage.light.sclera``),
in logarithms, both beside the light on the lids: slope and shift. Measured: 0.93 and -0.57 for
heads of the light stage, and for heads of ICT-FaceKit, whose eyes lie less deep, -0.41 where 0.19 is computed. It
counts all skin round the eyes; the zones of :func:`lid_zones` are nearer to them and 0.3 darker."""

FLAT, FLATTER = 0.15, (0.7, 1.2)
"""Eyes of the light stage's heads lie deeper between their lids than people's: under an even sky their whites stand in
0.2 to 0.65 less log light than the lids, those of scanned heads in 0 to 0.2 more (``Whites.beside_lids``). The whites
of each chart are told nearer to the first number by a share between the other two."""

ERROR = 0.22
"""Standard deviation of what is left; 0.25 and 0.18 there. With a wider one, and more mistakes than there are, what is
told was off by 0.67 in training, and the network heeded it by half."""

EXPOSED = (-0.5, 0.6)
"""Mean and standard deviation of the log light on faces as photos expose them. Real photos have a
median of -0.7 for the lids, and 0.45 for half of the middle two thirds; the rest of a face stands in 0.2 more."""

BRIGHTEST_TOLD = float(BETWEEN_LIDS / BEST_LIT / SCLERA.mean())
"""Mean light that a sclera tells which is just overexposed: it may be any more."""

BRIGHTEST, DARKEST = 4.0, 1e-3
"""Log light, and light, beyond which an 8-bit texture tells nothing."""

TINT = 0.08
"""Standard deviation of the light's tint by whites: eyes have vessels, teeth are more or less yellow."""

MISTAKEN, MISTAKE = 0.05, (-0.9, 0.5)
"""Share of training charts whose whites are lids, lashes or shadow in truth, and how far that is off, in logarithms."""


def lid_zones() -> Tensor:
    """(2, h, w) weights of the skin round either eye on the context's chart, the left one first, each of sum 1."""
    zones = region_planes(("eyelid_left",), ("eyelid_right",))
    return zones / zones.sum((1, 2), keepdim=True)


def face_zone() -> Tensor:
    """(1, h, w) weights of the skin of the face on the context's chart, of sum 1."""
    zone = region_planes(("forehead", "nose", "cheek_left", "cheek_right", "chin"))
    return zone / zone.sum()


def exposed(texture: Tensor, albedo: Tensor, zone: Tensor, here: Tensor, generator: torch.Generator) -> Tensor:
    """sRGB-coded textures (N, 3, h, w), some of them as bright as a photo would show them, whatever the skin.

    Args:
        texture: sRGB-coded in [0, 1].
        albedo: (N, 3, h, w) likewise.
        zone: of :func:`face_zone`.
        here: (N,) 1 for charts that are exposed anew, 0 for those that stay.
        generator: the light of each chart.
    """
    light = torch.einsum("nchw,ehw->ne", log_light(texture, albedo).clamp(max=BRIGHTEST).exp(), zone) / 3.0
    wanted = EXPOSED[0] + EXPOSED[1] * torch.randn(len(texture), 1, generator=generator)
    factor = torch.exp(wanted - light.clamp(min=DARKEST).log())[..., None, None]
    return torch.where(here.view(-1, 1, 1, 1) > 0, srgb((linear(texture) * factor).clamp(0.0, 1.0)), texture)


def eye_light(light: Tensor, zones: Tensor, whites: Tensor, known: Tensor, generator: torch.Generator) -> Tensor:
    """(N, 4) channels ``EYES`` as a photo would give them: the light of the lids, what reaches the whites, and errors.

    Args:
        light: (N, 3, h, w) log light of the skin.
        zones: of :func:`lid_zones`.
        whites: (N, 2, 3) log light on the whites less that on the lids (``models.lightstage.light.sclera``); NaN for a
            closed eye.
        known: (N,) 1 where the whites are seen if they are open; the light is 0 elsewhere.
        generator: which eye is seen, and errors.
    """
    n = len(light)
    open_ = whites.isfinite().all(2).float()
    lids = torch.einsum("nchw,ehw->nec", light.clamp(max=BRIGHTEST).exp(), zones).clamp(min=DARKEST).log()
    flatter = uniform(generator, *FLATTER, n, 1, 1)
    each = lids + LESS + FAITH * torch.nan_to_num(whites + flatter * (FLAT - whites))
    share = torch.tensor([0.0, 0.5, 0.5, 1.0])[torch.randint(4, (n,), generator=generator)]
    weight = torch.stack([share, 1.0 - share], 1) * open_
    weight = torch.where(weight.sum(1, keepdim=True) > 0.0, weight, open_)  # the only open eye is seen
    weight = weight / weight.sum(1, keepdim=True).clamp(min=1e-6)
    error = ERROR * torch.randn(n, 1, generator=generator)
    wrong = (torch.rand(n, 1, generator=generator) < MISTAKEN).float()
    error = error + wrong * (MISTAKE[0] + MISTAKE[1] * torch.randn(n, 1, generator=generator))
    tint = TINT * torch.randn(n, 3, generator=generator)
    seen = (each * weight[..., None]).sum(1) + error + tint
    seen = seen - (seen.mean(1, keepdim=True) - math.log(BRIGHTEST_TOLD)).clamp(min=0.0)  # overexposed
    known = (known * open_.amax(1))[:, None]
    return torch.cat([seen * known, known], 1)
