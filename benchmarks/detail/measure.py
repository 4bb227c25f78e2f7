"""How much of the detail that a photo shows is in the maps: correlation and strength in bands of periods.

All is compared in the photo's own frame, where map and photo lie on each other whatever the fit errs by.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.detail.shoot import Taken
from benchmarks.metrics import View, at_chart, face_region
from service.archive.avatar import Avatar
from service.colour import LUMA, linear_to_srgb
from service.geometry.chart import Chart
from service.reflectance.reflectance_maps import MID, SCALE_MM, unpack_normals

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

BANDS_MM = ((0.6, 1.2), (1.2, 2.5), (2.5, 6.0))
"""Periods on the face."""
SURE = 180
"""Confidence from which on a texel counts as seen."""
EDGE_MM = 1.5
"""Distance from what is not compared, so that no border is taken for detail."""
MAP = (1536, 1024)
"""Chart on which tangent frames are drawn."""
MOST_SLANTED = 0.2
"""Cosine of the viewing angle below which no slope is told."""
SHAPE_MM = 1.5
"""Standard deviation, on the face, of the Gaussian over which slopes are those of the head's shape."""
CREASES_MM, DEEPEST, BESIDE_MM = (0.6, 2.5), 0.005, 0.5
"""Periods of creases; the share of the skin, where the truth lies deepest, that counts as such; how far off ours may
lie."""
LIDS_M = 0.021
"""Distance from the eyes within which relief is not compared: lids of another head are no creases."""


@dataclass(frozen=True)
class Agreement:
    """Of two fields in a band: correlation in [-1, 1], and the ratio of their root mean squares."""

    correlation: float
    strength: float


def band(field: Array, mask: Mask, per_mm: float, limits: tuple[float, float]) -> Array:
    """(H, W) part of a field whose periods lie in [low, high) mm; what is masked out is continued smoothly first."""
    return _banded(_continued(field, mask, 2 * limits[1] * per_mm), per_mm, limits)


def _banded(field: Array, per_mm: float, limits: tuple[float, float]) -> Array:
    inside = _inside(np.hypot(*_frequencies(field.shape, per_mm)), limits)
    return np.asarray(np.fft.irfft2(np.fft.rfft2(field) * inside, field.shape))


def heights(normal: Array, mask: Mask, per_mm: float, limits: tuple[float, float]) -> Array:
    """(H, W) millimetres towards the camera that have the slopes of normals in a band (Frankot and Chellappa 1988).

    Slopes count as far as they differ from those around (:func:`fine`): else the shape of a head would ring.

    Args:
        normal: (H, W, 3) unit, along the camera's right, down and forward.
        mask: where they count.
        per_mm: pixels per millimetre.
        limits: periods, millimetres.
    """
    down, across = _frequencies(normal.shape[:2], per_mm)
    frequency = np.hypot(down, across)
    forward = np.minimum(normal[..., 2], -MOST_SLANTED)
    slope = [np.fft.rfft2(fine(normal[..., k] / forward, mask, per_mm)) for k in (0, 1)]
    upward = (across * slope[0] + down * slope[1]) / (2j * np.pi * np.maximum(frequency**2, 1e-12))
    return np.asarray(np.fft.irfft2(upward * _inside(frequency, limits), normal.shape[:2]))


def fine(field: Array, mask: Mask, per_mm: float) -> Array:
    """(H, W) field less its mean over ``SHAPE_MM`` within a mask, 0 outside."""
    weight = mask.astype(np.float32)
    soft = cv2.GaussianBlur(np.dstack([field * weight, weight]).astype(np.float32), (0, 0), SHAPE_MM * per_mm)
    return np.where(mask, field - soft[..., 0] / np.maximum(soft[..., 1], 1e-3), 0.0).astype(np.float64)


def _frequencies(shape: tuple[int, ...], per_mm: float) -> tuple[Array, Array]:
    """Cycles per millimetre along columns and rows, as ``rfft2`` has them."""
    return np.float64(per_mm) * np.fft.fftfreq(shape[0])[:, None], np.float64(per_mm) * np.fft.rfftfreq(shape[1])[None]


