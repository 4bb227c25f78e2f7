"""The shipped normals network on real skin: ``python -m models.training.real_skins --data DIR``.

DIR holds ``hifi3d_uv/`` (three pairs of albedo and tangent normals) and ``lee_perry_smith/`` (a head scan with
normals), which no training sees. Cheeks and foreheads are enlarged to the network's own texels per mm, rho reads
normals off the grey albedo, and both are compared in the bands of wavelengths that the scans resolve. Printed beside
it: a flat map, and "dark is deep", the albedo itself taken for a height.

Correlations are given of slopes along x and along y apart, which agree where relief is read that the scan has.
A second table has the mean angle as the service uses rho: on skin that a light from the side or from above shades, with
what that shade corrects (``service.reflectance.relief.normal_inputs``).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import numpy.typing as npt
import typer

from models.lightstage.measures import BANDS_MM, Patch, band
from models.lightstage.references import reference_patches
from models.tables import tell
from service.arrays import Float32
from service.colour import LUMA, linear_to_srgb
from service.head.files import load_head
from service.reflectance.reflectance_maps import STEEPEST_Z
from service.reflectance.relief.normal_inputs import GAMMA, LEAST, PIGMENT, RELIEF, UNTOLD, updated
from service.runtime.network_registry import DRAWN_DETAIL, SHADED_GREY
from service.runtime.networks import Engine, open_network
from service.runtime.sessions import MODELS
from service.texture.photo_sampling import joined_octaves, split_octaves

PPM = 14.0
"""Texels per mm of the full chart on cheeks."""

PLACES_MM = {"cheek right": (-42.0, -20.0), "cheek left": (42.0, -20.0), "forehead": (0.0, 60.0)}
"""Where on the head a patch is, from the middle between the eyes: x to the subject's left, y up."""

MARK = ("<!-- real-skin -->", "<!-- /real-skin -->")
SHOWN = BANDS_MM[1:]
"""Bands of wavelengths, in mm, that at least one scan resolves."""

SENSITIVITIES = (0.2, 0.5)
"""Change of the logarithm of the light with a component of the normal, on skin: of soft and of usual light."""
TURNS = (0.2, 1.2, 1.9, 2.9)
"""Where the light comes from, radians from image x towards up: both sides, and from above."""

Array = npt.NDArray[np.float64]


def enlarged(patch: Patch) -> Float32:
    """(side, side) grey of a patch, sRGB-coded, at ``PPM``; the side is a multiple of 32 texels."""
    coded = linear_to_srgb(patch.albedo.astype(np.float32))
    side = round(patch.albedo.shape[0] * PPM / patch.texels_per_mm / 32) * 32
    big = cv2.resize(coded, (side, side), interpolation=cv2.INTER_CUBIC).clip(0.0, 1.0)
    return np.asarray(big @ LUMA, np.float32)


def asked(grey: Float32, name: str, folder: Path = MODELS) -> Float32:
    """(3, h, w) normals that rho reads off the grey (h, w), sRGB-coded, of the patch of this name."""
    x, y = next(place for end, place in PLACES_MM.items() if name.endswith(end))
    with open_network("rho", Engine(threads=1, folder=folder)) as network:
        ahead = {"normal_tangent_z": 1.0, "normal_tangent_x": 0.0, "normal_tangent_y": 0.0}
        constant = ahead | {DRAWN_DETAIL: -1.0} | _position(x, y)
        planes = [grey * 2.0 - 1.0 if channel == SHADED_GREY else np.full_like(grey, constant[channel])
                  for channel in network.description.channels]  # fmt: skip
        return network.run(np.stack(planes))


def predicted(patch: Patch, folder: Path = MODELS) -> Array:
    """(2, h, w) slopes that rho reads off a patch, at the patch's own resolution."""
    normal, size = asked(enlarged(patch), patch.name, folder), patch.albedo.shape[1::-1]
    slopes = np.stack([cv2.resize(-normal[k] / normal[2], size, interpolation=cv2.INTER_AREA) for k in (0, 1)])
    return slopes.astype(np.float64)


def in_light(patch: Patch, sensitivity: float, turn: float, folder: Path = MODELS) -> tuple[float, float, float]:
    """Mean angle in degrees of a flat map, of rho, and of rho corrected by the shade, in a light from one side.

    Args:
        patch: of real skin; its slopes shade it.
        sensitivity: d log E / d n along the light (``service.reflectance.subject``).
        turn: radians from image x towards up, where the light comes from.
        folder: of the ONNX files.
    """
    grey = enlarged(patch)
    slopes = [cv2.resize(plane, grey.shape[::-1], interpolation=cv2.INTER_CUBIC) for plane in np.asarray(patch.slope)]
    truth = np.stack(slopes).astype(np.float64)
    tilted = -truth / np.sqrt(1.0 + np.square(truth).sum(0))
    toward = sensitivity * np.array([np.cos(turn), np.sin(turn)])
    lit = np.clip(grey * np.exp(np.tensordot(toward, tilted, 1) / GAMMA), 0.0, 1.0).astype(np.float32)
    normal = asked(lit, patch.name, folder)
    guess = np.moveaxis(normal[:2] / np.linalg.norm(normal, axis=0), 0, 2).astype(np.float32)
    octaves = len(RELIEF)
    shade, _ = split_octaves(np.log(np.maximum(lit, LEAST)) * np.float32(GAMMA), octaves)
    bands, _ = split_octaves(np.ascontiguousarray(guess), octaves)
    change = [
        updated(one, seen, toward.tolist(), UNTOLD * strength, pigment)
        for one, seen, strength, pigment in zip(bands, shade, RELIEF, PIGMENT, strict=True)
    ]
    flat = np.zeros_like(truth)
    return error(flat, truth), error(slopes_of(guess), truth), error(slopes_of(guess + joined_octaves(change)), truth)


