"""Every network that ships, in one table: what it does, who runs it, and the planes that it takes and gives.

Whatever needs the name of a network or of a plane asks here. A new network is a row here, its class in
``models.networks``, and the code of its stage. A file also says itself which planes it takes, in which order, and how
far it looks (``service.runtime.networks.Description``): that holds while it runs, so that other networks of the same
role take its place.

Planes are maps of the head's chart with values in about [-1, 1].
"""

from __future__ import annotations

from dataclasses import dataclass

TEXTURE = ("texture_r", "texture_g", "texture_b")
"""Skin in the photo's light, sRGB-coded."""

ALBEDO = ("albedo_r", "albedo_g", "albedo_b")
"""Diffuse albedo, sRGB-coded."""

PARTS = ("parts_r", "parts_g", "parts_b")
"""Albedo of eyes, teeth and all else that is no skin, sRGB-coded."""

CONTEXT = ("context_0", "context_1", "context_2")
"""Natural logarithm of the light in red, green and blue, as the whole chart tells it."""

SHADED_GREY = "shaded_grey"
"""Grey texture divided by its smooth light: fine shading stays."""

FINE_ALBEDO, FINE_SHADED = "albedo_fine", "shaded_fine"
FINE = {FINE_ALBEDO: "albedo_grey", FINE_SHADED: SHADED_GREY}
"""``FINE_GAIN`` times what a grey differs by from its mean over ``FINE_WINDOW`` texels around, and that grey."""

FINE_WINDOW = 17
"""Texels (odd): about 1.2 mm."""

FINE_GAIN = 10.0
"""Pores are a few codes deep; so enlarged they are as large as other planes."""

PACKED = "/"
"""Joins the names of up to four planes that lie in one, each at half its size: a square of 2 x 2 texels has one of
each, row by row. So come planes that are smooth: less is read, and less computed with."""

DRAWN_DETAIL = "drawn_detail"
"""How far fine detail was drawn by super-resolution: -1 where all of it is the photo's, 1 where all is drawn."""

DEPTH, MASK = ("depth",), ("mask",)
OBJECT, TANGENT, POSITION = (
    tuple(f"{name}_{axis}" for axis in "xyz") for name in ("normal_object", "normal_tangent", "position")
)

GEOMETRY = (*DEPTH, *OBJECT, *TANGENT, *POSITION, *MASK)
"""Planes of the head's shape: ``service.reflectance.subject.Subject.geometry``."""

EYES = ("eye_light_r", "eye_light_g", "eye_light_b", "eye_light_known")
"""Log radiance of a white surface in place of the sclera, the same at all texels; 1 where it was measured, else 0."""

LIT = "lit_skin"
"""1 where the texture shows skin in the photo's light, 0 on hair, eyes and inpainted texels."""

INPAINTED = "inpainted_skin"
"""1 on inpainted skin."""

SHOWN = "shown_beard"
"""1 where the photo shows the head's own surface and beards grow, lit skin or not."""

COVERED = "covered_skin"
"""1 where brows, lashes, hair or glasses cover the skin, and on the scalp."""

LIDS = "lids"
"""1 on the skin round the eyes."""

CLUES = (LIT, INPAINTED, *EYES, SHOWN, COVERED, LIDS)
"""Planes of ``service.reflectance.subject.Subject.clues``: where light and relief can be read from the texture."""

NOISE = "noise_"
"""Prefix of planes of normally distributed noise, from which super-resolution draws detail."""


@dataclass(frozen=True)
class RegisteredNetwork:
    """One network.

    Attributes:
        name: in models.json; its file is NAME.onnx.
        role: what it does, for manifests and ``/v1/models``.
        stage: of the pipeline or of the reflectance that runs it.
        channels: names of the planes that it takes; those of noise and features are left out, as they depend on its
            size. Empty for networks that see photos.
        outputs: names of the planes that it gives.
    """

    name: str
    role: str
    stage: str
    channels: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


REGISTRY = (
    RegisteredNetwork("face_detector", "finds faces", "detect"),
    RegisteredNetwork("face_mesh", "468 landmarks", "detect"),
    RegisteredNetwork("reader", "place of the head, normal and part of every pixel", "read"),
    RegisteredNetwork("lids", "edges of the lids", "read"),
    RegisteredNetwork("lips", "edges of the lips", "read"),
    RegisteredNetwork("face_landmarker", "478 points for the expression", "read"),
    RegisteredNetwork("face_blendshapes", "expression scores", "read"),
    RegisteredNetwork("segmenter", "tells hair, skin, clothes, things and background apart", "read"),
    RegisteredNetwork("hair", "tells where hair is, which way it runs and what kind it is", "read"),
    RegisteredNetwork("face_identity", "compares the result with the photo", "compare"),
    RegisteredNetwork(
        "zeta_body", "enlarges the texture", "super_resolution", (*TEXTURE, *POSITION, *MASK), ("features",)
    ),
    RegisteredNetwork("zeta_tail", "enlarges the texture", "super_resolution", (), TEXTURE),
    RegisteredNetwork(
        "delta_context", "sees the light of the whole texture", "diffuse_albedo",
        (*TEXTURE, *EYES, *DEPTH, *OBJECT, *POSITION, LIT), CONTEXT,
    ),
    RegisteredNetwork(
        "delta", "texture to diffuse albedo", "diffuse_albedo",
        (*TEXTURE, *CONTEXT, *DEPTH, *OBJECT, *POSITION, *MASK), ALBEDO,
    ),
    RegisteredNetwork(
        "psi", "diffuse to specular albedo", "specular_albedo", (FINE_ALBEDO, *ALBEDO, *POSITION), ("specular_albedo",)
    ),
    RegisteredNetwork(
        "rho", "diffuse albedo to specular normals", "specular_normal",
        (FINE_SHADED, SHADED_GREY, *TANGENT, *POSITION, DRAWN_DETAIL), ("specular_slope_x", "specular_slope_y"),
    ),
    RegisteredNetwork(
        "sigma", "diffuse albedo to diffuse normals", "diffuse_normal",
        (FINE_SHADED, SHADED_GREY, *OBJECT, *POSITION, DRAWN_DETAIL), ("diffuse_slope_x", "diffuse_slope_y"),
    ),
)  # fmt: skip
"""In the order in which they run; Greek letters as in AvatarMe, figure 3."""

ROLES = {one.name: one.role for one in REGISTRY}
"""What each network does, by name."""


def networks_of(*stages: str) -> tuple[str, ...]:
    """Names of the networks that some stages run, in order; none where a stage needs none."""
    return tuple(one.name for one in REGISTRY if one.stage in stages)
