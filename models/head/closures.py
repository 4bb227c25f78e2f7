"""Lips and lids that close, put into a head file of before: ``python -m models.head.closures FILE``.

The builder does it to every new head. A rebuild on another machine differs by rounding, which the chart's optimisation
enlarges to some texels, and networks are trained on one chart; so a file that exists is changed in place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from models.head.bases import Bases
from models.head.digest import BASE_NAME, change_file
from models.head.expression import PARTNERS
from models.head.freed import freed
from models.head.lids import close
from models.head.lining import clear_of_teeth
from models.head.lips import TONGUE_JAW, find_lips, seal
from models.head.mimic import mended
from models.head.settle import part_members
from models.head.tongue import over_the_teeth
from service.anatomy.items import read_insets
from service.errors import ModelFault
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.integer]

BEFORE = "avatarme-cc0-head-1"


def closing(bases: Bases, head: HeadModel) -> Bases:
    """The bases of a head of our topology with lips and lids that close; ``head`` tells its polygons and regions."""
    quads = head.polygons[head.polygon_part == 0].astype(np.int64)
    members = part_members(head.polygons.astype(np.int64), head.polygon_part)
    regions = dict(zip(head.region_names, head.regions.astype(np.float64), strict=True))
    balls = {side: members[f"eye_{side}"] for side in ("left", "right")}
    sealed = seal(bases, quads, regions, head.expression_names)
    lips = find_lips(bases.mean, quads, regions)
    inside = np.zeros(len(bases.mean), bool)
    inside[quads] = (regions["mouth_inner"] > 0.5)[quads]
    inside[lips.inner[:, :2]] = True
    insets = read_insets()
    rows = [mesh for mesh in insets.meshes if mesh.name.startswith("teeth")]
    sealed = clear_of_teeth(
        sealed, rows, insets.fitted_head.astype(np.float64), np.flatnonzero(inside), members, head.expression_names,
        TONGUE_JAW,
    )  # fmt: skip
    sealed = freed(
        sealed, insets.meshes, insets.fitted_head.astype(np.float64), np.flatnonzero(inside),
        np.asarray(head.triangles[head.triangle_part == 0], np.int64), head.expression_names,
    )  # fmt: skip
    out = close(sealed, quads, balls, regions, head.expression_names)
    partners = [head.expression_names.index(PARTNERS[name]) for name in head.expression_names]
    # Rounding alone tells left from right here, but may choose another edge of the mesh.
    flip, mirror = np.array([-1.0, 1.0, 1.0]), head.mirror
    evened = Bases(
        0.5 * (out.mean + out.mean[mirror] * flip),
        np.stack([_evened(new, old, mirror) for new, old in zip(out.identity, bases.identity, strict=True)]),
        0.5 * (out.expression + out.expression[partners][:, mirror] * flip),
    )
    return mended(over_the_teeth(evened, members, np.unique(quads), head.expression_names), head)


def _evened(component: Float, before: Float, mirror: Int) -> Float:
    """A component (V, 3) as symmetric, or as antisymmetric, as it was before."""
    flip = np.array([-1.0, 1.0, 1.0])
    image = before[mirror] * flip
    sign = 1.0 if np.abs(image - before).max() < np.abs(image + before).max() else -1.0
    return np.asarray(0.5 * (component + sign * component[mirror] * flip))


def closed(head: HeadModel) -> HeadModel:
    """A head of before with lips and lids that close; topology, chart, landmarks and regions stay.

    Raises:
        ModelFault: it is not a head of before.
    """
    if head.name != BEFORE:
        raise ModelFault(f"the head is {head.name}; {BEFORE} can be changed into {BASE_NAME}")
    return with_bases(head, closing(Bases.of(head), head))


def with_bases(head: HeadModel, bases: Bases) -> HeadModel:
    """The head with other bases, rounded as a file keeps them, and the name of the present version."""
    halves = (half.astype(np.float16).astype(np.float32) for half in (bases.identity, bases.expression))
    identity, expression = halves
    return replace(head, name=BASE_NAME, mean=bases.mean.astype(np.float32), identity=identity, expression=expression)


def main() -> None:
    """Command line."""
    change_file(__doc__, closed)


if __name__ == "__main__":
    main()
