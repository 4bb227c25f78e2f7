"""One texture of several photos of a head: the best views of each texel, in the light of the first photo.

Each photo has its own light, exposure and white balance. What another photo shows is brought into the first one's by a
smooth field of gains on the head: the ratio of both where both see skin, continued by the ratio of the light that the
fits found (spherical harmonics) to what only one of them sees. So the albedo links them: it is the same in all.

Photos are blended in octaves (Burt and Adelson, "A Multiresolution Spline", 1983): coarse ones softly by weight, the
finest by the best view alone, as two views of a brow never lie exactly on each other. What disagrees with most photos,
a strand of hair, a highlight, a cast shadow, is outvoted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from service.arrays import Float32, Float64
from service.colour import LUMA, linear_to_srgb, srgb_to_linear
from service.face.fit.fit import Fit
from service.geometry.chart import Chart
from service.geometry.mesh import laplacian, smooth_fit, splat, vertex_normals
from service.head.regions import vertex_mask
from service.image_filters import blurred
from service.light.formulas import LUMINANCE, sh_basis
from service.robust import agreement, smoothstep
from service.texture.unwrap import Segmentation, Unwrapped, Zones

if TYPE_CHECKING:
    from scipy.sparse import csc_array

GAIN_SMOOTHNESS, GAIN_PRIOR = 0.5, 0.02
"""Weights of the gains' smoothness, and of the ratio of the lights, relative to a texel that both photos see well."""
MOST_GAIN = 5.0
"""Largest magnitude of a gain, natural logarithm."""
DIM, CLIPPED = (0.0, 0.45), (0.93, 0.99)
"""sRGB values up to which noise is all that a photo shows and from which on it is well exposed; and at which light is
lost."""
OCTAVES = (1.5, 4.0, 10.0)
"""Standard deviations, texels of a chart of 576, between which octaves lie."""


@dataclass(frozen=True)
class Layer:
    """What one photo shows of a head, at the inner texels (N,) of its chart.

    Attributes:
        unwrapped: its weight is 0 where something hides the head.
        parts: (N, 13) probabilities.
        weight: (N,) before anything was found to hide the head.
        found: where it shows the head's own surface.
    """

    unwrapped: Unwrapped
    parts: Float32
    weight: Float32
    found: Segmentation


@dataclass(frozen=True)
class Blend:
    """Layers of several photos in one.

    Attributes:
        layer: all together, in the first photo's light.
        shares: (K, N) float32 of each photo in it, 0 where none shows the head.
        gains: (K, N, 3) float32, natural logarithm: of the first photo's light over each one's.
    """

    layer: Layer
    shares: Float32
    gains: Float32


def blend(chart: Chart, layers: Sequence[Layer], fits: Sequence[Fit], zones: Zones) -> Blend:
    """Blend photos of one head; one photo is itself.

    Args:
        chart: of the head.
        layers: of each photo, the first of which gives light, eyes and mouth.
        fits: of each photo.
        zones: of the texels.
    """
    first, count = layers[0], len(zones.skin)
    if len(layers) == 1:
        return Blend(first, np.ones((1, count), np.float32), np.zeros((1, count, 3), np.float32))
    logs = [_log(layer.unwrapped.colour) for layer in layers]
    weights = np.stack([_merit(layer, fit) for layer, fit in zip(layers, fits, strict=True)])
    weights[1:] *= zones.skin
    features = chart.inside(vertex_mask(chart.head, "lips", "eyelid_left", "eyelid_right")[:, None])[:, 0]
    # Factor on the first photo's weight at lids and lips: what moves has the shape that it has there.
    weights[0] *= 1 + (4.0 - 1) * features
    gains = _gains(chart, layers, fits, logs, weights, zones)
    lit = np.stack([one + gain for one, gain in zip(logs, gains, strict=True)])
    # Difference from what most photos show, natural logarithm of luminance, at which a photo's say is quartered.
    weights *= agreement(np.asarray(lit @ LUMA, np.float32), weights, weights > 0.02, 0.3)
    total = weights.sum(0)
    shares = np.asarray(weights / np.maximum(total, 1e-9), np.float32)
    colour = linear_to_srgb(np.exp(_in_octaves(chart, lit, weights)))

    def mean(values: Sequence[Float32]) -> Float32:
        return np.asarray(np.einsum("kn,kn...->n...", shares, np.stack(values)), np.float32)

    unwrapped = replace(
        first.unwrapped,
        colour=np.where(total[:, None] > 0, np.clip(colour, 0, 1), first.unwrapped.colour).astype(np.float32),
        weight=np.max([one.unwrapped.weight for one in layers], 0),
        visible=np.any([one.unwrapped.visible for one in layers], 0),
    )
    face = np.asarray(first.found.face & (shares[0] > 0.5))
    bare = face if face.any() else first.found.face
    tone = np.median(unwrapped.colour[bare], 0).astype(np.float32) if bare.any() else first.found.colour
    seen = np.max([one.found.seen for one in layers], 0)
    parts = np.where(total[:, None] > 0, mean([one.parts for one in layers]), first.parts)
    found = Segmentation(seen, mean([one.found.lit for one in layers]), tone, bare)
    whole = Layer(unwrapped, parts.astype(np.float32), np.max([one.weight for one in layers], 0), found)
    return Blend(whole, shares, gains)


