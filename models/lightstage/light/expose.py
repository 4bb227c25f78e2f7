"""Choosing the exposure as a photographer would: from the face, once a scene and subject, not per crop."""

from __future__ import annotations

import torch

from models.lightstage.light.bake import radiance
from models.lightstage.light.geometry import Geometry
from models.lightstage.light.maps import LitMaps
from models.lightstage.light.sampling import enlarged
from models.lightstage.skin.window import ChartWindow
from service.colour import LUMA
from service.light.plan import LightPlan
from service.light.scene import BRIGHT, Scene, exposed_for, level_of

__all__ = ["expose", "level_of"]


def expose(skin: LitMaps, geometry: Geometry, scene: Scene, window: ChartWindow) -> Scene:
    """The scene with the exposure that brings the 90th percentile of the face's luminance to the response's target.

    A scene that already has an exposure is returned as it is; in complete darkness the exposure is 1.

    Args:
        skin: maps of the whole chart, small (192 x 128 will do).
        geometry: the head.
        scene: what lights it.
        window: the whole chart at the size of the maps.
    """
    if scene.response.exposure is not None:
        return scene
    views = radiance(skin, geometry, scene, LightPlan.everything(scene), window)
    blend = sum((light * weight for light, weight in views), torch.zeros((), device=geometry.device))
    balance = torch.tensor(scene.response.white_balance, device=geometry.device)
    balance = balance * torch.from_numpy(LUMA).to(geometry.device)
    luminance = (blend * balance.view(3, 1, 1)).sum(0)
    face = (enlarged(geometry.face, window)[0] > 0.5) & (skin.mask[0] > 0.5)
    chosen = luminance[face] if face.any() else luminance.flatten()
    return exposed_for(scene, float(chosen.float().quantile(BRIGHT)))
