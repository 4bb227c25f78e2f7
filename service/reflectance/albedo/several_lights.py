"""The light in a texture of several photos: each photo tells its own, and the albedo is what they agree on.

Skin in one light cannot be told from paler skin in less light. Photos in other lights can: what a network takes off
each of them leaves the same albedo, but for its errors, which differ with the light. So each photo is de-lit by itself,
and the logarithms of what is left are averaged, weighted by how sure each is; a highlight or a cast shadow that one
photo has and the others have not is outvoted. How pale the whole skin is, each photo says on its own, and all together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from service.arrays import Float32
from service.colour import LUMA
from service.image_filters import blurred, shrunk
from service.reflectance.albedo.albedo_prior import DARKEST
from service.reflectance.albedo.corrections import ChartLight
from service.reflectance.planes import Planes
from service.robust import agreement, smoothstep
from service.runtime.network_registry import EYES, LIT, TEXTURE
from service.texture.texture import PhotoTexture

ASTRAY = 0.25
"""Difference of log luminance from the middle of all photos at which a photo's say is quartered."""
ROUNDS = 4
"""Rounds in which photos are brought to one brightness."""
KNOWN = (0.02, 0.3)
"""Lit skin of all photos together from which on the albedo counts, and from which on alone."""
SOFT = 1.5
"""Standard deviation, texels of the context, below which light has no detail."""


def photo_planes(planes: Planes, photo: PhotoTexture) -> Planes:
    """Planes of a whole chart with one photo's texture, lit skin and white in place of the blended texture's."""
    own = Planes(planes.size, dict(planes.channels))
    coded = np.moveaxis(photo.texture, 2, 0) * np.float32(2 / 255) - np.float32(1)
    own.add_coarse(TEXTURE, np.asarray(coded, np.float32))
    lit = photo.lit_skin * np.float32(1 / 255)
    own.add_coarse([LIT], lit[None])
    if EYES[0] in planes.channels:
        white = planes.shrunk(EYES, (photo.lit_skin.shape[1], photo.lit_skin.shape[0]))
        if photo.white is not None:
            white[:3], white[3] = np.log(photo.white)[:, None, None], 1
        else:  # as bright as another photo's beside the same skin
            level = (photo.gain * lit[..., None]).sum((0, 1)) / max(float(lit.sum()), 1e-6)
            white[:3] -= white[3] * level.astype(np.float32)[:, None, None]
        own.add_coarse(EYES, white)
    return own


def agreed_light(
    blended: ChartLight, photos: Sequence[PhotoTexture], delit: Callable[[PhotoTexture], tuple[ChartLight, Float32]]
) -> ChartLight:
    """The light in a blended texture under which its albedo is what the photos agree on.

    Args:
        blended: of the blended texture, its light as a network found it, where no photo tells.
        photos: what each shows.
        delit: of one photo its light on lit skin, corrected, and (h, w) how far its albedo may be off.
    """
    size = (blended.lit.shape[1], blended.lit.shape[0])
    albedos, weights, levels = [], [], []
    for photo in photos:
        own, error = delit(photo)
        seen = shrunk(photo.seen, size) * np.float32(1 / 255)
        albedos.append(np.log(np.maximum(own.texture, np.float32(DARKEST))) - own.light)
        weights.append(own.weight * seen / np.maximum(error, np.float32(0.02)) ** 2)
        levels.append(own.weight * seen)
    albedo, weight = np.stack(albedos), np.stack(weights)
    level = np.stack(levels).sum((1, 2))
    if not float(level.sum()) > 1:
        return blended
    offset: Float32 = np.zeros((len(photos), 3), np.float32)
    for _ in range(ROUNDS):
        trust = weight * _agreed(albedo + offset[..., None, None], weight)
        for one in range(len(photos)):
            rest = trust.copy()
            rest[one] = 0
            total = rest.sum(0)
            mean = (rest[:, None] * (albedo + offset[..., None, None])).sum(0) / np.maximum(total, np.float32(1e-6))
            shared = trust[one] * total / np.maximum(trust[one] + total, np.float32(1e-6))
            if float(shared.sum()) > 0:
                offset[one] = (shared * (mean - albedo[one])).sum((1, 2)) / shared.sum()
    offset -= (level[:, None] * offset).sum(0) / level.sum()
    said = albedo + offset[..., None, None]
    trust = weight * _agreed(said, weight)
    mean = (trust[:, None] * said).sum(0) / np.maximum(trust.sum(0), np.float32(1e-6))
    light = np.log(np.maximum(blended.texture, np.float32(DARKEST))) - mean
    told = np.asarray(smoothstep(np.stack(levels).sum(0), *KNOWN) * (blended.lit > 0), np.float32)
    near = np.maximum(blurred(told, SOFT), np.float32(1e-3))
    smooth = np.stack([blurred(plane * told, SOFT) / near for plane in light])
    return replace(blended, light=np.asarray(blended.light + told * (smooth - blended.light), np.float32))


def _agreed(said: Float32, weight: Float32) -> Float32:
    """(K, h, w) in (0, 1] how near each photo's albedo (K, 3, h, w), in logarithms, is to the middle of all."""
    return agreement(np.tensordot(said, LUMA, ((1,), (0,))), weight, weight > 0, ASTRAY)
