"""Keys come and go without a restart, the first one is made, and a server that others reach needs some."""

from __future__ import annotations

import json
import stat
from pathlib import Path

import pytest

from service.api import keys
from service.api.keys import Keys, check_exposed, make_first_key, new_key
from service.api.server import serve
from service.errors import UsageError
from service.jobs.settings import Settings

EVERYWHERE = "0.0.0.0"  # noqa: S104 - what it is about


def bearer(key: str) -> dict[str, str]:
    return {"authorization": f"Bearer {key}"}


@pytest.fixture(autouse=True)
def _looks_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keys, "LOOK_S", 0.0)


def test_keys_come_and_go_without_a_restart(tmp_path: Path) -> None:
    file = tmp_path / "keys.json"
    (old, first), (new, second) = new_key("ada"), new_key("ada")
    file.write_text(json.dumps({"keys": [first]}))
    known = Keys(str(file))
    assert known.tenant(bearer(old)) and not known.tenant(bearer(new))
    file.write_text(json.dumps({"keys": [first, second]}))
    assert {known.tenant(bearer(key)).name for key in (old, new)} == {"ada"}  # type: ignore[union-attr]
    replaced = tmp_path / "next.json"
    replaced.write_text(json.dumps({"keys": [second]}))
    replaced.replace(file)
    assert known.tenant(bearer(new)) and not known.tenant(bearer(old))


@pytest.mark.parametrize("text", ["", "{", '{"keys": []}', None])
def test_a_file_that_turns_bad_locks_nobody_out_and_lets_nobody_in(tmp_path: Path, text: str | None) -> None:
    file = tmp_path / "keys.json"
    key, entry = new_key("ada")
    file.write_text(json.dumps({"keys": [entry]}))
    known = Keys(str(file))
    if text is None:
        file.unlink()
    else:
        file.write_text(text)
    assert known.tenant(bearer(key))
    assert known.tenant({}) is None
    assert known


def test_the_first_key_is_made_once(tmp_path: Path) -> None:
    file = tmp_path / "data" / "keys.json"
    told = make_first_key(file)
    assert told is not None
    key = told.read_text().strip()
    assert Keys(str(file)).tenant(bearer(key))
    assert key not in file.read_text()
    assert all(stat.S_IMODE(path.stat().st_mode) == 0o600 for path in (file, told))
    before = file.read_text()
    assert make_first_key(file) is None
    assert file.read_text() == before


def test_a_server_that_others_reach_needs_keys(tmp_path: Path) -> None:
    check_exposed(EVERYWHERE, "", anybody=True)
    with pytest.raises(UsageError, match="--anybody"):
        serve(Settings(host=EVERYWHERE, data=tmp_path))
