"""How near an albedo is to the truth of a rendered photo: on the skin that it shows, and on the face's skin beyond.

On seen skin a pixel's true albedo is compared with that of the texel which the fitted head shows there. On unseen skin
the fitted head is laid over the true one by the similarity that matches what both show to the camera, and each of its
texels compared with the nearest points of the true head.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.corrections.photos import Photo
from benchmarks.light_spread import psnr
from benchmarks.metrics import FACE_RADIUS, View, at_chart, face_region, similarity
from service.archive.avatar import Avatar
from service.colour import linear_to_srgb
from service.geometry.chart import Chart
from service.map_registry import SEEN
from service.reflectance.reflectance_maps import unpack_normals

Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

CHART_SIZE = (384, 256)
"""Chart on which unseen skin is compared."""
NEAREST_M = 0.008
"""A texel has a true albedo where the true head is not further."""
LEAST_TEXELS = 100
"""Fewest texels of unseen skin that are worth a number."""
MATCHES = 4000
"""Pixels by which the two heads are matched."""


@dataclass(frozen=True)
class Score:
    """Of one albedo.

    Attributes:
        best, raw: PSNR in dB of sRGB-coded seen skin, after the best gain of linear values and without it.
        delta_e: mean CIEDE2000 of seen skin, without gain.
        unseen: as ``best`` on the face's skin that the photo does not show; NaN where there is little of it.
    """

    best: float
    raw: float
    delta_e: float
    unseen: float

    def over(self, other: Score) -> Score:
        """By how much this is better than another: dB more, Delta E less."""
        less = other.delta_e - self.delta_e
        return Score(self.best - other.best, self.raw - other.raw, less, self.unseen - other.unseen)


@dataclass(frozen=True)
class Judge:
    """Scores albedos of one photo and one fit.

    Attributes:
        uv: (N, 2) chart coordinates of the pixels of seen skin, origin bottom left.
        truth: (N, 3) sRGB-coded albedo there.
        unseen_uv: (M, 2) the same of texels of unseen skin; M may be 0.
        unseen_truth: (M, 3).
        normal: (N, 3) true unit normals, in the frame of the fitted head.
    """

    uv: Float
    truth: Float
    unseen_uv: Float
    unseen_truth: Float
    normal: Float

    @classmethod
    def of(cls, photo: Photo, avatar: Avatar) -> Judge:
        """Match the fitted head with the true one.

        Raises:
            ValueError: the two share no pixel of skin.
        """
        truth, fit = photo.truth, avatar.fit
        height, width = truth.skin.shape
        view = View.of(fit, avatar.head, (height, width), width / avatar.photo.size[0])
        position, normal = truth.position.astype(np.float64), truth.normal.astype(np.float64)
        face = truth.skin & view.skin & face_region(position, normal, photo.head.eyes, photo.shot.yaw)
        if not face.any():
            raise ValueError(f"{photo.name}: the fitted head and the true one share no pixel of skin")
        step = max(1, int(face.sum()) // MATCHES)
        placed = similarity(view.points[face][::step], position[face][::step])
        uv, colours = _unseen(photo, avatar, placed)
        return cls(view.uv[face], _coded(truth.albedo[face]), uv, _coded(colours), normal[face] @ placed[1].T)

    def score(self, albedo: npt.NDArray[np.floating]) -> Score:
        """Of a map (h, w, 3) on the chart, sRGB-coded in [0, 1]."""
        return self._of(at_chart(albedo, self.uv), at_chart(albedo, self.unseen_uv))

    def relief(self, avatar: Avatar) -> float:
        """PSNR in dB of the specular normals of seen skin, components brought to [0, 1]; the truth has no pores.

        Raises:
            ValueError: the avatar has no specular normals.
        """
        if avatar.reflectance is None or avatar.reflectance.specular_normal is None:
            raise ValueError("relief is scored by specular normals, which were not made")
        bumps = unpack_normals(avatar.reflectance.specular_normal)
        frame = Chart.build(avatar.head, bumps.shape[1], bumps.shape[0]).frame(avatar.fit.vertices)
        axes = (frame.tangent, frame.bitangent, frame.normal)
        found = at_chart(
            sum((bumps[..., k, None] * axis for k, axis in enumerate(axes)), np.zeros_like(bumps)), self.uv
        )
        found /= np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-9)
        return -10 * float(np.log10(max(float(np.square((found - self.normal) / 2).mean()), 1e-10)))

    def flat(self) -> Score:
        """Of the one colour that is the mean of the true ones: what any effort has to beat."""
        colour = self.truth.mean(0)
        return self._of(np.broadcast_to(colour, self.truth.shape), np.broadcast_to(colour, self.unseen_truth.shape))

    def _of(self, found: Float, unseen: Float) -> Score:
        raw, best = psnr(found, self.truth)
        beyond = psnr(unseen, self.unseen_truth)[1] if len(unseen) >= LEAST_TEXELS else float("nan")
        return Score(best, raw, delta_e(found, self.truth), beyond)


def delta_e(found: Float, truth: Float) -> float:
    """Mean CIEDE2000 (Sharma 2005) of sRGB-coded colours (N, 3) in [0, 1]."""
    from skimage.color import deltaE_ciede2000, rgb2lab

    return float(np.mean(deltaE_ciede2000(rgb2lab(found[None]), rgb2lab(truth[None]))))


def _coded(linear: npt.NDArray[np.floating]) -> Float:
    return linear_to_srgb(np.clip(linear, 0, 1).astype(np.float32)).astype(np.float64)


def _unseen(photo: Photo, avatar: Avatar, placed: tuple[float, Float, Float]) -> tuple[Float, Float]:
    """Chart coordinates (M, 2) and true linear albedo (M, 3) of the face's skin that the photo does not show.

    ``placed`` is the similarity from the fitted head to the true one.
    """
    import cv2

    scale, rotation, offset = placed
    chart = Chart.build(avatar.head, *CHART_SIZE)
    confidence = cv2.resize(avatar.texture.confidence, CHART_SIZE, interpolation=cv2.INTER_NEAREST).ravel()
    chosen = (chart.inner_part == avatar.head.part_names.index("skin")) & (confidence[chart.texels] < SEEN)
    points = scale * chart.inside(avatar.fit.vertices)[chosen].astype(np.float64) @ rotation + offset
    texels = chart.texels[chosen]
    eyes, head = photo.head.eyes, photo.head
    apart = float(np.linalg.norm(eyes[0] - eyes[1]))
    colours, distance = head.colours_at(points)
    near = np.linalg.norm(points - (eyes.mean(0) - [0, 0.55 * apart, 0]), axis=1) < FACE_RADIUS * apart
    near &= (distance < NEAREST_M) & (np.linalg.norm(points[:, None] - eyes, axis=2).min(1) > head.eye_radius)
    row, column = np.divmod(texels[near], CHART_SIZE[0])
    return np.stack([(column + 0.5) / CHART_SIZE[0], 1 - (row + 0.5) / CHART_SIZE[1]], 1), colours[near]
