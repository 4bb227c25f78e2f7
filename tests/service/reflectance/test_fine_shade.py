"""What the networks of the normals see of the photo's light: creases, not the light itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from service.colour import FULL_CODE, LUMA, linear_to_srgb
from service.reflectance import reflectance as make
from service.reflectance.albedo.highlights import without_highlights
from service.reflectance.plan import Plan
from service.reflectance.planes import Planes
from service.reflectance.reflectance import make_reflectance
from service.reflectance.relief.normal_inputs import READERS, shaded_grey
from service.runtime.network_registry import CONTEXT as LIGHT
from service.runtime.networks import Engine
from tests.service.reflectance.toys import noise, toy_folder, toy_subject

Float = npt.NDArray[np.float32]

SIZE = (96, 600)
ALBEDO = np.array([0.5, 0.3, 0.22], np.float32)


def codes_of(linear: Float) -> npt.NDArray[np.uint16]:
    return np.rint(linear_to_srgb(linear) * FULL_CODE).astype(np.uint16)


def planes_of(texture: npt.NDArray[np.uint16], log_light: Float) -> Planes:
    planes = Planes(SIZE)
    planes.add_codes("texture", texture)
    planes.add_coarse(LIGHT, np.stack([log_light] * 3))
    return planes


def in_light(shade: Float) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint16], Float]:
    """Texture in light from the side with a finer shade, the albedo's codes, and the light's logarithm."""
    light = np.broadcast_to(np.linspace(-1.8, 0.2, SIZE[0], dtype=np.float32), SIZE[::-1])
    albedo = np.broadcast_to(ALBEDO, (*SIZE[::-1], 3))
    return codes_of(albedo * np.exp(light + shade)[..., None]), codes_of(albedo), np.ascontiguousarray(light)


def test_a_crease_is_seen_and_the_light_that_it_lies_in_is_not() -> None:
    """delta takes the crease off the albedo: read there, wrinkles would come out flat."""
    crease = np.zeros(SIZE[::-1], np.float32)
    crease[300] = -0.5
    texture, albedo, light = in_light(crease)
    grey = shaded_grey(planes_of(texture, light), albedo) / FULL_CODE
    expected = float(linear_to_srgb(ALBEDO) @ LUMA)
    plain = np.delete(grey, 300, axis=0)
    assert np.abs(plain / expected - 1).max() < 0.06, "the light goes; sRGB is not quite a power"
    assert np.abs(grey[300] / plain[299] / np.exp(-0.5 / 2.2) - 1).max() < 0.04


@pytest.mark.parametrize("strength", [-1e4, 1e4, np.nan, np.inf])
def test_any_light_gives_a_value(strength: float) -> None:
    """exp of it would overflow, and a NaN in 16-bit codes is any number."""
    texture, albedo, light = in_light(np.zeros(SIZE[::-1], np.float32))
    light[:, :40] = strength
    with np.errstate(all="raise", under="ignore"):
        grey = shaded_grey(planes_of(texture, light), albedo)
    assert grey.shape == SIZE[::-1]
    assert np.ptp(grey[:, :30], axis=0).max() == 0, "the same in every row"
    assert np.array_equal(grey[:, 50:], shaded_grey(planes_of(texture, in_light(np.zeros(SIZE[::-1], np.float32))[2]),
                                                    albedo)[:, 50:])  # fmt: skip


def test_without_a_known_light_it_is_the_luma_of_the_albedo() -> None:
    """Of a delta that has no context; the texture's light would be read as relief."""
    texture, albedo, _ = in_light(np.zeros(SIZE[::-1], np.float32))
    planes = Planes(SIZE)
    planes.add_codes("texture", texture)
    assert np.abs(shaded_grey(planes, albedo) - (albedo @ LUMA)).max() < 1


def test_a_highlight_goes_from_the_grey_as_from_the_albedo() -> None:
    """Its border would be read as a rim."""
    y, x = np.indices((128, 192))
    spot = np.exp(-((x - 90) ** 2 + (y - 60) ** 2) / (2 * 4.0**2)).astype(np.float32)[..., None]
    skin = np.broadcast_to(ALBEDO, (128, 192, 3))
    shown = codes_of(np.minimum(skin + 0.5 * spot, 1).astype(np.float32))
    albedo, grey = shown.copy(), np.rint(shown @ LUMA).astype(np.uint16)
    before = albedo @ LUMA
    without_highlights(albedo, shown, np.full((128, 192), 255, np.uint8), grey=grey)
    assert before[60, 90] - float(albedo[60, 90] @ LUMA) > 0.05 * FULL_CODE
    assert np.abs(grey.astype(np.float32) - albedo @ LUMA).max() < 3


def test_it_is_made_only_where_a_network_reads_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """25 million texels that nobody asked for would take a second."""
    engine, calls = Engine(threads=1, folder=toy_folder(tmp_path)), []

    def counted(*given: Planes) -> npt.NDArray[np.uint16]:
        calls.append(1)
        return shaded_grey(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(make, "shaded_grey", counted)
    for roles, times in (({"diffuse_albedo", "specular_albedo"}, 0), (READERS, 1)):
        calls.clear()
        make_reflectance(noise(), toy_subject(), Plan.of(roles), (240, 160), engine)
        assert len(calls) == times