def slopes_of(xy: Float32) -> Array:
    """(2, h, w) slopes of x and y (h, w, 2) of unit normals."""
    z = np.sqrt(np.maximum(1.0 - np.square(xy).sum(-1), STEEPEST_Z**2))
    return np.asarray(np.moveaxis(-xy / z[..., None], 2, 0), np.float64)


def lit_rows(patches: Sequence[Patch], folder: Path) -> list[str]:
    """Rows of the second table: by kind of scan and strength of the light, means over patches and directions."""
    lines = ["| scans | sensitivity to the light | flat | rho | rho and the photo's shade |", "|---" * 5 + "|"]
    for who in dict.fromkeys(patch.name.split()[0] for patch in patches):
        own = [patch for patch in patches if patch.name.startswith(who)]
        for strength in SENSITIVITIES:
            angles = np.mean([in_light(one, strength, turn, folder) for one in own for turn in TURNS], 0)
            lines.append(f"| {who} | {strength} | " + " | ".join(f"{value:.2f}" for value in angles) + " |")
    return lines


def _position(x: float, y: float) -> dict[str, float]:
    """Rest position of a place of the face, as the networks are told it."""
    head = load_head()
    mm = head.mean.astype(np.float64) * 1000.0
    part = head.part_names.index("eye_left"), head.part_names.index("eye_right")
    eyes = [mm[np.unique(head.triangles[head.triangle_part == p])].mean(0) for p in part]
    middle = (eyes[0] + eyes[1]) / 2.0
    front = mm[mm[:, 2] > middle[2] - 60.0]
    near = front[np.argmin(np.hypot(front[:, 0] - middle[0] - x, front[:, 1] - middle[1] - y))]
    return {f"position_{axis}": float(value / 128.0) for axis, value in zip("xyz", near, strict=True)}


def compare(found: Array, truth: Array, ppm: float, low: float, high: float) -> tuple[float, float]:
    """Correlation of slopes in a band, and the ratio of their strengths."""
    a = np.concatenate([band(plane, ppm, low, high).ravel() for plane in found])
    b = np.concatenate([band(plane, ppm, low, high).ravel() for plane in truth])
    return correlation(a, b), float(np.sqrt((a * a).sum() / max(float((b * b).sum()), 1e-20)))


def correlation(a: Array, b: Array) -> float:
    """Of values whose mean is 0; 0 where one of both has none."""
    power = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / power if power > 1e-20 else 0.0


def by_axis(found: Array, truth: Array, ppm: float, low: float, high: float) -> str:
    """Correlations of slopes in a band along x / along y."""
    return " / ".join(f"{compare(found[k : k + 1], truth[k : k + 1], ppm, low, high)[0]:.2f}" for k in (0, 1))


def resolved(patch: Patch) -> list[tuple[float, float]]:
    """Bands that a patch's texels resolve at least half of."""
    return [(low, high) for low, high in SHOWN if 2.0 / patch.texels_per_mm <= 0.5 * (low + high)]


def dark_is_deep(patch: Patch) -> Array:
    """(2, h, w) slopes along x and up of the coded albedo taken for a height."""
    rows, columns = np.gradient(np.asarray(linear_to_srgb(patch.albedo.astype(np.float32)) @ LUMA, np.float64))
    return np.stack([columns, -rows])


def tilt(slopes: Array) -> float:
    """Mean tilt in degrees."""
    return float(np.degrees(np.arctan(np.hypot(*slopes))).mean())


def error(found: Array, truth: Array) -> float:
    """Mean angle in degrees between the normals of two slope maps."""
    normals = []
    for slope in (found, truth):
        n = np.stack([-slope[0], -slope[1], np.ones_like(slope[0])])
        normals.append(n / np.linalg.norm(n, axis=0))
    return float(np.degrees(np.arccos(np.clip((normals[0] * normals[1]).sum(0), -1.0, 1.0))).mean())


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of the scans; else $AVATARME_BENCH_DATA.")] = None,
    folder: Annotated[Path, typer.Option(help="Folder of the ONNX files.")] = MODELS,
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the tables into.")] = None,
) -> None:
    """Print the tables."""
    place = data or Path(os.environ.get("AVATARME_BENCH_DATA", ""))
    lines = ["| patch | rho deg | flat deg | " + " | ".join(
        f"{low}-{high} mm: correlation x / y, strength, dark is deep" for low, high in SHOWN) + " |"]  # fmt: skip
    lines.append("|---" * (3 + len(SHOWN)) + "|")
    patches = reference_patches(place)
    for patch in patches:
        found, deep = predicted(patch, folder), dark_is_deep(patch)
        truth = np.asarray(patch.slope)
        cells = ["-"] * (len(SHOWN) - len(resolved(patch)))
        for low, high in resolved(patch):
            limits = patch.texels_per_mm, low, high
            ours, theirs = (by_axis(slopes, truth, *limits) for slopes in (found, deep))
            cells.append(f"{ours}, {compare(found, truth, *limits)[1]:.2f}, {theirs}")
        numbers = f"{error(found, truth):.2f} | {tilt(truth):.2f}"
        lines.append(f"| {patch.name} | {numbers} | " + " | ".join(cells) + " |")
    lines += ["", *lit_rows(patches, folder)]
    tell("\n".join(lines), MARK, write)


if __name__ == "__main__":
    typer.run(main)
