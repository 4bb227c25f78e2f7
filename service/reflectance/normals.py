"""rho and sigma: normals for specular and for diffuse reflection, in tangent space (AvatarMe, section 4.3)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.arrays import Float32
from service.ledger import SEEN_CHANGE, Constant, Correction, Ledger
from service.reflectance.result import NORMAL_ONE
from service.reflectance.subject import COVERED
from service.reflectance.translate import MapInputs, translate

SPECULAR, DIFFUSE = "rho", "sigma"

UNDER_COVER = 0.25
"""Share of the relief that is kept under brows, hair and glasses: their strands and frames are dark lines like creases,
and the skin under them is not seen."""

COVERED_RELIEF = Correction(
    name="covered-relief",
    mends="Strands of hair and frames of glasses come out as creases of the skin under them.",
    source="relief",
    constants={"kept": Constant(UNDER_COVER, "share of the relief", "chosen by eye")},
    cases=("brows", "beard"),
)

STEEPEST_Z = 0.17
"""Smallest z of a unit normal, a tilt of 80 degrees: steeper slopes are not meaningful, and 8 bits do not resolve
them."""


def tangent_normals(name: str, job: MapInputs, ledger: Ledger | None = None) -> npt.NDArray[np.int16]:
    """(H, W, 2) int16 codes of x and y from network ``name``; flat off the skin, flattened where skin is covered.

    Args:
        name: ``SPECULAR`` or ``DIFFUSE``.
        job: inputs of the network.
        ledger: whether ``COVERED_RELIEF`` runs; it counts the texels whose normal that changes.

    Raises:
        ModelFault: the network is missing, changed, or does not fit.
    """
    result = np.zeros((*job.skin.shape, 2), np.int16)
    ledger = ledger or Ledger()
    runs = ledger.runs(COVERED_RELIEF) and COVERED in job.planes.channels
    covered = job.planes.read([COVERED]) if runs else None

    def keep(place: tuple[slice, slice], values: Float32, skin: Float32) -> None:
        result[place] = pack_normals(skin * values[0], skin * values[1], skin * values[2] + (1 - skin))
        if covered is not None:
            rows, columns = (np.arange(s.start, s.stop) for s in place)
            kept = skin * (1 - np.float32(1 - UNDER_COVER) * covered(rows, columns)[0])
            flatter = pack_normals(kept * values[0], kept * values[1], kept * values[2] + (1 - kept))
            change = np.abs(flatter.astype(np.int32) - result[place]).max(-1)
            ledger.count(COVERED_RELIEF, int((change > 2 * NORMAL_ONE * SEEN_CHANGE).sum()), change.size)
            result[place] = flatter

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
