"""Light at half the size where no photo shows the skin: the seen face stays, and nobody sees where it begins."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from service.colour import FULL_CODE, Codes, from_codes, to_codes
from service.corrections import Ledger
from service.head.files import load_head
from service.levels import LEVELS
from service.reflectance import reflectance
from service.reflectance.albedo import diffuse_albedo as module
from service.reflectance.albedo.diffuse_albedo import LIFTED, NAMES, diffuse_albedo
from service.reflectance.planes import Planes
from service.reflectance.reflectance import make_reflectance
from service.reflectance.reflectance_plan import ReflectancePlan
from service.reflectance.subject import Subject, beyond
from service.reflectance.translate import MapInputs
from service.runtime.network_registry import CLUES, GEOMETRY, PARTS
from service.runtime.networks import Engine
from tests.service.reflectance.toys import noise, toy_folder, toy_subject

SIZE = (768, 512)
STEP = FULL_CODE / 255


@pytest.fixture(scope="module")
def subject() -> Subject:
    """A face seen from the front, with holes where the eyes are."""
    head = load_head()
    seen = np.zeros((384, 576), bool)
    seen[70:300, 170:406] = True
    seen[140:165, 210:255] = seen[140:165, 320:365] = False
    plain = Subject.of(head, head.mean, eye_light=np.array([0.6, 0.55, 0.5]))
    return replace(plain, unseen=beyond(seen), parts=np.full((384, 576, 3), 90, np.uint8))


def made(subject: Subject) -> Codes:
    """The albedo of smooth skin with a little grain."""
    row, column = np.mgrid[: SIZE[1], : SIZE[0]] / 60
    shade = 0.1 * np.sin(row)[..., None] * np.cos(column)[..., None] + [0.2, -0.1, -0.2]
    texture = to_codes(np.asarray(shade + np.random.default_rng(1).normal(0, 0.01, (*SIZE[::-1], 1)), np.float32))
    planes = Planes(SIZE)
    planes.add_coarse(GEOMETRY, subject.geometry)
    planes.add_coarse(CLUES, subject.clues)
    planes.add_codes("texture", texture)
    assert subject.parts is not None
    planes.add_coarse(PARTS, np.moveaxis(subject.parts, 2, 0) * np.float32(2 / 255) - np.float32(1))
    job = MapInputs(planes, subject.skin(SIZE), Engine(threads=2), tile=256)
    return diffuse_albedo(texture, job, subject, Ledger(NAMES)).albedo


@pytest.fixture(scope="module")
def whole(subject: Subject) -> Codes:
    return made(replace(subject, unseen=None))


def share(subject: Subject) -> np.ndarray:
    assert subject.unseen is not None
    return np.asarray(cv2.resize(subject.unseen, SIZE, interpolation=cv2.INTER_LINEAR))


def test_the_seen_face_stays_and_the_rest_is_alike(subject: Subject, whole: Codes) -> None:
    """By the shipped network: to a tenth of an 8-bit step where a photo shows skin, as tiles lie otherwise there."""
    apart = np.abs(made(subject).astype(np.int64) - whole).max(-1)
    assert apart[share(subject) == 0].max() <= 0.1 * STEP
    skin = cv2.erode(subject.own_skin, np.ones((9, 9))) > 0
    assert 0 < apart[skin].mean() < 3 * STEP


def test_no_line_shows_where_it_begins(subject: Subject, whole: Codes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Light that is off by far comes in little by little; grain stays; eyes and teeth keep their own colours."""
    half = np.full((3, SIZE[1] // 2, SIZE[0] // 2), 0.5, np.float32)
    monkeypatch.setattr(module, "halved_light", lambda *_: half)
    after, far = made(subject), share(subject)
    skin = subject.skin(SIZE) == 255
    ratio = (from_codes(after) + LIFTED) / (from_codes(whole) + LIFTED)
    line = ratio[250, :, 1]  # across a cheek, from the unseen to the seen
    told, own = line[far[250] == 1].mean(), line[far[250] == 0].mean()
    assert own == pytest.approx(1, abs=1e-3) and told < 0.8
    assert np.abs(np.diff(cv2.blur(line[None, 100:660], (3, 1)))).max() < 0.15 * (own - told)
    assert np.abs(after[far == 0].astype(np.int64) - whole[far == 0]).max() <= 0.1 * STEP
    assert (after[~skin & (subject.skin(SIZE) == 0)] == whole[~skin & (subject.skin(SIZE) == 0)]).all()


def test_holes_in_the_face_count_as_seen(subject: Subject) -> None:
    far = beyond(np.zeros((384, 576), bool))
    assert far.min() == 1, "nothing is seen"
    assert beyond(np.ones((384, 576), bool)).max() == 0
    assert subject.unseen is not None and subject.unseen[60:310, 160:416].max() < 1
    assert subject.unseen[:40].min() == 1


def test_maps_say_so(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Small maps have no light to halve, and the level that others are measured by is made whole."""
    engine = Engine(threads=1, folder=toy_folder(tmp_path_factory.mktemp("models")))
    plan = ReflectancePlan.of(["diffuse_albedo"], super_resolution=False)
    hidden = replace(toy_subject(), unseen=np.ones((64, 96), np.float32))
    code = "unseen-light-halved"
    assert code not in make_reflectance(noise(), hidden, plan, (96, 64), engine).fallbacks
    monkeypatch.setattr(reflectance, "SMALL_MAP", 0)
    assert code in make_reflectance(noise(), hidden, plan, (96, 64), engine).fallbacks
    assert code not in make_reflectance(noise(), toy_subject(), plan, (96, 64), engine).fallbacks
    assert [name for name, level in LEVELS.items() if level.unseen_halved] == ["standard", "high"]
