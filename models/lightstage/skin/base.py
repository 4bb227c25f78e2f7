"""Slowly varying maps of a subject over the whole chart: pigment by region, gloss by region, masks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from models.lightstage.skin.anatomy import Anatomy, smoothstep
from models.lightstage.skin.hair import beard_cover
from models.lightstage.skin.streams import Stream
from models.lightstage.skin.subject import Subject
from models.lightstage.skin.volumes import Placement, noise

Float = npt.NDArray[np.float64]

CHANNELS = (
    "melanin",  # logarithm of the regional factor
    "blood",  # logarithm of the volume fraction
    "thickness",  # cm
    "oxygenation",
    "gloss",  # s of F0 = 0.04 s before occlusion
    "roughness",  # factor of both lobes
    "relief",  # strength of the net of furrows
    "across",  # 1 where skin lines run across the face
    "lip",  # mm, distance to the vermilion border, negative on it
    "shadow",  # beard shadow, share of light lost
    "scalp",  # cover by hair of the scalp
    "eye",  # mm from the rim of the lids
    "blush",
    "eyeshadow",
    "face",
    "dark",  # openings of nose and mouth
)


@dataclass(frozen=True)
class BaseMaps:
    """(16, H, W) float32 maps in the order of ``CHANNELS``."""

    maps: Tensor

    def split(self, maps: Tensor) -> dict[str, Tensor]:
        """Name the channels of maps that were cut and enlarged."""
        return dict(zip(CHANNELS, maps, strict=True))


def _asymmetric(subject: Subject, name: str, shape: tuple[int, int], spread: float) -> Float:
    """(H, W) smooth random factor about 1, a few bumps over the chart, different left and right."""
    stream = Stream(subject.seed, f"uneven {name}")
    grid = stream.normal(0.0, spread, 7 * 10).reshape(7, 10)
    fine = torch.nn.functional.interpolate(
        torch.from_numpy(grid)[None, None], shape, mode="bicubic", align_corners=True
    )
    return np.exp(fine[0, 0].numpy())


def base_maps(subject: Subject, anatomy: Anatomy, device: torch.device | str = "cpu") -> BaseMaps:
    """Regional pigment (method 1.2) with soft borders and large blotches."""
    a, r = anatomy, subject.regions
    shape = a["seen"].shape

    def mask(name: str) -> Float:
        return np.asarray(a[name] * _asymmetric(subject, name, shape, 0.15), np.float64)

    lip = a["lip_distance"].astype(np.float64)
    cheek, nose, tip = mask("cheek"), mask("nose"), mask("nose_tip")
    forehead, chin, ear, ala = mask("forehead"), mask("chin"), mask("ear"), mask("alae")
    upper, under = mask("eyelid_upper"), mask("under_eye")
    lower = np.maximum(under, 0.7 * mask("eyelid_lower"))
    normal_up = _upward(anatomy)
    melanin = (
        np.log(r.forehead_melanin) * forehead
        + np.log(r.circle_melanin) * lower
        + np.log(r.periocular_melanin) * np.maximum(upper, lower)
        + np.log(r.perioral_melanin) * mask("perioral")
        + np.log(r.neck_melanin) * a["neck"]
        + np.log1p(r.tan * np.clip(normal_up, 0.0, 1.0)) * (1.0 - 0.5 * a["neck"])
        - 0.25 * a["ear"] * 0.0
    )
    blood = (
        np.log(r.forehead_blood) * forehead
        + np.log(r.cheek_blood) * np.clip(cheek * 1.25, 0, 1.2)
        + np.log(r.nose_blood) * np.clip(0.6 * nose + 0.5 * tip + 0.6 * ala, 0.0, 1.2)
        + np.log(r.ear_blood) * ear
        + np.log(r.chin_blood) * chin
        + np.log(r.upper_lid_blood) * upper
        + np.log(r.circle_blood) * lower
        - 0.1 * a["neck"]
    )
    thin = 1.0 - 0.35 * np.maximum(a["eyelid_upper"], 0.7 * lower)
    oxygenation = subject.tone.oxygenation + (r.circle_oxygenation - subject.tone.oxygenation) * np.clip(lower, 0, 1)
    oily = 1.0 + 0.1 * subject.gloss.oil
    gloss = (
        0.66
        + 0.06 * forehead * oily
        + 0.1 * np.clip(nose, 0, 1) * oily
        + 0.03 * chin
        - 0.06 * a["ear"]
        - 0.03 * a["neck"]
    )
    gloss = gloss * subject.gloss.scale * _asymmetric(subject, "gloss", shape, 0.04)
    rough = (
        1.0
        - 0.1 * forehead
        - 0.17 * np.clip(nose, 0, 1) * (0.5 + 0.5 * subject.gloss.oil)
        + 0.1 * cheek
        + 0.05 * a["neck"]
    )
    relief = (
        1.0 - 0.25 * a["nose"] - 0.2 * a["forehead"] + 0.3 * a["neck"] + 0.25 * np.maximum(a["eyelid_upper"], lower)
    )
    relief = (relief + 0.35 * a["chin"] - 0.3 * a["ear"]) * _asymmetric(subject, "relief", shape, 0.1)
    across = np.clip(a["forehead"] + a["eyelid_upper"] + lower + 0.8 * a["neck"] + 0.6 * a["brow"], 0.0, 1.0)
    shadow = beard_cover(subject, anatomy) * subject.hair.beard_shadow * _asymmetric(subject, "shadow", shape, 0.2)
    hidden = np.maximum(a["mouth_inner"], a["eye_socket"])
    dark = np.clip(1.5 * a["nostril"] + 0.85 * smoothstep(hidden, 0.4, 1.0), 0.0, 1.0)
    channels = {
        "melanin": melanin, "blood": blood + np.log(subject.tone.blood), "thickness": subject.tone.thickness_cm * thin,
        "oxygenation": oxygenation, "gloss": gloss, "roughness": rough, "relief": relief, "across": across,
        "lip": np.clip(lip, -20.0, 20.0), "shadow": shadow, "scalp": a["scalp"],
        "eye": np.minimum(a["eye_distance"], 30.0),
        "blush": cheek, "eyeshadow": a["eyelid_upper"], "face": a["face"], "dark": dark,
    }  # fmt: skip
    stack = np.stack([np.asarray(channels[name], np.float32) for name in CHANNELS])
    maps = torch.from_numpy(stack).to(device)
    maps[:2] += _blotches(subject, anatomy, device)
    return BaseMaps(maps)


def _blotches(subject: Subject, anatomy: Anatomy, device: torch.device | str) -> Tensor:
    """(2, H, W) changes of log melanin and log blood with wavelengths of 6 to 48 mm."""
    position = torch.from_numpy(anatomy.atlas.position).to(device)
    volume = noise(4).to(device)
    values = volume(position[:, ::2, ::2].contiguous(), 6.0, Placement.sample(subject.seed, "blotches"))
    values = torch.nn.functional.interpolate(values[None], position.shape[1:], mode="bilinear", align_corners=False)[0]
    # Flush comes in patches with soft borders rather than as symmetric waves.
    flush = 0.7 * values[1] + 0.3 * (values[1].clamp(min=0.0) ** 1.5) * 1.6
    return torch.stack([0.55 * subject.regions.mottle_melanin * values[0], subject.regions.blotch_blood * 0.8 * flush])


def _upward(anatomy: Anatomy) -> Float:
    """(H, W) vertical component of the template's normal."""
    du = np.gradient(anatomy.atlas.position, axis=2)
    dv = -np.gradient(anatomy.atlas.position, axis=1)
    normal = np.stack([du[1] * dv[2] - du[2] * dv[1], du[2] * dv[0] - du[0] * dv[2], du[0] * dv[1] - du[1] * dv[0]])
    return np.asarray(normal[1] / np.maximum(np.sqrt((normal**2).sum(0)), 1e-9), np.float64)
