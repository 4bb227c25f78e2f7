"""What a caller may ask for, checked before any work starts."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import asdict, field, replace
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Le
from pydantic import AfterValidator, AllowInfNan, BeforeValidator, Strict, ValidationInfo
from pydantic.dataclasses import dataclass

from service.checks import CHECKED, Checked, Right, shown
from service.errors import UsageError
from service.face.fit.fit import FitSettings, IdentityComponents, Iterations, Refine
from service.hair.asked import LENGTHS_MM, STYLES, AskedHair, checked_colour, checked_hair, parse_length
from service.levels import LEVELS, SMALLEST_ENLARGED, TEXTURE_SIZE, Level, QualityName, Size
from service.map_registry import MAP_NAMES, maps_made_by
from service.reflectance.reflectance_plan import ReflectancePlan
from service.runtime.network_registry import networks_of

TEXTURE_MAPS = maps_made_by("photo")

SMALLEST_WIDTH = 96
LARGEST_WIDTH = 6144
LARGEST_SEED = 2**32 - 1

_FIT = FitSettings()

CORRECTIONS = ("hair", "hair_colour", "hair_length", "eye_colour", "mouth", "wrinkles")
"""Options by which a head is corrected, with its kept stages at hand: these find each by what it is given."""


def _in_order(maps: tuple[str, ...]) -> tuple[str, ...]:
    """The same names in the order of the archive, so that equal requests give equal bytes."""
    unknown = [name for name in maps if name not in MAP_NAMES]
    if unknown:
        raise UsageError(f"maps has {unknown[0]!r}; there are {', '.join(MAP_NAMES)}", field="maps")
    if not maps or len(set(maps)) != len(maps):
        raise UsageError(f"maps is {shown(maps)}; name at least one map, and each once", field="maps")
    return tuple(name for name in MAP_NAMES if name in maps)


def _on_the_chart(size: tuple[int, int], info: ValidationInfo) -> tuple[int, int]:
    thirds, name = round(min(max(size[0], SMALLEST_WIDTH), LARGEST_WIDTH) / 3), info.field_name
    if size != (3 * thirds, 2 * thirds):
        raise UsageError(
            f"{name} is {size[0]}x{size[1]}; the chart is 3:2 and {SMALLEST_WIDTH} to {LARGEST_WIDTH} texels wide, "
            f"for example {3 * thirds}x{2 * thirds}",
            field=name,
        )
    return size


def _known(without: tuple[str, ...]) -> tuple[str, ...]:
    if not without:
        return without
    from service.reflectance.albedo.diffuse_albedo import (
        NAMES,  # loads numpy, which the command line does without until it has work
    )

    unknown = [name for name in without if name not in NAMES]
    if unknown or len(set(without)) != len(without):
        wrong = repr(unknown[0]) if unknown else f"{shown(without)}, some of them twice"
        raise UsageError(f"without has {wrong}; there are {', '.join(NAMES)}", field="without")
    return without


SPACES = " \t\r\n"
"""What may stand around a number; ``strip`` alone also takes separators and spaces that are not ASCII."""


def parse_size(text: str, name: str = "size") -> tuple[int, int]:
    """``"576x384"`` -> (576, 384), of the option ``name``; UsageError: it is no two whole numbers with an x between."""
    width, cross, height = text.strip(SPACES).lower().partition("x")
    if not cross or not _digits(width) or not _digits(height):
        raise UsageError(f"{name} is {text!r}; write WIDTHxHEIGHT in texels, for example 576x384", field=name)
    return int(width), int(height)


def _face(text: str) -> int | str:
    bare = text.strip(SPACES)
    if bare.lower() != "largest" and not _digits(bare):
        raise UsageError(f"face is {text!r}; it has to be 'largest' or an index, 0 for the first face", field="face")
    return int(bare) if _digits(bare) else bare.lower()


def _texture_size(text: str) -> str | tuple[int, int]:
    bare = text.strip(SPACES).lower()
    return bare if bare == "auto" else parse_size(text, "texture_size")


def _digits(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= 10


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(","))


def _written(parse: Callable[[str], Any]) -> BeforeValidator:
    """Text stands for a value, too, as it is written on the command line."""
    return BeforeValidator(lambda value: parse(value) if isinstance(value, str) else value)


_Whole = Annotated[int, Strict()]
_Maps = Annotated[
    tuple[str, ...], _written(lambda text: _names(text.replace("-", "_"))), AfterValidator(_in_order),
    Right(f"names out of {', '.join(MAP_NAMES)}"),
]  # fmt: skip
_Without = Annotated[tuple[str, ...], _written(_names), AfterValidator(_known), Right("names of corrections")]
_MapSize = Annotated[tuple[_Whole, _Whole], AfterValidator(_on_the_chart)]
_Seconds = Annotated[float, Strict(), Gt(0), AllowInfNan(False)]
_FaceIndex = Annotated[int, Strict(), Ge(0), Le(9999)]


EyeColour = Literal["auto", "dark_brown", "brown", "hazel", "green", "blue", "grey"]
"""The photo's, or a natural colour; ``service.face.features.eye_colours.NAMED_IRISES`` has their albedo."""
Mouth = Literal["auto", "shut"]
Wrinkles = Literal["auto", "none", "younger", "older", "old"]
"""The photo's; or as deep as ``service.reflectance.relief.folds.AGES`` says."""
_Hair = Annotated[str | dict[str, Any], AfterValidator(checked_hair), Right(f"one of auto, none, {', '.join(STYLES)}")]
_HairColour = Annotated[str, AfterValidator(checked_colour), Right("a colour's name or '#rrggbb'")]
_HairLength = Annotated[
    float, Strict(), Ge(LENGTHS_MM[0]), Le(LENGTHS_MM[1]), AllowInfNan(False),
    Right(f"millimetres from {LENGTHS_MM[0]} to {LENGTHS_MM[1]}"),
]  # fmt: skip


