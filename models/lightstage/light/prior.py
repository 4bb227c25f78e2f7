"""Random scenes as photographers and rooms make them (method.md 2.2)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.lightstage.skin.streams import Stream
from service.light.environment import names
from service.light.scene import Environment, PointLight, Response, Scene, Softbox, Triple


def blackbody(kelvin: float) -> Triple:
    """Linear sRGB of a black body, luminance 1: Planck's law, CIE 1931 observer (lobes of Wyman et al. 2013)."""
    nm = np.arange(380.0, 781.0, 5.0)

    def lobe(mean: float, below: float, above: float) -> np.ndarray:
        return np.asarray(np.exp(-0.5 * ((nm - mean) / np.where(nm < mean, below, above)) ** 2))

    x = 1.056 * lobe(599.8, 37.9, 31.0) + 0.362 * lobe(442.0, 16.0, 26.7) - 0.065 * lobe(501.1, 20.4, 26.2)
    y = 0.821 * lobe(568.8, 46.9, 40.5) + 0.286 * lobe(530.9, 16.3, 31.1)
    z = 1.217 * lobe(437.0, 11.8, 36.0) + 0.681 * lobe(459.0, 26.0, 13.8)
    spectrum = nm**-5 / np.expm1(1.4388e7 / (nm * kelvin))
    xyz = np.array([(spectrum * c).sum() for c in (x, y, z)])
    matrix = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
    rgb = np.maximum(matrix @ (xyz / xyz[1]), 0.0)
    return float(rgb[0]), float(rgb[1]), float(rgb[2])


def _colour(s: Stream, strength: float) -> Triple:
    """A lamp of 2800 to 7500 K with a tint, relative to 5500 K so that cameras' daylight is white."""
    white = np.asarray(blackbody(5500.0))
    rgb = np.asarray(blackbody(s.one(2800.0, 7500.0))) / white * np.exp(s.normal(0.0, 0.03, 3)) * strength
    return float(rgb[0]), float(rgb[1]), float(rgb[2])


def _lamp(s: Stream, yaw_deg: float, pitch_deg: float, irradiance: float) -> PointLight:
    """At 0.4 to 3 m from the face, 0 to 150 mm wide."""
    distance = s.one(0.4, 3.0)
    yaw, pitch = np.radians(yaw_deg), np.radians(pitch_deg)
    face = np.array([0.0, -0.03, 0.0])
    at = face + distance * np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    return PointLight(
        (float(at[0]), float(at[1]), float(at[2])),
        _colour(s, irradiance * distance**2),
        s.one(0.0, 0.15),
    )


def _lamps(s: Stream, level: float) -> tuple[PointLight, ...]:
    """Three lamps: key, fill on the other side, a third anywhere in front; 10 % one lamp, 10 % none."""
    kind = s.one()
    if kind < 0.1:
        return ()
    yaw = s.one(-60.0, 60.0)
    key = _lamp(s, yaw, s.one(0.0, 50.0), level)
    if kind < 0.2:
        return (key,)
    fill = _lamp(s, -np.sign(yaw) * s.one(10.0, 70.0), s.one(-15.0, 40.0), level * s.one(0.2, 0.6))
    third = _lamp(s, s.one(-90.0, 90.0), s.one(-30.0, 60.0), level * s.one(0.1, 0.5))
    return key, fill, third


def _made_up(s: Stream) -> Environment:
    """Sky and ground with one to six softboxes."""
    boxes = []
    for _ in range(1 + int(s.one(0.0, 6.0))):
        yaw, pitch = s.one(-np.pi, np.pi), np.arcsin(s.one(-0.4, 1.0))
        direction = (float(np.sin(yaw) * np.cos(pitch)), float(np.sin(pitch)), float(np.cos(yaw) * np.cos(pitch)))
        colour = _colour(s, float(s.log_normal(2.0, 0.8)[0]))
        boxes.append(Softbox(direction, colour, float(s.log_normal(25.0, 0.7)[0])))
    return Environment(
        zenith=_colour(s, s.one(0.2, 1.5)), horizon=_colour(s, s.one(0.2, 1.2)), ground=_colour(s, s.one(0.05, 0.6)),
        softboxes=tuple(boxes), strength=float(s.log_normal(0.6, 0.6)[0]),
    )  # fmt: skip


def _views(s: Stream) -> tuple[Triple, ...]:
    """Three cameras at 1.2 m, 45 degrees apart, turned together by up to 10 degrees; one in 20 % of scenes."""
    turn = s.one(-10.0, 10.0)
    angles = (0.0,) if s.chance(0.2) else (0.0, -45.0, 45.0)
    yaws = [np.radians(turn + angle) for angle in angles]
    return tuple((float(1.2 * np.sin(yaw)), -0.03, float(1.2 * np.cos(yaw))) for yaw in yaws)


def _hard_lamps(s: Stream, level: float) -> tuple[PointLight, ...]:
    """One small lamp from in front, a side or above; 15 % a flash beside the camera; 15 % from behind, with a fill."""
    kind, width = s.one(), s.one(0.0, 0.08)
    if kind < 0.15:
        yaw, pitch = s.one(-8.0, 8.0), s.one(-5.0, 12.0)
    elif kind < 0.3:
        yaw, pitch = (1.0 if s.chance(0.5) else -1.0) * s.one(95.0, 150.0), s.one(0.0, 50.0)
    else:
        yaw, pitch = s.one(-85.0, 85.0), s.one(-15.0, 80.0)
    key = replace(_lamp(s, yaw, pitch, level), radius_m=width)
    if 0.15 <= kind < 0.3 or s.chance(0.3):
        return key, _lamp(s, -np.sign(yaw) * s.one(0.0, 60.0), s.one(-10.0, 40.0), level * s.one(0.03, 0.3))
    return (key,)


def sample_scene(seed: int) -> Scene:
    """The scene named ``seed``: lamps, surroundings (half of them shipped panoramas), viewpoints and a camera.

    Its exposure is left to be chosen from the face (``models.lightstage.light.expose``).
    """
    s = Stream(seed, "scene")
    if s.chance(0.5):
        chosen = names()
        name = chosen[min(int(s.one() * len(chosen)), len(chosen) - 1)]
        turn = s.one(-180.0, 180.0)
        surroundings = Environment(name=name, rotation_deg=turn, strength=float(s.log_normal(0.7, 0.6)[0]))
    else:
        surroundings = _made_up(s)
    lamps = _lamps(s, float(s.log_normal(2.0, 0.7)[0]))
    balance = np.exp(s.uniform(-0.1, 0.1, 3))
    balance /= balance[1]
    response = Response(
        target=s.one(0.55, 0.95),
        white_balance=(float(balance[0]), 1.0, float(balance[2])),
        shoulder=s.one(0.0, 0.5),
        gamma=s.one(0.9, 1.1),
    )
    return Scene(surroundings, lamps, _views(s), response)


def sample_hard_scene(seed: int) -> Scene:
    """The scene named ``seed`` in hard light: one small lamp in dim surroundings."""
    s = Stream(seed, "hard scene")
    usual = sample_scene(seed)
    strength = float(s.log_normal(0.15, 0.6)[0])
    return replace(
        usual,
        environment=replace(usual.environment, strength=strength),
        lights=_hard_lamps(s, float(s.log_normal(2.5, 0.4)[0])),
        response=replace(usual.response, target=s.one(0.6, 0.97)),
    )
