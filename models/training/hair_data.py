"""Shards of people as training batches of the hair reader: crops as the service cuts them, and what befalls them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.utils.data import IterableDataset, get_worker_info

from models.networks.hair import CELL, SIDE
from models.people.develop import decoded
from models.people.shards import UNKNOWN, load
from service.errors import ModelFault
from service.face.detection import face_roll
from service.face.reading import part_labels as labels
from service.face.reading.reader import HEAD_ABOVE, HEAD_FILL
from service.face.region import Region, level_square
from service.hair.kinds import KINDS, LENGTHS, PARTINGS, length_of

People = dict[str, npt.NDArray[Any]]
Image = npt.NDArray[Any]

KEPT = ("jpeg", "jpeg_end", "part", "hair", "direction", "kinds", "ends_m", "points", "seed")
MIRRORED_PARTING = [PARTINGS.index({"left": "right", "right": "left"}.get(name, name)) for name in PARTINGS]
PARTING, CURL, LENGTH = (list(KINDS).index(name) for name in ("parting", "curl", "length"))
STANDS_IN = 0.3
"""Share of the crops whose background is another portrait, upside down or not."""
FIRST = 12
"""Shards with which a worker begins."""
REFRESH_STEPS = 25
"""Batches after which a shard makes room for another."""


@dataclass(frozen=True)
class HairBatch:
    """N crops and their truth; C cells a side.

    Attributes:
        image: (N, 3, 224, 224) sRGB in [0, 1].
        mask: (N, 1, C, C) share of hair; known: (N, 1, C, C) 1 in the photo.
        direction: (N, 2, C, C) unit; strands: (N, 1, C, C) weight of the direction.
        kinds: (N, 5) int64, ``UNKNOWN`` where nobody knows; ends: (N, 1) metres, NaN where nobody knows.
    """

    image: Tensor
    mask: Tensor
    known: Tensor
    direction: Tensor
    strands: Tensor
    kinds: Tensor
    ends: Tensor

    def of(self, index: Tensor) -> HairBatch:
        """Some of the crops."""
        return HairBatch(*(getattr(self, f.name)[index] for f in fields(self)))

    def to(self, device: torch.device) -> HairBatch:
        """The same elsewhere."""
        return HairBatch(*(getattr(self, f.name).to(device, non_blocking=True) for f in fields(self)))


def read_people(path: Path) -> People:
    """What the hair reader is taught from a shard."""
    arrays = load(path)
    return {key: arrays[key] for key in KEPT}


def crop_of_person(people: People, i: int, rng: np.random.Generator | None) -> tuple[Region, npt.NDArray[np.uint8]]:
    """The square round a person's hair, as the service cuts it, and the picture; shaken where ``rng`` is given."""
    ends = people["jpeg_end"]
    image = decoded(people["jpeg"][(ends[i - 1] if i else 0) : ends[i]].tobytes())
    points = np.zeros((478, 3))
    points[:, :2] = people["points"][i]
    angle = face_roll(points[:468])
    shake = np.zeros(4) if rng is None else rng.normal(0, [0.06, 0.03, 0.03, 0.08])
    fill = HEAD_FILL * np.exp(shake[0])
    square = level_square(points[:468, :2], float(angle + shake[3]), 1 / fill, HEAD_ABOVE)
    turn = np.array([np.cos(square.angle), np.sin(square.angle)]) * square.side
    x, y = square.x + turn[0] * shake[1] - turn[1] * shake[2], square.y + turn[1] * shake[1] + turn[0] * shake[2]
    return Region(float(x), float(y), square.side, square.angle), image


def cut(image: npt.NDArray[Any], region: Region, size: int, fine: bool = True) -> Image:
    """(size, size, ...) float32 of a picture (H, W, ...) in a region, 0 beyond it."""
    matrix = region.matrix(size)
    shift = matrix[:, 2] + matrix[:, :2] @ [0.5, 0.5] - 0.5
    warp = np.concatenate([matrix[:, :2], shift[:, None]], 1)
    flags = (cv2.INTER_LINEAR if fine else cv2.INTER_NEAREST) | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(np.ascontiguousarray(image, np.float32), warp, (size, size), flags=flags))


def _shrunk(values: Image) -> Image:
    side = SIDE // CELL
    return np.asarray(cv2.resize(values, (side, side), interpolation=cv2.INTER_AREA), np.float32)


