"""Colour of skin from melanin and blood: a two-layer model, tabulated and inverted.

The epidermis absorbs like packed melanosomes, the dermis scatters and absorbs like tissue with blood in it. Plain Beer
absorption turns dark skin orange with negative blue; the share ``1 - PACKED`` of light that meets no pigment and the
surface term ``SURFACE`` repair that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from models.lightstage.skin import spectra

Array = npt.NDArray[np.float64]

PACKED = 0.85
SURFACE = 0.015
DERMIS_PATH = 7.0
STEPS = 128
MELANIN_MAX = 1.0
BLOOD_MAX = 0.25
DEPTH_CM = 0.008
OXYGENATIONS = (0.4, 0.65, 0.9)
_WHITE = np.array([0.95047, 1.0, 1.08883])
_RGB_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


def epidermis_transmission(melanin: Array, depth_cm: Array, eumelanin: float) -> Array:
    """(n, 33) transmission down and up again, T^2, for (n,) melanosome volume fraction and (n,) thickness in cm."""
    share = melanin[:, None]
    mu = share * spectra.melanin_absorption(eumelanin) + (1.0 - share) * spectra.base_absorption()
    single = (1.0 - PACKED) + PACKED * np.exp(-mu * depth_cm[:, None] / PACKED)
    return np.asarray(single**2)


def dermis_reflectance(blood: Array, oxygenation: Array) -> Array:
    """(n, 33) diffuse reflectance of the dermis, R_d, for (n,) blood volume fraction and (n,) oxygenation."""
    share = blood[:, None]
    mu = share * spectra.blood_absorption(oxygenation) + (1.0 - share) * spectra.base_absorption()
    return np.asarray(np.exp(-DERMIS_PATH / np.sqrt(3.0 * (1.0 + spectra.reduced_scattering() / mu))))


def skin_rgb(
    melanin: npt.ArrayLike,
    blood: npt.ArrayLike,
    depth_cm: npt.ArrayLike = 0.008,
    oxygenation: npt.ArrayLike = 0.75,
    eumelanin: float = 0.8,
) -> Array:
    """(n, 3) linear sRGB reflectance in [0, 1]; arguments broadcast to (n,). R = R0 + (1 - R0) T^2 R_d, integrated."""
    fm, fb, d, s = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(a, np.float64)) for a in (melanin, blood, depth_cm, oxygenation))
    )
    spectrum = SURFACE + (1.0 - SURFACE) * epidermis_transmission(fm, d, eumelanin) * dermis_reflectance(fb, s)
    return np.asarray(np.clip(spectrum @ spectra.rgb_weights(), 0.0, 1.0))


def lab(rgb: npt.ArrayLike) -> Array:
    """(..., 3) CIE L*a*b* (D65) of (..., 3) linear sRGB."""
    xyz = np.asarray(rgb, np.float64) @ _RGB_TO_XYZ.T / _WHITE
    f = np.where(xyz > 0.008856, np.cbrt(np.maximum(xyz, 0.0)), 7.787 * xyz + 16.0 / 116.0)
    return np.stack([116.0 * f[..., 1] - 16.0, 500.0 * (f[..., 0] - f[..., 1]), 200.0 * (f[..., 1] - f[..., 2])], -1)


def typology_angle(rgb: npt.ArrayLike) -> Array:
    """(...,) individual typology angle in degrees, atan2(L* - 50, b*), of (..., 3) linear sRGB (Chardon 1991)."""
    values = lab(rgb)
    return np.degrees(np.arctan2(values[..., 0] - 50.0, values[..., 2]))


def melanin_for_angle(
    angle_deg: float, blood: float, depth_cm: float = 0.008, oxygenation: float = 0.75, eumelanin: float = 0.8
) -> float:
    """Melanosome fraction in [1e-4, 1] whose skin has the given typology angle, to 0.01 degrees where one exists.

    Beyond the ends of what the model can colour, the nearest end is returned. The angle falls monotonically with
    melanin, so bisection on the cube root is safe.
    """
    low, high = 1e-4 ** (1 / 3), MELANIN_MAX ** (1 / 3)
    for _ in range(40):
        middle = 0.5 * (low + high)
        angle = float(typology_angle(skin_rgb(middle**3, blood, depth_cm, oxygenation, eumelanin))[0])
        low, high = (middle, high) if angle > angle_deg else (low, middle)
    return float((0.5 * (low + high)) ** 3)


@dataclass(frozen=True)
class ColourTable:
    """Lookup of the model at one eumelanin share.

    The epidermis only sees the product of absorption and thickness, and what is not melanin in it absorbs a thousand
    times less, so thickness is folded into the melanin axis (fm d / DEPTH_CM) instead of being interpolated: exact to
    0.1 in Delta-E where three nodes of depth would err by 8 on dark skin.

    Attributes:
        table: (9, 128, 128) float32 linear sRGB: channel 3 c + j is colour c at oxygenation j; rows are equal steps of
            blood^(1/2), columns of (melanin depth)^(1/3).
    """

    table: Tensor

    @staticmethod
    def build(eumelanin: float, device: torch.device | str = "cpu") -> ColourTable:
        """Tabulate for ``eumelanin`` in [0, 1]: the layers separate, so the table is one matrix product per colour."""
        axis = np.linspace(0.0, 1.0, STEPS)
        fm = MELANIN_MAX * axis**3
        fb, s = (a.ravel() for a in np.meshgrid(BLOOD_MAX * axis**2, OXYGENATIONS, indexing="ij"))
        above = epidermis_transmission(fm, np.full_like(fm, DEPTH_CM), eumelanin)
        below = dermis_reflectance(fb, s)
        weights = spectra.rgb_weights()
        rows = []
        for colour in range(3):
            product = SURFACE + (1.0 - SURFACE) * (below * weights[:, colour]) @ above.T  # (128 S, 128)
            rows.append(product.reshape(STEPS, 3, STEPS).transpose(1, 0, 2))
        table = np.clip(np.concatenate(rows), 0.0, 1.0).astype(np.float32)
        return ColourTable(torch.from_numpy(table).to(device))

    def __call__(self, melanin: Tensor, blood: Tensor, depth_cm: Tensor, oxygenation: Tensor) -> Tensor:
        """(3, h, w) float32 linear sRGB of (h, w) maps; values beyond the table are clamped to its ends.

        Bilinear in melanin and blood, quadratic through the three nodes in oxygenation.
        """
        column = (melanin * depth_cm / (DEPTH_CM * MELANIN_MAX)).clamp(0.0, 1.0) ** (1.0 / 3.0) * 2.0 - 1.0
        row = (blood / BLOOD_MAX).clamp(0.0, 1.0).sqrt() * 2.0 - 1.0
        grid = torch.stack([column, row], -1)[None]
        nodes = torch.nn.functional.grid_sample(self.table[None], grid, mode="bilinear", align_corners=True)[0]
        colour = (nodes.reshape(3, 3, *melanin.shape) * _quadratic(oxygenation, OXYGENATIONS)).sum(1)
        return colour.clamp(0.0, 1.0)


def _quadratic(value: Tensor, nodes: tuple[float, float, float]) -> Tensor:
    """(3, ...) Lagrange weights of equally spaced nodes."""
    t = (value.clamp(nodes[0], nodes[2]) - nodes[1]) / (nodes[2] - nodes[1])
    return torch.stack([0.5 * t * (t - 1.0), 1.0 - t * t, 0.5 * t * (t + 1.0)])
