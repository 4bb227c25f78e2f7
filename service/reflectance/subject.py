"""What the stages know of one head: geometry on the chart, what each texel shows, how light answers to normals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from service.anatomy.canvas import brow_plane, lash_line, lid_skin
from service.arrays import AnyFloat, Bool, Float32, Float64
from service.face.fit.fit import Fit
from service.geometry.chart import NO_PART, Chart, islands
from service.head.model import HeadModel
from service.head.regions import vertex_mask
from service.image_filters import blurred, by_strips, ramp, shrunk, stretched_to
from service.light.formulas import BAND_GAIN, LUMINANCE, gradient, sh_basis
from service.reflectance.planes import read_window
from service.reflectance.reflectance_maps import NORMAL_ONE, unpack_normals
from service.reflectance.relief.folds import Creases
from service.runtime.network_registry import EYES
from service.texture.texture import PhotoTexture, Texture, depth_map, shape_normals

DARKEST = 0.2
"""Least irradiance, over the mean of the seen skin, by which is divided: darker skin lies in cast shadows, whose light
the harmonics do not know."""


def sensitivity(chart: Chart, vertices: AnyFloat, light: AnyFloat, rotation: AnyFloat) -> Float32:
    """(h, w, 2) float32, d log E / d (x, y) of the tangent-space normal, continued beyond the islands.

    Args:
        chart: of the head.
        vertices: (V, 3) metres.
        light: (9, 3) harmonics of radiance in the camera's frame (``service.face.fit.fit.Fit.light``).
        rotation: (3, 3) from the head's frame to the camera's.
    """
    frame, turn = chart.frame(vertices), np.asarray(rotation, np.float64).T

    def seen(axis: Float32) -> Float64:
        return np.asarray(axis.reshape(-1, 3)[chart.texels] @ turn, np.float64)

    grey = np.asarray(light, np.float64) @ LUMINANCE
    normal = seen(frame.normal)
    shade = np.maximum(sh_basis(normal) @ grey, DARKEST)
    slope = gradient(normal, grey * BAND_GAIN) / shade[:, None]
    both = np.stack([(slope * seen(axis)).sum(1) for axis in (frame.tangent, frame.bitangent)], 1)
    return chart.fill_outside(chart.spread(both.astype(np.float32)))


BEYOND = (8.0, 18.0)
"""Texels of a texture of 576 from what a photo shows at which unseen skin begins, and from which on it is nothing else:
a centimetre. Lids and lips, in holes that are narrower, count as seen."""


def beyond(seen: Bool) -> Float32:
    """(h, w) float32 in [0, 1], how far texels count as unseen, of (h, w) what photos show."""
    near, far = (seen.shape[1] / 576 * texels for texels in BEYOND)
    closed = cv2.morphologyEx(seen.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((2 * int(far) + 1,) * 2, np.uint8))
    return ramp(np.asarray(cv2.distanceTransform(1 - closed, cv2.DIST_L2, 5), np.float32), (near, far))


GEOMETRY_SIZE = (768, 512)
"""Chart on which geometry is drawn once; larger maps interpolate it, as the meshes have no finer detail."""

UNIT_MM = 128.0
"""Positions and depth go into networks in this unit, which keeps them within about [-1, 1]."""

BROW_SOFT = 5.0
"""Standard deviation of the blur by which relief fades out towards brows, texels of ``GEOMETRY_SIZE``."""

LASHES_SOFT = 2.0
"""The same for lashes."""


def margin(width: int) -> int:
    """Padding of the islands of parts, in texels of a map of this width: one texel of ``GEOMETRY_SIZE``."""
    return max(width // GEOMETRY_SIZE[0], 1)


@lru_cache(maxsize=1)
def coarse_chart(head: HeadModel) -> Chart:
    """The chart of a head at ``GEOMETRY_SIZE``; of one head it is kept."""
    return Chart.build(head, *GEOMETRY_SIZE)


def drawn_geometry(chart: Chart, vertices: AnyFloat) -> Float32:
    """(11, h, w) float32 of a chart's size, named by ``GEOMETRY``, continued beyond the islands.

    Depth is z of the head in units of 128 mm; normals are unit vectors in object space and in the tangent space of the
    head's overall form; position is where the texel lies on the mean head, the same for everybody, a code of the
    region; mask is 1 inside the islands.
    """
    scale = 1000.0 / UNIT_MM
    exact, tangent = shape_normals(chart, vertices)
    position = chart.fill_outside(chart.interpolate(chart.head.mean)) * np.float32(scale)
    depth = depth_map(chart, vertices) * np.float32(scale)
    fields = (depth[..., None], exact, tangent, position, chart.mask[..., None].astype(np.float32))
    return np.concatenate([np.moveaxis(one, 2, 0) for one in fields])


@dataclass(frozen=True)
class Subject:
    """One fitted head.

    Attributes:
        head: the model.
        vertices: (V, 3) metres with the photo's expression.
        chart: of ``head`` at ``GEOMETRY_SIZE``.
        geometry: (11, h, w) float32 at ``GEOMETRY_SIZE``, as :func:`drawn_geometry` makes it.
        lit: (h, w) float32, 1 where the texture is skin in the photo's light, 0 on hair, glasses and inpainted texels;
            None: all of it is skin in the light.
        inpainted: (h, w) float32, 1 on inpainted skin; None: nowhere.
        eye_light: (3,) linear RGB radiance of a white surface in place of the sclera; None: not measured.
        parts: (h, w, 3) uint8 sRGB-coded diffuse albedo of all that is no skin; None: the texture divided by the mean
            light of the face is taken instead.
        slope: (h, w, 2) float32 at ``GEOMETRY_SIZE``: how the photo's light answers to normals
            (``service.reflectance.subject``); None: the light is not known.
        creases: where the photo's expression folds the skin; None: nowhere.
        photos: what each of several photos shows; empty for one.
        wrinkles: factor on the depth of the face's lines.
        cloth: linear luminance of the brightest cloth in the photo; 0: none is seen.
        unseen: (h, w) float32 in [0, 1], how far the light is taken off as at half the size; None: nowhere.
    """

    head: HeadModel
    vertices: npt.NDArray[np.floating]
    chart: Chart
    geometry: Float32
    lit: Float32 | None = None
    eye_light: npt.NDArray[np.floating] | None = None
    parts: npt.NDArray[np.uint8] | None = None
    inpainted: Float32 | None = None
    slope: Float32 | None = None
    creases: Creases | None = None
    photos: tuple[PhotoTexture, ...] = ()
    wrinkles: float = 1.0
    cloth: float = 0.0
    unseen: Float32 | None = None

    @classmethod
    def of(
        cls,
        head: HeadModel,
        vertices: npt.NDArray[np.floating],
        lit_skin: npt.NDArray[np.uint8] | None = None,
        eye_light: npt.NDArray[np.floating] | None = None,
    ) -> Subject:
        """Draw the chart of a head; ``lit_skin`` is the texture's, of any size."""
        lit = None if lit_skin is None else lit_skin * np.float32(1 / 255)
        chart = coarse_chart(head)
        return cls(head, vertices, chart, drawn_geometry(chart, vertices), lit, eye_light)

    @classmethod
    def fitted(cls, head: HeadModel, fit: Fit) -> Subject:
        """The head of a photo, with all that its fit tells: the light's way with normals, and folds."""
        subject = cls.of(head, fit.vertices, eye_light=fit.eye_light)
        slope = None
        if fit.light is not None:
            slope = sensitivity(subject.chart, fit.vertices, fit.light, fit.camera.rotation)
        return replace(subject, slope=slope, creases=Creases.of(subject.chart, fit))

    def wearing(self, texture: Texture, *, halved: bool = False) -> Subject:
        """The same head with what the texture tells of its light, which is ``halved`` where no photo shows it."""
        inpainted = np.asarray(texture.confidence == 0, np.float32)
        height, width = inpainted.shape
        inpainted *= self.bare((width, height))
        shown = (texture.confidence > 0) & (shrunk(self.own_skin, (width, height)) > 0.5)
        return replace(
            self,
            lit=texture.lit_skin * np.float32(1 / 255),
            inpainted=inpainted,
            parts=texture.parts,
            photos=texture.photos,
            cloth=texture.cloth,
            unseen=beyond(shown) if halved else None,
        )

    @property
    def eyes(self) -> Float32:
        """(4, 1, 1) float32 channels ``EYES``, the same at all texels; all 0 where the light is not known."""
        known = self.eye_light is not None and bool((np.asarray(self.eye_light) > 0).all())
        logs = np.log(np.asarray(self.eye_light, np.float64)) if known else np.zeros(3)
        return np.append(logs, float(known))[:, None, None].astype(np.float32)

    @property
    def lids(self) -> Float32:
        """(h, w) float32 >= 0 at ``GEOMETRY_SIZE``: weight of the skin round the eyes; 0 if the head names none."""
        return lid_skin(self.chart)

    @property
    def clues(self) -> Float32:
        """(9, h, w) float32 channels ``CLUES`` at ``GEOMETRY_SIZE``."""

        def whole(plane: Float32 | None, usual: float) -> Float32:
            drawn = np.full((1, 1), usual, np.float32) if plane is None else plane
            return stretched_to(np.asarray(drawn, np.float32), GEOMETRY_SIZE)[None]

        eyes = np.broadcast_to(self.eyes, (len(EYES), *GEOMETRY_SIZE[::-1]))
        shown, inpainted = whole(self.lit, 1.0), whole(self.inpainted, 0.0)
        brows = brow_plane(self.chart)[None]
        lit = shown * self.own_skin
        lit = lit if lit.any() else self.own_skin[None]  # of a photo without lit skin all of it has to count
        # Softly: relief that ends at a line would show as a patch.
        beneath = blurred(brows[0], BROW_SOFT)
        # Fair hair is taken for lit skin by its colour; on the scalp hair is the rule.
        bare = (1 - (1 - shown) * (1 - inpainted)) * self.bare(GEOMETRY_SIZE)
        # Lashes are no groove.
        lashes = cv2.dilate(self.chart.spread(lash_line(self.chart)[:, None])[..., 0], np.ones((5, 5), np.uint8))
        lashes = np.clip(2 * blurred(lashes, LASHES_SOFT), 0, 1)
        covered = np.maximum(np.maximum(beneath, lashes), 1 - bare)
        grows = self.chart.interpolate(vertex_mask(self.head, "beard"))[..., 0]
        beard = (1 - inpainted) * np.clip(grows, 0, 1) * self.own_skin
        return np.concatenate([lit, inpainted, eyes, beard, covered, self.lids[None]])

    @property
    def own_skin(self) -> Float32:
        """(h, w) float32 at ``GEOMETRY_SIZE``: 1 on the part "skin", 0 on eyes, teeth and outside the islands."""
        return np.asarray(self.chart.part == self.head.part_names.index("skin"), np.float32)

    def bare(self, size: tuple[int, int]) -> Float32:
        """(H, W) float32 in [0, 1]: skin where no hair is to be expected."""
        hair = self.chart.interpolate(vertex_mask(self.head, "scalp"))[..., 0]
        smooth = self.chart.fill_outside(np.asarray(self.own_skin * (1 - np.clip(hair, 0, 1)), np.float32))
        return shrunk(smooth, size)

    def skin(self, size: tuple[int, int]) -> npt.NDArray[np.uint8]:
        """(H, W) uint8: 255 where a texel is skin, which is what the networks learnt; 0 on eyes, teeth, tongue, lashes.

        Also falls to 0 inside the mouth and the eye sockets. Texels outside the islands count as skin, as they
        continue it.
        """
        hidden = self.chart.fill_outside(
            self.chart.interpolate(vertex_mask(self.head, "mouth_inner", "eye_socket"))[..., 0]
        )
        coarse = np.rint(255 * (1 - np.clip(hidden, 0, 1))).astype(np.uint8)
        result = np.asarray(cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR), np.uint8)
        part = self.islands(size)
        others = ((part != self.head.part_names.index("skin")) & (part != NO_PART)).astype(np.uint8)
        grown = cv2.dilate(others, np.ones((3, 3), np.uint8), iterations=margin(size[0]))
        result[np.asarray(grown) > 0] = 0
        return result

    def islands(self, size: tuple[int, int]) -> npt.NDArray[np.uint8]:
        """(H, W) uint8 part of each texel, ``NO_PART`` outside; a texel that an outline crosses is inside."""
        return islands(self.head, size)


