"""The texture stage: one fitted photo becomes the maps of a whole head."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes import paint as parts
from service.anatomy.eyes.measure import EyeTone, measure_eyes
from service.anatomy.eyes.sclera import ALBEDO as SCLERA_ALBEDO
from service.anatomy.lashes.line import LASH_LINE, lash_line
from service.anatomy.mouth import paint as mouth
from service.anatomy.mouth.paint import TOOTH_HUE
from service.anatomy.teeth.measure import measure_teeth, toothlike
from service.colour import linear_to_srgb, srgb_to_linear, to_bytes
from service.errors import NumericFault
from service.face.fit.result import Fit
from service.geometry.chart import Chart, chart_points
from service.geometry.normals import face_normals
from service.geometry.raster import signed_area
from service.head.model import HeadModel
from service.ledger import SEEN_CHANGE, Ledger
from service.photo.photo import Photo
from service.texture.inpainting.inpaint import Completed, complete_skin, opacity
from service.texture.result import MIRRORED, SEEN, Texture
from service.texture.segmentation.glasses import GLASSES, frames
from service.texture.segmentation.skin import cap_or_mask, judge, lit_skin
from service.texture.segmentation.skin_model import Skin
from service.texture.segmentation.zones import Zones
from service.texture.shape import depth_map, shape_normals
from service.texture.unwrap import Unwrapped, unwrap

Float = npt.NDArray[np.float32]

DEFAULT_SKIN = np.array([0.75, 0.59, 0.51], np.float32)
"""Skin of a photo that shows none, sRGB."""

DARKEST = 1e-3
"""Linear value of the darkest white of an eye: its light is divided by."""

LEAST_SCALP_TEXELS = 60
LITTLE_SEEN = 0.25


def make_texture(
    photo: Photo, head: HeadModel, fit: Fit, chart: Chart, without: Collection[str] = ()
) -> Texture:
    """Unwrap the photo on the fitted head and fill in the rest.

    Args:
        photo: the upright photo that was fitted.
        head: the model, the one that ``chart`` was built from.
        fit: camera and vertices.
        chart: gives the size of the maps, 576 x 384 for AvatarMe's texture.
        without: names of corrections that do not run.

    Raises:
        NumericFault: vertices or camera are not finite, or a map would not be.
    """
    _require_finite(fit)
    unwrapped = unwrap(photo, fit, chart)
    zones = Zones.of(chart)
    ledger = Ledger(without)
    rims = np.zeros(len(unwrapped.weight), bool)
    if ledger.runs(GLASSES):
        rims = frames(chart, unwrapped, zones)
        ledger.count(GLASSES, int(rims.sum()), rims.size)
    bare = np.where(rims, np.float32(0), np.float32(1))
    trust, seen, skin = judge(chart, unwrapped, zones, ledger)
    trust, seen = trust * bare, seen * bare
    lit = lit_skin(chart, unwrapped, zones, skin) * bare
    hair = _scalp_colour(unwrapped, zones)
    fallback = DEFAULT_SKIN if skin is None else skin.colour
    completed = complete_skin(chart, unwrapped.colour, seen, trust, fallback, hair)
    colour, confidence, white, iris = _paint_parts(photo, chart, fit, unwrapped, zones, completed, skin, ledger)

    exact, tangent = shape_normals(chart, fit.vertices)
    texture = chart.fill_outside(chart.spread(colour))
    depth = depth_map(chart, fit.vertices)
    for name, values in (("texture", texture), ("normals", exact), ("tangent normals", tangent), ("depth", depth)):
        if not np.isfinite(values).all():
            raise NumericFault(f"the {name} map has {int((~np.isfinite(values)).sum())} values that are not finite")
    fraction = visible_fraction(chart, fit, unwrapped, zones)
    code = chart.fill_outside(chart.spread(confidence[:, None])[..., 0]).astype(np.uint8)
    own, reflected, lit_map = np.moveaxis(chart.spread(np.stack([completed.seen, completed.from_mirror, lit], 1)), 2, 0)
    shown = np.rint(255 * np.clip(own * lit_map + reflected * lit_map[:, ::-1], 0, 1))
    shown = chart.fill_outside(shown).astype(np.uint8)
    worn = None if skin is None else cap_or_mask(chart, colour, unwrapped.normal, skin)
    told = {"little-seen": fraction < LITTLE_SEEN, "glasses-removed": rims.any(), "face-covered": worn is not None}
    warnings = tuple(code for code, true in told.items() if true)
    return Texture(
        to_bytes(texture), code, shown, exact, tangent, depth, chart.mask, fraction, warnings, white, worn, iris,
        ledger.applied,
    )


def _require_finite(fit: Fit) -> None:
    camera = fit.camera
    numbers = {
        "vertices": fit.vertices,
        "focal length": np.array([camera.focal_px]),
        "rotation": camera.rotation,
        "translation": camera.translation,
        "principal point": camera.principal_point,
    }
    for name, values in numbers.items():
        if not np.isfinite(values).all():
            raise NumericFault(f"the fit's {name} is not finite: {int((~np.isfinite(values)).sum())} bad values")


def _scalp_colour(unwrapped: Unwrapped, zones: Zones) -> Float | None:
    """(3,) sRGB median of the scalp where the photo shows it, well behind the hairline if it shows that."""
    for inside in (0.95, 0.7):
        chosen = (zones.scalp > inside) & zones.skin & (unwrapped.weight > 0.08)
        if chosen.sum() >= LEAST_SCALP_TEXELS:
            return linear_to_srgb(np.median(srgb_to_linear(unwrapped.colour[chosen]), 0))
    return None


def _paint_parts(
    photo: Photo, chart: Chart, fit: Fit, unwrapped: Unwrapped, zones: Zones, completed: Completed, skin: Skin | None,
    ledger: Ledger,
) -> tuple[Float, Float, Float, Float | None]:
    """Colours (N, 3) and confidence codes (N,) of all parts, the skin's from ``completed``; their light (3,); the
    albedo of the irises (3,), None where none was seen.
    """
    seen_weight = opacity(unwrapped.weight)
    irises = () if fit.gaze is None else fit.gaze.irises
    tone = measure_eyes(photo.pixels, irises)
    # Eyes without a visible iris point elsewhere than in the photo, which shows lids or glass in their place.
    eyes_seen = seen_weight * float(fit.gaze is None or tone.iris is not None)
    face = (zones.face > 0.5) & zones.skin & (unwrapped.weight > 0.25)
    light = parts.judge_light(tone.sclera, None if skin is None else skin.colour, unwrapped.colour[face])
    colour, code = completed.colour.copy(), _confidence(completed)

    socket = (np.clip(zones.hidden - zones.mouth, 0, 1) * zones.skin)[:, None]
    colour += socket * (light.on(parts.SOCKET) * np.float32(parts.BETWEEN) - colour)
    if ledger.runs(LASH_LINE):
        lashes = (lash_line(chart) * zones.skin * (1 - seen_weight))[:, None]
        colour += lashes * (light.on(parts.LASHES) - colour)
        ledger.count(LASH_LINE, int((lashes > SEEN_CHANGE).sum()), len(lashes))
    inside = (zones.mouth * zones.skin)[:, None]
    colour += inside * (mouth.paint_lining(chart, zones.mouth * zones.skin, light) - colour)
    for index, name in enumerate(chart.head.part_names):
        own = np.flatnonzero(chart.inner_part == index)
        if name == "skin" or name.startswith("teeth") or not len(own):
            continue
        if name.startswith("eye"):
            painted = _paint_eye(chart, index, light, tone)
            share = eyes_seen[own] * (parts.alike(unwrapped.colour[own], painted) if irises else 1.0)
        else:
            tongue = name == "tongue"
            painted = mouth.paint_tongue(chart, index, own, light) if tongue else light.on(parts.LASHES)[None]
            share = np.zeros(len(own), np.float32)
        _lay_over(colour, code, own, painted, share, unwrapped.colour)
    sclera = light.on(parts.SCLERA) if tone.sclera is None else tone.sclera
    white = np.asarray(np.maximum(srgb_to_linear(sclera), DARKEST) / SCLERA_ALBEDO, np.float32)
    teeth = mouth.Teeth(chart)
    if len(teeth.own):
        typical = DEFAULT_SKIN if skin is None else skin.colour
        measured = None if fit.mouth_rim is None else measure_teeth(photo.pixels, fit.mouth_rim, typical)
        tooth = light.on(mouth.TEETH) if measured is None else measured
        shown = unwrapped.colour[teeth.own]
        share = seen_weight[teeth.own] * toothlike(shown, typical) * teeth.shows(shown, tooth)
        _lay_over(colour, code, teeth.own, teeth.paint(tooth, light), share, unwrapped.colour)
        if ledger.runs(TOOTH_HUE):
            yellower = mouth.no_bluer(colour[teeth.own], white)
            moved = np.abs(yellower - colour[teeth.own]).max(1) > SEEN_CHANGE
            ledger.count(TOOTH_HUE, int(moved.sum()), len(colour))
            colour[teeth.own] = yellower
    iris = None if tone.iris is None else np.asarray(srgb_to_linear(tone.iris) / white, np.float32)
    return colour, code, white, iris


def _lay_over(
    colour: Float, code: Float, own: npt.NDArray[np.int64], painted: Float, share: Float, photo: Float
) -> None:
    """Write a part's texels: the paint (n, 3), with a share (n,) of the photo (N, 3), and their confidence codes."""
    colour[own] = painted + share[:, None] * (photo[own] - painted)
    code[own] = np.where(share > 0.05, np.rint(SEEN + (255 - SEEN) * share), 0)


