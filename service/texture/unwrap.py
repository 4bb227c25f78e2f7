"""What a photo shows of the head's chart: the colour of each texel, how far to trust it, and where that is bare skin.

What hides the head makes texels unseen, whatever their colour. The reader's parts are probabilities of cells of about
two millimetres: soft edges stay soft on the chart.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from service.arrays import Bool, Float32, Float64, Int64
from service.colour import LUMA, bytes_to_linear, linear_to_srgb, srgb_to_linear
from service.face.fit.fit import Fit
from service.face.reading.part_labels import (
    BACKGROUND,
    BEARD,
    BROW,
    CLOTH,
    GLASSES,
    HAIR,
    HAT,
    IRIS,
    LIP,
    MOUTH,
    OTHER,
    PARTS,
    SCLERA,
    SKIN,
)
from service.face.reading.reader import Reading, parts_at_pixels
from service.geometry.camera import NEAREST_M, Camera
from service.geometry.chart import Chart, chart_points, dot, solve_affine, unit_vectors
from service.geometry.mesh import vertex_normals
from service.geometry.raster import rasterise
from service.geometry.sampling import Pyramid, sample_area
from service.head.regions import vertex_mask
from service.image_filters import blurred
from service.photo.photo import Photo
from service.robust import smoothstep
from service.texture.inpainting import opacity
from service.words import WarningCode

GRAZING = (0.12, 0.35)
"""Cosine of the viewing angle below which the weight is 0, and from which on it is the cosine's square."""


@dataclass(frozen=True)
class Unwrapped:
    """What the photo shows of each inner texel of the chart, in the order of ``chart.texels``.

    Attributes:
        colour: (N, 3) float32 sRGB in [0, 1]; 0 where ``weight`` is 0.
        weight: (N,) float32 in [0, 1]: squared cosine of the viewing angle, less near outlines and occlusion edges.
        visible: (N,) bool: in the photo, facing the camera and not occluded by the head.
        position: (N, 3) float32 metres, head space.
    """

    colour: Float32
    weight: Float32
    visible: Bool
    position: Float32


def unwrap(photo: Photo, fit: Fit, chart: Chart) -> Unwrapped:
    """Project every texel into the photo, test it against the z-buffer of the whole head and read its colour."""
    camera, head = fit.camera, chart.head
    both = chart.inside(np.c_[fit.vertices, vertex_normals(fit.vertices, head.triangles)])
    position, normal = both[:, :3], unit_vectors(both[:, 3:])
    facing = dot(normal, unit_vectors(camera.centre.astype(np.float32) - position))[:, 0]
    front = np.flatnonzero(facing > 0)  # the back half needs no further look
    depth = camera.to_camera(position[front])[:, 2]
    pixel = camera.project(position[front])
    within = np.all((pixel > 0.5) & (pixel < np.array(photo.size) - 0.5), 1) & (depth > NEAREST_M)

    buffer = _Buffer.draw(camera, fit, chart)
    nearest, margin = buffer.look_up(pixel, depth, facing[front])
    visible = np.zeros(len(position), bool)
    visible[front] = within & nearest
    ramp = np.clip((facing[front] - GRAZING[0]) / (GRAZING[1] - GRAZING[0]), 0.0, 1.0)
    weight = np.zeros(len(position), np.float32)
    weight[front] = np.where(visible[front], ramp * facing[front] ** 2 * margin, 0.0)

    colour = np.zeros((len(position), 3), np.float32)
    shown = np.flatnonzero(weight[front] > 0)
    colour[front[shown]] = _read(photo, fit, chart, pixel[shown], front[shown])
    return Unwrapped(colour, weight, visible, position)


def _read(photo: Photo, fit: Fit, chart: Chart, pixel: Float64, chosen: Int64) -> Float32:
    """Colours (n, 3) sRGB at photo pixels (n, 2), averaged in linear light over each texel's area in the photo."""
    if not len(chosen):
        return np.zeros((0, 3), np.float32)
    head = chart.head
    low = np.maximum(np.floor(pixel.min(0)).astype(int) - 8, 0)
    high = np.ceil(pixel.max(0)).astype(int) + 8
    crop = bytes_to_linear(photo.pixels[low[1] : high[1], low[0] : high[0]])
    texel = chart_points(head, chart.width, chart.height)[head.triangle_uv]
    du, dv = solve_affine(texel, fit.camera.project(fit.vertices)[head.triangles])
    jacobian = np.stack([du, dv], -1)[chart.triangle.ravel()[chart.texels[chosen]]]
    return linear_to_srgb(sample_area(Pyramid.build(crop), pixel - low, jacobian))


