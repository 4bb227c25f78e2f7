"""The baked texture of a whole chart, end to end, as ``python -m models.lightstage sample`` writes it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")

from models.lightstage.light.bake import bake, footprint  # noqa: E402
from models.lightstage.light.expose import expose  # noqa: E402
from models.lightstage.light.geometry import Geometry  # noqa: E402
from models.lightstage.light.prior import sample_scene  # noqa: E402
from models.lightstage.light.texture import bake_texture  # noqa: E402
from models.lightstage.sample import write_sample  # noqa: E402
from models.lightstage.skin.window import ChartWindow  # noqa: E402
from models.lightstage.stage import Stage  # noqa: E402
from service.light.plan import LightPlan  # noqa: E402

pytestmark = [pytest.mark.train, pytest.mark.slow]

SIZE = (192, 128)


def test_a_texture_is_the_same_every_time_and_what_sample_writes(tmp_path: Path) -> None:
    stage = Stage.open()
    skin = stage.skin(1034)
    texture = bake_texture(skin, stage, *SIZE, 1034)
    assert texture.shape == (128, 192, 3)
    assert texture.dtype == np.uint8
    face = skin.maps(ChartWindow.whole(*SIZE)).mask[0].numpy() > 0.5
    assert texture[face].mean() > 20  # lit
    assert np.ptp(texture[face]) > 60  # and not evenly
    write_sample(stage, 1034, *SIZE, "neutral", tmp_path)
    written = cv2.imread(str(tmp_path / "texture.png"))
    assert written is not None
    np.testing.assert_array_equal(written[..., ::-1], texture)
    assert not np.array_equal(bake_texture(skin, stage, *SIZE, 1035), texture)  # another light


def test_a_crop_of_a_real_head_is_that_of_the_whole_and_bfloat16_is_near() -> None:
    stage = Stage.open()
    skin = stage.skin(1034)
    geometry = Geometry.of(stage.head, stage.vertices(skin), size=SIZE, sky_size=(96, 64), directions=64)
    whole = ChartWindow.whole(*SIZE)
    maps = skin.maps(whole)
    scene = expose(maps, geometry, sample_scene(7), whole)
    everything = LightPlan.everything(scene)
    outer = footprint(whole, geometry, everything)
    exact = bake(skin.maps(outer), geometry, scene, everything, whole, maps_window=outer)
    assert exact.isfinite().all()
    crop = ChartWindow(72, 40, 48, 32, *SIZE)
    around = footprint(crop, geometry, everything)
    part = bake(skin.maps(around), geometry, scene, everything, crop, maps_window=around)
    torch.testing.assert_close(part, crop.cut(exact, whole), rtol=0, atol=1e-3)
    half = bake(skin.maps(outer), geometry, scene, everything, whole, maps_window=outer, dtype=torch.bfloat16)
    assert half.dtype == torch.bfloat16
    skin_texels = maps.mask[0] > 0.5
    difference = (half.float() - exact).abs()[:, skin_texels]
    assert float(difference.mean()) < 1.0 / 255  # rounding of bfloat16 near 1 is 1/256 at most
    assert float(difference.max()) < 16.0 / 255