def to_object(codes: npt.NDArray[np.int16], subject: Subject) -> npt.NDArray[np.int16]:
    """(H, W, 3) int16 codes of unit normals in head space, from (H, W, 2) codes of x and y in tangent space.

    The tangent frame is that of the mesh (``Chart.frame``), interpolated from the subject's coarse chart.
    """
    height, width = codes.shape[:2]
    frame = subject.chart.frame(subject.vertices)
    axes = [subject.chart.fill_outside(axis) for axis in (frame.tangent, frame.bitangent, frame.normal)]
    result = np.zeros((height, width, 3), np.int16)

    def turn(strip: slice) -> None:
        local = unpack_normals(codes[strip])
        turned = np.zeros_like(local)
        for along, axis in enumerate(axes):
            here = read_window(np.moveaxis(axis, 2, 0), (width, height), strip)
            turned += local[..., along : along + 1] * here
        # Interpolated axes are shorter than 1; where opposite ones cancel, the normal is set to forward, +Z.
        length = np.sqrt(np.einsum("yxi,yxi->yx", turned, turned))[..., None]
        forward = np.array([0, 0, 1], np.float32)
        unit = np.where(length > 1e-3, turned / np.maximum(length, 1e-3), forward)
        result[strip] = np.rint(unit * NORMAL_ONE)

    by_strips(height, turn)
    return result
