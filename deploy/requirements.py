"""Print what the serving install needs, from pyproject.toml: python requirements.py [EXTRA,...]."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path


def requirements(project: dict[str, object], extras: list[str]) -> list[str]:
    """Requirements of the project and of some of its extras.

    Args:
        project: the table ``project`` of pyproject.toml.
        extras: names of extras.

    Raises:
        KeyError: there is no such extra.
    """
    needed, optional = project["dependencies"], project["optional-dependencies"]
    if not isinstance(needed, list) or not isinstance(optional, dict):
        raise KeyError("dependencies")
    return [*needed, *(requirement for extra in extras for requirement in optional[extra])]


if __name__ == "__main__":
    wanted = [name.strip() for argument in sys.argv[1:] for name in argument.split(",") if name.strip()]
    table = tomllib.loads(Path("pyproject.toml").read_text("utf-8"))["project"]
    sys.stdout.writelines(f"{requirement}\n" for requirement in requirements(table, wanted))
