"""``manifest.json``: contents and provenance of an archive.

The classes are plain dataclasses, so writing a manifest costs no import of pydantic (0.15 to 0.3 s, a tenth of a whole
run); pydantic makes the published JSON Schema (``docs/manifest.schema.json``) from them.

``timings_s`` and ``peak_rss_mb`` differ from run to run, whereas the same photo, options and seed give the same archive
to the byte. So both keys are null.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Interval, Len, MinLen

from service.errors import NumericFault

SCHEMA_VERSION: Literal["1.0"] = "1.0"
"""Major: a key changed its meaning or was removed; minor: a key was added."""

Fraction = Annotated[float, Interval(ge=0, le=1)]
Sha256 = Annotated[str, Len(64, 64)]
Triple = Annotated[list[float], Len(3, 3)]
JsonValue = str | int | float | bool | None | list[Any] | dict[str, Any]


class _Strict:
    __pydantic_config__ = {"extra": "forbid", "use_attribute_docstrings": True}  # noqa: RUF012 - pydantic's protocol


@dataclasses.dataclass(frozen=True)
class Generator(_Strict):
    """The program that wrote the archive."""

    name: str
    version: str


@dataclasses.dataclass(frozen=True)
class Input(_Strict):
    """The photo, of several the best, of which only the part in preview/overlay.jpg is in the archive."""

    sha256: str
    """Hex digest of the photo's bytes as they came in; empty where the pixels did not come from a file."""
    width: Annotated[int, Gt(0)]
    """Pixels of the upright photo."""
    height: Annotated[int, Gt(0)]
    face_box: Annotated[list[float], Len(4, 4)]
    """Detector box of the fitted face: x0, y0, x1, y1 in photo pixels."""
    face_score: Fraction


@dataclasses.dataclass(frozen=True)
class Given(_Strict):
    """External mesh and texture that the avatar was made from (avatarme maps); neither file is in the archive."""

    texture_sha256: Sha256
    mesh_sha256: Sha256
    width: Annotated[int, Gt(0)]
    """Pixels of the texture."""
    height: Annotated[int, Gt(0)]


@dataclasses.dataclass(frozen=True)
class CameraEntry(_Strict):
    """A vertex X of mesh/head.obj lands on focal_px * (x/z, y/z) + principal_point, (x, y, z) = rotation X +
    translation; x right, y down, z forward, centre of the top left pixel at (0.5, 0.5), in the upright photo.
    """

    width: Annotated[int, Gt(0)]
    height: Annotated[int, Gt(0)]
    focal_px: Annotated[float, Gt(0)]
    principal_point: Annotated[list[float], Len(2, 2)]
    rotation: Annotated[list[Triple], Len(3, 3)]
    """Rows of the rotation matrix."""
    translation: Triple
    """Metres."""
    yaw_pitch_roll_deg: Triple
    """The head's turn in degrees: yaw > 0 towards the image right, pitch > 0 looking up, roll > 0 clockwise."""


@dataclasses.dataclass(frozen=True)
class FileEntry(_Strict):
    """One file of the archive."""

    path: str
    role: str
    media_type: str
    size: Annotated[int, Gt(0)]
    """Bytes."""
    sha256: Sha256


@dataclasses.dataclass(frozen=True)
class Coding(_Strict):
    """value = (code - zero) / scale."""

    zero: float
    scale: Annotated[float, Gt(0)]
    meaning: str


@dataclasses.dataclass(frozen=True)
class Map(_Strict):
    """One map: an image on the head's chart, row 0 = top."""

    path: str
    role: str
    colour_space: Literal["srgb", "linear", "data"]
    """srgb: colours; linear: quantities that may be averaged as they are; data: vectors or codes."""
    bits: Literal[8, 16]
    channels: Literal[1, 3, 4]
    width: Annotated[int, Gt(0)]
    height: Annotated[int, Gt(0)]
    size: Annotated[int, Gt(0)]
    """Bytes of the file."""
    sha256: Sha256
    frame: Literal["object", "tangent"] | None
    """For normals: object is head space (+Y up, +Z out of the face), tangent is +Y (OpenGL)."""
    coding: Coding
    units: dict[str, float] | None = None
    """For wrinkles: the blendshapes that fold the skin, and their weights in the photo, at which the map is this."""


@dataclasses.dataclass(frozen=True)
class Displacement(_Strict):
    """How maps/displacement.png codes heights."""

    scale_mm: Annotated[float, Gt(0)]
    """Millimetres per code: height_mm = (code - mid) * scale_mm."""
    mid: Annotated[int, Ge(0)]


