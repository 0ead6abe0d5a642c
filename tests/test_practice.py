"""What researchers expect of a training: to begin with a policy, to log, to evaluate and to stop early."""

import csv
import json
import shutil
import struct
import sys
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import same
from safetensors.numpy import load_file

import nnql_bullet as nb
from nnql_bullet import assets, session
from nnql_bullet.agents.learning.genetic import GeneticOptions
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.presets import load_config
from nnql_bullet.reports.plots import draw_learning_curve
from nnql_bullet.rollout import run_episode
from nnql_bullet.runs import Run
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.sources import changed_sources
from nnql_bullet.task import ENDINGS
from nnql_bullet.training.evaluation import Evaluation, reason_to_stop

Cli = Callable[..., tuple[int, str, str]]

SMALL: dict[str, Any] = {"simulator": "kinematic", "vehicles": 3, "episodes": 6, "seed": 5, "task": {"max_steps": 40}}
KINDS: dict[str, dict[str, Any]] = {
    "nnql": {},
    "q_table": {},
    "genetic": {"population": 2, "worlds": 2, "elites": 1},
    "double_dqn": {
        "hidden": [8],
        "learning_starts": 30,
        "buffer_size": 500,
        "batch_size": 8,
        "exploration_episodes": 2,
    },
    "sb3_dqn": {"hidden": [8], "learning_starts": 8, "buffer_size": 500, "exploration_steps": 20},
}
LIBRARIES = {"genetic": "deap", "sb3_dqn": "stable_baselines3"}


def small(kind: str, **changes: Any) -> dict[str, Any]:
    return {**SMALL, "agent": {"kind": kind, **KINDS[kind]}, **changes}


def train(out: Path, **asked: Any) -> Run:
    """Trains by a preset and keys over it, without a picture."""
    config = load_config("paper", {key: str(its) if isinstance(its, Path) else its for key, its in asked.items()})
    return session.train(config, out, workers=1)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a run."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def policies(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A run of a kind, made when it is first asked for."""
    home = tmp_path_factory.mktemp("policies")

    def run(kind: str) -> Path:
        if kind in LIBRARIES:
            pytest.importorskip(LIBRARIES[kind])
        if not (home / kind).exists():
            train(home / kind, **small(kind))
        return home / kind

    return run


