"""Inpainting of the skin that the photo does not show.

A smooth base colour is solved for on the mesh. It follows the photo where skin is seen, the mirrored side where only
that is seen (after matching its light), and tends to the person's mean skin colour far from both. The photo's
detail above the base (brows, lips, wrinkles, spots) is added where it is seen, and mirrored to where only the other
side is seen; elsewhere skin is smooth, and finer detail is super-resolution's. As the base agrees with the photo at its
borders, detail can fade out there without a seam.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from service.arrays import AnyFloat, Float32, Float64
from service.geometry.chart import Chart, mirrored_map
from service.geometry.mesh import laplacian, smooth_fit, splat
from service.head.regions import vertex_mask
from service.image_filters import blurred, ramp
from service.robust import smoothstep

SMOOTHNESS = 0.25
"""Weight of the base colour's smoothness relative to a fully trusted texel; the photo's detail is added on top."""

LIGHT_SMOOTHNESS = 0.3

PRIOR_TRUST = 0.02
"""Weight of the prior, the mean colour of skin."""

LIP = (0.35, 0.55)
"""Values of the region's soft mask at which a texel begins to be lip, and from which on it is lip: the mask fades out
over skin, and slightly where the lips turn in."""

LEAST_LIP = 1e-3
"""Weight of the mean of all seen lips, relative to lips nearby of weight 1."""


@dataclass(frozen=True)
class Completed:
    """Skin colours at the inner texels (N,), including those of other parts.

    Attributes:
        colour: (N, 3) float32 sRGB.
        seen: (N,) float32 share of the photo in it, in [0, 1].
        from_mirror: (N,) float32 share of the mirrored side; ``seen + from_mirror <= 1``, the rest is inpainted.
    """

    colour: Float32
    seen: Float32
    from_mirror: Float32


def opacity(weight: AnyFloat) -> Float32:
    """(N,) opacity of the photo in [0, 1], from its weight (N,)."""
    # Weight at which the photo begins to show, and from which on it shows alone.
    return smoothstep(np.asarray(weight, np.float32), 0.03, 0.25)


def complete_skin(
    chart: Chart,
    colour: Float32,
    seen: Float32,
    skin: Float32,
    plain: Float32 | float = 1.0,
    worn: Float32 | float = 0.0,
) -> Completed:
    """Colour of all skin: base, detail and mirrored detail.

    Args:
        chart: of the head.
        colour: (N, 3) sRGB of the photo, read where ``seen`` > 0.
        seen: (N,) opacity of the photo, also the weight with which colours are continued and mirrored from a texel.
        skin: (3,) sRGB of the person's skin, the prior far from everything seen.
        plain: (N,) in [0, 1], share of a texel that is skin and no brow: what is hidden beside brows is not dark.
        worn: (N,) in [0, 1], share of a texel that a hat hides. It has the prior's colour: beside it lies its shadow.
    """
    on_skin = (chart.inner_part == chart.head.part_names.index("skin")).astype(np.float32)
    shown = seen * on_skin
    base = chart.inside(_base(chart, colour, shown * plain, worn * on_skin * (1 - shown), skin))
    detail = np.where(shown[:, None] > 0, colour - base, 0.0).astype(np.float32)
    seen = _feather(chart, shown)

    other = _flip(chart, np.c_[detail, shown])
    reflected = _feather(chart, other[:, 3]) * (1 - seen)
    inpainted = (1 - seen - reflected)[:, None]
    result = base + seen[:, None] * detail + reflected[:, None] * other[:, :3]
    result += inpainted * _lip_difference(chart, colour, base, seen)
    return Completed(np.clip(result, 0, 1).astype(np.float32), seen, reflected)


def _base(chart: Chart, values: Float32, trust: Float32, usual: Float32, skin: Float32) -> Float64:
    """(V, 3) smooth sRGB on the whole mesh, from values (N, 3) at the texels, with their trust (N,) and that of the
    prior there (N,).
    """
    head = chart.head
    count = len(head.mean)
    hair = vertex_mask(head, "scalp").astype(np.float64)
    edges = laplacian(head.skin_triangles, count, hair)

    known, k = splat(chart.corners, chart.weights, values, trust, count)
    reflected, k_reflected = known[head.mirror], k[head.mirror]
    both = np.minimum(k, k_reflected)
    # Weights of smoothness and of the prior 0 for the colour difference between the head's halves: where only one half
    # is known it fades within some twenty vertices.
    light = smooth_fit(edges, known - reflected, both, LIGHT_SMOOTHNESS, np.zeros(3), 0.0005)
    # Weight of the mirrored colour relative to a seen one of the same trust.
    share = 0.4 * np.maximum(1 - k, 0) * k_reflected
    total = k + share
    blend = np.where(total > 0, share / np.where(total > 0, total, 1), 0)[:, None]
    known = known + blend * (reflected + light - known)

    far = np.tile(skin.astype(np.float64), (count, 1))
    _, prior = splat(chart.corners, chart.weights, values[:, :0], usual, count)
    both = total + prior
    known = (total[:, None] * known + prior[:, None] * far) / np.where(both > 0, both, 1)[:, None]
    return np.clip(smooth_fit(edges, known, both, SMOOTHNESS, far, PRIOR_TRUST), 0, 1)


def _lip_difference(chart: Chart, colour: Float32, base: Float32, seen: Float32) -> Float32:
    """(N, 3) colour of unseen lips minus the base colour, which is skin there; 0 elsewhere.

    Args:
        chart: of the head; all is 0 without a region "lips".
        colour: (N, 3) sRGB of the photo, read where ``seen`` (N,) > 0.
        base: (N, 3) sRGB.
        seen: (N,) opacity of the photo.
    """
    lips = chart.inside(vertex_mask(chart.head, "lips")[:, None])[:, 0]
    lips = ramp(lips, LIP)
    weight = (lips * seen)[:, None]
    if not float(weight.sum()) > 0:
        return np.zeros_like(base)
    shown = np.where(weight > 0, colour, 0) * weight
    spread = chart.spread(np.concatenate([shown, weight], 1).astype(np.float32))
    # Standard deviation of the Gaussian that carries the seen lips' colour to unseen ones, as a share of the chart's
    # width.
    near = blurred(spread, chart.width * (10 / 576)).reshape(-1, 4)[chart.texels]
    mean = shown.sum(0) / weight.sum()
    lip = (near[:, :3] + LEAST_LIP * mean) / (near[:, 3:] + LEAST_LIP)
    return np.asarray(lips[:, None] * (lip - base), np.float32)


def _flip(chart: Chart, values: Float32) -> Float32:
    """(N, C) values at the mirrored texels; border texels without a mirror image read the nearest one."""
    flipped = mirrored_map(chart.fill_outside(chart.spread(values))).reshape(-1, values.shape[1])
    return flipped[chart.texels]


def _feather(chart: Chart, share: Float32) -> Float32:
    """(N,) shares, eroded and blurred by some texels, so that the seen area fades out towards its borders."""
    image = chart.fill_outside(chart.spread(share[:, None])[..., 0])
    sigma = max(chart.width / 576 * 2.0, 0.5)
    reach = 2 * round(sigma) + 1
    soft = blurred(np.asarray(cv2.erode(image, np.ones((reach, reach), np.uint8))), sigma)
    return np.minimum(share, soft.ravel()[chart.texels])
