"""What a map network says about itself: the JSON under the key "description" of its ONNX file.

Nothing else in the program knows which channels a network takes or how far it looks, so another network of the same
role takes its place without a change of code.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from service.errors import ModelFault

KEY = "description"


@dataclass(frozen=True)
class Description:
    """One network that maps planes to planes: input "maps" (1, C, H, W), output "result" (1, K, scale H, scale W).

    Attributes:
        network: role, for example "rho".
        channels: C names of the input planes in order.
        outputs: K names of the output planes in order; or one name for any number of planes of a kind.
        stride: H and W have to be multiples of it.
        halo: input pixels at each side beyond which nothing matters, a multiple of ``stride``.
        scale: output pixels per input pixel.
        whole: (width, height) of an input that is never cut into tiles; None for tiles of any size.
    """

    network: str
    channels: tuple[str, ...]
    outputs: tuple[str, ...]
    stride: int = 1
    halo: int = 0
    scale: int = 1
    whole: tuple[int, int] | None = None

    def planes(self, count: int) -> tuple[str, ...]:
        """Names of ``count`` output planes: ``outputs``, or the one name numbered from 0 where there are several."""
        if len(self.outputs) == 1 and count > 1:
            return tuple(f"{self.outputs[0].removesuffix('s')}_{index}" for index in range(count))
        return self.outputs

    @classmethod
    def parse(cls, text: str, name: str) -> Description:
        """Read the JSON text of the file of model ``name``.

        Raises:
            ModelFault: it is no description; the message says what is wrong with it.
        """
        try:
            content = json.loads(text)
            whole = content.get("whole")
            found = cls(
                network=str(content["network"]),
                channels=_names(content["channels"]),
                outputs=_names(content["outputs"]),
                stride=_count(content, "stride", 1),
                halo=_count(content, "halo", 0),
                scale=_count(content, "scale", 1),
                whole=None if whole is None else (_positive(whole[0]), _positive(whole[1])),
            )
        except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
            raise ModelFault(f"model {name}: its description cannot be read ({error!r}): {text[:200]!r}") from error
        if found.halo % found.stride:
            raise ModelFault(f"model {name}: halo {found.halo} is not a multiple of its stride {found.stride}")
        return found


def _names(values: Any) -> tuple[str, ...]:
    names = tuple(str(value) for value in values)
    if isinstance(values, str) or not names:
        raise ValueError(f"{values!r} has to be a list of names")
    return names


def _count(content: dict[str, Any], key: str, least: int) -> int:
    value = content.get(key, least)
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise ValueError(f"{key} is {value!r}, it has to be a whole number of at least {least}")
    return value


def _positive(value: Any) -> int:
    if not isinstance(value, int) or value < 1:
        raise ValueError(f"{value!r} has to be a size in pixels")
    return value
