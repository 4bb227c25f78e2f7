"""Checks the shipped face networks against the answers of the implementations that they were converted from::

    python -m export.faces.parity

The references in ``tests/data/faces`` were written by the converters: the TFLite interpreter's answers for the
MediaPipe networks, a plain numpy forward pass on the unfolded weights for the identity network. Prints one line a
network and exits 1 when one is off by more than its bound. Where the sources are at hand, running the converters
(``export.faces.mediapipe``, ``export.faces.identity``) again repeats the comparison from scratch.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from export.faces.onnx_tools import thinned, worst_difference
from export.faces.probes import point_probes, probes
from service.runtime.sessions import MODELS, load_session

REFERENCES = Path(__file__).parents[2] / "tests" / "data" / "faces"


@dataclass(frozen=True)
class Check:
    """How a network is fed, and how far it may be off (units of its outputs).

    ``size`` is the side of the image that goes in, or how many points where ``entry`` is "points"; ``every`` and
    ``mean``, whose network is rounded, as in ``export.faces``.
    """

    size: int
    low: float
    high: float
    bound: float
    entry: str = "image"
    every: int = 1
    mean: bool = False

    def probes(self) -> list[npt.NDArray[np.float32]]:
        """Inputs whose answers are kept."""
        if self.entry == "points":
            return point_probes(self.size)
        return [(p * (self.high - self.low) + self.low)[None].astype(np.float32) for p in probes(self.size)]


CHECKS = {
    "face_detector": Check(256, -1.0, 1.0, 5e-3),
    "face_mesh": Check(192, 0.0, 1.0, 2e-2),
    "face_landmarker": Check(256, 0.0, 1.0, 2e-2),
    "face_blendshapes": Check(146, 0.0, 1.0, 2e-3, "points"),
    "segmenter": Check(256, -1.0, 1.0, 0.2, every=8, mean=True),
    "face_identity": Check(150, 0.0, 255.0, 2e-4),
}
"""Regressors are pixels of a 256-pixel crop and landmarks of a 192-pixel one; descriptors have norm 1.4; classes are
logits of up to 8, whose weights are rounded to half precision: on a face they are off by 6e-4 in the mean, on blobs of
noise, which are nothing to that network, by 0.17."""


def difference(name: str, folder: Path = MODELS) -> float:
    """Largest difference of a shipped network from its references over all probes.

    Raises:
        ModelFault: the file is missing or changed.
        ParityError: outputs are missing or not finite.
    """
    check, session = CHECKS[name], load_session(name, folder=folder)
    with np.load(REFERENCES / f"{name}.npz") as references:
        expected = {key: references[key] for key in references.files}
    worst = 0.0
    for index, probe in enumerate(check.probes()):
        answer = session.run({check.entry: probe})
        found = {name: thinned(values, check.every) for name, values in zip(session.outputs, answer, strict=True)}
        wanted = {key: values[index] for key, values in expected.items()}
        worst = max(worst, worst_difference(wanted, found, mean=check.mean))
    return worst


def main() -> None:
    """Check all networks."""
    failed = False
    for name, check in CHECKS.items():
        worst = difference(name)
        failed = failed or worst > check.bound
        print(f"{name}: largest difference {worst:.2e}, bound {check.bound:.0e}")  # noqa: T201
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
