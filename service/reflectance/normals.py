"""rho and sigma: normals for specular and for diffuse reflection, in tangent space (AvatarMe, section 4.3)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.arrays import Float32
from service.reflectance.result import NORMAL_ONE
from service.reflectance.subject import COVERED
from service.reflectance.translate import MapInputs, translate

SPECULAR, DIFFUSE = "rho", "sigma"

STEEPEST_Z = 0.17
"""Smallest z of a unit normal, a tilt of 80 degrees: steeper slopes are not meaningful, and 8 bits do not resolve
them."""


def tangent_normals(name: str, job: MapInputs) -> npt.NDArray[np.int16]:
    """(H, W, 2) int16 codes of x and y from network ``name``; flat off the skin and where the skin is covered.

    The networks read relief off bare skin, and give the likeliest: where colour and shade tell little, little of it
    (``benchmarks.real_skins``). Strands of hair, brows and frames of glasses are dark lines as creases are,
    and what lies under them is not seen: there the map is flat.

    Args:
        name: ``SPECULAR`` or ``DIFFUSE``.
        job: inputs of the network; without a channel ``COVERED`` all skin is bare.

    Raises:
        ModelFault: the network is missing, changed, or does not fit.
    """
    result = np.zeros((*job.skin.shape, 2), np.int16)
    covered = job.planes.read([COVERED]) if COVERED in job.planes.channels else None

    def keep(place: tuple[slice, slice], values: Float32, skin: Float32) -> None:
        bare = skin
        if covered is not None:
            rows, columns = (np.arange(s.start, s.stop) for s in place)
            bare = skin * (1 - np.clip(covered(rows, columns)[0], 0, 1))
        result[place] = pack_normals(bare * values[0], bare * values[1], bare * values[2] + (1 - bare))

    translate(name, job, 3, keep)
    return result


def pack_normals(x: Float32, y: Float32, z: Float32) -> npt.NDArray[np.int16]:
    """(..., 2) int16 codes of x and y of vectors of any length, normalised.

    Vectors without a direction become flat, (0, 0, 1); those steeper than ``STEEPEST_Z`` are limited to it.
    """
    z = np.maximum(z, 0)
    length = np.sqrt(x * x + y * y + z * z)
    sound = np.isfinite(length) & (length > 1e-3)
    inverse = np.where(sound, 1 / np.where(sound, length, 1), 0)
    x, y = (np.where(sound, part, 0) * inverse for part in (x, y))
    across = np.sqrt(x * x + y * y)
    most = np.float32(np.sqrt(1 - STEEPEST_Z**2))
    shorter = np.where(across > most, most / np.maximum(across, most), 1) * np.float32(NORMAL_ONE)
    return np.stack([np.rint(x * shorter), np.rint(y * shorter)], -1).astype(np.int16)
