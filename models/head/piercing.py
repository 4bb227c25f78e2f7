"""Count triangles of the head's parts that cross: ``python -m models.head.piercing [--head FILE] [--heads N]``.

For every single unit at 1 and for random mixtures, on the mean head and on random identities: the lips with each other,
lids and sockets with the eyeballs, lips, cheeks and lining with teeth and tongue, and these with each other. Teeth,
gums and tongue are the meshes that avatars get. What is rooted in the skin, lashes and caruncle, is left out.
``mouthClose`` takes back the opening of ``jawOpen`` and means nothing without it: alone it is shown with ``jawOpen`` at
1, and in a mixture it is at most ``jawOpen``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt

from models.head.crossing import crossing_pairs
from service.anatomy.items import read_insets
from service.anatomy.mouth import too_near
from service.head.files import load_head
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

MIXTURES, MIXED_UNITS = 20, 8
"""Random mixtures, and how many units of each are active."""


def groups(head: HeadModel) -> dict[str, Int]:
    """Triangles (T, 3) of the surfaces that may cross, by name."""
    own = {name: head.triangles[head.triangle_part == k].astype(np.int64) for k, name in enumerate(head.part_names)}
    skin = own.pop("skin")
    own = {name: own[name] for name in own if name.startswith("eye")}
    count = len(head.mean)
    for mesh in read_insets().meshes:
        corners = (
            mesh.faces if mesh.faces.shape[1] == 3 else np.concatenate([mesh.faces[:, :3], mesh.faces[:, [0, 2, 3]]])
        )
        own[mesh.name], count = corners.astype(np.int64) + count, count + len(mesh.rest)
    lips = (head.region("lips") > 0.25)[skin].any(1) & (head.region("mouth_inner") < 0.5)[skin].any(1)
    drop = -head.expression[head.expression_names.index("jawOpen")][:, 1]
    lower = (drop > 0.25 * drop.max())[skin].all(1)
    upper = (drop < 0.25 * drop.max())[skin].all(1)
    return {"skin": skin, "lip_upper": skin[lips & upper], "lip_lower": skin[lips & lower], **own}


def with_insets(vertices: Float, neutral: Float | None = None) -> Float:
    """(V + N, 3) vertices of the head, then those of teeth, gums and tongue; neutral: the head (V, 3) at rest."""
    insets = read_insets()
    rest = insets.fitted_head if neutral is None else neutral
    rows = [mesh for mesh in insets.meshes if mesh.name.startswith("teeth")]
    sunk = np.array([0, -too_near(rows, rest - insets.fitted_head), 0])
    placed = (m.rest + m.moved(vertices - insets.fitted_head) + sunk * (m is rows[1]) for m in insets.meshes)
    return np.concatenate([vertices, *placed])


def pairs_of(names: list[str]) -> list[tuple[str, str]]:
    """Pairs of surfaces that must not cross."""
    parts = [name for name in names if name not in ("skin", "lip_upper", "lip_lower")]
    mouth = [name for name in parts if not name.startswith("eye")]
    inside = [(a, b) for i, a in enumerate(mouth) for b in mouth[i + 1 :]]
    return [("lip_upper", "lip_lower"), *(("skin", name) for name in parts), *inside]


def poses(head: HeadModel, seed: int) -> dict[str, Float]:
    """Activations (E,) by name: neutral, every unit, the random mixtures."""
    names = head.expression_names
    random = np.random.default_rng(seed)
    jaw, close = names.index("jawOpen"), names.index("mouthClose")
    out = {"neutral": np.zeros(len(names))}
    for k, name in enumerate(names):
        out[name] = np.zeros(len(names))
        out[name][k] = 1.0
    out["mouthClose"][jaw] = 1.0
    for n in range(MIXTURES):
        mix = np.zeros(len(names))
        mix[random.choice(len(names), MIXED_UNITS, replace=False)] = random.uniform(0, 1, MIXED_UNITS)
        mix[close] = min(mix[close], mix[jaw])
        out[f"mixture {n + 1}"] = mix
    return out


def count(vertices: Float, surfaces: dict[str, Int], neutral: Float | None = None) -> dict[str, int]:
    """Crossing triangles by "a x b" on a head (V, 3), those without any left out; neutral: the same head at rest."""
    found, points = {}, with_insets(vertices, neutral)
    for a, b in pairs_of(list(surfaces)):
        crossing = crossing_pairs(points, surfaces[a], surfaces[b])
        if len(crossing):
            found[f"{a} x {b}"] = len(np.unique(crossing[:, 0])) + len(np.unique(crossing[:, 1]))
    return found


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--head", type=Path, help="head model (default: the one in the box)")
    parser.add_argument("--heads", type=int, default=4, help="random identities beside the mean one")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    head = load_head(options.head)
    surfaces, random = groups(head), np.random.default_rng(options.seed)
    identities = [np.zeros(0), *(random.normal(size=len(head.identity)) for _ in range(options.heads))]
    print_ = sys.stdout.write
    total = 0
    for name, activation in poses(head, options.seed).items():
        for number, identity in enumerate(identities):
            shaped, rest = (head.shape(identity, how).astype(np.float64) for how in (activation, 0 * activation))
            found = count(shaped, surfaces, rest)
            total += sum(found.values())
            if found:
                which = "mean head" if number == 0 else f"identity {number}"
                print_(f"{name:22s} {which:12s} {', '.join(f'{k}: {v}' for k, v in found.items())}\n")
    print_(f"{total} crossing triangles on {len(identities)} heads in {len(poses(head, options.seed))} poses\n")


if __name__ == "__main__":
    main()
