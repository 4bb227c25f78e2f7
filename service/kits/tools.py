"""The tools that there are kits for."""

from __future__ import annotations

from service.errors import UsageError

TOOLS = ("blender", "unreal", "unity", "maya")


def known(tool: object) -> str:
    """The name of a tool.

    Raises:
        UsageError: there is no kit for it.
    """
    if not isinstance(tool, str) or tool not in TOOLS:
        raise UsageError(f"for is {tool!r:.60}; there are {', '.join(TOOLS)}", field="for")
    return tool
