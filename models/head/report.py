"""What the head model is like: ``python -m models.head.report [--out FOLDER]``.

Prints texels per mm and stretch by region, the fill of the chart, and measures of the population; with ``--out`` also
draws the chart and the head with a checkerboard of 10 mm squares.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from models.head.chart.measure import HEIGHT, WIDTH, Measures, measure, overlap_texels, percentiles
from models.head.shoot import look_at, shoot
from service.head.files import load_head
from service.head.model import HeadModel

REGIONS = (
    "face", "cheek_left", "cheek_right", "forehead", "nose", "lips", "eyelid_left", "chin", "ear_left", "neck", "scalp",
    "mouth_inner", "eye_socket",
)  # fmt: skip


def chart_table(head: HeadModel, m: Measures) -> str:
    """Texels per mm (5, 50, 95 %) and stretch (50, 90, 99 %, largest) by region and part."""
    lines = ["region          area cm2   texels/mm 5%   50%   95%    stretch 50%   90%   99%     max"]
    rows = [(n, head.region(n)[head.triangles].mean(1) > 0.5) for n in REGIONS if n in head.region_names]
    rows += [(n, head.triangle_part == k) for k, n in enumerate(head.part_names) if k > 0]
    for name, inside in rows:
        area = m.area_mm2 * inside
        ppm = percentiles(m.ppm, area, (0.05, 0.5, 0.95))
        stretch = percentiles(m.stretch, area, (0.5, 0.9, 0.99, 1.0))
        lines.append(
            f"{name:14s} {area.sum() / 100:9.1f} {ppm[0]:14.1f} {ppm[1]:5.1f} {ppm[2]:5.1f} "
            f"{stretch[0]:13.2f} {stretch[1]:5.2f} {stretch[2]:5.2f} {stretch[3]:7.1f}"
        )
    fill = np.abs(m.signed_px2).sum() / (WIDTH * HEIGHT)
    lines.append(
        f"fill {fill:.3f}, flipped triangles {(m.signed_px2 <= 0).sum()}, doubly covered texels {overlap_texels(head)}"
    )
    return "\n".join(lines)


def draw_chart(head: HeadModel, path: Path) -> None:
    """Outline of every polygon at 3072 x 2048."""
    image = np.full((2048, 3072, 3), 255, np.uint8)
    points = head.uv * [3072, -2048] + [0, 2048]
    for polygon, part in zip(head.polygon_uv, head.polygon_part, strict=True):
        corners = (points[polygon[polygon >= 0]] * 16).round().astype(np.int32)
        cv2.polylines(image, [corners], True, (60, 60, 60) if part == 0 else (200, 80, 0), 1, cv2.LINE_AA, 4)
    cv2.imwrite(str(path), image)


def checkerboard(size_px: int = 32, width: int = 3072, height: int = 2048) -> npt.NDArray[np.float32]:
    """(H, W, 3) linear checkerboard in the chart, grey with a hue that changes from tile to tile."""
    y, x = np.mgrid[0:height, 0:width] // size_px
    dark = ((x + y) % 2).astype(np.float32)[..., None]
    hue = np.stack([0.5 + 0.5 * np.sin(x / 9.0), 0.5 + 0.5 * np.sin(y / 7.0), np.full(x.shape, 0.5)], -1)
    return np.asarray(0.12 + 0.6 * dark * (0.5 + 0.5 * hue), np.float32)


def draw_heads(head: HeadModel, path: Path) -> None:
    """The mean head with a checkerboard from four sides."""
    board, background = checkerboard(), np.full((700, 700, 3), 0.7, np.float32)
    views = []
    for yaw in (0.0, 45.0, 90.0, 180.0):
        light = np.array([np.sin(np.radians(-yaw)), 0.3, np.cos(np.radians(yaw))])
        camera = look_at(yaw, 0, 0, 1.5, 700, 3000.0)
        views.append(
            shoot(head, head.mean.astype(float), board, camera, light / np.linalg.norm(light), 0.4, background).pixels
        )
    cv2.imwrite(str(path), np.hstack(views)[..., ::-1])


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--head", type=Path)
    parser.add_argument("--out", type=Path, help="folder for chart.png and checkerboard.png")
    arguments = parser.parse_args()
    head = load_head(arguments.head)
    skin = (head.polygon_part == 0).sum()
    sys.stdout.write(
        f"{head.name}: {len(head.mean)} vertices, {len(head.polygons)} polygons ({skin} of skin), "
        f"{len(head.identity)} components, "
        f"{len(head.expression_names)} units, {len(head.landmark_triangle)} landmarks\n"
    )
    sys.stdout.write(chart_table(head, measure(head)) + "\n")
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        draw_chart(head, arguments.out / "chart.png")
        draw_heads(head, arguments.out / "checkerboard.png")


if __name__ == "__main__":
    main()
