"""16-bit PNG, rounded to 8 bits.

Pillow has no 16-bit colour mode: it drops the low byte of 16-bit colour and clips 16-bit grey at 255. Unpacking the
same image twice, once as big-endian and once as little-endian samples, yields both bytes of each sample, from
which ``round(sample / 257)`` follows exactly: with sample = 256 high + low,

    sample / 257 = high + (low - high) / 257,

so the result is high, one more where low - high >= 129, one less where high - low >= 129.
"""

from __future__ import annotations

from io import BytesIO

from PIL import Image, ImageChops, ImageFile, PngImagePlugin

_CARRY = [int(difference >= 129) for difference in range(256)]


def decode_png16(image: ImageFile.ImageFile, payload: bytes) -> Image.Image:
    """Decode a PNG of 16 bits a sample to 8 bits.

    Args:
        image: the opened, not yet loaded file.
        payload: its bytes, from which it is opened a second time.

    Returns:
        An image of mode L, LA, RGB or RGBA; a colour key in the file becomes alpha, compared at 16 bits.
    """
    high, low = _bytes(image, payload)
    bands = [_round(*pair) for pair in zip(high, low, strict=True)]
    key = image.info.get("transparency")
    if key is not None:
        keys = key if isinstance(key, tuple) else (key,)
        bands.append(_opaque(high, low, keys))
    mode = {1: "L", 2: "LA", 3: "RGB", 4: "RGBA"}[len(bands)]
    return Image.merge(mode, bands)


def _bytes(image: ImageFile.ImageFile, payload: bytes) -> tuple[list[Image.Image], list[Image.Image]]:
    """High and low bytes of each channel, as images of mode L."""
    layout = str(image.tile[0].args)
    if layout == "I;16B":
        # Loaded samples lie in memory as low byte, high byte.
        low, high = Image.frombuffer("LA", image.size, image.tobytes(), "raw", "LA", 0, 1).split()
        return [high], [low]
    if layout == "LA;16B":
        # Four bytes a pixel, so the four channels of RGBA take them one by one.
        image.tile = [tile._replace(args="RGBA") for tile in image.tile]
        grey_high, grey_low, alpha_high, alpha_low = image.split()
        return [grey_high, alpha_high], [grey_low, alpha_low]
    again = PngImagePlugin.PngImageFile(BytesIO(payload))
    again.tile = [tile._replace(args=layout.replace("16B", "16L")) for tile in again.tile]
    return list(image.split()), list(again.split())


def _round(high: Image.Image, low: Image.Image) -> Image.Image:
    up = ImageChops.subtract(low, high).point(_CARRY)
    down = ImageChops.subtract(high, low).point(_CARRY)
    return ImageChops.subtract(ImageChops.add(high, up), down)


def _opaque(high: list[Image.Image], low: list[Image.Image], keys: tuple[int, ...]) -> Image.Image:
    """255 where any channel differs from its key, else 0."""
    opaque = Image.new("L", high[0].size, 0)
    for upper, lower, key in zip(high, low, keys, strict=True):
        for band, byte in ((upper, key >> 8), (lower, key & 255)):
            differs = band.point([0 if value == byte else 255 for value in range(256)])
            opaque = ImageChops.lighter(opaque, differs)
    return opaque
