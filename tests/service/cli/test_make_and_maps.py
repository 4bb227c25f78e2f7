"""The command line's plumbing, with a pipeline that answers at once; ``tests/end_to_end`` has the real one."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from service import diagnosis, errors
from service.cli.app import app
from service.cli.files import progress_bar
from service.cli.make_and_maps import destination
from service.errors import TooManyBytes, UnreadableInput, UsageError
from service.manifest import LeftOut
from service.options import Options
from service.photo.limits import Limits, read_file

ROOT = Path(__file__).parents[3]
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command in this process -> (exit status, stdout, stderr)."""

    def call(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as leaving:
            app(list(arguments), prog_name="avatarme")
        out, err = capsys.readouterr()
        return int(leaving.value.code or 0), out, err

    return call


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    (tmp_path / "me.jpg").write_bytes(b"the bytes of a photo")
    return tmp_path / "me.jpg"


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[list[bytes], Options]]:
    """Put a pipeline in place that only notes what it was asked for."""
    calls: list[tuple[list[bytes], Options]] = []
    camera = SimpleNamespace(focal_px=1.0, yaw_pitch_roll_deg=lambda: (1.0, 2.0, 3.0))

    def make_avatar(data: list[bytes], options: Options, progress: Any, *_: Any, **__: Any) -> SimpleNamespace:
        calls.append((data, options))
        progress("fit", 0.5)
        return SimpleNamespace(
            options=options.to_json(),
            fit=SimpleNamespace(landmark_rms_px=0.5, inter_ocular_px=60.0, camera=camera),
            sources=(),
            left_out=tuple(LeftOut(hashlib.sha256(one).hexdigest(), "strangers", "another person") for one in data[2:]),
            all_warnings=lambda: ("no-colour",),
            timings_s={"fit": 0.1},
        )

    def write_archive(avatar: object, target: Any) -> None:
        target.write_bytes(b"PK") if isinstance(target, Path) else target.write(b"PK")

    replace(monkeypatch, make_avatar, write_archive)
    return calls


def replace(
    monkeypatch: pytest.MonkeyPatch, make_avatar: Callable[..., Any], write_archive: Callable[..., Any]
) -> None:
    for name, attribute, function in (
        ("service.pipeline", "make_avatar", make_avatar),
        ("service.archive.pack", "write_archive", write_archive),
    ):
        module = ModuleType(name)
        setattr(module, attribute, function)
        monkeypatch.setitem(sys.modules, name, module)
    for begun in ("expect_photo", "FaceNetworks"):
        monkeypatch.setattr(f"service.cli.make_and_maps.{begun}", lambda *_: None)


def test_several_photos_are_one_avatar_and_those_left_out_are_named(
    run: Run, photo: Path, asked: list[tuple[list[bytes], Options]]
) -> None:
    others = [photo.with_name(f"{number}.jpg") for number in range(2)]
    for number, other in enumerate(others):
        other.write_bytes(b"another %d" % number)
    files = [str(photo), *map(str, others)]
    status, out, err = run("make", *files, "--leave-out", "strangers", "-o", str(photo.with_name("me.zip")))
    assert (status, out) == (0, f"{photo.with_name('me.zip')}\n")
    assert [len(data) for data, _ in asked] == [3] and asked[0][1].leave_out == "strangers"
    assert f"{others[1]} is left out: another person" in err