@dataclasses.dataclass(frozen=True)
class Integration(_Strict):
    """How maps/displacement.png was found from the specular normals."""

    iterations: Annotated[int, Ge(0)]
    residual: Annotated[float, Ge(0)]
    """Norm of the residual before the last iteration over that of the right-hand side."""
    ignored_fraction: Fraction
    """Share of the texels whose normals were not usable."""


@dataclasses.dataclass(frozen=True)
class CorrectionEntry(_Strict):
    """A rule that altered what the photo or a network gave; docs/corrections.md says what each is for."""

    name: str
    changed: Annotated[int, Ge(0)]
    """Texels that it changed by more than 1/255."""
    texels: Annotated[int, Ge(0)]
    """How many it looked at: of the map, or of the small chart on which it works."""


@dataclasses.dataclass(frozen=True)
class Octave(_Strict):
    """How much of the detail of some periods is the photo's own."""

    shortest_mm: Annotated[float, Ge(0)]
    longest_mm: Annotated[float, Ge(0)]
    share: Fraction
    """What the photo tells of it on skin that it shows, by area; the rest is made up, or smooth with --detail 0."""


@dataclasses.dataclass(frozen=True)
class Detail(_Strict):
    """The photo's own detail, beyond a texture of 576 x 384."""

    octaves: list[Octave]
    """Finest first."""
    blur_px: Annotated[float, Ge(0)]
    """Standard deviation of the photo's point spread at the face, in pixels."""
    noise: Annotated[float, Ge(0)]
    """Standard deviation of its noise there, of sRGB-coded luma, 1 = white."""
    pixels_per_mm: dict[str, float]
    """The photo's pixels per millimetre of the surface, by region; regions that it does not show are missing."""


@dataclasses.dataclass(frozen=True)
class ReflectanceEntry(_Strict):
    """How the networks ran."""

    quality: Literal["draft", "standard", "high", "reference"]
    width: Annotated[int, Gt(0)]
    """Of albedo, normals and displacement."""
    height: Annotated[int, Gt(0)]
    super_resolution: bool
    """Whether a network enlarged the texture; otherwise it was resampled."""
    runtime: Literal["onnxruntime", "openvino"]
    """Of most networks."""
    precision: Literal["fp32", "bf16"]
    engines: dict[str, str]
    """Runtime and precision of each network, for example "openvino bf16"."""
    tile: Annotated[int, Gt(0)]
    """Inner side of the tiles; the result does not depend on it."""
    fallbacks: list[str]
    """Stable codes of what ran differently than on another machine or with other options."""
    integration: Integration | None
    corrections: list[CorrectionEntry]
    """Those that ran, in order."""
    detail: Detail | None
    """Null where there was no photo, or the texture was only resampled."""


@dataclasses.dataclass(frozen=True)
class UsedPhoto(_Strict):
    """A photo that the avatar was made from."""

    sha256: str
    """As ``input.sha256``."""
    face_box: Annotated[list[float], Len(4, 4)]
    camera: CameraEntry
    """The head in this photo has its own expression; that of ``fit`` is the first photo's."""
    landmark_rms_px: Annotated[float, Ge(0)]
    used_for: list[str]
    """What it told: shape, texture, albedo, detail; the first also expression, eyes, hair."""
    texture_share: Fraction
    """Share of what the texture shows that is from this photo."""
    expression: dict[str, float]
    """Non-zero activations of blendshapes in it."""
    warnings: list[str]


@dataclasses.dataclass(frozen=True)
class LeftOut(_Strict):
    """A photo that was given and not used."""

    sha256: str
    code: str
    """Of the error that it would be alone, or "same-photo"."""
    message: str


@dataclasses.dataclass(frozen=True)
class HeadEntry(_Strict):
    """The head model that was fitted."""

    name: str
    licence: str
    vertices: Annotated[int, Gt(0)]
    """Vertices of mesh/head.obj, in its order in every archive made with this head model."""
    polygons: Annotated[int, Gt(0)]
    parts: Annotated[list[str], MinLen(1)]
    blendshapes: list[str]
    """Morph targets of mesh/head.glb in order; ARKit's names where the unit is one of the 52."""
    uv_origin: Literal["bottom-left"]
    """Of OBJ and USD; v is flipped in the GLB, as glTF requires."""


