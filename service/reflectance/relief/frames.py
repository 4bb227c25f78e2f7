"""Normals of a map, from tangent space to head space."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.reflectance.result import NORMAL_ONE, unpack_normals
from service.reflectance.subject import Subject
from service.reflectance.texels import interpolated

_BAND = 256
"""Rows of the full map at a time."""


def to_object(codes: npt.NDArray[np.int16], subject: Subject) -> npt.NDArray[np.int16]:
    """(H, W, 3) int16 codes of unit normals in head space, from (H, W, 2) codes of x and y in tangent space.

    The tangent frame is that of the mesh (``Chart.frame``), interpolated from the subject's coarse chart.
    """
    height, width = codes.shape[:2]
    frame = subject.chart.frame(subject.vertices)
    axes = [subject.chart.fill_outside(axis) for axis in (frame.tangent, frame.bitangent, frame.normal)]
    result = np.zeros((height, width, 3), np.int16)
    columns = np.arange(width)
    for first in range(0, height, _BAND):
        rows = np.arange(first, min(first + _BAND, height))
        local = unpack_normals(codes[rows[0] : rows[-1] + 1])
        turned = np.zeros_like(local)
        for along, axis in enumerate(axes):
            for component in range(3):
                plane = interpolated(axis[..., component], (width, height), rows, columns)
                turned[..., component] += local[..., along] * plane
        # Interpolated axes are shorter than 1; where opposite ones cancel, the normal is set to forward, +Z.
        length = np.sqrt(np.einsum("yxi,yxi->yx", turned, turned))[..., None]
        forward = np.array([0, 0, 1], np.float32)
        unit = np.where(length > 1e-3, turned / np.maximum(length, 1e-3), forward)
        result[rows[0] : rows[-1] + 1] = np.rint(unit * NORMAL_ONE)
    return result
