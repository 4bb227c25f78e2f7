from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from service.batch.driver import Tally, Wanted, run


@dataclass
class Folders:
    """A folder of photos, one of archives, and runs from the one into the other."""

    photos: Path
    out: Path
    options: dict[str, Any] = field(default_factory=dict)
    wanted: dict[str, Any] = field(default_factory=dict)
    shown: list[tuple[int, int, int]] = field(default_factory=list)

    def photo(self, name: str, content: str) -> Path:
        path = self.photos / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
        return path

    def run(self, **more: Any) -> Tally:
        standard: dict[str, Any] = {"jobs": 2, "timeout_s": 20, "program": "tests.support.toy_photo"}
        places: dict[str, Any] = {"source": str(self.photos), "out": str(self.out)}
        asked = Wanted(options=self.options, **places | standard | self.wanted | more)
        tally = run(asked, lambda made, failed, photos, seconds: self.shown.append((made, failed, photos)))
        return tally

    def lines(self) -> dict[str, dict[str, Any]]:
        content = [json.loads(line) for line in (self.out / "report.jsonl").read_text().splitlines()]
        names = [line["path"] for line in content]
        assert names == sorted(set(names)), "one line a photo, in the order of their names"
        return {line["path"]: line for line in content}

    def archives(self) -> list[str]:
        return sorted(path.relative_to(self.out).as_posix() for path in self.out.rglob("*.zip"))


@pytest.fixture
def folders(tmp_path: Path) -> Folders:
    (tmp_path / "photos").mkdir()
    return Folders(tmp_path / "photos", tmp_path / "out")
