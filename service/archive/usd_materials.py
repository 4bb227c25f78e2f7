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
from dataclasses import dataclass
from html import escape

from service.archive.images import NORMAL_SCALE, NORMAL_ZERO
from service.archive.maps import MapFiles
from service.archive.usd_text import Prim
from service.materials.material import Map, Material
from service.reflectance.reflectance_maps import MID, SCALE_MM


@dataclass(frozen=True)
class Wire:
    """A connection to an output of another node."""

    shader: str
    output: str


Value = float | int | str | tuple[float, ...] | Wire
Inputs = Mapping[str, tuple[str, Value]]
"""By name: type, and value."""

_USD_TYPES = {
    "color3": "color3f", "vector3": "float3", "vector2": "float2", "filename": "asset", "surfaceshader": "token",
    "color4": "color4f", "integer": "int",
}  # fmt: skip
"""Of MaterialX types, where USD calls them otherwise."""


@dataclass(frozen=True)
class Node:
    """A node of a shading network, of USD alone or of MaterialX.

    Attributes:
        name: of the prim.
        definition: its ``info:id``: "UsdUVTexture" or, of MaterialX, "ND_image_color3" and the like.
        inputs: name -> (type, value); values that come from other nodes are wires.
        outputs: type of each, by name; MaterialX has one, ``out``.
        category: of MaterialX: "image" and the like.
        space: colour space of its file, in MaterialX.
    """

    name: str
    definition: str
    inputs: Inputs
    outputs: Mapping[str, str]
    category: str = ""
    space: str | None = None

    def text(self, parent: str, indent: str) -> str:
        """The prim of USD under a parent path."""
        values: dict[str, str | None] = {"uniform token info:id": f'"{self.definition}"'}
        for name, (kind, value) in self.inputs.items():
            wire = ".connect" if isinstance(value, Wire) else ""
            values[f"{_USD_TYPES.get(kind, kind)} inputs:{name}{wire}"] = _assigned(kind, value, parent)
        values |= {f"{_USD_TYPES.get(kind, kind)} outputs:{name}": None for name, kind in self.outputs.items()}
        return Prim("Shader", self.name, values).text(indent)

    def xml(self, prefix: str) -> list[str]:
        """Lines of a MaterialX document in which names of the material's nodes have a prefix."""
        lines = [f'  <{self.category} name="{prefix}{self.name}" type="{self.outputs["out"]}">']
        for name, (kind, value) in self.inputs.items():
            if isinstance(value, Wire):
                lines.append(f'    <input name="{name}" type="{kind}" nodename="{prefix}{value.shader}"/>')
                continue
            text = ", ".join(f"{one:.7g}" for one in value) if isinstance(value, tuple) else value
            text = text if isinstance(text, str) else f"{text:.7g}"
            space = f' colorspace="{self.space}"' if self.space and kind == "filename" else ""
            lines.append(f'    <input name="{name}" type="{kind}" value="{escape(text)}"{space}/>')
        return [*lines, f"  </{self.category}>"]


