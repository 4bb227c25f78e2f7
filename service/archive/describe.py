"""The manifest of an avatar and its files."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping

from service import PROGRAM, __version__
from service.anatomy.hair.find_hair import Hair
from service.archive import manifest as m
from service.archive.avatar import Avatar
from service.archive.container import in_order
from service.archive.glb import weights_by_name
from service.archive.maps import MAPS, MapFiles, MapSpec, wrinkle_of
from service.archive.meshes import drawn_parts, map_files
from service.archive.skeleton import JOINTS, PARENTS, skeleton
from service.face.features.eyes import Gaze
from service.geometry.camera import Camera
from service.materials.material import Material
from service.reflectance.reflectance_maps import MID, SCALE_MM

MEDIA_TYPES = {
    "png": "image/png",
    "jpg": "image/jpeg",
    "obj": "model/obj",
    "mtl": "model/mtl",
    "glb": "model/gltf-binary",
    "usda": "model/vnd.usda",
    "mtlx": "model/mtlx+xml",
    "exr": "image/x-exr",
    "md": "text/markdown",
    "json": "application/json",
}
"""Media type by file name extension."""

ROLES = {
    "LICENSES.md": "licences",
    "mesh/head.obj": "mesh, photo's expression",
    "mesh/parts.obj": "hair, bust, lashes, finer eyes and teeth, photo's expression",
    "mesh/head.mtl": "materials of head.obj",
    "mesh/head.glb": "mesh, neutral with blendshapes",
    "mesh/head.usda": "mesh, neutral with blendshapes and skeleton, weights of the photo's expression",
    "mesh/head.mtlx": "materials as MaterialX",
    "mesh/specular_normal.exr": "normals for head.mtl",
    "mesh/specular_albedo.exr": "specular level for head.mtl",
    "mesh/roughness.exr": "roughness for head.mtl",
    "mesh/head_fine.obj": "mesh, photo's expression, subdivided and displaced",
    "preview/overlay.jpg": "preview of the fit",
    "preview/sheet.jpg": "preview of the result",
}

_PNG_HEADER = struct.Struct(">II BB")
_PNG_CHANNELS = {0: 1, 2: 3, 6: 4}


def describe(avatar: Avatar, files: Mapping[str, bytes], *, timings: bool) -> m.Manifest:
    """Manifest of ``avatar`` whose archive holds ``files`` (name -> content, without the manifest itself)."""
    parts, where = drawn_parts(avatar), map_files(avatar)
    return m.Manifest(
        schema_version=m.SCHEMA_VERSION,
        generator=m.Generator(PROGRAM, __version__),
        options=dict(sorted(avatar.options.items())),
        seed=avatar.seed,
        input=None if avatar.given else _input(avatar),
        given=_given(avatar),
        camera=None if avatar.given else _camera(avatar.fit.camera),
        units="m",
        up="+Y",
        forward="+Z",
        head=_head(avatar),
        maps=[_map(spec, avatar, files[spec.path]) for spec in MAPS if spec.path in files],
        files=[_file(name, files[name]) for name in in_order(files)],
        parts=[m.Part(part.name, part.material.name, part.bone) for part in parts],
        materials=[_material(one, where) for one in {part.material.name: part.material for part in parts}.values()],
        joints=_joints(avatar),
        displacement=m.Displacement(SCALE_MM, MID) if "maps/displacement.png" in files else None,
        reflectance=_reflectance(avatar),
        fit=None if avatar.given else _fit(avatar),
        hair=None if avatar.hair is None else _hair(avatar.hair),
        effects=list(avatar.effects),
        timings_s={key: round(value, 4) for key, value in avatar.timings_s.items()} if timings else None,
        peak_rss_mb=avatar.peak_rss_mb if timings else None,
        models=[m.Model(card.name, card.sha256, card.licence, card.role) for card in avatar.models],
        warnings=list(avatar.all_warnings()),
    )


def _input(avatar: Avatar) -> m.Input:
    width, height = avatar.photo.size
    box = [float(value) for value in avatar.face.box]
    return m.Input(avatar.photo.sha256, width, height, box, float(avatar.face.score))


def _given(avatar: Avatar) -> m.Given | None:
    given = avatar.given
    return None if given is None else m.Given(given.texture_sha256, given.mesh_sha256, *given.size)


def _camera(camera: Camera) -> m.Camera:
    return m.Camera(
        width=camera.width,
        height=camera.height,
        focal_px=float(camera.focal_px),
        principal_point=camera.principal_point.tolist(),
        rotation=camera.rotation.tolist(),
        translation=camera.translation.tolist(),
        yaw_pitch_roll_deg=list(camera.yaw_pitch_roll_deg()),
    )


def _head(avatar: Avatar) -> m.Head:
    head = avatar.head
    return m.Head(
        name=head.name,
        licence=head.licence,
        vertices=len(head.mean),
        polygons=len(head.polygons),
        parts=list(head.part_names),
        blendshapes=list(head.expression_names),
        uv_origin="bottom-left",
    )


def _map(spec: MapSpec, avatar: Avatar, data: bytes) -> m.Map:
    width, height, bits, colour_type = _PNG_HEADER.unpack_from(data, 16)
    wrinkle = wrinkle_of(avatar, spec.role)
    return m.Map(
        path=spec.path,
        role=spec.role,
        colour_space=spec.entry.colour_space,
        bits=bits,
        channels=_PNG_CHANNELS[colour_type],  # type: ignore[arg-type]
        width=width,
        height=height,
        size=len(data),
        sha256=hashlib.sha256(data).hexdigest(),
        frame=spec.frame(avatar),
        coding=m.Coding(*spec.coding(bits), spec.entry.meaning),
        units=None if wrinkle is None else {unit: round(value, 6) for unit, value in wrinkle.units.items()},
    )


def _material(material: Material, where: MapFiles) -> m.Material:
    slots = {
        "colour": material.colour_map, "roughness": material.roughness_map, "specular": material.specular_map,
        "normal": material.normal_map, "displacement": material.displacement_map, "cavity": material.cavity_map,
        "thickness": material.thickness_map,
    }  # fmt: skip
    paths = {slot: where.path(one) for slot, one in slots.items()}
    return m.Material(
        name=material.name,
        colour=list(material.colour),
        opacity=material.opacity,
        alpha=material.alpha,
        cutoff=material.cutoff,
        double_sided=material.double_sided,
        roughness=material.roughness,
        ior=material.ior,
        specular=material.specular,
        subsurface_mm=list(material.subsurface_mm),
        transmission=material.transmission,
        maps={slot: path.removeprefix("../") for slot, path in paths.items() if path is not None},
    )


def _joints(avatar: Avatar) -> list[m.Joint]:
    made = skeleton(avatar.head, avatar.fit.neutral)
    return [
        m.Joint(name, None if parent < 0 else JOINTS[parent], [round(float(value), 6) for value in position])
        for name, parent, position in zip(JOINTS, PARENTS, made.positions, strict=True)
    ]


def _reflectance(avatar: Avatar) -> m.Reflectance | None:
    made = avatar.reflectance
    if made is None:
        return None
    solved = made.integration
    return m.Reflectance(
        quality=avatar.options.get("quality", "standard"),
        width=made.size[0],
        height=made.size[1],
        super_resolution=made.super_resolution,
        runtime=made.runtime,
        precision=made.precision,
        engines=dict(sorted(made.engines.items())),
        tile=made.tile,
        fallbacks=list(made.fallbacks),
        integration=None
        if solved is None
        else m.Integration(
            solved.iterations,
            round(solved.residual, 9),
            round(solved.ignored_fraction, 9),
            None if solved.cut_fraction is None else round(solved.cut_fraction, 9),
        ),
        corrections=[m.Correction(one.name, one.changed, one.texels) for one in made.corrections],
        detail=None
        if made.detail is None
        else m.Detail(
            [m.Octave(one.shortest_mm, one.longest_mm, one.share) for one in made.detail.octaves],
            made.detail.blur_px,
            made.detail.noise,
            dict(made.detail.pixels_per_mm),
        ),
    )


def _file(name: str, data: bytes) -> m.File:
    stem = name.rpartition("/")[2].partition(".")[0]
    role = ROLES.get(name) or (f"texture {stem}" if name.startswith("maps/parts/") else stem)
    return m.File(name, role, MEDIA_TYPES[name.rpartition(".")[2]], len(data), hashlib.sha256(data).hexdigest())


def _hair(hair: Hair) -> m.Hair:
    choice = hair.choice
    return m.Hair(
        style=None if choice.name is None else choice.name.partition("/")[2],
        volume=choice.cut.volume,
        length=choice.cut.length,
        mirrored=choice.cut.mirrored,
        agreement=round(choice.agreement, 4),
        scalp_share=round(min(max(choice.share, 0.0), 1.0), 4),
        colour=[round(float(value), 6) for value in hair.colour.usual],
        grey=round(hair.colour.grey, 4),
        doubts=list(hair.doubts),
    )


def _fit(avatar: Avatar) -> m.FitReport:
    fit, alike = avatar.fit, avatar.similarity
    relative = fit.landmark_rms_px / fit.inter_ocular_px if fit.inter_ocular_px > 0 else None
    return m.FitReport(
        landmark_rms_px=float(fit.landmark_rms_px),
        landmark_rms_iod=None if relative is None else float(relative),
        visible_fraction=float(avatar.texture.visible_fraction),
        identity_similarity=None
        if alike is None
        else m.IdentitySimilarity(float(alike.distance), float(alike.centred_cosine), dict(alike.impostor)),
        light=None if fit.light is None else m.Light("sh9", "camera", fit.light.tolist()),
        eye_light=None if fit.eye_light is None else [float(value) for value in fit.eye_light],
        gaze=None if fit.gaze is None else _gaze(fit.gaze),
        identity=fit.identity.tolist(),
        expression=weights_by_name(avatar.head.expression_names, fit.expression),
        warnings=list(fit.warnings),
    )


def _gaze(gaze: Gaze) -> m.Gaze:
    pupil = None if gaze.pupil_m is None else round(2e3 * gaze.pupil_m, 2)
    return m.Gaze(gaze.yaw_deg, gaze.pitch_deg, len(gaze.irises), pupil)
