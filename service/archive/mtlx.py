"""MaterialX: standard_surface with all that the description has, subsurface scattering too.

One list of nodes is written twice: into the USD file, and as ``mesh/head.mtlx`` for tools that take MaterialX alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from xml.sax.saxutils import quoteattr

from service.archive.images import NORMAL_SCALE, NORMAL_ZERO
from service.archive.map_files import MapFiles
from service.archive.usd_text import Asset, Shader, Value, Wire
from service.materials.material import Map, Material

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


def network(material: Material, files: MapFiles) -> list[Node]:
    """Nodes of one material; the last is the surface, ``Standard``."""
    made: list[Node] = []
    wires: dict[str, tuple[str, str]] = {}
    inputs: dict[str, tuple[str, Input]] = {
        "base": ("float", 1.0),
        "base_color": ("color3", material.colour),
        "specular": ("float", material.specular),
        "specular_IOR": ("float", material.ior),
        "specular_roughness": ("float", material.roughness),
        "transmission": ("float", material.transmission),
        "opacity": ("color3", (material.opacity,) * 3),
    }
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
        for node in network(material, files):
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
