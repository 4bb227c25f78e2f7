"""``preview/overlay.jpg``: the fitted head and the landmarks over the photo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.archive.avatar import Avatar
from service.archive.preview.sheet import GREY, INK, PAPER, Image, blank, clay_picture, paste, write_text
from service.arrays import Float64, Int64
from service.colour import to_bytes
from service.face.fit.fit import Fit
from service.geometry.camera import Camera
from service.head.model import HeadModel
from service.render.sketch import over

PANEL = (520, 640)
"""Largest width and height of each of the three panels, pixels."""

_MARGIN, _CAPTION = 12, 34
_DETECTED, _FITTED = (0, 210, 255), (255, 120, 20)


def overlay(avatar: Avatar) -> Image:
    """(h, w, 3) uint8 sRGB: the photo around the head, the fitted head over it, detected and fitted landmarks."""
    import cv2

    left, top, right, bottom = crop_box(avatar)
    size = _panel_size((left, top, right, bottom))
    way = cv2.INTER_AREA if size[0] < right - left else cv2.INTER_CUBIC
    cut = np.asarray(cv2.resize(avatar.photo.pixels[top:bottom, left:right], size, interpolation=way), np.uint8)
    zoom = np.array(size) / (right - left, bottom - top)
    panels = (
        ("Photo", cut),
        ("Fitted head", _over(avatar, cut, _panel_camera(avatar.fit.camera, (left, top), zoom, size))),
        ("Landmarks", _landmarks(avatar, cut, np.array([left, top]), zoom)),
    )
    page = blank(3 * size[0] + 4 * _MARGIN, size[1] + _MARGIN + _CAPTION, PAPER)
    for index, (title, picture) in enumerate(panels):
        x = _MARGIN + index * (size[0] + _MARGIN)
        paste(page, picture, x, _MARGIN)
        write_text(page, title, x, _MARGIN + size[1] + 21, 15, INK, bold=True)
    if size[0] >= 300:
        _legend(page, 2 * size[0] + 3 * _MARGIN + 100, _MARGIN + size[1] + 21, avatar.fit)
    return page


def crop_box(avatar: Avatar) -> tuple[int, int, int, int]:
    """Left, top, right, bottom in photo pixels: bounding box of fitted head and detected face with a border, clipped.

    The whole photo where the head lies outside it.
    """
    width, height = avatar.photo.size
    points = avatar.fit.camera.project(avatar.fit.vertices[np.unique(avatar.head.triangles)])
    points = np.concatenate([points[np.isfinite(points).all(1)], avatar.face.box.reshape(2, 2)])
    # A failed fit must not make the picture useless: at most five detector boxes wide.
    low_face, high_face = avatar.face.box[:2], avatar.face.box[2:]
    reach = 2 * (high_face - low_face)
    low = np.maximum(points.min(0), low_face - reach)
    high = np.minimum(points.max(0), high_face + reach)
    room = 0.18 * (high - low).max()
    left, top = np.floor(np.clip(low - room, 0, (width, height))).astype(int)
    right, bottom = np.ceil(np.clip(high + room, 0, (width, height))).astype(int)
    if right - left < 2 or bottom - top < 2:
        return 0, 0, width, height
    return int(left), int(top), int(right), int(bottom)


def panel_box(avatar: Avatar) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of the photo's panel in pixels of the picture."""
    width, height = _panel_size(crop_box(avatar))
    return _MARGIN, _MARGIN, _MARGIN + width, _MARGIN + height


def _panel_size(crop: tuple[int, int, int, int]) -> tuple[int, int]:
    """Width and height of the panels for a part of the photo."""
    width, height = crop[2] - crop[0], crop[3] - crop[1]
    scale = min(PANEL[0] / width, PANEL[1] / height, 4.0)
    return max(1, round(width * scale)), max(1, round(height * scale))


def fitted_landmarks(head: HeadModel, fit: Fit) -> Float64:
    """(L, 2) photo pixels of the head's landmarks; contour landmarks at the nearest tabulated yaw."""
    triangle, weights = head.landmark_triangle.copy(), head.landmark_barycentric.copy()
    if len(head.contour_landmarks) and len(head.contour_yaw_deg):
        yaw = fit.camera.yaw_pitch_roll_deg()[0]
        nearest = int(np.argmin(np.abs(head.contour_yaw_deg - yaw)))
        triangle[head.contour_landmarks] = head.contour_triangle[nearest]
        weights[head.contour_landmarks] = head.contour_barycentric[nearest]
    corners = fit.vertices[head.triangles[triangle]]
    return fit.camera.project(np.einsum("lk,lkc->lc", weights, corners))


def _panel_camera(camera: Camera, corner: tuple[int, int], zoom: Float64, size: tuple[int, int]) -> Camera:
    """The photo's camera for a crop of the photo; the scales of width and height differ by rounding only."""
    return replace(
        camera,
        width=size[0],
        height=size[1],
        focal_px=camera.focal_px * float(zoom.mean()),
        principal_point=(camera.principal_point - corner) * zoom,
    )


def _over(avatar: Avatar, cut: Image, camera: Camera) -> Image:
    """The untextured head blended over the photo, so that eyes, lips and silhouette can be compared."""
    photo = np.asarray(cut, np.float32) / np.float32(255)
    head = over(*clay_picture(avatar, avatar.fit.vertices, camera), photo)
    return to_bytes(photo + np.float32(0.72) * (head - photo))


def _landmarks(avatar: Avatar, cut: Image, corner: Int64, zoom: Float64) -> Image:
    """Detected points, fitted points and the lines between them, over the dimmed photo."""
    import cv2

    picture = to_bytes(np.asarray(cut, np.float32) / 255 * 0.62 + 0.04)
    detected = (avatar.face.landmarks[:, :2] - corner) * zoom
    fitted = (fitted_landmarks(avatar.head, avatar.fit) - corner) * zoom
    limit = 4.0 * max(picture.shape[:2])
    sound = np.isfinite(detected).all(1) & np.isfinite(fitted).all(1)
    sound &= (np.abs(detected) < limit).all(1) & (np.abs(fitted) < limit).all(1)
    shift = 4
    at = [np.rint((points[sound] - 0.5) * 2**shift).astype(int) for points in (detected, fitted)]
    for a, b in zip(at[0].tolist(), at[1].tolist(), strict=True):
        cv2.line(picture, a, b, (235, 235, 235), 1, cv2.LINE_AA, shift)
    for points, colour, radius in ((at[1], _FITTED, 1.6), (at[0], _DETECTED, 1.3)):
        for point in points.tolist():
            cv2.circle(picture, point, round(radius * 2**shift), colour, -1, cv2.LINE_AA, shift)
    return picture


def _legend(page: Image, x: int, y: int, fit: Fit) -> None:
    import cv2

    for label, colour in (("detected", _DETECTED), ("fitted", _FITTED)):
        cv2.circle(page, (x, y - 5), 4, colour, -1, cv2.LINE_AA)
        write_text(page, label, x + 9, y, 14, GREY)
        x += 82 if label == "detected" else 62
    if fit.inter_ocular_px > 0:
        share = 100 * fit.landmark_rms_px / fit.inter_ocular_px
        write_text(page, f"rms {share:.1f} % of eye distance", x, y, 14, GREY)
