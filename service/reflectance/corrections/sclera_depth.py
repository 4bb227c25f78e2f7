"""How much of the light reaches the sclera, by the direction that it comes from.

The sclera tells the light, but lies between lids and under brows: a lamp before the face reaches it better than a sky
above it. In scanned heads it lies less deep than in those of the light stage, which the network learnt on, and shows
more of the same light. The direction is known from the shading of the face (``service.light.skin_light``). What reaches
sclera and lids from each direction depends on the head; the constants are those of the mean head, in second-order
harmonics.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.colour import LUMA
from service.ledger import Constant, Correction
from service.light.skin_light import BAND_GAIN, sh_basis
from service.light.sphere import spread_directions

SCLERA = np.array([0.0664, -0.0080, 0.0928, 0.0, 0.0, -0.0122, 0.0787, 0.0, 0.0134])
LIDS = np.array([0.1944, -0.0498, 0.1998, 0.0, 0.0, -0.0381, 0.0786, 0.0, 0.0135])
"""Mean irradiance over pi of the visible sclera and of the lids of the mean head, shadows included, for each harmonic
of the radiance in head space: ``models.lightstage.light.sclera``, with which a test compares them."""

USUAL = -0.91
"""Log ratio of the light on the sclera and on the lids, by these tables, in the usual light of photos."""
SLOPE = 1.25
"""Change of the sclera's log light over the change of that ratio: one, and more for the shadows of hard lamps, which
harmonics blur."""
SHALLOW = 0.3
"""Log light by which the sclera of scanned heads counts as brighter than that of the stage's in the same light. Beside
the lids a head of ICT-FaceKit has 0.06 to 0.27, a subject of the stage -1.05 to -0.72 (``benchmarks.eye_whites``, with
and without ``--stage``). A third of it: the network allows for the depth that the fitted head has."""
LEAST, MOST = 0.12, 0.6
"""Share of the lids' light that reaches the sclera in any case, from the skin around; and the largest correction, in
logarithms."""

_DIRECTIONS = 64


def beside_lids(light: npt.NDArray[np.floating], rotation: npt.NDArray[np.floating]) -> float:
    """Log ratio of the luminance on the sclera and on the lids; ``USUAL`` where the lids get none.

    Args:
        light: (9, 3) coefficients of ``service.light.skin_light``, camera frame.
        rotation: (3, 3) from head space to the camera.
    """
    directions = spread_directions(_DIRECTIONS)
    turned = sh_basis(directions @ np.asarray(rotation, np.float64).T) / BAND_GAIN
    grey = np.asarray(light, np.float64) @ LUMA
    in_head = np.linalg.lstsq(sh_basis(directions) / BAND_GAIN, turned @ grey, rcond=None)[0]
    sclera, lids = float(SCLERA @ in_head), float(LIDS @ in_head)
    if not np.isfinite([sclera, lids]).all() or lids <= 1e-6:
        return USUAL
    return float(np.log(max(sclera / lids, LEAST)))


def in_usual_light(
    eye_light: npt.NDArray[np.floating] | None,
    light: npt.NDArray[np.floating] | None,
    rotation: npt.NDArray[np.floating],
) -> npt.NDArray[np.float64] | None:
    """(3,) radiance that the stage's sclera would show if as much light came from where it usually comes.

    Args:
        eye_light: (3,) linear RGB that they show (``service.light.white_reference``); None: not known.
        light: (9, 3) of the fit; None: not known, and counts as usual.
        rotation: (3, 3) from head space to the camera.
    """
    if eye_light is None:
        return None
    apart = 0.0 if light is None else SLOPE * (beside_lids(light, rotation) - USUAL)
    return np.asarray(np.asarray(eye_light, np.float64) * np.exp(-SHALLOW - np.clip(apart, -MOST, MOST)))


SCLERA_DEPTH = Correction(
    name="sclera-depth",
    mends="The direction of the light and the depth of the eyes are taken for the strength of the light.",
    source="light",
    constants={
        "usual": Constant(USUAL, "log radiance on the sclera over that on the lids", "models.lightstage.light.sclera"),
        "slope": Constant(SLOPE, "log over log", "benchmarks.eye_whites"),
        "shallow": Constant(SHALLOW, "log radiance", "benchmarks.eye_whites, with and without --stage"),
        "most": Constant(MOST, "log radiance", "largest correction"),
    },
    cases=("soft", "hard"),
)
