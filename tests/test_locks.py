"""Folders that two processes want at once, and what dead processes leave."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from unittest.mock import Mock

import pytest

import nnql_bullet as nb
from nnql_bullet.errors import UserError
from nnql_bullet.files import staged, sweep, write_text
from nnql_bullet.locks import locked

HOLD = """
import sys, time
from pathlib import Path
from nnql_bullet.files import temporary_folder
from nnql_bullet.locks import locked
with locked(Path(sys.argv[1])), temporary_folder(Path(sys.argv[1])) as folder:
    (folder / "half.mp4").write_text("half")
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path: Path):
    """Another process that holds the lock of `tmp_path` and writes there."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def test_the_second_process_is_told_who_holds_the_folder(holder: subprocess.Popen[str], tmp_path: Path) -> None:
    before = sorted(tmp_path.iterdir())
    with pytest.raises(UserError) as caught, locked(tmp_path):
        pass
    expected = rf"{tmp_path}: is in use by process {holder.pid} on \S+ since \d{{4}}-\d\d-\d\d \d\d:\d\d:\d\d; wait"
    assert caught.match(expected)
    assert sorted(tmp_path.iterdir()) == before


def test_a_link_in_place_of_the_lock_is_refused_and_what_it_leads_to_is_kept(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("precious")
    (tmp_path / ".lock").symlink_to(precious)
    with pytest.raises(UserError, match="is a symbolic link"), locked(tmp_path):
        pass
    assert precious.read_text() == "precious"


def test_the_lock_of_a_dead_process_is_taken_over_and_its_temporary_files_go(
    holder: subprocess.Popen[str], tmp_path: Path
) -> None:
    sweep(tmp_path)
    assert len(list(tmp_path.iterdir())) == 2  # a living process keeps its own
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    with locked(tmp_path):
        assert [path.name for path in tmp_path.iterdir()] == [".lock"]
        assert f"process {os.getpid()} on" in (tmp_path / ".lock").read_text()
    assert list(tmp_path.iterdir()) == []


def test_a_writer_removes_what_a_dead_one_left(holder: subprocess.Popen[str], tmp_path: Path) -> None:
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    write_text(tmp_path / "a.txt", "a")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".lock", "a.txt"]


def test_threads_exclude_each_other_too(tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(UserError, match="is in use"), locked(tmp_path):
        pass


@pytest.mark.parametrize("verb", [["train", "--out"], ["train", "--overwrite", "--out"]])
def test_a_run_folder_in_use_is_refused_in_one_line(
    holder: subprocess.Popen[str], run_cli: Callable[..., tuple[int, str, str]], tmp_path: Path, verb: list[str]
) -> None:
    code, _, err = run_cli(*verb, tmp_path, "--sim", "kinematic", "--vehicles", 2, "--episodes", 2)
    assert code == 2
    assert f"is in use by process {holder.pid}" in err
    assert err.count("\n") == 1


def test_a_gap_is_measured_in_a_folder_of_its_own_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nnql_bullet.api.gap.run_all", Mock(side_effect=AssertionError))
    with locked(tmp_path), pytest.raises(UserError, match="is in use"):
        nb.gap("straight", world="empty", n_worlds=1, physics="fast", out=tmp_path)


class TestStaged:
    def test_files_take_the_place_of_older_ones_together(self, tmp_path: Path) -> None:
        (tmp_path / "sub").mkdir()
        for name in ("sub/old.png", "results.json", "mine.txt"):
            (tmp_path / name).write_text("old")
        with staged(tmp_path, "results.json", ["sub/*.png"]) as stage:
            (stage / "sub").mkdir()
            (stage / "sub" / "new.png").write_text("new")
            (stage / "results.json").write_text("new")
            assert (tmp_path / "sub/old.png").exists()
        found = {str(path.relative_to(tmp_path)): path.read_text() for path in tmp_path.rglob("*") if path.is_file()}
        assert found == {"sub/new.png": "new", "results.json": "new", "mine.txt": "old"}

    def test_after_an_error_the_older_ones_are_there(self, tmp_path: Path) -> None:
        (tmp_path / "results.json").write_text("old")
        with pytest.raises(OSError, match="full") as caught, staged(tmp_path, "results.json", ["*"]) as stage:
            (stage / "results.json").write_text("new")
            raise OSError(28, "full", str(stage / "other"))
        assert caught.value.filename == str(tmp_path)
        assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]
