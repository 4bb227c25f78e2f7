"""Where eyes look: ``python -m benchmarks.gaze --photos build/states [--count 48]``.

The portraits of ``benchmarks.states`` with an eye that is 3 mm open or more. The direction of the eyes in the head's
frame, of the fitted mesh less that of the true one, degrees: a bias, and the mean of the error without its sign. A bias
in pitch is what people see first: who looks into the camera then looks at its feet.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.states import OPEN_MM, SIDES, fits, make, openings_mm
from service.anatomy.eyes.eyeball import pole
from service.head.files import load_head
from service.head.model import HeadModel
from service.head.regions import part_vertices

Float = npt.NDArray[np.float64]


def directions_deg(head: HeadModel, vertices: npt.NDArray[np.floating]) -> dict[str, Float]:
    """(2,) yaw, positive to the subject's left, and pitch, upwards, of each eye by side, degrees."""
    found = {}
    for side in SIDES:
        eye = part_vertices(head, f"eye_{side}")
        x, y, z = vertices[pole(head, side)].astype(np.float64) - vertices[eye].mean(0, dtype=np.float64)
        found[side] = np.degrees([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])
    return found


def errors(folder: Path) -> Float:
    """(N, 2) yaw and pitch of the fit less the truth's, of each open eye whose iris was found."""
    head, off = load_head(), []
    for _, fit, vertices in fits(folder, head):
        if fit.gaze is None or not fit.gaze.irises:
            continue
        true, found = directions_deg(head, vertices), directions_deg(head, fit.vertices)
        opened = openings_mm(head, vertices)
        off += [found[side] - true[side] for side in SIDES if opened[side] >= OPEN_MM]
    return np.array(off, np.float64).reshape(-1, 2)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=Path, required=True, help="folder of the portraits")
    parser.add_argument("--count", type=int, default=48)
    chosen = parser.parse_args()
    make(chosen.photos, chosen.count)
    off = errors(chosen.photos)
    if not len(off):
        raise SystemExit(f"{chosen.photos}: no open eye whose iris was found")
    print(f"{len(off)} open eyes, degrees\n\n| | bias | mean error |\n|---|---|---|")
    for name, values in zip(("yaw", "pitch"), off.T, strict=True):
        print(f"| {name} | {values.mean():+.1f} | {np.abs(values).mean():.1f} |")


if __name__ == "__main__":
    main()
