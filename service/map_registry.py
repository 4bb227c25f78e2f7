"""Every map that an avatar may have, in one table: what its values are, how they are coded, and what makes it.

Whatever lists maps asks here: options, plan and archive. A new map is a row here and the code that makes it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class RegisteredMap:
    """One map of (H, W) texels on the head's chart.

    Attributes:
        name: in options and manifest; the archive's file is maps/NAME.png.
        made_by: "networks", by a stage of the reflectance; "surface", from these and the mesh; "photo", by the texture
            stage.
        kind: what its values are: "colour" in [0, 1], "normal" components of unit vectors, "height" and "length" in mm,
            "count" of photos.
        colour_space: "srgb", "linear" or "data" (vectors).
        meaning: of a value, for the manifest.
        needs: stage of the reflectance whose result it is, or is made from; None: no stage of it.
        bits: of a component; None: as many as the options request of normals.
        framed: whether the options choose the frame of its normals; others are in object space.
        beside: the map with which it is requested; None: it is requested by its own name.
    """

    name: str
    made_by: Literal["networks", "surface", "photo"]
    kind: Literal["colour", "normal", "height", "length", "count"]
    colour_space: Literal["srgb", "linear", "data"]
    meaning: str
    needs: str | None = None
    bits: Literal[8, 16] | None = 8
    framed: bool = False
    beside: str | None = None

    @property
    def path(self) -> str:
        """Name in the archive."""
        return f"maps/{self.name}.png"


_FRAMES = "tangent: x along u, y up (OpenGL, glTF), z out; object: as for shape_normal"

WRINKLE = "wrinkle_"
"""Prefix of the names of maps of folds; the rest is the name of the fold, of
``service.reflectance.relief.folds.GROUPS``."""

SEEN = 128
"""Lowest confidence of a texel seen in the photo; 255 where it is seen frontally, and the photo alone decides."""

MIRRORED = 1
"""Lowest confidence of a texel mirrored from the other side of the face, up to ``SEEN`` - 1; 0 is inpainted."""

MAPS = (
    RegisteredMap(
        "diffuse_albedo", "networks", "colour", "srgb",
        "share of light that comes back diffused, sRGB coded, in [0, 1]", "diffuse_albedo",
    ),
    RegisteredMap(
        "specular_albedo", "networks", "colour", "linear",
        "share s of light that is mirrored: F0 = 0.04 s, as in glTF", "specular_albedo",
    ),
    RegisteredMap(
        "diffuse_normal", "networks", "normal", "data", f"unit normal for diffused light. {_FRAMES}",
        "diffuse_normal", bits=None, framed=True,
    ),
    RegisteredMap(
        "specular_normal", "networks", "normal", "data", f"unit normal for mirrored light. {_FRAMES}",
        "specular_normal", bits=None, framed=True,
    ),
    RegisteredMap(
        "displacement", "networks", "height", "linear",
        "millimetres along the normal of mesh/head.obj, outwards above 0", "displacement", bits=16,
    ),
    *(
        RegisteredMap(
            WRINKLE + fold, "networks", "normal", "data",
            f"unit normal of folds that the photo's expression makes and the other maps are without. {_FRAMES}",
            "specular_normal", bits=None, framed=True, beside="specular_normal",
        )
        for fold in ("brows", "eyes", "smile", "mouth")
    ),
    RegisteredMap(
        "roughness", "surface", "colour", "linear",
        "square root of GGX alpha, of one lobe for both of the skin's, in [0, 1]",
    ),
    RegisteredMap(
        "cavity", "surface", "colour", "linear", "share of the sky that the relief leaves open, in [0, 1]",
        "displacement",
    ),
    RegisteredMap(
        "thickness", "surface", "length", "linear",
        "millimetres of flesh under the skin; the last code is that or more",
    ),
    RegisteredMap(
        "albedo_error", "surface", "colour", "linear",
        "error of the natural logarithm of the diffuse albedo's luminance that two texels in three stay within; "
        "1 is that or more, and all that is no skin", "diffuse_albedo",
    ),
    RegisteredMap("texture", "photo", "colour", "srgb", "colour in the photo's light, sRGB coded, in [0, 1]"),
    RegisteredMap(
        "confidence", "photo", "colour", "linear",
        f"codes 255 to {SEEN}: seen in the photo, by weight; {SEEN - 1} to {MIRRORED}: mirrored from the other side; "
        f"0: made up",
    ),
    RegisteredMap(
        "seen_by", "photo", "count", "linear", "of several photos so many show the texel", beside="confidence",
    ),
    RegisteredMap(
        "shape_normal", "photo", "normal", "data",
        "unit normal of mesh/head.obj: R = +X, the subject's left; G = +Y, up; B = +Z, out of the face", bits=None,
    ),
)  # fmt: skip
"""All maps, in the order of the archive."""

MAP_NAMES = tuple(one.name for one in MAPS if one.beside is None)
"""Maps that can be requested, in the order of the archive."""


def maps_made_by(maker: Literal["networks", "surface", "photo"]) -> tuple[str, ...]:
    """Names of the maps that can be requested and that one part of the program makes."""
    return tuple(one.name for one in MAPS if one.made_by == maker and one.name in MAP_NAMES)
