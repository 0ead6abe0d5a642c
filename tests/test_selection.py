"""Selection: the best of the late states is the policy, however the run came to its end."""

import csv
import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import same
from safetensors.numpy import load_file

from nnql_bullet.agents.learning.nnql import Nnql
from nnql_bullet.agents.learning.options import NnqlOptions
from nnql_bullet.cli import main
from nnql_bullet.config import to_values
from nnql_bullet.env import Navigation
from nnql_bullet.evaluation.ablation import AblationTask, Counts, train_and_test
from nnql_bullet.experiment import Experiment
from nnql_bullet.presets import load_config
from nnql_bullet.rollout import run_episode
from nnql_bullet.run_config import changed
from nnql_bullet.runs import load_policy
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import ENDINGS
from nnql_bullet.training.selection import Candidates, SelectionOptions, finalists, keep, most_goals, seeds

Cli = Callable[..., tuple[int, str, str]]
Train = Callable[..., tuple[int, str, str]]

SELECTION = "\n[training.selection]\ncandidates = 3\nevery = 4\ncount = 12\n"
TOTAL = 18
"""Episodes of the whole run: what was learned after 12, 16 and 18 is tried, and with seed 7 that after 16 is best."""


class TestCandidates:
    @pytest.mark.parametrize(
        ("total", "expected"),
        [(3, [3]), (4, [4]), (6, [4, 6]), (12, [4, 8, 12]), (13, [8, 12, 13]), (20, [12, 16, 20])],
    )
    def test_the_last_multiples_and_the_end_are_tried(self, total: int, expected: list[int]) -> None:
        agent, candidates = Nnql(NnqlOptions(), 0), Candidates()
        for episodes in range(1, total + 1):
            agent.load_state_dict({name: np.full_like(values, episodes) for name, values in agent.state_dict().items()})
            keep(candidates, episodes, agent, SelectionOptions(candidates=3, every=4))
        found = finalists(candidates, total, agent, SelectionOptions(candidates=3, every=4))
        assert list(found) == expected
        assert all((values == episodes).all() for episodes, its in found.items() for values in its.values())

    @pytest.mark.parametrize(
        ("goals", "best"), [({4: 7, 8: 9, 12: 8}, 8), ({4: 9, 8: 9, 12: 8}, 8), ({4: 9, 8: 8, 12: 9}, 12), ({5: 0}, 5)]
    )
    def test_the_most_goals_win_and_of_equals_the_later(self, goals: dict[int, int], best: int) -> None:
        assert most_goals(goals) == best

    def test_it_is_tried_in_the_last_validation_worlds(self) -> None:
        assert seeds(3) == range(99_997, 100_000)

    @pytest.mark.parametrize(
        ("changes", "names"),
        [
            ({}, ["paper"]),
            ({"world": "cover_10"}, ["cover_10"]),
            ({"training": {"worlds": ["cover_10", "traps", "cover_10"]}}, ["cover_10", "traps"]),
            ({"training": {"worlds": ["traps"], "selection": {"worlds": ["cover_15"]}}}, ["cover_15"]),
        ],
    )
    def test_worlds_are_those_of_the_training_unless_given(self, changes: dict[str, Any], names: list[str]) -> None:
        config = changed(load_config("paper", {"training": {"selection": {"count": 2}}}), **changes)
        worlds = Experiment(config).selection_worlds
        assert [(world.name, world.seed) for world in worlds] == [
            (name, seed) for name in names for seed in (99_998, 99_999)
        ]


@pytest.fixture(scope="module")
def selecting_config(tmp_path_factory: pytest.TempPathFactory, small_config: Path) -> Path:
    """Short episodes, and three candidates."""
    path = tmp_path_factory.mktemp("selecting") / "selecting.toml"
    path.write_text(small_config.read_text() + SELECTION)
    return path


KINEMATIC = ("--sim", "kinematic", "--vehicles", "3", "--workers", "1", "--seed", "7")


@pytest.fixture
def train(run_cli: Cli, selecting_config: Path, compiled_kernels: None) -> Train:
    """Trains in the small world with a selection."""

    def run(folder: Path, count: int, config: Path = selecting_config) -> tuple[int, str, str]:
        return run_cli("train", "--config", config, *KINEMATIC, "--episodes", count, "--out", folder)

    return run


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, selecting_config: Path) -> Path:
    """A run that was never stopped, to be read only."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    flags = [*KINEMATIC, "--episodes", str(TOTAL), "--out", str(folder)]
    assert main(["train", "--config", str(selecting_config), *flags]) == 0
    return folder


def rows(folder: Path) -> list[dict[str, int]]:
    with (folder / "selection.csv").open(newline="") as file:
        return [{name: int(value) for name, value in row.items()} for row in csv.DictReader(file)]


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a run."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def driven(policy: Path, world: str | None, seeds: range) -> list[str]:
    """How a policy's drives end in the kinematic model, one vehicle after the other."""
    experiment = load_policy(policy, {"world": world}).experiment
    navigation = Navigation(KinematicSimulator(experiment.vehicle, experiment.config.drive, 1), experiment.config.task)
    return [run_episode(navigation, experiment.world(seed), experiment.agent).ending for seed in seeds]


