"""delta's context on real skin: ``python -m benchmarks.real_albedo --data DIR --captures build/captures [--run RUN]``.

DIR holds ``ict_facekit_head.npz``, ``ffhq_uv_head/``, ``hifi3d_uv/`` and ``lee_perry_smith/``, which no training has
seen. Their albedo maps are brought to the chart of our head by the fit of a photo, and lit by what held-out captures of
the light stage stood in; so a network is judged on skin that is not the stage's, in seconds and without rendering.
Held-out subjects of the stage cannot tell how well a network does on others' skin: it may know the stage's by its hue.

Told for each skin: PSNR in dB of sRGB-coded albedo over the face, with the light of the eyes and without, the same
after the best gain, and log(light found / true light), mean and standard deviation over lights; above 0 is too dark.
``--run`` judges the checkpoint of a training run instead of the network in the box.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import numpy.typing as npt
import torch
import typer
from torch import Tensor, nn

from benchmarks.heads import Skin, TexturedHead
from benchmarks.light_spread import photo_of, true_albedo
from benchmarks.shoot import data_folder, ffhq_head
from benchmarks.subjects import scan
from export.networks.convert import load_run
from models.colour import linear, srgb
from models.lightstage.references import linear as decoded
from models.lightstage.references import read
from models.networks.context import HEIGHT, WIDTH
from models.tables import tell
from models.training.albedo import log_light, unlit
from models.training.context import ContextTask, best_gain
from models.training.degrade import blur
from models.training.evaluate import Shipped
from models.training.eyes import eye_light
from models.training.tasks import Batch, channels, psnr
from service.colour import linear_to_srgb
from service.face.finder import FaceFinder
from service.face.fit.fit import fit_face
from service.geometry.chart import Chart
from service.head.files import load_head
from service.options import Options
from service.photo.gate import read_photo
from service.runtime.sessions import MODELS
from service.texture.make import make_texture
from service.texture.result import Texture

MARK = ("<!-- real-albedo -->", "<!-- /real-albedo -->")
HIFI = ("", "_1", "_2")
SEEN = 128
"""Confidence code from which a texel shows the skin."""
HAIR = 60 / 255
"""sRGB value below which a texel is hair, or was not painted at all."""
BRIGHT = (0.8, 0.38)
"""Quantile of the face's linear values that a photo exposes to that value."""
SEED = 3


@dataclass(frozen=True)
class RealSkin:
    """A skin on the chart.

    Attributes:
        albedo: (1, 3, h, w) sRGB-coded.
        face: (1, 1, h, w) 1 where the photo showed the face.
        lit: (1, 1, h, w) in [0, 1], 1 where it showed skin and no hair.
    """

    albedo: Tensor
    face: Tensor
    lit: Tensor


def skins(data: Path, out: Path) -> dict[str, RealSkin]:
    """Every real skin by its name."""
    skin = Skin.load(data / "ffhq_uv_head")
    faces = {"ffhq": ffhq_head(skin)}
    for number, end in enumerate(HIFI, 1):  # the same layout of the chart
        coloured = replace(skin, texture=decoded(read(data / "hifi3d_uv" / f"albedo{end}.png")))
        faces[f"hifi3d {number}"] = ffhq_head(coloured)
    scanned = scan(data, out)[0]
    return on_chart(faces["ffhq"], faces, out) | on_chart(scanned, {"scan": scanned}, out)


def on_chart(head: TexturedHead, coloured: Mapping[str, TexturedHead], out: Path) -> dict[str, RealSkin]:
    """Skins of one shape, by the fit of one photo of ``head`` in soft light."""
    path = photo_of(head, "soft", out)
    photo, model = read_photo(Path(f"{path}.png").read_bytes()), load_head()
    fit = fit_face(FaceFinder().find(photo.pixels)[0], photo, model, Options().fit_settings())
    chart = Chart.build(model, 4 * WIDTH, 4 * HEIGHT)
    with np.load(f"{path}.npz") as truth:
        position, mask = truth["position"].astype(np.float64), truth["mask"]
    found = {}
    for name, one in coloured.items():
        albedo, _ = true_albedo(one, position, mask)
        pixels = np.rint(255 * linear_to_srgb(np.clip(albedo, 0, 1).astype(np.float32))).astype(np.uint8)
        texture = make_texture(replace(photo, pixels=pixels), model, fit, chart)
        found[name] = _small(texture, chart.mask)
    return found


