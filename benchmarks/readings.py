"""What the reader sees in photos: ``python -m benchmarks.readings PHOTOS [--sheet readings.jpg] [--reader FILE]``.

No truth is needed: for every photo of the folder it prints how far the reader's places lie from the landmarks, which an
independent network found (median over the landmarks of the skin, % of the distance of the eyes), its own uncertainty,
and the shares of the parts. ``--sheet`` draws for each photo the crop, chart coordinates, normals and parts.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from service.errors import AvatarError
from service.face.finder import FaceFinder
from service.face.reading.parts import PARTS, READ
from service.face.reading.reader import CHART_MM, SIDE, ReaderNetwork, Reading, crop_of
from service.head.files import load_head
from service.head.model import HeadModel
from service.photo.gate import read_photo
from service.runtime.sessions import Session, load_session

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")
COLOURS = np.array(
    [
        (40, 40, 40), (236, 190, 160), (110, 70, 40), (150, 110, 80), (220, 90, 100), (120, 20, 30), (250, 250, 250),
        (60, 120, 200), (90, 60, 30), (60, 220, 220), (200, 160, 40), (90, 130, 90), (200, 60, 200),
    ],
    np.uint8,
)  # fmt: skip
"""Of the parts in the sheet."""


def offsets(head: HeadModel, reading: Reading, landmarks: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(N,) distance of landmarks on the skin from the pixel that the reader gives their place, over the eyes' distance.

    Landmarks whose place no sure cell is near (5 mm on the chart) are left out.
    """
    uv = (head.uv[head.triangle_uv[head.landmark_triangle]] * head.landmark_barycentric[..., None]).sum(1)
    share = reading.parts[..., list(READ)].sum(-1).reshape(64, 2, 64, 2).mean((1, 3))
    sure = share > 0.6
    if not sure.any():
        return np.zeros(0)
    places, pixels = reading.chart[sure] * CHART_MM, reading.cells[sure.ravel()]
    apart = float(np.linalg.norm(landmarks[[33, 133], :2].mean(0) - landmarks[[362, 263], :2].mean(0)))
    found = []
    for place, landmark in zip(uv * CHART_MM, landmarks[:, :2], strict=True):
        distance = np.linalg.norm(places - place, axis=1)
        near = np.argsort(distance)[:6]
        if distance[near[0]] < 5.0:
            weight = 1.0 / (distance[near] + 1.0) ** 2
            found.append(np.linalg.norm((weight[:, None] * pixels[near]).sum(0) / weight.sum() - landmark))
    return np.array(found) / max(apart, 1e-6)


def picture(pixels: npt.NDArray[np.uint8], reading: Reading) -> npt.NDArray[np.uint8]:
    """(256, 1024, 3) crop, chart coordinates, normals and parts beside one another."""
    import cv2

    def large(image: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
        return np.asarray(cv2.resize(image.astype(np.uint8), (SIDE, SIDE), interpolation=cv2.INTER_NEAREST), np.uint8)

    share = cv2.resize(reading.parts[..., list(READ)].sum(-1), (64, 64), interpolation=cv2.INTER_AREA)[..., None] > 0.5
    rings = np.concatenate([reading.chart * CHART_MM / 20.0 % 1.0, reading.chart_mm[..., None] / 20.0], -1)
    chart = 255 * np.clip(rings, 0, 1) * share
    normal = 127.5 * (1.0 - reading.normal * [-1.0, 1.0, 1.0]) * share
    parts = COLOURS[reading.parts.argmax(-1)]
    crop = reading.region.cut(pixels, SIDE)
    return np.hstack([crop, large(chart), large(normal), large(parts)])


def main() -> None:
    """Entry point."""
    import cv2

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--sheet", type=Path)
    parser.add_argument("--reader", type=Path, help="another reader.onnx")
    chosen = parser.parse_args()
    session: Session | None = None
    if chosen.reader:
        import onnxruntime as ort

        session = Session("reader", ort.InferenceSession(str(chosen.reader), providers=["CPUExecutionProvider"]))
    network, finder, head = ReaderNetwork(session or load_session("reader", 2)), FaceFinder(), load_head()
    rows = []
    sys.stdout.write("| photo | landmarks off, % | own uncertainty, mm | parts over 1 % |\n|---|---|---|---|\n")
    for path in sorted(p for p in chosen.photos.iterdir() if p.suffix.lower() in SUFFIXES):
        try:
            pixels = read_photo(path.read_bytes()).pixels
        except AvatarError as fault:
            sys.stdout.write(f"| {path.name} | {fault} | | |\n")
            continue
        faces = finder.find(pixels)
        region = crop_of(faces[0].landmarks) if faces else None
        reading = None if region is None else network(pixels, region)
        if reading is None:
            sys.stdout.write(f"| {path.name} | no face | | |\n")
            continue
        off = 100 * offsets(head, reading, faces[0].landmarks)
        skin = reading.parts[..., list(READ)].sum(-1).reshape(64, 2, 64, 2).mean((1, 3)) > 0.6
        shares = np.bincount(reading.parts.argmax(-1).ravel(), minlength=len(PARTS)) / reading.parts[..., 0].size
        told = ", ".join(f"{name} {100 * share:.0f}" for name, share in zip(PARTS, shares, strict=True) if share > 0.01)
        numbers = [float(np.median(v)) if len(v) else float("nan") for v in (off, reading.chart_mm[skin])]
        sys.stdout.write(f"| {path.stem} | {numbers[0]:.1f} | {numbers[1]:.1f} | {told} |\n")
        rows.append(picture(pixels, reading))
    if chosen.sheet and rows:
        half = (len(rows) + 1) // 2
        blank = np.zeros_like(rows[0])
        pairs = [np.hstack([rows[k], rows[k + half] if k + half < len(rows) else blank]) for k in range(half)]
        cv2.imwrite(str(chosen.sheet), np.ascontiguousarray(np.vstack(pairs)[..., ::-1]))


if __name__ == "__main__":
    main()
