"""What a camera makes of the light that came through its lens: exposure, colour, tone curves, clipping, 8 bits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.colour import LUMA, linear_to_srgb

Float = npt.NDArray[np.float32]

FACE_LEVEL, FACE_SHARE = 0.55, 0.9
"""Linear luminance that automatic exposure gives to this quantile of the face: sRGB 0.77."""


@dataclass(frozen=True)
class Camera:
    """One camera's ways.

    Attributes:
        stops: exposure beside the automatic one, in powers of two.
        balance: gain of each linear channel before it clips: below 1 in blue is warm light that was left warm.
        bend: exponent of each coded channel: above 1 its shades are darker; all alike is contrast, apart is a hue that
            follows the light, as films and filters have.
        contrast: strength in [0, 1] of an S-shaped curve on all coded channels.
        ceiling: coded value at which each channel is cut off and stretched to 1 (a blown channel).
        size: pixels of the square photo; None: as rendered.
        noise: standard deviation of the sensor's noise, codes of 255.
        jpeg: quality of JPEG, 0 to 100; None: PNG.
    """

    stops: float = 0.0
    balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    bend: tuple[float, float, float] = (1.0, 1.0, 1.0)
    contrast: float = 0.0
    ceiling: tuple[float, float, float] = (1.0, 1.0, 1.0)
    size: int | None = None
    noise: float = 0.0
    jpeg: int | None = None


def automatic(radiance: Float, face: npt.NDArray[np.bool_]) -> float:
    """Gain that a camera which meters the face would take."""
    return FACE_LEVEL / float(np.quantile(radiance[face] @ LUMA, FACE_SHARE))


def develop(radiance: Float, face: npt.NDArray[np.bool_], camera: Camera, seed: int = 0) -> npt.NDArray[np.uint8]:
    """(h, w, 3) uint8 sRGB photo of linear radiance (H, W, 3) with a face somewhere."""
    import cv2

    gain = automatic(radiance, face) * 2**camera.stops * np.array(camera.balance)
    linear = radiance * gain.astype(np.float32)
    if camera.size is not None:
        small = cv2.resize(linear, (camera.size, camera.size), interpolation=cv2.INTER_AREA)
        linear = np.asarray(small, np.float32)
    coded = linear_to_srgb(np.clip(linear, 0, 1).astype(np.float32))
    coded = np.minimum(coded / np.array(camera.ceiling, np.float32), 1) ** np.array(camera.bend, np.float32)
    coded = coded + np.float32(camera.contrast) * (coded * coded * (3 - 2 * coded) - coded)
    noise = np.random.default_rng(seed).normal(0, camera.noise, coded.shape) if camera.noise else 0.0
    return np.asarray(np.clip(np.rint(coded * 255 + noise), 0, 255), np.uint8)


def encoded(pixels: npt.NDArray[np.uint8], camera: Camera) -> bytes:
    """The file that the camera writes."""
    import cv2

    ending, settings = (".png", []) if camera.jpeg is None else (".jpg", [cv2.IMWRITE_JPEG_QUALITY, camera.jpeg])
    done, data = cv2.imencode(ending, pixels[..., ::-1], settings)
    if not done:
        raise RuntimeError(f"a photo of {pixels.shape} could not be encoded as {ending}")
    return data.tobytes()