class TestStart:
    @pytest.mark.parametrize("kind", list(KINDS))
    def test_it_begins_with_these_weights_in_another_world_and_goes_on_bit_for_bit(
        self, kind: str, policies: Callable[[str], Path], tmp_path: Path
    ) -> None:
        source = policies(kind)
        asked = small(kind, start_from=source, world="cover_10", seed=6)
        whole = train(tmp_path / "whole", **asked)
        train(tmp_path / "parts", **{**asked, "episodes": 2})
        hidden = source.rename(source.with_name("hidden"))  # the run has a copy
        try:
            session.resume(tmp_path / "parts", 6, workers=1)
        finally:
            hidden.rename(source)
        assert contents(tmp_path / "parts") == contents(tmp_path / "whole")
        drawn = train(tmp_path / "drawn", **{**asked, "start_from": None})
        assert not same(*(load_file(run.folder / "policy.safetensors") for run in (whole, drawn)))
        assert (tmp_path / "whole" / "start.safetensors").read_bytes() == (source / "policy.safetensors").read_bytes()
        digest = sha256((source / "policy.safetensors").read_bytes()).hexdigest()
        assert json.loads((tmp_path / "whole" / "sources.json").read_text())["start"] == {str(source): digest}
        nb.drive(tmp_path / "whole")

    def test_a_run_without_a_checkpoint_goes_on_with_its_copy(
        self, policies: Callable[[str], Path], tmp_path: Path
    ) -> None:
        source = tmp_path / "mine.safetensors"
        source.write_bytes((policies("nnql") / "policy.safetensors").read_bytes())
        whole = train(tmp_path / "whole", **small("nnql", start_from=source))
        cut = tmp_path / "cut"  # as a kill before the first checkpoint leaves it
        cut.mkdir()
        for name in ("config.toml", "sources.json", "start.safetensors"):
            shutil.copy(whole.folder / name, cut)
        source.unlink()
        session.resume(cut, workers=1)
        assert contents(cut) == contents(whole.folder)

    @pytest.mark.parametrize("kind", ["nnql", "q_table", "double_dqn"])
    def test_the_first_decisions_are_those_of_the_policy(self, kind: str, policies: Callable[[str], Path]) -> None:
        source = policies(kind)
        config = load_config("paper", small(kind, start_from=str(source)))
        experiment = Experiment(config)
        experiment.trainer(experiment.navigation)
        assert same(experiment.trainable.state_dict(), load_file(source / "policy.safetensors"))

    def test_both_networks_of_double_dqn_do(self, policies: Callable[[str], Path]) -> None:
        source = policies("double_dqn")
        experiment = Experiment(load_config("paper", small("double_dqn", start_from=str(source), vehicles=1)))
        training = experiment.trainer(experiment.navigation)
        episode = next(training.episodes())
        state = training.state_dict()
        online = {n.removeprefix("agent/online/"): a for n, a in state.items() if n.startswith("agent/online/")}
        assert episode.diagnostics["exploration"] == 1.0  # anew
        assert same(online, load_file(source / "policy.safetensors"))  # too few steps yet to learn from

    def test_a_search_begins_with_the_genome_and_mutants_of_it(self) -> None:
        evolution = pytest.importorskip("nnql_bullet.agents.learning.evolution", reason="needs the extra [baselines]")
        options = GeneticOptions(population=30, mutation_share=0.2, mutation_step=0.1)
        genome = rng(1, Stream.WEIGHTS).normal(size=89)
        first = evolution.mutants(genome, options, rng(2, Stream.WEIGHTS))
        changed = first != genome
        assert first.shape == (30, 89)
        assert not changed[0].any()
        assert abs(changed[1:].mean() - 0.2) < 0.05
        assert abs((first - genome)[changed].std() - 0.1) < 0.02

    def test_the_command_line_says_what_it_begins_with_and_that_schedules_begin_anew(
        self, run_cli: Cli, policies: Callable[[str], Path], small_config: Path, compiled_kernels: None, tmp_path: Path
    ) -> None:
        source = policies("nnql")
        flags = ("--config", small_config, "--sim", "kinematic", "--episodes", 2, "--out", tmp_path / "run")
        code, _, err = run_cli("train", "--from", source, *flags)
        assert code == 0
        assert f"it begins with what '{source}' learned in 6 episodes; schedules of exploration" in err
        assert f'start_from = "{source}"' in (tmp_path / "run" / "config.toml").read_text()
        assert "exploration" not in run_cli("train", "--resume", tmp_path / "run", "--episodes", 3)[2]

    def test_a_shipped_policy_is_kept_and_no_episode_is_its_own(self, tmp_path: Path) -> None:
        run = nb.train("double_dqn", start_from="double_dqn", vehicles=2, episodes=1, out=tmp_path / "run")
        shipped = assets.policies()["double_dqn"]
        assert (run.folder / "start.safetensors").read_bytes() == shipped.read_bytes()
        assert same(load_file(run.folder / "policy.safetensors"), load_file(shipped))  # nothing is learned that soon
        assert run.policy.episodes == 1

    def test_a_policy_that_changed_is_named(self, policies: Callable[[str], Path], tmp_path: Path) -> None:
        source = tmp_path / "mine.safetensors"
        source.write_bytes((policies("nnql") / "policy.safetensors").read_bytes())
        train(tmp_path / "run", **small("nnql", start_from=source, episodes=1))
        assert changed_sources(tmp_path / "run") == {}
        source.write_bytes((policies("q_table") / "policy.safetensors").read_bytes())
        assert changed_sources(tmp_path / "run") == {str(source): "its weights differ"}
        source.unlink()
        assert changed_sources(tmp_path / "run") == {}