@dataclasses.dataclass(frozen=True)
class IdentitySimilarity(_Strict):
    """Similarity of the rendered head and the photo by an identity network; only meaningful beside ``impostor``."""

    distance: Annotated[float, Ge(0)]
    centred_cosine: Annotated[float, Interval(ge=-1, le=1)]
    impostor: dict[str, float]
    """The same numbers between different people."""


@dataclasses.dataclass(frozen=True)
class Light(_Strict):
    """Light on the face as spherical harmonics of radiance up to degree 2, linear RGB; docs/archive.md has the formula.

    Scaled so that irradiance over pi has a mean luminance of one over the seen skin: how bright the light is cannot be
    told from how dark the skin is. The skin's mean colour is in it for the same reason.
    """

    basis: Literal["sh9"]
    frame: Literal["camera"]
    coefficients: Annotated[list[Triple], Len(9, 9)]


@dataclasses.dataclass(frozen=True)
class GazeEntry(_Strict):
    """Where both eyes look, in the head's frame; already part of ``expression`` as the units eyeLook*."""

    yaw_deg: float
    """> 0 to the subject's left."""
    pitch_deg: float
    """> 0 upwards."""
    irises_seen: Annotated[int, Interval(ge=0, le=2)]
    """Number of eyes it was measured on. 0: not visible, and the eyes look straight ahead (warning "gaze-not-seen")."""


@dataclasses.dataclass(frozen=True)
class FitReport(_Strict):
    """How well the head fits the photo."""

    landmark_rms_px: Annotated[float, Ge(0)]
    landmark_rms_iod: Annotated[float, Ge(0)] | None
    """The same as a share of the inter-ocular distance; null where that distance is not known."""
    visible_fraction: Fraction
    """Share of the face that the photo shows."""
    identity_similarity: IdentitySimilarity | None
    light: Light | None
    """Null where options.fit is "landmarks", or, with the warning "no-light", where too little lit skin is seen."""
    eye_light: Triple | None
    """Radiance of a white diffuse surface in place of the sclera, linear RGB of the photo; null if not measured."""
    gaze: GazeEntry | None
    """Null for a head without eyeballs."""
    identity: list[float]
    """Coefficients of the head model in standard deviations."""
    expression: dict[str, float]
    """Non-zero activations of blendshapes in the photo."""
    warnings: list[str]


@dataclasses.dataclass(frozen=True)
class MaterialEntry(_Strict):
    """A surface, from which the materials of all files are written; maps are paths in the archive."""

    name: str
    colour: Triple
    """Linear RGB; multiplies the map."""
    opacity: Fraction
    """Multiplies the alpha of the colour map."""
    alpha: Literal["opaque", "mask", "blend"]
    cutoff: Fraction
    """Alpha below which a mask is cut off."""
    double_sided: bool
    roughness: Fraction
    """Square root of GGX alpha, where there is no map."""
    ior: Annotated[float, Ge(1)]
    specular: Fraction
    """Share of the F0 that ior gives, where there is no map."""
    subsurface_mm: Triple
    """Mean free path of red, green and blue."""
    maps: dict[str, str]
    """By what they are for: colour, roughness, specular, normal, displacement, cavity, thickness, anisotropy, and
    strand: place from root to tip, identity and depth."""
    anisotropy: Fraction = 0.0
    """How much wider a highlight is across the strands of hair than along them, as glTF has it."""


@dataclasses.dataclass(frozen=True)
class Part(_Strict):
    """A mesh of the files under mesh/."""

    name: str
    material: str
    bone: Literal["neck", "head", "jaw", "eye_left", "eye_right"]
    """The joint that carries it."""


@dataclasses.dataclass(frozen=True)
class Joint(_Strict):
    """A joint of the skeleton in mesh/head.usda."""

    name: str
    parent: str | None
    position: Triple
    """Metres."""


@dataclasses.dataclass(frozen=True)
class Hair(_Strict):
    """What hair the head wears, and how sure that is."""

    kind: str
    """What one would call it; a "bald" head wears no strands, nor does "none"."""
    probabilities: dict[str, Fraction]
    """Of every kind that was compared, likeliest first; empty where none was."""
    style: dict[str, JsonValue] | None
    """Numbers of the style, which the option "hair" takes as they are; null without strands."""
    strands: Annotated[int, Ge(0)]
    agreement: Fraction
    """Intersection over union of its silhouette and the hair in the photo; 0 where none was compared."""
    seen: Fraction
    """Share of the strands' points that the photo shows; what it does not show is likely and no more."""
    colour: Triple | None
    """Of the usual strands, linear RGB: under white light where the albedo was made, else in the photo's."""
    melanin: Annotated[list[float], Len(2, 2)] | None
    """Usual concentrations of eumelanin and pheomelanin, as d'Eon et al. 2011 have them."""
    dyed: bool
    """Whether the colour is none that melanin gives."""
    doubts: list[str]
    """Stable codes, as warnings have them."""


