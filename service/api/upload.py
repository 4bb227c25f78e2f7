"""What a request for an avatar says beside its photo."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from service.api.options import NAMES, parse_options, query_options
from service.api.problems import ProblemError
from service.jobs.admission import PRIORITIES
from service.options import Options

PARTS = ("options", "keep_photo", "metadata", "priority", "webhook_url")
"""Parts beside the photo."""

QUERY = frozenset(PARTS) - {"options"} | NAMES
"""Parameters of the address of a photo that is the body."""


@dataclass
class Upload:
    """A request that has arrived.

    Attributes:
        path: file of the photo, in the folder of uploads.
        sha256: hex digest of the photo.
        size: bytes of the photo.
        options: the part ``options``, empty without one.
        named: options by name as text, where the photo is the body.
        keep_photo: the part ``keep_photo``.
        metadata: the part ``metadata``, empty without one.
        priority: the part ``priority``.
        webhook_url: the part ``webhook_url``, empty without one.
    """

    path: Path
    sha256: str = ""
    size: int = 0
    options: bytes = b""
    named: dict[str, str] = field(default_factory=dict)
    keep_photo: bool = False
    metadata: bytes = b""
    priority: str = "normal"
    webhook_url: str = ""

    def chosen(self) -> Options:
        """The options.

        Raises:
            ProblemError, UsageError: as ``service.api.options.parse_options``.
        """
        return query_options(self.named) if self.named else parse_options(self.options)

    def set(self, name: str, value: bytes) -> None:
        """Take a part other than the photo.

        Raises:
            ProblemError: its value is not possible.
        """
        if name == "options":
            self.options = value
        elif name == "metadata":
            self.metadata = value
        elif name == "webhook_url":
            self.webhook_url = value.decode("utf-8", "replace").strip()
        elif name == "keep_photo":
            self.keep_photo = _one_of(name, value, ("true", "false")) == "true"
        elif name == "priority":
            self.priority = _one_of(name, value, PRIORITIES)


def _one_of(name: str, value: bytes, allowed: tuple[str, ...]) -> str:
    text = value.decode("utf-8", "replace").strip().lower()
    if text not in allowed:
        *most, last = (f"'{word}'" for word in allowed)
        raise ProblemError("usage", 422, f"{name} has to be {', '.join(most)} or {last}", pointer=f"/{name}")
    return text