@pytest.mark.usefixtures("asked")
def test_memory_is_told_after_the_archive_is_written(run: Run, photo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Would break: a photo whose writing takes more memory than its making is put on a machine that is too small."""
    target = photo.with_name("me.zip")
    monkeypatch.setattr("service.cli.make_and_maps.peak_rss_mb", lambda: 900.0 if target.exists() else 500.0)
    _, out, _ = run("make", str(photo), "-o", str(target), "--json")
    assert json.loads(out)["peak_rss_mb"] == 900


def test_a_fault_of_one_of_several_photos_has_the_name_of_its_file(
    run: Run, photo: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photo.with_name("b.jpg").write_bytes(b"another")

    def make_avatar(*_: object, **__: object) -> None:
        raise errors.Strangers("it is another person", photos=[1])

    replace(monkeypatch, make_avatar, lambda *_: None)
    status, out, err = run("make", str(photo), str(photo.with_name("b.jpg")), "--json")
    assert status == 3 and json.loads(out)["error"]["files"] == [str(photo.with_name("b.jpg"))]
    assert str(photo.with_name("b.jpg")) in err


WRONG = ("--leave-out everybody", "--no-such-option", "--size 5x5", "--maps albedo", "--seed 1.5", "--face -1",
         "--fit magic", "--head no-such-head.npz")  # fmt: skip


@pytest.mark.parametrize(
    "words", ["make", "make no-such-file.jpg", "no-such-command", *(f"make a.jpg {words}" for words in WRONG)]
)
def test_usage_errors_end_with_two_and_say_nothing_on_stdout(run: Run, words: str) -> None:
    status, out, err = run(*words.split())
    assert (status, out) == (2, "")
    assert err


def terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> str:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm-256color")
    with progress_bar() as progress:
        progress("fit", -1.0)
        progress("texture", 2.0)
    out, err = capsys.readouterr()
    assert out == "", "progress belongs to stderr only"
    return err


def test_no_color_is_obeyed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    drawn = terminal(monkeypatch, capsys)
    assert "texture" in drawn
    assert "\x1b[3" not in drawn


def test_control_c_ends_with_130_and_no_archive(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "slow.jpg")
    # A shell starts background jobs with SIGINT ignored, and children inherit that: the tests may run in one.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        process = subprocess.Popen([sys.executable, "-m", "service", "make", str(tmp_path / "slow.jpg")], cwd=ROOT)
    finally:
        signal.signal(signal.SIGINT, before)
    with process, (tmp_path / "slow.jpg").open("wb"):  # opens when the program does; it waits for bytes that never come
        process.send_signal(signal.SIGINT)
        try:
            assert process.wait(20) == 130
        finally:
            process.kill()
    assert not (tmp_path / "slow.zip").exists()


AT_NUMPY = """
import os, sys

class Stop:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy":
            sys.exit("threads=" + os.environ.get("OPENBLAS_NUM_THREADS", "unset"))

sys.meta_path.insert(0, Stop())
sys.argv = ["avatarme", "make", sys.argv[1], "-o", sys.argv[2]]
from service.cli.app import main
main()
"""


@pytest.mark.parametrize(("given", "seen"), [(None, "1"), ("2", "2")])
def test_openblas_has_one_thread_before_numpy_loads(tmp_path: Path, given: str | None, seen: str) -> None:
    """Set any later it does nothing, and a fit beside a busy process takes many times as long. The caller decides."""
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    if given is not None:
        environment["OPENBLAS_NUM_THREADS"] = given
    program = [sys.executable, "-c", AT_NUMPY, str(diagnosis.SAMPLE), str(tmp_path / "out.zip")]
    stopped = subprocess.run(program, cwd=ROOT, capture_output=True, text=True, env=environment)
    assert stopped.stderr.strip().endswith(f"threads={seen}"), stopped.stderr


def test_a_named_pipe_is_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=(tmp_path / "pipe").write_bytes, args=(b"bytes",))
    writer.start()
    assert read_file(str(tmp_path / "pipe")) == b"bytes"
    writer.join()


def test_what_is_not_there_is_a_usage_error(tmp_path: Path) -> None:
    for name in (tmp_path / "no.jpg", tmp_path, tmp_path / "no" / "no.jpg"):
        with pytest.raises(UsageError, match=str(name)):
            read_file(str(name))


@pytest.mark.parametrize("name", ["a\0b.jpg", "a" * 5000 + ".jpg"])
def test_a_name_that_no_file_can_have_is_refused_in_words(name: str) -> None:
    with pytest.raises(UnreadableInput):
        read_file(name)


def test_an_endless_pipe_ends_at_the_limit_of_the_gate() -> None:
    """Without the cap this test would fill the memory and never return."""
    with pytest.raises(TooManyBytes, match=str(Limits().max_bytes)):
        read_file("/dev/zero")


def test_a_zip_is_not_poured_over_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdout", SimpleNamespace(isatty=lambda: True))
    with pytest.raises(UsageError, match="terminal"):
        destination(["me.jpg"], "-", as_json=False)


@pytest.mark.parametrize("output", ["no/such/folder/x.zip", "folder", "a" * 300 + ".zip"])
def test_an_output_that_cannot_be_written_is_refused_before_the_work(
    output: str, run: Run, photo: Path, asked: list[Any], tmp_path: Path
) -> None:
    (tmp_path / "folder").mkdir()
    target = str(tmp_path / output)
    for given in (("make", str(photo)), ("maps", "--texture", str(photo), "--mesh", str(photo))):
        status, out, err = run(*given, "-o", target)
        assert (status, out) == (1, "")
        assert "cannot write" in err and output in err
    assert not asked
    assert sorted(os.listdir(tmp_path)) == ["folder", "me.jpg"]


@pytest.mark.parametrize("output", ["me.glb", "me.PNG", "me.mp4"])
def test_an_archive_is_not_named_as_something_else(output: str) -> None:
    """A zip that was called me.glb was opened by no viewer, and nothing had said why."""
    with pytest.raises(UsageError, match=r"would not be what its name says: the archive is a \.zip"):
        destination(["me.jpg"], output, as_json=False)
    for free in ("me", "me.v2", "me.ZIP", "/dev/stdout"):
        assert destination(["me.jpg"], free, as_json=False) == free


def test_the_photo_is_not_overwritten(tmp_path: Path) -> None:
    photo = tmp_path / "me.zip"  # a JPEG by content, whatever its name says
    photo.write_bytes(b"\xff\xd8")
    (tmp_path / "link").symlink_to(photo)
    for output in (None, str(photo), str(tmp_path / "link"), f"{tmp_path}/./me.zip"):
        with pytest.raises(UsageError, match="would be overwritten"):
            destination([str(photo)], output, as_json=False)