def example(people: People, i: int, rng: np.random.Generator | None = None, behind: Image | None = None) -> HairBatch:
    """One crop as a batch.

    Args:
        people: of a shard.
        i: which.
        rng: of what befalls it; None: nothing.
        behind: (224, 224, 3) float32 sRGB codes in [0, 255] that stand in for the background.
    """
    region, image = crop_of_person(people, i, rng)
    picture, hair = cut(image, region, SIDE), cut(people["hair"][i], region, SIDE) / 255
    inside = cut(np.full(image.shape[:2], 255, np.uint8), region, SIDE) / 255
    way = cut(people["direction"][i], region, SIDE) / 127
    turn = np.array([[np.cos(region.angle), -np.sin(region.angle)], [np.sin(region.angle), np.cos(region.angle)]])
    way = np.asarray(way @ turn, np.float32)
    kinds = people["kinds"][i].astype(np.int64)
    if behind is not None:
        own = cut((people["part"][i] != labels.BACKGROUND).astype(np.uint8) * 255, region, SIDE) / 255
        own = np.maximum(own, hair)[..., None]
        picture = picture * own + behind * (1 - own)
    if rng is not None:
        picture = other_hair(picture, hair, rng)
        if rng.random() < 0.5:
            picture, hair, inside = (np.ascontiguousarray(a[:, ::-1]) for a in (picture, hair, inside))
            way = np.ascontiguousarray(way[:, ::-1]) * np.array([-1, 1], np.float32)
            kinds[PARTING] = MIRRORED_PARTING[kinds[PARTING]] if kinds[PARTING] != UNKNOWN else UNKNOWN
        picture, inside = spoilt(picture, inside, rng)
    if kinds[LENGTH] == 0:
        kinds[CURL] = UNKNOWN  # cropped hair does not say
    elif kinds[LENGTH] != UNKNOWN:  # by today's borders, whatever they were when the shard was drawn
        kinds[LENGTH] = LENGTHS.index(length_of(float(people["ends_m"][i])))
    mask, known, strands = _shrunk(hair * inside), _shrunk(inside), _shrunk(np.linalg.norm(way, axis=2) * inside)
    run = _shrunk(way)
    run /= np.maximum(np.linalg.norm(run, axis=2, keepdims=True), 1e-6)
    arrays = [np.clip(picture / 255, 0, 1).transpose(2, 0, 1), mask[None], (known > 0.5)[None], run.transpose(2, 0, 1),
              strands[None]]  # fmt: skip
    image, *rest = (torch.from_numpy(np.ascontiguousarray(a, np.float32))[None] for a in arrays)
    ends = torch.tensor([[float(people["ends_m"][i])]])
    return HairBatch(image, rest[0], rest[1], rest[2], rest[3], torch.from_numpy(kinds)[None], ends)


def other_hair(picture: Image, hair: Image, rng: np.random.Generator) -> Image:
    """A crop (224, 224, 3) whose hair, by its share (224, 224) of each pixel, may have lost its strands or its colour.

    Photos that are soft, overexposed or made small show a body of hair without strands, and hair of any brightness.
    """
    share = hair[..., None]
    if rng.random() < 0.4:
        sigma = float(np.exp(rng.uniform(0.4, 2.2)))
        around = cv2.GaussianBlur(hair, (0, 0), sigma)[..., None]
        smooth = cv2.GaussianBlur(picture * share, (0, 0), sigma) / np.maximum(around, 1e-3)
        picture = picture + rng.uniform(0.5, 1) * share * (smooth - picture)
    if rng.random() < 0.3:
        gain = np.exp(rng.normal(0, 0.35) + rng.normal(0, 0.08, 3))
        picture = picture * (1 + share * (gain - 1))
    return np.asarray(np.clip(picture, 0, 255), np.float32)


