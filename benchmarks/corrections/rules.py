"""What is on trial: rules that can be taken out, and the way to make an avatar without some of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from service.archive.avatar import Avatar
from service.options import Options
from service.pipeline import make_avatar
from service.stage_cache import Stages

SIZE = (768, 512)
"""Maps of the trial: a rule decides on the light of 192 x 128 cells or on textures of 576 x 384, whatever the map."""
FIRST_STAGE = {"texture": "texture", "light": "diffuse_albedo", "albedo": "diffuse_albedo", "relief": "diffuse_albedo"}
"""By what a rule alters, the first stage of the pipeline that has to be made anew without it."""
RELIEF = "relief"


class Rule(Protocol):
    """One correction; ``service.reflectance.albedo.diffuse_albedo.Correction``."""

    @property
    def name(self) -> str:
        """As ``--without`` takes it."""

    @property
    def mends(self) -> str:
        """A sentence."""

    @property
    def source(self) -> str:
        """What it alters, out of ``FIRST_STAGE``."""

    @property
    def cases(self) -> Sequence[str]:
        """Groups of ``benchmarks.corrections.photos.GROUPS`` on which it has to gain; none means all photos."""


class Rules(Protocol):
    """All rules, and the product with a switch for each."""

    @property
    def registry(self) -> Sequence[Rule]:
        """In the order in which they run."""

    def make(self, data: bytes, without: Sequence[str], stages: Stages, relief: bool = False) -> Avatar:
        """The avatar of a photo with the rules of these names turned off. Raises as ``make_avatar``.

        It has the diffuse albedo, and with ``relief`` the specular normals.
        """

    def changed(self, avatar: Avatar) -> dict[str, int]:
        """Texels that each rule which ran changed by more than 1/255; rules may be missing."""


@dataclass(frozen=True)
class Product:
    """The rules of the program, turned off as a caller would."""

    @property
    def registry(self) -> Sequence[Rule]:
        """The program's."""
        from service.reflectance.albedo.diffuse_albedo import REGISTRY

        return tuple(REGISTRY)

    def make(self, data: bytes, without: Sequence[str], stages: Stages, relief: bool = False) -> Avatar:
        """By ``make_avatar``."""
        maps = ("diffuse_albedo", "specular_normal") if relief else ("diffuse_albedo",)
        switches: dict[str, Any] = {"without": tuple(without)} if without else {}
        options = Options(maps=maps, quality="draft", size=SIZE, face="largest", **switches)
        return make_avatar(data, options, stages=stages)

    def changed(self, avatar: Avatar) -> dict[str, int]:
        """As the manifest has it."""
        told = getattr(avatar.reflectance, "corrections", ())
        return {one.name: int(one.changed) for one in told}
