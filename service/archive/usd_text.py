"""Prims and arrays as USD text; prims are read back from it too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import orjson

from service.arrays import AnyFloat, AnyInt
from service.errors import NumericFault


@dataclass(frozen=True)
class Prim:
    """A thing of a USD file.

    Attributes:
        kind: its type.
        name: its own.
        values: "type name" -> text of the value; None where it is only declared.
        facts: "type name" -> metadata of the value, for example ``interpolation = "vertex"``.
        schemas: API schemas that are applied.
        children: prims below it.
    """

    kind: str
    name: str
    values: dict[str, str | None]
    facts: Mapping[str, Sequence[str]] = field(default_factory=dict)
    schemas: Sequence[str] = ()
    children: list[Prim] = field(default_factory=list)

    def text(self, indent: str) -> str:
        """Lines of USD."""
        inner = f"{indent}    "
        lines = [f'{indent}def {self.kind} "{self.name}"', f"{indent}{{"]
        if self.schemas:
            lines[0] += f" (\n{inner}prepend apiSchemas = [{tokens(self.schemas)}]\n{indent})"
        for key, value in self.values.items():
            lines.append(f"{inner}{key}" + ("" if value is None else f" = {value}"))
            if key in self.facts:
                lines[-1] += f" (\n{''.join(f'{inner}    {fact}{chr(10)}' for fact in self.facts[key])}{inner})"
        return "\n".join([*lines, "".join(child.text(inner) for child in self.children) + f"{indent}}}\n"])


def read_prims(text: str) -> list[Prim]:
    """Prims of kinds, names, values and children as :meth:`Prim.text` wrote them; metadata is left out."""
    found: list[Prim] = []
    above: list[Prim] = []
    for line in text.splitlines():
        words = line.strip()
        if words.startswith("def "):
            _, kind, name, *_ = words.split()
            made = Prim(kind, name.strip('"'), {})
            (above[-1].children if above else found).append(made)
        elif words == "{":
            above.append(made)
        elif words == "}":
            above.pop()
        elif above and " = " in words:
            key, _, value = words.partition(" = ")
            above[-1].values[key] = value.removesuffix(" (")
    return found


def tokens(names: Sequence[str]) -> str:
    """Names as "a", "b" in quotes."""
    return ", ".join(f'"{name}"' for name in names)


def fixed_tuples(rows: AnyFloat | Sequence[AnyFloat], decimals: int) -> str:
    """Rows (N, C) of finite numbers, rounded to so many decimals, as "(a,b),(c,d)"."""
    words = _json(np.round(np.asarray(rows, np.float64), decimals) + 0.0)
    return words.replace("[", "(").replace("]", ")")


def numbers(values: AnyFloat | AnyInt) -> str:
    """Numbers of any shape, flat, as "a,b" in the fewest digits that tell each from its neighbours."""
    return _json(values.ravel())


def _json(values: AnyFloat | AnyInt) -> str:
    """An array as JSON without its brackets, which three.js takes arrays of USD for.

    NumericFault: a number is not finite, for which JSON has no word.
    """
    if not np.isfinite(values).all():
        bad = np.count_nonzero(~np.isfinite(values))
        raise NumericFault(f"{bad} of {values.size} numbers of a mesh are NaN or Inf")
    return orjson.dumps(np.ascontiguousarray(values), option=orjson.OPT_SERIALIZE_NUMPY)[1:-1].decode("ascii")
