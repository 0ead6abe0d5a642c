"""Options of drives: every verb that drives takes them alike, and results are kept apart by them."""

import json
import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest

from nnql_bullet import ablate, check_fidelity, drive, failures
from nnql_bullet.cli.flags import ELSEWHERE, parse
from nnql_bullet.cli.parser import VERBS, verb_of
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.drives import Drawn, DriveTask, Tier
from nnql_bullet.evaluation.policies import open_policies
from nnql_bullet.fidelity.envelope import envelope_slices
from nnql_bullet.fidelity.probe import Bench
from nnql_bullet.fidelity.stopping import stopping_tasks
from nnql_bullet.run_config import frozen_keys
from nnql_bullet.setting import Setting
from nnql_bullet.vehicle.spec import VehicleSpec

Cli = Callable[..., tuple[int, str, str]]

DRIVES = {
    **{"train": (), "drive": (), "evaluate": ("straight",), "gap": ("straight",), "barn": ("BARN", "straight")},
    **{"ablate": (), "render": ("vfh",)},
}
"""Verbs that drive, and arguments without which they are not called."""
GIVEN = {
    "--robot tricycle": {"robot": "tricycle"},
    "--drive.speed 0.5": {"drive": {"speed": 0.5}},
    "--rays 144": {"conditions": {"rays": 144}},
    "--sensor-range 5": {"conditions": {"sensor_range": 5.0}},
    "--blind-arc 170 190": {"conditions": {"blind_arc_degrees": (170.0, 190.0)}},
    "--conditions.payload 40": {"conditions": {"payload": 40.0}},
    "--shield.least-width 0.02 --shield.margin 0.1": {"shield": {"least_width": 0.02, "margin": 0.1}},
    "--task.max-steps 9": {"task": {"max_steps": 9}},
}
WIDEST = 101


def called(verb: str, arguments: list[str]) -> Any:
    """The call of a verb that arguments stand for, which is not made."""
    return parse(verb_of(verb), f"nnql-bullet {verb}", arguments)


def keys_of(verb: str, arguments: list[str]) -> Any:
    """The values of a configuration that arguments of a verb that drives stand for."""
    given = called(verb, [*DRIVES[verb], *arguments]).keywords
    return given["drives"].keys if "drives" in given else given["keys"]


class TestFlags:
    @pytest.mark.parametrize("verb", DRIVES)
    @pytest.mark.parametrize("flags", GIVEN)
    def test_every_verb_that_drives_takes_it(self, verb: str, flags: str) -> None:
        assert keys_of(verb, flags.split()) == GIVEN[flags]

    @pytest.mark.parametrize("verb", [verb for verb in DRIVES if verb != "render"])  # where it is the film's
    def test_speed_is_short_for_the_key(self, verb: str) -> None:
        assert keys_of(verb, ["--speed", "0.5"]) == {"drive": {"speed": 0.5}}

    @pytest.mark.parametrize("verb", ["fidelity", "envelope"])
    def test_a_bench_has_a_robot_and_a_speed(self, verb: str) -> None:
        given = called(verb, ["--robot", "r.toml", "--speed", "0.5"]).keywords
        assert (given["robot"], given["speed"]) == ("r.toml", 0.5)

    @pytest.mark.parametrize("verb", ELSEWHERE)
    @pytest.mark.parametrize("flag", ["--robot", "--speed", "--seeds", "--shield"])
    def test_a_verb_without_drives_says_where_it_belongs(self, run_cli: Cli, verb: str, flag: str) -> None:
        code, out, err = run_cli(verb, "what", flag, "x")
        assert (code, out) == (2, "")
        assert f"{flag}: {ELSEWHERE[verb]}" in err


class TestHelp:
    @pytest.mark.parametrize("verb", VERBS)
    def test_it_is_short_and_its_examples_are_right(self, run_cli: Cli, verb: str) -> None:
        text = run_cli(verb, "--help")[1]
        assert len(text.splitlines()) <= 95
        about, _, examples = text.partition("For example:\n")
        assert all(len(line) <= WIDEST for line in about.splitlines() if not line.startswith("usage:"))
        assert examples or verb == "doctor"
        for line in examples.splitlines():
            words = shlex.split(line)
            if words[:1] == ["nnql-bullet"]:
                called(words[1], words[2:])  # raises if one is wrong

    def test_what_it_says_of_keys_is_right(self, run_cli: Cli) -> None:
        for name in re.findall(r"--(conditions\.[a-z-]+|shield\.[a-z-]+)", run_cli("drive", "--help")[1]):
            called("drive", [f"--{name}", "1"])


