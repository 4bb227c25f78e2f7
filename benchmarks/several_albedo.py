"""Albedo of several photos beside that of each alone: ``python -m benchmarks.several_albedo --data DIR``.

Takes the first photos of heads that ``benchmarks.shoot --views`` has photographed, each in another light. An avatar is
made of each photo and one of all of them (``service.pipeline.make_avatar``); in every photo the albedo of the skin that
it shows is compared with the truth: PSNR of sRGB-coded values as they are, and after the one gain of linear values that
fits best. Beside it the share of the face that was seen, and seconds of the processor.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from benchmarks.heads import IctHeads, Skin, TexturedHead
from benchmarks.metrics import Truth, View, face_region
from benchmarks.shoot import FFHQ_EYES_M, data_folder, ffhq_head, ict_colours
from service.archive.avatar import Avatar
from service.colour import FULL_CODE, linear_to_srgb, srgb_to_linear
from service.face.fit.fit import Fit
from service.map_registry import SEEN
from service.options import Options
from service.pipeline import make_avatar

Float = npt.NDArray[np.float64]
SIZE = (576, 384)
OPTIONS = Options(maps=("diffuse_albedo", "texture", "confidence"), quality="draft", size=SIZE, face="largest")


def head_of(name: str, data: Path, out: Path) -> TexturedHead:
    """The head that was photographed under a name."""
    skin = Skin.load(data / "ffhq_uv_head")
    if name == "ffhq":
        return ffhq_head(skin)
    heads = IctHeads(data / "ict_facekit_head.npz")
    return heads.textured(name, int(name[3:]), ict_colours(heads, skin, np.zeros((0, 3)), FFHQ_EYES_M.mean(0), out))


def psnr(avatar: Avatar, fit: Fit, truth: Truth, head: TexturedHead) -> tuple[float, float]:
    """DB of the albedo in one photo: as it is, and after the best gain."""
    if avatar.reflectance is None or avatar.reflectance.diffuse_albedo is None:
        raise ValueError("the avatar has no albedo")
    view = View.of(fit, avatar.head, truth.mask.shape)
    pupils = truth.position[truth.eyes[:, 1], truth.eyes[:, 0]]
    both = view.skin & truth.mask & face_region(truth.position, truth.normal, pupils, truth.yaw)
    eyes = np.linalg.norm(truth.position[:, :, None] - head.eyes, axis=-1).min(-1) < 1.3 * head.eye_radius
    both &= ~eyes
    wanted = head.colours[cKDTree(head.vertices).query(truth.position[both])[1]]
    coded = view.of_map(avatar.reflectance.diffuse_albedo / FULL_CODE)[both]
    ours = srgb_to_linear(np.clip(coded, 0, 1).astype(np.float32)).astype(np.float64)
    gain = float((ours * wanted).sum() / max(float((ours * ours).sum()), 1e-9))
    errors = [
        np.mean((_coded(scale * ours) - _coded(wanted)) ** 2) for scale in (1.0, gain)
    ]  # fmt: skip
    raw, best = (-10 * np.log10(max(float(error), 1e-9)) for error in errors)
    return raw, best


def _coded(linear: Float) -> Float:
    return linear_to_srgb(np.clip(linear, 0, 1).astype(np.float32)).astype(np.float64)


def seen(avatar: Avatar) -> float:
    """Share of the chart's face that was seen."""
    from service.geometry.chart import Chart
    from service.head.regions import vertex_mask

    chart = Chart.build(avatar.head, *avatar.texture.confidence.shape[::-1])
    face = chart.interpolate(vertex_mask(avatar.head, "face", "ear_left", "ear_right"))[..., 0] > 0.5
    return float((avatar.texture.confidence[face] >= SEEN).mean())


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data")
    parser.add_argument("--photos", type=Path, default=Path("build/bench"))
    parser.add_argument("--heads", default="ffhq", help="names with commas between")
    parser.add_argument("--count", type=int, default=3, help="photos of each head")
    arguments = parser.parse_args()
    data = data_folder(arguments.data)
    sys.stdout.write("| head | raw dB, alone | all | best gain, alone | all | seen, first | all | CPU s, one | all |\n")
    sys.stdout.write("|---" * 9 + "|\n")
    for name in arguments.heads.split(","):
        head = head_of(name, data, arguments.photos)
        paths = sorted((arguments.photos / "views").glob(f"{name}_*.png"), key=lambda p: int(p.stem.split("_")[1]))
        files = [path.read_bytes() for path in paths[: arguments.count]]
        truths = [Truth.load(str(path.with_suffix(".npz"))) for path in paths[: arguments.count]]
        begin = time.process_time()
        alone = [make_avatar(file, OPTIONS) for file in files]
        each = (time.process_time() - begin) / len(files)
        begin = time.process_time()
        together = make_avatar(files, OPTIONS)
        whole = time.process_time() - begin
        fits = {source.photo.sha256: source.fit for source in together.sources}
        one = np.mean([psnr(a, a.fit, truth, head) for a, truth in zip(alone, truths, strict=True)], 0)
        all_ = np.mean([
            psnr(together, fits[a.photo.sha256], truth, head) for a, truth in zip(alone, truths, strict=True)
            if a.photo.sha256 in fits
        ], 0)  # fmt: skip
        sys.stdout.write(
            f"| {name} | {one[0]:.1f} | {all_[0]:.1f} | {one[1]:.1f} | {all_[1]:.1f} | {seen(alone[0]):.2f} "
            f"| {seen(together):.2f} | {each:.1f} | {whole:.1f} |\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
