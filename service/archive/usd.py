"""``mesh/head.usda``: the same head as ``head.obj`` for USD tools, as text.

Original polygons with ``subdivisionScheme = "none"``, chart as face-varying ``primvars:st`` (origin bottom left), one
Mesh per part and one material per kind of surface.
"""

from __future__ import annotations

from collections.abc import Sequence

from service.archive.map_files import MapFiles
from service.archive.surface import vertex_normals
from service.archive.usd_materials import material_text
from service.archive.usd_text import integers, tuples
from service.head.files import split_polygons
from service.materials.part import MeshPart

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


def usda_bytes(parts: Sequence[MeshPart], files: MapFiles, title: str) -> bytes:
    """USD text of the parts in the photo's expression."""
    blocks = [_STAGE.format(title=title), *(_mesh(part) for part in parts)]
    used = {part.material.name: part.material for part in parts}
    blocks += ['    def Scope "Materials"\n    {\n', *(material_text(material, files) for material in used.values())]
    return "".join([*blocks, "    }\n}\n"]).encode("ascii")


def _mesh(part: MeshPart) -> str:
    polygons, places = part.polygons, part.polygons_uv
    present = polygons >= 0
    return _MESH.format(
        name=part.name,
        material=part.material.name,
        double_sided="true" if part.material.double_sided else "false",
        extent=tuples([part.vertices.min(0), part.vertices.max(0)], 6),
        counts=integers(present.sum(1)),
        indices=integers(polygons[present]),
        points=tuples(part.vertices, 6),
        normals=tuples(vertex_normals(part.vertices, split_polygons(polygons)), 4),
        st=tuples(part.uv[places[present]], 6),
    )
