"""Run folders: going on bit for bit, and nothing lost, overwritten or half written."""

import csv
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from nnql_bullet.config import read_toml, write_toml
from nnql_bullet.runs import Run
from nnql_bullet.sim.bullet import BulletEngine

Cli = Callable[..., tuple[int, str, str]]
Snapshot = Callable[[Path], dict[str, bytes]]

UNDER_WAY = "under_way/"
"""What begins like this in a checkpoint is not learned: it says where a training has come to."""

FILES = {"checkpoint.safetensors", "config.toml", "episodes.csv", "learning_curve.png", "policy.safetensors"}
FILES |= {"README.md", "made_by.json", "sources.json"}  # the second as the world is a file


def weights(folder: Path, name: str = "checkpoint.safetensors") -> dict[str, NDArray[np.float64]]:
    return load_file(folder / name)


def same_weights(first: dict[str, NDArray[np.float64]], second: dict[str, NDArray[np.float64]]) -> bool:
    return first.keys() == second.keys() and all(np.array_equal(first[name], second[name]) for name in first)


def learned(arrays: dict[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """The arrays of a checkpoint that a policy has too."""
    return {name: values for name, values in arrays.items() if not name.startswith(UNDER_WAY)}


def metadata(path: Path) -> dict[str, str]:
    with safe_open(path, framework="numpy") as file:
        return dict(json.loads(file.metadata()["nnql-bullet"]))


def change_arrays(
    path: Path, change: Callable[[dict[str, NDArray[np.float64]]], dict[str, NDArray[np.float64]]]
) -> None:
    """Rewrites a safetensors file with other arrays and the same metadata."""
    about = metadata(path)
    save_file(change(load_file(path)), path, about)  # in the format of version 0.1, which is still read


def episodes(folder: Path) -> int:
    return len((folder / "episodes.csv").read_text().splitlines()) - 1


@pytest.fixture
def train(run_cli: Cli, small_config: Path) -> Callable[..., tuple[int, str, str]]:
    """Trains in the small world, as the tiny run was."""

    def run(folder: Path, count: int, *more: object) -> tuple[int, str, str]:
        return run_cli("train", "--config", small_config, "--episodes", count, "--out", folder, *more)

    return run


@pytest.fixture
def copy(tiny_run: Path, tmp_path: Path) -> Path:
    """The tiny run, to be changed."""
    return Path(shutil.copytree(tiny_run, tmp_path / "copy"))


def refused(answer: tuple[int, str, str]) -> str:
    """The one line that a refusal consists of."""
    code, out, err = answer
    assert code == 2
    assert out == ""
    assert err.startswith("nnql-bullet: ")
    assert err.count("\n") == 1
    return err


class TestFolder:
    def test_a_run_leaves_its_files(self, tiny_run: Path) -> None:
        assert {path.name for path in tiny_run.iterdir()} == FILES
        assert episodes(tiny_run) == 12

    def test_the_policy_is_what_of_the_checkpoint_is_learned(self, tiny_run: Path) -> None:
        checkpoint, policy = weights(tiny_run), weights(tiny_run, "policy.safetensors")
        assert policy.keys() == {"0.weight", "0.bias", "2.weight", "2.bias"}
        assert same_weights(learned(checkpoint), policy)
        assert checkpoint.keys() > policy.keys()  # the rest is what is under way

    def test_episodes_are_counted_and_their_terms_sum_to_the_return(self, tiny_run: Path) -> None:
        with (tiny_run / "episodes.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert [int(row["episode"]) for row in rows] == list(range(12))
        assert len({row["world_seed"] for row in rows}) == 12
        terms = ("non_safe_to_safe", "safe_to_non_safe", "closer", "away", "winning", "failure")
        for row in rows:
            assert row["ending"] in ("goal", "collision", "timeout", "stuck")
            assert float(row["return"]) == pytest.approx(sum(float(row[term]) for term in terms))
            assert int(row["world_seed"]) >= 1_000_000
            assert (float(row["clearance"]) == 0.0) is (row["ending"] == "collision")

    def test_the_seed_decides(self, train: Callable[..., tuple[int, str, str]], tmp_path: Path) -> None:
        for folder, seed in (("a", 1), ("b", 1), ("c", 2)):
            assert train(tmp_path / folder, 3, "--seed", seed)[0] == 0
        first, same, other = ((tmp_path / folder / "episodes.csv").read_bytes() for folder in "abc")
        assert first == same != other
        assert same_weights(weights(tmp_path / "a"), weights(tmp_path / "b"))
        assert not same_weights(learned(weights(tmp_path / "a")), learned(weights(tmp_path / "c")))


class TestResume:
    def test_in_two_parts_is_bit_for_bit_as_in_one(
        self, train: Callable[..., tuple[int, str, str]], run_cli: Cli, tiny_run: Path, tmp_path: Path
    ) -> None:
        folder = tmp_path / "parts"
        assert train(folder, 6)[0] == 0
        assert episodes(folder) == 6
        code, _, _ = run_cli("train", "--resume", folder, "--episodes", 12)
        assert code == 0
        for name in ("episodes.csv", "config.toml"):
            assert (folder / name).read_bytes() == (tiny_run / name).read_bytes(), name
        for name in ("checkpoint.safetensors", "policy.safetensors"):
            assert same_weights(weights(folder, name), weights(tiny_run, name)), name
        assert {path.name for path in folder.iterdir()} == FILES

    def test_a_longer_run_begins_as_the_shorter_one(
        self, train: Callable[..., tuple[int, str, str]], tiny_run: Path, tmp_path: Path
    ) -> None:
        train(tmp_path / "longer", 14)
        longer = (tmp_path / "longer" / "episodes.csv").read_text().splitlines()
        assert longer[:13] == (tiny_run / "episodes.csv").read_text().splitlines()
        assert len(longer) == 15

    def test_a_finished_run_is_left_as_it_is(self, run_cli: Cli, copy: Path, snapshot: Snapshot) -> None:
        before = snapshot(copy)
        code, out, _ = run_cli("train", "--resume", copy)
        assert code == 0
        assert "12 episodes already" in out
        assert snapshot(copy) == before

    def test_fewer_episodes_than_there_are_is_refused(self, run_cli: Cli, copy: Path, snapshot: Snapshot) -> None:
        before = snapshot(copy)
        assert "12 episodes already" in refused(run_cli("train", "--resume", copy, "--episodes", 5))
        assert snapshot(copy) == before

    @pytest.mark.parametrize(
        "option",
        [
            ["--seed", "3"],
            ["--config", "literal"],
            ["--world", "paper"],
            ["--physics", "fast"],
            ["--sim", "kinematic"],
            ["--vehicles", "2"],
            ["--out", "elsewhere"],
            ["--overwrite"],
        ],
    )
    def test_what_the_run_was_configured_with_stays(
        self, run_cli: Cli, copy: Path, snapshot: Snapshot, option: list[str]
    ) -> None:
        before = snapshot(copy)
        assert option[0] in refused(run_cli("train", "--resume", copy, "--episodes", 14, *option))
        assert snapshot(copy) == before

    def test_with_how_many_workers_it_goes_on_is_free(self, run_cli: Cli, copy: Path, tiny_run: Path) -> None:
        assert run_cli("train", "--resume", copy, "--episodes", 13, "--workers", 2)[0] == 0
        assert episodes(copy) == 13

    def test_a_folder_without_a_run_is_refused(self, run_cli: Cli, tmp_path: Path) -> None:
        assert "holds no run" in refused(run_cli("train", "--resume", tmp_path))
        assert "holds no run" in refused(run_cli("train", "--resume", tmp_path / "nowhere"))
        assert list(tmp_path.iterdir()) == []

    def test_without_a_checkpoint_it_begins_at_the_beginning(self, run_cli: Cli, copy: Path, tiny_run: Path) -> None:
        for name in FILES - {"config.toml"}:
            (copy / name).unlink()
        assert run_cli("train", "--resume", copy)[0] == 0
        assert (copy / "episodes.csv").read_bytes() == (tiny_run / "episodes.csv").read_bytes()


def as_version_0_1(values: dict[str, Any]) -> dict[str, Any]:
    """The values of a configuration under their older names."""
    conditions, training = dict(values["conditions"]), dict(values["training"])
    conditions["sensors"] = {"noise": conditions.pop("sensor_noise")}
    training["disturbances"] = training.pop("domain_randomization")
    return {**values, "conditions": conditions, "training": training}


def test_a_run_folder_of_version_0_1_is_driven_and_gone_on_with(run_cli: Cli, copy: Path, tmp_path: Path) -> None:
    (copy / "config.toml").write_text(write_toml(as_version_0_1(read_toml(copy / "config.toml"))))
    for path in copy.glob("*.safetensors"):
        about = metadata(path)
        about["config"] = json.dumps(as_version_0_1(json.loads(about["config"])))
        save_file(load_file(path), path, about)
    assert run_cli("drive", copy, "--physics", "fast", "--out", tmp_path / "drive")[0] == 0
    assert run_cli("train", "--resume", copy, "--episodes", 13)[0] == 0
    assert episodes(copy) == 13
    assert "sensor_noise" in (copy / "config.toml").read_text()


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory, small_config: Path) -> tuple[Path, int, str, str]:
    """A run that Ctrl-C ended: folder, exit code, standard output, standard error."""
    folder = tmp_path_factory.mktemp("interrupted") / "run"
    command = [sys.executable, "-m", "nnql_bullet", "train", "--episodes", "2000", "--config", str(small_config)]
    command += ["--out", str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + 60.0
        while not (folder / "config.toml").exists() and time.monotonic() < deadline:
            time.sleep(0.02)
        time.sleep(2.0)  # some episodes; their checkpoint is the one that the interrupt asks for
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60.0)
    finally:
        process.kill()
    return folder, process.returncode, out, err


class TestInterrupt:
    def test_it_exits_130_and_says_how_to_go_on(self, stopped: tuple[Path, int, str, str]) -> None:
        folder, code, out, err = stopped
        assert code == 130, err
        assert f"train --resume {folder}" in out
        assert "Traceback" not in err

    def test_it_leaves_a_whole_run(self, stopped: tuple[Path, int, str, str]) -> None:
        folder, _, out, _ = stopped
        assert {path.name for path in folder.iterdir()} == FILES
        assert 1 <= episodes(folder) < 2000
        assert f"after episode {episodes(folder)} of 2000" in out
        for name in ("checkpoint.safetensors", "policy.safetensors"):
            assert metadata(folder / name)["episodes"] == str(episodes(folder))

    def test_going_on_is_bit_for_bit_as_if_it_had_never_stopped(
        self,
        stopped: tuple[Path, int, str, str],
        train: Callable[..., tuple[int, str, str]],
        run_cli: Cli,
        tmp_path: Path,
    ) -> None:
        folder = Path(shutil.copytree(stopped[0], tmp_path / "stopped"))
        total = episodes(folder) + 4
        assert run_cli("train", "--resume", folder, "--episodes", total)[0] == 0
        assert train(tmp_path / "whole", total)[0] == 0
        for name in ("episodes.csv", "config.toml"):
            assert (folder / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name
        assert same_weights(weights(folder), weights(tmp_path / "whole"))

    def test_an_interrupt_within_an_episode_waits_for_its_end(
        self, train: Callable[..., tuple[int, str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        real, calls = BulletEngine.advance, []

        def advance(self: BulletEngine, *args: object) -> object:
            calls.append(args)
            if len(calls) == 3:
                os.kill(os.getpid(), signal.SIGINT)
            return real(self, *args)  # type: ignore[arg-type]

        monkeypatch.setattr(BulletEngine, "advance", advance)
        handler = signal.getsignal(signal.SIGINT)
        code, out, _ = train(tmp_path / "run", 50)
        assert code == 130
        assert episodes(tmp_path / "run") == 1
        assert "--resume" in out
        assert signal.getsignal(signal.SIGINT) is handler

    def test_a_second_interrupt_ends_at_once(
        self, train: Callable[..., tuple[int, str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        real, calls = BulletEngine.advance, []

        def advance(self: BulletEngine, *args: object) -> object:
            calls.append(args)
            if len(calls) in (3, 4):
                os.kill(os.getpid(), signal.SIGINT)
            return real(self, *args)  # type: ignore[arg-type]

        monkeypatch.setattr(BulletEngine, "advance", advance)
        code, _, err = train(tmp_path / "run", 50)
        assert code == 130
        assert len(calls) == 4
        assert "Traceback" not in err


class TestDamage:
    @pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
    def test_a_truncated_checkpoint_is_refused(
        self, run_cli: Cli, copy: Path, snapshot: Snapshot, share: float
    ) -> None:
        path = copy / "checkpoint.safetensors"
        path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
        before = snapshot(copy)
        assert "checkpoint.safetensors" in refused(run_cli("train", "--resume", copy, "--episodes", 20))
        assert snapshot(copy) == before

    @pytest.mark.parametrize("place", [0, 9, 40])
    def test_a_checkpoint_with_a_broken_header_is_refused(
        self, run_cli: Cli, copy: Path, snapshot: Snapshot, place: int
    ) -> None:
        path = copy / "checkpoint.safetensors"
        data = bytearray(path.read_bytes())
        data[place] ^= 0xFF
        path.write_bytes(data)
        before = snapshot(copy)
        refused(run_cli("train", "--resume", copy, "--episodes", 20))
        assert snapshot(copy) == before

    @pytest.mark.parametrize("metadata", [None, {"format": "pt"}, {"format": "nnql-bullet weights 1"}])
    def test_a_foreign_safetensors_file_is_refused(
        self, run_cli: Cli, copy: Path, snapshot: Snapshot, metadata: dict[str, str] | None
    ) -> None:
        save_file({"layer": np.zeros((3, 3))}, copy / "checkpoint.safetensors", metadata)
        save_file({"layer": np.zeros((3, 3))}, copy / "policy.safetensors", metadata)
        before = snapshot(copy)
        refused(run_cli("train", "--resume", copy, "--episodes", 20))
        refused(run_cli("drive", copy))
        assert snapshot(copy) == before

    def test_weights_of_another_shape_are_refused(self, run_cli: Cli, copy: Path, snapshot: Snapshot) -> None:
        change_arrays(
            copy / "checkpoint.safetensors",
            lambda arrays: {**arrays, **{name: value[..., :2].copy() for name, value in learned(arrays).items()}},
        )
        before = snapshot(copy)
        assert "8-6-5" in refused(run_cli("train", "--resume", copy, "--episodes", 20))
        assert snapshot(copy) == before

    @pytest.mark.parametrize(
        "change",
        [
            {"actions": None},
            {"next_episode": None},
            {"episode": np.zeros(2, np.int64)},
            {"next_episode": np.zeros(2, np.int64)},
            {"actions": np.zeros((1, 1000), np.int8)},
            {"actions": np.zeros((3, 1), np.int8)},
            {"actions": np.zeros(1, np.int8)},
        ],
        ids=["no actions", "no number", "two vehicles", "two numbers", "too long", "three vehicles", "flat"],
    )
    def test_a_training_of_another_shape_is_refused(
        self, run_cli: Cli, copy: Path, snapshot: Snapshot, change: dict[str, NDArray[np.int64] | None]
    ) -> None:
        changes = {UNDER_WAY + name: values for name, values in change.items()}
        assert changes.keys() <= weights(copy).keys()
        change_arrays(
            copy / "checkpoint.safetensors",
            lambda arrays: {name: values for name, values in {**arrays, **changes}.items() if values is not None},
        )
        before = snapshot(copy)
        assert "state of a training" in refused(run_cli("train", "--resume", copy, "--episodes", 20))
        assert snapshot(copy) == before

    def test_weights_that_are_not_numbers_are_refused(self, run_cli: Cli, copy: Path, snapshot: Snapshot) -> None:
        change_arrays(
            copy / "policy.safetensors",
            lambda arrays: {name: np.full_like(value, np.nan) for name, value in arrays.items()},
        )
        before = snapshot(copy)
        assert "is not finite" in refused(run_cli("drive", copy))
        assert snapshot(copy) == before

    @pytest.mark.parametrize("damage", ["missing", "short", "words", "header"])
    def test_damaged_episodes_are_refused(self, run_cli: Cli, copy: Path, snapshot: Snapshot, damage: str) -> None:
        path = copy / "episodes.csv"
        lines = path.read_text().splitlines()
        if damage == "missing":
            path.unlink()
        elif damage == "short":
            path.write_text("\n".join(lines[:6]) + "\n")
        elif damage == "words":
            path.write_text("\n".join([*lines[:5], lines[5].replace(",", ",x", 2), *lines[6:]]) + "\n")
        else:
            path.write_text("\n".join(["a,b,c", *lines[1:]]) + "\n")
        before = snapshot(copy)
        refused(run_cli("train", "--resume", copy, "--episodes", 20))
        assert snapshot(copy) == before

    def test_a_checkpoint_of_another_run_is_refused(
        self, train: Callable[..., tuple[int, str, str]], run_cli: Cli, copy: Path, tmp_path: Path, snapshot: Snapshot
    ) -> None:
        train(tmp_path / "other", 12, "--seed", 5)
        shutil.copy(tmp_path / "other" / "checkpoint.safetensors", copy)
        before = snapshot(copy)
        assert "does not belong" in refused(run_cli("train", "--resume", copy, "--episodes", 20))
        assert snapshot(copy) == before

    def test_a_damaged_config_is_refused(self, run_cli: Cli, copy: Path, snapshot: Snapshot) -> None:
        (copy / "config.toml").write_text("episodes = = 3\n")
        before = snapshot(copy)
        assert "config.toml" in refused(run_cli("train", "--resume", copy, "--episodes", 20))
        assert snapshot(copy) == before


class TestOverwriting:
    def test_a_run_is_not_overwritten_unasked(
        self, train: Callable[..., tuple[int, str, str]], copy: Path, snapshot: Snapshot
    ) -> None:
        before = snapshot(copy)
        line = refused(train(copy, 3))
        assert "is not empty; resume the run there, overwrite it, or give another folder" in line
        assert snapshot(copy) == before

    def test_a_run_is_overwritten_when_asked(
        self, train: Callable[..., tuple[int, str, str]], copy: Path, tmp_path: Path
    ) -> None:
        assert train(copy, 3, "--seed", 7, "--overwrite")[0] == 0
        assert train(tmp_path / "fresh", 3, "--seed", 7)[0] == 0
        assert {path.name for path in copy.iterdir()} == FILES
        assert (copy / "episodes.csv").read_bytes() == (tmp_path / "fresh" / "episodes.csv").read_bytes()

    @pytest.mark.parametrize("more", [[], ["--overwrite"]])
    def test_a_folder_that_is_no_run_is_never_overwritten(
        self, train: Callable[..., tuple[int, str, str]], tmp_path: Path, snapshot: Snapshot, more: list[str]
    ) -> None:
        folder = tmp_path / "thesis"
        folder.mkdir()
        (folder / "policy.safetensors").write_text("precious")
        refused(train(folder, 3, *more))
        assert snapshot(folder) == {"policy.safetensors": b"precious"}

    @pytest.mark.parametrize("more", [[], ["--overwrite"]])
    def test_a_file_is_never_overwritten(
        self, train: Callable[..., tuple[int, str, str]], tmp_path: Path, more: list[str]
    ) -> None:
        (tmp_path / "notes").write_text("precious")
        refused(train(tmp_path / "notes", 3, *more))
        assert (tmp_path / "notes").read_text() == "precious"

    def test_an_empty_folder_is_used(self, train: Callable[..., tuple[int, str, str]], tmp_path: Path) -> None:
        (tmp_path / "empty").mkdir()
        assert train(tmp_path / "empty", 1)[0] == 0

    def test_a_bad_option_overwrites_nothing(self, run_cli: Cli, copy: Path, snapshot: Snapshot) -> None:
        before = snapshot(copy)
        refused(run_cli("train", "--world", "nowhere", "--out", copy, "--overwrite"))
        assert snapshot(copy) == before


class TestCheckpoints:
    def test_there_is_one_every_five_seconds_and_at_the_end(
        self, train: Callable[..., tuple[int, str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        clock, reset, save = [100.0], BulletEngine.reset, Run.save
        saved: list[int] = []

        def slow_reset(self: BulletEngine, *args: object) -> None:
            clock[0] += 2.0  # so long does an episode take
            reset(self, *args)  # type: ignore[arg-type]

        def noted_save(self: Run, *args: object) -> None:
            save(self, *args)  # type: ignore[arg-type]
            saved.append(episodes(self.folder))

        monkeypatch.setattr("nnql_bullet.session.time", SimpleNamespace(monotonic=lambda: clock[0]))
        monkeypatch.setattr(BulletEngine, "reset", slow_reset)
        monkeypatch.setattr(Run, "save", noted_save)
        assert train(tmp_path / "run", 8)[0] == 0
        assert saved == [3, 6, 8]

    def test_how_often_they_are_written_changes_nothing(
        self,
        train: Callable[..., tuple[int, str, str]],
        tiny_run: Path,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        monkeypatch.setattr("nnql_bullet.session.SAVE_EVERY", 0)
        assert train(tmp_path / "run", 12)[0] == 0
        for name in ("episodes.csv", "config.toml"):
            assert (tmp_path / "run" / name).read_bytes() == (tiny_run / name).read_bytes(), name
        assert same_weights(weights(tmp_path / "run"), weights(tiny_run))


class TestFullDisk:
    # Writes: config 1, sources 2, what made it 3; after episode 1: episodes 4, checkpoint 5, policy 6; and so on.
    @pytest.mark.parametrize(("write", "kept"), [(7, 1), (8, 1), (9, 2), (10, 2), (11, 2), (12, 3)])
    def test_the_checkpoint_before_stays_whole(
        self,
        train: Callable[..., tuple[int, str, str]],
        run_cli: Cli,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        write: int,
        kept: int,
    ) -> None:
        real, calls = os.fsync, []

        def fsync(descriptor: int) -> None:
            calls.append(descriptor)
            if len(calls) >= write:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            real(descriptor)

        folder = tmp_path / "full"
        assert train(tmp_path / "whole", 5)[0] == 0  # first, as it may write to the user's cache
        with monkeypatch.context() as patch:
            patch.setattr("nnql_bullet.session.SAVE_EVERY", 0)
            patch.setattr("nnql_bullet.files.os.fsync", fsync)
            code, _, err = train(folder, 5)
        assert code == 2
        assert "No space left on device" in err.splitlines()[-1]
        assert "Traceback" not in err
        assert {path.name for path in folder.iterdir()} <= FILES  # nothing half written is left
        assert metadata(folder / "checkpoint.safetensors")["episodes"] == str(kept)
        assert run_cli("train", "--resume", folder)[0] == 0
        assert (folder / "episodes.csv").read_bytes() == (tmp_path / "whole" / "episodes.csv").read_bytes()
        assert same_weights(weights(folder), weights(tmp_path / "whole"))

    def test_a_disk_full_from_the_beginning_leaves_no_half_written_file(
        self, train: Callable[..., tuple[int, str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def fsync(descriptor: int) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr("nnql_bullet.files.os.fsync", fsync)
        line = refused(train(tmp_path / "full", 2))
        assert "free some space" in line
        assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


class TestCutShort:
    """Moments at which a training may be killed; `tests/crash` tries them all."""

    SMALL = ("--sim", "kinematic", "--vehicles", 2, "--episodes", 3)

    @pytest.fixture
    def whole(self, train: Callable[..., tuple[int, str, str]], tmp_path: Path) -> Path:
        assert train(tmp_path / "whole", 3, *self.SMALL[:4])[0] == 0
        return tmp_path / "whole"

    @pytest.mark.parametrize("again", ["train", "resume"])
    @pytest.mark.parametrize("left", [["config.toml"], ["config.toml", "episodes.csv"], [".lock"]])
    def test_before_its_first_checkpoint_nothing_is_lost(
        self,
        train: Callable[..., tuple[int, str, str]],
        run_cli: Cli,
        whole: Path,
        tmp_path: Path,
        snapshot: Snapshot,
        left: list[str],
        again: str,
    ) -> None:
        folder = tmp_path / "cut"
        folder.mkdir()
        for name in left:
            (folder / name).write_bytes((whole / name).read_bytes() if (whole / name).exists() else b"process 1")
        (folder / ".writing-x").mkdir()
        (folder / ".writing-x" / "episodes.csv").write_text("half")
        if again == "resume" and "config.toml" in left:
            assert run_cli("train", "--resume", folder)[0] == 0
        else:
            assert train(folder, 3, *self.SMALL[:4])[0] == 0
        assert snapshot(folder) == snapshot(whole)

    @pytest.mark.parametrize("lost", [["policy.safetensors"], ["policy.safetensors", "learning_curve.png"]])
    def test_a_checkpoint_restores_the_whole_run(
        self, run_cli: Cli, whole: Path, snapshot: Snapshot, lost: list[str]
    ) -> None:
        before = snapshot(whole)
        for name in lost:
            (whole / name).unlink()
        assert run_cli("train", "--resume", whole)[0] == 0
        assert snapshot(whole) == before


@pytest.mark.slow
def test_equal_trainings_leave_equal_bytes(
    spawn_cli: Callable[..., subprocess.CompletedProcess[str]], small_config: Path, tmp_path: Path, snapshot: Snapshot
) -> None:
    left = []
    for number in (1, 2):
        command = ["train", "--config", small_config, "--sim", "kinematic", "--vehicles", 2, "--episodes", 3, "--out"]
        environment = {**os.environ, "PYTHONHASHSEED": str(number)}
        assert spawn_cli(*command, tmp_path / str(number), env=environment).returncode == 0
        left.append(snapshot(tmp_path / str(number)))
    assert left[0] == left[1]
