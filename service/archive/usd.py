"""``mesh/head.usda``: the same head as ``head.obj`` for USD tools, as text.

Original polygons with ``subdivisionScheme = "none"``, chart as face-varying ``primvars:st`` (origin bottom left), one
Mesh and one UsdPreviewSurface material per part.
"""

from __future__ import annotations

import numpy as np

from service.archive.obj import TEXTURE_FROM_MESH
from service.archive.surface import vertex_normals
from service.arrays import AnyFloat, AnyInt, Float32, Int32
from service.errors import NumericFault
from service.head.model import HeadModel
from service.materials.material import Material
from service.materials.of_head import material_of

_STAGE = """\
#usda 1.0
(
    defaultPrim = "Head"
    doc = "{title}"
    metersPerUnit = 1
    upAxis = "Y"
)

def Xform "Head" (
    kind = "component"
)
{{
"""

_MESH = """\
    def Mesh "{name}" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        uniform bool doubleSided = {double_sided}
        uniform token subdivisionScheme = "none"
        float3[] extent = [{extent}]
        int[] faceVertexCounts = [{counts}]
        int[] faceVertexIndices = [{indices}]
        point3f[] points = [{points}]
        normal3f[] normals = [{normals}] (
            interpolation = "vertex"
        )
        texCoord2f[] primvars:st = [{st}] (
            interpolation = "faceVarying"
        )
        rel material:binding = </Head/Materials/{material}>
    }}
"""

_MATERIAL = """\
        def Material "{name}"
        {{
            token outputs:surface.connect = </Head/Materials/{name}/Surface.outputs:surface>

            def Shader "Surface"
            {{
                uniform token info:id = "UsdPreviewSurface"
                color3f inputs:diffuseColor{diffuse}
                float inputs:roughness = {roughness:g}
                float inputs:metallic = 0
                float inputs:opacity = {opacity:g}
                token outputs:surface
            }}
{texture}        }}
"""

_TEXTURE = """
            def Shader "Chart"
            {{
                uniform token info:id = "UsdPrimvarReader_float2"
                string inputs:varname = "st"
                float2 outputs:result
            }}

            def Shader "Texture"
            {{
                uniform token info:id = "UsdUVTexture"
                asset inputs:file = @{path}@
                token inputs:sourceColorSpace = "sRGB"
                token inputs:wrapS = "clamp"
                token inputs:wrapT = "clamp"
                float2 inputs:st.connect = </Head/Materials/{name}/Chart.outputs:result>
                float3 outputs:rgb
            }}
"""


def usda_bytes(
    head: HeadModel,
    vertices: AnyFloat,
    title: str,
    *,
    textured: bool = True,
    texture: str = TEXTURE_FROM_MESH,
) -> bytes:
    """USD text of ``vertices`` (V, 3) metres, head space.

    Raises:
        NumericFault: a vertex is not finite.
    """
    if not np.isfinite(vertices).all():
        raise NumericFault("a vertex of the head is not finite")
    normals = vertex_normals(vertices, head.triangles)
    blocks = [_STAGE.format(title=title)]
    for index, name in enumerate(head.part_names):
        chosen = head.polygon_part == index
        if chosen.any():
            blocks.append(_mesh(name, head.polygons[chosen], head.polygon_uv[chosen], head.uv, vertices, normals))
    used = {material_of(name).name: material_of(name) for name in head.part_names}
    blocks += [
        '    def Scope "Materials"\n    {\n',
        *(_material(material, textured, texture) for material in used.values()),
    ]
    return "".join([*blocks, "    }\n}\n"]).encode("ascii")


def _mesh(
    name: str,
    polygons: Int32,
    polygon_uv: Int32,
    uv: Float32,
    vertices: AnyFloat,
    normals: AnyFloat,
) -> str:
    present = polygons >= 0
    own, local = np.unique(polygons[present], return_inverse=True)
    material = material_of(name)
    return _MESH.format(
        name=name,
        material=material.name,
        double_sided="true" if material.double_sided else "false",
        extent=_tuples([vertices[own].min(0), vertices[own].max(0)], 6),
        counts=_integers(present.sum(1)),
        indices=_integers(local),
        points=_tuples(vertices[own], 6),
        normals=_tuples(normals[own], 4),
        st=_tuples(uv[polygon_uv[present]], 6),
    )


def _material(material: Material, textured: bool, texture: str) -> str:
    with_texture = textured and material.textured
    connected = f".connect = </Head/Materials/{material.name}/Texture.outputs:rgb>"
    constant = " = (" + ", ".join(f"{value:g}" for value in material.colour) + ")"
    return _MATERIAL.format(
        name=material.name,
        diffuse=connected if with_texture else constant,
        roughness=material.roughness,
        opacity=material.opacity,
        texture=_TEXTURE.format(name=material.name, path=texture) if with_texture else "",
    )


def _tuples(rows: AnyFloat | list[AnyFloat], digits: int) -> str:
    values = np.asarray(rows, np.float64) + 0.0  # -0.0 becomes 0.0
    number = f"%.{digits}g"
    pattern = "(" + ", ".join([number] * values.shape[1]) + ")"
    return ", ".join([pattern] * len(values)) % tuple(values.ravel().tolist())


def _integers(values: AnyInt) -> str:
    return ", ".join(map(str, np.asarray(values).ravel().tolist()))