@dataclass(frozen=True)
class _Buffer:
    """Z-buffer of the head within the bounding box of its projection.

    Attributes:
        origin: (2,) photo pixels of the buffer's corner.
        scale: cells per photo pixel.
        metres: size of a cell at a depth of one metre.
        depth: (h, w) float32 metres, inf where there is no head.
        margin: (h, w) float32 in [0, 1], 0 at outlines and occlusion edges, 1 far from them.
    """

    origin: Float64
    scale: float
    metres: float
    depth: Float32
    margin: Float32

    @classmethod
    def draw(cls, camera: Camera, fit: Fit, chart: Chart) -> _Buffer:
        """Rasterise the fitted head; empty where it lies behind the camera."""
        points = camera.project(fit.vertices)
        z = camera.to_camera(fit.vertices)[:, 2]
        before = z >= NEAREST_M
        if not before.any():
            return cls(np.zeros(2), 1.0, 1.0, np.full((1, 1), np.inf, np.float32), np.zeros((1, 1), np.float32))
        # Vertices close to the camera plane project arbitrarily far out: draw only what may fall into the photo.
        size = np.array([camera.width, camera.height], float)
        low = np.maximum(points[before].min(0), -size) - 2
        high = np.minimum(points[before].max(0), 2 * size) + 2
        extent = np.maximum(high - low, 1.0)
        # Longer side of the head in the z-buffer, in cells of about 0.6 mm, whatever the photo's resolution.
        scale = 512 / float(extent.max())
        width, height = (int(n) for n in np.ceil(extent * scale))
        raster = rasterise((points - low) * scale, z, chart.head.triangles, width, height, perspective=True)
        metres = 1.0 / (camera.focal_px * scale)
        cell = metres * float(np.median(z[before]))
        return cls(low, scale, metres, raster.depth, _margins(raster.depth, cell))

    def look_up(self, pixel: Float64, depth: Float64, facing: Float32) -> tuple[Bool, Float64]:
        """(N,) bool, whether points are not occluded, and (N,) their margin.

        Args:
            pixel: (N, 2) photo pixels.
            depth: (N,) metres.
            facing: (N,) cosine of the viewing angle.
        """
        cell = np.clip((pixel - self.origin) * self.scale, 0, [self.depth.shape[1] - 1, self.depth.shape[0] - 1])
        column, row = cell.astype(int).T
        cosine = np.clip(facing, 0.15, 1.0)
        slant = np.sqrt(1 - cosine**2) / cosine
        # Depth bias: a texel at most this far behind the z-buffer counts as visible; slant adds to it.
        bias = 0.0015 + self.metres * depth * slant
        return depth <= self.depth[row, column] + bias, self.margin[row, column].astype(np.float64)


def _margins(depth: Float32, cell: float) -> Float32:
    """(h, w) in [0, 1], how far each cell is from outlines and inner edges; ``cell`` is its side in metres."""
    far = np.where(np.isfinite(depth), depth, np.float32(1e3))
    square = np.ones((3, 3), np.uint8)
    background = np.asarray(cv2.dilate((~np.isfinite(depth)).astype(np.uint8), square)) > 0
    drop = np.asarray(cv2.dilate(far, square)) - np.asarray(cv2.erode(far, square))
    # Difference in depth between neighbouring cells of the z-buffer that makes an occlusion edge.
    inner = (drop > 0.006) & ~background
    margin = np.ones(depth.shape, np.float32)
    # (0.003, 0.010): distance from the head's outline: the weight is 0 up to the first, and not reduced from the second
    # on. The fitted outline is off by a millimetre or two, and hair, collar or wall on a cheek is worse than an
    # inpainted cheek.
    # (0.0005, 0.003): the same from occlusion edges within the head (nose before cheek, lip before teeth): less, as
    # both sides are skin.
    for edge, (none, full) in ((background, (0.003, 0.010)), (inner, (0.0005, 0.003))):
        if edge.any():
            distance = np.asarray(cv2.distanceTransform((~edge).astype(np.uint8), cv2.DIST_L2, 3)) * cell
            margin = np.minimum(margin, np.clip((distance - none) / (full - none), 0.0, 1.0).astype(np.float32))
    return margin


