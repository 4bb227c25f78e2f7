"""Filling in the skin that the photo does not show.

A smooth base colour is solved for on the mesh: it follows what was seen, takes the mirrored side where only that was
seen (after matching its light), and ends in the person's own skin or hair colour. What the photo has beyond the base
(brows, lips, wrinkles, spots) is added where it was seen, then mirrored; elsewhere a faint grain of the same strength.
The base meets the photo by construction, so whatever is added can fade out at any border without a seam.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.colour import luma
from service.geometry.chart import Chart, mirrored
from service.geometry.mesh_field import laplacian, smooth_fit, splat
from service.head.regions import vertex_mask
from service.texture.inpainting.grain import grain

Float = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]

OPAQUE = (0.03, 0.25)
"""Weight from which the photo begins to show, and from which on it shows alone."""

SMOOTHNESS = 0.25
"""Of the base colour, against a texel's trust of 1; the photo's detail comes back on top."""

LIGHT_SMOOTHNESS = 0.3
LIGHT_PRIOR = 0.0005
"""Colour difference of the halves: smooth, and fading within some twenty vertices where only one half is known."""

MIRROR_TRUST = 0.4
PRIOR_TRUST = 0.02
GRAIN = 0.6
"""Strength of made-up grain over that of the photo's own detail nearby."""

MOST_GRAIN = 0.02

LIP = (0.35, 0.55)
"""Of the region's soft mask, from which on a texel begins to be lip, and is: the mask fades out over skin, and a little
where the lips turn in."""
LIPS_ALIKE = 10 / 576
"""Reach of the lips' own colour into lips that no photo shows, over the chart's width."""
LEAST_LIP = 1e-3
"""Weight of the mean of all seen lips beside that of those nearby."""


@dataclass(frozen=True)
class Completed:
    """SkinModel colours at the inner texels (N,), whatever their part.

    Attributes:
        colour: (N, 3) float32 sRGB.
        seen: (N,) float32 share of the photo in it, in [0, 1]; ``from_mirror`` the mirrored side's share.
        from_mirror: (N,) float32, ``seen + from_mirror <= 1``.
    """

    colour: Float
    seen: Float
    from_mirror: Float


def opacity(weight: npt.NDArray[np.floating]) -> Float:
    """How much of a texel (N,) the photo alone decides, in [0, 1], of its weight."""
    t = np.clip((np.asarray(weight, np.float32) - OPAQUE[0]) / (OPAQUE[1] - OPAQUE[0]), 0, 1)
    return np.asarray(t * t * (3 - 2 * t), np.float32)


def complete_skin(
    chart: Chart, colour: Float, seen: Float, trust: Float, skin: Float, scalp: Float | None, seed: int = 0
) -> Completed:
    """Base, detail, mirror image and grain in one.

    Args:
        chart: of the head.
        colour: (N, 3) sRGB of the photo, read where ``seen`` > 0.
        seen: (N,) opacity of the photo.
        trust: (N,) <= ``seen``: how far colours may be continued and mirrored from here.
        skin: (3,) sRGB, the person's skin, for what is far from everything seen.
        scalp: (3,) sRGB of the hair (or bald head), or None where the photo does not show it.
        seed: of the grain.
    """
    own = (chart.inner_part == chart.head.part_names.index("skin")).astype(np.float32)
    seen, trust = seen * own, np.minimum(trust, seen) * own
    field = chart.inside(_base(chart, np.c_[colour, _fine(chart, colour, seen)], trust, skin, scalp))
    base = field[:, :3]
    detail = np.where(seen[:, None] > 0, colour - base, 0.0).astype(np.float32)
    seen = _feather(chart, seen)

    other = _flip(chart, np.c_[detail, trust])
    reflected = _feather(chart, other[:, 3]) * (1 - seen)
    inpainted = (1 - seen - reflected)[:, None]
    result = base + seen[:, None] * detail + reflected[:, None] * other[:, :3]
    result += inpainted * _redder(chart, colour, base, seen)
    result += inpainted * np.clip(field[:, 3:], 0, MOST_GRAIN) * GRAIN * grain(chart, seed)
    return Completed(np.clip(result, 0, 1).astype(np.float32), seen, reflected)


