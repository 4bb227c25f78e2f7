"""Random heads of hair, for the bank and for synthetic people."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from service.hair.colour import Melanin
from service.hair.style import LOOSE, NAMED, Style

_CHANCE: Mapping[str, float] = {
    "shaved": 0.06, "crop": 0.13, "side_part": 0.11, "slicked_back": 0.06, "afro": 0.06, "bob": 0.12, "curly": 0.10,
    "long_wavy": 0.12, "ponytail": 0.14, "bun": 0.10,
}  # fmt: skip
"""How often a random style begins as each of :data:`NAMED`; none is rare, so that every kind is learnt."""

STANDS_MM = 45.0
"""Length up to which random hair is combed up."""
_SHORT_COMBED = (0.33, 0.2, 0.25, 0.15, 0.07)
"""How often short hair is combed as its kind is, and back, forward, aside and up. Seen from the front, what stands up
looks as what is combed back does, and is rarer."""
_ENDS: Mapping[str, tuple[float, float]] = {
    "bob": (-0.175, -0.055), "curly": (-0.26, -0.06), "long_wavy": (-0.42, -0.17)
}  # fmt: skip
"""Heights between which random hair is cut."""


def sample_style(seed: int, chance: Mapping[str, float] = _CHANCE) -> Style:
    """A random style; the same for the same seed and chances of :data:`NAMED` (which add up to 1)."""
    rng = np.random.default_rng([seed, 0x4A1])
    kinds = list(NAMED)
    base = NAMED[str(rng.choice(kinds, p=np.array([chance[kind] for kind in kinds])))]
    length = float(np.exp(rng.normal(0, 0.3)))
    changes: dict[str, object] = {
        name: float(np.clip(getattr(base, name) * length * np.exp(rng.normal(0, 0.15)), 0.5, 900))
        for name in ("top_mm", "fringe_mm", "sides_mm", "back_mm")
    }
    changes |= {
        "layers": _near(base.layers, 0.2, rng), "lift": _near(base.lift, 0.12, rng),
        "gravity": _near(base.gravity, 0.1, rng), "stiffness": _near(base.stiffness, 0.1, rng),
        "clump": _near(base.clump, 0.15, rng), "hairline": _near(0.2, 0.15, rng),
        "frizz_mm": base.frizz_mm * float(np.exp(rng.normal(0, 0.4))),
        "volume_mm": base.volume_mm * float(np.exp(rng.normal(0, 0.25))),
        "lock_mm": base.lock_mm * float(np.exp(rng.normal(0, 0.25))),
        "density": float(rng.uniform(0.6, 1.0)), "melanin": sample_melanin(rng),
    }  # fmt: skip
    if base.cut_y is not None:
        low, high = _ENDS[base.kind]
        changes["cut_y"] = float(rng.uniform(low, high))
        changes["tucked"] = float(rng.uniform(0.3, 1)) if rng.random() < 0.4 else 0.0
    if base.gather == "none" and base.kind not in ("shaved", "afro"):
        changes["parting"] = str(rng.choice(["none", "left", "middle", "right"], p=[0.25, 0.25, 0.3, 0.2]))
    if base.kind in ("bob", "long_wavy"):
        if rng.random() < 0.35:  # a fringe that is cut above the brows
            changes |= {"fringe_mm": float(rng.uniform(45, 80)), "kind": f"{base.kind}_fringe"}
        changes["curl"] = str(rng.choice(["1", "1", "2a", "2b", "2c"]))
    elif base.kind == "curly":
        changes["curl"] = str(rng.choice(["2c", "3a", "3b", "3c", "4a"]))
        changes["cut_y"] = None if rng.random() < 0.4 else changes["cut_y"]
    elif base.kind == "afro":
        changes["curl"] = str(rng.choice(["4a", "4b", "4c"]))
    elif base.kind in ("crop", "side_part", "slicked_back"):
        changes["curl"] = str(rng.choice(["1", "1", "1", "2a", "3b", "4a"]))
        changes["combing"] = str(rng.choice([base.combing, "back", "forward", "side", "up"], p=_SHORT_COMBED))
        if changes["combing"] == "up":  # longer hair does not stand by itself
            changes |= {name: min(float(str(changes[name])), STANDS_MM) for name in ("top_mm", "fringe_mm")}
        if changes["combing"] == "forward" and base.kind != "crop":  # hangs over the forehead
            changes |= {"fringe_mm": float(rng.uniform(45, 95)), "parting": "none", "kind": f"{base.kind}_fringe"}
        changes["fade"] = min(_near(base.fade, 0.1, rng), 0.4) if rng.random() < 0.4 else 0.0
        changes["receding"] = float(np.clip(rng.normal(0, 0.5), 0, 1)) if rng.random() < 0.5 else 0.0
        changes["crown"] = float(rng.uniform(0.3, 1)) if rng.random() < 0.3 else 0.0
        if changes["crown"] and rng.random() < 0.5:  # temples and crown have met: a horseshoe is left
            changes |= {"receding": float(rng.uniform(0.6, 1)), "crown": float(rng.uniform(0.6, 1)), "parting": "none"}
    elif base.kind == "ponytail":
        gather = str(rng.choice(["ponytail", "ponytail", "half_up", "plait", "two_plaits", "pinned"]))
        changes |= {"gather": gather, "tie_y": float(rng.uniform(-0.07, 0.075))}
        changes["kind"] = base.kind if gather == "ponytail" else gather
        changes["curl"] = str(rng.choice(["1", "1", "2a", "2b", "3b"]))
    elif base.kind == "bun":
        changes["tie_y"] = float(rng.uniform(-0.05, 0.09))
    gathered = str(changes.get("gather", base.gather))
    if gathered != "none":  # from combed tight to half undone
        changes |= {
            "volume_mm": base.volume_mm * float(np.exp(rng.normal(0.35, 0.5))), "flyaways": float(rng.uniform(0, 0.1)),
            "frizz_mm": base.frizz_mm * float(np.exp(abs(rng.normal(0, 0.7)))),
            "wisps": float(rng.uniform(0.1, 0.7)) if rng.random() < 0.6 else 0.0,
        }  # fmt: skip
    if gathered not in LOOSE:
        changes["parting"] = str(rng.choice(["none", "left", "middle", "right"], p=[0.5, 0.17, 0.2, 0.13]))
    return dataclasses.replace(base, **changes)  # type: ignore[arg-type]


def sample_melanin(rng: np.random.Generator, fair: float = 1.0) -> Melanin:
    """Pigment of a random person: black and brown are most frequent, then blond, then red; some have gone grey.

    Args:
        rng: random numbers.
        fair: 1 where any hair is as likely as in all people together, 0 where only black and brown hair grows.
    """
    chance = np.array([0.33, 0.29, 0.15, 0.16, 0.07]) * [1, 0.3 + 0.7 * fair, fair, fair, fair]
    kind = rng.choice(["black", "brown", "light_brown", "blond", "red"], p=chance / chance.sum())
    low, high, pheo = {
        "black": (1.4, 4.0, (0.05, 0.3)), "brown": (0.45, 1.4, (0.05, 0.3)), "light_brown": (0.2, 0.45, (0.05, 0.2)),
        "blond": (0.04, 0.2, (0.02, 0.15)), "red": (0.05, 0.3, (0.35, 1.0)),
    }[str(kind)]  # fmt: skip
    grey = float(rng.beta(1.2, 1.2)) if rng.random() < 0.2 else 0.0
    return Melanin(
        eumelanin=float(np.exp(rng.uniform(np.log(low), np.log(high)))), pheomelanin=float(rng.uniform(*pheo)),
        fade=float(rng.uniform(0, 0.4)), spread=float(rng.uniform(0.05, 0.25)), grey=grey,
        highlights=float(rng.uniform(0.1, 0.4)) if grey == 0 and rng.random() < 0.15 else 0.0,
    )  # fmt: skip


def _near(value: float, spread: float, rng: np.random.Generator) -> float:
    return float(np.clip(value + rng.normal(0, spread), 0, 1))
