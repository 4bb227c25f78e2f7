"""What hides skin and is finer than the cells of the reader, or beside what it made out: strands of hair, rims.

The reader's parts are probabilities of cells of two millimetres, and what is thinner has little of them. So where it
makes out hair, each texel near that is asked whether its colour is that of the hair beside it or that of the skin; what
is found counts as hair for the next round: a lock is followed to its tip. Single strands are finer than a texel, and
their colour is between both: dark lines on the face that begin in hair and hang are strands, and others wrinkles.
Where glasses are worn, and the reader suspects them, lines no wider than a rim are rims.

Darkness hides skin, too: what is nearly black in some colour, under a brim or where a cast clips it; and brows in it.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from service.arrays import Bool, Float32
from service.colour import LUMA, srgb_to_linear
from service.face.reading.part_labels import BEARD, BROW, GLASSES, HAIR, IRIS, LIP, MOUTH, SCLERA, SKIN
from service.geometry.chart import Chart
from service.image_filters import blurred
from service.robust import smoothstep
from service.texture.unwrap import Unwrapped, Zones, near_eyes, wears_glasses

DARKEST = 2e-3
"""Linear value at which logarithms stop."""
OWN_FEATURES = (0.1, 0.3)
"""Probability of brows, beard, lips, eyes and mouth up to which lines count, and from which on they are features."""
SURE_HAIR, SURE_SKIN, NO_HAIR = 0.4, 0.9, 0.03
"""Least probability of what tells the colour of hair and of skin, and the most of hair on such skin. Beside a hat the
reader divides hair between both."""
NEAR = 0.03
"""How far hair is followed in a round, over the chart's width: 13 mm."""
AROUND = 0.035
"""Standard deviation of what counts as beside a texel: 15 mm. Light varies over a head."""
FOLLOWED = 8
"""Most rounds."""
LIKELIER = 1.5
"""Log odds of hair from which on a texel is hair."""
LEAST_SPREAD = 0.04
"""Least standard deviation of colours, natural logarithm."""
FEWEST, OUTLYING, GROWS = 50, 5.0, 5
"""Fewest texels that tell a colour, how many median deviations from it outliers begin, and the fewest texels of half
the size that are worth another round."""
FINE = 4
"""Texels beside what was found at half the size in which there may be finer strands."""
LEAST_NEAR = 0.003
"""Least share of hair, and of skin, beside a texel that is asked."""
RIM = 0.0035
"""Half the width of the widest rim, over the chart's width: 1.5 mm."""
CONTRAST = (0.05, 0.15)
"""Contrast of a line, natural logarithm of luminance, from which on it is a rim, and from which on surely."""
WISP, WRINKLES = 0.22, 0.95
"""Least contrast of a strand before the skin, natural logarithm of luminance, and the quantile of the contrasts of
lines away from hair that it has to exceed, too: wrinkled and freckled skin has its own."""
SQUARE = np.ones((3, 3), np.uint8)
"""A texel and its neighbours."""
SUSPECTED = (0.04, 0.12)
"""Probability of glasses from which on lines are rims, and from which on surely."""


def finer_cover(chart: Chart, unwrapped: Unwrapped, parts: Float32, zones: Zones) -> tuple[Float32, Float32]:
    """(N,) float32 in [0, 1], 1 where a strand hides skin, and (N,) where a rim of glasses does.

    Args:
        chart: of the head.
        unwrapped: the photo on its inner texels.
        parts: (N, 13) as ``service.texture.unwrap.parts_at`` gives them.
        zones: of the same texels.
    """
    seen = unwrapped.weight > 0
    colour = np.log(np.maximum(srgb_to_linear(unwrapped.colour), np.float32(DARKEST)))
    features = 1 - smoothstep(parts[:, [BROW, BEARD, LIP, IRIS, SCLERA, MOUTH]].sum(1), *OWN_FEATURES)
    free = chart.spread((features * zones.skin * seen)[:, None].astype(np.float32))[..., 0]
    strands, rims = _followed(chart, colour, unwrapped.weight, parts, zones), np.zeros_like(free)
    bright, reach = _continued(chart, colour @ LUMA, seen), max(round(RIM * chart.width), 1)
    face, hair = np.moveaxis(chart.spread(np.stack([zones.face, parts[:, HAIR] * seen], 1)), 2, 0)
    strands = np.maximum(strands, _wisps(bright, free * face, (strands > 0.5) | (hair > SURE_HAIR), reach))
    if wears_glasses(parts, unwrapped.weight, zones):
        suspected = smoothstep(chart.spread(parts[:, [GLASSES]])[..., 0], *SUSPECTED)
        rims = suspected * _lines(bright, reach) * (1 - near_eyes(chart, parts))
    both = np.stack([strands, rims]) * free
    return tuple(np.ascontiguousarray(both.reshape(2, -1)[:, chart.texels]))


