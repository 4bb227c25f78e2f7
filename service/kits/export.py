"""``avatarme export``: a kit for a tool."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.errors import OutputFault, UsageError

TOOLS = ("blender", "unreal", "unity", "maya")


def known_tool(tool: object) -> str:
    """The name of a tool.

    Raises:
        UsageError: there is no kit for it.
    """
    if not isinstance(tool, str) or tool not in TOOLS:
        raise UsageError(f"for is {tool!r:.60}; there are {', '.join(TOOLS)}", field="for")
    return tool


@dataclass(frozen=True)
class Kit:
    """What was written.

    Attributes:
        folder: of the kit.
        files: all of it.
        scene: ``avatar.blend``; None where it is not for Blender, or Blender is not installed.
    """

    folder: Path
    files: tuple[Path, ...]
    scene: Path | None

    def facts(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "folder": str(self.folder),
            "files": [str(path.relative_to(self.folder)) for path in self.files],
            "bytes": sum(path.stat().st_size for path in self.files),
            "scene": None if self.scene is None else str(self.scene),
        }


def export_kit(archive: Path, tool: str, folder: Path) -> Kit:
    """Write the kit of an archive for a tool into a folder, which is made.

    Raises:
        UsageError: no such tool or archive, or the folder holds other things.
        BadArchive: the archive cannot be used.
        OutputFault: a file could not be written, or Blender could not build the scene.
    """
    from service.kits import blender, engines
    from service.kits.source import opened

    known_tool(tool)
    source = opened(archive)
    if folder.exists() and not folder.is_dir():
        raise OutputFault(f"cannot write {folder}: it is no folder", path=str(folder))
    if folder.is_dir() and any(folder.iterdir()) and not (folder / "kit.json").is_file():
        raise UsageError(f"the folder {folder} holds other files; name a new one with -o", field="output")
    if tool != "blender":
        return Kit(folder, tuple(engines.write_engine_kit(source, folder, tool)), None)
    files = blender.write_blender_kit(source, folder)
    scene = blender.build_scene(folder)
    return Kit(folder, (*files, *([scene] if scene else [])), scene)