class TestParts:
    def test_they_are_kept_apart_by_all_that_a_policy_drives_with(self, other_robot: Path) -> None:
        tier = Tier("t", "t", None, (Drawn("t", 0, "0"),), False)
        bare = Setting("kinematic", "reference")
        asked = (*GIVEN.values(), {"drive": {"speed": 0.6}}, {"shield": {"margin": 0.2}}, {"robot": str(other_robot)})
        keys = [frozen_keys(its) for its in asked if "conditions" not in its]
        parts = []
        for its in ((), *keys):
            setting = replace(bare, keys=its)
            plain, shielded = open_policies("straight", True, setting.robot)
            parts.append([DriveTask(policy, tier, setting, 0).part for policy in (plain, shielded)])
        same = parts[1 + keys.index((("robot", "tricycle"),))]
        assert same == parts[0]  # the robot that it drives anyway
        others = [pair for pair in parts if pair is not same]
        assert all(a[1] != b[1] for a, b in combinations(others, 2))
        of_shield = [pair[0] for its, pair in zip(((), *keys), parts, strict=True) if "shield" in str(its)]
        assert set(of_shield) == {parts[0][0]}  # what holds in a shield alone changes nothing without one

    def test_a_robot_whose_file_changes_is_another_one(self, other_robot: Path) -> None:
        (before,) = open_policies("straight", robot=str(other_robot))
        other_robot.write_text(re.sub(r"yaw_rate = .*", "yaw_rate = 0.3", other_robot.read_text()))
        (after,) = open_policies("straight", robot=str(other_robot))
        assert before.fingerprint == after.fingerprint
        assert before.vehicle != after.vehicle


class TestResults:
    def test_they_name_the_robot_and_go_on_with_it(
        self, run_cli: Cli, tmp_path: Path, other_robot: Path, small_world: Path
    ) -> None:
        where = ("--world", small_world, "--worlds", 2, "--sim", "kinematic", "--task.max-steps", 3)
        asked = (*where, "--robot", other_robot, "--speed", 0.5, "--executor", "inline")
        out = tmp_path / "out"
        code, said, err = run_cli("evaluate", "double_dqn", *asked, "--shield.margin", 0.1, "--out", out)
        assert code == 0, err
        assert "robot other, speed 0.5" in said
        assert "double_dqn was trained on the robot 'tricycle' and drives 'other' here" in err
        assert "no episode can reach it" in err
        values = json.loads((out / "results.json").read_text())
        assert (values["robots"], values["keys"]["drive.speed"]) == (["other"], 0.5)
        bare, shielded = (one["replay"] for one in values["failures"])
        assert "--shield.margin 0.1" in shielded
        assert "--shield" not in bare
        assert len(failures(out).rows) == 4
        kept = out / "robot" / "other.toml"
        kept.write_text(kept.read_text().replace("yaw_rate = 0.5", "yaw_rate = 0.3"))
        with pytest.raises(UserError, match="the robot 'other' is not what it was"):
            failures(out)

    def test_a_speed_beyond_the_robot_is_refused_even_if_it_is_the_default(self, other_robot: Path) -> None:
        text = other_robot.read_text().replace("[limits]", "[limits]\nspeed = 0.4")
        other_robot.write_text(text)
        with pytest.raises(UserError, match=r"drives at 0\.4 m/s at most, not at 2 m/s"):
            drive("straight", simulator="kinematic", robot=other_robot, speed=2.0)

    def test_an_envelope_is_about_the_speed_of_the_vehicle(self, vehicle: VehicleSpec) -> None:
        with pytest.raises(UserError, match="at 2 m/s at most, not at 3 m/s"):
            check_fidelity(vehicle, speed=3.0)
        for spec, speed in ((vehicle, 2.0), (vehicle.driving_at(0.5), 0.5)):
            (speeds, *_), stops = envelope_slices(spec), stopping_tasks(Bench(spec))
            assert speeds.values == tuple(speed * share / 4 for share in range(2, 9))
            assert {task.speed for task in stops} == {speed * count / 2 for count in range(1, 13)}

    def test_an_ablation_refuses_a_key_that_it_varies(self) -> None:
        with pytest.raises(UserError, match=r"'drive\.decision_period' is what the factor 'period' varies"):
            ablate("paper", only=["period"], changes={"drive": {"decision_period": 0.25}})


@pytest.fixture
def other_robot(tmp_path: Path) -> Path:
    """A copy of the shipped robot that turns more slowly."""
    shipped = Path(__file__).resolve().parents[1] / "robots"
    (tmp_path / "tricycle.urdf").write_bytes((shipped / "tricycle.urdf").read_bytes())
    path = tmp_path / "other.toml"
    path.write_text(re.sub(r"yaw_rate = .*", "yaw_rate = 0.5", (shipped / "tricycle.toml").read_text()))
    return path
