"""What is in the portraits: shares of parts and states, poses, sizes, tones and the time they take."""

from __future__ import annotations

import time
from collections import Counter

import numpy as np
import numpy.typing as npt

from models.people.make import portrait
from models.people.person import draw_person
from models.people.shards import EYE_STATES
from models.people.skins import default_folder, load_skin
from service.face.reading import part_labels as labels


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
        lines.append(f"|{name}|, degrees: {_spread(column)}")
    lines.append(f"distance, m: {_spread(np.array([p.camera.translation[2] for p in made]), 2)}")
    charted = [np.isfinite(p.chart[..., 0]) for p in made]
    lines.append(f"share of pixels with chart coordinates: {np.mean(charted):.3f}")
    lines.append(f"share of landmarks that nothing hides: {np.mean([p.seen.mean() for p in made]):.3f}")
    identity = np.stack([p.identity for p in made])
    wide = (np.abs(identity) > 2.5).mean()
    lines.append(f"identity coefficients: rms {np.sqrt((identity**2).mean()):.2f}, beyond 2.5: {wide:.4f}")
    people = [draw_person(p.seed) for p in made]
    residual = np.concatenate([np.linalg.norm(person.residual, axis=1) for person in people])
    lines.append(f"beyond the model: {1e3 * np.sqrt((residual**2).mean()):.2f} mm rms")
    tones = np.array([load_skin(person.skin, default_folder()).angle_deg for person in people])
    lines.append(f"typology angle of the skins, degrees: {_spread(tones)}")
    level = [p.image[where].mean() for p, where in zip(made, charted, strict=True) if where.any()]
    lines.append(f"mean code of the face: {_spread(np.array(level))}")
    return "\n".join(lines) + "\n"


def _spread(values: npt.NDArray[np.floating], digits: int = 0) -> str:
    """Least, 10 %, median, 90 % and greatest value."""
    least, low, median, high, most = np.quantile(values, [0.0, 0.1, 0.5, 0.9, 1.0])
    return (
        f"median {median:.{digits}f}, 80 % from {low:.{digits}f} to {high:.{digits}f}, "
        f"all from {least:.{digits}f} to {most:.{digits}f}"
    )
