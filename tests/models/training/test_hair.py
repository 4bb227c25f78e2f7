"""The hair reader's training: crops as the service cuts them, truth that turns with them, and a run that goes on."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
pytest.importorskip("moderngl", reason="moderngl is not installed: pip install '.[train]'")

from models.networks.hair import COUNTS, HairReader  # noqa: E402
from models.people.make import Portrait  # noqa: E402
from models.people.shards import UNKNOWN, encode, save  # noqa: E402
from models.training.hair import Run, losses, measured, train  # noqa: E402
from models.training.hair_data import PARTING, batch_of, draw, example, other_hair, read_people  # noqa: E402
from service.face.detection import EYE_LEFT, EYE_RIGHT, MOUTH  # noqa: E402
from service.face.reading import part_labels as labels  # noqa: E402
from service.geometry.camera import Camera  # noqa: E402
from service.hair.kinds import KINDS, PARTINGS  # noqa: E402

pytestmark = pytest.mark.train

SIZE = 160


def made_up(seed: int, roll: float = 0.0) -> Portrait:
    """A face of 60 pixels whose strands run to its own right and down, hair above it, rolled clockwise by an angle."""
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5 - SIZE / 2
    turn = np.array([[np.cos(roll), np.sin(roll)], [-np.sin(roll), np.cos(roll)]])
    own = np.stack([x, y], -1) @ turn.T
    hair = ((np.abs(own[..., 0]) < 32) & (own[..., 1] > -45) & (own[..., 1] < -15)).astype(np.float32)
    face = (own**2).sum(-1) < 32**2
    image = np.where(hair[..., None] > 0, [40, 30, 20], np.where(face[..., None], [200, 150, 120], [90, 120, 150]))
    points = np.random.default_rng(0).uniform(-1, 1, (478, 2)) * 30
    for ends, place in ((EYE_LEFT, (-18, -6)), (EYE_RIGHT, (18, -6)), (MOUTH, (0, 18))):
        points[list(ends)] = place
    points[[0, 1]] = [[-30, -30], [30, 30]]
    way = np.array([0.6, 0.8]) @ turn
    blank = np.zeros((SIZE, SIZE), np.float32)
    part = np.where(hair > 0, labels.HAIR, np.where(face, labels.SKIN, labels.BACKGROUND)).astype(np.uint8)
    jpeg = cv2.imencode(".jpg", image.astype(np.uint8)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()
    kinds = {"length": "short", "gathered": "none", "parting": "left", "fringe": "no", "curl": "wavy"}
    camera = Camera(SIZE, SIZE, 500.0, np.full(2, SIZE / 2), np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
    return Portrait(
        seed, image.astype(np.uint8), jpeg, np.full((SIZE, SIZE, 2), np.nan, np.float32),
        np.zeros((SIZE, SIZE, 3), np.float32), np.full((SIZE, SIZE), np.inf, np.float32), part,
        np.asarray(points @ turn + SIZE / 2, np.float32), np.zeros(478, bool), camera, np.zeros(100, np.float32),
        np.zeros(52, np.float32), np.zeros((4, 3), np.float32), "open", np.zeros(2, np.float32), hair + blank,
        np.asarray(hair[..., None] * way, np.float32), kinds, -0.02,
    )  # fmt: skip


@pytest.fixture
def shards(tmp_path: Path) -> Path:
    for first in (0, 100_000):
        save(encode([made_up(first + k) for k in range(4)]), tmp_path / f"people-{SIZE}-{first:08d}-04.npz")
    return tmp_path


def test_a_crop_stands_upright_and_its_directions_turn_with_it(tmp_path: Path) -> None:
    save(encode([made_up(k, roll) for k, roll in enumerate((0.0, 0.5, -0.3))]), tmp_path / "people-160-00000000-03.npz")
    people = read_people(tmp_path / "people-160-00000000-03.npz")
    crops = batch_of([example(people, k) for k in range(3)])
    for k in (1, 2):
        a, b = crops.mask[0, 0] > 0.5, crops.mask[k, 0] > 0.5
        assert float((a & b).sum() / (a | b).sum()) > 0.9
    inner = (crops.mask > 0.99) & (crops.strands > 0.9)
    for k in range(3):
        ways = crops.direction[k][:, inner[k, 0]]
        np.testing.assert_allclose(ways.mean(1).numpy(), [0.6, 0.8], atol=0.05)


def test_a_mirrored_crop_has_its_parting_on_the_other_side(shards: Path) -> None:
    people = read_people(next(iter(sorted(shards.glob("*.npz")))))
    for seed in range(12):
        one = example(people, 0, np.random.default_rng(seed))
        inner = one.strands[0, 0] > 0.9
        if not inner.any():
            continue
        across = float(one.direction[0, 0][inner].mean())
        assert PARTINGS[int(one.kinds[0, PARTING])] == ("left" if across > 0 else "right")


def test_hair_may_lose_its_strands_or_its_colour_and_nothing_else_does() -> None:
    """Would break: a blur over the hair's edge, which would draw skin into it and hair over the skin."""
    rng = np.random.default_rng(0)
    hair = np.zeros((224, 224), np.float32)
    hair[40:160, 60:170] = 1
    picture = np.where(hair[..., None] > 0, rng.uniform(40, 80, (224, 224, 3)), 200).astype(np.float32)
    made = [other_hair(picture, hair, np.random.default_rng(k)) for k in range(40)]
    assert all(np.array_equal(one[hair == 0], picture[hair == 0]) for one in made)
    inside = hair > 0
    rough = [one[inside].std(0).mean() / max(float(one[inside].mean()), 1.0) for one in made]
    plain = picture[inside].std(0).mean() / picture[inside].mean()
    assert min(rough) < 0.4 * plain and max(rough) < 1.1 * plain
    assert len({round(float(one[inside].mean())) for one in made}) > 8
    nothing = other_hair(picture, np.zeros_like(hair), np.random.default_rng(1))
    np.testing.assert_array_equal(nothing, picture)