def mtlx_network(material: Material, files: MapFiles) -> list[Node]:
    """Nodes of one material; the last is the surface, ``Standard``."""
    made: list[Node] = []

    def node(name: str, category: str, kind: str, inputs: Inputs, of: str = "") -> Wire:
        space = "srgb_texture" if category == "image" and kind in ("color3", "color4") else None
        made.append(Node(name, f"ND_{category}_{of or kind}", inputs, {"out": kind}, category, space))
        return Wire(name, "out")

    def image(name: str, one: Map | None, kind: str) -> Wire | None:
        path, clamp = files.path(one), ("string", "clamp")
        file: Inputs = {"file": ("filename", path or ""), "uaddressmode": clamp, "vaddressmode": clamp}
        place: Inputs = {"texcoord": ("vector2", Wire("Mtlx_chart", "out"))}
        return None if path is None else node(name, "image", kind, {**file, **place})

    inputs: dict[str, tuple[str, Value]] = {
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
    wires: dict[str, tuple[str, Value]] = {}
    if colour := image("Mtlx_colour", material.colour_map, "color3"):
        factors: Inputs = {"in2": ("color3", material.colour), "in1": ("color3", colour)}
        tinted = ("color3", node("Mtlx_tinted", "multiply", "color3", factors))
        wires |= dict.fromkeys(("base_color", *(["subsurface_color"] * ("subsurface" in inputs))), tinted)
    for called, one in (("specular_roughness", material.roughness_map), ("specular", material.specular_map)):
        if value := image(f"Mtlx_{called}", one, "float"):
            wires[called] = ("float", value)
    if codes := image("Mtlx_normals", material.normal_map, "vector3"):
        # The coding 128 + 127 n as the 127.5 (1 + n) that the node decodes.
        for name, category, factor in (
            ("Mtlx_scaled", "multiply", 255 / (2 * NORMAL_SCALE)),
            ("Mtlx_shifted", "add", 0.5 - NORMAL_ZERO / (2 * NORMAL_SCALE)),
        ):
            both: Inputs = {"in2": ("float", factor), "in1": ("vector3", codes)}
            codes = node(name, category, "vector3", both, "vector3FA")
        normal = node("Mtlx_normal", "normalmap", "vector3", {"in": ("vector3", codes)}, "float")
        wires["normal"] = ("vector3", normal)
    if material.alpha != "opaque" and (rgba := image("Mtlx_rgba", material.colour_map, "color4")):
        channel: Inputs = {"index": ("integer", 3), "in": ("color4", rgba)}
        alpha = node("Mtlx_alpha", "extract", "float", channel, "color4")
        opacity = node("Mtlx_opacity", "convert", "color3", {"in": ("float", alpha)}, "float_color3")
        wires["opacity"] = ("color3", opacity)
    if made:
        node("Mtlx_chart", "geompropvalue", "vector2", {"geomprop": ("string", "st")})
        made.insert(0, made.pop())
    fixed = {name: one for name, one in inputs.items() if name not in wires}
    node("Standard", "standard_surface", "surfaceshader", {**fixed, **wires})
    return made


def mtlx_bytes(materials: Iterable[Material], files: MapFiles) -> bytes:
    """A MaterialX 1.38 document of materials, each once by name."""
    lines = ['<?xml version="1.0"?>', '<materialx version="1.38" colorspace="lin_rec709">']
    for material in {one.name: one for one in materials}.values():
        for node in mtlx_network(material, files):
            lines += node.xml(f"{material.name}_")
        shader = f'<input name="surfaceshader" type="surfaceshader" nodename="{material.name}_Standard"/>'
        lines += [f'  <surfacematerial name="{material.name}" type="material">', f"    {shader}"]
        lines.append("  </surfacematerial>")
    return "\n".join([*lines, "</materialx>", ""]).encode("ascii")


NORMAL_FACTORS = (255 / NORMAL_SCALE, -NORMAL_ZERO / NORMAL_SCALE)
"""Scale and bias from codes in [0, 1] to components."""
HEIGHT_FACTORS = (65535 * SCALE_MM * 1e-3, -MID * SCALE_MM * 1e-3)
"""Scale and bias from codes in [0, 1] to metres."""

RELIEF = {"normal": ("normal3f", Wire("Normals", "rgb")), "displacement": ("float", Wire("Heights", "r"))}
"""Inputs of the surface of which only one may be used: type and source."""

_VARIANT_SET = """ (
            variants = {
                string relief = "normal"
            }
            prepend variantSets = "relief"
        )"""


def material_text(material: Material, files: MapFiles) -> str:
    """One material, as a prim of the scope ``Materials``."""
    path = f"/Head/Materials/{material.name}"
    relief = [name for name in RELIEF if files.path(getattr(material, f"{name}_map"))]
    alone = relief if len(relief) == 1 else []
    nodes = [_surface(material, files, alone), *_textures(material, files)]
    nodes += mtlx_network(material, files)
    displaced = f"token outputs:displacement.connect = <{path}/Surface.outputs:displacement>\n"
    return "".join([
        f'        def Material "{material.name}"{_VARIANT_SET if len(relief) == 2 else ""}\n        {{\n',
        f"            token outputs:surface.connect = <{path}/Surface.outputs:surface>\n",
        *([f"            {displaced}"] if "displacement" in alone else []),
        f"            token outputs:mtlx:surface.connect = <{path}/Standard.outputs:out>\n",
        *(node.text(path, "            ") for node in nodes),
        _variants(path, displaced) if len(relief) == 2 else "",
        "        }\n",
    ])  # fmt: skip


def _surface(material: Material, files: MapFiles, relief: Sequence[str]) -> Node:
    """The UsdPreviewSurface of a material, with the inputs of ``RELIEF`` that are named."""

    def or_map(slot: str, source: str, output: str, value: Value) -> Value:
        return Wire(source, output) if files.path(getattr(material, f"{slot}_map")) else value

    inputs: dict[str, tuple[str, Value]] = {
        "diffuseColor": ("color3f", or_map("colour", "Colour", "rgb", material.colour)),
        "roughness": ("float", or_map("roughness", "Roughness", "r", material.roughness)),
        "metallic": ("float", 0.0),
        "useSpecularWorkflow": ("int", 0),
        "ior": ("float", ior_of(material.f0)),
    }
    if files.path(material.specular_map) and material.specular > 0:
        inputs["specularColor"] = ("color3f", Wire("Specular", "rgb"))
    opaque = material.alpha == "opaque"
    opacity = material.opacity if opaque else or_map("colour", "Alpha", "a", material.opacity)
    inputs["opacity"] = ("float", opacity)
    if material.alpha == "blend":
        inputs["opacityMode"] = ("token", "presence")  # alpha is coverage, as in glTF
    if material.alpha == "mask":
        inputs["opacityThreshold"] = ("float", material.cutoff)
    if files.path(material.cavity_map):
        inputs["occlusion"] = ("float", Wire("Cavity", "r"))
    inputs |= {name: RELIEF[name] for name in relief}
    return Node("Surface", "UsdPreviewSurface", inputs, {"surface": "token", "displacement": "token"})


def _textures(material: Material, files: MapFiles) -> list[Node]:
    """What the surface's wires lead to, and first the texture coordinates."""
    whole, alpha = (1.0, 0.0), None if material.alpha == "opaque" else material.colour_map
    slots: list[tuple[str, Map | None, str, str, str, tuple[float, float]]] = [
        ("Colour", material.colour_map, "sRGB", "float3", "rgb", whole),
        # Of its own, as Blender takes the colour for alpha where one texture with a scale has both outputs.
        ("Alpha", alpha, "sRGB", "float", "a", whole),
        ("Roughness", material.roughness_map, "raw", "float", "r", whole),
        ("Specular", material.specular_map, "raw", "float3", "rgb", (1 / max(material.specular, 1e-3), 0.0)),
        ("Normals", material.normal_map, "raw", "float3", "rgb", NORMAL_FACTORS),
        ("Heights", material.displacement_map, "raw", "float", "r", HEIGHT_FACTORS),
        ("Cavity", material.cavity_map, "raw", "float", "r", whole),
    ]
    made = []
    for name, one, space, kind, output, (factor, bias) in slots:
        path = files.path(one)
        if path is None:
            continue
        inputs: dict[str, tuple[str, Value]] = {
            "file": ("asset", path), "sourceColorSpace": ("token", space),
            "wrapS": ("token", "clamp"), "wrapT": ("token", "clamp"), "st": ("float2", Wire("Chart", "result")),
        }  # fmt: skip
        scale = (*material.colour, 1.0) if name == "Colour" else (factor, factor, factor, 1.0)
        if scale != (1.0, 1.0, 1.0, 1.0):
            inputs["scale"] = ("float4", scale)
        if bias:
            inputs["bias"] = ("float4", (bias, bias, bias, 0.0))
        made.append(Node(name, "UsdUVTexture", inputs, {output: kind}))
    chart = Node("Chart", "UsdPrimvarReader_float2", {"varname": ("string", "st")}, {"result": "float2"})
    return [chart, *made] if made else []


def _variants(path: str, displaced: str) -> str:
    pad = " " * 16
    text = '            variantSet "relief" = {\n'
    for name in sorted(RELIEF):
        kind, wire = RELIEF[name]
        own = f"{pad}    {displaced}" if name == "displacement" else ""
        text += (
            f'{pad}"{name}" {{\n{own}{pad}    over "Surface"\n{pad}    {{\n'
            f"{pad}        {kind} inputs:{name}.connect = <{path}/{wire.shader}.outputs:{wire.output}>\n"
            f"{pad}    }}\n{pad}}}\n"
        )
    return f"{text}            }}\n"


def _assigned(kind: str, value: Value, parent: str) -> str:
    """A value of a type as USD text; wires lead to prims under a parent path."""
    if isinstance(value, Wire):
        return f"<{parent}/{value.shader}.outputs:{value.output}>"
    if isinstance(value, tuple):
        return "(" + ", ".join(f"{one:.7g}" for one in value) + ")"
    if isinstance(value, str):
        return f"@{value}@" if kind in ("asset", "filename") else f'"{value}"'
    return f"{value:.7g}"


def ior_of(f0: float) -> float:
    """Index of refraction, >= 1, whose reflectance at normal incidence is ``f0`` in [0, 1)."""
    root = math.sqrt(min(max(f0, 0.0), 0.9))
    return (1 + root) / (1 - root)