def _small(texture: Texture, mask: npt.NDArray[np.bool_]) -> RealSkin:
    size = (WIDTH, HEIGHT)
    small = np.asarray(cv2.resize(texture.texture, size, interpolation=cv2.INTER_AREA), np.float32) / 255
    seen, lit = (np.where(mask, one, 0).astype(np.uint8) for one in (texture.confidence, texture.lit_skin))
    face = (cv2.resize(seen, size, interpolation=cv2.INTER_AREA) >= SEEN) & (small.max(2) > HAIR)
    shown = np.asarray(cv2.resize(lit, size, interpolation=cv2.INTER_AREA), np.float32) / 255
    albedo = torch.from_numpy(np.ascontiguousarray(np.moveaxis(small, 2, 0)))[None]
    return RealSkin(albedo, *(torch.from_numpy(p.astype(np.float32))[None, None] for p in (face, shown)))


def lit(task: ContextTask, skin: RealSkin, generator: torch.Generator) -> list[Batch]:
    """The skin in the light of each held-out capture, exposed as cameras do, with what its eyes would show."""
    batches = []
    for number, item in enumerate(task.test.items):
        batch = task.of([(item, number % len(item["texture"]))])
        inside = channels(batch, ("mask",))
        light = blur(log_light(batch["texture"], batch["albedo"]) * inside, 1.0) / (blur(inside, 1.0) + 1e-3)
        shown = linear(skin.albedo) * torch.exp(light)
        level = torch.quantile(shown.mean(1, keepdim=True)[skin.face > 0.5], BRIGHT[0]).clamp(min=1e-4)
        texture = srgb((shown * (BRIGHT[1] / level)).clamp(0.0, 1.0))
        batch |= {"texture": texture, "clean": texture, "albedo": skin.albedo, "lit": skin.lit}
        batch["eyes"] = eye_light(log_light(texture, skin.albedo), task.lids, batch["whites"], torch.ones(1), generator)
        batches.append(batch)
    return batches


def judged(task: ContextTask, network: nn.Module, batch: Batch, face: Tensor) -> tuple[float, float, float, float]:
    """PSNR with eyes, without them, with them after the best gain; and log(light found / true)."""
    light, blind = (
        task.predict(network, batch | {"eyes": eyes}) for eyes in (batch["eyes"], torch.zeros_like(batch["eyes"]))
    )
    gain = best_gain(light, batch | {"lit": face})
    scores = (psnr(unlit(batch["clean"], one), batch["albedo"], face) for one in (light, blind, light - gain))
    return (*scores, float(gain.mean()))  # type: ignore[return-value]


def table(rows: Mapping[str, npt.NDArray[np.float64]]) -> list[str]:
    """Markdown of the (n, 4) results of :func:`judged` by skin."""
    lines = ["| skin | albedo dB | no eyes seen | best gain | log(light found / true) |", "|---" * 5 + "|"]
    for name, row in {**rows, "all": np.concatenate(list(rows.values()))}.items():
        eyes, blind, best, gain = row.mean(0)
        lines.append(f"| {name} | {eyes:.1f} | {blind:.1f} | {best:.1f} | {gain:+.2f} +- {row[:, 3].std():.2f} |")
    return lines


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    captures: Annotated[Path, typer.Option(help="Folder of captures.")] = Path("build/captures"),
    out: Annotated[Path, typer.Option(help="Folder that keeps the photos.")] = Path("build/bench"),
    run: Annotated[Path | None, typer.Option(help="Training run to judge; else the network in the box.")] = None,
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the table into.")] = None,
) -> None:
    """Print the table."""
    out.mkdir(parents=True, exist_ok=True)
    task, generator = ContextTask(captures), torch.Generator().manual_seed(SEED)
    task.test.refresh()
    network = Shipped("delta_context", MODELS) if run is None else load_run(run)[1].eval()
    with torch.no_grad():
        rows = {
            name: np.array([judged(task, network, batch, skin.face) for batch in lit(task, skin, generator)])
            for name, skin in skins(data_folder(None if data is None else str(data)), out).items()
        }
    lights = len(next(iter(rows.values())))
    tell("\n".join([*table(rows), "", f"Means over the lights of {lights} held-out captures."]), MARK, write)


if __name__ == "__main__":
    typer.run(main)
