"""Bad input and silence: what cannot be done rightly is refused or said in one line, and names cannot do harm."""

import json
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import nnql_bullet as nb
from nnql_bullet import memory
from nnql_bullet.cli.console import items
from nnql_bullet.config import MOST_TOML
from nnql_bullet.env import Transition
from nnql_bullet.errors import UserError, WorkFailed
from nnql_bullet.evaluation.metrics import Evaluation
from nnql_bullet.reports.document import Section, table
from nnql_bullet.run_config import RunConfig, changed
from nnql_bullet.session import check
from nnql_bullet.text import one_line, printable, shell_line

Cli = Callable[..., tuple[int, str, str]]
BOX = '[layout]\nkind = "boxes"\nboxes = [{x = 15, y = 25, length = 2, width = 2}]\n'
FIXED = f"width = 30\ndepth = 30\nstart = [5, 5]\ntarget = [25, 5]\n{BOX}"
WORDS = ["plain", "a b", "it's", "$(touch hurt)", "`touch hurt`", "a\nb", "tab\t\x1b[31m", "é", "\\x", "'", "-x", ""]


class TestText:
    def test_a_shell_takes_a_line_apart_into_the_words(self) -> None:
        line = shell_line(*WORDS)
        assert line.isprintable()
        shown = subprocess.run(["bash", "-c", f"printf '%s\\0' {line}"], capture_output=True, check=True).stdout
        assert shown.decode().split("\0")[:-1] == WORDS

    def test_names_cannot_steer_a_terminal(self) -> None:
        assert printable("a\x1b[31mb\u202ec\nd") == "a\\x1b[31mb\\u202ec\nd"
        assert one_line("a\r\n\tb\x07") == "a b\\x07"
        assert len(one_line("x" * 10**6)) < 2100

    def test_names_do_not_break_markdown(self) -> None:
        text = Section("a <b>", ("see <script> and `a < b`", table(["x"], [["a|b\nc"]]))).markdown()
        assert "<script>" not in text
        assert "`a < b`" in text
        assert "| a\\|b c |" in text

    def test_a_comma_in_the_name_of_a_file_is_part_of_it(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        Path("a, b's.toml").touch()
        assert items("paper,a, b's.toml, traps,,") == ["paper", "a, b's.toml", "traps"]


class TestMemory:
    @pytest.mark.parametrize(
        "agent", [{"kind": "double_dqn", "buffer_size": 10**9}, {"kind": "sb3_dqn", "buffer_size": 10**9}]
    )
    def test_what_does_not_fit_is_refused_with_both_numbers(self, agent: dict[str, object], tmp_path: Path) -> None:
        with pytest.raises(UserError, match=r"needs at least [\d.]+ GB of memory, and this machine has [\d.]+ GB"):
            nb.train(changed(RunConfig(), agent=agent), out=tmp_path / "run")
        assert not (tmp_path / "run").exists()

    def test_vehicles_times_steps_count(self, monkeypatch: pytest.MonkeyPatch) -> None:
        config = changed(RunConfig(), vehicles=1000, task={"max_steps": 10_000})
        check(config)
        monkeypatch.setattr(memory, "installed", lambda: 89_000_000)
        with pytest.raises(UserError, match=r"0\.1 GB"):
            check(config)


class TestSilence:
    def test_a_target_out_of_reach_is_said(self, caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
        changes = {"simulator": "kinematic", "vehicles": 8, "episodes": 8, "drive": {"speed": 0.22}}
        nb.train("paper", out=tmp_path / "run", task={"max_steps": 20}, **changes)
        before, after = (record.getMessage() for record in caplog.records if record.levelname == "WARNING")
        assert "20 steps of 0.5 s at 0.22 m/s are 2.2 m, and the target is 97 m away" in before
        assert after.startswith("none of 8 episodes reached its target; ")

    def test_a_schedule_without_success_is_said(self, caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
        agent, task = {"schedule_episodes": 4}, {"max_steps": 20}
        nb.train("paper", out=tmp_path / "run", simulator="kinematic", episodes=6, agent=agent, task=task)
        assert any("the schedule is over after 4 episodes, and none" in message for message in caplog.messages)

    def test_a_training_that_diverges_ends_in_one_line(self, tmp_path: Path) -> None:
        def reward(transitions: Transition) -> np.ndarray:
            return np.full(len(transitions.r_t), 1e300)

        with pytest.raises(
            WorkFailed, match=r"the training diverged: after \d+ episodes 'td_error' is not finite"
        ) as e:
            nb.train("paper", out=tmp_path / "run", simulator="kinematic", vehicles=4, episodes=40, reward=reward)
        assert "it came to no checkpoint, so nothing is kept; begin anew, in the same folder if you like" in str(
            e.value
        )
        nb.train("paper", out=tmp_path / "run", simulator="kinematic", vehicles=4, episodes=2)

    def test_a_fixed_world_is_one_drive(self, tmp_path: Path) -> None:
        (tmp_path / "fixed.toml").write_text(FIXED)
        worlds = [tmp_path / "fixed.toml", "cover_10"]
        results = nb.evaluate(["straight", "vfh"], worlds=worlds, n_worlds=3, simulator="kinematic")
        assert {(row["world"], row["drives"]) for row in results.rows} >= {("fixed", 1), ("cover_10", 3)}
        assert "--worlds 3 " in Evaluation.command.fget(results.evaluation)  # type: ignore[attr-defined]

    def test_random_drives_through_a_fixed_world_count(self, tmp_path: Path) -> None:
        (tmp_path / "fixed.toml").write_text(FIXED)
        results = nb.evaluate("random", worlds=[tmp_path / "fixed.toml"], n_worlds=3, simulator="kinematic")
        assert results.rows[0]["drives"] == 3

    @pytest.mark.parametrize("x", [5.0, 6.9])
    def test_a_target_that_is_reached_at_the_start_is_refused(self, x: float) -> None:
        with pytest.raises(UserError, match="the target is reached at the start"):
            nb.World.from_boxes([], width=30, depth=30, start=(5, 5), target=(x, 5))


class TestRunFolder:
    @pytest.fixture
    def folder(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        """A run that was trained with files of its own, in another working folder."""
        (tmp_path / "here").mkdir()
        monkeypatch.chdir(tmp_path / "here")
        Path("w.toml").write_text(FIXED)
        robots = Path(nb.__file__).parents[1] / "robots"
        for suffix in ("toml", "urdf"):
            shutil.copy(robots / f"tricycle.{suffix}", f"tricycle.{suffix}")
        changes = {"world": "w.toml", "robot": "tricycle.toml", "simulator": "kinematic", "vehicles": 2}
        nb.train("paper", out=tmp_path / "run", episodes=4, **changes)
        return tmp_path / "run"

    def test_it_is_driven_and_resumed_from_elsewhere(
        self, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ) -> None:
        shutil.copytree(folder, tmp_path / "whole")
        nb.resume(tmp_path / "whole", episodes=8)
        (tmp_path / "here").rename(tmp_path / "gone")
        monkeypatch.chdir(tmp_path)
        folder.rename(tmp_path / "moved")
        assert nb.drive("moved", simulator="kinematic").world.name == "w"
        assert len(nb.resume("moved", episodes=8).episodes) == 8
        assert (tmp_path / "moved/episodes.csv").read_bytes() == (tmp_path / "whole/episodes.csv").read_bytes()
        assert not [message for message in caplog.messages if "has changed" in message]

    @pytest.mark.parametrize("name", ["w.toml", "tricycle.urdf"])
    def test_a_changed_file_is_noticed(self, folder: Path, name: str, caplog: pytest.LogCaptureFixture) -> None:
        file = Path(name)
        file.write_text(file.read_text().replace("x = 15", "x = 14").replace("</robot>", " </robot>"))
        nb.resume(folder, episodes=6)
        (line,) = (message for message in caplog.messages if "has changed" in message)
        assert line.startswith(f"{name} has changed since this run began")


class TestFiles:
    def test_a_chain_of_bases_ends(self, tmp_path: Path) -> None:
        for number in range(2000):
            (tmp_path / f"w{number}.toml").write_text(f'base = "w{number + 1}"\n')
        with pytest.raises(UserError, match="more than 20 worlds are based on one another"):
            nb.World.load(tmp_path / "w0.toml")

    @pytest.mark.parametrize("name", ["", "a/b", "..\\x", "a\nb", "\x1b[31m", "x" * 101])
    def test_names_of_worlds_name_files(self, name: str) -> None:
        with pytest.raises(UserError, match="name must be one line"):
            nb.World.from_boxes([], name=name)

    def test_a_bomb_is_refused_before_it_is_unpacked(self, tmp_path: Path) -> None:
        bomb = tmp_path / "bomb.npz"
        with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("about.npy", "w") as member:
            for _ in range(600):
                member.write(b"\0" * 1_000_000)
        with pytest.raises(UserError, match="unpacks to more than"):
            nb.Recording.load(bomb)

    @pytest.mark.usefixtures("compiled_kernels")
    @pytest.mark.parametrize(
        "words",
        [
            ("robot", "circle.urdf"),
            ("robot", "circle.xacro"),
            ("worlds", "show", "circle.toml"),
            ("worlds", "import", "circle.yaml", "--out", "w.toml"),
            ("drive", "straight", "--robot", "circle.toml"),
            ("train", "--from", "circle.safetensors", "--out", "run"),
        ],
        ids=lambda words: words[-1],
    )
    def test_links_in_a_circle_are_refused(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_cli: Cli, words: tuple[str, ...]
    ) -> None:
        monkeypatch.chdir(tmp_path)
        for name in filter(lambda word: word.startswith("circle"), words):
            Path(name).symlink_to(name)
        code, out, err = run_cli(*words, *(("--sim", "kinematic") if words[0] in ("drive", "train") else ()))
        assert (code, out, err.count("\n")) == (2, "", 1)

    def test_a_huge_toml_is_refused_before_it_is_parsed(self, tmp_path: Path) -> None:
        huge = tmp_path / "huge.toml"
        with huge.open("wb") as file:
            file.truncate(MOST_TOML + 1)
        with pytest.raises(UserError, match=f"has {MOST_TOML + 1} bytes; such a file is read up to {MOST_TOML} bytes"):
            nb.World.load(huge)

    def test_objects_are_refused(self, tmp_path: Path) -> None:
        np.savez(tmp_path / "a.npz", about=np.array([{}], dtype=object))
        with pytest.raises(UserError, match="is not what its header says"):
            nb.Recording.load(tmp_path / "a.npz")

    def test_quoted_commands_and_odd_names_in_every_verb(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_cli: Cli
    ) -> None:
        monkeypatch.chdir(tmp_path)
        world, run = "a, b's [red] world.toml", "my runs/it's, a"
        Path(world).write_text(FIXED)
        code, out, _ = run_cli("train", "--sim", "kinematic", "--episodes", 2, "--world", world, "--out", run)
        assert (code, out.splitlines()[-1].partition("with: ")[2]) == (0, f"nnql-bullet {shell_line('drive', run)}")
        sim = ("--sim", "kinematic")
        assert run_cli("drive", run, *sim)[0] == 0
        code, out, _ = run_cli("evaluate", run, "vfh", "--world", f"{world},cover_10", "--worlds", 1, *sim, "--json")
        assert (code, [tier["file"] for tier in json.loads(out)["tiers"]]) == (0, [world, "cover_10"])