def crc32c(data: bytes) -> int:
    """The checksum of RFC 3720, bit by bit."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0x82F63B78 * (crc & 1)
    return crc ^ 0xFFFFFFFF


def masked(data: bytes) -> int:
    """The checksum as records of TensorFlow hold it."""
    crc = crc32c(data)
    return ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF


def logged(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """What TensorBoard shows of a log: steps and numbers by name, without those that a later session took back."""
    event_pb2 = pytest.importorskip("tensorboardX.proto.event_pb2", reason="needs the extra [log]")
    found: dict[str, list[tuple[int, float]]] = {}
    for path in sorted(folder.iterdir()):
        data = path.read_bytes()
        while data:
            length, of_length = struct.unpack("<QI", data[:12])
            record, (of_record,) = data[12 : 12 + length], struct.unpack("<I", data[12 + length : 16 + length])
            assert (of_length, of_record) == (masked(data[:8]), masked(record))
            data = data[16 + length :]
            event = event_pb2.Event.FromString(record)
            if event.session_log.status == event_pb2.SessionLog.START:
                found = {name: [row for row in rows if row[0] < event.step] for name, rows in found.items()}
            for value in event.summary.value:
                found.setdefault(value.tag, []).append((event.step, value.simple_value))
    return found


class TestLog:
    def test_it_has_the_numbers_of_every_episode_once_and_the_run_is_the_same(
        self, run_cli: Cli, small_config: Path, compiled_kernels: None, tmp_path: Path
    ) -> None:
        flags = ("--config", small_config, "--sim", "kinematic", "--vehicles", 2, "--workers", 1)
        plain, parts = tmp_path / "plain", tmp_path / "parts"
        assert run_cli("train", *flags, "--episodes", 4, "--out", parts, "--log", "tensorboard")[0] == 0
        (parts / "learning_curve.png").unlink(), (parts / "README.md").unlink()
        config = nb.load_run(parts, 7).config
        session.train(config, plain, workers=1)
        before = shutil.copytree(parts, tmp_path / "before")
        session.resume(parts, 6, workers=1)
        for path in (parts / "tensorboard").iterdir():  # as after a kill: the log is ahead of the checkpoint
            shutil.copy(path, before / "tensorboard")
        session.resume(before, 7, workers=1)
        found = logged(before / "tensorboard")
        assert all([step for step, _ in rows] == list(range(1, 8)) for rows in found.values())
        shutil.rmtree(before / "tensorboard")
        assert contents(before) == contents(plain)
        with (plain / "episodes.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        goals = [row["ending"] == "goal" for row in rows]
        expected = {
            "episode/return": [float(row["return"]) for row in rows],
            "episode/steps": [float(row["steps"]) for row in rows],
            "learning/td_error": [float(row["td_error"]) for row in rows],
            "learning/temperature": [float(row["temperature"]) for row in rows],
            "success/last_100": [np.mean(goals[:done]) for done in range(1, 8)],
        }
        for name, values in expected.items():
            assert [value for _, value in found[name]] == pytest.approx(values, rel=1e-6), name
        shares = [sum(found[f"endings_of_last_100/{ending}"][i][1] for ending in ENDINGS) for i in range(7)]
        assert shares == pytest.approx([1.0] * 7)
        assert all(speed > 0 for _, speed in found["speed/steps_per_second"])

    def test_a_log_that_begins_late_has_the_episodes_before(self, tmp_path: Path) -> None:
        train(tmp_path / "run", **small("nnql", episodes=2))
        session.resume(tmp_path / "run", 4, workers=1, log="tensorboard")
        assert [step for step, _ in logged(tmp_path / "run" / "tensorboard")["episode/return"]] == [1, 2, 3, 4]

    def test_starting_anew_removes_an_older_log(self, tmp_path: Path) -> None:
        config = load_config("paper", small("nnql", episodes=1))
        session.train(config, tmp_path / "run", log="tensorboard")
        session.train(config, tmp_path / "run", overwrite=True)
        assert not (tmp_path / "run" / "tensorboard").exists()

    def test_a_function_receives_the_same(self, tmp_path: Path) -> None:
        told: list[tuple[int, float]] = []
        config = load_config("paper", small("q_table", episodes=3))
        run = session.train(config, tmp_path / "run", log=lambda done, its: told.append((done, its["episode/return"])))
        assert told == [(i, e.summary.episode_return) for i, e in enumerate(run.episodes, 1)]

    def test_without_the_library_it_is_refused_before_anything_is_written(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setitem(sys.modules, "nnql_bullet.training.tensorboard", None)
        with pytest.raises(UserError, match=r"tensorboardX is not installed; .*\[log\]"):
            session.train(load_config("paper", small("nnql")), tmp_path / "run", log="tensorboard")
        assert not (tmp_path / "run").exists()


def evaluations(*goals: int) -> list[Evaluation]:
    return [Evaluation(10 * i, its, 20) for i, its in enumerate(goals, 1)]


class TestEvaluations:
    @pytest.mark.parametrize("kind", list(KINDS))
    def test_they_change_nothing_and_go_on_as_if_never_stopped(
        self, kind: str, policies: Callable[[str], Path], tmp_path: Path
    ) -> None:
        plain = policies(kind)
        asked = small(kind, training={"evaluate_every": 2, "evaluate_count": 3})
        whole = train(tmp_path / "whole", **asked)
        train(tmp_path / "parts", **{**asked, "episodes": 3})
        session.resume(tmp_path / "parts", 6, workers=1)
        assert contents(tmp_path / "parts") == contents(whole.folder)
        assert [(one.episodes, one.worlds) for one in whole.evaluations] == [(2, 3), (4, 3), (6, 3)]
        for name in ("checkpoint.safetensors", "policy.safetensors"):
            assert same(load_file(whole.folder / name), load_file(plain / name))
        assert (whole.folder / "episodes.csv").read_bytes() == (plain / "episodes.csv").read_bytes()

    def test_each_is_that_of_a_run_stopped_there(self, small_world: Path, tmp_path: Path) -> None:
        keys = {"world": str(small_world), "task": {"max_steps": 60}, "seed": 7}
        evaluated = {"evaluate_every": 4, "evaluate_count": 4, "evaluate_worlds": [str(small_world), "empty"]}
        run = train(tmp_path / "run", **small("nnql", **keys, episodes=8, training=evaluated))
        expected = []
        for episodes in (4, 8):
            policy = train(tmp_path / str(episodes), **small("nnql", **keys, episodes=episodes)).policy
            endings = []
            for world in (str(small_world), "empty"):
                drive = nb.load_policy(policy, {"world": world}).experiment
                driven = (
                    run_episode(drive.navigation, drive.world(its), drive.agent) for its in range(99_996, 100_000)
                )
                endings += [summary.ending for summary in driven]
            expected.append(Evaluation(episodes, endings.count("goal"), 8))
        assert run.evaluations == expected
        assert any(one.goals for one in expected)
        assert (run.folder / "evaluations.csv").read_text().splitlines() == [
            "episodes,goals,worlds",
            *(f"{one.episodes},{one.goals},8" for one in expected),
        ]

    @pytest.mark.parametrize(
        ("goals", "success", "patience", "stops"),
        [
            ((), 0.1, 1, False),
            ((18, 19), 0.95, None, True),
            ((18, 18), 0.95, None, False),
            ((5, 7, 7, 6), None, 2, True),
            ((5, 7, 7), None, 2, False),
            ((5, 7, 6, 8), None, 2, False),
            ((0, 0), None, 1, True),
            ((20,), None, 1, False),
            ((20, 20), None, None, False),
        ],
    )
    def test_what_ends_a_training(
        self, goals: tuple[int, ...], success: float | None, patience: int | None, stops: bool
    ) -> None:
        assert bool(reason_to_stop(evaluations(*goals), success, patience)) == stops

    def test_a_training_that_is_good_enough_stops_selects_and_stays_over(self, run_cli: Cli, tmp_path: Path) -> None:
        config = tmp_path / "config.toml"
        config.write_text(
            'world = "empty"\nsimulator = "kinematic"\nvehicles = 2\n[task]\nmax_steps = 200\n[training]\n'
            "evaluate_every = 2\nevaluate_count = 2\nstop_at_success = 1.0\n[training.selection]\ncount = 2\n"
        )
        out = tmp_path / "run"
        code, said, err = run_cli("train", "--config", config, "--episodes", 9, "--workers", 1, "--out", out)
        assert code == 0
        assert "over after 2 of 9 episodes: 2 goals in 2 validation worlds are enough" in err
        assert f"policy: {out / 'policy.safetensors'}" in said
        assert len(nb.load_run(out).episodes) == nb.load_policy(out).episodes == 2
        assert (out / "selection.csv").is_file()
        before = contents(out)
        code, said, _ = run_cli("train", "--resume", out, "--episodes", 20)
        assert (code, said.strip()) == (
            0,
            f"{out} is over after 2 episodes: 2 goals in 2 validation worlds are enough",
        )
        assert contents(out) == before

    def test_they_are_logged(self, tmp_path: Path) -> None:
        config = load_config("paper", small("nnql", training={"evaluate_every": 2, "evaluate_count": 1}))
        run = session.train(config, tmp_path / "run", workers=1)
        session.resume(tmp_path / "run", 8, workers=1, log="tensorboard")
        assert logged(run.folder / "tensorboard")["success/validation"] == [(i, 0.0) for i in (2, 4, 6, 8)]

    @pytest.mark.parametrize("key", ["patience", "stop_at_success", "evaluate_worlds", "evaluate_count"])
    def test_keys_of_evaluations_without_these_are_refused(self, key: str) -> None:
        value = {"patience": 3, "stop_at_success": 0.5, "evaluate_worlds": ["traps"], "evaluate_count": 3}[key]
        with pytest.raises(UserError, match=f"{key} needs evaluations; give evaluate_every too"):
            load_config("paper", {"training": {key: value}})

    @pytest.mark.parametrize("text", ["", "episodes,goals,worlds\n", "episodes,goals,worlds\n2,x,1\n", "a\n1\n"])
    def test_a_damaged_table_is_refused(self, text: str, tmp_path: Path) -> None:
        train(tmp_path / "run", **small("nnql", training={"evaluate_every": 2, "evaluate_count": 1}))
        (tmp_path / "run" / "evaluations.csv").write_text(text)
        with pytest.raises(UserError, match=r"evaluations\.csv: "):
            nb.load_run(tmp_path / "run")

    def test_the_learning_curve_shows_them(self, tmp_path: Path) -> None:
        run = train(tmp_path / "run", **small("q_table", episodes=2))
        draw_learning_curve(run.episodes, tmp_path / "with.png", evaluations=[Evaluation(2, 1, 2)])
        draw_learning_curve(run.episodes, tmp_path / "without.png")
        assert (tmp_path / "with.png").read_bytes() != (tmp_path / "without.png").read_bytes()


class TestRefused:
    @pytest.mark.parametrize(
        ("source", "agent", "said"),
        [
            ("nnql", {"kind": "q_table"}, "it is a nnql, and this run trains a q_table"),
            ("nnql", {"kind": "nnql", "hidden_units": 8}, "weights are for agent.hidden_units 6, and this run has 8"),
            ("nnql", {"kind": "nnql", "encoding": "distance"}, "agent.encoding proximity, and this run has distance"),
            ("q_table", {"kind": "q_table", "sectors": [0]}, "agent.sectors (0, 1, 7), and this run has (0,)"),
            ("nnql", {"kind": "straight"}, "'straight' is a rule"),
        ],
    )
    def test_weights_of_another_agent(
        self, source: str, agent: dict[str, Any], said: str, policies: Callable[[str], Path], tmp_path: Path
    ) -> None:
        with pytest.raises(UserError) as refusal:
            train(tmp_path / "run", **{**SMALL, "agent": agent}, start_from=policies(source))
        assert said in str(refusal.value)
        assert not (tmp_path / "run").exists()

    def test_what_is_no_policy(self, tmp_path: Path) -> None:
        with pytest.raises(UserError, match=r"no such run or policy file, and no shipped policy; these are: .*tuned"):
            train(tmp_path / "run", **SMALL, start_from="nothing")
        assert not (tmp_path / "run").exists()

    def test_an_agent_of_ones_own(self, policies: Callable[[str], Path], tmp_path: Path) -> None:
        agent = Experiment(load_config("paper", {})).trainable
        with pytest.raises(UserError, match="an agent of your own begins with what it has learned"):
            nb.train("paper", agent=agent, **SMALL, start_from=policies("nnql"), out=tmp_path / "run")

    def test_to_overwrite_what_it_begins_from(self, policies: Callable[[str], Path]) -> None:
        source = policies("nnql")
        before = contents(source)
        with pytest.raises(UserError, match="is what the training begins from"):
            nb.train("paper", **small("nnql", start_from=source), out=source, overwrite=True)
        assert contents(source) == before