def _inside(frequency: Array, limits: tuple[float, float]) -> Mask:
    return np.asarray((frequency > 1 / limits[1]) & (frequency <= 1 / limits[0]))


def _continued(field: Array, mask: Mask, sigma: float) -> Array:
    weight = mask.astype(np.float32)
    soft = cv2.GaussianBlur(np.dstack([field * weight, weight]).astype(np.float32), (0, 0), sigma)
    mean = float(field[mask].mean()) if mask.any() else 0.0
    smooth = (soft[..., 0] + 1e-3 * mean) / (soft[..., 1] + 1e-3)
    return np.where(mask, field, smooth).astype(np.float64)


def agreement(found: list[Array], truth: list[Array], mask: Mask, per_mm: float,
              limits: tuple[float, float]) -> Agreement:  # fmt: skip
    """Of fields, all components together, inside a mask and not near its border."""
    core = _core(mask, per_mm)
    a, b = (np.concatenate([band(one, mask, per_mm, limits)[core] for one in fields]) for fields in (found, truth))
    return _agreement(a, b)


def _core(mask: Mask, per_mm: float) -> Mask:
    reach = 2 * round(EDGE_MM * per_mm) + 1
    return np.asarray(cv2.erode(mask.astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0)


def _agreement(a: Array, b: Array) -> Agreement:
    power = float(np.sqrt((a * a).sum() * (b * b).sum()))
    strength = float(np.sqrt((a * a).sum() / max(float((b * b).sum()), 1e-20)))
    return Agreement(float((a * b).sum()) / power if power > 1e-20 else 0.0, strength)


@dataclass(frozen=True)
class Compared:
    """Agreements by band of one photo: ours with the truth, and the photo's own with the truth."""

    albedo: tuple[Agreement, ...]
    photo: tuple[Agreement, ...]
    texture: tuple[Agreement, ...]
    normals: tuple[Agreement, ...]
    relief: tuple[Agreement, ...]
    """Of the displacement with the truth's heights."""
    creases_mm: tuple[float, float, float] | None
    """Depth of the truth where that lies deepest, of the displacement there, and of the displacement anywhere: means of
    the deepest within ``BESIDE_MM``."""
    error: float
    """Root mean square error of coded albedo after the best gain, in 255ths, of all periods below 6 mm."""


def compare(avatar: Avatar, pixels: npt.NDArray[np.uint8], truth: Taken, unfit: Array) -> Compared:
    """Compare an avatar's maps with the truth.

    Args:
        avatar: with diffuse albedo; where it has specular normals and displacement, these are compared too.
        pixels: (h, w, 3) of the photo that it was made from, of any size.
        truth: what the photo shows, pixel by pixel.
        unfit: (K, 4) centres and radii of balls, metres, that are left out.
    """
    size = truth.skin.shape
    scale = size[1] / pixels.shape[1]
    view = View.of(avatar.fit, avatar.head, size, scale)
    made = avatar.reflectance
    assert made is not None and made.diffuse_albedo is not None  # noqa: S101 - asked for
    confidence = at_chart(avatar.texture.confidence[..., None].astype(np.float32), view.uv)[..., 0]
    eyes = np.array([[0.0315, 0.0, 0.0], [-0.0315, 0.0, 0.0]])
    seen = (truth.position.astype(np.float64), truth.normal.astype(np.float64))
    mask = truth.skin & view.skin & (confidence >= SURE) & face_region(*seen, eyes, 0.0)
    for ball in unfit:
        mask &= np.linalg.norm(truth.position - ball[:3], axis=-1) > ball[3]
    per_mm = truth.per_mm
    true = _grey(linear_to_srgb(truth.albedo))
    ours = _grey(at_chart(made.diffuse_albedo.astype(np.float32), view.uv) / 65535)
    shot = cv2.resize(pixels, size[::-1], interpolation=cv2.INTER_CUBIC)
    fields = {
        "albedo": ours,
        "photo": _grey(shot / 255),
        "texture": _grey(at_chart(avatar.texture.texture.astype(np.float32), view.uv) / 255),
    }
    logs = {name: _log(field) for name, field in (fields | {"true": true}).items()}
    found = {
        name: tuple(agreement([logs[name]], [logs["true"]], mask, per_mm, limits) for limits in BANDS_MM)
        for name in fields
    }
    right = _in_camera(truth.normal, truth)
    bent: tuple[Agreement, ...] = ()
    if made.specular_normal is not None:
        ours_bent = _normals(avatar, view, made.specular_normal)
        bent = tuple(
            agreement([ours_bent[..., k] for k in (0, 1)], [right[..., k] for k in (0, 1)], mask, per_mm, limits)
            for limits in BANDS_MM
        )
    bare = mask & (np.linalg.norm(truth.position[..., None, :] - eyes, axis=-1) > LIDS_M).all(-1)
    relief, creases = ((), None) if made.displacement is None else _relief(view, made.displacement, right, bare, per_mm)
    return Compared(
        found["albedo"], found["photo"], found["texture"], bent, relief, creases, _error(ours, true, mask, per_mm)
    )


def _relief(
    view: View, codes: npt.NDArray[np.uint16], normal: Array, mask: Mask, per_mm: float
) -> tuple[tuple[Agreement, ...], tuple[float, float, float]]:
    """Of displacement codes and the truth's normals in camera space: agreement by band, and depth of creases."""
    facing = np.maximum(cv2.GaussianBlur(-normal[..., 2], (0, 0), BANDS_MM[-1][1] * per_mm), MOST_SLANTED)
    along = at_chart((codes.astype(np.float32) - MID) * np.float32(SCALE_MM), view.uv) / facing  # towards the camera
    ours, core = fine(along, mask, per_mm), _core(mask, per_mm)
    bands = tuple(
        _agreement(_banded(ours, per_mm, limits)[core], heights(normal, mask, per_mm, limits)[core])
        for limits in BANDS_MM
    )
    true, found = heights(normal, mask, per_mm, CREASES_MM), _banded(ours, per_mm, CREASES_MM)
    if not core.any():
        return bands, (0.0, 0.0, 0.0)
    deep = core & (true <= np.quantile(true[core], DEEPEST))
    near = np.ones(2 * (2 * round(BESIDE_MM * per_mm) + 1,), np.uint8)
    true_low, low = (np.asarray(cv2.erode(one, near)) for one in (true, found))
    return bands, (float(true_low[deep].mean()), float(low[deep].mean()), float(low[core].mean()))


def _grey(coded: npt.NDArray[np.floating]) -> Array:
    return np.asarray(coded.astype(np.float64) @ LUMA)


def _log(coded: Array) -> Array:
    return np.log(np.maximum(coded, 0.02))


def _error(ours: Array, true: Array, mask: Mask, per_mm: float) -> float:
    wide = (0.3, 6.0)
    difference = band(_log(ours), mask, per_mm, wide) - band(_log(true), mask, per_mm, wide)
    return float(255 * np.sqrt(np.square(difference[mask] * true[mask]).mean()))


def _normals(avatar: Avatar, view: View, codes: npt.NDArray[np.int16]) -> Array:
    """(H, W, 3) our unit normals in camera space, as the photo's pixels show them."""
    chart = Chart.build(avatar.head, *MAP)
    frame = chart.frame(avatar.fit.vertices)
    local = unpack_normals(at_chart(codes.astype(np.float32), view.uv).astype(np.float32))
    axes = [at_chart(chart.fill_outside(axis), view.uv) for axis in (frame.tangent, frame.bitangent, frame.normal)]
    normal = sum(local[..., k : k + 1] * axis for k, axis in enumerate(axes))
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    return np.asarray(normal @ avatar.fit.camera.rotation.T)


def _in_camera(normal: npt.NDArray[np.float32], truth: Taken) -> Array:
    """(H, W, 3) normals of the truth along the camera's right, down and forward."""
    return np.asarray(normal.astype(np.float64) @ truth.axes.T)