@dataclass(frozen=True)
class Zones:
    """Masks at the inner texels (N,), in the order of ``chart.texels``: float32 in [0, 1] except ``skin``.

    Attributes:
        skin: bool, texel of the part "skin".
        face: the face proper, where hair and make-up are part of the likeness.
        scalp: where hair is expected.
        beside: neck and ears, in whose places collars, hair and walls are seen.
        mouth: the inside of the mouth.
        hidden: inside of the mouth and of the eye sockets.
    """

    skin: Bool
    face: Float32
    scalp: Float32
    beside: Float32
    mouth: Float32
    hidden: Float32

    @classmethod
    def of(cls, chart: Chart) -> Zones:
        """Interpolate the head's region masks to the texels of the chart."""
        head = chart.head
        rows = [
            vertex_mask(head, "face"),
            vertex_mask(head, "scalp"),
            vertex_mask(head, "neck", "ear_left", "ear_right"),
            vertex_mask(head, "mouth_inner"),
            vertex_mask(head, "mouth_inner", "eye_socket"),
        ]
        skin = chart.part.ravel()[chart.texels] == head.part_names.index("skin")
        return cls(skin, *np.ascontiguousarray(chart.inside(np.stack(rows, 1)).T))


BEFORE = (BACKGROUND, HAT, CLOTH, OTHER)
"""Parts that are never the head's own surface; hair is its own only on the scalp."""
WORN, BROWED, LIDDED, LIDS = (0.3, 0.55), (0.15, 0.4), 0.1, 0.01
"""Range of the probability of glasses, over that of a brow, from which on they hide the head; of the probability of a
brow from which on they do not; least probability of an eye that is seen behind them, and the distance from it, over the
chart's width, within which its lids are: 4 mm."""
LENS = 0.03
"""How far a lens reaches beyond what the reader makes out of glasses, over the chart's width: 13 mm."""
MIRRORS, GREEN, BRIGHT = (0.4, 0.7), 0.75, (0.15, 0.25)
"""How much bluer or brighter than the face's skin lenses mirror, natural logarithm of blue over red or of luminance;
what of green, which coatings mirror too, counts as blue; and luminance over the skin's from which on blue counts, as
lashes and brows are blue for want of light."""
RAMP = (0.25, 0.55)
"""Probability up to which a texel counts as seen, and from which on as hidden."""
SHADOW = 0.009
"""Width of the shadow of hair on the forehead, over the chart's width: 4 mm."""
STRANDS = (0.08, 0.3)
"""The same for hair alone: single strands before the forehead would be left as streaks."""


def parts_at(reading: Reading, fit: Fit, unwrapped: Unwrapped) -> Float32:
    """(N, 13) float32 probabilities of the parts at each texel; 0 where the photo does not show it.

    Beyond the crops, where nothing was read, all counts as background.

    Args:
        reading: of the photo that was fitted.
        fit: camera of the photo.
        unwrapped: the photo on the chart's inner texels.
    """
    result = np.zeros((len(unwrapped.weight), reading.parts.shape[-1]), np.float32)
    shown = np.flatnonzero(unwrapped.weight > 0)
    result[shown] = parts_at_pixels(reading, fit.camera.project(unwrapped.position[shown]))
    return result


def parts_of_face(chart: Chart, unwrapped: Unwrapped, zones: Zones) -> Float32:
    """(N, 13) float32 as :func:`parts_at`, where nothing was read: the face shows itself, all else is hidden.

    Hair, collars and walls lie beside the face; what is before it cannot be told.
    """
    result = np.zeros((len(unwrapped.weight), len(PARTS)), np.float32)
    result[:, SKIN], result[:, OTHER] = zones.face, 1 - zones.face
    names = np.array(chart.head.part_names)[chart.inner_part]
    for part, own in ((SCLERA, np.char.startswith(names, "eye")), (MOUTH, np.char.startswith(names, "teeth"))):
        result[own] = 0
        result[own, part] = 1
    return result * (unwrapped.weight > 0)[:, None]


def covered(parts: Float32, zones: Zones, *, bald: bool = False) -> Float32:
    """(N,) float32 in [0, 1], 1 where the photo shows something before the head that is no glasses.

    Args:
        parts: (N, 13) as :func:`parts_at` gives them.
        zones: of the same texels.
        bald: hair hides the scalp too, as it is a mesh of its own.
    """
    share = parts[:, list(BEFORE)].sum(1)
    if not bald:
        return smoothstep(share + parts[:, HAIR] * (1 - zones.scalp), *RAMP)
    return np.maximum(smoothstep(share + parts[:, HAIR], *RAMP), smoothstep(parts[:, HAIR], *STRANDS))


