"""Quality levels: named points between fast and fine.

``docs/reflectance.md`` says what each costs and gains.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Size = tuple[int, int]

TEXTURE_SIZE: Size = (576, 384)
"""Texture of the method (AvatarMe, section 4.1): what the fit can tell, and what the networks enlarge."""

FULL_SIZE: Size = (6144, 4096)
DRAFT_SIZE: Size = (1536, 1024)

QualityName = Literal["draft", "standard", "high", "reference"]


@dataclass(frozen=True)
class Level:
    """What a level means.

    Attributes:
        size: (width, height) of the reflectance maps.
        super_resolution: whether the texture is enlarged by a network; else it is resampled.
        normal_bits: bits per component of normal maps.
        fine_mesh: whether the subdivided, displaced mesh is made with the displacement map.
        precision: of the networks: "auto" is the fastest that the processor has.
        unseen_halved: whether the light on skin that no photo shows is found at half the size.
        part_texture_step: texels of a side that textures of hair, eyes and the like, in full 512 to 1024, put into one.
        strands: of a full head of hair.
    """

    size: Size
    super_resolution: bool
    normal_bits: Literal[8, 16]
    fine_mesh: bool
    precision: Literal["auto", "fp32"]
    strands: int
    unseen_halved: bool
    part_texture_step: int = 1


LEVELS: dict[str, Level] = {
    "draft": Level(DRAFT_SIZE, False, 8, False, "auto", 5_000, False, part_texture_step=2),
    "standard": Level(FULL_SIZE, True, 8, False, "auto", 10_000, True),
    "high": Level(FULL_SIZE, True, 16, True, "auto", 20_000, True),
    "reference": Level(FULL_SIZE, True, 16, True, "fp32", 20_000, False),
}
"""From fast to fine."""

SMALLEST_ENLARGED = 2 * DRAFT_SIZE[0]
"""Width from which on enlarging pays: smaller maps would throw away what the network adds."""
