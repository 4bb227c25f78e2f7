"""SkinModel beside things that cover much of a face."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from service.geometry.chart import Chart
from service.head.files import load_head
from service.reflectance.subject import Subject
from service.texture.make import make_texture
from service.texture.segmentation.skin_model import fit_skin_model, skin_likelihood
from service.texture.segmentation.zones import Zones
from tests.service.texture.scenes import SKIN, fitted, photograph, turned

HEAD = load_head()
CAP = np.array([0.45, 0.6, 0.95])
CHART = Chart.build(HEAD, 192, 128)
ZONES = Zones.of(CHART)
NORMAL = CHART.normals(HEAD.mean).reshape(-1, 3)[CHART.texels]
HEIGHT = CHART.interpolate(HEAD.mean).reshape(-1, 3)[CHART.texels, 1]
FACE = ZONES.skin & (ZONES.face > 0.9) & (ZONES.features < 0.01) & (ZONES.scalp < 0.01) & (NORMAL[:, 2] > 0.5)


@pytest.mark.parametrize(
    ("worn", "cover"),
    [
        ("cap", (0.55, 0.65, 0.95)),
        ("cap", (0.85, 0.1, 0.1)),
        ("mask", (0.7, 0.8, 0.9)),
        ("mask", (0.3, 0.6, 0.4)),
    ],
)
@pytest.mark.parametrize("skin_colour", [(0.8, 0.6, 0.5), (0.4, 0.27, 0.2)])
def test_a_cap_or_a_mask_over_much_of_a_face_is_no_skin(
    worn: str, cover: tuple[float, float, float], skin_colour: tuple[float, float, float]
) -> None:
    """Taken for skin, a blue cap would be made skin by a blue light."""
    edge = np.percentile(HEIGHT[FACE], 55)
    over = (edge < HEIGHT) == (worn == "cap")
    light = np.clip(0.75 + 0.25 * NORMAL[:, :1], 0, 1)
    seen = (np.where(over[:, None], cover, skin_colour) * light).astype(np.float32)
    skin = fit_skin_model(seen, NORMAL, np.clip(NORMAL[:, 2], 0, 1) ** 2, ZONES)
    assert skin is not None
    assert np.abs(skin.colour - np.array(skin_colour) * 0.75).max() < 0.05  # teeth are judged beside it
    likely = skin_likelihood(skin, seen, NORMAL, face=1.0)
    assert np.median(likely[FACE & ~over]) > 0.95
    assert np.percentile(likely[FACE & over], 90) < 0.05


def _with_cap(points: np.ndarray) -> np.ndarray:
    eye = HEAD.mean[HEAD.region("eyelid_left") > 0.5, 1].mean()
    return np.where(points[:, 1:2] > eye + 0.035, CAP, SKIN)


@pytest.mark.parametrize("yaw", [0, 25])
def test_a_cap_stays_and_is_named_and_its_light_is_not_read(yaw: int) -> None:
    """Read as the light of skin, its blue makes skin of the cap, and a cap of the skin."""
    camera = turned(yaw, 500)
    bare, capped = (
        make_texture(photograph(HEAD, camera, paint), HEAD, fitted(HEAD, camera), CHART)
        for paint in (lambda points: np.broadcast_to(SKIN, (len(points), 3)), _with_cap)
    )
    assert bare.worn is None and bare.warnings == ()
    assert capped.worn is not None and capped.warnings == ("face-covered",)
    drawn = _with_cap(CHART.interpolate(HEAD.mean).reshape(-1, 3))[:, 2].reshape(CHART.mask.shape) > 0.9
    skin = (CHART.part == HEAD.part_names.index("skin")) & (capped.confidence > 0)
    edge = cv2.Canny(drawn.astype(np.uint8) * 255, 50, 100) > 0
    inner = skin & (cv2.dilate(edge.astype(np.uint8), np.ones((9, 9), np.uint8)) == 0)
    assert (inner & drawn).sum() > 500 and (inner & ~drawn).sum() > 500
    assert np.abs(capped.texture[inner & drawn] / 255 - CAP).mean() < 0.03
    assert capped.worn[inner & drawn].mean() > 230 and capped.worn[inner & ~drawn].mean() < 10
    assert capped.lit_skin[inner & drawn].mean() < 10
    subject = Subject.in_photo(HEAD, fitted(HEAD, camera), capped)
    assert subject.inpainted is not None and (subject.inpainted * (capped.worn == 255)).max() == 0.0
