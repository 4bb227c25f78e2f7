"""How near our head model can come to heads that it has never seen: ``python -m models.head.capacity FILE``.

Draws heads from another linear model (the layout of ``models.head.import_ict``), brings them to an inter-ocular
distance of 63 mm and fits ours to them in three dimensions: similarity and identity, point to plane, every
coefficient held within a number of standard deviations. Prints the distance from the other head's face to our fitted
surface. This is a bound on what any fit to a photo can reach; nothing of our model is built or tuned with these
heads.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt

from models.head.register import Cloud, Fitter, hidden_behind
from service.geometry.mesh import area_normals
from service.head.files import load_head

Float = npt.NDArray[np.float64]
IOD_M = 0.063


def unseen_heads(path: Path, count: int, seed: int) -> list[Cloud]:
    """Faces of ``count`` random heads: forward-facing skin within 1.45 inter-ocular distances of the face's middle."""
    with np.load(path, allow_pickle=False) as file:
        neutral, identity = file["neutral"].astype(float), file["identity"].astype(float)
        quads, landmarks = file["quads"], file["landmarks68"]
        face_count = int(file["face_vertex_count"])
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[quads[:, 3] >= 0][:, [0, 2, 3]]])
    triangles = triangles[(triangles < face_count).all(1)]
    random = np.random.default_rng(seed)
    out = []
    for _ in range(count):
        vertices = neutral + np.tensordot(random.normal(size=len(identity)), identity, 1)
        eyes = np.stack([vertices[landmarks[36:42]].mean(0), vertices[landmarks[42:48]].mean(0)])
        vertices = (vertices - eyes.mean(0)) * IOD_M / np.linalg.norm(eyes[1] - eyes[0])
        normals = area_normals(vertices, triangles).astype(np.float64)
        middle = np.array([0.0, -0.55 * IOD_M, vertices[landmarks[27:31], 2].mean() - 0.3 * IOD_M])
        keep = np.isin(np.arange(len(vertices)), triangles) & (normals[:, 2] > 0.25)
        keep &= np.linalg.norm(vertices - middle, axis=1) < 1.45 * IOD_M
        keep &= ~hidden_behind(vertices, keep)
        out.append(Cloud(vertices[keep], normals[keep]))
    return out


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    folder = os.environ.get("AVATARME_BENCH_DATA")
    parser.add_argument("file", type=Path, nargs="?", default=Path(folder) / "ict_facekit_head.npz" if folder else None)
    parser.add_argument("--head", type=Path, help="head model to measure (default: the one in the box)")
    parser.add_argument("--heads", type=int, default=20)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--components", type=int, nargs="+", default=[20, 40, 60, 80, 100])
    parser.add_argument("--bounds", type=float, nargs="+", default=[1.0, 2.0, 3.0])
    arguments = parser.parse_args()
    if arguments.file is None:
        parser.error("give FILE or set AVATARME_BENCH_DATA to the folder that holds ict_facekit_head.npz")
    model = load_head(arguments.head)
    clouds = unseen_heads(arguments.file, arguments.heads, arguments.seed)
    fitter = Fitter(model)
    write = sys.stdout.write
    write(f"{model.name}: {len(clouds)} heads, distances in mm at 63 mm inter-ocular distance\n")
    write("components  bound   median   mean    p95   rms coefficient\n")
    for count in arguments.components:
        for bound in arguments.bounds:
            results = [fitter.fit(cloud, min(count, len(model.identity)), bound) for cloud in clouds]
            d = [r.distance * 1e3 for r in results]
            median, mean = np.mean([np.median(x) for x in d]), np.mean([x.mean() for x in d])
            p95, size = (
                np.mean([np.percentile(x, 95) for x in d]),
                np.sqrt(np.mean([(r.identity**2).mean() for r in results])),
            )
            write(f"{count:10d} {bound:6.1f} {median:8.3f} {mean:6.3f} {p95:6.3f} {size:10.2f}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
