"""Task of zeta: a baked texture at 1/10.7 of the chart's resolution -> 4608 x 3072, eight times as large."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from models.networks.configs import ZETA_CHANNELS
from models.networks.rcan import SCALE
from models.training.degrade import blur, gain, noisy
from models.training.store import Arrays, Patches
from models.training.tasks import FLIPPED, Batch, byte, choice, psnr, uniform
from service.runtime.network_registry import GEOMETRY

SMALL = 48
"""Pixels of the 576 x 384 texture along a patch of 512 texels of the full chart."""

PLAIN_EVERY = 3
"""Every third crop of a batch has no noise: there the network is to say what is most likely, and only that."""

SQUARE_WEIGHT = 100.0
"""Of the squared difference where there is no noise: as steep as the plain difference at 1.3 codes of 255."""

PLAIN_WEIGHT = 0.4
"""Of the plain difference where there is noise: no noise can know where the true pores are."""


def made_up(batch: Batch) -> Tensor:
    """(N,) which items have noise to make detail of."""
    return batch["noise"].flatten(1).abs().amax(1) > 0.0


def as_fitted(small: Tensor, generator: torch.Generator) -> Tensor:
    """Small textures a little blurred and noisy, as those of fitted photos are."""
    return noisy(blur(small, float(uniform(generator, -0.6, 0.7, 1))), generator)


def bicubic(small: Tensor) -> Tensor:
    """(N, 3, h, w) -> (N, 3, 8 h, 8 w), a little beyond [0, 1] where it overshoots."""
    return functional.interpolate(small, scale_factor=float(SCALE), mode="bicubic")


def large_mask(batch: Batch) -> Tensor:
    """(N, 1, 8 h, 8 w) mask of the large textures."""
    return functional.interpolate(batch["mask"], scale_factor=float(SCALE), mode="nearest")


class ZetaTask:
    """Pairs of patches; the small one is the large one by area, then blurred and noisy as fitted textures are.

    Noise is the knob of made-up detail: without it the result is the best guess, with it it looks like skin.
    """

    def __init__(self, data: Path, side: int = 32, noise: int = 8) -> None:
        wanted = ("texture", "mask", "geometry")
        self.train = Patches(data / "train", wanted, full_size_only=True)
        self.test = Patches(data / "held-out", wanted, full_size_only=True)
        self.side, self.noise = side, noise

    def refresh(self) -> None:
        """Read captures that came since the last time."""
        self.train.refresh()
        if not self.test.items:
            self.test.refresh()

    def batch(self, size: int, generator: torch.Generator) -> Batch:
        """Random crops."""
        crops = []
        for _ in range(size):
            pair = self.pair(self.train.items[choice(generator, len(self.train.items))])
            row, column = (choice(generator, SMALL - self.side + 1) for _ in range(2))
            crops.append(self._cut(pair, row, column, bool(torch.rand(1, generator=generator) < 0.5)))
        batch = {name: torch.stack([c[name] for c in crops]) for name in crops[0]}
        both = torch.cat([batch["large"].flatten(2), batch["small"].flatten(2)], 2)
        both = gain(both[..., None], generator)[..., 0]
        split = batch["large"].shape[-1] ** 2
        batch["large"] = both[..., :split].reshape(batch["large"].shape)
        batch["small"] = as_fitted(both[..., split:].reshape(batch["small"].shape), generator)
        noise = torch.randn(size, self.noise, self.side, self.side, generator=generator)
        noise[::PLAIN_EVERY] = 0.0
        batch["noise"] = noise
        return batch

    def held_out(self) -> list[Batch]:
        """Whole patches as fitting hands them over, first all without noise, then all with it."""
        items = self.test.items[:16]
        generator = torch.Generator().manual_seed(1)
        batches = []
        for i in range(0, len(items), 4):
            pairs = [self.pair(item) for item in items[i : i + 4]]
            batch = {name: torch.stack([p[name] for p in pairs]) for name in pairs[0]}
            batch["small"] = as_fitted(batch["small"], generator)
            batch["noise"] = torch.randn(len(pairs), self.noise, SMALL, SMALL, generator=generator)
            batches.append(batch)
        return [batch | {"noise": torch.zeros_like(batch["noise"])} for batch in batches] + batches

    def seeds(self) -> list[int]:
        """The subject of each item of the held-out batches."""
        return 2 * [int(item["seed"]) for item in self.test.items[:16]]

    def predict(self, network: nn.Module, batch: Batch) -> Tensor:
        """Large texture in [0, 1]."""
        index = [GEOMETRY.index(name) for name in ZETA_CHANNELS[3:]]
        inputs = torch.cat([batch["small"] * 2.0 - 1.0, batch["geometry"][:, index]], 1)
        result: Tensor = network(inputs, batch["noise"])
        return result * 0.5 + 0.5

    def loss(self, result: Tensor, batch: Batch) -> Tensor:
        """L1 of what the small texture can know, that is of both after a small blur, and of the plain difference.

        Without noise the plain difference counts by its square: the median of a skin with sparse pores has none.
        """
        truth, mask = batch["large"], large_mask(batch)
        noisy = made_up(batch).float().view(-1, 1, 1, 1)
        apart = (result - truth) * mask
        plain = (PLAIN_WEIGHT * noisy * apart.abs() + SQUARE_WEIGHT * (1.0 - noisy) * apart.square()).mean()
        known = ((blur(result, 3.0) - blur(truth, 3.0)).abs() * mask).mean()
        return plain + 2.0 * known

    def measure(self, result: Tensor, batch: Batch) -> dict[str, float]:
        """Without noise: PSNR beside bicubic's, of all and made small again, which is what a small texture can know.

        With it: likeness when made small again, and share of fine detail.
        """
        truth, mask = batch["large"], large_mask(batch)
        cubic = bicubic(batch["small"]).clamp(0.0, 1.0)
        back, cubic_back, known = (
            functional.interpolate(image, scale_factor=1.0 / SCALE, mode="area") for image in (result, cubic, truth)
        )
        fine = [((x - blur(x, 2.0)) * mask).std() for x in (result, cubic, truth)]
        if not made_up(batch).any():
            return {
                "score": psnr(result, truth, mask),
                "bicubic": psnr(cubic, truth, mask),
                "small_again": psnr(back, known, batch["mask"]),
                "small_again_bicubic": psnr(cubic_back, known, batch["mask"]),
            }
        return {
            "with_detail": psnr(result, truth, mask),
            "consistency_255": float((back - batch["small"]).abs().mean() * 255.0),
            "detail": float(fine[0] / (fine[2] + 1e-9)),
            "detail_bicubic": float(fine[1] / (fine[2] + 1e-9)),
        }

    def sheet(self, result: Tensor, batch: Batch) -> Tensor:
        """Enlarged input, result and truth one below the other."""
        near = functional.interpolate(batch["small"], scale_factor=float(SCALE), mode="nearest")
        rows = [near, result.clamp(0.0, 1.0), batch["large"]]
        return torch.cat([torch.cat(list(row[:3]), 2) for row in rows], 1)

    @staticmethod
    def judged(batch: Batch, image: Tensor) -> Tensor:
        """What the discriminator sees: textures made with noise, and the smooth textures that they came from."""
        base = functional.interpolate(batch["small"], scale_factor=float(SCALE), mode="bilinear", align_corners=False)
        shown = made_up(batch)
        image, base = image[shown], base[shown]
        # Detail is a few codes strong; enlarged, the discriminator need not learn to see it.
        return torch.cat([(image - base) * 8.0, base * 2.0 - 1.0], 1)

    def pair(self, item: Arrays) -> Batch:
        """Small and large texture of a patch, with mask and geometry at the small one's size."""
        texture, mask = byte(item["texture"])[None], byte(item["mask"])[None]
        cells = torch.from_numpy(item["geometry"].astype("float32"))[None, :, 1:-1, 1:-1]
        large = functional.interpolate(texture, (SMALL * SCALE, SMALL * SCALE), mode="area")
        return {
            "large": large[0],
            "small": functional.interpolate(large, (SMALL, SMALL), mode="area")[0],
            "mask": functional.interpolate(mask, (SMALL, SMALL), mode="area")[0],
            "geometry": functional.interpolate(cells, (SMALL, SMALL), mode="area")[0],
        }

    def _cut(self, pair: Batch, row: int, column: int, flip: bool) -> Batch:
        result = {}
        for name, values in pair.items():
            scale = values.shape[-1] // SMALL
            rows = slice(row * scale, (row + self.side) * scale)
            part = values[:, rows, column * scale : (column + self.side) * scale]
            if flip:
                part = part.flip(-1) * (FLIPPED.view(-1, 1, 1) if name == "geometry" else 1.0)
            result[name] = part
        return result
