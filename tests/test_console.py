"""What is printed where a terminal cannot show it, where nobody reads it, and while work goes on."""

import errno
import json
import os
import subprocess
import sys
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import pytest

from nnql_bullet.cli import console
from nnql_bullet.cli.console import ESTIMATE_AFTER, PIECES, _TimeLeft, printable
from nnql_bullet.errors import UserError
from nnql_bullet.files import write_atomically
from nnql_bullet.work import Progress

ROOT = Path(__file__).resolve().parents[1]
DRIVE = "drive straight --world cover_10 --sim kinematic --json"


@pytest.mark.parametrize(
    ("text", "encoding", "shown"),
    [
        ("aus ü", "utf-8", "aus ü"),
        ("aus ü", "ascii", r"aus \xfc"),
        ("lat\udcfc", "utf-8", r"lat\udcfc"),
        ("red\x1b[31m\rgone\x07", "utf-8", r"red\x1b[31m\rgone\x07"),
        ("two\nlines", "ascii", "two\nlines"),
        ("[bold]:car:", "utf-8", "[bold]:car:"),
    ],
)
def test_what_cannot_be_shown_is_escaped(text: str, encoding: str, shown: str) -> None:
    assert printable(text, encoding) == shown


def in_a_shell(command: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    line = command.replace("nnql-bullet", f"'{sys.executable}' -m nnql_bullet")
    known = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    return subprocess.run(["bash", "-c", line], cwd=folder, env=known, capture_output=True, timeout=120)


def test_closed_standard_error_does_not_lose_json(tmp_path: Path) -> None:
    done = in_a_shell(f"nnql-bullet {DRIVE} --out out 2>&-", tmp_path)
    assert done.returncode == 0
    assert json.loads(done.stdout)["world"] == "cover_10"


@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-"])
def test_closed_streams_are_no_hindrance(tmp_path: Path, closed: str) -> None:
    assert in_a_shell(f"nnql-bullet {DRIVE} --out out {closed}", tmp_path).returncode == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"trajectory.npz", "trajectory.png"}
    assert in_a_shell(f"nnql-bullet drive --help {closed}", tmp_path).returncode == 0


class _Broken(StringIO):
    def __init__(self, number: int) -> None:
        super().__init__()
        self._error = OSError(number, os.strerror(number))

    def flush(self) -> None:
        raise self._error


class TestBrokenStreams:
    @pytest.fixture
    def broken(self, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, int], None]:
        return lambda name, number: monkeypatch.setattr(console, name, console._Stream(file=_Broken(number)))

    def test_a_full_standard_output_is_named(self, broken: Callable[[str, int], None]) -> None:
        broken("out", errno.ENOSPC)
        with pytest.raises(UserError, match=r"^standard output: No space left on device; "):
            console.say("result")

    def test_messages_that_find_no_room_end_no_work(self, broken: Callable[[str, int], None]) -> None:
        broken("err", errno.ENOSPC)
        console.tell("drawing 1/2")

    @pytest.mark.parametrize("number", [errno.EPIPE, errno.EIO])
    def test_unread_ones_are_not_taken_for_an_error_of_the_file_that_is_written(
        self, broken: Callable[[str, int], None], tmp_path: Path, number: int
    ) -> None:
        broken("err", number)
        with pytest.raises(BrokenPipeError):
            write_atomically(tmp_path / "film.mp4", lambda _: console.tell("drawing 1/2"))
        assert list(tmp_path.iterdir()) == []


def test_an_ascii_terminal_is_no_hindrance(tmp_path: Path) -> None:
    done = in_a_shell(f"nnql-bullet {DRIVE.replace(' --json', '')} --out 'aus ü'", tmp_path, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, b"")
    assert rb"aus \xfc/trajectory.npz" in done.stdout


class TestTimeLeft:
    @pytest.fixture
    def at(self, monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
        return lambda time: monkeypatch.setattr(console, "monotonic", lambda: time)

    def test_a_slow_start_does_not_count(self, at: Callable[[float], None]) -> None:
        """The first frame of a film takes 10 s, in which processes start, and each other one 0.6 s."""
        left, said = _TimeLeft(), []
        for done in range(101):
            at(0.0 if done == 0 else 10.0 + 0.6 * (done - 1))
            said.append(left(Progress("film", done, 100)))
        assert not any(said[: PIECES + 1])
        assert said[11] == "0:00:53 left"  # 89 frames of 0.6 s
        assert said[-1] == "0:00:00 left"

    def test_nothing_is_said_of_what_is_quick(self, at: Callable[[float], None]) -> None:
        left = _TimeLeft()
        for done in range(100):
            at(done * 0.9 * ESTIMATE_AFTER / 100)
            assert left(Progress("quick", done, 100)) == ""

    def test_what_was_done_before_does_not_count(self, at: Callable[[float], None]) -> None:
        left = _TimeLeft()
        for number in range(20):
            at(float(number))
            said = left(Progress("resumed", 500 + number, 1000))
        assert said == "0:08:01 left"  # 481 episodes of 1 s
