"""Materials of the USD file: UsdPreviewSurface."""

from __future__ import annotations

from service.archive.map_files import MapFiles
from service.materials.material import Material

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


def material_text(material: Material, files: MapFiles) -> str:
    """One material."""
    path = files.path(material.colour_map)
    connected = f".connect = </Head/Materials/{material.name}/Texture.outputs:rgb>"
    constant = " = (" + ", ".join(f"{value:g}" for value in material.colour) + ")"
    return _MATERIAL.format(
        name=material.name,
        diffuse=constant if path is None else connected,
        roughness=material.roughness,
        opacity=material.opacity,
        texture="" if path is None else _TEXTURE.format(name=material.name, path=path),
    )
