"""The contract of every verb: its exit codes, and what goes to which stream."""

import functools
import json
import os
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

import pytest

import nnql_bullet as nb
from nnql_bullet.cli import main
from nnql_bullet.cli.parser import VERBS
from nnql_bullet.errors import UserError, WorkerDied, WorkFailed

Cli = Callable[..., tuple[int, str, str]]

NEEDED = dict.fromkeys(("render", "view", "evaluate", "failures", "gap", "report", "robot", "sweep"), ("what",)) | {
    "worlds": ("list",),
    "barn": ("what", "what"),
    "export": ("what", "--to", "c"),
}
"""Arguments without which a verb is not called."""
RAISED = {
    "bad input": (UserError("no such thing"), 2),
    "a piece that fails": (WorkFailed("driving, piece 1 of 2"), 1),
    "a dead worker": (WorkerDied("worker 1 of 2 died"), 1),
    "a full disk": (OSError(28, "No space left on device", "file"), 2),
    "Ctrl-C": (KeyboardInterrupt(), 130),
    "no reader": (BrokenPipeError(), 141),
}


@pytest.mark.parametrize("verb", VERBS)
class TestEveryVerb:
    def test_help_is_printed(self, run_cli: Cli, verb: str) -> None:
        code, out, err = run_cli(verb, "--help")
        assert (code, err) == (0, "")
        assert out

    def test_a_wrong_flag_is_refused_in_one_line(self, run_cli: Cli, verb: str) -> None:
        code, out, err = run_cli(verb, *NEEDED.get(verb, ()), "--no-such-flag")
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert "--no-such-flag" in err

    @pytest.mark.parametrize("what", RAISED)
    def test_what_goes_wrong_has_its_code_and_nothing_on_standard_output(
        self, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, verb: str, what: str
    ) -> None:
        error, code = RAISED[what]
        module = import_module(f"nnql_bullet.cli.{verb}")

        @functools.wraps(getattr(module, verb))
        def fails(*_: Any, **__: Any) -> NoReturn:
            raise error

        monkeypatch.setattr(module, verb, fails)
        monkeypatch.setattr("nnql_bullet.cli.parser.give_up_output", lambda: 141)  # it would close pytest's own
        assert main([verb, *NEEDED.get(verb, ())]) == code
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == (0 if what == "no reader" else 1)


class TestJson:
    @pytest.mark.parametrize("verb", ["drive", "evaluate"])
    def test_it_is_all_that_standard_output_holds(self, run_cli: Cli, tmp_path: Path, verb: str) -> None:
        some = ("--worlds", 2, "--cover", 20, "--workers", 1) if verb == "evaluate" else ()
        code, out, _ = run_cli(verb, "straight", "--sim", "kinematic", *some, "--out", tmp_path / "out", "--json")
        assert code == 0
        assert isinstance(json.loads(out), dict)

    def test_so_it_is_of_robots_and_worlds(
        self, run_cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, small_world: Path
    ) -> None:
        monkeypatch.chdir(tmp_path)
        Path("maps").mkdir()
        answers = [
            run_cli(*words, "--json")
            for words in (
                ("robot", nb.Vehicle.load("tricycle").urdf, "--write", "mine.toml"),
                ("worlds", "list"),
                ("worlds", "show", small_world, "--out", "small.png"),
                ("worlds", "export", small_world, "--out", "maps/small.world"),
                ("worlds", "import", "maps/small.world", "--out", "small.toml"),
                ("worlds", "import", "maps", "--out", "all"),
            )
        ]
        assert [code for code, *_ in answers] == [0] * 6
        robot, _, shown, exported, imported, every = (json.loads(out) for _, out, _ in answers)
        assert robot["track"] == pytest.approx(0.6)
        assert exported["files"] == ["maps/small.world"]
        assert shown["boxes"] == imported["boxes"] == every[0]["boxes"]

    @pytest.mark.parametrize(
        "words",
        [
            ("barn", "no/folder", "straight"),
            ("drive", "nobody"),
            ("evaluate", "nobody"),
            ("robot", "no.urdf"),
            ("worlds", "show", "no"),
        ],
        ids=lambda words: words[0],
    )
    def test_there_is_none_of_what_is_refused(self, run_cli: Cli, words: tuple[str, ...]) -> None:
        code, out, err = run_cli(*words, "--json")
        assert (code, out, err.count("\n")) == (2, "", 1)


def test_a_reader_that_goes_away_ends_a_verb_quietly() -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "wb") as pipe:
        command = [sys.executable, "-m", "nnql_bullet", "keys"]
        done = subprocess.run(command, stdout=pipe, stderr=subprocess.PIPE, timeout=120)
    assert (done.returncode, done.stderr) == (141, b"")
