"""How heads of men differ from women's: ``python -m models.people.sexes`` measures it on MakeHuman's bodies.

Hair that is tied behind looks from the front like short hair; the face is evidence for what is meant, so synthetic
people have a sex, which shows in the shape of the head, the beard (``models.people.dress``) and how often each style is
worn (``models.people.strands``).
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]

FILE = Path(__file__).resolve().parent / "data" / "sexes.npz"
PAIRS = 40
"""Pairs of a man and a woman of the same ancestry, age, muscle and weight that are compared."""
RIDGE = 1e-3
"""Of the least squares that finds the coefficients, over the mean square of a component."""


@functools.lru_cache(maxsize=1)
def manly() -> Float:
    """(K,) float32 coefficients of identity by which the mean man's head differs from the mean woman's."""
    with np.load(FILE, allow_pickle=False) as arrays:
        return np.asarray(arrays["manly"], np.float32)


def with_sex(identity: Float, male: bool, spread: float) -> Float:
    """(K,) float32 coefficients whose part along :func:`manly` is a man's or a woman's.

    Args:
        identity: (K,) float32 coefficients.
        male: which.
        spread: standard normal: how manly this person is among their sex.
    """
    way = manly()
    length = float(np.linalg.norm(way))
    unit = way / max(length, 1e-6)
    along = (0.35 if male else -0.35) * length + 0.25 * length * spread
    return np.asarray(identity + (along - float(identity @ unit)) * unit, np.float32)


def measure() -> Float:
    """(K,) float32 :func:`manly`, measured."""
    from models.head.crop import crop_head
    from models.head.identity import align
    from models.head.macro import Person, macro_paths, macro_weights
    from models.head.sample import draw_person
    from models.head.source import UNIT_M, find_data, read_base, read_target
    from service.head.files import load_head

    data, head = find_data(None), load_head()
    base = read_base(data)
    crop = crop_head(base)
    targets = [read_target(path, crop.operator.shape[1]) for path in macro_paths(data)]
    macro = UNIT_M * np.stack([crop.operator @ target for target in targets])
    template, face = UNIT_M * (crop.operator @ base.vertices), np.asarray(head.region("face"), np.float64)
    random, apart = np.random.default_rng(0), np.zeros((len(head.mean), 3))
    for _ in range(PAIRS):
        p = draw_person(random)
        man, woman = (
            template + np.tensordot(macro_weights(Person(p.ancestry, gender, p.age, p.muscle, p.weight)), macro, 1)
            for gender in (1.0, 0.0)
        )
        apart += (align(man, woman, face) - woman) / PAIRS
    skin = np.unique(head.triangles[head.triangle_part == head.part_names.index("skin")])
    weight = np.sqrt(np.maximum(face[skin], 0.08))[:, None]
    basis = (head.identity[:, skin] * weight).reshape(len(head.identity), -1).T.astype(np.float64)
    square = basis.T @ basis
    square += RIDGE * np.trace(square) / len(square) * np.eye(len(square))
    return np.asarray(np.linalg.solve(square, basis.T @ (apart[skin] * weight).ravel()), np.float32)


if __name__ == "__main__":
    np.savez(FILE, manly=measure())
