"""Microrelief: the net of fine furrows, the plateaus between them, bumps, and the furrows of the lips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from models.lightstage.skin.subject import Subject
from models.lightstage.skin.volumes import Placement, Volume, furrows, noise

_ACROSS = np.array([1.0, 0.0, 0.0])
_CREASE = np.array([0.95, 0.2, 0.2])
_OBLIQUE = np.array([0.62, 0.78, 0.0])


@dataclass(frozen=True)
class Relief:
    """Volumes and their places for one subject."""

    subject: Subject
    net: Volume
    fine: Volume
    broad: Volume
    places: dict[str, Placement]

    @classmethod
    def of(cls, subject: Subject, device: torch.device | str = "cpu") -> Relief:
        """Place the volumes."""
        seed, stretch = subject.seed, subject.surface.anisotropy
        places = {name: Placement.sample(seed, f"relief {name}") for name in ("secondary", "grain", "bumps", "lips")}
        # Skin lines run across on the forehead and round the eyes, obliquely down the cheeks, mirrored left to right.
        first = Placement.sample(seed, "relief primary")
        places["across"] = first.stretched(_ACROSS, stretch)
        places["left"] = first.stretched(_OBLIQUE * [-1.0, 1.0, 1.0], stretch)
        places["right"] = first.stretched(_OBLIQUE, stretch)
        places["crease"] = Placement.sample(seed, "relief crease").stretched(_CREASE, 1.2 + 1.0 * stretch)
        lips = np.diag([1.0, 0.09, 0.2])
        places["lip_lines"] = Placement(places["lips"].rotation @ lips, places["lips"].shift)
        return cls(subject, furrows().to(device), noise(2).to(device), noise(3).to(device), places)

    def height(
        self, position: Tensor, texel_mm: Tensor, strength: Tensor, across: Tensor, lips: Tensor, dense: bool
    ) -> Tensor:
        """(h, w) mm.

        Args:
            position: (3, h, w) template mm.
            texel_mm: (h, w) size of a texel; layers finer than two texels fade out.
            strength: (h, w) regional factor of the net and grain.
            across: (h, w) in [0, 1], 1 where skin lines run across the face.
            lips: (h, w) in [0, 1].
            dense: draw bumps on a grid of half the size.
        """
        s, places = self.subject.surface, self.places
        bumps = self.broad.coarse(position, 0.9, places["bumps"], dense)
        if (
            float(fade(texel_mm, 0.5 * max(s.primary_spacing, s.lip_spacing, s.crease_spacing)).max()) == 0.0
        ):  # from afar only the bumps are left
            return s.bump_rms * (0.4 + 0.6 * strength.clamp(0.0, 1.0)) * bumps[0] * (1.0 - 0.7 * lips)
        grain = self.fine(position, 0.16, places["grain"])
        # The net is bent a little, or its straight edges give the Voronoi cells away.
        bent = position + 0.16 * s.primary_spacing * bumps[1:4]
        side = torch.sigmoid(position[0] / 6.0)
        primary = self._net(bent, s.primary_spacing, "across", across)
        primary = primary + self._net(bent, s.primary_spacing, "left", (1.0 - across) * side)
        primary = primary + self._net(bent, s.primary_spacing, "right", (1.0 - across) * (1.0 - side))
        secondary = self.net(
            position + 0.05 * grain[1:4] * s.secondary_spacing, s.secondary_spacing, places["secondary"]
        )
        crease = self.net.coarse(bent + 0.25 * bumps[1:4], s.crease_spacing, places["crease"], dense)
        visible = fade(texel_mm, 0.5 * s.secondary_spacing)
        depth = 1.0 + 0.35 * bumps[0]
        height = -s.primary_depth * depth * primary[0] + s.dome_depth * (primary[1] - 0.5 + 0.35 * primary[2])
        height = height * fade(texel_mm, 0.5 * s.primary_spacing)
        height = height - s.crease_depth * (0.6 + 0.4 * bumps[3]) * fade(texel_mm, 0.5 * s.crease_spacing) * (
            crease[0] - 0.35 * crease[1]
        )
        height = height + visible * (0.35 * s.dome_depth * (secondary[1] - 0.5) - s.secondary_depth * secondary[0])
        height = height + fade(texel_mm, 0.22) * s.grain_rms * grain[0]
        height = strength * height + s.bump_rms * (0.4 + 0.6 * strength.clamp(0.0, 1.0)) * bumps[0]
        height = height * (1.0 - 0.7 * lips)
        return height + lips * self._lip_lines(position, texel_mm, bumps) if float(lips.max()) > 0.0 else height

    def _net(self, position: Tensor, spacing: float, place: str, weight: Tensor) -> Tensor:
        if float(weight.max()) < 1e-3:
            return torch.zeros((4, *weight.shape), device=weight.device)
        weight = torch.where(weight < 1e-3, 0.0, weight)
        return weight * self.net(position, spacing, self.places[place])

    def _lip_lines(self, position: Tensor, texel_mm: Tensor, bumps: Tensor) -> Tensor:
        s = self.subject.surface
        bent = position + 0.1 * s.lip_spacing * bumps[1:4]
        lines = self.net(bent, s.lip_spacing * 1.3, self.places["lip_lines"])
        # Deep and shallow furrows come in groups, and finer creases lie between them.
        finer = self.net(bent, s.lip_spacing * 0.6, self.places["lip_lines"])
        group = (0.55 + 0.3 * bumps[2] + 0.25 * bumps[3]).clamp(0.1, 1.3)
        shape = group * (0.6 * (lines[1] - 0.6) - 0.8 * lines[0] + 0.1 * lines[2]) + 0.25 * (0.4 * finer[1] - finer[0])
        return fade(texel_mm, 0.5 * s.lip_spacing) * s.lip_depth * shape


def fade(texel_mm: Tensor, wavelength_mm: float) -> Tensor:
    """1 where a wavelength has at least 3 texels, 0 below 1.5."""
    return ((wavelength_mm / texel_mm - 1.5) / 1.5).clamp(0.0, 1.0)
