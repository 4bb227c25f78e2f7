"""What fitting and super-resolution do to a texture, done to the clean one, so that networks learn to live with it."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from models.colour import linear, srgb
from models.training.tasks import uniform

LARGEST_GAIN = 0.35

PHOTOS_DETAIL = (3.0, 10.67)
"""Range of the size, in texels of the full chart, below which detail is not the photo's: super-resolution makes it."""


def gain(texture: Tensor, generator: torch.Generator, strength: float = 0.12) -> Tensor:
    """sRGB-coded textures (N, 3, h, w) as another exposure and white balance would have given them."""
    n = len(texture)
    common = torch.randn(n, 1, 1, 1, generator=generator) * strength
    tint = torch.randn(n, 3, 1, 1, generator=generator) * 0.25 * strength
    factor = torch.exp((common + tint).clamp(-LARGEST_GAIN, LARGEST_GAIN) / 2.2)
    return (texture * factor).clamp(0.0, 1.0)


TINTED, LAMPS = 0.4, 0.25
"""Share of the charts in the light of coloured lamps that the camera did not balance, and the standard deviation of the
logarithm of their colours, less the mean. With the stage's own lights alone, fair skin in warm light counts as dark."""


def tinted(texture: Tensor, generator: torch.Generator) -> Tensor:
    """sRGB-coded textures (N, 3, h, w), some in light of another colour; a channel is cut off where it is beyond 1."""
    n = len(texture)
    colour = LAMPS * torch.randn(n, 3, 1, 1, generator=generator)
    here = torch.rand(n, 1, 1, 1, generator=generator) < TINTED
    lit = linear(texture) * torch.exp(colour - colour.mean(1, keepdim=True))
    return torch.where(here, srgb(lit.clamp(0.0, 1.0)), texture)


GRADED = 0.3
"""Share of the charts whose photo has another tone curve than sRGB's."""


def graded(texture: Tensor, generator: torch.Generator) -> Tensor:
    """sRGB-coded textures (N, 3, h, w), some of them as cameras and films bend their tones, and clip them.

    An S-shaped curve, an exponent for each channel, and a ceiling beyond which a channel is cut off.
    """
    n = len(texture)
    contrast = uniform(generator, -0.2, 0.6, n, 1, 1, 1)
    bend = torch.exp(0.1 * torch.randn(n, 3, 1, 1, generator=generator))
    ceiling = uniform(generator, 0.8, 1.0, n, 1, 1, 1) * uniform(generator, 0.94, 1.0, n, 3, 1, 1)
    coded = (texture / ceiling).clamp(0.0, 1.0) ** bend
    coded = coded + contrast * (coded * coded * (3.0 - 2.0 * coded) - coded)
    here = torch.rand(n, 1, 1, 1, generator=generator) < GRADED
    return torch.where(here, coded, texture)


def blur(image: Tensor, sigma: float) -> Tensor:
    """Gaussian blur of (N, C, h, w) with reflected borders; unchanged for a sigma under 0.05 pixels."""
    if sigma < 0.05:
        return image
    radius = max(1, math.ceil(3.0 * sigma))
    x = torch.arange(-radius, radius + 1, dtype=image.dtype)
    kernel = torch.exp(-0.5 * (x / sigma) ** 2)
    kernel = kernel / kernel.sum()
    channels = image.shape[1]
    rows = kernel.view(1, 1, -1, 1).expand(channels, 1, -1, 1)
    columns = kernel.view(1, 1, 1, -1).expand(channels, 1, 1, -1)
    padded = functional.pad(image, (radius, radius, radius, radius), mode="reflect")
    return functional.conv2d(functional.conv2d(padded, rows, groups=channels), columns, groups=channels)


def noisy(image: Tensor, generator: torch.Generator, largest: float = 2.0 / 255.0) -> Tensor:
    """Noise of a camera: up to ``largest`` standard deviation, different in each image, smooth over a pixel or so."""
    sigma = torch.rand(len(image), 1, 1, 1, generator=generator) * largest
    noise = torch.randn(image.shape, generator=generator)
    return (image + sigma * (0.5 * noise + blur(noise, 0.7))).clamp(0.0, 1.0)


def smooth_field(shape: tuple[int, ...], cells: int, generator: torch.Generator) -> Tensor:
    """(N, C, h, w) noise of about unit variance whose waves are a ``cells``-th of the image long."""
    coarse = torch.randn(shape[0], shape[1], cells + 2, cells + 2, generator=generator)
    return functional.interpolate(coarse, shape[2:], mode="bicubic", align_corners=False)


def lost_detail(image: Tensor, share: Tensor, factor: float) -> Tensor:
    """Image whose detail finer than ``factor`` pixels is reduced to a share (N, 1, 1, 1) of itself."""
    size = (max(round(image.shape[2] / factor), 2), max(round(image.shape[3] / factor), 2))
    small = functional.interpolate(image, size, mode="area")
    smooth = functional.interpolate(small, image.shape[2:], mode="bicubic", align_corners=False)
    return smooth + share * (image - smooth)


def half_mirrored(images: list[Tensor], generator: torch.Generator, signs: list[Tensor | None]) -> list[Tensor]:
    """Charts (N, C, h, w) of which one side was taken from the other, as for a head that was seen from the side.

    Args:
        images: all that belong together; each is treated alike.
        generator: where the seam lies and which side is kept.
        signs: (C,) factors of mirrored channels (-1 for x of vectors), None for plain ones.
    """
    n, _, _, width = images[0].shape
    seam = 0.5 + 0.12 * torch.randn(n, 1, 1, 1, generator=generator)
    column = ((torch.arange(width) + 0.5) / width).view(1, 1, 1, -1)
    soft = torch.sigmoid((column - seam.clamp(0.3, 0.7)) * width / 4.0)
    keep_left = torch.rand(n, 1, 1, 1, generator=generator) < 0.5
    weight = torch.where(keep_left, 1.0 - soft, soft)
    result = []
    for image, sign in zip(images, signs, strict=True):
        other = image.flip(-1)
        if sign is not None:
            other = other * sign.view(1, -1, 1, 1)
        result.append(weight * image + (1.0 - weight) * other)
    return result
