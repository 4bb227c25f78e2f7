"""What is in the portraits: shares of parts and states, poses, sizes, tones and the time they take."""

from __future__ import annotations

import time
from collections import Counter

import numpy as np

from models.people import labels
from models.people.person import draw_person
from models.people.portrait import portrait
from models.people.shards import EYE_STATES
from models.people.skins import default_folder, load_skin


def statistics(start: int, count: int, size: int) -> str:
    """A text of some lines on the portraits of a range of seeds; the skins must be there for the time to mean much."""
    portrait(start, size)  # set-up is not part of the time
    begun, wall = time.process_time(), time.perf_counter()
    made = [portrait(seed, size) for seed in range(start, start + count)]
    cpu, wall = time.process_time() - begun, time.perf_counter() - wall
    lines = [f"{count} portraits of {size} x {size}: {cpu / count:.2f} s of CPU each ({wall / count:.2f} s elapsed)"]
    parts = np.stack([np.bincount(p.part.ravel(), minlength=len(labels.PARTS)) for p in made])
    lines.append("part          share of pixels   portraits that show it")
    for k, name in enumerate(labels.PARTS):
        lines.append(f"{name:<12}  {parts[:, k].sum() / parts.sum():>13.4f}   {(parts[:, k] > 0).mean():>20.2f}")
    states = Counter(p.eyes for p in made)
    lines.append("eyes: " + ", ".join(f"{name} {states[name] / count:.2f}" for name in EYE_STATES))
    angles = np.abs([p.camera.yaw_pitch_roll_deg() for p in made])
    for name, column in zip(("yaw", "pitch", "roll"), angles.T, strict=True):
        lines.append(f"|{name}| degrees: median {np.median(column):.0f}, 90 % below {np.quantile(column, 0.9):.0f}, most {column.max():.0f}")
    distance = np.array([p.camera.translation[2] for p in made])
    lines.append(f"distance m: {distance.min():.2f} to {distance.max():.2f}, median {np.median(distance):.2f}")
    charted = np.mean([np.isfinite(p.chart[..., 0]).mean() for p in made])
    lines.append(f"pixels with chart coordinates: {charted:.3f}; landmarks that nothing hides: {np.mean([p.seen.mean() for p in made]):.3f}")
    identity = np.stack([p.identity for p in made])
    lines.append(f"identity coefficients: rms {np.sqrt((identity**2).mean()):.2f}, beyond 2.5: {(np.abs(identity) > 2.5).mean():.4f}")
    residual = np.concatenate([np.linalg.norm(draw_person(p.seed).residual, axis=1) for p in made[:20]])
    lines.append(f"beyond the model: {1e3 * np.sqrt((residual**2).mean()):.2f} mm rms")
    tones = np.array([load_skin(draw_person(p.seed).skin, default_folder()).angle_deg for p in made])
    lines.append(f"typology angle of the skins: {tones.min():.0f} to {tones.max():.0f} degrees, median {np.median(tones):.0f}")
    level = np.array([p.image[np.isfinite(p.chart[..., 0])].mean() for p in made if np.isfinite(p.chart[..., 0]).any()])
    lines.append(f"mean code of the face: median {np.median(level):.0f}, 10 % below {np.quantile(level, 0.1):.0f}, 10 % above {np.quantile(level, 0.9):.0f}")
    return "\n".join(lines) + "\n"
