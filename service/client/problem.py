"""Problem objects of RFC 9457."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

_LONGEST_TEXT = 2000


@dataclass(frozen=True)
class Problem:
    """One problem object.

    Attributes:
        status: HTTP status.
        title: what kind of fault, in words.
        type: URI reference of the kind; its last segment is the stable code.
        detail: what was wrong this time.
        extensions: further members, for example the boxes of several faces.
    """

    status: int
    title: str = ""
    type: str = "about:blank"
    detail: str = ""
    extensions: Mapping[str, Any] = field(default_factory=dict)

    @property
    def code(self) -> str:
        """Stable code for machines: the member ``code``, else the last segment of ``type``, else the status."""
        code = self.extensions.get("code")
        if isinstance(code, str) and code:
            return code
        segment = re.split(r"[/#:]", self.type.rstrip("/#"))[-1]
        return segment if segment and self.type != "about:blank" else f"http-{self.status}"

    @property
    def message(self) -> str:
        """A sentence for people."""
        return self.detail or self.title or f"the server answered with status {self.status}"

    @classmethod
    def parse(cls, content: object, status: int) -> Problem:
        """Read a problem object as leniently as RFC 9457, section 3.1, asks: members of a wrong type are ignored.

        Args:
            content: decoded JSON.
            status: what counts where the object has no status of its own.
        """
        if not isinstance(content, Mapping):
            return cls(status)
        known = {
            name: str(content[name])[:_LONGEST_TEXT] for name in ("title", "type", "detail") if _text(content, name)
        }
        own = content.get("status")
        own_status = own if isinstance(own, int) and not isinstance(own, bool) and 100 <= own <= 599 else status
        rest = {str(name): value for name, value in content.items() if name not in (*known, "status", "instance")}
        return cls(own_status, extensions=rest, **known)


def _text(content: Mapping[str, Any], name: str) -> bool:
    return isinstance(content.get(name), str)
