"""``avatarme export``: a kit for a tool. That for Blender is the maps and the head, a script that builds the scene, and
the scene itself where Blender is; those for engines are made in ``service.kits.engines``.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from service.archive.container import ArchiveFile
from service.errors import OutputFault, UsageError
from service.machine import variable

SCRIPT = Path(__file__).resolve().parent.parent / "data" / "kits" / "blender_scene.txt"
"""The script; not named .py, as it runs in Blender and not here."""

VARIABLE = "AVATARME_BLENDER"
"""Environment variable with the path of Blender, or of a Python that has the module bpy."""


def write_blender_kit(source: ArchiveFile, folder: Path) -> list[Path]:
    """Write the files that Blender's script needs, and the script."""
    from service.kits.source import extract, kit_facts, write, write_light

    facts = kit_facts(source)  # what can be refused comes before what is written
    light = write_light(source, folder)
    wanted = ("maps/", "mesh/head.usda", "mesh/hair.usda", "mesh/beard.usda", "LICENSES.md")
    written = light + extract(source, folder, wanted)
    facts |= {"environment": light[0].name if light else None}
    write(folder / "kit.json", (json.dumps(facts, indent=1) + "\n").encode())
    write(folder / "avatar_scene.py", SCRIPT.read_bytes())
    return [*written, folder / "kit.json", folder / "avatar_scene.py"]


def blender() -> list[str] | None:
    """How Blender's Python is called with a script, up to the script's path; None where there is none.

    ``AVATARME_BLENDER`` comes first, then ``blender`` of the path, then the module bpy of this Python.
    """
    named = variable(VARIABLE) or shutil.which("blender")
    if named:
        python = Path(named).name.startswith("python")
        return [named] if python else [named, "--background", "--factory-startup", "--python"]
    return [sys.executable] if find_spec("bpy") is not None else None


def build_scene(folder: Path) -> Path | None:
    """Build ``avatar.blend`` in a kit's folder by Blender; None where there is no Blender.

    OutputFault: Blender could not build it; says what it said.
    """
    command = blender()
    if command is None:
        return None
    script = folder.resolve() / "avatar_scene.py"
    target = folder / "avatar.blend"
    background = [] if command[1:] else ["--background"]
    try:
        done = subprocess.run(  # noqa: S603 - the user's own Blender
            [*command, str(script), *background], capture_output=True, text=True, timeout=600, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise OutputFault(f"Blender ({command[0]}) could not build {target}: {error}", path=str(target)) from error
    if done.returncode != 0 or not target.is_file():
        said = (done.stderr or done.stdout).strip().splitlines()[-3:]
        raise OutputFault(f"Blender ({command[0]}) could not build {target}: {' | '.join(said)}", path=str(target))
    return target


TOOLS = ("blender", "unreal", "unity", "maya")


def known_tool(tool: object) -> str:
    """The name of a tool; UsageError where there is no kit for it."""
    if not isinstance(tool, str) or tool not in TOOLS:
        raise UsageError(f"for is {tool!r:.60}; there are {', '.join(TOOLS)}", field="for")
    return tool


@dataclass(frozen=True)
class Kit:
    """What was written: all files of a folder, and ``avatar.blend``, None without Blender or for another tool."""

    folder: Path
    files: tuple[Path, ...]
    scene: Path | None

    def facts(self) -> dict[str, Any]:
        """What the kit holds, as JSON values."""
        return {
            "folder": str(self.folder),
            "files": [str(path.relative_to(self.folder)) for path in self.files],
            "bytes": sum(path.stat().st_size for path in self.files),
            "scene": None if self.scene is None else str(self.scene),
        }


def export_kit(archive: Path, tool: str, folder: Path) -> Kit:
    """Write the kit of an archive for a tool into a folder, which is made.

    UsageError: no such tool or archive, or the folder holds other things. BadArchive: the archive cannot be used.
    OutputFault: a file could not be written, or Blender could not build the scene.
    """
    from service.kits.engines import write_engine_kit  # loads numpy, which the server does without
    from service.kits.source import opened

    known_tool(tool)
    source = opened(archive)
    if folder.exists() and not folder.is_dir():
        raise OutputFault(f"cannot write {folder}: it is no folder", path=str(folder))
    if folder.is_dir() and any(folder.iterdir()) and not (folder / "kit.json").is_file():
        raise UsageError(f"the folder {folder} holds other files; name a new one with -o", field="output")
    if tool != "blender":
        return Kit(folder, tuple(write_engine_kit(source, folder, tool)), None)
    files = write_blender_kit(source, folder)
    scene = build_scene(folder)
    return Kit(folder, (*files, *([scene] if scene else [])), scene)
