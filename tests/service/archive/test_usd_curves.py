"""Strands as USD curves, as USD's own library reads them."""

from __future__ import annotations

import numpy as np
import pytest

from service.archive.usd import MOST_POINTS, curves_bytes
from service.hair.groom import make_groom
from service.hair.style import NAMED


@pytest.mark.parametrize("kind", ["bob", "afro"])
def test_usd_reads_the_strands(kind: str) -> None:
    pxr = pytest.importorskip("pxr")
    from pxr import Sdf, Usd, UsdGeom

    assert pxr
    groom = make_groom(NAMED[kind], 3, 400)
    layer = Sdf.Layer.CreateAnonymous(".usda")
    assert layer.ImportFromString(curves_bytes(groom, "hair").decode())
    stage = Usd.Stage.Open(layer)
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    curves = UsdGeom.BasisCurves(stage.GetDefaultPrim())
    counts = np.array(curves.GetCurveVertexCountsAttr().Get())
    points = np.array(curves.GetPointsAttr().Get()).reshape(len(groom), -1, 3)
    assert len(counts) == len(groom)
    assert (counts == points.shape[1]).all()
    assert points.shape[1] == min(groom.strands.shape[1], MOST_POINTS)
    assert np.allclose(points[:, 0], groom.strands[:, 0], atol=1e-5)
    assert np.allclose(points[:, -1], groom.strands[:, -1], atol=1e-5)
    widths = np.array(curves.GetWidthsAttr().Get())
    assert len(widths) == points.shape[0] * points.shape[1]
    assert 2e-5 < widths.min() < widths.max() < 1.2e-4
    colour = np.array(curves.GetDisplayColorAttr().Get()).reshape(*points.shape[:2], 3)
    assert np.allclose(colour, groom.colour.linear(points.shape[1]), atol=1e-3)
    assert curves.GetWidthsInterpolation() == UsdGeom.Tokens.vertex
