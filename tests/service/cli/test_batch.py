from __future__ import annotations

import json
from pathlib import Path

import pytest

from service.batch.driver import on_stderr
from service.cli.app import app
from tests.service.client.fake import Fake, answer, problem


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_bytes(b"photo a")
    return tmp_path / "photos"


def run(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as leaving:
        app(["batch", *map(str, words)], prog_name="avatarme")
    out, err = capsys.readouterr()
    return int(leaving.value.code or 0), out, err


def test_options_of_make_reach_the_server(
    capsys: pytest.CaptureFixture[str], fake: Fake, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AVATARME_API_KEY", "secret")
    fake.stages.clear()
    flags = ["--maps", "texture,confidence", "--size", "1152x768", "--face", "largest", "--seed", "5", "--keep"]
    status, out, err = run(capsys, folder, tmp_path / "out", "--server", fake.url, *flags)
    assert (status, out) == (0, f"{tmp_path / 'out' / 'report.jsonl'}\n")
    assert "1 made" in err
    (job,) = fake.jobs.values()
    asked = {"maps": ["texture", "confidence"], "size": [1152, 768], "face": "largest", "seed": 5}
    assert job["options"] == asked, "what was not asked for is left to the server"
    assert fake.requests("POST")[0].headers["Authorization"] == "Bearer secret"


def test_the_address_may_come_from_the_environment(
    capsys: pytest.CaptureFixture[str], fake: Fake, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AVATARME_SERVER", fake.url)
    fake.stages.clear()
    status, _, err = run(capsys, folder, tmp_path / "out")
    assert status == 0, err
    assert len(fake.requests("POST")) == 1


def test_empty_variables_count_as_none(
    capsys: pytest.CaptureFixture[str], fake: Fake, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AVATARME_API_KEY", "")
    fake.stages.clear()
    status, _, err = run(capsys, folder, tmp_path / "out", "--server", fake.url)
    assert status == 0, err
    assert "Authorization" not in fake.requests("POST")[0].headers


def test_a_server_that_refuses_the_key_is_named(
    capsys: pytest.CaptureFixture[str], fake: Fake, folder: Path, tmp_path: Path
) -> None:
    fake.fail("POST", "avatars", answer(401, problem(401, "unauthorised", "this key is unknown")))
    status, out, err = run(capsys, folder, tmp_path / "out", "--server", fake.url, "--json")
    assert status == 1
    assert "this key is unknown; go on with --resume" in err
    assert json.loads(out)["error"]["message"] == "this key is unknown"


@pytest.mark.parametrize(
    "words",
    [
        ["photos"], ["no-such-folder", "out"], ["photos", "full"],
        *(["photos", "out", *words.split()] for words in (
            "--jobs 0", "--timeout 0", "--timeout nan", "--size 5x5", "--maps albedo", "--seed -1", "--keep",
            "--shard 3/2", "--shard all", "--shard 1/2 --watch", "--database postgresql://127.0.0.1:9/x --jobs 2",
            "--database postgresql://127.0.0.1:9/x --server http://127.0.0.1:9", "--head no-such-head.npz",
            "--server ftp://example.org", "--server http://127.0.0.1:9 --head photos/a.jpg",
        )),
    ],
)  # fmt: skip
def test_usage_errors_end_with_two(
    capsys: pytest.CaptureFixture[str], folder: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    monkeypatch.chdir(folder.parent)
    Path("full").mkdir()
    Path("full", "a.zip").write_text("somebody's")
    status, out, err = run(capsys, *words)
    assert (status, out) == (2, "")
    assert err
    assert Path("full", "a.zip").read_text() == "somebody's"


@pytest.mark.parametrize("no_color", [None, "1"])
def test_a_bar_on_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], no_color: str | None
) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    if no_color:
        monkeypatch.setenv("NO_COLOR", no_color)
    with on_stderr() as shown:
        shown(0, 0, 2, 0.0)
        shown(1, 1, 2, 60.0)
    out, err = capsys.readouterr()
    assert out == ""
    assert "2 of 2 photos, 2.0 a minute, 1 failed" in err
    assert ("\x1b[3" in err) == (no_color is None)


def test_a_wrong_key_is_told_before_anything_is_written(
    capsys: pytest.CaptureFixture[str], fake: Fake, folder: Path, tmp_path: Path
) -> None:
    """It left an empty report, for which the next run, with the right key, was refused."""
    fake.fail("GET", "avatars/0+$", answer(401, problem(401, "unauthorized", "Send a key.")))
    command = (folder, tmp_path / "out", "--server", fake.url, "--json")
    status, out, err = run(capsys, *command)
    assert (status, err) == (1, "avatarme: AVATARME_API_KEY holds no key of this server: Send a key\n")
    assert json.loads(out)["error"]["code"] == "access-denied"
    assert not fake.requests("POST")
    assert not (tmp_path / "out" / "report.jsonl").exists()
    fake.stages.clear()
    status, _, err = run(capsys, *command)
    assert status == 0, err


def test_a_refused_key_is_told_where_keys_come_from(
    capsys: pytest.CaptureFixture[str], fake: Fake, folder: Path, tmp_path: Path
) -> None:
    """All that was said was which header the server wants."""
    words = "Send a key: 'Authorization: Bearer KEY'."
    fake.fail("POST", "avatars", answer(401, problem(401, "unauthorized", words)))
    status, _, err = run(capsys, folder, tmp_path / "out", "--server", fake.url)
    assert status == 1
    assert f"avatarme: AVATARME_API_KEY holds no key of this server: {words[:-1]}; go on with --resume\n" in err