@dataclasses.dataclass(frozen=True)
class Beard(_Strict):
    """The beard that the photo shows, where it is more than stubble."""

    strands: Annotated[int, Ge(1)]
    length_mm: Annotated[float, Ge(0)]
    """Of the usual strands."""
    colour: Triple
    """As that of the hair."""


@dataclasses.dataclass(frozen=True)
class ModelEntry(_Strict):
    """One data file of the program that was used."""

    name: str
    sha256: str
    licence: str
    role: str


@dataclasses.dataclass(frozen=True)
class Overlay(_Strict):
    """Where preview/overlay.jpg has a part of the photo."""

    crop: Annotated[list[int], Len(4, 4)]
    """The part, in pixels of the upright photo: x0, y0, x1, y1."""
    panel: Annotated[list[int], Len(4, 4)]
    """Where the picture shows it: x0, y0, x1, y1."""


@dataclasses.dataclass(frozen=True)
class Manifest(_Strict):
    """Contents of an avatar archive."""

    schema_version: Literal["1.0"]
    generator: Generator
    options: dict[str, JsonValue]
    """As requested."""
    seed: int
    input: Input | None
    """Null for an external mesh, as are camera and fit: there was no photo."""
    given: Given | None
    """Null for a photo."""
    camera: CameraEntry | None
    units: Literal["m"]
    up: Literal["+Y"]
    forward: Literal["+Z"]
    head: HeadEntry
    maps: list[Map]
    files: list[FileEntry]
    """Every file of the archive except this one."""
    parts: list[Part]
    materials: list[MaterialEntry]
    joints: list[Joint]
    displacement: Displacement | None
    reflectance: ReflectanceEntry | None
    """Null where only texture, confidence and shape normals were requested."""
    fit: FitReport | None
    hair: Hair | None
    """Null for an external mesh."""
    effects: list[str]
    """Effects that the previews simulate."""
    timings_s: dict[str, float] | None
    """Seconds per stage; always null, because they differ from run to run."""
    peak_rss_mb: float | None
    """Largest resident memory in MiB; always null, likewise."""
    models: list[ModelEntry]
    warnings: list[str]
    """Stable codes of every stage; service/data/words.json has a sentence for each."""
    overlay: Overlay | None = None
    """Null for an external mesh."""
    photos: list[UsedPhoto] = dataclasses.field(default_factory=list)
    """All photos of the person that were used; that of ``input``, ``camera`` and ``fit`` first, the others by hash."""
    left_out: list[LeftOut] = dataclasses.field(default_factory=list)
    beard: Beard | None = None
    """Null where the photo shows none."""


def to_json(manifest: Manifest) -> bytes:
    """UTF-8 JSON, indented, keys in the order of the classes, newline at the end.

    NumericFault: a number is NaN or infinite; the message names where.
    """
    content = dataclasses.asdict(manifest)
    try:
        return (json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode()
    except ValueError as error:
        raise NumericFault(f"the manifest would hold a number that is not finite at {_not_finite(content)}") from error


def json_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of ``manifest.json``."""
    from pydantic import TypeAdapter

    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **TypeAdapter(Manifest).json_schema()}


def _not_finite(value: object, path: str = "$") -> str:
    """Path of the first number that JSON cannot hold."""
    if isinstance(value, dict):
        items = [(f"{path}.{key}", item) for key, item in value.items()]
    elif isinstance(value, list | tuple):
        items = [(f"{path}[{index}]", item) for index, item in enumerate(value)]
    else:
        broken = isinstance(value, float) and value - value != 0
        return path if broken else ""
    return next((found for name, item in items if (found := _not_finite(item, name))), "")


PUBLISHED = Path(__file__).parent / "data" / "manifest.schema.json"
"""Shipped with the package; docs/manifest.schema.json is a link to it."""


def schema_text() -> str:
    """The published form of :func:`json_schema`."""
    return json.dumps(json_schema(), indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    PUBLISHED.write_text(schema_text(), encoding="utf-8")