def _base(chart: Chart, values: Float, trust: Float, skin: Float, scalp: Float | None) -> Array:
    """(V, 4) smooth sRGB and strength of fine detail over the whole mesh, from values (N, 4) of the texels."""
    head = chart.head
    count = len(head.mean)
    hair = vertex_mask(head, "scalp").astype(np.float64)
    edges = laplacian(head.triangles[head.triangle_part == head.part_names.index("skin")], count, hair)

    known, k = splat(chart.corners, chart.weights, values, trust, count)
    reflected, k_reflected = known[head.mirror], k[head.mirror]
    both = np.minimum(k, k_reflected)
    light = smooth_fit(edges, known - reflected, both, LIGHT_SMOOTHNESS, np.zeros(4), LIGHT_PRIOR)
    share = MIRROR_TRUST * np.maximum(1 - k, 0) * k_reflected
    total = k + share
    blend = np.where(total > 0, share / np.where(total > 0, total, 1), 0)[:, None]
    known = known + blend * (reflected + light - known)

    typical = float((known[:, 3] * total).sum() / max(float(total.sum()), 1e-9))
    far = np.tile([*skin.tolist(), typical], (count, 1))
    if scalp is not None:
        far[:, :3] += hair[:, None] * (scalp.astype(np.float64) - far[:, :3])
    return np.clip(smooth_fit(edges, known, total, SMOOTHNESS, far, PRIOR_TRUST), 0, 1)


def _fine(chart: Chart, colour: Float, seen: Float) -> Float:
    """(N,) strength of the photo's fine detail: departure of the luma from its surroundings, at most ``MOST_GRAIN``."""
    import cv2

    both = chart.spread(np.stack([luma(colour) * seen, seen], 1))
    soft = np.asarray(cv2.GaussianBlur(both, (0, 0), max(chart.width / 480, 0.5))).reshape(-1, 2)[chart.texels]
    middle = soft[:, 0] / np.maximum(soft[:, 1], 1e-6)
    return np.asarray(np.minimum(np.abs(luma(colour) - middle), MOST_GRAIN), np.float32)


def _redder(chart: Chart, colour: Float, base: Float, seen: Float) -> Float:
    """(N, 3) by how much lips that are not seen differ from the base colour, which is skin there; 0 on all else.

    Args:
        chart: of the head; without a region "lips" all is 0.
        colour: (N, 3) sRGB of the photo, read where ``seen`` (N,) > 0.
        base: (N, 3) sRGB.
        seen: opacity of the photo.
    """
    import cv2

    lips = chart.inside(vertex_mask(chart.head, "lips")[:, None])[:, 0]
    lips = np.clip((lips - LIP[0]) / (LIP[1] - LIP[0]), 0, 1).astype(np.float32)
    weight = (lips * seen)[:, None]
    if not float(weight.sum()) > 0:
        return np.zeros_like(base)
    shown = np.where(weight > 0, colour, 0) * weight
    spread = chart.spread(np.concatenate([shown, weight], 1).astype(np.float32))
    near = np.asarray(cv2.GaussianBlur(spread, (0, 0), chart.width * LIPS_ALIKE)).reshape(-1, 4)[chart.texels]
    mean = shown.sum(0) / weight.sum()
    own = (near[:, :3] + LEAST_LIP * mean) / (near[:, 3:] + LEAST_LIP)
    return np.asarray(lips[:, None] * (own - base), np.float32)


def _flip(chart: Chart, values: Float) -> Float:
    """Values (N, C) of the texels on the other side; border texels without a partner read the nearest one."""
    flipped = mirrored(chart.fill_outside(chart.spread(values))).reshape(-1, values.shape[1])
    return flipped[chart.texels]


def _feather(chart: Chart, share: Float) -> Float:
    """(N,) shares eroded and blurred by some texels, so that borders inside the seen area fade instead of ending."""
    import cv2

    image = chart.fill_outside(chart.spread(share[:, None])[..., 0])
    sigma = max(chart.width / 576 * 2.0, 0.5)
    reach = 2 * round(sigma) + 1
    soft = cv2.GaussianBlur(np.asarray(cv2.erode(image, np.ones((reach, reach), np.uint8))), (0, 0), sigma)
    return np.asarray(np.minimum(share, np.asarray(soft, np.float32).ravel()[chart.texels]))
