"""The shipped normals network on real skin: ``python -m benchmarks.real_skins --data DIR``.

DIR holds ``hifi3d_uv/`` (three pairs of albedo and tangent normals) and ``lee_perry_smith/`` (a head scan with
normals), which no training sees. Cheeks and foreheads are enlarged to the network's own texels per mm, rho reads
normals off the grey albedo, and both are compared in the bands of wavelengths that the scans resolve. Printed beside
it: a flat map, and "dark is deep", the albedo itself taken for a height.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import numpy.typing as npt
import typer

from models.lightstage.measures import BANDS_MM, Patch, band
from models.lightstage.references import reference_patches
from service.colour import LUMA, linear_to_srgb
from service.head.files import load_head
from service.runtime.networks import Engine, open_network
from service.runtime.sessions import MODELS

PPM = 14.0
"""Texels per mm of the full chart on cheeks."""

PLACES_MM = {"cheek right": (-42.0, -20.0), "cheek left": (42.0, -20.0), "forehead": (0.0, 60.0)}
"""Where on the head a patch is, from the middle between the eyes: x to the subject's left, y up."""

Array = npt.NDArray[np.float64]


def predicted(patch: Patch, folder: Path = MODELS) -> tuple[Array, Array]:
    """(2, h, w) slopes that rho reads off a patch, and those of "dark is deep", both at the patch's own resolution."""
    scale = PPM / patch.texels_per_mm
    coded = linear_to_srgb(patch.albedo.astype(np.float32))
    side = round(patch.albedo.shape[0] * scale / 16) * 16
    big = cv2.resize(coded, (side, side), interpolation=cv2.INTER_CUBIC).clip(0.0, 1.0)
    grey = np.asarray(big @ LUMA, np.float32) * 2.0 - 1.0
    x, y = next(place for name, place in PLACES_MM.items() if patch.name.endswith(name))
    with open_network("rho", Engine(threads=1, folder=folder)) as network:
        position = _position(x, y)
        constant = {"normal_tangent_z": 1.0, "normal_tangent_x": 0.0, "normal_tangent_y": 0.0, **position}
        planes = [grey if name == "albedo_grey" else np.full_like(grey, constant[name])
                  for name in network.description.channels]  # fmt: skip
        normal = network.run(np.stack(planes))
    size = patch.albedo.shape[1::-1]
    slopes = np.stack([cv2.resize(-normal[k] / normal[2], size, interpolation=cv2.INTER_AREA) for k in (0, 1)])
    height = np.asarray(coded @ LUMA, np.float64)
    rows, columns = np.gradient(height)
    return slopes.astype(np.float64), np.stack([columns, -rows])


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
    power = float(np.sqrt((a * a).sum() * (b * b).sum()))
    ratio = float(np.sqrt((a * a).sum() / max(float((b * b).sum()), 1e-20)))
    return (float((a * b).sum()) / power if power > 1e-20 else 0.0), ratio


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
) -> None:
    """Print one line a patch, as a Markdown table."""
    place = data or Path(os.environ.get("AVATARME_BENCH_DATA", ""))
    typer.echo("| patch | rho deg | flat deg | " + " | ".join(
        f"{low}-{high} mm: correlation, strength, dark is deep" for low, high in BANDS_MM[1:]) + " |")  # fmt: skip
    typer.echo("|---" * (3 + len(BANDS_MM[1:])) + "|")
    for patch in reference_patches(place):
        found, deep = predicted(patch, folder)
        truth = np.asarray(patch.slope)
        cells = []
        for low, high in BANDS_MM[1:]:
            if 2.0 / patch.texels_per_mm > 0.5 * (low + high):
                cells.append("-")
                continue
            correlation, ratio = compare(found, truth, patch.texels_per_mm, low, high)
            other, _ = compare(deep, truth, patch.texels_per_mm, low, high)
            cells.append(f"{correlation:.2f}, {ratio:.2f}, {other:.2f}")
        numbers = f"{error(found, truth):.2f} | {tilt(truth):.2f}"
        typer.echo(f"| {patch.name} | {numbers} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    typer.run(main)
