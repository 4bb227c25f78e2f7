"""Eyes, teeth, tongue and lashes: their albedo by what the photo shows of them, and how they look in its light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes import colours as eye
from service.anatomy.eyes.measure import measure_eyes
from service.anatomy.eyes.paint import alike, lid_shade, on_eyeball, paint_eye, sight_angle
from service.anatomy.lashes.line import COLOUR as LASHES
from service.anatomy.lashes.line import LASH_LINE, lash_line
from service.anatomy.mouth.paint import paint_lining, paint_tongue
from service.anatomy.teeth.colours import TOOTH
from service.anatomy.teeth.measure import toothlike
from service.anatomy.teeth.paint import TOOTH_HUE, Teeth, no_bluer
from service.colour import linear_to_srgb, luma, srgb_to_linear
from service.face.fit.result import Fit
from service.geometry.chart import Chart, nearest_inside
from service.ledger import SEEN_CHANGE, Ledger
from service.photo.photo import Photo
from service.texture.inpainting.inpaint import opacity
from service.texture.result import SEEN
from service.texture.segmentation.zones import Zones
from service.texture.unwrap import Unwrapped

Float = npt.NDArray[np.float32]

DARKEST = 1e-3
"""Linear value of the darkest sclera: albedo is divided by its light."""
BETWEEN_LIDS = 0.7
"""What the lids leave of the light on the flesh between them and the eyeball, on sRGB values."""
COLOURFUL = 0.06
"""Range of the skin's sRGB channels from which a photo counts as coloured; of a grey one all parts are grey."""
KNOWN = 0.05
"""Share of a texel that is no skin from which it has an albedo of its own."""


@dataclass(frozen=True)
class PartLight:
    """The light between the lids and lips.

    Attributes:
        white: (3,) float32 linear RGB, positive, of a white diffuse surface in it.
        colourfulness: of the photo, in [0, 1].
    """

    white: Float
    colourfulness: float

    @classmethod
    def of(cls, sclera: Float | None, skin: Float | None, face: Float) -> PartLight:
        """By the sclera where it was seen, else by the bright end of the face.

        Args:
            sclera: (3,) sRGB or None.
            skin: (3,) sRGB median skin or None.
            face: (N, 3) sRGB texels of the face, may be empty.
        """
        if sclera is None:
            bright = np.percentile(luma(face), 95) / 0.8 if len(face) else 1.0
            sclera = linear_to_srgb(eye.SCLERA) * np.float32(np.clip(bright, 0.35, 1.15))
        colourful = 1.0 if skin is None else float(np.clip((skin.max() - skin.min()) / COLOURFUL, 0.0, 1.0))
        white = np.maximum(srgb_to_linear(sclera), np.float32(DARKEST)) / eye.SCLERA
        grey = luma(white)
        return cls(np.asarray(grey + np.float32(colourful) * (white - grey), np.float32), colourful)

    def of_photo(self, albedo: Float) -> Float:
        """(..., 3) sRGB-coded albedo, as grey as the photo is."""
        grey = luma(albedo)[..., None]
        return np.asarray(grey + np.float32(self.colourfulness) * (albedo - grey), np.float32)

    def on(self, albedo: Float) -> Float:
        """(..., 3) sRGB that the photo shows of an sRGB-coded albedo."""
        return linear_to_srgb(srgb_to_linear(albedo) * self.white)

    def off(self, colour: Float) -> Float:
        """(..., 3) sRGB-coded albedo of what the photo shows, at most ``BRIGHTEST``; the inverse of :meth:`on`."""
        return linear_to_srgb(np.minimum(srgb_to_linear(colour) / self.white, np.float32(eye.BRIGHTEST)))


@dataclass(frozen=True)
class Parts:
    """What lies between lids and lips, at the inner texels (N,).

    Attributes:
        colour: (N, 3) sRGB in the photo's light, on top of the skin's.
        code: (N,) confidence, see ``service.texture.result``.
        albedo: (H, W, 3) sRGB-coded albedo of all that is no skin, continued over the chart.
        iris: (3,) linear albedo of the irises, the usual one where none was seen.
    """

    colour: Float
    code: Float
    albedo: Float
    iris: Float


