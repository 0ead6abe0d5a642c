"""The command line end to end: what it prints, where, what it leaves, and with which exit code."""

import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

import nnql_bullet
from nnql_bullet.agents import RULES
from nnql_bullet.agents.learning.q_table import QTableOptions
from nnql_bullet.recording import load_recording
from nnql_bullet.run_config import Conditions
from nnql_bullet.runs import load_run
from nnql_bullet.training.selection import SelectionOptions

Cli = Callable[..., tuple[int, str, str]]
Spawn = Callable[..., subprocess.CompletedProcess[str]]
Snapshot = Callable[[Path], dict[str, bytes]]

ROBOTS = Path(__file__).resolve().parents[1] / "robots"
KEYS = {
    "ending",
    "steps",
    "time",
    "path_length",
    "smallest_clearance",
    "seed",
    "world",
    "robot",
    "recording",
    "picture",
}


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def refused(answer: tuple[int, str, str]) -> str:
    """The one line that a refusal consists of."""
    code, out, err = answer
    assert (code, out) == (2, "")
    assert err.startswith("nnql-bullet: ")
    assert err.endswith("\n")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    return err


class TestTrain:
    def test_it_says_where_things_are_and_how_to_go_on(self, run_cli: Cli, here: Path, small_world: Path) -> None:
        code, out, err = run_cli("train", "--episodes", 2, "--world", small_world, "--seed", 4)
        folder = here / "runs" / "paper-4"
        assert code == 0
        assert (folder / "policy.safetensors").is_file()
        assert "runs/paper-4/policy.safetensors" in out
        assert "nnql-bullet drive runs/paper-4" in out
        assert "training 2/2" in err

    def test_a_config_file_names_the_run(self, run_cli: Cli, here: Path, small_world: Path) -> None:
        (here / "mine.toml").write_text(
            f'preset = "literal"\nepisodes = 1\nworld = "{small_world}"\n[agent]\nkind = "nnql"\ngradient_step = 0.7\n'
        )
        assert run_cli("train", "--config", "mine.toml")[0] == 0
        resolved = (here / "runs" / "mine-0" / "config.toml").read_text()
        assert "gradient_step = 0.7" in resolved  # from the file
        assert 'encoding = "distance"' in resolved  # from the preset under it
        assert "learning_rate = 0.1" in resolved  # from the paper

    def test_a_flag_goes_over_the_file(self, run_cli: Cli, here: Path, small_world: Path) -> None:
        (here / "mine.toml").write_text(f'episodes = 50\nworld = "{small_world}"\n')
        assert run_cli("train", "--config", "mine.toml", "--episodes", 1, "--out", "run")[0] == 0
        assert "episodes = 1\n" in (here / "run" / "config.toml").read_text()

    def test_every_key_of_the_configuration_is_a_flag(self, run_cli: Cli, here: Path, small_world: Path) -> None:
        asked = ("--agent.discount", 0.2, "--agent.mirrored", "true", "--task.front-distance", 6)
        asked += ("--conditions.payload", 80, "--training.selection.worlds", small_world, "paper")
        asked += ("--training.selection.count", 1, "--training.domain-randomization.noise=0.1")
        answer = run_cli("train", "--episodes", 1, "--world", small_world, *asked, "--out", "run")
        assert answer[0] == 0, answer
        config = load_run(here / "run").config
        selection = SelectionOptions(worlds=(str(small_world), "paper"), count=1)
        assert (config.agent.discount, config.agent.mirrored, config.task.front_distance) == (0.2, True, 6.0)
        assert (config.conditions, config.training.selection) == (Conditions(payload=80), selection)
        assert config.training.domain_randomization.noise == 0.1

    def test_a_key_of_another_agent_is_taken_over_its_preset(
        self, run_cli: Cli, here: Path, small_config: Path
    ) -> None:
        arguments = ("--config", small_config, "--episodes", 1, "--agent.kind", "q_table", "--agent.edges", 2, 4.5)
        assert run_cli("train", *arguments, "--out", "run")[0] == 0
        assert load_run(here / "run").config.agent == QTableOptions(edges=(2.0, 4.5))

    @pytest.mark.usefixtures("compiled_kernels")
    def test_it_trains_the_kinematic_model_when_asked(self, run_cli: Cli, here: Path, small_config: Path) -> None:
        code, _, err = run_cli("train", "--sim", "kinematic", "--episodes", 3, "--config", small_config, "--out", "run")
        assert code == 0
        assert "the kinematic model" in err.splitlines()[0]
        assert "training 3/3" in err.splitlines()[1]
        assert err.count("\n") == 2
        assert 'simulator = "kinematic"' in (here / "run" / "config.toml").read_text()

    def test_as_a_program(self, spawn_cli: Spawn, here: Path, small_world: Path) -> None:
        done = spawn_cli("train", "--episodes", 2, "--world", small_world, "--out", "run", cwd=here)
        assert done.returncode == 0, done.stderr
        assert "Warning" not in done.stderr
        assert len((here / "run" / "episodes.csv").read_text().splitlines()) == 3