def _paint_eye(chart: Chart, index: int, light: parts.Light, tone: EyeTone) -> Float:
    """(n, 3) sRGB of an eye's texels in measured or plausible colours."""
    _, angle, limbus, pupil = parts.eye_angles(chart, index)
    sclera = light.on(parts.SCLERA) if tone.sclera is None else tone.sclera
    iris = light.on(parts.IRIS) if tone.iris is None else tone.iris
    painted = parts.paint_eye(angle, limbus, pupil, sclera, iris, light.on(parts.SOCKET))
    return np.asarray(painted * parts.lid_shade(chart, index), np.float32)


def _confidence(completed: Completed) -> Float:
    """(N,) code of each texel, see ``service.texture.result``."""
    seen = np.rint(SEEN + (255 - SEEN) * completed.seen)
    reflected = np.rint(MIRRORED + (SEEN - 1 - MIRRORED) * completed.from_mirror)
    made_up = 1 - completed.seen - completed.from_mirror
    code = np.where(completed.from_mirror > np.maximum(made_up, completed.seen), reflected, 0)
    return np.asarray(np.where(completed.seen >= np.maximum(completed.from_mirror, made_up), seen, code), np.float32)


def visible_fraction(chart: Chart, fit: Fit, unwrapped: Unwrapped, zones: Zones) -> float:
    """Share of the face region's area that the photo shows, facing the camera and not hidden, in [0, 1]."""
    area = chart.gather(triangle_area(chart, fit.vertices)).ravel()[chart.texels] * zones.face * zones.skin
    total = float(area.sum())
    return float(area[unwrapped.visible].sum() / total) if total > 0 else 0.0


def triangle_area(chart: Chart, vertices: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """(T,) m^2 of surface per texel of chart; 0 for triangles without area on the chart."""
    space = face_normals(vertices, chart.head.triangles)
    texels = np.abs(signed_area(chart_points(chart.head, chart.width, chart.height), chart.head.triangle_uv))
    area = np.sqrt((space * space).sum(1))
    return np.asarray(np.divide(area, texels, out=np.zeros_like(area), where=texels > 1e-9))
