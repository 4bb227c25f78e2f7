"""What the simulation of light reads of a skin."""

from __future__ import annotations

from typing import Protocol

from torch import Tensor


class LitMaps(Protocol):
    """What ``bake`` reads of ``SkinMaps``; (C, h, w) tensors of one floating type."""

    @property
    def diffuse_albedo(self) -> Tensor: ...  # noqa: D102
    @property
    def specular_albedo(self) -> Tensor: ...  # noqa: D102
    @property
    def roughness(self) -> Tensor: ...  # noqa: D102
    @property
    def specular_normal(self) -> Tensor: ...  # noqa: D102
    @property
    def diffuse_normal(self) -> Tensor: ...  # noqa: D102
    @property
    def height_mm(self) -> Tensor: ...  # noqa: D102
    @property
    def mask(self) -> Tensor: ...  # noqa: D102
