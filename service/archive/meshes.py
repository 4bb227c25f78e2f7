"""The meshes of an archive, with the textures of their parts."""

from __future__ import annotations

from service import GENERATOR
from service.archive.avatar import Avatar
from service.archive.glb import glb_bytes, weights_by_name
from service.archive.images import encode_png
from service.archive.licences import COPYRIGHT
from service.archive.maps import (
    MAPS,
    MapFiles,
    chart_pictures,
    chart_values,
    fine_mesh_wanted,
    in_object_space,
    map_wanted,
)
from service.archive.obj import data_maps, mtl_bytes, obj_bytes, parts_obj_bytes
from service.archive.skeleton import joint_weights, skeleton
from service.archive.surfaces import displaced, subdivided_head
from service.archive.usd import usda_bytes
from service.archive.usd_materials import mtlx_bytes
from service.materials.of_head import head_parts, material_of
from service.materials.part import MeshPart, check_parts


def meshes(avatar: Avatar) -> dict[str, bytes]:
    """Name -> content of everything under ``mesh/`` and ``maps/parts/``.

    Raises:
        NumericFault: a vertex is not finite, or names of parts are ambiguous.
    """
    head, fit, made = avatar.head, avatar.fit, avatar.reflectance
    title = f"{GENERATOR}: {head.name} {'with maps of its own' if avatar.given else 'fitted to a photo'}"
    parts, maps = drawn_parts(avatar), map_files(avatar)
    materials = [part.material for part in parts]
    weights = weights_by_name(head.expression_names, fit.expression)
    joints = skeleton(head, fit.neutral)
    files = {
        "mesh/head.obj": obj_bytes(head, fit.vertices, title),
        **({"mesh/parts.obj": parts_obj_bytes(avatar.parts, title)} if avatar.parts else {}),
        "mesh/head.mtl": mtl_bytes([*map(material_of, head.part_names), *materials], maps),
        "mesh/head.mtlx": mtlx_bytes(materials, maps),
        "mesh/head.glb": glb_bytes(
            parts,
            chart_pictures(avatar),
            units=head.expression_names,
            generator=GENERATOR,
            copyright_notice=COPYRIGHT,
            expression=weights,
            extras={"headModel": head.name, "headModelLicence": head.licence, "units": "metre"},
        ),
        "mesh/head.usda": usda_bytes(
            parts, maps, title, units=head.expression_names, expression=weights, joints=joints,
            weights=joint_weights(head, joints),
        ),
    }
    if made is not None and made.displacement is not None and fine_mesh_wanted(avatar):
        fine, smooth = subdivided_head(head, fit.vertices)
        embossed = displaced(fine, smooth, made.displacement)
        files["mesh/head_fine.obj"] = obj_bytes(fine, embossed, f"{title}, subdivided and displaced")
    return files | data_maps(materials, maps, chart_values(avatar)) | _textures(avatar)


def drawn_parts(avatar: Avatar) -> list[MeshPart]:
    """The head's own parts, without those that others replace, and the others.

    Raises:
        NumericFault: a vertex is not finite, or names are ambiguous.
    """
    own = head_parts(avatar.head, avatar.fit.vertices, avatar.fit.neutral)
    check_parts(avatar.parts, [part.name for part in own])
    replaced = {name for part in avatar.parts for name in part.replaces}
    return [*(part for part in own if part.name not in replaced), *avatar.parts]


def map_files(avatar: Avatar) -> MapFiles:
    """Where the meshes find the maps of the chart; normals in object space are no use to them."""
    there = [spec for spec in MAPS if map_wanted(avatar, spec.role) and spec.codes(avatar) is not None]
    return MapFiles([spec.role for spec in there if not (spec.entry.framed and in_object_space(avatar))])


def _textures(avatar: Avatar) -> dict[str, bytes]:
    """PNG of each texture of a part's own."""
    own = {one.name: (one, one is part.material.colour_map) for part in avatar.parts for one in part.own_maps}
    return {
        f"maps/parts/{name}.png": encode_png(one.pixels, srgb=colour, level=7) for name, (one, colour) in own.items()
    }
