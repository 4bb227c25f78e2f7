"""Shards of synthetic people as training batches of the reader: truth by cells, and what happens to the crops."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional
from torch.utils.data import IterableDataset, get_worker_info

from models.networks.reader import CELL, PART_CELL, PARTS
from models.people.develop import decoded
from models.people.shards import load
from service.errors import ModelFault
from service.face.reading import part_labels as labels
from service.geometry.camera import ahead

Cells = dict[str, npt.NDArray[Any]]

SMOOTH = (labels.SKIN, labels.BROW, labels.BEARD, labels.LIP, labels.HAIR)
"""Parts whose chart coordinates are learnt: the skin's island. Eyes and mouth lie in small islands elsewhere."""
AT_ONCE = 12
"""Shards in memory: some 800 people."""
USES = 2
"""How often, on average, each person of a shard is drawn before the shard makes room for the next."""


@dataclass(frozen=True)
class Batch:
    """N crops and their truth.

    Attributes:
        image: (N, 3, 256, 256) sRGB in [0, 1].
        chart, normal: (N, 2, 64, 64), (N, 3, 64, 64); charted, shaped: (N, 1, 64, 64) 1 where they are known.
        parts: (N, 13, 128, 128) shares; known: (N, 1, 128, 128) 1 where they are to be learnt.
    """

    image: Tensor
    chart: Tensor
    charted: Tensor
    normal: Tensor
    shaped: Tensor
    parts: Tensor
    known: Tensor

    def to(self, device: torch.device) -> Batch:
        """The same elsewhere."""
        return Batch(*(getattr(self, f.name).to(device) for f in fields(self)))


def shard_seed(path: Path) -> int:
    """First seed of a shard by its name.

    Raises:
        ModelFault: the name is not a shard's.
    """
    found = re.fullmatch(r"people-\d+-(\d+)-\d+\.npz", path.name)
    if found is None:
        raise ModelFault(f"{path} is not named like a shard of portraits")
    return int(found[1])