def shows_opening(parts: Float32, zones: Zones) -> Float32:
    """(N,) float32 in [0, 1], 1 on skin in whose place the photo shows an eye or the inside of the mouth.

    Lids and lips of the fitted head are never exactly where the photo's are: an iris on a lid would stay there.
    """
    # The same for eyes and mouth in place of skin: the rims of lids and lips lie in cells that they share with these.
    return np.asarray(smoothstep(parts[:, [SCLERA, IRIS, MOUTH]].sum(1), 0.5, 0.9) * zones.skin, np.float32)


def widened(chart: Chart, hidden: Float32) -> Float32:
    """(N,) float32 what hides the head, larger by ``SHADOW``: hair throws a shadow on the skin before it."""
    soft = blurred(_grown(chart, hidden, SHADOW), max(round(SHADOW * chart.width), 1) / 2)
    return np.maximum(soft.ravel()[chart.texels], hidden)


def _grown(chart: Chart, values: Float32 | Bool, reach: float) -> Float32:
    """(H, W) float32 the greatest of values (N,) within a reach, over the chart's width; a texel at least."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * max(round(reach * chart.width), 1) + 1,) * 2)
    return np.asarray(cv2.dilate(chart.spread(values[:, None].astype(np.float32))[..., 0], disc), np.float32)


def behind_glasses(chart: Chart, unwrapped: Unwrapped, parts: Float32, rims: Float32) -> Float32:
    """(N,) float32 in [0, 1], 1 where glasses hide the head.

    Through clear lenses a person's own brows, lids and lashes are seen, which nothing else tells; skin beside rims,
    which they tint and shade, is as elsewhere. What a coated lens mirrors is bluer than any skin.

    Args:
        chart: of the head.
        unwrapped: the photo on it.
        parts: (N, 13) as :func:`parts_at` gives them.
        rims: (N,) in [0, 1], those that are thinner than the reader's cells.
    """
    if not ((parts[:, GLASSES] > WORN[0]).any() or rims.any()):
        return np.zeros(len(parts), np.float32)
    worn = smoothstep(parts[:, GLASSES] - parts[:, BROW], *WORN)
    own = np.maximum(smoothstep(parts[:, BROW], *BROWED), near_eyes(chart, parts).ravel()[chart.texels] * (1 - rims))
    hidden = widened(chart, np.maximum(worn, rims)) * (1 - own)
    return np.asarray(np.maximum(hidden, mirrored_by_lenses(chart, unwrapped, parts)), np.float32)


def mirrored_by_lenses(chart: Chart, unwrapped: Unwrapped, parts: Float32) -> Float32:
    """(N,) float32 in [0, 1], 1 where lenses mirror the surroundings; arguments as above."""
    skin = (parts[:, SKIN] > SURE) & (unwrapped.weight > 0)
    if not skin.any():
        return np.zeros(len(parts), np.float32)
    lens = _grown(chart, parts[:, GLASSES] > WORN[0], LENS).ravel()[chart.texels] * (unwrapped.weight > 0)
    linear = np.maximum(srgb_to_linear(unwrapped.colour), np.float32(1e-3))
    bright = linear @ LUMA

    def beyond(measure: Float32) -> Float32:
        usual, most = np.quantile(measure[skin], (0.5, 0.98))  # two lights of different colours, a sheen: still skin
        return smoothstep(measure - max(usual, most - MIRRORS[0]), *MIRRORS)

    bluer = beyond(np.log(np.maximum(linear[:, 2], linear[:, 1] * GREEN) / linear[:, 0]))
    seen = bluer * smoothstep(bright / np.median(bright[skin]), *BRIGHT)
    return widened(chart, lens * np.maximum(seen, beyond(np.log(bright))))


def near_eyes(chart: Chart, parts: Float32) -> Float32:
    """(H, W) float32 in [0, 1], 1 on the lids of eyes that the parts (N, 13) show, 0 elsewhere."""
    eyes = parts[:, [IRIS, SCLERA]].sum(1) > LIDDED
    return blurred(_grown(chart, eyes, LIDS), LIDS * chart.width / 4)


SURFACE = (SKIN, BROW, BEARD, LIP)
"""Parts that lie on the skin: all of them are seen, and belong to the albedo."""


SURE = 0.9
"""Least probability of skin or beard at which neck and ears are taken from the photo."""

SLIVER, SLIVER_SEEN = 0.012, 0.05
"""Share of the chart below which an island of seen neck is not taken from the photo, and opacity that makes it one."""
THIN = 0.0225
"""Half of its width over the chart's, likewise: 10 mm. The fitted jaw is off by half of that: it is beard or shade."""

