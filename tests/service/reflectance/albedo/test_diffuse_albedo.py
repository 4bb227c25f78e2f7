"""delta, what lies beside the skin, and how sure the albedo is."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from pytest import approx

from service.colour import FULL_CODE, LUMA, linear_to_srgb, srgb_to_linear
from service.face.features.eye_colours import SCLERA
from service.geometry.chart import NO_PART
from service.head.files import load_head
from service.light.scene import BRIGHT
from service.reflectance.albedo.beside_skin import as_told, close_seam, pad_parts, pad_skin, part_island, scaled
from service.reflectance.albedo.diffuse_albedo import EXPOSED, asked, exposure, without
from service.reflectance.planes import Planes
from service.reflectance.subject import Subject
from service.runtime.network_registry import EYES, INPAINTED, LIDS, LIT, TEXTURE


def test_the_white_of_an_eye_is_white_in_any_light() -> None:
    """In dim or coloured light eyes would else be darker than the skin, or of the light's opposite colour."""
    for factor in ([0.05, 0.05, 0.05], [0.9, 0.4, 0.2], [1.0, 1.0, 1.0]):
        coded = linear_to_srgb((SCLERA * factor).astype(np.float32)).reshape(1, 1, 3) * 2 - 1
        bare = without(np.log(np.array(factor, np.float32)), coded)
        assert np.allclose(srgb_to_linear(bare * 0.5 + 0.5)[0, 0], SCLERA, atol=2e-3)


class Recorder:
    """A network that says nothing and keeps what it is asked about."""

    name = "recorder"
    description = SimpleNamespace(channels=(*TEXTURE, *EYES), whole=(64, 48))

    def run(self, maps: np.ndarray) -> np.ndarray:
        self.seen = maps
        return np.zeros((3, 48, 64), np.float32)


@pytest.mark.parametrize("level", [0.02, 0.3, 1.0])
def test_a_photo_is_asked_about_as_if_it_were_well_exposed(level: float) -> None:
    """A face in a dim photo counted as a dark one: closed eyes in the light of one lamp cost 8 dB."""
    shape = (48, 64)
    albedo = np.random.default_rng(0).uniform(0.1, 0.6, (3, *shape)).astype(np.float32)
    planes, full, network = Planes(shape[::-1]), np.ones((1, *shape), np.float32), Recorder()
    planes.add_coarse(TEXTURE, linear_to_srgb(level * albedo) * 2 - 1)
    planes.add_coarse(EYES, np.concatenate([0 * full, 0 * full, 0 * full, full]))
    planes.add_coarse(["mask", LIT], np.concatenate([full, full]))
    found, _, _ = asked(network, planes)  # type: ignore[arg-type]
    shown = srgb_to_linear(network.seen[:3] / 2 + 0.5)
    assert np.quantile(np.tensordot(LUMA, shown, 1), BRIGHT) == approx(EXPOSED, rel=0.02)
    gain = np.log(shown.mean() / found.texture.mean())
    assert network.seen[3:6] == approx(np.full((3, *shape), gain), abs=0.03) and (network.seen[6] == 1).all()
    assert found.light == approx(np.full((3, *shape), -gain), abs=0.03)
    assert found.texture == approx(level * albedo, abs=1e-4), "the texture itself stays"


def test_lids_behind_open_eyes_are_completed_as_all_unseen_skin_is() -> None:
    """Filled with the dark of lashes, they glowed or stayed dark by what light the network took them to be in."""
    shape = (48, 64)
    half = np.zeros((1, *shape), np.float32)
    half[:, :, :32] = 1
    planes, full = Planes(shape[::-1]), np.ones((1, *shape), np.float32)
    planes.add_coarse(TEXTURE, np.zeros((3, *shape), np.float32))
    planes.add_coarse(EYES, np.zeros((4, *shape), np.float32))
    planes.add_coarse(["mask", LIT, INPAINTED, LIDS], np.concatenate([full, full - half, half, full]))
    found, lids, _ = asked(Recorder(), planes)  # type: ignore[arg-type]
    assert found.inpainted == approx(half[0]) and lids.min() == 1


def test_a_photo_without_lit_skin_keeps_its_exposure() -> None:
    """The quantile of nothing."""
    assert exposure(np.full((3, 4, 4), 0.1, np.float32), np.zeros((4, 4), np.float32)) == 1.0
    assert np.isfinite(exposure(np.zeros((3, 4, 4), np.float32), np.ones((4, 4), np.float32)))


HEAD = load_head()
SIZE = (1536, 1024)