def spoilt(picture: Image, inside: Image, rng: np.random.Generator) -> tuple[Image, Image]:
    """A crop (224, 224, 3) in other colours and light, blurred, noisy, compressed, or cut off by the photo's border."""
    if rng.random() < 0.4:  # a soft-edged shadow
        side = SIDE // 4
        field = cv2.resize(rng.normal(0, 1, (3, 3)).astype(np.float32), (side, side), interpolation=cv2.INTER_CUBIC)
        edge = np.exp(rng.uniform(0, 3))
        shade = 1 - rng.uniform(0, 0.8) / (1 + np.exp(-np.clip(edge * 2 * field, -20, 20)))
        picture = picture * cv2.resize(shade.astype(np.float32), (SIDE, SIDE))[..., None]
    gain = np.exp(rng.normal(0, 0.12, 3) + rng.normal(0, 0.18))
    picture = 255 * np.clip(picture / 255 * gain, 1e-4, 1) ** np.exp(rng.normal(0, 0.22))
    if rng.random() < 0.1:
        picture = np.repeat(picture.mean(2, keepdims=True), 3, 2)
    if rng.random() < 0.25:
        picture = cv2.GaussianBlur(picture, (0, 0), float(rng.uniform(0.4, 1.8)))
    if rng.random() < 0.3:
        picture = picture + rng.normal(0, rng.uniform(0, 12), picture.shape)
    picture = np.clip(picture, 0, 255)
    if rng.random() < 0.3:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.uniform(25, 90))]
        done, data = cv2.imencode(".jpg", picture.astype(np.uint8), quality)
        coded = cv2.imdecode(data, cv2.IMREAD_COLOR) if done else None
        picture = picture if coded is None else coded
    if rng.random() < 0.6:  # photos end, at some sides or, cut to the head, at all of them
        low, high = rng.uniform(0, 0.28, 2), 1 - rng.uniform(0, 0.35, 2)
        keep = rng.random(4) < (0.5 if rng.random() < 0.6 else 0.95)
        x0, y0 = (np.where(keep[:2], low, 0) * SIDE).astype(int)
        x1, y1 = (np.where(keep[2:], high, 1) * SIDE).astype(int)
        frame = np.zeros((SIDE, SIDE), np.float32)
        frame[y0:y1, x0:x1] = 1
        picture, inside = picture * frame[..., None], inside * frame
    return np.asarray(picture, np.float32), np.asarray(inside, np.float32)


def batch_of(examples: list[HairBatch]) -> HairBatch:
    """Several crops as one batch."""
    return HairBatch(*(torch.cat([getattr(one, f.name) for one in examples]) for f in fields(HairBatch)))


class HairCrops(IterableDataset[HairBatch]):
    """Endless batches of spoilt crops from the shards that there are; each worker of a loader has a pool of its own.

    Args:
        shards: lists the shards there are; new ones are taken in.
        count: crops in a batch.
        seed: of all chance.
        at_once: shards in memory of a worker.
    """

    def __init__(self, shards: Callable[[], list[Path]], count: int, seed: list[int], at_once: int = 40) -> None:
        self.shards, self.count, self.seed, self.at_once = shards, count, seed, at_once

    def __iter__(self) -> Iterator[HairBatch]:
        worker = get_worker_info()
        rng = np.random.default_rng([*self.seed, worker.id if worker else 0])
        pool: list[People] = []
        names: list[Path] = []
        step = 0
        while True:
            for _ in range(FIRST if not pool else int(step % REFRESH_STEPS == 0)):
                fresh = [path for path in self.shards() if path not in names]
                if fresh:
                    path = fresh[int(rng.integers(len(fresh)))]
                    pool, names = [*pool, read_people(path)][-self.at_once :], [*names, path][-self.at_once :]
            if not pool:
                raise ModelFault("no shard to train on; make some: python -m models.people --framing hair")
            yield draw(pool, self.count, rng)
            step += 1


def draw(pool: list[People], count: int, rng: np.random.Generator) -> HairBatch:
    """A batch of random people, each spoilt in its way."""
    made: list[HairBatch] = []
    for _ in range(count):
        people = pool[int(rng.integers(len(pool)))]
        behind = None
        if made and rng.random() < STANDS_IN:
            other = (255 * made[int(rng.integers(len(made)))].image[0]).numpy().transpose(1, 2, 0)
            turned = np.ascontiguousarray(np.rot90(other, int(rng.choice([0, 2]))), np.float32)
            behind = np.asarray(cv2.GaussianBlur(turned, (0, 0), float(rng.uniform(0.3, 4))), np.float32)
        made.append(example(people, int(rng.integers(len(people["seed"]))), rng, behind))
    return batch_of(made)