def _followed(chart: Chart, colour: Float32, weight: Float32, parts: Float32, zones: Zones) -> Float32:
    """(h, w) 1 on hair that goes on beyond what was read, 0 elsewhere and where no hair or no skin is seen."""
    opponents = np.stack([colour @ LUMA, colour[:, 0] - colour[:, 1], colour[:, 2] - colour[:, 1]], 1)
    seen = (weight > 0).astype(np.float32)
    shown = chart.spread(np.concatenate([opponents * seen[:, None], seen[:, None]], 1).astype(np.float32))
    soft = blurred(shown, 1.0)
    values = np.asarray(soft[..., :3] / np.maximum(soft[..., 3:], 1e-3), np.float32)

    def mask(chosen: Bool) -> Float32:
        return np.asarray(chart.spread(chosen[:, None].astype(np.float32))[..., 0], np.float32)

    hair = mask((parts[:, HAIR] > SURE_HAIR) & (weight > 0))
    skin = mask((parts[:, SKIN] > SURE_SKIN) & (parts[:, HAIR] < NO_HAIR) & (weight > 0) & zones.skin)
    # The reader takes a lock far from the rest for skin: its colours would be among those of the skin beside it.
    odds = of_all(values, hair) - of_all(values, skin)
    skin *= odds < LIKELIER
    full = [values, hair, skin, odds, np.asarray(shown[..., 3], np.float32)]
    # Followed from texel to texel of half the size, then seen in full from there.
    half = [np.ascontiguousarray(plane[::2, ::2]) for plane in full]
    found = np.zeros_like(half[1])
    for k in range(FOLLOWED):
        more = _beside(half, found, chart.width / 2, LIKELIER * max(k - 1, 1))
        if (more > found).sum() < GROWS:
            break
        found = np.maximum(found, more)
    known = np.asarray(cv2.resize(found, hair.shape[::-1], interpolation=cv2.INTER_NEAREST), np.float32)
    near = cv2.dilate(np.maximum(known, hair), np.ones((2 * FINE + 1,) * 2, np.uint8))
    return _beside(full, known, chart.width, LIKELIER) * np.asarray(near, np.float32)


