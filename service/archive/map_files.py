"""Where the maps of a material lie in the archive, as seen from its meshes."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from service.materials.material import Map, OwnMap


@dataclass(frozen=True)
class MapFiles:
    """Relative paths of maps.

    Attributes:
        roles: maps of the chart that the archive has.
        folder: from the mesh to the maps.
        substitutes: role -> role of the chart that stands in where the first is not there.
    """

    roles: Collection[str]
    folder: str = "../maps"
    substitutes: tuple[tuple[str, str], ...] = (("diffuse_albedo", "texture"),)

    def path(self, one: Map | None) -> str | None:
        """Path of a map; None where there is none."""
        if one is None:
            return None
        if isinstance(one, OwnMap):
            return f"{self.folder}/parts/{one.name}.png"
        for role in (one.role, dict(self.substitutes).get(one.role)):
            if role in self.roles:
                return f"{self.folder}/{role}.png"
        return None
