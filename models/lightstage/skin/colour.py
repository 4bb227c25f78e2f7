"""Diffuse albedo: pigment maps through the colour table, cavities, hair and make-up on top."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from models.lightstage.skin.chromophores import ColourTable
from models.lightstage.skin.drawn import Drawn
from models.lightstage.skin.relief import fade
from models.lightstage.skin.stack import GaussianStack
from models.lightstage.skin.subject import Subject
from models.lightstage.skin.volumes import Placement, Volume, noise

CAVITY_COLOUR = (0.6, 0.85, 1.0)
_DARKEST = 0.75
"""Melanosome fraction beyond which the two-layer model turns bluish."""
_SEBUM = (0.62, 0.55, 0.38)
_WHITE_HAIR = (0.5, 0.48, 0.45)


@dataclass(frozen=True)
class Paint:
    """Noise of the pigments, one placement each."""

    mottle: Volume
    grain: Volume
    places: dict[str, Placement]

    @classmethod
    def of(cls, subject: Subject, device: torch.device | str = "cpu") -> Paint:
        """Place the volumes."""
        places = {name: Placement.sample(subject.seed, f"paint {name}") for name in ("mottle", "grain", "streaks")}
        # Hair of the scalp runs down and back from the crown.
        places["streaks"] = places["streaks"].stretched(np.array([0.0, 0.85, -0.5]), 14.0)
        return cls(noise(4, 0.95).to(device), noise(3, 0.8).to(device), places)

    def noises(self, position: Tensor, dense: bool) -> tuple[Tensor, Tensor]:
        """(4, h, w) each: mottling of 0.8 to 6.4 mm and grain of 0.14 to 0.56 mm, variance 1."""
        return self.mottle.coarse(position, 0.8, self.places["mottle"], dense), self.grain(
            position, 0.14, self.places["grain"]
        )


def diffuse_albedo(
    subject: Subject,
    colours: ColourTable,
    paint: Paint,
    drawn: Drawn,
    cavity: GaussianStack,
    ppm: Tensor,
    finest: float,
) -> Tensor:
    """(3, h, w) linear sRGB in [0, 1] (method 1.1 to 1.5).

    Args:
        subject: the person.
        colours: the person's colour table.
        paint: the person's noise.
        drawn: layers of the window.
        cavity: blurs of the height.
        ppm: (h, w) texels per mm.
        finest: ``ppm`` is cut to this, the same for all windows of a chart size.
    """
    mottle, grain = drawn.mottle, drawn.grain
    grain = grain * fade(drawn.texel_mm, 0.2)
    hollow = (cavity.at(ppm, [(0.4, 1.0)], finest)[0] - drawn.height) / _cavity_depth(subject)
    hole, ridge = hollow.clamp(0.0, 1.0), (-hollow).clamp(0.0, 1.0)
    lips = _lips(subject, drawn, mottle)
    fm, fb, thickness = _pigment(subject, drawn, mottle, grain, hole, ridge, lips)
    colour = colours(fm, fb, thickness, drawn.base["oxygenation"])
    # Carotene and bilirubin: a yellow that the two chromophores do not have.
    yellow = (subject.regions.yellow + 0.3 * mottle[3] + 0.12 * grain[3])[None]
    colour = colour * (1.0 - yellow * (1.0 - _tint(colour, (1.0, 0.99, 0.93))))
    dim = subject.coupling.cavity_darkening * hole
    colour = colour * (1.0 - dim * _tint(colour, CAVITY_COLOUR))
    colour = colour * (1.0 + subject.coupling.free_noise * (0.8 * grain[2] + 0.5 * mottle[3])).clamp(0.5, 1.5)
    colour = colour * (1.0 - drawn.lines.blue * (1.0 - _tint(colour, (0.86, 0.94, 1.0))))
    colour = torch.lerp(colour, _tint(colour, _SEBUM).expand_as(colour), 0.55 * drawn.spots.pale)
    colour = _openings(subject, drawn, colour, mottle)
    colour = _make_up(subject, drawn, colour, lips, mottle)
    return _hairs(subject, paint, drawn, colour, mottle, grain).clamp(0.0, 1.0)


def _tint(like: Tensor, colour: tuple[float, float, float]) -> Tensor:
    return torch.tensor(colour, dtype=like.dtype, device=like.device).view(3, 1, 1)


def _cavity_depth(subject: Subject) -> float:
    """Depth in mm at which a cavity is as dark as it gets; deeper on rough skin, where everything would be dark."""
    s = subject.surface
    return 0.04 * max(1.0, (s.primary_depth + s.secondary_depth + 0.04 * s.pore_depth) / 0.065)


def _lips(subject: Subject, drawn: Drawn, mottle: Tensor) -> Tensor:
    """(h, w) vermilion with a border that wanders a little."""
    width = subject.regions.lip_border_mm
    return (0.5 - (drawn.base["lip"] + 0.16 * mottle[2]) / width).clamp(0.0, 1.0)


def _pigment(
    subject: Subject, drawn: Drawn, mottle: Tensor, grain: Tensor, hole: Tensor, ridge: Tensor, lips: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """(h, w) melanin and blood fractions and thickness in cm."""
    regions, coupling = subject.regions, subject.coupling
    evenness = 1.0 - 0.6 * subject.make_up.foundation * drawn.base["face"].clamp(0.0, 1.0)
    brown = regions.mottle_melanin * (0.6 * mottle[0]) + regions.grain_melanin * grain[0]
    red = regions.mottle_blood * mottle[1] + 0.3 * regions.mottle_blood * grain[1]
    brown, red = brown * evenness, red * evenness + drawn.spots.blood * evenness + drawn.lines.blood * evenness
    fm = subject.tone.melanin * torch.exp(drawn.base["melanin"] + brown + drawn.lines.melanin)
    fb = torch.exp(drawn.base["blood"] + red) * (1.0 - coupling.ridge_blood * ridge)
    fb = fb * (1.0 + coupling.pore_blood * drawn.pits.cover)
    lip_m = regions.lip_melanin * torch.exp(0.15 * mottle[0] + 0.08 * grain[0] + 0.1 * hole)
    lip_b = regions.lip_blood * torch.exp(0.1 * mottle[1] + 0.08 * grain[1] + 0.15 * hole - 0.15 * ridge)
    fm = fm * (1.0 - lips + lips * lip_m)
    fb = torch.exp(torch.lerp(fb.clamp(min=1e-5).log(), lip_b.log(), lips))
    fm = fm * (1.0 + coupling.cavity_melanin * hole) + drawn.spots.melanin * evenness * (
        1.0 + 0.22 * mottle[2] + 0.2 * grain[3]
    ).clamp(0.2, 1.8)
    fm = fm.clamp(max=_DARKEST)
    return fm, fb, drawn.base["thickness"] * (1.0 - 0.6 * lips)


def _openings(subject: Subject, drawn: Drawn, colour: Tensor, mottle: Tensor) -> Tensor:
    """Nostrils, the line between the lips, and the rim of the lids with its lashes."""
    colour = colour * (1.0 - drawn.base["dark"].clamp(0.0, 1.0) * (1.0 - _tint(colour, (0.16, 0.07, 0.06))))
    eye = drawn.base["eye"].clamp(min=0.0)
    wet = torch.exp(-((eye / 1.1) ** 2))
    colour = colour * (1.0 - wet * (1.0 - _tint(colour, (0.9, 0.68, 0.66))))
    lash = (
        subject.hair.lash_strength * torch.exp(-(((eye - 1.0) / 0.75) ** 2)) * (0.8 + 0.25 * mottle[3]).clamp(0.0, 1.0)
    )
    return colour * (1.0 - 0.75 * lash)


def _make_up(subject: Subject, drawn: Drawn, colour: Tensor, lips: Tensor, mottle: Tensor) -> Tensor:
    """Lipstick, blush, eye shadow and eye liner as veils."""
    m = subject.make_up
    uneven = (1.0 + 0.06 * mottle[2]).clamp(0.6, 1.4)
    if m.lipstick > 0:
        stick = _tint(colour, (m.lipstick_red, m.lipstick_green, m.lipstick_blue))
        colour = torch.lerp(colour, stick.expand_as(colour), (m.lipstick * lips * uneven).clamp(0.0, 1.0))
    if m.blush > 0:
        veil = (0.35 * m.blush * drawn.base["blush"].clamp(0.0, 1.0) * uneven).clamp(0.0, 1.0)
        colour = torch.lerp(colour, colour * _tint(colour, (1.0, 0.45, 0.5)), veil)
    if m.eyeshadow > 0:
        shade = _tint(colour, (m.eyeshadow_red, m.eyeshadow_green, m.eyeshadow_blue))
        veil = (m.eyeshadow * drawn.base["eyeshadow"].clamp(0.0, 1.0) * uneven).clamp(0.0, 1.0)
        colour = torch.lerp(colour, shade.expand_as(colour), veil)
    if m.eyeliner > 0:
        eye = drawn.base["eye"].clamp(min=0.0)
        line = ((1.9 + 0.2 * mottle[0] - eye) / 0.5).clamp(0.0, 1.0)
        colour = colour * (1.0 - 0.93 * m.eyeliner * line)
    return colour


def _hairs(subject: Subject, paint: Paint, drawn: Drawn, colour: Tensor, mottle: Tensor, grain: Tensor) -> Tensor:
    """Shadow of the beard under the skin, scalp, then strands."""
    hair = subject.hair
    own = _tint(colour, (hair.colour_red, hair.colour_green, hair.colour_blue))
    veil = drawn.base["shadow"].clamp(0.0, 1.0) * (1.0 + 0.22 * mottle[3] + 0.35 * grain[3]).clamp(0.0, 2.0)
    colour = colour * (1.0 - veil * (1.0 - _tint(colour, (0.0, 0.03, 0.07))))
    if hair.scalp_cover > 0:
        streak = paint.mottle(drawn.position, 0.09, paint.places["streaks"])
        mask = drawn.base["scalp"].clamp(0.0, 1.0) * hair.scalp_cover
        cover = ((2.0 * mask - 0.75 + 0.22 * streak[0] + 0.1 * mottle[1]) / 0.5).clamp(0.0, 1.0) * (mask * 6.0).clamp(
            max=1.0
        )
        white = ((streak[2] - 1.3 + 3.0 * hair.grey) / 0.6).clamp(0.0, 1.0) * hair.grey
        tone = torch.lerp(own.expand_as(colour), _tint(colour, _WHITE_HAIR).expand_as(colour), white)
        tone = tone * (1.0 + 0.3 * streak[1]).clamp(0.3, 2.0)
        colour = torch.lerp(colour, tone, 0.94 * cover)
    strands = drawn.hair
    colour = colour * (1.0 - 0.3 * strands.shadow.clamp(0.0, 1.0))
    colour = torch.lerp(colour, own.expand_as(colour), strands.dark.clamp(0.0, 1.0))
    return torch.lerp(colour, _tint(colour, _WHITE_HAIR).expand_as(colour), 0.6 * strands.grey.clamp(0.0, 1.0))
