"""The tongue comes out over the lower teeth at every activation of ``tongueOut``, not at its end alone.

A blendshape moves vertices along straight lines. From a tip that rests deep behind the lower gums they lead through
them; from one that rests behind the upper incisors, where it does in life, they pass over them, if the jaw opens enough
on the way. The tongue that is out stays where it is.

The builder does it to every new head; ``python -m models.head.tongue FILE`` to a head file of before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from models.head.bases import Bases
from models.head.digest import change_file
from models.head.lips import TONGUE_JAW
from models.head.settle import part_members
from service.errors import ModelFault
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.integer]

TIP_M = (-0.02, 0.005)
"""Depth (z, metres) from which the resting tongue rises, and from which on it does wholly."""
UP_M = 0.010
"""How far its tip rises at rest."""
LOWERED = 0.8
"""Share of that which ``jawOpen`` takes back: in an open mouth the tongue lies behind the lower teeth, its top seen."""
WIDER = 0.2
"""Further share of ``jawOpen`` in ``tongueOut``, beside ``TONGUE_JAW``, that skin and lower teeth take; the tongue does
not go down with them."""


def over_the_teeth(bases: Bases, members: Mapping[str, Int], skin: Int, expression_names: tuple[str, ...]) -> Bases:
    """The bases with a tongue that passes over the teeth.

    Args:
        bases: with teeth and tongue in their places and lips that close.
        members: vertices of each part by name.
        skin: vertices of the skin.
        expression_names: of the units, E of them, with "jawOpen" and "tongueOut".

    Raises:
        ModelFault: it does already.
    """
    mean, expression = bases.mean.copy(), bases.expression.copy()
    jaw, out = (expression[expression_names.index(name)] for name in ("jawOpen", "tongueOut"))
    lower, tongue = members["teeth_lower"], members["tongue"]
    share = float((out[lower] * jaw[lower]).sum() / max(float((jaw[lower] ** 2).sum()), 1e-12))
    if share > TONGUE_JAW + 0.5 * WIDER:
        raise ModelFault(f"tongueOut opens the jaw by {share:.2f} of jawOpen: its tongue passes the teeth already")
    up = np.zeros((len(tongue), 3))
    up[:, 1] = UP_M * np.clip((mean[tongue, 2] - TIP_M[0]) / (TIP_M[1] - TIP_M[0]), 0.0, 1.0)
    mean[tongue] += up
    out[tongue] -= up
    jaw[tongue] -= LOWERED * up
    for own in (skin, lower):
        out[own] += WIDER * jaw[own]
    return Bases(mean, bases.identity, expression)


def changed(head: HeadModel) -> HeadModel:
    """A head of our own topology with such a tongue; identity, chart, landmarks and regions stay to the bit."""
    members = part_members(head.polygons.astype(np.int64), head.polygon_part)
    skin = np.unique(head.triangles[head.triangle_part == 0])
    new = over_the_teeth(Bases.of(head), members, skin, head.expression_names)
    expression = new.expression.astype(np.float16).astype(np.float32)
    return replace(head, mean=new.mean.astype(np.float32), expression=expression)


def main() -> None:
    """Command line."""
    change_file(__doc__, changed)


if __name__ == "__main__":
    main()