def paint_parts(
    photo: Photo, chart: Chart, fit: Fit, unwrapped: Unwrapped, zones: Zones, colour: Float, code: Float, skin: Float,
    ledger: Ledger,
) -> Parts:  # fmt: skip
    """Eyes, teeth, tongue, lashes, sockets and the mouth's lining on top of the skin.

    Args:
        photo: that was fitted.
        chart: of the head.
        fit: with gaze, cheek and teeth.
        unwrapped: the photo on the chart.
        zones: of the same texels.
        colour: (N, 3) sRGB of the completed skin.
        code: (N,) its confidence.
        skin: (3,) sRGB of the person's skin.
        ledger: which corrections run.
    """
    irises = () if fit.gaze is None else fit.gaze.irises
    tone = measure_eyes(photo.pixels, irises)
    seen = opacity(unwrapped.weight)
    face = (zones.face > 0.5) & zones.skin & (unwrapped.weight > 0.25)
    light = PartLight.of(tone.sclera, skin, unwrapped.colour[face])
    iris = eye.IRIS if tone.iris is None else np.asarray(srgb_to_linear(tone.iris) / light.white, np.float32)
    work = _Work(chart, light, colour.copy(), code.copy(), np.zeros_like(colour), np.zeros(len(colour), np.float32))

    socket = np.clip(zones.hidden - zones.mouth, 0, 1) * zones.skin
    work.over_skin(socket, linear_to_srgb(eye.SOCKET), np.float32(BETWEEN_LIDS))
    if ledger.runs(LASH_LINE):
        lashes = lash_line(chart) * zones.skin * (1 - seen)
        work.colour += lashes[:, None] * (light.on(light.of_photo(linear_to_srgb(LASHES))) - work.colour)
        ledger.count(LASH_LINE, int((lashes > SEEN_CHANGE).sum()), len(lashes))
    mouth = zones.mouth * zones.skin
    work.over_skin(mouth, paint_lining(chart, mouth), np.float32(1))
    # Eyes without a visible iris point elsewhere than in the photo, which shows lids or glass in their place.
    eyes_seen = seen * float(fit.gaze is None or tone.iris is not None)
    for index, name in enumerate(chart.head.part_names):
        own = np.flatnonzero(chart.inner_part == index)
        if name == "skin" or name.startswith("teeth") or not len(own):
            continue
        if name.startswith("eye"):
            ball, points = on_eyeball(chart, index)
            painted = _eye(ball.limbus_deg, ball.pupil_deg, sight_angle(ball, points), iris)
            shown = np.asarray(light.on(light.of_photo(painted)) * lid_shade(ball, points), np.float32)
            share = eyes_seen[own] * (alike(unwrapped.colour[own], shown) if irises else 1.0)
            work.part(own, painted, shown, share, unwrapped.colour)
        else:
            painted = paint_tongue(chart, index, own) if name == "tongue" else linear_to_srgb(LASHES)[None]
            work.part(own, painted, None, np.zeros(len(own), np.float32), unwrapped.colour)
    teeth = Teeth(chart)
    if len(teeth.own):
        _paint_teeth(work, teeth, fit, unwrapped, seen, skin, ledger)
    return Parts(work.colour, work.code, work.everywhere(), iris)


def _eye(limbus: float, pupil: float, angle: Float, iris: Float) -> Float:
    """(n, 3) sRGB-coded albedo of an eye's texels."""
    sclera, coded, socket = (linear_to_srgb(c) for c in (eye.SCLERA, eye.likely_iris(iris), eye.SOCKET))
    return paint_eye(angle, limbus, pupil, sclera, coded, socket)


def _paint_teeth(
    work: _Work, teeth: Teeth, fit: Fit, unwrapped: Unwrapped, seen: Float, skin: Float, ledger: Ledger
) -> None:
    """Teeth in the measured colour, and as the photo shows them where it shows teeth."""
    light, shown = work.light, unwrapped.colour[teeth.own]
    tooth = linear_to_srgb(TOOTH) if fit.tooth is None else light.off(fit.tooth)
    share = seen[teeth.own] * toothlike(shown, skin) * teeth.shows(shown, light.on(tooth))
    painted = teeth.paint(tooth)
    painted += share[:, None] * (light.off(shown) - painted)
    if ledger.runs(TOOTH_HUE):
        before, painted = painted, no_bluer(painted)
        ledger.count(TOOTH_HUE, int((np.abs(painted - before).max(1) > SEEN_CHANGE).sum()), len(work.colour))
    work.part(teeth.own, painted, None, np.zeros_like(share), unwrapped.colour)
    work.code[teeth.own] = _code(share)


@dataclass
class _Work:
    """What has been painted so far, at the inner texels."""

    chart: Chart
    light: PartLight
    colour: Float
    code: Float
    albedo: Float
    known: Float

    def over_skin(self, share: Float, albedo: Float, lit: np.float32) -> None:
        """Lay an sRGB-coded albedo over the skin by a share (N,); ``lit`` is a factor on sRGB values of the texture."""
        own = self.light.of_photo(albedo)
        self.colour += share[:, None] * (self.light.on(own) * lit - self.colour)
        self.albedo += share[:, None] * (own - self.albedo)
        self.known = np.maximum(self.known, share)

    def part(
        self, own: npt.NDArray[np.int64], albedo: Float, shown: Float | None, share: Float, photo: Float
    ) -> None:
        """Write a part's texels: its albedo (n, 3), and the texture with a share (n,) of the photo (N, 3)."""
        albedo = self.light.of_photo(albedo)
        painted = self.light.on(albedo) if shown is None else shown
        self.albedo[own], self.known[own] = albedo, 1
        self.colour[own] = painted + share[:, None] * (photo[own] - painted)
        self.code[own] = _code(share)

    def everywhere(self) -> Float:
        """(H, W, 3) the albedo; on skin and outside the islands that of the nearest texel that has one."""
        chart = self.chart
        known = chart.spread(self.known[:, None])[..., 0] > KNOWN
        # Of a texel that is partly skin the share of the part counts alone.
        whole = self.albedo / np.maximum(self.known, np.float32(KNOWN))[:, None]
        planes = chart.spread(np.clip(whole, 0, 1).astype(np.float32))
        return planes.reshape(-1, 3)[nearest_inside(known)] if known.any() else planes


def _code(share: Float) -> Float:
    """(n,) confidence of texels with a share (n,) of the photo."""
    return np.asarray(np.where(share > 0.05, np.rint(SEEN + (255 - SEEN) * share), 0), np.float32)
