"""Everything that is particular to one synthetic person, as named numbers that can be written to JSON and read back."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.lightstage.skin.chromophores import melanin_for_angle
from models.lightstage.skin.streams import Stream

IDENTITY_COUNT = 80
IDENTITY_LIMIT = 2.5
ANGLE_RANGE = (-60.0, 65.0)


@dataclass(frozen=True)
class Tone:
    """Base colour. Fractions by volume; thickness of the epidermis in cm; angle is the ITA the base was chosen for."""

    typology_angle_deg: float
    melanin: float
    eumelanin: float
    blood: float
    oxygenation: float
    thickness_cm: float


@dataclass(frozen=True)
class Regions:
    """Multipliers of melanin (fm), blood (fb) or oxygenation by region, and strengths of large-scale variation."""

    forehead_melanin: float
    forehead_blood: float
    cheek_blood: float
    nose_blood: float
    ear_blood: float
    chin_blood: float
    lip_blood: float
    lip_melanin: float
    lip_border_mm: float
    upper_lid_blood: float
    circle_melanin: float
    circle_blood: float
    circle_oxygenation: float
    neck_melanin: float
    periocular_melanin: float
    perioral_melanin: float
    tan: float
    blotch_blood: float
    mottle_blood: float
    mottle_melanin: float
    grain_melanin: float
    yellow: float


@dataclass(frozen=True)
class Surface:
    """Mesostructure. Densities are relative to the regional mean, lengths and depths in mm."""

    pore_density: float
    pore_diameter: float
    pore_spread: float
    pore_depth: float
    pore_elongation: float
    primary_spacing: float
    primary_depth: float
    secondary_spacing: float
    secondary_depth: float
    anisotropy: float
    dome_depth: float
    grain_rms: float
    bump_rms: float
    crease_spacing: float
    crease_depth: float
    lip_spacing: float
    lip_depth: float
    forehead_lines: float
    glabella_lines: float
    crow_feet: float
    under_eye_lines: float
    nasolabial: float
    marionette: float
    upper_lip_lines: float
    neck_lines: float
    lid_lines: float


@dataclass(frozen=True)
class Coupling:
    """How colour follows height (varies between subjects so that no fixed law can be learnt)."""

    cavity_darkening: float
    cavity_melanin: float
    ridge_blood: float
    pore_blood: float
    free_noise: float


@dataclass(frozen=True)
class Gloss:
    """Specular reflection: scale of F0, two lobes (GGX alpha) and their mix, occlusion by cavities.

    What pores and furrows hide of themselves is little: they are shallow for their width, and nearly all of the sky
    reaches their floors. With three times this detail at 0.4 to 0.8 mm, the specular albedo of finished avatars had 2.2
    times that of a real light stage's; that of 1.6 to 3 mm is as it was then.
    """

    scale: float
    alpha_narrow: float
    alpha_broad: float
    mix: float
    oil: float
    occlusion_fine: float
    occlusion_coarse: float
    scatter_scale: float


@dataclass(frozen=True)
class Spots:
    """Expected counts on the whole face, and strengths."""

    freckles: float
    freckle_melanin: float
    lentigines: float
    moles: float
    acne: float
    acne_marks: float
    blackheads: float
    scars: float
    telangiectasia: float
    veins: float
    papules: float


@dataclass(frozen=True)
class Hair:
    """Brows, lashes, beard and scalp. Colours are linear RGB; lengths and widths in mm; densities per cm^2."""

    colour_red: float
    colour_green: float
    colour_blue: float
    grey: float
    brow_count: int
    brow_length: float
    brow_width: float
    brow_spread: float
    lash_strength: float
    beard_density: float
    beard_length: float
    beard_shadow: float
    moustache: float
    vellus_density: float
    scalp_cover: float
    scalp_length: float


@dataclass(frozen=True)
class MakeUp:
    """Opacities in [0, 1] and linear colours; all 0 for most people."""

    lipstick: float
    lipstick_red: float
    lipstick_green: float
    lipstick_blue: float
    blush: float
    foundation: float
    eyeliner: float
    eyeshadow: float
    eyeshadow_red: float
    eyeshadow_green: float
    eyeshadow_blue: float


@dataclass(frozen=True)
class Subject:
    """A synthetic person.

    Attributes:
        seed: names the person; every list of pores and hairs follows from it.
        age_years, masculine: what the rest was drawn from; ``masculine`` in [0, 1].
        identity: coefficients of the head model in standard deviations.
    """

    seed: int
    age_years: float
    masculine: float
    identity: tuple[float, ...]
    tone: Tone
    regions: Regions
    surface: Surface
    coupling: Coupling
    gloss: Gloss
    spots: Spots
    hair: Hair
    make_up: MakeUp

    @classmethod
    def sample(cls, seed: int) -> Subject:
        """Draw the person named ``seed`` >= 0; the typology angle is uniform over all human skin."""
        s = Stream(seed, "person")
        age = float(np.clip(18.0 + 62.0 * s.one() ** 1.35, 18.0, 80.0))
        masculine = 1.0 if s.chance(0.5) else 0.0
        identity = np.clip(Stream(seed, "identity").normal(size=IDENTITY_COUNT), -IDENTITY_LIMIT, IDENTITY_LIMIT)
        tone = _tone(Stream(seed, "tone"))
        made_up = Stream(seed, "make-up").chance(0.3 if masculine == 0.0 else 0.02)
        return cls(
            seed=seed,
            age_years=age,
            masculine=masculine,
            identity=tuple(float(x) for x in identity),
            tone=tone,
            regions=_regions(Stream(seed, "regions"), tone, age),
            surface=_surface(Stream(seed, "surface"), age, masculine),
            coupling=_coupling(Stream(seed, "coupling"), tone),
            gloss=_gloss(Stream(seed, "gloss"), tone),
            spots=_spots(Stream(seed, "spots"), tone, age),
            hair=_hair(Stream(seed, "hair"), tone, age, masculine),
            make_up=_make_up(Stream(seed, "make-up colours"), made_up),
        )

    def to_json(self) -> str:
        """All parameters as JSON."""
        return json.dumps(dataclasses.asdict(self), indent=2)

    @classmethod
    def from_json(cls, text: str) -> Subject:
        """The subject that ``to_json`` wrote; unknown or missing names raise TypeError."""
        data: dict[str, Any] = json.loads(text)
        groups = {
            "tone": Tone, "regions": Regions, "surface": Surface, "coupling": Coupling, "gloss": Gloss, "spots": Spots,
            "hair": Hair, "make_up": MakeUp,
        }  # fmt: skip
        for name, kind in groups.items():
            data[name] = kind(**data[name])
        return cls(**{**data, "identity": tuple(data["identity"])})


def _onset(age: float, start: float) -> float:
    """Share of a sign of age that shows, 0.5 at ``start`` years."""
    return float(1.0 / (1.0 + np.exp(-(age - start) / 8.0)))


def _tone(s: Stream) -> Tone:
    angle = s.one(*ANGLE_RANGE)
    eumelanin, oxygenation = s.one(0.6, 0.95), s.one(0.65, 0.85)
    blood = float(np.clip(s.log_normal(0.013, 0.35)[0], 0.005, 0.034))
    thickness = float(np.clip(s.log_normal(0.008, 0.15)[0], 0.0055, 0.012))
    melanin = melanin_for_angle(angle, blood, thickness, oxygenation, eumelanin)
    return Tone(angle, melanin, eumelanin, blood, oxygenation, thickness)


def _regions(s: Stream, tone: Tone, age: float) -> Regions:
    def about(value: float, spread: float = 0.12) -> float:
        return float(s.log_normal(value, spread)[0])

    ruddy = about(1.0, 0.25)
    dark = tone.typology_angle_deg < -10.0
    # The same relative change of melanin shows far more where there is much of it.
    even = 1.0 / (1.0 + 5.0 * tone.melanin)
    return Regions(
        forehead_melanin=about(1.08, 0.08),
        forehead_blood=about(0.92),
        cheek_blood=1.0 + 0.75 * ruddy,
        nose_blood=1.0 + 0.8 * about(ruddy, 0.2),
        ear_blood=about(1.8, 0.15),
        chin_blood=about(1.25, 0.12),
        lip_blood=float(np.clip(about(0.05, 0.25), 0.025, 0.085)),
        lip_melanin=about(0.5 + 1.2 * float(1.0 / (1.0 + np.exp((tone.typology_angle_deg + 12.0) / 9.0))), 0.2),
        lip_border_mm=s.one(0.5, 1.6),
        upper_lid_blood=about(1.3),
        circle_melanin=1.0 + 0.3 * about(1.0, 0.5) * (1.0 if dark else 0.7),
        circle_blood=about(1.3, 0.15),
        circle_oxygenation=s.one(0.45, 0.62),
        neck_melanin=about(0.88, 0.08),
        periocular_melanin=about(1.1, 0.1),
        perioral_melanin=about(1.12 if dark else 1.03, 0.08),
        tan=max(0.0, s.one(-0.25, 0.45)),
        blotch_blood=float(np.clip(about(0.15, 0.45), 0.04, 0.45)),
        mottle_blood=float(np.clip(about(0.1, 0.35), 0.04, 0.2)),
        mottle_melanin=float(np.clip(even * about(0.09, 0.35) * (1.0 + 0.6 * _onset(age, 50)), 0.015, 0.3)),
        grain_melanin=float(np.clip(even * about(0.06, 0.4), 0.01, 0.18)),
        yellow=s.one(0.0, 1.0),
    )


def _surface(s: Stream, age: float, masculine: float) -> Surface:
    def about(value: float, spread: float) -> float:
        return float(s.log_normal(value, spread)[0])

    coarse = about(1.0, 0.2) * (1.08 if masculine else 0.94)
    old = _onset(age, 52)

    def lines(start: float) -> float:
        return float(np.clip(_onset(age, start) * about(1.0, 0.45), 0.0, 1.6))

    return Surface(
        pore_density=about(1.0, 0.25),
        pore_diameter=float(np.clip(0.2 * coarse * (1.0 + 0.25 * _onset(age, 32)), 0.13, 0.34)),
        pore_spread=s.one(0.3, 0.5),
        pore_depth=about(0.52, 0.35) * coarse,
        pore_elongation=1.0 + 0.6 * _onset(age, 45) * about(1.0, 0.2),
        primary_spacing=float(np.clip(about(0.95 + 0.35 * old, 0.15), 0.75, 1.7)),
        primary_depth=float(np.clip(about(0.03 * coarse, 0.3), 0.014, 0.06)),
        secondary_spacing=float(np.clip(about(0.42, 0.12), 0.33, 0.56)),
        secondary_depth=float(np.clip(about(0.025 * (1.0 - 0.3 * old) * coarse, 0.3), 0.009, 0.04)),
        anisotropy=1.15 + 0.7 * old * about(1.0, 0.3),
        dome_depth=float(np.clip(about(0.010, 0.35), 0.003, 0.025)),
        grain_rms=float(np.clip(about(0.0075 * coarse**0.5, 0.22), 0.0045, 0.013)),
        bump_rms=float(np.clip(about(0.009 * (1.0 + 0.6 * old), 0.35), 0.003, 0.03)),
        crease_spacing=s.one(1.7, 3.0),
        crease_depth=float(np.clip(about(0.03 * (1.0 + 0.9 * old) * coarse, 0.35), 0.01, 0.1)),
        lip_spacing=s.one(0.75, 1.3),
        lip_depth=float(np.clip(about(0.07 * (1.0 + 0.3 * old), 0.3), 0.03, 0.2)),
        forehead_lines=lines(42),
        glabella_lines=lines(45),
        crow_feet=lines(42),
        under_eye_lines=lines(38),
        nasolabial=lines(38),
        marionette=lines(55),
        upper_lip_lines=lines(62) * (0.7 if masculine else 1.0),
        neck_lines=lines(45),
        lid_lines=lines(35),
    )


def _coupling(s: Stream, tone: Tone) -> Coupling:
    dark = 1.0 if tone.typology_angle_deg < -10.0 else 0.0
    return Coupling(
        cavity_darkening=s.one(0.02, 0.16),
        cavity_melanin=s.one(0.0, 0.1),
        ridge_blood=s.one(0.0, 0.1),
        pore_blood=s.one(-0.15, 0.3),
        free_noise=s.one(0.01, 0.024) * (1.0 + 0.6 * dark),
    )


def _gloss(s: Stream, tone: Tone) -> Gloss:
    return Gloss(
        scale=float(s.log_normal(1.0, 0.08)[0]),
        alpha_narrow=float(np.clip(s.normal(0.25, 0.04)[0], 0.16, 0.36)),
        alpha_broad=float(np.clip(s.normal(0.48, 0.06)[0], 0.36, 0.62)),
        mix=float(np.clip(s.normal(0.75, 0.1)[0], 0.5, 0.95)),
        oil=s.one(0.0, 1.0),
        occlusion_fine=s.one(0.075, 0.135),
        occlusion_coarse=s.one(0.3, 0.7),
        scatter_scale=s.one(0.7, 1.4) * (0.8 if tone.typology_angle_deg < -10.0 else 1.0),
    )


def _spots(s: Stream, tone: Tone, age: float) -> Spots:
    light = float(1.0 / (1.0 + np.exp(-(tone.typology_angle_deg - 25.0) / 10.0)))
    freckled = s.chance(0.1 + 0.3 * light)
    acne = s.chance(0.45 * (1.0 - _onset(age, 32)) + 0.05)
    return Spots(
        freckles=s.one(40, 400) * s.one() * light if freckled else s.one(0, 12),
        freckle_melanin=s.one(0.25, 1.0),
        lentigines=15.0 * _onset(age, 58) * s.one() ** 2,
        moles=float(np.clip(s.log_normal(3.0, 0.8)[0], 0, 15)),
        acne=s.one(2, 28) * s.one() if acne else s.one(0, 2),
        acne_marks=s.one(3, 30) * s.one() if acne else s.one(0, 4),
        blackheads=s.one(0, 120) * s.one(),
        scars=1.6 * s.one() ** 2,
        telangiectasia=s.one(0, 14) * (0.2 + _onset(age, 50)) * (0.3 + light),
        veins=s.one() ** 2 * (0.2 + 0.8 * light),
        papules=s.one(0, 60) * s.one(),
    )


def _hair(s: Stream, tone: Tone, age: float, masculine: float) -> Hair:
    # Blond hair goes with light skin only; most people of any tone have dark hair.
    light = float(1.0 / (1.0 + np.exp(-(tone.typology_angle_deg - 40.0) / 6.0)))
    fair = s.one() ** (0.6 + 4.0 * (1.0 - light))
    red = 0.15 if s.chance(0.05 + 0.1 * light) else 0.0
    dark, blond = np.array([0.016, 0.012, 0.010]), np.array([0.22, 0.135, 0.072])
    colour = np.exp((1.0 - fair) * np.log(dark) + fair * np.log(blond)) * np.array(
        [1.0 + 3.0 * red, 1.0, 1.0 - 2.0 * red]
    )
    stubble = masculine > 0.5 and s.chance(0.85)
    kind = s.one()
    length = 0.0 if kind < 0.4 else (s.one(0.2, 1.0) if kind < 0.8 else s.one(1.0, 3.0))
    return Hair(
        colour_red=float(colour[0]),
        colour_green=float(colour[1]),
        colour_blue=float(colour[2]),
        grey=float(np.clip(_onset(age, 55) * s.one(0.0, 1.6) - 0.1, 0.0, 0.95)),
        brow_count=int(s.one(420, 850) * (1.15 if masculine else 0.95)),
        brow_length=s.one(6.0, 9.5),
        brow_width=s.one(0.08, 0.12),
        brow_spread=s.one(0.75, 1.3) * (1.1 if masculine else 0.85),
        lash_strength=s.one(0.4, 1.0),
        beard_density=s.one(35, 100) if stubble else 0.0,
        beard_length=length,
        beard_shadow=s.one(0.05, 0.25) if stubble else 0.0,
        moustache=s.one(0.7, 1.2),
        vellus_density=s.one(20, 70),
        scalp_cover=0.0 if s.chance(0.12) else s.one(0.6, 1.0),
        scalp_length=s.one(1.0, 6.0),
    )


def _make_up(s: Stream, worn: bool) -> MakeUp:
    lipstick = s.one(0.3, 0.85) if worn and s.chance(0.7) else 0.0
    red, pink = s.one(0.25, 0.6), s.one(0.03, 0.2)
    shadow = s.uniform(0.02, 0.35, size=3)
    return MakeUp(
        lipstick=lipstick,
        lipstick_red=red,
        lipstick_green=pink * s.one(0.4, 1.0),
        lipstick_blue=pink * s.one(0.5, 1.1),
        blush=s.one(0.1, 0.5) if worn and s.chance(0.6) else 0.0,
        foundation=s.one(0.2, 0.6) if worn and s.chance(0.6) else 0.0,
        eyeliner=s.one(0.4, 0.95) if worn and s.chance(0.6) else 0.0,
        eyeshadow=s.one(0.1, 0.5) if worn and s.chance(0.4) else 0.0,
        eyeshadow_red=float(shadow[0]),
        eyeshadow_green=float(shadow[1] * 0.8),
        eyeshadow_blue=float(shadow[2]),
    )
