"""An unpacked archive as three readers see it, none of which is ours: glTF's JSON, the MTL file, and USD's own library.

Each gives the same list of :class:`Surface`, so that a renderer without loaders of its own can draw all three.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from service.geometry.mesh import area_normals

Float = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
FORMATS = {"glb": "head.glb", "obj": "head.obj", "usd": "head.usda"}
KINDS = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}


@dataclass
class Surface:
    """A mesh in metres, +Y up, in the photo's expression, with one material; images are linear, row 0 at v = 1.

    Attributes:
        points, normals, uv, triangles: (N, 3), (N, 3), (N, 2) with its origin bottom left, (T, 3).
        colour: (h, w, 3); opacity: (h, w), cut off already where the format says so; roughness, f0: (h, w).
        normal: (h, w, 3) tangent space, unit; None without a map.
    """

    name: str
    points: Float
    normals: Float
    uv: Float
    triangles: Ints
    colour: Float
    opacity: Float
    roughness: Float
    f0: Float
    normal: Float | None


def surfaces(folder: Path, kind: str) -> list[Surface]:
    """Meshes of ``FORMATS[kind]`` of an unpacked archive, those left out that nothing is seen of."""
    read = {"glb": _glb, "obj": _obj, "usd": _usd}[kind]
    return [one for one in read(folder) if one.opacity.max() > 0]


def linear(codes: Float) -> Float:
    """Linear values of sRGB in [0, 1] (IEC 61966-2-1)."""
    return np.asarray(np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4))


def cut(alpha: Float, cutoff: float) -> Float:
    """Alpha (h, w) cut off between texels, at four times the size."""
    fine = cv2.resize(alpha, None, fx=4, fy=4, interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine >= cutoff, np.float64)


def decoded(image: npt.NDArray[Any]) -> Float:
    """(h, w, 4) in [0, 1] of what OpenCV read: of one channel three, and alpha 1 where there is none."""
    largest = {np.dtype(np.uint8): 255.0, np.dtype(np.uint16): 65535.0}.get(image.dtype, 1.0)
    values = np.atleast_3d(image.astype(np.float64) / largest)
    rgb = np.repeat(values, 3, 2) if values.shape[2] == 1 else values[..., 2::-1]
    alpha = values[..., 3:] if values.shape[2] == 4 else np.ones_like(rgb[..., :1])
    return np.concatenate([rgb, alpha], 2)


def exr(data: bytes) -> npt.NDArray[np.float16]:
    """(h, w) or (h, w, 3) of an OpenEXR file, as Mitsuba's reader has them."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    stream = mi.MemoryStream()
    stream.write(data)
    stream.seek(0)
    return np.array(mi.Bitmap(stream))


def picture(path: Path) -> Float:
    """(h, w, 4) of a file."""
    if path.suffix == ".exr":
        values = np.atleast_3d(exr(path.read_bytes()))
        return decoded(values[..., ::-1])
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None, path
    return decoded(image)


def _flat(value: float) -> Float:
    return np.full((1, 1), float(value))


def _unit(image: Float) -> Float:
    return np.asarray(image / np.maximum(np.linalg.norm(image, axis=2, keepdims=True), 1e-6))


# --- glTF 2.0 ---------------------------------------------------------------------------------------------------------


def _glb(folder: Path) -> list[Surface]:
    told, binary = gltf((folder / "mesh" / FORMATS["glb"]).read_bytes())
    weights = next(node["extras"]["expressionWeights"] for node in told["nodes"] if "extras" in node)
    found = []
    for mesh in told["meshes"]:
        part = mesh["primitives"][0]
        by_name = dict(zip(mesh.get("extras", {}).get("targetNames", ()), part.get("targets", ()), strict=True))
        moved = [(weight, by_name[name]) for name, weight in weights.items() if name in by_name]
        points, normals = (
            accessor(told, binary, part["attributes"][key])
            + sum((weight * accessor(told, binary, one[key]) for weight, one in moved), np.zeros(3))
            for key in ("POSITION", "NORMAL")
        )
        uv = accessor(told, binary, part["attributes"]["TEXCOORD_0"]) * [1, -1] + [0, 1]
        triangles = accessor(told, binary, part["indices"]).astype(np.int64).reshape(-1, 3)
        material = told["materials"][part["material"]]
        found.append(Surface(mesh["name"], points, normals, uv, triangles, *_gltf_material(told, binary, material)))
    return found


def gltf(data: bytes) -> tuple[dict[str, Any], bytes]:
    """JSON and buffer of a GLB."""
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def values_of(told: dict[str, Any], binary: bytes, at: dict[str, Any], count: int, wide: int) -> npt.NDArray[Any]:
    """(count, wide) numbers at a place of a buffer view."""
    start = told["bufferViews"][at["bufferView"]].get("byteOffset", 0) + at.get("byteOffset", 0)
    return np.frombuffer(binary, KINDS[at.get("componentType", 5126)], count * wide, start).reshape(count, wide)