def test_the_truth_costs_less_than_anything_else(shards: Path) -> None:
    people = read_people(next(iter(sorted(shards.glob("*.npz")))))
    batch = batch_of([example(people, k) for k in range(4)])
    with torch.no_grad():
        read = HairReader().eval().read(batch.image)
    logits = torch.cat([
        8.0 * torch.nn.functional.one_hot(batch.kinds[:, k], n) for k, n in enumerate(COUNTS)
    ], 1)  # fmt: skip
    true = dataclasses.replace(
        read, mask=30 * (batch.mask - 0.5), direction=batch.direction, kinds=logits,
        ends=torch.cat([batch.ends, torch.full_like(batch.ends, 0.01)], 1),
    )  # fmt: skip
    best, made = losses(true, batch), losses(read, batch)
    assert all(float(best[name]) < float(made[name]) for name in best)
    unknown = dataclasses.replace(batch, kinds=torch.full_like(batch.kinds, UNKNOWN), ends=batch.ends * float("nan"))
    assert float(losses(read, unknown)["kinds"]) == 0.0
    assert float(losses(read, unknown)["ends"]) == 0.0


def test_a_run_learns_and_goes_on_where_it_stopped(shards: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    run = Run(folder)
    people = read_people(sorted(shards.glob("*.npz"))[1])
    rng = np.random.default_rng(0)
    begun = [run.train_step(draw([people], 2, rng), 1.0)["mask"] for _ in range(12)]
    assert np.mean(begun[-3:]) < 0.8 * np.mean(begun[:3])
    train(Run(folder), shards, 2, 1e9, 2, 1, 2)
    again = Run(folder)
    assert again.step == 2
    train(again, shards, 3, 1e9, 2, 1, 2)
    assert again.step == 3
    assert len((folder / "log.jsonl").read_text("utf-8").splitlines()) == 3
    numbers = measured(again.average, [people], 2)
    assert set(KINDS) <= set(numbers)
