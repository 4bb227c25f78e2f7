"""Eyes, teeth, tongue and lashes: albedo measured in the photo, and their colour in the photo's light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.anatomy.eyes import BRIGHTEST, SOCKET, lid_shade, on_eyeball, paint_eye, sight_angle
from service.anatomy.mouth import Teeth, no_bluer, paint_lining, paint_tongue
from service.anatomy.wearables import LASH
from service.arrays import Bool, Float32, Int64
from service.colour import bytes_to_linear, linear_to_srgb, luma, srgb_to_linear
from service.face.features.eye_colours import IRIS, SCLERA, iris_without_light
from service.face.features.mouth import TOOTH
from service.face.fit.fit import Fit
from service.face.reading import part_labels as labels
from service.face.reading.reader import Reading
from service.geometry.chart import Chart, nearest_inside
from service.map_registry import SEEN
from service.photo.photo import Photo
from service.texture.inpainting import opacity
from service.texture.unwrap import Unwrapped, Zones

KNOWN = 0.05
"""Share of a texel that has to be another part than skin for it to have an albedo."""


@dataclass(frozen=True)
class LightOnParts:
    """Light of the photo on eyes, teeth and tongue.

    Attributes:
        white: (3,) float32 linear RGB, positive, that a white diffuse surface would have in it.
        colourfulness: of the photo, in [0, 1]; 0 for a grey one.
    """

    white: Float32
    colourfulness: float

    @classmethod
    def of(cls, sclera: Float32 | None, skin: Float32 | None, face: Float32) -> LightOnParts:
        """From the sclera where it was seen, else from the brightest texels of the face.

        Args:
            sclera: (3,) sRGB as the photo shows it, or None.
            skin: (3,) sRGB median of the skin, or None.
            face: (N, 3) sRGB texels of the face; N may be 0.
        """
        if sclera is None:
            bright = np.percentile(luma(face), 95) / 0.8 if len(face) else 1.0
            sclera = linear_to_srgb(SCLERA) * np.float32(np.clip(bright, 0.35, 1.15))
        # Range of the skin's sRGB channels from which on a photo counts as coloured; in a grey one all parts are grey.
        colourful = 1.0 if skin is None else float(np.clip((skin.max() - skin.min()) / 0.06, 0.0, 1.0))
        # Smallest linear value of the sclera, as albedos are divided by its light.
        white = np.maximum(srgb_to_linear(sclera), np.float32(1e-3)) / SCLERA
        grey = luma(white)
        return cls(np.asarray(grey + np.float32(colourful) * (white - grey), np.float32), colourful)

    def of_photo(self, albedo: Float32) -> Float32:
        """(..., 3) sRGB-coded albedo, as desaturated as the photo."""
        grey = luma(albedo)[..., None]
        return np.asarray(grey + np.float32(self.colourfulness) * (albedo - grey), np.float32)

    def on(self, albedo: Float32) -> Float32:
        """(..., 3) sRGB colour of an sRGB-coded albedo (..., 3) in this light."""
        return linear_to_srgb(srgb_to_linear(albedo) * self.white)

    def off(self, colour: Float32) -> Float32:
        """(..., 3) sRGB-coded albedo, at most ``BRIGHTEST``, of an sRGB colour in this light; the inverse of
        :meth:`on`.
        """
        return linear_to_srgb(np.minimum(srgb_to_linear(colour) / self.white, np.float32(BRIGHTEST)))


CLOTHED, LEAST_CLOTH, BRIGHT_CLOTH = 0.9, 20, 0.9
"""Probability from which on a cell of a reading is cloth; fewest cells that count; quantile of their luminance."""


def brightest_cloth(photo: Photo, reading: Reading) -> float:
    """Linear luminance in [0, 1] of the brightest tenth of what the person wears but hats; 0 where none is seen."""
    cloth = reading.parts[..., labels.CLOTH] > CLOTHED
    if cloth.sum() < LEAST_CLOTH:
        return 0.0
    shown = reading.region.cut(photo.pixels, len(cloth))[cloth]
    return float(np.quantile(luma(bytes_to_linear(shown)), BRIGHT_CLOTH))


@dataclass(frozen=True)
class Parts:
    """Skin and all other parts, at the inner texels (N,).

    Attributes:
        colour: (N, 3) sRGB in the photo's light: the parts painted over the skin.
        code: (N,) confidence, see ``service.texture.texture``.
        albedo: (H, W, 3) sRGB-coded albedo of all parts but skin, extended over the chart.
        iris, tooth: (3,) linear albedo of irises (:func:`iris_without_light`) and of teeth, the usual one where unseen.
    """

    colour: Float32
    code: Float32
    albedo: Float32
    iris: Float32
    tooth: Float32


def paint_parts(
    chart: Chart, fit: Fit, unwrapped: Unwrapped, zones: Zones, face: Bool, shown: Float32,
    colour: Float32, code: Float32, skin: Float32,
) -> Parts:  # fmt: skip
    """Paint eyes, teeth, tongue, lashes, sockets and the lining of the mouth over the skin.

    Args:
        chart: of the head.
        fit: with gaze and the colours of eyes and teeth.
        unwrapped: the photo on the chart.
        zones: of the same texels.
        face: (N,) bool, texels of the face's lit skin.
        shown: (N, 13) parts that the photo shows at them.
        colour: (N, 3) sRGB of the completed skin.
        code: (N,) confidence of that skin.
        skin: (3,) sRGB of the person's skin.
    """
    seen = opacity(unwrapped.weight)
    light = LightOnParts.of(fit.sclera, skin, unwrapped.colour[face])
    iris = IRIS if fit.iris is None else iris_without_light(fit.iris, light.white)
    work = _Painted(chart, light, colour.copy(), code.copy(), np.zeros_like(colour), np.zeros(len(colour), np.float32))

    socket = np.clip(zones.hidden - zones.mouth, 0, 1) * zones.skin
    # Factor on sRGB values by which the lids shade the conjunctiva between them and the eyeball.
    work.over_skin(socket, linear_to_srgb(SOCKET), np.float32(0.7))
    mouth = zones.mouth * zones.skin
    work.over_skin(mouth, paint_lining(chart, mouth), np.float32(1))
    # With no iris found, the head's eyes may look elsewhere than the photo's, or it shows lids or lenses instead.
    told = np.float32(fit.gaze is None or fit.iris is not None)
    eyes_seen = seen * shown[:, [labels.SCLERA, labels.IRIS]].sum(1) * told
    for index, name in enumerate(chart.head.part_names):
        texels = np.flatnonzero(chart.inner_part == index)
        if name == "skin" or name.startswith("teeth") or not len(texels):
            continue
        if name.startswith("eye"):
            ball, points = on_eyeball(chart, index)
            painted = paint_eye(sight_angle(ball, points), ball.limbus_deg, ball.pupil_deg, iris)
            shaded = np.asarray(light.on(light.of_photo(painted)) * lid_shade(ball, points), np.float32)
            work.part(texels, painted, shaded, eyes_seen[texels], unwrapped.colour)
        else:
            painted = paint_tongue(chart, index, texels) if name == "tongue" else linear_to_srgb(LASH)[None]
            work.part(texels, painted, None, np.zeros(len(texels), np.float32), unwrapped.colour)
    teeth, tooth = Teeth(chart), linear_to_srgb(TOOTH) if fit.tooth is None else light.off(fit.tooth)
    if len(teeth.own):
        _paint_teeth(work, teeth, tooth, unwrapped, seen * shown[:, labels.MOUTH])
    return Parts(work.colour, work.code, work.everywhere(), iris, srgb_to_linear(no_bluer(tooth[None])[0]))


def _paint_teeth(work: _Painted, teeth: Teeth, tooth: Float32, unwrapped: Unwrapped, seen: Float32) -> None:
    """Teeth of a sRGB-coded albedo (3,), blended with the photo where it shows teeth."""
    light, shown = work.light, unwrapped.colour[teeth.own]
    share = seen[teeth.own] * teeth.shows(shown, light.on(tooth))
    painted = teeth.paint(tooth)
    painted += share[:, None] * (light.off(shown) - painted)
    work.part(teeth.own, no_bluer(painted), None, np.zeros_like(share), unwrapped.colour)
    work.code[teeth.own] = _code(share)


@dataclass
class _Painted:
    """What has been painted so far, at the inner texels."""

    chart: Chart
    light: LightOnParts
    colour: Float32
    code: Float32
    albedo: Float32
    known: Float32

    def over_skin(self, share: Float32, albedo: Float32, lit: np.float32) -> None:
        """Blend an sRGB-coded albedo over the skin by a share (N,); ``lit`` is a factor on sRGB values of the
        texture.
        """
        albedo = self.light.of_photo(albedo)
        self.colour += share[:, None] * (self.light.on(albedo) * lit - self.colour)
        self.albedo += share[:, None] * (albedo - self.albedo)
        self.known = np.maximum(self.known, share)

    def part(self, texels: Int64, albedo: Float32, shown: Float32 | None, share: Float32, photo: Float32) -> None:
        """Write the texels of a part.

        Args:
            texels: (n,) indices among the inner texels.
            albedo: (n, 3) or (1, 3), sRGB-coded.
            shown: (n, 3) sRGB of that albedo in the photo's light; None: computed.
            share: (n,) opacity of the photo in the texture.
            photo: (N, 3) sRGB at all inner texels.
        """
        albedo = self.light.of_photo(albedo)
        painted = self.light.on(albedo) if shown is None else shown
        self.albedo[texels], self.known[texels] = albedo, 1
        self.colour[texels] = painted + share[:, None] * (photo[texels] - painted)
        self.code[texels] = _code(share)

    def everywhere(self) -> Float32:
        """(H, W, 3) albedo of the parts; on skin and outside the islands that of the nearest texel that has one."""
        chart = self.chart
        known = chart.spread(self.known[:, None])[..., 0] > KNOWN
        # In a texel that is partly skin, the albedo is that of the part alone.
        whole = self.albedo / np.maximum(self.known, np.float32(KNOWN))[:, None]
        planes = chart.spread(np.clip(whole, 0, 1).astype(np.float32))
        return planes.reshape(-1, 3)[nearest_inside(known)] if known.any() else planes


def _code(share: Float32) -> Float32:
    """(n,) confidence code of texels with a share (n,) of the photo."""
    return np.asarray(np.where(share > 0.05, np.rint(SEEN + (255 - SEEN) * share), 0), np.float32)
