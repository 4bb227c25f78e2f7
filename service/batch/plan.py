"""What is still to be made: the photos of one place, of each person together, against the archives of another.

A photo is finished where its archive is there, is not older than the photo, and was made since these options were asked
for; as ``make`` does it, no file is hashed for that.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import json
import os
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import IO, Any, NamedTuple

from service.errors import UsageError
from service.photo.bundle import MOST, bundled
from service.places import Entry, Place, place

SUFFIXES = frozenset({".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".webp", ".heic", ".heif"})
"""Files that count as photos. What they really are, their first bytes decide later."""

ARCHIVE = ".zip"
"""End of the name of what is made of a photo."""

STATE = ".batch"
"""Folder among the archives for what is asked for, manifests and reports of shards."""

ASKED = f"{STATE}/batch.json"
"""What was asked for; what is older than this file was made with other options."""

MANIFESTS, REPORTS = f"{STATE}/photos", f"{STATE}/reports"
REPORT = "report.jsonl"

SHARD = 100
"""Most photos of a shard."""

SHARDS = 256
"""Shards that the photos that are left would give at least, if all were as large as the next one.

So shards are the smaller the fewer are left, up to this many workers have work from the first, and all have until the
end: guided self-scheduling (Polychronopoulos and Kuck 1987).
"""

SETTLED_S = 5.0
"""Age that a new photo has to have when a folder is watched: it may still be on its way into it."""

Line = dict[str, Any]
"""What became of one photo; :func:`service.batch.shards.report_line` has the members."""


class _Said(NamedTuple):
    """The last line of a photo: name of the report ("" for the merged one), whether it is made, attempts, text."""

    report: str
    made: bool
    attempt: int
    text: bytes


class Plan:
    """The plan of one batch."""

    def __init__(self, source: Place, out: Place, inputs: Collection[str] = SUFFIXES, product: str = ARCHIVE) -> None:
        self.source = source
        self.out = out
        self._inputs, self._product = inputs, product
        self._photos: dict[str, tuple[str, float]] = {}  # name -> archive, and when it was written
        self._archives: dict[str, float] = {}
        self._said: dict[str, _Said] = {}
        self._tried: dict[str, float] = {}
        self._since = 0.0

    def refuse(self) -> None:
        """Refuse to begin (UsageError) where there was a batch before, or an archive's name is taken."""
        if any(self.out.modified(name) is not None for name in (ASKED, REPORT)):
            raise UsageError(
                f"{self.out.address} has the report of an earlier run; --resume goes on with it", field="resume"
            )
        for archive, _ in self._photos.values():
            if archive in self._archives:
                raise UsageError(
                    f"{self.out.address} has a {archive} already; name another place, or --resume to replace it",
                    field="out",
                )

    def ask(self, options: Mapping[str, Any]) -> None:
        """Write down what is asked for; with the same options as before, what was made before counts."""
        content = json.dumps({"source": self.source.address, "options": options}, sort_keys=True).encode()
        if not self.out.exists(ASKED) or self.out.read(ASKED) != content:
            self.out.write(ASKED, content)
        self._since = self.out.modified(ASKED) or 0.0

    def look(self, *, own: tuple[int, int] | None = None, settled: float | None = None) -> int:
        """List photos, archives and reports anew; returns the number of photos.

        ``own`` (K, N) takes only every N-th photo, by its name, the K-th part of them; ``settled`` only those that were
        written before this time, seconds since 1970.
        """
        written = {entry.name: entry.modified for entry in self.source.entries(self._inputs, self.out)}
        self._photos = {
            name: (archive, written[name])
            for name, archive in named_apart(written, self._product).items()
            if (own is None or part_of(os.fsencode(name), own[1]) == own[0])
            and (settled is None or written[name] <= settled)
        }
        self._archives = {entry.name: entry.modified for entry in self.out.entries({self._product})}
        self.gather()
        return len(self._photos)

    def todo(self) -> Iterator[Line]:
        """Photos that are to be made, by their names: ``path``, ``archive``, ``modified``, ``attempt``.

        Those that failed in a round of this plan before are not, unless they have changed since.
        """
        for name, (archive, modified) in sorted(self._photos.items(), key=lambda one: os.fsencode(one[0])):
            said = self._said.get(name) or _Said("", made=False, attempt=0, text=b"")
            finished = said.made and self._archives.get(archive, -1.0) >= max(modified, self._since)
            if not finished and self._tried.get(name) != modified:
                attempt = said.attempt + (not said.made)
                yield {"path": name, "archive": archive, "modified": modified, "attempt": attempt}

    def write_shards(self, round_name: str) -> list[int]:
        """Write the manifest of a round: one file for each shard; returns how many photos each has.

        The name of a later round comes after that of an earlier one in the order of letters.
        """
        photos, counts = list(self.todo()), list[int]()
        while photos:
            shard = photos[: min(SHARD, max(1, len(photos) // SHARDS))]
            self.out.write(manifest_name(round_name, len(counts)), b"".join(map(text_of, shard)))
            counts.append(len(shard))
            del photos[: len(shard)]
        self._tried |= {name: modified for name, (_, modified) in self._photos.items()}
        return counts

    def gather(self) -> list[str]:
        """Read all reports, the last line of a photo counts; returns the names of the reports of shards."""
        shards = sorted(name for name in self.out.names(REPORTS) if name.endswith(".jsonl"))
        for report in (REPORT, *shards):
            rank = "" if report == REPORT else report
            for line, text in _lines(self.out, report):
                known = self._said.get(line["path"])
                if known is None or rank >= known.report:
                    made = line.get("outcome") == "succeeded"
                    self._said[line["path"]] = _Said(rank, made, int(line.get("attempt", 1)), text)
        return shards

    def merge(self, folder: Path) -> None:
        """Write ``report.jsonl`` anew, by the names of the photos; the reports of shards that are in it go.

        The folder is on the file system of the archives, where that is a disk.
        """
        shards = self.gather()
        part = folder / "report"
        with part.open("wb") as stream:
            stream.writelines(self._said[name].text for name in sorted(self._said, key=os.fsencode))
        self.out.put(part, REPORT)
        for name in shards:
            self.out.delete(name)
            self.out.delete(name.replace(REPORTS, MANIFESTS, 1))

    def failures(self, limit: int) -> list[Line]:
        """Lines of the first photos that failed."""
        names = (name for name in sorted(self._photos, key=os.fsencode) if name in self._said)
        failed = (self._said[name].text for name in names if not self._said[name].made)
        return [json.loads(text) for text in itertools.islice(failed, limit)]

    def outcome(self) -> tuple[int, int, int]:
        """Numbers of photos that have an archive, that failed, and of which nothing is known."""
        said = [self._said[name].made for name in self._photos if name in self._said]
        return sum(said), len(said) - sum(said), len(self._photos) - len(said)


def named_apart(names: Collection[str], product: str) -> dict[str, str]:
    """Photo -> archive. Photos that differ in the suffix only have their whole name and that of an archive, until all
    differ, also for a file system without case.
    """
    archives = {name: str(PurePosixPath(name).with_suffix(product)) for name in names}
    while True:
        folds = Counter(archive.casefold() for archive in archives.values())
        crowded = [name for name, one in archives.items() if folds[one.casefold()] > 1 and one != name + product]
        if not crowded:
            return archives
        archives |= {name: name + product for name in crowded}


def part_of(name: bytes, count: int) -> int:
    """Which of ``count`` parts a photo belongs to, from 1: by its name, so that all machines agree without a word."""
    return int.from_bytes(hashlib.sha256(name).digest()[:8], "big") % count + 1


def manifest_name(round_name: str, number: int) -> str:
    """Where the photos of a shard are listed."""
    return f"{MANIFESTS}/{round_name}-{number:06d}.jsonl"


def report_name(round_name: str, number: int) -> str:
    """Where a shard is reported."""
    return f"{REPORTS}/{round_name}-{number:06d}.jsonl"


def text_of(line: Line) -> bytes:
    """One line of a report or manifest; ASCII, as a file name need not be text."""
    return json.dumps(line).encode() + b"\n"


def read_lines(where: Place, name: str) -> Iterator[Line]:
    """The lines of a report or manifest; what is none (the end of one that was cut off) is left out."""
    return (line for line, _ in _lines(where, name))


def _lines(where: Place, name: str) -> Iterator[tuple[Line, bytes]]:
    try:
        stream = where.open(name)
    except FileNotFoundError:
        return
    with stream:
        for text in stream:
            try:
                line = json.loads(text)
            except (ValueError, RecursionError):
                continue
            if isinstance(line, dict) and isinstance(line.get("path"), str):
                yield line, text.rstrip(b"\n") + b"\n"


GROUPS = ("folder", "prefix")
"""How photos of one person are told: they lie in one folder, or their names have the same beginning before the last
``-`` or ``_``."""
GROUP = ".photos"
"""End of the name of a group, which gives way to that of its archive."""


def grouped(address: str, by: str | None) -> str:
    """The address of a place whose photos are taken together by person; itself where ``by`` is None.

    UsageError: ``by`` is no way to tell.
    """
    if by is None:
        return address
    if by not in GROUPS:
        raise UsageError(f"group-by is {by!r}; it has to be {' or '.join(GROUPS)}", field="group_by")
    return f"by-{by}:{address if '://' in address else Path(address).absolute()}"


def photos_at(address: str) -> Place:
    """The place of an address, in groups where it is one of :func:`grouped`; raises as :func:`service.places.place`."""
    for by in GROUPS:
        if address.startswith(f"by-{by}:"):
            return Grouped(place(address.partition(":")[2]), by)
    return place(address)


class Grouped(Place):
    """Photos of another place, all of one person as one file (``service.photo.bundle``); it is only read.

    A group is called like its folder, or its beginning; a photo that lies in no folder is one by itself.
    """

    def __init__(self, inner: Place, by: str) -> None:
        self._inner, self._by = inner, by
        self.address, self.folder = grouped(inner.address, by), None
        self._groups: dict[str, list[Entry]] = {}

    @property
    def missing(self) -> bool:
        """Whether the photos should lie in a folder of this machine that is not there."""
        return self._inner.folder is not None and not self._inner.folder.is_dir()

    def entries(self, suffixes: Collection[str], leave_out: Place | None = None) -> Iterator[Entry]:
        """See ``Place``; the suffixes are those of the photos."""
        self._groups = {}
        for entry in self._inner.entries(suffixes, leave_out):
            self._groups.setdefault(self._group(PurePosixPath(entry.name)), []).append(entry)
        for name, members in self._groups.items():
            yield Entry(name, max(entry.modified for entry in members))

    def _group(self, name: PurePosixPath) -> str:
        if self._by == "folder":
            return f"{name.parent}{GROUP}" if name.parent.parts else f"{name.stem}{GROUP}"
        stem = re.sub(r"[-_][^-_]*$", "", name.stem)
        return str(name.with_name((stem or name.stem) + GROUP))

    def open(self, name: str) -> IO[bytes]:
        """See ``Place``; UsageError where the group has more photos than are taken of one person."""
        if name not in self._groups:
            list(self.entries(SUFFIXES))
        members = sorted(entry.name for entry in self._groups.get(name, ()))
        if not members:
            raise FileNotFoundError(name)
        if len(members) > MOST:
            raise UsageError(f"{name.removesuffix(GROUP)} has {len(members)} photos; at most {MOST} of one person")
        return io.BytesIO(bundled([self._inner.read(one) for one in members]))

    def modified(self, name: str) -> float | None:
        """See ``Place``."""
        return max((entry.modified for entry in self._groups.get(name, ())), default=None)
