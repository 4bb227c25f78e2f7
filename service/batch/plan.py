"""What is still to be made: the photos of one place, of each person together, against the archives of another.

A photo is finished where its archive is there, is not older than the photo, and was made since these options were asked
for; as ``make`` does it, no file is hashed for that. Names are compared in a database on the disk, so a plan for a
hundred thousand photos takes no more memory than one for a thousand.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import json
import os
import re
import sqlite3
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import IO, Any

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


class Plan:
    """The plan of one batch, in a database in a folder of this machine."""

    def __init__(
        self, folder: Path, source: Place, out: Place, inputs: Collection[str] = SUFFIXES, product: str = ARCHIVE
    ) -> None:
        self.source = source
        self.out = out
        self._inputs, self._product = inputs, product
        self._tables = sqlite3.connect(folder / "plan.sqlite", isolation_level=None)
        self._tables.executescript(
            """
            pragma journal_mode = off; pragma synchronous = off;
            create table photos (name blob primary key, archive blob, fold blob, modified real) without rowid;
            create table archives (name blob primary key, modified real) without rowid;
            create table lines (name blob primary key, rank blob, made integer, attempt integer, text blob)
                without rowid;
            create table tried (name blob primary key, modified real) without rowid;
            create index folds on photos (fold);
            """
        )

    def refuse(self) -> None:
        """Refuse to begin (UsageError) where there was a batch before, or an archive's name is taken."""
        if any(self.out.modified(name) is not None for name in (ASKED, REPORT)):
            raise UsageError(
                f"{self.out.address} has the report of an earlier run; --resume goes on with it", field="resume"
            )
        taken = "select p.archive from photos p join archives a on a.name = p.archive limit 1"
        for (name,) in self._tables.execute(taken):
            raise UsageError(
                f"{self.out.address} has a {os.fsdecode(name)} already; name another place, or --resume to replace it",
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
        run = self._tables.execute
        run("begin")
        for table in ("photos", "archives"):
            run(f"delete from {table}")  # noqa: S608 - our own names
        found = ((*self._names(e.name), e.modified) for e in self.source.entries(self._inputs, self.out))
        self._tables.executemany("insert into photos values (?, ?, ?, ?)", found)
        self._tell_apart()
        if own is not None:
            self._tables.create_function("part", 1, lambda name: part_of(name, own[1]), deterministic=True)
            run("delete from photos where part(name) != ?", (own[0],))
        if settled is not None:
            run("delete from photos where modified > ?", (settled,))
        there = ((os.fsencode(entry.name), entry.modified) for entry in self.out.entries({self._product}))
        self._tables.executemany("insert into archives values (?, ?)", there)
        self.gather()
        run("commit")
        return int(run("select count(*) from photos").fetchone()[0])

    def todo(self) -> Iterator[Line]:
        """Photos that are to be made, by their names: ``path``, ``archive``, ``modified``, ``attempt``.

        Those that failed in a round of this plan before are not, unless they have changed since.
        """
        rows = self._tables.execute(
            """
            select p.name, p.archive, p.modified, coalesce(l.attempt + (l.made = 0), 1) from photos p
            left join archives a on a.name = p.archive
            left join lines l on l.name = p.name
            left join tried t on t.name = p.name
            where (a.modified is null or a.modified < max(p.modified, ?) or coalesce(l.made, 0) = 0)
            and (t.modified is null or t.modified != p.modified) order by p.name
            """,
            (self._since,),
        )
        for name, archive, modified, attempt in rows:
            yield {
                "path": os.fsdecode(name), "archive": os.fsdecode(archive), "modified": modified, "attempt": attempt,
            }  # fmt: skip

    def write_shards(self, round_name: str) -> list[int]:
        """Write the manifest of a round: one file for each shard; returns how many photos each has.

        The name of a later round comes after that of an earlier one in the order of letters.
        """
        left, counts = sum(1 for _ in self.todo()), list[int]()
        photos = self.todo()
        while shard := list(itertools.islice(photos, min(SHARD, max(1, left // SHARDS)))):
            self.out.write(manifest_name(round_name, len(counts)), b"".join(map(text_of, shard)))
            counts.append(len(shard))
            left -= len(shard)
        self._tables.execute("insert or replace into tried select name, modified from photos")
        return counts

    def gather(self) -> list[str]:
        """Read all reports, the last line of a photo counts; returns the names of the reports of shards."""
        shards = sorted(name for name in self.out.names(REPORTS) if name.endswith(".jsonl"))
        for name in (REPORT, *shards):
            rank = b"" if name == REPORT else name.encode()
            rows = (
                (os.fsencode(line["path"]), rank, line.get("outcome") == "succeeded", int(line.get("attempt", 1)), text)
                for line, text in _lines(self.out, name)
            )
            self._tables.executemany(
                "insert into lines values (?, ?, ?, ?, ?) on conflict do update set rank = excluded.rank, "
                "made = excluded.made, attempt = excluded.attempt, text = excluded.text "
                "where excluded.rank >= lines.rank",
                rows,
            )
        return shards

    def merge(self, folder: Path) -> None:
        """Write ``report.jsonl`` anew, by the names of the photos; the reports of shards that are in it go.

        The folder is on the file system of the archives, where that is a disk.
        """
        self._tables.execute("begin")
        shards = self.gather()
        self._tables.execute("commit")
        part = folder / "report"
        with part.open("wb") as stream:
            stream.writelines(text for (text,) in self._tables.execute("select text from lines order by name"))
        self.out.put(part, REPORT)
        for name in shards:
            self.out.delete(name)
            self.out.delete(name.replace(REPORTS, MANIFESTS, 1))

    def failures(self, limit: int) -> Iterator[Line]:
        """Lines of the first photos that failed."""
        rows = self._tables.execute(
            "select l.text from photos p join lines l on l.name = p.name where l.made = 0 order by p.name limit ?",
            (limit,),
        )
        return (json.loads(text) for (text,) in rows)

    def outcome(self) -> tuple[int, int, int]:
        """Numbers of photos that have an archive, that failed, and of which nothing is known."""
        row = self._tables.execute(
            "select coalesce(sum(l.made), 0), coalesce(sum(l.made = 0), 0), count(*) from photos p "
            "left join lines l on l.name = p.name"
        ).fetchone()
        return int(row[0]), int(row[1]), int(row[2] - row[0] - row[1])

    def close(self) -> None:
        """Let go of the database."""
        self._tables.close()

    def _names(self, name: str) -> tuple[bytes, bytes, bytes]:
        archive = str(PurePosixPath(name).with_suffix(self._product))
        return os.fsencode(name), os.fsencode(archive), _fold(archive)

    def _tell_apart(self) -> None:
        """Give photos that differ in the suffix only their whole name and that of an archive, until all differ."""
        many = "select fold from photos group by fold having count(*) > 1"
        crowded = f"fold in ({many}) and archive != cast(name || x'{self._product.encode().hex()}' as blob)"
        while self._tables.execute(f"select 1 from photos where {crowded} limit 1").fetchone():  # noqa: S608
            rows = self._tables.execute(f"select name from photos where {crowded}").fetchall()  # noqa: S608
            longer = (
                (name + self._product.encode(), _fold(os.fsdecode(name) + self._product), name) for (name,) in rows
            )
            self._tables.executemany("update photos set archive = ?, fold = ? where name = ?", longer)


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


def _fold(archive: str) -> bytes:
    """Names that are one file for a file system without case have one fold."""
    return os.fsencode(archive.casefold())


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