class TestDrive:
    def test_it_drives_and_leaves_recording_and_picture(self, run_cli: Cli, tiny_run: Path, here: Path) -> None:
        code, out, err = run_cli("drive", tiny_run, "--seed", 3, "--out", "drive")
        assert (code, err) == (0, "")
        assert re.search(r"^(goal|collision|timeout|stuck|overturned) in world 'small', seed 3: \d+ steps", out)
        assert {path.name for path in (here / "drive").iterdir()} == {"trajectory.npz", "trajectory.png"}
        assert (here / "drive" / "trajectory.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"

    def test_json_is_exactly_one_object_that_agrees_with_the_recording(
        self, run_cli: Cli, tiny_run: Path, here: Path
    ) -> None:
        code, out, err = run_cli("drive", tiny_run, "--json", "--out", "drive")
        assert (code, err) == (0, "")
        assert out.count("\n") == 1
        result = json.loads(out)
        assert result.keys() == KEYS
        recording = load_recording(here / result["recording"])
        assert (here / result["picture"]).is_file()
        assert result["ending"] == recording.about["ending"]
        assert result["steps"] == len(recording.action)
        assert result["time"] == pytest.approx(recording.state_time[-1])
        assert result["smallest_clearance"] == recording.clearance.min()
        assert (result["seed"], result["world"]) == (0, "small")

    def test_it_is_reproducible(self, run_cli: Cli, tiny_run: Path, here: Path) -> None:
        answers = [json.loads(run_cli("drive", tiny_run, "--json", "--out", name)[1]) for name in ("a", "b")]
        for answer in answers:
            del answer["recording"], answer["picture"]
        assert answers[0] == answers[1]
        assert (here / "a" / "trajectory.png").read_bytes() == (here / "b" / "trajectory.png").read_bytes()

    def test_it_takes_another_world_seed_and_physics(self, run_cli: Cli, tiny_run: Path, here: Path) -> None:
        arguments = ("--world", "cover_10", "--seed", 7, "--physics", "fast", "--json", "--out", "drive")
        code, out, _ = run_cli("drive", tiny_run, *arguments)
        assert code == 0
        assert (json.loads(out)["world"], json.loads(out)["seed"]) == ("cover_10", 7)
        assert load_recording(here / "drive" / "trajectory.npz").about["physics"] == "fast"

    @pytest.mark.usefixtures("compiled_kernels")
    def test_drives_under_other_conditions_do_not_replace_each_other(
        self, run_cli: Cli, tiny_run: Path, tmp_path: Path
    ) -> None:
        run = shutil.copytree(tiny_run, tmp_path / "run")
        flags = (
            [],
            ["--sim", "kinematic"],
            ["--conditions.wheel-friction", 0.5],
            ["--conditions.payload", 40, "--conditions.dead-sector", 2],
            ["--conditions.sensor-noise", 0.05],
        )
        for extra in flags:
            assert run_cli("drive", run, "--physics", "fast", *extra)[0] == 0
        folders = {path.name: path / "trajectory.npz" for path in (run / "drives").iterdir()}
        assert folders.keys() == {
            "small-0", "small-0-kinematic", "small-0-wheel-friction-0.5", "small-0-payload-40-dead-sector-2",
            "small-0-sensor-noise-0.05"
        }  # fmt: skip
        conditions = load_recording(folders["small-0-payload-40-dead-sector-2"]).about["conditions"]
        assert (conditions["payload"], conditions["dead_sector"]) == (40.0, 2)
        ends = {name: load_recording(path).state_pose[-1].tolist() for name, path in folders.items()}
        assert len({tuple(end) for end in ends.values()}) >= 4  # they do differ

    @pytest.mark.usefixtures("compiled_kernels")
    def test_it_drives_the_kinematic_model_when_asked(self, run_cli: Cli, tiny_run: Path, here: Path) -> None:
        code, _, err = run_cli("drive", tiny_run, "--sim", "kinematic", "--out", "drive")
        assert (code, err) == (0, "")
        assert load_recording(here / "drive" / "trajectory.npz").about["simulator"] == "kinematic"

    def test_it_takes_a_policy_file(self, run_cli: Cli, tiny_run: Path, here: Path) -> None:
        (here / "policy.safetensors").write_bytes((tiny_run / "policy.safetensors").read_bytes())
        code, out, _ = run_cli("drive", "policy.safetensors")
        assert code == 0
        assert "drives/small-0/trajectory.png" in out
        assert (here / "drives" / "small-0" / "trajectory.png").is_file()

    @pytest.mark.usefixtures("compiled_kernels")
    def test_a_rule_leaves_its_drives_under_its_name(self, run_cli: Cli, here: Path, small_world: Path) -> None:
        code, out, err = run_cli("drive", "straight", "--world", small_world, "--sim", "kinematic")
        assert (code, err) == (0, "")
        folder = Path("runs", "straight", "drives", "small-0-kinematic")
        assert f"picture: {folder}/trajectory.png" in out
        recording = load_recording(here / folder / "trajectory.npz")
        assert recording.about["policy"] == "straight"
        assert set(recording.action.tolist()) == {5}

    @pytest.mark.usefixtures("compiled_kernels")
    def test_it_takes_a_file_that_configures_a_rule(self, run_cli: Cli, here: Path, small_world: Path) -> None:
        (here / "mine.toml").write_text(
            f'preset = "hand_rule"\nworld = "{small_world}"\n[agent]\nkind = "hand_rule"\nturn_degrees = 60\n'
        )
        code, out, _ = run_cli("drive", "mine.toml", "--sim", "kinematic", "--json")
        assert code == 0
        assert json.loads(out)["recording"] == "runs/mine/drives/small-0-kinematic/trajectory.npz"
        assert load_recording(here / json.loads(out)["recording"]).about["policy"] == "hand_rule"

    def test_a_rule_drives_in_contact_physics(self, run_cli: Cli, here: Path, small_world: Path) -> None:
        code, out, err = run_cli("drive", "vfh", "--world", small_world, "--physics", "fast", "--json")
        assert (code, err) == (0, "")
        assert json.loads(out)["ending"] == "goal"

    def test_as_a_program_only_the_object_is_on_standard_output(
        self, spawn_cli: Spawn, tiny_run: Path, here: Path
    ) -> None:
        done = spawn_cli("drive", tiny_run, "--json", "--out", "drive", cwd=here)
        assert (done.returncode, done.stderr) == (0, "")
        assert json.loads(done.stdout).keys() == KEYS


class TestHelp:
    @pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"]])
    def test_the_overview_names_every_verb(self, run_cli: Cli, arguments: list[str]) -> None:
        code, out, err = run_cli(*arguments)
        assert (code, err) == (0, "")
        for verb in ("train", "drive", "gap", "report", "fidelity", "envelope", "doctor"):
            assert re.search(rf"^  {verb} +\S", out, re.MULTILINE)

    @pytest.mark.parametrize(
        ("verb", "words"),
        [
            ("train", ["--config", "--episodes", "--seed", "--world", "--physics", "--out", "--resume", "--overwrite"]),
            ("train", ["--sim", "--vehicles", "--workers"]),
            ("drive", ["RUN", "--world", "--seed", "--sim", "--physics", "--out", "--json"]),
            ("drive", ["--conditions.payload", "[kg]", "--conditions.sensor-noise", "[m]", "--conditions.dead-sector"]),
            ("drive", ["RULE", *RULES]),
            ("gap", ["RUN", "--against", "--sim", "--physics", "--world", "--worlds", "--split", "--no-faults"]),
            ("report", ["RUN", "--evaluation", "--gap", "--out"]),
            ("fidelity", ["--robot", "--sim", "--physics", "--out"]),
            ("envelope", ["--robot", "--sim", "--physics", "--workers", "--out", "3691-4"]),
            ("doctor", ["Check this machine"]),
        ],
    )
    def test_each_verb_explains_its_options(self, run_cli: Cli, verb: str, words: list[str]) -> None:
        code, out, err = run_cli(verb, "--help")
        assert (code, err) == (0, "")
        assert [word for word in words if word not in out] == []
        assert f"nnql-bullet {verb}" in out

    def test_help_of_training_fits_a_screen(self, run_cli: Cli) -> None:
        out = run_cli("train", "--help")[1]
        assert len(out.splitlines()) <= 65
        assert "nnql-bullet keys" in out
        assert "--agent.learning-rate" not in out

    def test_keys_are_listed_with_type_unit_and_value(self, run_cli: Cli) -> None:
        code, out, err = run_cli("keys", "--config", "double_dqn")
        assert (code, err) == (0, "")
        lines = {line.split()[0]: line for line in out.splitlines()}
        assert re.search(r"number >= 0, <= 1 +0\.9 ", lines["agent.discount"])
        assert "[kg]" in lines["conditions.payload"]
        assert {
            "seed",
            "task.front_distance",
            "training.selection.every",
            "shield.margin",
            "drive.speed",
        } <= lines.keys()
        assert "agent.gradient_step" not in lines  # of another agent

    def test_version(self, run_cli: Cli) -> None:
        assert run_cli("--version") == (0, f"nnql-bullet {nnql_bullet.__version__}\n", "")

    def test_doctor_finds_this_machine_well(self, run_cli: Cli) -> None:
        code, out, err = run_cli("doctor")
        assert (code, err) == (0, "")
        lines = out.splitlines()
        assert all(re.match(r"(ok   |note ) \w", line) for line in lines)
        for name in ("Python", "PyBullet", "drive", "rays"):
            assert any(re.match(rf"ok +{name} ", line) for line in lines)

    def test_doctor_fails_if_something_needed_does(self, run_cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
        from nnql_bullet import diagnosis
        from nnql_bullet.diagnosis import Finding

        checks = {"fine": lambda: Finding(True, "yes"), "drive": lambda: Finding(False, "off course; do this")}
        monkeypatch.setattr(diagnosis, "CHECKS", checks)
        monkeypatch.setattr("nnql_bullet.cli.doctor.CHECKS", checks)
        code, out, _ = run_cli("doctor")
        assert code == 1
        assert "FAIL" in out
        assert "off course; do this" in out


BAD_ARGUMENTS = [
    (["fly"], ["fly", "train", "drive", "gap", "fidelity", "envelope", "doctor"]),
    (["train", "--bogus"], ["--bogus", "train --help"]),
    (["train", "--episodes"], ["--episodes"]),
    (["train", "--episodes", "many"], ["--episodes", "many"]),
    (["train", "--episodes", "0"], ["episodes", "greater than or equal to 1"]),
    (["train", "--seed", "-1"], ["seed", "greater than or equal to 0"]),
    (["train", "--config", "papre"], ["papre", "paper", "literal"]),
    (["train", "--config", "missing.toml"], ["missing.toml"]),
    (["train", "--world", "nowhere"], ["nowhere", "paper", "cover_10", "empty"]),
    (["train", "--sim", "gazebo"], ["gazebo", "one of: bullet"]),
    (["train", "--vehicles", "0"], ["vehicles", "greater than or equal to 1"]),
    (["train", "--physics", "slow"], ["slow", "one of: fast, reference"]),
    (["train", "extra"], ["extra"]),
    (["gap"], ["give a policy"]),
    (["evaluate"], ["give a policy", "double_dqn", *RULES]),
    (["drive", "no/such/run"], ["no/such/run"]),
    (["drive", "."], ["policy.safetensors", "train first"]),
    (["drive", "vhf"], ["vhf", "rules: ", *RULES]),
    (["train", "--config", "vfh"], ["'vfh' is a rule and has nothing to learn"]),
    (["doctor", "--fast"], ["--fast"]),
    (["train", "--discount", "0.2"], ["unknown flag '--discount' (did you mean --agent.discount?)"]),
    (["train", "--task.front-distence", "6"], ["did you mean --task.front-distance"]),
    (["train", "--agent.discount", "2"], ["'agent.discount'", "less than or equal to 1, not 2.0"]),
    (["train", "--agent.discount", "much"], ["--agent.discount: not a valid value: 'much'"]),
    (["train", "--agent.mirrored", "maybe"], ["--agent.mirrored: 'maybe' is not valid", "false, true"]),
    (["train", "--agent.frames", "2"], ["unknown key 'agent.frames'", "discount"]),
    (["keys", "agnt"], ["no key begins with 'agnt'"]),
    (["view"], ["give recording"]),
    # as version 0.1 had it
    (["navigate"], ["the verb 'navigate' is now 'drive'"]),
    (["ledger", "tuned"], ["the verb 'ledger' is now 'ablate'"]),
    (["train", "--sim", "twin"], ["--sim twin is now --sim kinematic"]),
    (["gap", "paper", "--against", "twin"], ["--against twin is now --against kinematic"]),
    (["drive", "--friction", "0.5"], ["--friction is now --conditions.wheel-friction"]),
    (["evaluate", "paper", "--noise=0.1"], ["--noise is now --conditions.sensor-noise"]),
    # no empty value is another word for the working folder, or for a default
    (["train", "--out", ""], ["--out has an empty value"]),
    (["train", "--config="], ["--config has an empty value"]),
    (["drive", " "], ["an argument has an empty value"]),
    (["train", "--training.disturbances.noise", "1"], ["is now --training.domain-randomization.noise"]),
]


class TestBadArguments:
    @pytest.mark.parametrize(("arguments", "words"), BAD_ARGUMENTS, ids=[" ".join(a) for a, _ in BAD_ARGUMENTS])
    def test_one_line_that_helps_and_nothing_written(
        self, run_cli: Cli, here: Path, arguments: list[str], words: list[str]
    ) -> None:
        line = refused(run_cli(*arguments))
        assert [word for word in words if word not in line] == []
        assert list(here.iterdir()) == []

    def test_bad_seed_or_world_of_drive(self, run_cli: Cli, tiny_run: Path, here: Path, snapshot: Snapshot) -> None:
        before = snapshot(tiny_run)
        assert "-3" in refused(run_cli("drive", tiny_run, "--seed", "-3"))
        assert "nowhere" in refused(run_cli("drive", tiny_run, "--world", "nowhere"))
        assert snapshot(tiny_run) == before
        assert list(here.iterdir()) == []

    def test_as_a_program(self, spawn_cli: Spawn, here: Path) -> None:
        done = spawn_cli("train", "--world", "nowhere", cwd=here)
        assert "nowhere" in refused((done.returncode, done.stdout, done.stderr))
        assert list(here.iterdir()) == []


BAD_CONFIGS = [
    ("color = 3", ["unknown key 'color'", "seed", "episodes", "world", "robot", "drive", "task", "agent"]),
    ("[drive]\nsped = 2.0", ["unknown key 'drive.sped'", "speed", "decision_period", "heading_gain"]),
    ("[task]\nfront = 1.0", ["unknown key 'task.front'", "front_distance", "max_steps"]),
    ("[agent]\nlr = 0.1", ["unknown key 'agent.lr'", "learning_rate", "gradient_step"]),
    ("[drive]\nspeed = 0", ["drive.speed", "greater than 0"]),
    ("[drive]\nspeed = nan", ["drive.speed"]),
    ("[drive]\nspeed = 'fast'", ["drive.speed", "fast"]),
    ("[drive]\ndecision_period = 0.123", ["0.123", "0.00833333"]),
    ("[task]\nfront_distance = 120.0", ["task.front_distance", "100"]),
    ("[task]\nmax_steps = 2.5", ["task.max_steps", "2.5"]),
    ("[agent]\nkind = 'dqn'", ["agent.kind", "nnql"]),
    ("[agent]\nlearning_rate = 2.0", ["agent.learning_rate", "less than or equal to 1"]),
    ("episodes = '10'", ["episodes", "10"]),
    ("preset = 'papre'", ["preset", "paper", "literal"]),
    ("robot = 'quadcopter'", ["quadcopter", "tricycle"]),
    ("physics = 'slow'", ["physics", "fast", "reference"]),
    ("episodes = = 3", ["TOML"]),
    ("episodes = 3\nepisodes = 4", ["TOML"]),
    ("drive = 3", ["drive"]),
    ("[training.disturbances]\nnoise = 1.0", ["'training.disturbances' is now named 'training.domain_randomization'"]),
    ("[conditions.sensors]\nnoise = 1.0", ["'conditions.sensors.noise' is now named 'conditions.sensor_noise'"]),
    ("simulator = 'twin'", ["simulator 'twin' is now named 'kinematic'"]),
]


class TestBadConfig:
    @pytest.mark.parametrize(("text", "words"), BAD_CONFIGS, ids=[text for text, _ in BAD_CONFIGS])
    def test_one_line_that_names_file_and_key_and_nothing_written(
        self, run_cli: Cli, here: Path, text: str, words: list[str]
    ) -> None:
        (here / "bad.toml").write_text(text + "\n")
        line = refused(run_cli("train", "--config", "bad.toml"))
        assert [word for word in words if word not in line] == []
        assert [path.name for path in here.iterdir()] == ["bad.toml"]

    def test_a_config_that_is_not_text(self, run_cli: Cli, here: Path) -> None:
        (here / "bad.toml").write_bytes(b"\xff\xfe\x00\x01")
        assert "bad.toml" in refused(run_cli("train", "--config", "bad.toml"))


def world(boxes: str, start: str = "[5.0, 5.0]", target: str = "[25.0, 25.0]") -> str:
    return (
        f'width = 30.0\ndepth = 30.0\nstart = {start}\ntarget = {target}\n[layout]\nkind = "boxes"\nboxes = [{boxes}]\n'
    )


BAR = "{x = 15.0, y = 15.0, length = 41.0, width = 1.0, yaw_degrees = -45.0}"
BAD_WORLDS = {
    "walled off": (world(BAR), ["narrows to 0.", "needs 0.75 m"]),
    "start in a box": (world("{x = 5.0, y = 5.0, length = 2.0, width = 2.0}"), ["narrows to 0.00 m at its start"]),
    "target in a box": (world("{x = 25.0, y = 25.0, length = 2.0, width = 2.0}"), ["narrows to 0.00 m at its target"]),
    "start too near": (world("{x = 5.8, y = 5.0, length = 1.0, width = 1.0}"), ["narrows to 0.60 m at its start"]),
    "start outside": (world("", start="[-5.0, 5.0]"), ["start (-5, 5)", "outside the arena"]),
    "target outside": (world("", target="[25.0, 250.0]"), ["target (25, 250)", "outside the arena"]),
    "unknown key": ("widht = 30.0\n" + world(""), ["unknown key 'widht'", "width"]),
    "unknown layout": ('[layout]\nkind = "maze"\n', ["layout.kind", "boxes", "random_boxes"]),
    "no layout": ("width = 30.0\n", ["layout", "missing"]),
    "too full": ('base = "paper"\n[layout]\ncover = 0.4\nmin_side = 30.0\nmax_side = 40.0\n', ["cover"]),
    "base of itself": ('base = "bad"\n', ["base", "itself"]),
}


class TestBadWorld:
    @pytest.mark.parametrize("name", BAD_WORLDS)
    def test_train_and_drive_refuse_it_in_one_line(
        self, run_cli: Cli, tiny_run: Path, here: Path, name: str, snapshot: Snapshot
    ) -> None:
        text, words = BAD_WORLDS[name]
        (here / "bad.toml").write_text(text)
        before = snapshot(tiny_run)
        for arguments in (["train"], ["drive", tiny_run]):
            line = refused(run_cli(*arguments, "--world", "bad.toml"))
            assert [word for word in words if word not in line] == []
        assert snapshot(tiny_run) == before
        assert [path.name for path in here.iterdir()] == ["bad.toml"]

    def test_a_box_at_the_front_corner_of_the_start_is_no_crash(self, run_cli: Cli, tiny_run: Path, here: Path) -> None:
        # The nose reaches 0.9 m ahead of the rear axle; this box stands at its corner, 0.92 m away from the axle.
        (here / "tight.toml").write_text(
            world("{x = 6.48, y = 5.88, length = 1.0, width = 1.2}", start="[5.1, 5.1]").replace(
                "[layout]", "start_yaw_degrees = 0.0\n[layout]"
            )
        )
        code, _, err = run_cli("drive", tiny_run, "--world", "tight.toml", "--out", "drive")
        assert code == 0 or (code == 2 and err.count("\n") == 1)


def edited(urdf: str, pattern: str, replacement: str) -> str:
    text, times = re.subn(pattern, replacement, urdf, count=1, flags=re.DOTALL)
    assert times == 1, "the test edits what is not there"
    return text


BAD_URDFS: dict[str, tuple[Callable[[str], str], list[str]]] = {
    "not XML": (lambda u: u[: len(u) // 2], ["cannot be read as a URDF"]),
    "another document": (lambda u: "<html><body/></html>", []),
    "empty": (lambda u: "", []),
    "no such joint": (lambda u: u.replace('"swivel"', '"pivot"'), ["swivel", "pivot"]),
    "no inertial": (
        lambda u: edited(u, r'(<link name="fork">\s*)<inertial>.*?</inertial>', r"\1"),
        ["fork", "<inertial>"],
    ),
    "no mass": (lambda u: edited(u, r'<mass value="104.5" />', '<mass value="0" />'), ["chassis", "no mass"]),
    "negative mass": (lambda u: edited(u, r'<mass value="6" />', '<mass value="-6" />'), ["left_wheel", "-6"]),
    "negative inertia": (lambda u: edited(u, r'izz="10.8854"', 'izz="-1"'), ["chassis", "not positive"]),
    "unequal wheels": (lambda u: edited(u, r'<sphere radius="0.125" />', '<sphere radius="0.12" />'), ["radius"]),
    "no effort": (lambda u: edited(u, r'<limit effort="40" velocity="100" />', ""), ["left_drive", "effort"]),
    "words for numbers": (lambda u: edited(u, r'<mass value="104.5" />', '<mass value="heavy" />'), []),
}


class TestBadRobot:
    @pytest.mark.parametrize("name", BAD_URDFS)
    def test_a_bad_urdf_is_one_line_that_names_it(self, run_cli: Cli, here: Path, name: str) -> None:
        change, words = BAD_URDFS[name]
        (here / "tricycle.urdf").write_text(change((ROBOTS / "tricycle.urdf").read_text()))
        (here / "mine.toml").write_text((ROBOTS / "tricycle.toml").read_text())
        (here / "run.toml").write_text('robot = "mine.toml"\n')
        before = sorted(here.iterdir())
        line = refused(run_cli("train", "--config", "run.toml"))
        assert [word for word in ["tricycle.urdf", *words] if word not in line] == []
        assert sorted(here.iterdir()) == before

    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            ('urdf = "tricycle.urdf"', 'urdf = "none.urdf"', ["none.urdf", "no such URDF"]),
            ("wheel_friction", "wheel_grip", ["unknown key 'contact.wheel_grip'", "wheel_friction"]),
            ("yaw_rate = 1.5708", "yaw_rate = 0.0", ["limits.yaw_rate", "greater than 0"]),
            ('swivel = "swivel"', "", ["joints.swivel", "trails"]),
            ('swivel = "swivel"', 'swivel = "elbow"', ["elbow", "caster_roll"]),
            ("[0.35, 0.0, 0.475]", "[0.35, 0.0]", ["sensor.position"]),
        ],
    )
    def test_a_bad_robot_file_is_one_line(self, run_cli: Cli, here: Path, old: str, new: str, words: list[str]) -> None:
        text = (ROBOTS / "tricycle.toml").read_text()
        assert old in text
        (here / "mine.toml").write_text(text.replace(old, new))
        (here / "tricycle.urdf").write_text((ROBOTS / "tricycle.urdf").read_text())
        (here / "run.toml").write_text('robot = "mine.toml"\n')
        line = refused(run_cli("train", "--config", "run.toml"))
        assert [word for word in words if word not in line] == []
        assert len(list(here.iterdir())) == 3

    def test_all_mistakes_of_a_robot_file_are_said_at_once(self, run_cli: Cli, here: Path) -> None:
        (here / "mine.toml").write_text("urdf = 3\nlimit = 4\n[contact]\nwheel_friction = -1.0\n[sensor]\nrays = 71\n")
        line = refused(run_cli("drive", "straight", "--robot", "mine.toml"))
        wrong = [
            "'urdf'",
            "'limit'",
            "'limits' is missing",
            "contact.wheel_friction",
            "contact.rolling_friction",
            "rays",
        ]
        assert [word for word in wrong if word not in line] == []

    def test_a_good_copy_of_the_robot_is_taken(self, run_cli: Cli, here: Path, small_world: Path) -> None:
        for name in ("tricycle.toml", "tricycle.urdf"):
            (here / name).write_text((ROBOTS / name).read_text())
        (here / "run.toml").write_text(f'robot = "tricycle.toml"\nworld = "{small_world}"\nepisodes = 1\n')
        assert run_cli("train", "--config", "run.toml")[0] == 0


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a file system that cannot be written to")
class TestReadOnly:
    def test_train(self, run_cli: Cli, here: Path) -> None:
        assert "/proc/" in refused(run_cli("train", "--episodes", 1, "--out", "/proc/nnql-bullet"))

    def test_drive(self, run_cli: Cli, tiny_run: Path, here: Path, snapshot: Snapshot) -> None:
        before = snapshot(tiny_run)
        assert "/proc/" in refused(run_cli("drive", tiny_run, "--out", "/proc/nnql-bullet"))
        assert snapshot(tiny_run) == before

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
    def test_a_folder_without_permission(self, run_cli: Cli, here: Path) -> None:
        (here / "locked").mkdir(mode=0o500)
        assert "--out" in refused(run_cli("train", "--episodes", 1, "--out", "locked/run"))


def test_drive_into_a_link_to_nothing_is_refused(run_cli: Cli, here: Path) -> None:
    (here / "out").symlink_to("nowhere")
    assert "link to nothing" in refused(run_cli("drive", "straight", "--sim", "kinematic", "--out", "out"))


def test_drive_into_a_file_is_refused(run_cli: Cli, tiny_run: Path, here: Path) -> None:
    (here / "notes").write_text("precious")
    refused(run_cli("drive", tiny_run, "--out", "notes"))
    assert (here / "notes").read_text() == "precious"