class TestRun:
    def test_each_candidate_is_the_policy_of_a_run_stopped_there_and_the_best_is_taken(
        self, whole: Path, train: Train, small_config: Path, tmp_path: Path
    ) -> None:
        found = rows(whole)
        assert [row["episodes"] for row in found] == [12, 16, 18]
        goals = {}
        for row in found:
            folder = tmp_path / str(row["episodes"])
            assert train(folder, row["episodes"], small_config)[0] == 0
            goals[row["episodes"]] = driven(folder, None, range(99_988, 100_000)).count("goal")
            assert (row["goals"], row["worlds"]) == (goals[row["episodes"]], 12)
            policy = load_file(whole / "policy.safetensors")
            assert not row["selected"] or same(policy, load_file(folder / "policy.safetensors"))
        assert [row["selected"] for row in found] == [0, 1, 0]
        assert max(row["goals"] for row in found) == next(row["goals"] for row in found if row["selected"])
        checkpoint = load_file(whole / "checkpoint.safetensors")
        without = {name: values for name, values in checkpoint.items() if not name.startswith("candidate/")}
        assert same(without, load_file(tmp_path / "18" / "checkpoint.safetensors"))
        assert (whole / "episodes.csv").read_bytes() == (tmp_path / "18" / "episodes.csv").read_bytes()

    def test_what_was_selected_is_said_and_marked(self, train: Train, tmp_path: Path) -> None:
        _, _, err = train(tmp_path / "run", TOTAL)
        best = next(row for row in rows(tmp_path / "run") if row["selected"])
        assert f"selected: what was learned after {best['episodes']} episodes, with {best['goals']} goals of 12" in err
        assert load_policy(tmp_path / "run", {}).episodes == best["episodes"]

    def test_contact_physics_changes_nothing_about_where_it_is_tried(
        self, run_cli: Cli, selecting_config: Path, compiled_kernels: None, tmp_path: Path
    ) -> None:
        code, _, err = run_cli("train", "--config", selecting_config, "--episodes", 5, "--out", tmp_path / "run")
        assert code == 0
        assert "in the kinematic model" in err
        best = next(row for row in rows(tmp_path / "run") if row["selected"])
        assert best["goals"] == driven(tmp_path / "run", None, range(99_988, 100_000)).count("goal")

    def test_a_world_that_is_not_there_is_refused_before_anything_is_written(
        self, run_cli: Cli, small_config: Path, tmp_path: Path
    ) -> None:
        config = tmp_path / "config.toml"
        config.write_text(small_config.read_text() + SELECTION + 'worlds = ["cover_11"]\n')
        code, _, err = run_cli("train", "--config", config, "--out", tmp_path / "run")
        assert code == 2
        assert "cover_11" in err
        assert not (tmp_path / "run").exists()


class TestResume:
    @pytest.mark.parametrize("first", [3, 13])
    def test_in_two_parts_is_bit_for_bit_as_in_one(
        self, first: int, whole: Path, train: Train, run_cli: Cli, tmp_path: Path
    ) -> None:
        folder = tmp_path / "parts"
        assert train(folder, first)[0] == 0
        assert (folder / "selection.csv").is_file()
        assert run_cli("train", "--resume", folder, "--episodes", TOTAL, "--workers", 1)[0] == 0
        assert contents(folder) == contents(whole)

    def test_after_an_interrupt_too(
        self, whole: Path, train: Train, run_cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        real, calls = KinematicSimulator.advance, []

        def advance(self: KinematicSimulator, *args: Any) -> Any:
            calls.append(args)
            if len(calls) == 20:
                os.kill(os.getpid(), signal.SIGINT)
            return real(self, *args)

        folder = tmp_path / "stopped"
        with monkeypatch.context() as patch:
            patch.setattr(KinematicSimulator, "advance", advance)
            assert train(folder, TOTAL)[0] == 130
        assert not (folder / "selection.csv").exists()
        assert run_cli("train", "--resume", folder, "--workers", 1)[0] == 0
        assert contents(folder) == contents(whole)

    def test_a_selection_that_was_cut_short_is_made_up_for(
        self, whole: Path, train: Train, run_cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def try_out(self: Experiment, *args: Any) -> None:
            raise KeyboardInterrupt

        folder = tmp_path / "cut"
        with monkeypatch.context() as patch:
            patch.setattr(Experiment, "try_out", try_out)
            assert train(folder, TOTAL)[0] != 0
        assert not (folder / "selection.csv").exists()
        assert run_cli("train", "--resume", folder, "--workers", 1)[0] == 0
        assert contents(folder) == contents(whole)
        assert "18 episodes already" in run_cli("train", "--resume", folder)[1]
        assert contents(folder) == contents(whole)


def test_the_ablation_tests_what_a_run_would_have_selected(whole: Path, selecting_config: Path) -> None:
    config = load_config(str(selecting_config), {"simulator": "kinematic", "vehicles": 3, "seed": 7, "episodes": TOTAL})
    expected = []
    tiers = ("paper", "cover_10")
    for world in tiers:
        endings = driven(whole, world, range(4))
        expected.append(Counts(world, *(endings.count(ending) for ending in ENDINGS)))
    assert train_and_test(AblationTask(json.dumps(to_values(config)), 0, tiers, 4, "")) == expected
