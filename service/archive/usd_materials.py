"""Materials of the USD file: UsdPreviewSurface for every tool, and MaterialX for those that have it.

UsdPreviewSurface's metallic workflow has no factor of F0, and its specular workflow is ignored by Blender, which takes
``specularColor`` as a tint of the F0 that ``ior`` gives. So ``ior`` holds the material's F0 without the map, which is
what a reader of the specification shows, and ``specularColor`` the map as a multiple of it. MaterialX has the map as it
is: standard_surface with all that the description has, subsurface scattering too. One list of its nodes is written
twice: into the USD file, and as ``mesh/head.mtlx`` for tools that take MaterialX alone.

Normals and displacement are the same relief, so the variant set ``relief`` of each material with both takes one:
``normal`` (the default), or ``displacement`` for renderers that subdivide.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from xml.sax.saxutils import quoteattr

from service.archive.images import NORMAL_SCALE, NORMAL_ZERO
from service.archive.maps import MapFiles
from service.archive.usd_text import Asset, Shader, Value, Wire
from service.materials.material import Map, Material
from service.reflectance.reflectance_maps import MID, SCALE_MM

Input = float | str | tuple[float, ...]

_USD_TYPES = {
    "float": "float", "color3": "color3f", "vector3": "float3", "vector2": "float2", "filename": "asset",
    "string": "string", "surfaceshader": "token", "color4": "color4f",
}  # fmt: skip


@dataclass(frozen=True)
class Node:
    """A node of MaterialX.

    Attributes:
        name: in its graph.
        category, kind: for example "image" of type "color3".
        inputs: name -> (type, value); of "node" inputs the value is the node's name.
        definition: name of the node definition.
    """

    name: str
    category: str
    kind: str
    definition: str
    inputs: Mapping[str, tuple[str, Input]] = field(default_factory=dict)
    wires: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """Inputs that come from other nodes: name -> (type, node)."""
    space: str | None = None
    """Colour space of its file."""


def mtlx_network(material: Material, files: MapFiles) -> list[Node]:
    """Nodes of one material; the last is the surface, ``Standard``."""
    made: list[Node] = []
    wires: dict[str, tuple[str, str]] = {}
    inputs: dict[str, tuple[str, Input]] = {
        "base": ("float", 1.0),
        "base_color": ("color3", material.colour),
        "specular": ("float", material.specular),
        "specular_IOR": ("float", material.ior),
        "specular_roughness": ("float", material.roughness),
        "opacity": ("color3", (material.opacity,) * 3),
    }
    if material.anisotropy > 0:
        inputs["specular_anisotropy"] = ("float", material.anisotropy)
    if any(material.subsurface_mm):
        longest = max(material.subsurface_mm)
        inputs["subsurface"] = ("float", 1.0)
        inputs["subsurface_scale"] = ("float", longest * 1e-3)
        inputs["subsurface_radius"] = ("color3", tuple(one / longest for one in material.subsurface_mm))
        inputs["subsurface_color"] = ("color3", material.colour)

    def image(name: str, one: Map | None, kind: str) -> str | None:
        path = files.path(one)
        if path is None:
            return None
        file = {"file": ("filename", path), "uaddressmode": ("string", "clamp"), "vaddressmode": ("string", "clamp")}
        made.append(
            Node(
                name, "image", kind, f"ND_image_{kind}", file, {"texcoord": ("vector2", "Mtlx_chart")},
                "srgb_texture" if kind in ("color3", "color4") else None,
            )
        )  # fmt: skip
        return name

    if image("Mtlx_colour", material.colour_map, "color3"):
        factor: dict[str, tuple[str, Input]] = {"in2": ("color3", material.colour)}
        source = {"in1": ("color3", "Mtlx_colour")}
        made.append(Node("Mtlx_tinted", "multiply", "color3", "ND_multiply_color3", factor, source))
        wires |= {"base_color": ("color3", "Mtlx_tinted")}
        if "subsurface" in inputs:
            wires |= {"subsurface_color": ("color3", "Mtlx_tinted")}
    for called, one in (("specular_roughness", material.roughness_map), ("specular", material.specular_map)):
        name = image(f"Mtlx_{called}", one, "float")
        if name:
            wires[called] = ("float", name)
    if image("Mtlx_normals", material.normal_map, "vector3"):
        # The coding 128 + 127 n as the 127.5 (1 + n) that the node decodes.
        scale, shift = 255 / (2 * NORMAL_SCALE), 0.5 - NORMAL_ZERO / (2 * NORMAL_SCALE)
        made += [
            Node("Mtlx_scaled", "multiply", "vector3", "ND_multiply_vector3FA", {"in2": ("float", scale)},
                 {"in1": ("vector3", "Mtlx_normals")}),
            Node("Mtlx_shifted", "add", "vector3", "ND_add_vector3FA", {"in2": ("float", shift)},
                 {"in1": ("vector3", "Mtlx_scaled")}),
            Node("Mtlx_normal", "normalmap", "vector3", "ND_normalmap_float", {}, {"in": ("vector3", "Mtlx_shifted")}),
        ]  # fmt: skip
        wires["normal"] = ("vector3", "Mtlx_normal")
    if material.alpha != "opaque" and image("Mtlx_rgba", material.colour_map, "color4"):
        made += [
            Node("Mtlx_alpha", "extract", "float", "ND_extract_color4", {"index": ("integer", 3)},
                 {"in": ("color4", "Mtlx_rgba")}),
            Node("Mtlx_opacity", "convert", "color3", "ND_convert_float_color3", {}, {"in": ("float", "Mtlx_alpha")}),
        ]  # fmt: skip
        wires["opacity"] = ("color3", "Mtlx_opacity")
    if made:
        chart: dict[str, tuple[str, Input]] = {"geomprop": ("string", "st")}
        made.insert(0, Node("Mtlx_chart", "geompropvalue", "vector2", "ND_geompropvalue_vector2", chart))
    fixed = {name: one for name, one in inputs.items() if name not in wires}
    made.append(
        Node("Standard", "standard_surface", "surfaceshader", "ND_standard_surface_surfaceshader", fixed, wires)
    )
    return made


def shaders(nodes: Iterable[Node]) -> list[Shader]:
    """The nodes as prims of USD."""
    made = []
    for node in nodes:
        values: dict[str, Value] = {}
        for name, (kind, value) in node.inputs.items():
            usd = "int" if kind == "integer" else _USD_TYPES[kind]
            values[f"{usd} {name}"] = Asset(str(value)) if kind == "filename" else value
        for name, (kind, source) in node.wires.items():
            values[f"{_USD_TYPES[kind]} {name}"] = Wire(source, "out")
        made.append(Shader(node.name, node.definition, values, (f"{_USD_TYPES[node.kind]} out",)))
    return made


def mtlx_bytes(materials: Iterable[Material], files: MapFiles) -> bytes:
    """A MaterialX 1.38 document of materials, each once by name."""
    lines = ['<?xml version="1.0"?>', '<materialx version="1.38" colorspace="lin_rec709">']
    for material in {one.name: one for one in materials}.values():
        for node in mtlx_network(material, files):
            lines += _xml(node, f"{material.name}_")
        shader = f'<input name="surfaceshader" type="surfaceshader" nodename="{material.name}_Standard"/>'
        lines += [f'  <surfacematerial name="{material.name}" type="material">', f"    {shader}"]
        lines.append("  </surfacematerial>")
    return "\n".join([*lines, "</materialx>", ""]).encode("ascii")


def _xml(node: Node, prefix: str) -> list[str]:
    lines = [f'  <{node.category} name="{prefix}{node.name}" type="{node.kind}">']
    for name, (kind, value) in node.inputs.items():
        text = ", ".join(f"{one:.7g}" for one in value) if isinstance(value, tuple) else value
        text = text if isinstance(text, str) else f"{text:.7g}"
        space = f' colorspace="{node.space}"' if node.space and kind == "filename" else ""
        lines.append(f'    <input name="{name}" type="{kind}" value={quoteattr(text)}{space}/>')
    for name, (kind, source) in node.wires.items():
        lines.append(f'    <input name="{name}" type="{kind}" nodename="{prefix}{source}"/>')
    return [*lines, f"  </{node.category}>"]


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
    path, made = f"{SCOPE}/{material.name}", _PreviewSurface(material, files)
    relief = made.relief()
    surface = made.surface(relief if len(relief) == 1 else {})
    nodes = [surface, *made.textures(), *shaders(mtlx_network(material, files))]
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
class _PreviewSurface:
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
        inputs["float opacity"] = Wire("Alpha", "a") if self._has_alpha else material.opacity
        if material.alpha == "blend":
            inputs["token opacityMode"] = "presence"  # alpha is coverage, as in glTF
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