def accessor(told: dict[str, Any], binary: bytes, index: int) -> Float:
    """(N, C) of a glTF accessor."""
    one = told["accessors"][index]
    wide, count = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[one["type"]], one["count"]
    rows = values_of(told, binary, one, count, wide) if "bufferView" in one else np.zeros((count, wide))
    rows = rows.astype(np.float64)
    if "sparse" in one:
        few = one["sparse"]
        index_rows = values_of(told, binary, few["indices"], few["count"], 1)[:, 0]
        rows[index_rows] = values_of(told, binary, few["values"], few["count"], wide)
    return rows


def _gltf_material(told: dict[str, Any], binary: bytes, one: dict[str, Any]) -> tuple[Any, ...]:
    def texture(place: dict[str, Any] | None) -> Float | None:
        if place is None:
            return None
        view = told["bufferViews"][told["images"][told["textures"][place["index"]]["source"]]["bufferView"]]
        start = view.get("byteOffset", 0)
        data = np.frombuffer(binary[start : start + view["byteLength"]], np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
        assert image is not None
        return decoded(image)

    base, extra = one["pbrMetallicRoughness"], one.get("extensions", {})
    factor = np.array(base.get("baseColorFactor", [1.0, 1, 1, 1]))
    colour = texture(base.get("baseColorTexture"))
    colour = np.ones((1, 1, 4)) if colour is None else np.concatenate([linear(colour[..., :3]), colour[..., 3:]], 2)
    colour = colour * factor
    mode = one.get("alphaMode", "OPAQUE")
    opacity = np.ones((1, 1)) if mode == "OPAQUE" else colour[..., 3]
    if mode == "MASK":
        opacity = cut(opacity, one.get("alphaCutoff", 0.5))
    rough = texture(base.get("metallicRoughnessTexture"))
    roughness = _flat(base["roughnessFactor"]) if rough is None else rough[..., 1] * base["roughnessFactor"]
    specular = extra.get("KHR_materials_specular", {})
    level = texture(specular.get("specularTexture"))
    ior = extra.get("KHR_materials_ior", {}).get("ior", 1.5)
    f0 = (
        ((ior - 1) / (ior + 1)) ** 2
        * specular.get("specularFactor", 1.0)
        * (np.ones((1, 1)) if level is None else level[..., 3])
    )
    normal = texture(one.get("normalTexture"))
    return colour[..., :3], opacity, roughness, f0, None if normal is None else _unit(2 * normal[..., :3] - 1)


# --- Wavefront OBJ and MTL with its PBR keys --------------------------------------------------------------------------


def _obj(folder: Path) -> list[Surface]:
    mesh = folder / "mesh"
    drawn = {one["name"] for one in json.loads((folder / "manifest.json").read_text())["parts"]}
    files = [mesh / FORMATS["obj"], *([mesh / "parts.obj"] if (mesh / "parts.obj").is_file() else [])]
    materials = _mtl(mesh / "head.mtl", folder)
    found = []
    for file in files:
        found += [one for one in _obj_file(file, materials) if one.name in drawn]
    return found


def _obj_file(path: Path, materials: dict[str, tuple[Any, ...]]) -> list[Surface]:
    rows: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
    parts: list[tuple[str, list[str], list[list[list[int]]]]] = []
    for line in path.read_text().splitlines():
        key, *rest = line.split() or [""]
        if key in rows:
            rows[key].append([float(value) for value in rest])
        elif key == "o":
            parts.append((rest[0], [], []))
        elif key == "usemtl":
            parts[-1][1].append(rest[0])
        elif key == "f":
            corner = [[int(value) - 1 for value in one.split("/")] for one in rest]
            parts[-1][2].extend([[corner[0], corner[k], corner[k + 1]] for k in range(1, len(corner) - 1)])
    points, uv, normals = (np.array(rows[key]) for key in ("v", "vt", "vn"))
    found = []
    for name, used, corners in parts:
        triangles = np.array(corners)
        own, place = np.unique(triangles.reshape(-1, triangles.shape[2]), axis=0, return_inverse=True)
        # Without normals a smoothing group stands for them.
        has = own.shape[1] == 3
        turned = normals[own[:, 2]] if has else area_normals(points, triangles[..., 0])[own[:, 0]]
        at = points[own[:, 0]], np.asarray(turned, np.float64), uv[own[:, 1]]
        found.append(Surface(name, *at, place.reshape(-1, 3).astype(np.int64), *materials[used[0]]))
    return found


def _mtl(path: Path, folder: Path) -> dict[str, tuple[Any, ...]]:
    found: dict[str, dict[str, list[str]]] = {}
    for line in path.read_text().splitlines():
        key, *rest = line.split() or [""]
        if key == "newmtl":
            found[rest[0]] = {}
        elif key:
            found[list(found)[-1]][key] = rest
    told = {one["name"]: one for one in json.loads((folder / "manifest.json").read_text())["materials"]}
    return {name: _mtl_material(path.parent, one, told.get(name, {})) for name, one in found.items()}


def _mtl_material(folder: Path, keys: dict[str, list[str]], told: dict[str, Any]) -> tuple[Any, ...]:
    """MTL knows no cutoff, so alpha is cut off where the manifest says so."""

    def number(key: str) -> float:
        return float(keys[key][0])

    def image(key: str) -> Float | None:
        return picture(folder / keys[key][-1]) if key in keys else None

    colour, level, rough, bump = (image(key) for key in ("map_Kd", "map_Ks", "map_Pr", "norm"))
    albedo = np.array([float(value) for value in keys["Kd"]]) * (
        np.ones((1, 1, 3)) if colour is None else linear(colour[..., :3])
    )
    opacity = _flat(number("d"))
    if "map_d" in keys and colour is not None:
        opacity = opacity * colour[..., 3]
        if told.get("alpha") == "mask":
            opacity = cut(opacity, told["cutoff"])
    f0 = (
        ((number("Ni") - 1) / (number("Ni") + 1)) ** 2 / 0.5 * (_flat(number("Ks")) if level is None else level[..., 0])
    )
    roughness = _flat(number("Pr")) if rough is None else rough[..., 0]
    return albedo, opacity, roughness, f0, None if bump is None else _unit(2 * bump[..., :3] - 1)


# --- USD --------------------------------------------------------------------------------------------------------------


def _usd(folder: Path) -> list[Surface]:
    from pxr import Usd, UsdGeom, UsdShade, UsdSkel

    stage = Usd.Stage.Open(str(folder / "mesh" / FORMATS["usd"]))
    root = UsdSkel.Root(stage.GetDefaultPrim())
    UsdSkel.BakeSkinning(root, _interval())
    found = []
    for prim in stage.Traverse():
        if not prim.IsA(UsdGeom.Mesh):
            continue
        mesh = UsdGeom.Mesh(prim)
        points, normals = (np.array(_at(one)) for one in (mesh.GetPointsAttr(), mesh.GetNormalsAttr()))
        places = np.array(UsdGeom.PrimvarsAPI(prim).GetPrimvar("st").ComputeFlattened())
        counts = np.array(mesh.GetFaceVertexCountsAttr().Get())
        corners = np.array(mesh.GetFaceVertexIndicesAttr().Get())
        places = places[corners] if len(places) != len(corners) else places  # one for each vertex, or for each corner
        first = np.concatenate([[0], np.cumsum(counts)[:-1]])
        fan = [np.stack([first, first + k, first + k + 1], 1)[counts > k + 1] for k in range(1, int(counts.max()) - 1)]
        triangles = np.arange(len(corners))[np.concatenate(fan)]
        material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        made = _preview_surface(folder / "mesh", material)
        found.append(Surface(prim.GetName(), points[corners], normals[corners], places, triangles, *made))
    return found


def _interval() -> Any:
    from pxr import Gf

    return Gf.Interval.GetFullInterval()


def _at(attribute: Any) -> Any:
    """Its value, of the first sample where baking left samples."""
    times = attribute.GetTimeSamples()
    return attribute.Get(times[0]) if times else attribute.Get()


def _preview_surface(folder: Path, material: Any) -> tuple[Any, ...]:
    shader = material.ComputeSurfaceSource()[0]

    def read(name: str, otherwise: Any = None) -> Float:
        """(h, w, 4) of a texture, or (1, 1, 4) of a value."""
        given = shader.GetInput(name)
        if not given:
            return np.asarray(np.ones((1, 1, 4)) * otherwise)
        source = given.GetConnectedSources()[0]
        if not source:
            value = np.atleast_1d(np.array(given.Get(), np.float64))
            return np.asarray(np.ones((1, 1, 4)) * np.concatenate([value, [1.0]] if len(value) == 3 else [value]))
        from pxr import UsdShade

        node = UsdShade.Shader(source[0].source.GetPrim())
        values = picture(folder / node.GetInput("file").Get().path)
        if node.GetInput("sourceColorSpace").Get() == "sRGB":
            values = np.concatenate([linear(values[..., :3]), values[..., 3:]], 2)
        scale, bias = ((node.GetInput(key).Get() if node.GetInput(key) else rest) for key, rest in
                       (("scale", (1, 1, 1, 1)), ("bias", (0, 0, 0, 0))))  # fmt: skip
        values = values * np.array(scale) + np.array(bias)
        return np.repeat(values[..., 3:], 4, 2) if source[0].sourceName == "a" else values

    ior = read("ior", 1.5)[0, 0, 0]
    opacity, cutoff = read("opacity", 1.0)[..., 0], read("opacityThreshold", 0.0)[0, 0, 0]
    normal = read("normal")[..., :3] if shader.GetInput("normal") else None
    return (
        read("diffuseColor")[..., :3], cut(opacity, cutoff) if cutoff > 0 else opacity, read("roughness")[..., 0],
        ((ior - 1) / (ior + 1)) ** 2 * read("specularColor", 1.0)[..., 0], None if normal is None else _unit(normal),
    )  # fmt: skip
