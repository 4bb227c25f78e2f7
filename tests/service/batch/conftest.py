from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from service.batch.display import Lines
from service.batch.local import LocalMaker
from service.batch.maker import Maker
from service.batch.photos import find_photos
from service.batch.report import Report
from service.batch.run import Batch, Tally


@dataclass
class Folders:
    """A folder of photos, one of archives, and runs from the one into the other."""

    photos: Path
    out: Path
    maker: Callable[[Path], Maker]
    options: dict[str, Any] = field(default_factory=dict)

    def photo(self, name: str, content: str) -> Path:
        path = self.photos / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
        return path

    def run(self, *, resume: bool = False, jobs: int = 2) -> Tally:
        work = self.out / ".work"
        photos = find_photos(self.photos, self.out)
        with Report(self.out, resume=resume) as report:
            work.mkdir(exist_ok=True)
            maker = self.maker(work)
            try:
                return Batch(photos, self.out, self.options, maker, report, Lines(len(photos))).run(jobs)
            finally:
                maker.close()

    def lines(self) -> dict[str, dict[str, Any]]:
        content = [json.loads(line) for line in (self.out / "report.jsonl").read_text().splitlines()]
        assert len({line["path"] for line in content}) == len(content), "one line a photo"
        return {line["path"]: line for line in content}

    def archives(self) -> list[str]:
        return sorted(path.relative_to(self.out).as_posix() for path in self.out.rglob("*.zip"))


@pytest.fixture
def folders(tmp_path: Path) -> Folders:
    (tmp_path / "photos").mkdir()
    maker = lambda work: LocalMaker(work, head=None, timeout_s=20, program="tests.service.batch.program")  # noqa: E731
    return Folders(tmp_path / "photos", tmp_path / "out", maker)