def test_skin_goes_on_beyond_its_island_from_farther_inside() -> None:
    """Another tone out there was a crease along the rim of the neck in the normals, the border's own a dark line."""
    subject = Subject.of(HEAD, HEAD.mean)
    part = subject.islands(SIZE)
    albedo = np.full((SIZE[1], SIZE[0], 3), 30000, np.uint16)
    albedo[part == NO_PART] = 50000
    albedo[(part != NO_PART) & (part != HEAD.part_names.index("skin"))] = 10000
    skin = (part == HEAD.part_names.index("skin")).astype(np.uint8)
    border = (cv2.erode(skin, np.ones((7, 7), np.uint8)) == 0) & (skin > 0)
    after = pad_skin(np.where(border[..., None], 26000, albedo).astype(np.uint16), subject)
    assert (after[part != NO_PART] == albedo[part != NO_PART]).all(1).mean() > 0.995  # the others: beside eyes
    outside = after[part == NO_PART]
    assert (outside == 30000).all(1).mean() > 0.8  # the others lie beside eyes and teeth
    assert set(np.unique(outside)) <= {30000, 50000}


def test_both_sides_of_the_seam_have_one_tone_and_the_face_keeps_its_own() -> None:
    """Half of the head 2,000 codes darker: at the seam behind both meet, in front of the ears nothing changes."""
    subject = Subject.of(HEAD, HEAD.mean)
    albedo = np.full((SIZE[1], SIZE[0], 3), 30000, np.uint16)
    albedo[:, SIZE[0] // 2 :] = 28000
    after = close_seam(albedo.copy(), subject).astype(int)
    rows = slice(round(0.3 * SIZE[1]), round(0.55 * SIZE[1]))
    left, right = after[rows, 14], after[rows, -15]
    assert np.abs(left - right).max() < 300, "2000 before"
    middle = slice(round(0.3 * SIZE[0]), round(0.7 * SIZE[0]))
    assert np.abs(after[rows, middle] - albedo[rows, middle].astype(int)).max() <= 1
    part = subject.islands(SIZE)
    others = (part != NO_PART) & (part != HEAD.part_names.index("skin"))
    assert np.array_equal(after[others], albedo[others])


def test_teeth_and_eyes_go_on_beyond_their_islands_and_no_other_island_changes() -> None:
    """Filtered by a renderer, a pale texel beside the biting edge was a line between the teeth."""
    subject = Subject.of(HEAD, HEAD.mean)
    part = subject.islands(SIZE)
    albedo = np.full((SIZE[1], SIZE[0], 3), 50000, np.uint16)
    drawn = np.zeros(part.shape, bool)
    for index, name in enumerate(HEAD.part_names):
        place = part_island(HEAD, index, SIZE, 0) if name.startswith(("eye", "teeth")) else None
        if place is not None:
            box, inside = place
            albedo[box][inside > 0] = 10000 + 1000 * index
            drawn[box] |= inside > 0
    after = pad_parts(albedo.copy(), subject)
    own = [index for index, name in enumerate(HEAD.part_names) if name.startswith(("eye", "teeth"))]
    others = (part != NO_PART) & ~np.isin(part, own)
    assert np.array_equal(after[drawn], albedo[drawn]) and np.array_equal(after[others], albedo[others])
    assert drawn.sum() > 2000
    beside = (cv2.dilate(drawn.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0) & ~drawn & ~others
    assert beside.sum() > 300 and (after[beside] < 50000).all()
    far = cv2.dilate(drawn.astype(np.uint8), np.ones((15, 15), np.uint8)) == 0
    assert np.array_equal(after[far], albedo[far])


def test_the_factor_is_on_linear_albedo() -> None:
    skin = np.array([0.4, 0.25, 0.2], np.float32)
    albedo = np.tile(np.rint(linear_to_srgb(skin) * FULL_CODE).astype(np.uint16), (64, 96, 1))
    factor = np.ones((3, 16, 24), np.float32)
    factor[:, :8] = np.array([0.5, 0.25, 1.2])[:, None, None]
    before = albedo.copy()
    found = srgb_to_linear(scaled(albedo, factor) / FULL_CODE)
    assert np.allclose(found[:24], skin * [0.5, 0.25, 1.2], atol=2e-4)
    assert np.array_equal(albedo[40:], before[40:])


def test_the_told_light_holds_for_all_but_detail() -> None:
    """What the network brightens in a wide region comes back; its fine lines stay, and so does what is no skin."""
    texture = np.full((96, 144, 3), 0.3)
    lines = 1 + 0.2 * (np.arange(768) % 4 < 2)[None, :, None]
    network = np.where(np.arange(512)[:, None, None] < 256, [0.45, 0.4, 0.3], 0.3) * lines
    codes = np.rint(linear_to_srgb(network.astype(np.float32)) * FULL_CODE).astype(np.uint16)
    weight = np.ones((96, 144), np.float32)
    weight[:, :18] = 0
    before = codes.copy()
    found, _ = as_told(codes, np.log(np.moveaxis(texture, 2, 0)).astype(np.float32), weight)
    linear = srgb_to_linear(found / FULL_CODE)
    assert np.allclose(linear[32:480, 200:].mean((0, 1)), 0.3, rtol=0.02)
    assert linear[100, 400] / linear[100, 402] == approx(1.2, abs=0.02)
    assert np.array_equal(found[:, :80], before[:, :80])
