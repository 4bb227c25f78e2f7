"""Soft vertex masks of the regions of the head, painted from MakeHuman's own region textures, its chart and the
geometry.

All positions are millimetres on the template (origin between the eyeballs, +X subject's left, +Y up, +Z forward);
offsets are relative to landmarks found on the mesh, so they follow the template.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from models.head.chart.islands import skin_kind
from models.head.crop import PART_NAMES, Crop
from models.head.source import BaseMesh
from service.errors import ModelFault

Float = npt.NDArray[np.float64]
TEXTURES = "mpfb2/textures"


def smooth(value: Float, low: float, high: float) -> Float:
    """Smoothstep from 0 at ``low`` to 1 at ``high``; ``low > high`` turns it round."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t))


def painted(data: Path, base: BaseMesh, crop: Crop, name: str) -> Float:
    """(V,) MakeHuman's mask ``mpfb_<name>.jpg`` at the skin's vertices, 0 elsewhere (mean over the corners of each
    vertex).
    """
    image = cv2.imread(str(data / TEXTURES / f"mpfb_{name}.jpg"), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ModelFault(f"mask {name} is missing from {data / TEXTURES}")
    image = cv2.GaussianBlur(image.astype(np.float32) / 255, (0, 0), 4)
    height, width = image.shape
    column = np.clip((base.uv[:, 0] * width).astype(int), 0, width - 1)
    row = np.clip(((1 - base.uv[:, 1]) * height).astype(int), 0, height - 1)
    value = image[row, column].astype(float)
    total, count = np.zeros(len(base.vertices)), np.zeros(len(base.vertices))
    np.add.at(total, base.quads.ravel(), value[base.quads_uv.ravel()])
    np.add.at(count, base.quads.ravel(), 1.0)
    skin = crop.body_index >= 0
    out = np.zeros(len(crop.body_index))
    out[skin] = (total / np.maximum(count, 1))[crop.body_index[skin]]
    return out


def _blob(points: Float, centre: Float, radii: tuple[float, float, float]) -> Float:
    return np.asarray(np.exp(-(((points - centre) / np.array(radii)) ** 2).sum(1)))


def _kind_mask(crop: Crop, kind: npt.NDArray[np.int64], which: int, count: int) -> npt.NDArray[np.bool_]:
    """Vertices all of whose skin polygons are of one kind."""
    inside, outside = np.zeros(count, bool), np.zeros(count, bool)
    inside[crop.polygons[kind == which].ravel()] = True
    outside[crop.polygons[(kind >= 0) & (kind != which)].ravel()] = True
    return inside & ~outside


def build_regions(data: Path, base: BaseMesh, crop: Crop, template_mm: Float) -> dict[str, Float]:
    """All masks, (V,) each in [0, 1]; vertices of other parts than the skin are 0."""
    p = template_mm
    skin = crop.body_index >= 0
    kind = skin_kind(base, crop)
    mouth, socket = _kind_mask(crop, kind, 1, len(p)), _kind_mask(crop, kind, 2, len(p))
    seen = skin & ~mouth & ~socket
    left = p[:, 0] > 0
    lips = painted(data, base, crop, "lips") * seen
    tip = p[seen][np.argmax(p[seen, 2])]
    lip_edge = crop.polygons[kind == 1]
    rim = np.intersect1d(lip_edge, crop.polygons[kind == 0])
    line = np.interp(np.abs(p[:, 0]), *_profile(np.abs(p[rim, 0]), p[rim, 1]))
    corner = p[rim][np.argmax(p[rim, 0])]
    chin = p[seen & (np.abs(p[:, 0]) < 1e-6) & (p[:, 2] > tip[2] - 40)]
    chin = chin[np.argmin(chin[:, 1])]
    lids = np.intersect1d(crop.polygons[kind == 2], crop.polygons[kind == 0])
    lid = p[lids[p[lids, 0] > 0]]
    eye = lid.mean(0)
    ears = painted(data, base, crop, "ears") * seen
    face = painted(data, base, crop, "face") * seen
    face = np.maximum(face, lips) * seen
    face = np.maximum(face, painted(data, base, crop, "eyelids") * seen * (p[:, 1] > corner[1] + 20))
    mirrored = np.stack([np.abs(p[:, 0]), p[:, 1], p[:, 2]], 1)
    lid_distance = np.sqrt(((mirrored[:, None] - lid[None]) ** 2).sum(2).min(1))
    near_lid = smooth(lid_distance, 13.0, 4.0) * seen
    above = smooth(p[:, 1] - np.interp(mirrored[:, 0], *_profile(lid[:, 0], lid[:, 1])), -1.0, 1.0)
    brow_line = (
        eye[1] + 17.0 - 0.012 * np.maximum(mirrored[:, 0] - 38.0, 0) ** 2 + 1.5 * smooth(mirrored[:, 0], 14.0, 36.0)
    )
    brow = np.exp(-(((p[:, 1] - brow_line) / 4.5) ** 2)) * smooth(mirrored[:, 0], 9.0, 14.0)
    brow *= smooth(mirrored[:, 0], 60.0, 50.0) * seen * (p[:, 2] > -25)
    nose = _blob(mirrored, tip + np.array([6.0, 2.0, -6.0]), (17.0, 13.0, 17.0)) + _blob(
        mirrored, tip + np.array([0.0, 20.0, -10.0]), (11, 18, 14)
    )
    nose = np.clip(1.3 * nose, 0, 1) * smooth(p[:, 1], tip[1] - 16, tip[1] - 9) * seen
    cheek = _blob(mirrored, np.array([45.0, tip[1] + 3.0, tip[2] - 38.0]), (20.0, 20.0, 30.0)) * seen
    chin_mask = _blob(mirrored, chin + np.array([0.0, 9.0, 2.0]), (19.0, 14.0, 22.0)) * seen * (1 - lips)
    jaw = smooth(p[:, 1] + 0.35 * p[:, 2], chin[1] - 2.0, chin[1] + 8.0)
    neck = seen * (1 - jaw) * smooth(p[:, 1], chin[1] + 20, chin[1] + 5) * (1 - ears)
    forehead = seen * face * smooth(p[:, 1], eye[1] + 20, eye[1] + 32) * smooth(p[:, 1], 88.0, 70.0)
    angle = np.degrees(np.arctan2(mirrored[:, 0], p[:, 2] + 95))
    hairline = 66.0 - 62.0 * smooth(angle, 24.0, 66.0)
    scalp = smooth(p[:, 1] - hairline, -8.0, 8.0)
    back = smooth(angle, 78.0, 90.0) * smooth(p[:, 1], -95.0, -75.0)
    scalp = np.maximum(scalp, back) * seen * (1 - smooth(ears, 0.2, 0.6))
    beard = smooth(p[:, 1], tip[1] + 4, tip[1] - 8) * smooth(angle, 72.0, 60.0) * (1 - lips) * (1 - nose)
    beard *= smooth(p[:, 1] + 0.35 * p[:, 2], chin[1] - 16.0, chin[1] - 2.0) * seen
    cheek_free = _blob(mirrored, np.array([38.0, tip[1] + 2.0, tip[2] - 30]), (18.0, 16.0, 40.0))
    beard *= 1 - np.clip(1.4 * cheek_free, 0, 1)
    side = smooth(p[:, 0], -1.0, 1.0)
    masks = {
        "face": face, "forehead": forehead, "nose": nose,
        "nose_tip": np.clip(1.2 * _blob(mirrored, tip, (9.0, 8.0, 9.0)), 0, 1) * seen,
        "cheek_left": cheek * side, "cheek_right": cheek * (1 - side),
        "lips": lips, "lip_upper": lips * smooth(p[:, 1] - line, -0.4, 0.4),
        "lip_lower": lips * smooth(p[:, 1] - line, 0.4, -0.4), "chin": chin_mask,
        "eyelid_left": near_lid * left, "eyelid_right": near_lid * ~left,
        "eyelid_upper_left": near_lid * left * above, "eyelid_upper_right": near_lid * ~left * above,
        "eyelid_lower_left": near_lid * left * (1 - above), "eyelid_lower_right": near_lid * ~left * (1 - above),
        "brow_left": brow * left, "brow_right": brow * ~left, "ear_left": ears * left, "ear_right": ears * ~left,
        "neck": neck, "scalp": scalp, "beard": beard, "mouth_inner": mouth.astype(float),
        "eye_socket": socket.astype(float),
    }  # fmt: skip
    return {name: _symmetric(np.clip(mask, 0, 1), masks, name, crop) for name, mask in masks.items()}


def _symmetric(mask: Float, masks: dict[str, Float], name: str, crop: Crop) -> Float:
    """Make masks exactly symmetric: the painted textures are so only up to JPEG noise."""
    other = name.replace("_left", "_right") if "_left" in name else name.replace("_right", "_left")
    return np.asarray(0.5 * (mask + np.clip(masks[other], 0, 1)[crop.mirror]))


def _profile(x: Float, y: Float) -> tuple[Float, Float]:
    """Mean height over sideways position, for interpolation: sorted (n,) x and y in 2 mm bins."""
    bins = np.round(x / 2.0)
    keys = np.unique(bins)
    return keys * 2.0, np.array([0.5 * (y[bins == k].min() + y[bins == k].max()) for k in keys])


def rigid_groups(crop: Crop) -> list[npt.NDArray[np.int64]]:
    """Vertices of each eyeball and of each row of teeth."""
    names = ("eye_left", "eye_right", "teeth_upper", "teeth_lower")
    out = []
    for name in names:
        table = crop.polygons[crop.part == PART_NAMES.index(name)]
        out.append(np.unique(table[table >= 0]))
    return out