def _log(colour: Float32) -> Float32:
    """(N, 3) natural logarithm of linear RGB of sRGB colours."""
    # Linear value at which logarithms stop.
    return np.log(np.maximum(srgb_to_linear(colour), np.float32(2e-3)))


def _merit(layer: Layer, fit: Fit) -> Float32:
    """(N,) how well a photo shows each texel: squarely, at a fine scale, unhidden."""
    # Distance of the eyes in pixels that a texture of 576 x 384 can hold; larger faces are no better on it.
    scale = min(fit.inter_ocular_px / 110.0, 1.0) ** 2
    doubt = 0.5 if "low-confidence" in fit.warnings else 1.0
    red, green, blue = layer.unwrapped.colour.T
    brightest = np.maximum(np.maximum(red, green), blue)
    exposed = smoothstep(brightest, *DIM) * (1 - 0.7 * smoothstep(brightest, *CLIPPED))
    return np.asarray(layer.found.seen * layer.unwrapped.weight * exposed * (scale * doubt), np.float32)


def _gains(
    chart: Chart, layers: Sequence[Layer], fits: Sequence[Fit], logs: Sequence[Float32], weights: Float32, zones: Zones
) -> Float32:
    """(K, N, 3) of each photo; one after the other is brought to those before it, nearest directions first."""
    head = chart.head
    edges = laplacian(head.skin_triangles, len(head.mean))
    shades = [_log_shade(fit, head.triangles) for fit in fits]
    ahead = np.stack([fit.camera.rotation[2] for fit in fits])
    gains = np.zeros((len(layers), len(zones.skin), 3), np.float32)
    done, rest = [0], list(range(1, len(layers)))
    while rest:
        one = max(rest, key=lambda k: (float((ahead[done] @ ahead[k]).max()), -k))
        total = weights[done].sum(0)
        known = np.einsum("kn,knc->nc", weights[done], np.stack([logs[k] + gains[k] for k in done]))
        # Opacity from which on a texel tells the gains, and from which on fully.
        both = smoothstep(np.minimum(total, weights[one]), 0.05, 0.3) * layers[one].found.lit * zones.skin
        apart = known / np.maximum(total, np.float32(1e-6))[:, None] - logs[one]
        field = _field(chart, edges, apart, both, shades[0] - shades[one])
        gains[one] = chart.inside(np.clip(field, -MOST_GAIN, MOST_GAIN).astype(np.float32))
        done.append(one)
        rest.remove(one)
    return gains


def _field(chart: Chart, edges: csc_array, apart: Float32, trust: Float32, light: Float64) -> Float64:
    """(V, 3) smooth gains from differences (N, 3) at trusted texels, continued by those of the light (V, 3)."""
    count = len(chart.head.mean)
    values, known = splat(chart.corners, chart.weights, apart, trust, count)
    weight = known[:, None]
    total = float(known.sum())
    # Share of that ratio of lights that is believed: of the sides of a head, a frontal photo tells little.
    light = 0.5 * light
    exposure = (weight * (values - light)).sum(0) / total if total > 1 else np.zeros(3)
    return smooth_fit(edges, values, known, GAIN_SMOOTHNESS, light + exposure, GAIN_PRIOR)


def _log_shade(fit: Fit, triangles: np.ndarray) -> Float64:
    """(V, 1) natural logarithm of the light's luminance on each vertex by the fit; 0 where it found none."""
    if fit.light is None:
        return np.zeros((len(fit.vertices), 1))
    normals = vertex_normals(fit.vertices, triangles).astype(np.float64) @ fit.camera.rotation.T
    # Least light over its mean that the fits are believed, as they know of no light from behind.
    return np.asarray(np.log(np.maximum(sh_basis(normals) @ fit.light @ LUMINANCE, 0.4)))[:, None]


def _in_octaves(chart: Chart, lit: Float32, weights: Float32) -> Float32:
    """(N, 3) values (K, N, 3) blended octave by octave by weights (K, N)."""
    sigmas = [max(sigma * chart.width / 576, 0.5) for sigma in OCTAVES]
    # Power of the weights by which the finest octave is blended: of the best view alone, nearly.
    keen = np.power(weights, np.float32(4.0))
    shown = weights > 0
    result: Float32 = np.zeros(lit.shape[1:], np.float32)
    above = lit
    below: Float32
    for index, sigma in enumerate((*sigmas, None)):
        # The finer an octave, the narrower the seam between two photos.
        sharp = keen if index == 0 else np.sqrt(keen) if index == 1 else weights
        soft = np.maximum(_soft(chart, sharp[..., None], sigmas[max(index - 1, 0)])[..., 0], 0) * shown  # rounding
        share = soft / np.maximum(soft.sum(0), np.float32(1e-12))
        if sigma is None:
            below = np.zeros_like(lit)
        else:
            cover = np.maximum(_soft(chart, shown[..., None].astype(np.float32), sigma), np.float32(1e-4))
            below = np.asarray(_soft(chart, np.where(shown[..., None], lit, 0), sigma) / cover, np.float32)
        result += np.einsum("kn,knc->nc", share, above - below).astype(np.float32)
        above = below
    return result


def _soft(chart: Chart, values: Float32, sigma: float) -> Float32:
    """(K, N, C) values blurred on the chart."""
    return np.stack([
        blurred(chart.spread(one), sigma).reshape(chart.height * chart.width, -1)[chart.texels] for one in values
    ])  # fmt: skip
