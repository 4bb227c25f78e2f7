"""The kit for Blender: the maps and the head, a script that builds the scene, and the scene itself where Blender is."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from service.archive.container import ArchiveFile
from service.errors import OutputFault
from service.kits.source import extract, kit_facts, write, write_light

SCRIPT = Path(__file__).resolve().parent.parent / "data" / "kits" / "blender_scene.txt"
"""The script; not named .py, as it runs in Blender and not here."""

VARIABLE = "AVATARME_BLENDER"
"""Environment variable with the path of Blender, or of a Python that has the module bpy."""

BUILD_SECONDS = 600


def write_blender_kit(source: ArchiveFile, folder: Path) -> list[Path]:
    """Everything that the script needs, and the script."""
    written = extract(source, folder, ("maps/", "mesh/head.usda", "mesh/hair.usda", "LICENSES.md"))
    light = write_light(source, folder)
    written += light
    facts = kit_facts(source) | {"environment": light[0].name if light else None}
    write(folder / "kit.json", (json.dumps(facts, indent=1) + "\n").encode())
    write(folder / "avatar_scene.py", SCRIPT.read_bytes())
    return [*written, folder / "kit.json", folder / "avatar_scene.py"]


def blender() -> list[str] | None:
    """How Blender's Python is called with a script, up to the script's path; None where there is none.

    ``AVATARME_BLENDER`` comes first, then ``blender`` of the path, then the module bpy of this Python.
    """
    named = os.environ.get(VARIABLE) or shutil.which("blender")
    if named:
        python = Path(named).name.startswith("python")
        return [named] if python else [named, "--background", "--factory-startup", "--python"]
    return [sys.executable] if find_spec("bpy") is not None else None


def build_scene(folder: Path) -> Path | None:
    """Build ``avatar.blend`` in a kit's folder by Blender; None where there is no Blender.

    Raises:
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
            [*command, str(script), *background], capture_output=True, text=True, timeout=BUILD_SECONDS, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise OutputFault(f"Blender ({command[0]}) could not build {target}: {error}", path=str(target)) from error
    if done.returncode != 0 or not target.is_file():
        said = (done.stderr or done.stdout).strip().splitlines()[-3:]
        raise OutputFault(f"Blender ({command[0]}) could not build {target}: {' | '.join(said)}", path=str(target))
    return target