@dataclass(frozen=True, kw_only=True, config=CHECKED)
class Options(Checked):
    """One request.

    Attributes:
        maps: names out of ``MAP_NAMES``, each once, at least one; kept in the order of ``MAP_NAMES``.
        quality: one of ``service.levels.LEVELS``.
        size: (width, height) of the maps in texels, width : height = 3 : 2, width in [96, 6144]; None for the level's.
            With reflectance among the maps it is theirs, and confidence and shape normals have at most 576 x 384;
            without, it is the size of those.
        texture_size: (width, height) of the map "texture", as ``size``; "auto" is what the photo holds, above
            ``draft``, and at most the size of the maps.
        bits: per component of normal maps, 8 or 16; None for the level's.
        normals: frame of specular and diffuse normals.
        budget: seconds that the whole may take on this machine; picks the best level that fits, whatever ``quality``
            says. None for no limit.
        runtime: what the networks run on; "auto" takes, network by network, the faster one by a measured rule.
        face: index of the face to take, in the order that ``MultipleFaces`` lists them; "largest"; or None, which
            refuses a photo with several faces.
        leave_out: of several photos, "strangers" leaves out those of another person, with a warning; None refuses them.
        detail: how much detail finer than the photo is made up, in [0, 1]: 0 gives the likeliest texture, smooth and
            nearest to the truth, 1 one that looks like skin.
        seed: of every random choice, in [0, 2**32 - 1].
        fit: "landmarks" stops after the landmarks, "dense" follows what the reader sees at every pixel, "full" bends
            the head beyond its components as well.
        identity_components: identity components to fit, in [0, 10000]; more than the head has means all.
        iterations: least-squares steps of the landmark stage, in [1, 1000].
        hair: "auto" wears strands as the photo shows them, or none on a bald head; "none"; a style's name; or the
            numbers of a style, as the manifest has them.
        hair_colour: "auto" is the photo's; a natural colour's name; or "#rrggbb", sRGB under white light.
        hair_length: millimetres of the longest strands, in [1, 1200]; None for the photo's, or the style's.
        eye_colour: of the irises: "auto" is the photo's, or a natural colour's name.
        mouth: "auto" is open as far as in the photo; "shut" says that its lips are closed, whatever was read.
        wrinkles: how deep they are: "auto" as in the photo, "none", or as in a younger or older face.
        without: names of corrections that do not run, for experts and trials; docs/corrections.md has them.

    Raises:
        UsageError: a value is out of range; the message has the value and what would be right.
    """

    maps: _Maps = field(default_factory=lambda: default_maps())
    quality: QualityName = "standard"
    size: Annotated[_MapSize | None, _written(parse_size), Right("two whole numbers, for example (576, 384)")] = None
    texture_size: Annotated[
        _MapSize | Literal["auto"], _written(_texture_size),
        Right("'auto' or two whole numbers, for example (1152, 768)"),
    ] = "auto"  # fmt: skip
    bits: Literal[8, 16] | None = None
    normals: Literal["tangent", "object"] = "tangent"
    budget: Annotated[_Seconds | None, Right("a number of seconds above 0")] = None
    runtime: Literal["auto", "onnxruntime", "openvino"] = "auto"
    face: Annotated[
        _FaceIndex | Literal["largest"] | None, _written(_face), Right("'largest' or an index, 0 for the first face")
    ] = None
    leave_out: Literal["strangers"] | None = None
    detail: Annotated[float, Strict(), Ge(0), Le(1), Right("a number from 0 to 1")] = 1.0
    seed: Annotated[int, Strict(), Ge(0), Le(LARGEST_SEED), Right(f"a whole number from 0 to {LARGEST_SEED}")] = 0
    fit: Refine = _FIT.refine
    identity_components: IdentityComponents = _FIT.identity_components
    iterations: Iterations = _FIT.iterations
    hair: _Hair = "auto"
    hair_colour: _HairColour = "auto"
    hair_length: Annotated[_HairLength | None, _written(parse_length)] = None
    eye_colour: EyeColour = "auto"
    mouth: Mouth = "auto"
    wrinkles: Wrinkles = "auto"
    without: _Without = ()

    @property
    def level(self) -> Level:
        """What ``quality`` means."""
        return LEVELS[self.quality]

    @property
    def map_size(self) -> Size:
        """(width, height) of the reflectance maps."""
        return self.size or self.level.size

    @property
    def base_size(self) -> Size:
        """(width, height) of confidence and shape normals, and of the texture that networks enlarge."""
        if set(self.maps) <= set(TEXTURE_MAPS):
            return self.size or TEXTURE_SIZE
        return min(self.map_size, TEXTURE_SIZE)

    @property
    def most_texture_width(self) -> int:
        """Most texels along a texture that follows the photo's resolution."""
        if not self.level.super_resolution:
            return self.base_size[0]
        if not set(self.maps) & set(maps_made_by("networks")) and self.size:
            return self.size[0]
        return self.map_size[0]

    def plan(self) -> ReflectancePlan:
        """The stages of reflectance that the maps need.

        Without a network to enlarge it in this installation the texture is resampled, and the manifest says so.
        """
        enlarged = self.level.super_resolution and self.map_size[0] >= SMALLEST_ENLARGED
        there = enlarged and installed(networks_of("super_resolution"))
        return ReflectancePlan.of(self.maps, super_resolution=there)

    def fit_settings(self) -> FitSettings:
        """The knobs of the fit; those that callers cannot turn keep their defaults."""
        return FitSettings(refine=self.fit, identity_components=self.identity_components, iterations=self.iterations)

    def uncorrected(self) -> Options:
        """Options without corrections: equal for all heads that only corrections tell apart."""
        return replace(self, **{name: type(self).__dataclass_fields__[name].default for name in CORRECTIONS})

    def asked_hair(self) -> AskedHair:
        """What is asked of the hair."""
        return AskedHair(self.hair, self.hair_colour, self.hair_length)

    def to_json(self) -> dict[str, Any]:
        """The request as JSON values, for the manifest."""
        values = asdict(self)
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}


def default_maps() -> tuple[str, ...]:
    """Every map, but for those whose networks this installation does not list."""
    return tuple(name for name in MAP_NAMES if installed(ReflectancePlan.of([name], super_resolution=False).networks))


def installed(networks: Collection[str]) -> bool:
    """Whether this installation lists all of these networks."""
    from service.runtime.sessions import model_table

    return set(networks) <= set(model_table())
