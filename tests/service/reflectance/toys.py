"""The seven networks as toys: random weights, the channels of the real ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from service.reflectance.subject import Subject
from service.runtime.network_registry import EYES, FINE_ALBEDO, FINE_SHADED
from tests.service.runtime.toynets import toy_net, write_models
from tests.toyhead import sphere_head

RGB = ("r", "g", "b")
TEXTURE = tuple(f"texture_{c}" for c in RGB)
ALBEDO = tuple(f"albedo_{c}" for c in RGB)
POSITION = tuple(f"position_{c}" for c in "xyz")
OBJECT = tuple(f"normal_object_{c}" for c in "xyz")
TANGENT = tuple(f"normal_tangent_{c}" for c in "xyz")
XY = ("x", "y")

TEXTURE_SIZE = (96, 64)


def toy_models() -> dict[str, bytes]:
    features = tuple(f"feature_{index}" for index in range(4))
    context = ("context_0", "context_1", "context_2")
    return {
        "zeta_body": toy_net("zeta_body", (*TEXTURE, *POSITION, "mask"), features, whole=TEXTURE_SIZE, seed=1),
        "zeta_tail": toy_net("zeta_tail", (*features, "noise_0"), RGB, scale=8, seed=2),
        "delta_context": toy_net(
            "delta_context", (*TEXTURE, *EYES, "depth", *OBJECT, "mask"), context, whole=(48, 32), seed=3
        ),
        "delta": toy_net("delta", (*TEXTURE, *context, "depth", *OBJECT, *POSITION, "mask"), ALBEDO, seed=4),
        "psi": toy_net("psi", (FINE_ALBEDO, *ALBEDO, *POSITION), ("specular_albedo",), seed=5),
        "rho": toy_net("rho", (FINE_SHADED, "shaded_grey", *TANGENT, *POSITION, "drawn_detail"), XY, seed=6),
        "sigma": toy_net("sigma", (FINE_SHADED, "shaded_grey", *OBJECT, *POSITION, "drawn_detail"), XY, seed=7),
    }


def toy_folder(folder: Path) -> Path:
    return write_models(folder, toy_models())


def toy_subject() -> Subject:
    head = sphere_head()
    light = np.array([0.5, 0.45, 0.4])
    subject = Subject.of(head, head.mean, eye_light=light)
    return replace(subject, parts=noise(1))


def noise(seed: int = 0) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    return np.random.default_rng(seed).integers(16, 256, (*TEXTURE_SIZE[::-1], 3), np.uint8)
