"""Materials of the USD file: UsdPreviewSurface for every tool, and MaterialX for those that have it.

UsdPreviewSurface's metallic workflow has no factor of F0, and its specular workflow is ignored by Blender, which takes
``specularColor`` as a tint of the F0 that ``ior`` gives. So ``ior`` holds the material's F0 without the map, which is
what a reader of the specification shows, and ``specularColor`` the map as a multiple of it. MaterialX has the map as it
is.

Normals and displacement are the same relief, so the variant set ``relief`` of each material with both takes one:
``normal`` (the default), or ``displacement`` for renderers that subdivide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from service.archive.images import NORMAL_SCALE, NORMAL_ZERO
from service.archive.map_files import MapFiles
from service.archive.mtlx import network, shaders
from service.archive.usd_text import Asset, Shader, Value, Wire
from service.materials.material import Material
from service.reflectance.reflectance_maps import MID, SCALE_MM

SCOPE = "/Head/Materials"

NORMAL_FACTORS = (255 / NORMAL_SCALE, -NORMAL_ZERO / NORMAL_SCALE)
"""Scale and bias from codes in [0, 1] to components."""
HEIGHT_FACTORS = (65535 * SCALE_MM * 1e-3, -MID * SCALE_MM * 1e-3)
"""Scale and bias from codes in [0, 1] to metres."""


_VARIANT_SET = """ (
            variants = {
                string relief = "normal"
            }
            prepend variantSets = "relief"
        )"""


def material_text(material: Material, files: MapFiles) -> str:
    """One material, as a prim of the scope ``Materials``."""
    path, made = f"{SCOPE}/{material.name}", _Network(material, files)
    relief = made.relief()
    nodes = [made.surface(relief if len(relief) == 1 else {}), *made.textures(), *shaders(network(material, files))]
    variants = _VARIANT_SET if len(relief) == 2 else ""
    lines = [
        f'        def Material "{material.name}"{variants}\n        {{\n',
        f"            token outputs:surface.connect = <{path}/Surface.outputs:surface>\n",
        f"            token outputs:mtlx:surface.connect = <{path}/Standard.outputs:out>\n",
        *(shader.text(path, "            ") for shader in nodes),
    ]
    if "displacement" in relief and len(relief) == 1:
        lines.insert(2, f"            token outputs:displacement.connect = <{path}/Surface.outputs:displacement>\n")
    if len(relief) == 2:
        lines.append(_variants(path, relief))
    return "".join([*lines, "        }\n"])


@dataclass(frozen=True)
class _Network:
    material: Material
    files: MapFiles

    def relief(self) -> dict[str, Wire]:
        """Inputs of the surface that only one of them may have, by name."""
        found = {}
        if self.files.path(self.material.normal_map):
            found["normal"] = Wire("Normals", "rgb")
        if self.files.path(self.material.displacement_map):
            found["displacement"] = Wire("Heights", "r")
        return found

    def surface(self, relief: dict[str, Wire]) -> Shader:
        material, files = self.material, self.files
        inputs: dict[str, Value] = {
            "color3f diffuseColor": Wire("Colour", "rgb") if files.path(material.colour_map) else material.colour,
            "float roughness": Wire("Roughness", "r") if files.path(material.roughness_map) else material.roughness,
            "float metallic": 0.0,
            "int useSpecularWorkflow": 0,
            "float ior": ior_of(material.f0),
        }
        if files.path(material.specular_map) and material.specular > 0:
            inputs["color3f specularColor"] = Wire("Specular", "rgb")
        opacity = material.opacity * (1 - material.transmission)
        inputs["float opacity"] = Wire("Alpha", "a") if self._has_alpha else opacity
        if material.alpha == "mask":
            inputs["float opacityThreshold"] = material.cutoff
        if files.path(material.cavity_map):
            inputs["float occlusion"] = Wire("Cavity", "r")
        kinds = {"normal": "normal3f normal", "displacement": "float displacement"}
        inputs |= {kinds[name]: wire for name, wire in relief.items()}
        return Shader("Surface", "UsdPreviewSurface", inputs, ("token surface", "token displacement"))

    @property
    def _has_alpha(self) -> bool:
        return self.material.alpha != "opaque" and bool(self.files.path(self.material.colour_map))

    def textures(self) -> list[Shader]:
        material = self.material
        colour = self.files.path(material.colour_map)
        slots: list[tuple[str, str | None, str, Sequence[str], tuple[float, float], tuple[float, ...]]] = [
            ("Colour", colour, "sRGB", ("float3 rgb",), (1, 0), (*material.colour, 1.0)),
            # Of its own, as Blender takes the colour for alpha where one texture with a scale has both outputs.
            ("Alpha", colour if self._has_alpha else None, "sRGB", ("float a",), (1, 0), ()),
            ("Roughness", self.files.path(material.roughness_map), "raw", ("float r",), (1, 0), ()),
            ("Specular", self.files.path(material.specular_map), "raw", ("float3 rgb",),
             (1 / max(material.specular, 1e-3), 0), ()),
            ("Normals", self.files.path(material.normal_map), "raw", ("float3 rgb",), NORMAL_FACTORS, ()),
            ("Heights", self.files.path(material.displacement_map), "raw", ("float r",), HEIGHT_FACTORS, ()),
            ("Cavity", self.files.path(material.cavity_map), "raw", ("float r",), (1, 0), ()),
        ]  # fmt: skip
        made = [_texture(name, path, *rest) for name, path, *rest in slots if path is not None]  # type: ignore[arg-type]
        if made:
            made.insert(0, Shader("Chart", "UsdPrimvarReader_float2", {"string varname": "st"}, ("float2 result",)))
        return made


def _texture(
    name: str, path: str, space: str, outputs: Sequence[str], factors: tuple[float, float], scale: tuple[float, ...]
) -> Shader:
    factor, bias = factors
    inputs: dict[str, Value] = {
        "asset file": Asset(path), "token sourceColorSpace": space, "token wrapS": "clamp", "token wrapT": "clamp",
        "float2 st": Wire("Chart", "result"),
    }  # fmt: skip
    scale = scale or (factor, factor, factor, 1.0)
    if scale != (1.0, 1.0, 1.0, 1.0):
        inputs["float4 scale"] = scale
    if bias:
        inputs["float4 bias"] = (bias, bias, bias, 0.0)
    return Shader(name, "UsdUVTexture", inputs, outputs)


def _variants(path: str, relief: dict[str, Wire]) -> str:
    normal, height = relief["normal"], relief["displacement"]
    pad = " " * 16
    return (
        '            variantSet "relief" = {\n'
        f'{pad}"displacement" {{\n'
        f"{pad}    token outputs:displacement.connect = <{path}/Surface.outputs:displacement>\n"
        f'{pad}    over "Surface"\n{pad}    {{\n'
        f"{pad}        float inputs:displacement.connect = <{path}/{height.shader}.outputs:{height.output}>\n"
        f"{pad}    }}\n{pad}}}\n"
        f'{pad}"normal" {{\n'
        f'{pad}    over "Surface"\n{pad}    {{\n'
        f"{pad}        normal3f inputs:normal.connect = <{path}/{normal.shader}.outputs:{normal.output}>\n"
        f"{pad}    }}\n{pad}}}\n"
        "            }\n"
    )


def ior_of(f0: float) -> float:
    """Index of refraction, >= 1, whose reflectance at normal incidence is ``f0`` in [0, 1)."""
    root = math.sqrt(min(max(f0, 0.0), 0.9))
    return (1 + root) / (1 - root)