FRAME = (0.1, 0.07)
"""Probability of glasses, and share of the face with more, from which on glasses are worn: 0.12 and 0.15 on two photos
with them, 0.04 at most on 27 without. Frames are thinner than the reader's cells."""


@dataclass(frozen=True)
class Segmentation:
    """What the photo shows at the inner texels of a chart.

    Attributes:
        seen: (N,) float32 opacity in [0, 1] of the photo where it shows the head's own surface.
        lit: (N,) float32 in [0, 1], 1 where that is skin or lip: there the light can be measured.
        colour: (3,) float32 sRGB, median of the face's bare skin; None where none is seen.
        face: (N,) bool, texels of the face's lit skin that are seen well.
    """

    seen: Float32
    lit: Float32
    colour: Float32 | None
    face: Bool


def segment(chart: Chart, unwrapped: Unwrapped, parts: Float32, zones: Zones) -> Segmentation:
    """Tell the head's own surface from all else.

    Args:
        chart: of the head.
        unwrapped: the photo on it, its weight less where something hides the head.
        parts: (N, 13) as ``service.texture.unwrap.parts_at`` gives them.
        zones: of the same texels.
    """
    # Beards and brows look like shade to who measures light: theirs is that of the skin beside them.
    smooth = 1 - widened(chart, smoothstep(parts[:, [BEARD, BROW]].sum(1), *RAMP))
    lit = np.asarray(smooth * (1 - smoothstep(1 - parts[:, list(SURFACE)].sum(1), *RAMP)), np.float32)
    face = (zones.face > 0.5) & zones.skin & (unwrapped.weight > 0.25) & (lit > 0.5)
    colour = np.median(unwrapped.colour[face], 0).astype(np.float32) if face.any() else None
    # Collars take the neck's shape and shade it; of an ear the fit is off by as much as it is wide.
    doubt = zones.beside * widened(chart, np.asarray(parts[:, [SKIN, BEARD]].sum(1) < SURE, np.float32))
    seen = np.asarray(opacity(unwrapped.weight) * (1 - zones.hidden) * (1 - doubt), np.float32)
    return Segmentation(seen * ~_slivers(chart, seen, zones), lit, colour, face)


def _slivers(chart: Chart, seen: Float32, zones: Zones) -> Bool:
    """(N,) bool, small and narrow islands of seen neck and ears: jaw and collar throw their shade on these."""
    spread = chart.spread((zones.skin & (seen > SLIVER_SEEN))[:, None].astype(np.float32))[..., 0]
    shown = (spread > 0.5).astype(np.uint8)
    _, label, found, _ = cv2.connectedComponentsWithStats(shown)
    island = np.asarray(label.ravel()[chart.texels])
    inside = cv2.distanceTransform(shown, cv2.DIST_L2, 3)
    wide = np.zeros(len(found), bool)
    wide[label[inside >= THIN * label.shape[1]]] = True
    small = (found[:, cv2.CC_STAT_AREA] < SLIVER * label.size) | ~wide
    small[island[zones.face > 0.5]] = False
    return np.asarray(small[island])


def wears_glasses(parts: Float32, weight: Float32, zones: Zones) -> bool:
    """Whether the photo shows glasses; see :func:`worn_before`."""
    face = parts[(weight > 0.25) & (zones.face > 0.5) & zones.skin, GLASSES]
    return bool(len(face)) and bool((face > FRAME[0]).mean() > FRAME[1])


def worn_before(parts: Float32, weight: Float32, zones: Zones) -> tuple[WarningCode, ...]:
    """Warnings of what is worn before the face: ``glasses-removed``, ``face-covered``.

    Args:
        parts: (N, 13), see :func:`segment`.
        weight: (N,) of the photo at the texels, before anything was found to hide the head.
        zones: of the same texels.
    """
    face = parts[(weight > 0.25) & (zones.face > 0.5) & zones.skin]
    if not len(face):
        return ()
    # Share of the face from which on a hat, a mask or a hand before it is worth a warning.
    worn: dict[WarningCode, bool] = {
        "glasses-removed": wears_glasses(parts, weight, zones),
        "face-covered": (smoothstep(face[:, [HAT, CLOTH, OTHER]].sum(1), *RAMP) > 0.5).mean() > 0.2,
    }
    return tuple(name for name, true in worn.items() if true)