def read_cells(path: Path) -> Cells:
    """A shard with its truth averaged over cells.

    The value of a cell is the mean of its four middle pixels, where all of them lie on one surface. The third axis of
    the normals points from the camera to the middle of the crop: where a crop lay in its photo cannot be seen in it.
    """
    a = load(path)
    ends = a["jpeg_end"]
    starts = np.concatenate([[0], ends[:-1]])
    images = np.stack([decoded(a["jpeg"][i:k].tobytes()) for i, k in zip(starts, ends, strict=True)])
    part, chart = a["part"], a["chart"].astype(np.float32)
    quad = [(CELL // 2 - 1 + y, CELL // 2 - 1 + x) for y in (0, 1) for x in (0, 1)]
    corner = np.stack([chart[:, y::CELL, x::CELL] for y, x in quad])  # (4, N, 64, 64, 2)
    smooth = np.stack([np.isin(part[:, y::CELL, x::CELL], SMOOTH) for y, x in quad]).all(0)
    near = (corner.max(0) - corner.min(0)).max(-1) < 0.02 * 65535
    normal = np.stack([a["normal"][:, y::CELL, x::CELL].astype(np.float32) for y, x in quad])
    size = part.shape[1]
    middle = (size / 2 - a["principal_point"]) / a["focal_px"][:, None]
    turn = np.stack([ahead(np.array([x, y, 1.0])) for x, y in middle]).astype(np.float32)
    normal = np.einsum("nij,qnyxj->qnyxi", turn, normal)
    depth = np.stack([a["depth"][:, y::CELL, x::CELL].astype(np.float32) for y, x in quad])
    whole = (depth > 0).all(0) & (depth.max(0) - depth.min(0) < 150)
    shaped = whole & np.isin(part[:, quad[0][0] :: CELL, quad[0][1] :: CELL], (*SMOOTH, labels.SCLERA, labels.IRIS))
    return {
        "seed": a["seed"], "image": images, "part": part,
        "chart": (corner.mean(0) - 1.0) / 65534.0, "charted": smooth & near & (corner.min((0, -1)) > 0),
        "normal": normal.mean(0).round().clip(-127, 127).astype(np.int8), "shaped": shaped,
    }  # fmt: skip


def batch_of(chosen: list[tuple[Cells, int]]) -> Batch:
    """A batch of some people."""

    def stack(key: str) -> Tensor:
        return torch.from_numpy(np.stack([cells[key][i] for cells, i in chosen]))

    part = stack("part").long()
    shares = torch.zeros(len(part), PARTS, part.shape[1] // PART_CELL, part.shape[2] // PART_CELL)
    for y in range(PART_CELL):
        for x in range(PART_CELL):
            corner = part[:, None, y::PART_CELL, x::PART_CELL]
            shares.scatter_add_(1, corner, torch.full(corner.shape, PART_CELL**-2.0))
    normal = stack("normal").permute(0, 3, 1, 2).float()
    return Batch(
        image=stack("image").permute(0, 3, 1, 2).float() / 255.0, chart=stack("chart").permute(0, 3, 1, 2).float(),
        charted=stack("charted")[:, None].float(), normal=functional.normalize(normal, dim=1),
        shaped=stack("shaped")[:, None].float(), parts=shares,
        known=torch.ones(len(chosen), 1, *shares.shape[2:]),
    )  # fmt: skip


class Pool:
    """Some shards in memory; the next one is read in the background and takes the place of the oldest.

    Shards that are written while the training runs are taken in when those before have been drawn.

    Args:
        shards: lists the shards there are.
        seed: of their order.

    Raises:
        ModelFault: there is no shard.
    """

    def __init__(self, shards: Callable[[], list[Path]], seed: int) -> None:
        self.list, self.random = shards, np.random.default_rng(seed)
        self.shards = shards()
        if not self.shards:
            raise ModelFault("no shard to train on: make some with python -m models.people --start 100000 --out DIR")
        self.order: list[Path] = []
        self.worker = ThreadPoolExecutor(1)
        self.ready = [read_cells(self._next()) for _ in range(min(AT_ONCE // 2, len(self.shards)))]
        self.coming: Future[Cells] | None = None
        self.drawn = 0

    def _next(self) -> Path:
        if not self.order:
            self.shards = self.list()
            self.order = [self.shards[i] for i in self.random.permutation(len(self.shards))]
        return self.order.pop()

    def draw(self, count: int, generator: torch.Generator) -> Batch:
        """A batch of ``count`` people of the shards in memory."""
        self.drawn += count
        if self.coming is None:
            self.coming = self.worker.submit(read_cells, self._next())
        elif self.coming.done() and self.drawn > USES * len(self.ready[0]["seed"]):
            self.ready = [*self.ready, self.coming.result()][-AT_ONCE:]
            self.coming, self.drawn = None, 0
        which = torch.randint(len(self.ready), (count,), generator=generator).tolist()
        places = torch.rand(count, generator=generator).tolist()
        return batch_of(
            [(self.ready[k], int(p * len(self.ready[k]["seed"]))) for k, p in zip(which, places, strict=True)]
        )


class ReaderCrops(IterableDataset[Batch]):
    """Endless augmented batches; each worker of a loader has a pool and random numbers of its own.

    Args:
        shards: lists the shards there are.
        count: crops in a batch.
        seed: of all chance.
    """

    def __init__(self, shards: Callable[[], list[Path]], count: int, seed: int) -> None:
        self.shards, self.count, self.seed = shards, count, seed

    def __iter__(self) -> Iterator[Batch]:
        worker = get_worker_info()
        seed = 1000 * self.seed + (worker.id if worker else 0)
        pool, generator = Pool(self.shards, seed), torch.Generator().manual_seed(seed)
        while True:
            yield augmented(pool.draw(self.count, generator), generator)


def augmented(batch: Batch, generator: torch.Generator) -> Batch:
    """The batch with mirrored people, painted shadows, other colours, noise, blur, and pieces cut out."""
    n = len(batch.image)
    flip = torch.rand(n, 1, 1, 1, generator=generator) < 0.5

    def mirrored(values: Tensor, sign: Tensor | None = None) -> Tensor:
        turned = values.flip(3)
        return torch.where(flip, turned if sign is None else turned * sign, values)

    chart = torch.where(flip, torch.cat([1.0 - batch.chart[:, :1], batch.chart[:, 1:]], 1).flip(3), batch.chart)
    normal = mirrored(batch.normal, torch.tensor([-1.0, 1.0, 1.0]).view(1, 3, 1, 1))
    image = mirrored(batch.image)
    shade = torch.from_numpy(np.stack([_polygon(generator, image.shape[2]) for _ in range(n)]))[:, None]
    depth = torch.rand(n, 1, 1, 1, generator=generator) * 0.85 * (torch.rand(n, 1, 1, 1, generator=generator) < 0.5)
    image = image * (1.0 - depth * shade)
    gain = torch.exp(
        0.12 * torch.randn(n, 3, 1, 1, generator=generator) + 0.15 * torch.randn(n, 1, 1, 1, generator=generator)
    )
    power = torch.exp(0.2 * torch.randn(n, 1, 1, 1, generator=generator))
    image = (image * gain).clamp(1e-4, 1.0) ** power
    soft = functional.avg_pool2d(functional.pad(image, (1, 1, 1, 1), mode="replicate"), 3, 1)
    image = torch.where(torch.rand(n, 1, 1, 1, generator=generator) < 0.25, soft, image)
    grain = 0.06 * torch.rand(n, 1, 1, 1, generator=generator) ** 2
    image = image + grain * _noise(image, generator)
    hide = torch.from_numpy(np.stack([_polygon(generator, image.shape[2], 0.5) for _ in range(n)]))[:, None]
    hide = hide * (torch.rand(n, 1, 1, 1, generator=generator) < 0.25)
    filling = torch.rand(n, 3, 1, 1, generator=generator) + 0.15 * _noise(image, generator)
    image = image + hide * (filling - image)
    beyond = torch.from_numpy(np.stack([_border(generator, image.shape[2]) for _ in range(n)]))[:, None]
    image, hide = image * (1.0 - beyond), torch.maximum(hide, beyond)
    kept = 1.0 - (functional.max_pool2d(hide, CELL) > 0.3).float()
    clear = 1.0 - (functional.max_pool2d(hide, PART_CELL) > 0.3).float()
    return Batch(
        image.clamp(0.0, 1.0), chart, mirrored(batch.charted) * kept, normal, mirrored(batch.shaped) * kept,
        mirrored(batch.parts), mirrored(batch.known) * clear,
    )  # fmt: skip


def _noise(image: Tensor, generator: torch.Generator) -> Tensor:
    """White noise of the images' shape: one field, shifted for each image."""
    field = torch.randn(image.shape[1:], generator=generator)
    shifts = torch.randint(image.shape[2], (len(image), 2), generator=generator).tolist()
    return torch.stack([field.roll(shift, (1, 2)) for shift in shifts])


def _border(generator: torch.Generator, size: int) -> npt.NDArray[np.float32]:
    """(size, size) 1 where a crop reaches beyond its photo, which one in six does, else 0."""
    r = torch.rand(3, generator=generator).numpy()
    image = np.zeros((size, size), np.float32)
    if r[0] < 1 / 6:
        width = int(r[1] * 0.3 * size)
        image[:width] = 1.0
        image = np.rot90(image, int(r[2] * 4)).copy()
    return image


def _polygon(generator: torch.Generator, size: int, small: float = 1.0) -> npt.NDArray[np.float32]:
    """(size, size) a random soft-edged polygon in [0, 1], drawn at a quarter of the size where its edge is soft."""
    r = torch.rand(20, generator=generator).numpy()
    blur = 0.5 + 12.0 * float(r[18]) ** 2
    side = size // 4 if blur > 4.0 else size
    count = 3 + int(r[0] * 5)
    angle = np.sort(r[1 : 1 + count]) * 2 * np.pi
    radius = (0.1 + 0.5 * r[8 : 8 + count]) * side * small
    points = r[16:18] * side + np.stack([np.cos(angle), np.sin(angle)], 1) * radius[:, None]
    image = np.zeros((side, side), np.float32)
    cv2.fillPoly(image, [points.astype(np.int32)], 1.0)
    image = np.asarray(cv2.GaussianBlur(image, (0, 0), blur * side / size), np.float32)
    return image if side == size else np.asarray(cv2.resize(image, (size, size)), np.float32)