def _beside(planes: Sequence[Float32], found: Float32, width: float, surer: float) -> Float32:
    """(h, w) 1 where values beside hair and what was found (h, w) are likelier hair than skin, on a chart of a width.

    ``planes`` are values (h, w, 3), and (h, w) hair, skin, the odds of all hair against all skin, which have to exceed
    ``surer``, and what is shown.
    """
    values, hair, skin, odds, shown = planes
    reach = max(round(NEAR * width), 1)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
    known = np.maximum(hair, found)
    near = np.asarray(cv2.dilate(known, disc)) > 0.5
    like_hair, of_hair = _likeness(values, known, AROUND * width)
    like_skin, of_skin = _likeness(values, skin * ~near, AROUND * width)
    own = np.where(of_skin > LEAST_NEAR, like_hair - like_skin, odds)
    likelier = near & (of_hair > LEAST_NEAR) & (shown > 0) & (own > LIKELIER) & (odds > surer)
    opened = cv2.morphologyEx(np.asarray(likelier, np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    return np.asarray(opened, np.float32)


def of_all(values: Float32, chosen: Float32) -> Float32:
    """(h, w) log likelihood of values (h, w, 3) among all the chosen ones; 0 where too few of them are alike."""
    own = values[chosen > 0.5]
    if len(own):
        middle = np.median(own, 0)
        near = np.abs(own - middle)
        own = own[(near <= OUTLYING * np.maximum(np.median(near, 0), LEAST_SPREAD)).all(1)]
    if len(own) < FEWEST:
        return np.zeros(chosen.shape, np.float32)
    cov = np.cov(own.T) + LEAST_SPREAD**2 * np.eye(3)
    # Whitened by the triangular root of its inverse, distances are plain.
    white = (values - middle) @ np.linalg.cholesky(np.linalg.inv(cov)).astype(np.float32)
    return np.asarray(-0.5 * np.square(white).sum(-1) - 0.5 * np.linalg.slogdet(cov)[1], np.float32)


def _likeness(values: Float32, chosen: Float32, sigma: float) -> tuple[Float32, Float32]:
    """(h, w) log likelihood of values (h, w, 3) among the chosen ones near by, and (h, w) the share of those."""
    both = blurred(np.dstack([values * chosen[..., None], chosen]), sigma)
    share = both[..., 3]
    square = np.square(values - both[..., :3] / np.maximum(share, 1e-4)[..., None])
    count = float(chosen.sum())
    spread = np.maximum(np.sqrt(np.einsum("hwi,hw->i", square, chosen) / max(count, 1)), LEAST_SPREAD)
    spread = np.asarray(spread if count else np.ones(3), np.float32)
    return np.asarray(square @ (-0.5 / np.square(spread)) - np.log(spread).sum(), np.float32), share


def _continued(chart: Chart, bright: Float32, seen: Bool) -> Float32:
    """(h, w) brightness (N,), in what is not seen that of what is seen beside it."""
    planes = chart.spread(np.stack([bright * seen, seen], 1).astype(np.float32))
    near = blurred(planes, 4.0)
    beside = near[..., 0] / np.maximum(near[..., 1], np.float32(1e-3))
    return np.asarray(planes[..., 0] + (1 - planes[..., 1]) * beside, np.float32)


def _lines(bright: Float32, reach: int) -> Float32:
    """(h, w) in [0, 1], 1 on lines that are darker or paler than both sides, and a texel beside them."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
    closed, opened = (cv2.morphologyEx(bright, how, disc) for how in (cv2.MORPH_CLOSE, cv2.MORPH_OPEN))
    line = smoothstep(np.maximum(closed - bright, bright - opened), *CONTRAST)
    return np.asarray(cv2.dilate(line, SQUARE), np.float32)


def _wisps(bright: Float32, free: Float32, hair: Bool, reach: int) -> Float32:
    """(h, w) 1 on dark lines that are not level and begin in hair (h, w), and a texel beside them, where it is free."""
    dark = (cv2.morphologyEx(bright, cv2.MORPH_CLOSE, np.ones((1, 2 * reach + 1), np.uint8)) - bright) * free
    hairy = hair.astype(np.uint8)
    near = cv2.dilate(hairy, np.ones((2 * round(NEAR * hair.shape[1]) + 1,) * 2, np.uint8))
    own = dark[(near == 0) & (dark != 0)]
    line = dark > (max(WISP, float(np.quantile(own, WRINKLES))) if len(own) > FEWEST else WISP)
    _, label = cv2.connectedComponents(cv2.dilate(hairy | line, SQUARE))
    found = line & np.isin(label, np.unique(label[hair]))
    return np.asarray(cv2.dilate(found.astype(np.float32), SQUARE), np.float32)


DARK_ITSELF = (BROW, BEARD, SCLERA, IRIS, MOUTH)
"""Parts that may be nearly black."""
SHADED, BESIDE = (0.3, 0.45), 0.017
"""Coded luminance of the skin beside, as a share of the face's median, up to which a brow, too, is dark for want of
light, and from which on of its own. Standard deviation of what counts as beside, over the chart's width: 7 mm."""
CLIPPED = 18 / 255
"""Coded least channel from which on skin tells its colour, and from a third of which down it does not: 8 bits leave a
dozen steps of it, and sensors their noise."""
USUAL = 0.4
"""The same as a share of the face's median, for photos that are dark as a whole."""
BLACK = (0.18, 0.32)
"""Coded greatest channel, as a share of the face's median, up to which skin is black, and from which on not: with 3 to
7 % of the usual light. Under a brim 6 % of a face had less, on 66 of 69 other photos less than 1.3 %."""


def in_the_dark(chart: Chart, unwrapped: Unwrapped, parts: Float32, zones: Zones) -> tuple[Float32, Float32]:
    """Skin that is too dark for its colour to be told: light can be taken off what the photo holds, and noise and
    clipped channels would come out as patches.

    Args:
        chart: of the head.
        unwrapped: the photo on it.
        parts: (N, 13) as ``service.texture.unwrap.parts_at`` gives them.
        zones: of the same texels.

    Returns:
        (N,) float32 in [0, 1], 1 where some colour is nearly black, and (N,) where all are, which leaves no light, and
        it is no hair.
    """
    told = unwrapped.weight > 0
    both = blurred(chart.spread(np.c_[unwrapped.colour * told[:, None], told].astype(np.float32)), 2.0)
    soft = (both[..., :3] / np.maximum(both[..., 3:], np.float32(1e-3))).reshape(-1, 3)[chart.texels]
    least, most = soft.min(1), soft.max(1)
    bare = told & zones.skin & (zones.face > 0.5) & (parts[:, SKIN] > 0.5)
    if not bare.any():
        return np.zeros_like(least), np.zeros_like(most)
    limit = min(CLIPPED, max(USUAL * float(np.median(least[bare])), 1e-3))
    dark = 1 - smoothstep(least, limit / 3, limit)
    black = 1 - smoothstep(most / max(float(np.median(most[bare])), 1e-3), *BLACK)
    bright = unwrapped.colour @ LUMA
    skin = blurred(chart.spread(np.c_[bright * bare, bare].astype(np.float32)), BESIDE * chart.width)
    beside = (skin[..., 0] / np.maximum(skin[..., 1], np.float32(1e-3))).ravel()[chart.texels]
    usual = max(float(np.median(bright[bare])), 1e-3)
    shaded = (1 - smoothstep(beside / usual, *SHADED)) * (parts[:, BROW] > OWN_FEATURES[1])
    own = parts[:, DARK_ITSELF].sum(1).clip(0, 1) * (1 - shaded)
    there = told * zones.skin * (1 - own)
    return np.asarray(dark * there, np.float32), np.asarray(black * there * (1 - parts[:, HAIR]), np.float32)
