"""Training with one vehicle and with many: the paper's order of things, and going on bit for bit."""

import csv
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import Stop, begun, ending, going_on, learn, same, stops
from helpers import row as of_vehicle
from numpy.typing import NDArray
from safetensors.numpy import load_file

from nnql_bullet.agents import LearningAgent
from nnql_bullet.agents.learning.nnql import Nnql
from nnql_bullet.env import Navigation, Observation, Transition
from nnql_bullet.errors import UserError, WorkerDied
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Actions, EpisodeSummary, PolicyState
from nnql_bullet.run_config import RunConfig
from nnql_bullet.seeding import Stream, rng, training_world_seed
from nnql_bullet.sim.base import Motion, Simulator, Traces
from nnql_bullet.sim.faults import FaultySimulator, SensorFaults
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import REWARD_TERMS, StateProperty, TaskOptions
from nnql_bullet.training.loop import Training, TrainingEpisode
from nnql_bullet.worlds.spec import WorldSpec

Cli = Callable[..., tuple[int, str, str]]
Arrays = dict[str, NDArray[Any]]
LIMIT = 60.0
"""Seconds after which a wait is given up: far more than a noisy machine needs."""


@dataclass
class Parts:
    """A training and what it is made of."""

    experiment: Experiment
    agent: LearningAgent
    simulator: Simulator
    training: Training


@pytest.fixture
def parts(small_world: Path) -> Iterator[Callable[..., Parts]]:
    """Makes trainings in the small world, on the kinematic model unless told otherwise; what it wraps may be looked
    into."""
    made: list[Simulator] = []

    def make(
        vehicles: int,
        agent: Callable[[LearningAgent], LearningAgent] = lambda agent: agent,
        around: Callable[[Simulator], Simulator] = lambda simulator: simulator,
        max_steps: int = 40,
        simulator: str = "kinematic",
        world: Path = small_world,
    ) -> Parts:
        config = RunConfig(
            seed=5,
            vehicles=vehicles,
            simulator=simulator,  # type: ignore[arg-type]
            world=str(world),
            task=TaskOptions(max_steps=max_steps),
        )
        experiment = Experiment(config)
        made.append(experiment.new_simulator(1))
        inner, learner = around(made[-1]), agent(experiment.learning_agent)
        navigation = Navigation(inner, config.task)
        return Parts(experiment, learner, inner, Training(learner, navigation, experiment.training_world, config.seed))

    yield make
    for one in made:
        one.close()


class Spy:
    """An agent whose training is written down."""

    def __init__(self, agent: LearningAgent) -> None:
        self._agent = agent
        self.asked: list[list[int]] = []
        """Which episodes the vehicles were in, at each step."""
        self.uniforms: list[list[float]] = []
        self.errors: dict[int, list[float]] = {}
        """What `learn` gave, by episode."""

    def act_exploring(
        self, observations: Observation, state: PolicyState, episodes: NDArray[np.int64], uniforms: Array
    ) -> tuple[Actions, PolicyState]:
        self.asked.append(episodes.tolist())
        self.uniforms.append(uniforms.tolist())
        return self._agent.act_exploring(observations, state, episodes, uniforms)

    def learn(self, transitions: Transition, state: PolicyState, episodes: NDArray[np.int64]) -> Array:
        errors = self._agent.learn(transitions, state, episodes)
        for episode, error in zip(self.asked[-1], errors.tolist(), strict=True):
            self.errors.setdefault(episode, []).append(error)
        return errors

    def __getattr__(self, name: str) -> Any:
        return getattr(self._agent, name)


class Mortal:
    """A simulator that dies at one of its calls."""

    def __init__(self, simulator: Simulator, verb: str, call: int) -> None:
        self._simulator, self._verb, self._left = simulator, verb, call
        self.size, self.vehicle, self.drive = simulator.size, simulator.vehicle, simulator.drive

    def _count(self, verb: str) -> None:
        self._left -= verb == self._verb
        if self._left < 0:
            raise WorkerDied("worker 1 of 1 died")

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        self._count("reset")
        return self._simulator.reset(worlds)

    def advance(
        self,
        heading_changes: Array,
        active: NDArray[np.bool_] | None = None,
        speed_scales: Array | None = None,
        traces: Traces | None = None,
    ) -> tuple[Motion, Array]:
        self._count("advance")
        return self._simulator.advance(heading_changes, active, speed_scales, traces)

    def close(self) -> None:
        self._simulator.close()


def online(experiment: Experiment, episodes: int) -> tuple[list[TrainingEpisode], Arrays]:
    """The paper's online learning, written down anew: one vehicle, one step, one update."""
    config = experiment.config
    agent = Nnql(config.agent, config.seed)
    found = []
    with closing(KinematicSimulator(experiment.vehicle, config.drive, 1)) as simulator:
        navigation = Navigation(simulator, config.task)
        for episode in range(episodes):
            world = experiment.world(training_world_seed(config.seed, episode))
            uniforms = rng(config.seed, Stream.POLICY, episode).random(config.task.max_steps)
            observation = begun(navigation, world)
            steps, errors = [], []
            while not steps or ending(steps[-1]) is None:
                chance = uniforms[len(steps) : len(steps) + 1]
                actions, _ = agent.act_exploring(observation, None, np.array([episode]), chance)
                steps.append(navigation.step(actions))
                errors += learn(agent, steps[-1]).tolist()
                observation = steps[-1].s_t
            learned = [error for error in errors if error == error]
            diagnostics = agent.diagnostics(episode)
            diagnostics["td_error"] = sqrt(sum(error**2 for error in learned) / max(len(learned), 1))
            found.append(TrainingEpisode(episode, summed_up(world.seed, steps), diagnostics))
    return found, agent.state_dict()


def summed_up(world_seed: int, steps: list[Transition]) -> EpisodeSummary:
    motions = [of_vehicle(t.motion, 0) for t in steps]
    return EpisodeSummary(
        world_seed=world_seed,
        ending=str(ending(steps[-1])),
        steps=len(steps),
        duration=sum(m.duration for m in motions),
        path_length=sum(m.path_length for m in motions),
        clearance=min(m.clearance for m in motions),
        mean_clearance=sum(m.clearance for m in motions) / len(steps),
        lateral_acceleration=max(abs(m.path_length / m.duration * m.yaw_rate) for m in motions),
        heading_error=sqrt(sum(m.heading_error**2 for m in motions) / len(steps)),
        non_safe_steps=sum(t.s_tm1.state_property[0] == StateProperty.NON_SAFE for t in steps),
        episode_return=sum(t.r_t.item() for t in steps),
        terms={name: sum(t.terms[0, k].item() for t in steps) for k, name in enumerate(REWARD_TERMS)},
    )


NUMBERS = (
    *("duration", "path_length", "clearance", "mean_clearance", "lateral_acceleration", "heading_error"),
    "episode_return",
)


class TestOneVehicle:
    def test_it_is_the_papers_online_learning(self, parts: Callable[..., Parts]) -> None:
        made = parts(1, max_steps=60)
        found = list(islice(made.training.episodes(), 10))
        expected, weights = online(made.experiment, 10)
        for one, other in zip(found, expected, strict=True):
            s, e = one.summary, other.summary
            for name in ("world_seed", "ending", "steps", "non_safe_steps"):
                assert getattr(s, name) == getattr(e, name), name
            for name in NUMBERS:
                assert getattr(s, name) == pytest.approx(getattr(e, name), abs=1e-12), name
            assert s.terms == pytest.approx(e.terms, abs=1e-12)
            assert one.episode == other.episode
            assert one.diagnostics == pytest.approx(other.diagnostics, abs=1e-12)
        assert same(made.agent.state_dict(), weights)
        assert len({episode.summary.ending for episode in found}) > 1
        assert sum(episode.summary.non_safe_steps for episode in found) > 50


class TestOrder:
    def test_a_vehicle_takes_the_next_episode_that_nobody_has_begun(self, parts: Callable[..., Parts]) -> None:
        made = parts(5, agent=Spy)
        found = list(islice(made.training.episodes(), 25))
        length = {episode.episode: episode.summary.steps for episode in found}
        driving, begun, order = [None] * 5, 0, []
        left: list[int] = [0] * 5
        for asked in made.agent.asked:  # type: ignore[attr-defined]
            for vehicle in range(5):
                if left[vehicle] == 0:
                    driving[vehicle], left[vehicle] = begun, length.get(begun, 10**6)
                    begun += 1
            assert asked == driving
            left = [steps - 1 for steps in left]
            order += [driving[vehicle] for vehicle in range(5) if left[vehicle] == 0]
        assert [episode.episode for episode in found] == order[:25]
        assert order != sorted(order)

    def test_each_episode_is_in_the_world_and_with_the_chance_of_its_number(self, parts: Callable[..., Parts]) -> None:
        made = parts(5, agent=Spy)
        for episode in islice(made.training.episodes(), 15):
            assert episode.summary.world_seed == training_world_seed(5, episode.episode)
        step = [0] * 100
        for asked, uniforms in zip(made.agent.asked, made.agent.uniforms, strict=True):  # type: ignore[attr-defined]
            for episode, uniform in zip(asked, uniforms, strict=True):
                assert uniform == rng(5, Stream.POLICY, episode).random(40)[step[episode]]
                step[episode] += 1

    def test_every_vehicle_drives_all_the_time(self, parts: Callable[..., Parts]) -> None:
        driven: list[list[bool]] = []

        class Watched(Mortal):
            def advance(self, heading_changes: Array, active: NDArray[np.bool_] | None = None, *more: Any) -> Any:
                driven.append(active)
                return super().advance(heading_changes, active, *more)

        made = parts(5, around=lambda simulator: Watched(simulator, "", 1))
        finished = sum(episode.summary.steps for episode in islice(made.training.episodes(), 15))
        assert all(active is None for active in driven)  # which is everybody
        arrays = made.training.state_dict()
        under_way = (arrays["actions"] != -1).sum()  # the vehicle whose episode was given out last has none
        assert finished + under_way == 5 * len(driven)

    def test_the_error_of_an_episode_is_the_rms_over_its_updates(self, parts: Callable[..., Parts]) -> None:
        made = parts(5, agent=Spy)
        partly = 0
        for episode in islice(made.training.episodes(), 15):
            errors = made.agent.errors[episode.episode]  # type: ignore[attr-defined]
            assert len(errors) == episode.summary.steps
            learned = [error for error in errors if error == error]
            assert len(learned) == episode.summary.non_safe_steps
            rms = sqrt(sum(error**2 for error in learned) / max(len(learned), 1))
            assert episode.diagnostics["td_error"] == pytest.approx(rms, rel=1e-12)
            partly += 0 < len(learned) < len(errors)
        assert partly > 3


def assert_same(one: Stop, other: Stop) -> None:
    assert one.done == other.done
    assert same(one.learned, other.learned)
    assert same(one.under_way, other.under_way)


class TestGoingOn:
    def test_it_is_as_if_it_had_never_stopped(self, parts: Callable[..., Parts]) -> None:
        whole = stops(parts(5, max_steps=12), 16)
        at_once = 0
        for stop in whole[:-1]:
            assert_same(going_on(parts(5, max_steps=12), stop, 16), whole[-1])
            at_once += (stop.under_way["actions"] != -1).sum(axis=1).tolist().count(12) > 0
        assert at_once >= 2  # stops between two episodes that ended at the same time

    def test_stopping_at_every_episode(self, parts: Callable[..., Parts]) -> None:
        whole = stops(parts(3), 9)
        stop = whole[0]
        for episodes in range(2, 10):
            stop = going_on(parts(3), stop, episodes)
        assert_same(stop, whole[-1])

    def test_with_noisy_sensors(self, parts: Callable[..., Parts]) -> None:
        noisy = partial(FaultySimulator, faults=SensorFaults(noise=0.2))
        whole = stops(parts(3, around=noisy), 8)
        for stop in whole[0], whole[3]:
            assert_same(going_on(parts(3, around=noisy), stop, 8), whole[-1])
        assert whole[-1].done != stops(parts(3), 8)[-1].done

    @pytest.mark.parametrize("simulator", ["kinematic", pytest.param("bullet", marks=pytest.mark.slow)])
    def test_in_a_world_with_boxes_that_move(
        self, parts: Callable[..., Parts], small_world: Path, tmp_path: Path, simulator: str
    ) -> None:
        """Replayed actions meet the same boxes at the same times."""
        moving = tmp_path / "moving.toml"
        table = "[patrols]\ncount = 5\nmax_side = 1.5\nmin_track = 4.0\nmax_track = 10.0\nclear_radius = 3.0\n"
        moving.write_text(f'base = "{small_world}"\n{table}')
        whole = stops(parts(3, simulator=simulator, world=moving), 8)
        for stop in whole[0], whole[3]:
            assert_same(going_on(parts(3, simulator=simulator, world=moving), stop, 8), whole[-1])
        assert whole[-1].done != stops(parts(3, simulator=simulator), 8)[-1].done

    @pytest.mark.slow
    def test_in_contact_physics(self, parts: Callable[..., Parts]) -> None:
        whole = stops(parts(3, simulator="bullet"), 8)
        for stop in whole[0], whole[3]:
            assert_same(going_on(parts(3, simulator="bullet"), stop, 8), whole[-1])

    @pytest.mark.parametrize(("verb", "call"), [("reset", 0), ("advance", 0), ("advance", 9), ("reset", 4)])
    def test_after_a_death_it_goes_on_from_before_the_step(
        self, parts: Callable[..., Parts], verb: str, call: int
    ) -> None:
        whole = stops(parts(5), 12)
        made = parts(5, around=lambda simulator: Mortal(simulator, verb, call))
        done = []
        with pytest.raises(WorkerDied):
            done += iter_into(done, made.training.episodes())
        stop = Stop(done, made.agent.state_dict(), made.training.state_dict())
        assert len(stop.done) < 12
        assert_same(going_on(parts(5), stop, 12), whole[-1])

    @pytest.mark.parametrize(
        "vehicles",
        [1, 4, 6],
    )
    def test_the_state_of_another_number_of_vehicles_is_refused(
        self, parts: Callable[..., Parts], vehicles: int
    ) -> None:
        (stop,) = stops(parts(vehicles), 1)
        with pytest.raises(UserError, match=r"not the state of a training with .*\b5\b"):
            parts(5).training.load_state_dict(stop.under_way)

    def test_a_longer_episode_than_there_can_be_is_refused(self, parts: Callable[..., Parts]) -> None:
        (*_, stop) = stops(parts(5, max_steps=40), 3)
        assert stop.under_way["actions"].shape[1] > 5
        with pytest.raises(UserError, match="not the state of a training"):
            parts(5, max_steps=5).training.load_state_dict(stop.under_way)

    def test_a_missing_array_is_refused(self, parts: Callable[..., Parts]) -> None:
        (stop,) = stops(parts(5), 1)
        assert set(stop.under_way) == {"next_episode", "episode", "actions", "squared_errors", "updates"}
        for name in stop.under_way:
            rest = {other: values for other, values in stop.under_way.items() if other != name}
            with pytest.raises(UserError, match=r"not the state of a training with .*\b5\b"):
                parts(5).training.load_state_dict(rest)

    def test_what_was_given_out_does_not_change_afterwards(self, parts: Callable[..., Parts]) -> None:
        made = parts(5)
        episodes = made.training.episodes()
        next(episodes)
        given = made.training.state_dict()
        kept = {name: values.copy() for name, values in given.items()}
        list(islice(episodes, 6))
        assert same(given, kept)


def iter_into(done: list[TrainingEpisode], episodes: Iterator[TrainingEpisode]) -> list[TrainingEpisode]:
    """Fills a list for as long as there are episodes."""
    for episode in episodes:
        done.append(episode)
    return []


def weights(folder: Path) -> Arrays:
    return load_file(folder / "checkpoint.safetensors")


def count(folder: Path) -> int:
    return len((folder / "episodes.csv").read_text().splitlines()) - 1


def assert_same_run(one: Path, other: Path) -> None:
    for name in ("episodes.csv", "config.toml"):
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    assert same(weights(one), weights(other))
    assert same(load_file(one / "policy.safetensors"), load_file(other / "policy.safetensors"))


@pytest.fixture
def train(run_cli: Cli, small_config: Path) -> Callable[..., None]:
    """Trains in the small world with several vehicles, and succeeds."""

    def run(folder: Path, episodes: int, *more: object, vehicles: int = 4) -> None:
        arguments = ("--config", small_config, "--episodes", episodes, "--vehicles", vehicles, "--out", folder)
        code, out, err = run_cli("train", *arguments, *more)
        assert code == 0, out + err

    return run


class TestCommandLine:
    def test_the_number_of_workers_makes_no_difference(self, train: Callable[..., None], tmp_path: Path) -> None:
        for workers in (1, 2):
            train(tmp_path / str(workers), 12, "--workers", workers)
        assert_same_run(tmp_path / "1", tmp_path / "2")

    def test_in_two_parts_is_as_in_one(self, train: Callable[..., None], run_cli: Cli, tmp_path: Path) -> None:
        train(tmp_path / "one", 12, "--sim", "kinematic")
        train(tmp_path / "two", 6, "--sim", "kinematic", "--workers", 1)
        assert count(tmp_path / "two") == 6
        assert run_cli("train", "--resume", tmp_path / "two", "--episodes", 12, "--workers", 3)[0] == 0
        assert_same_run(tmp_path / "one", tmp_path / "two")

    def test_episodes_are_written_down_as_they_finish(
        self, train: Callable[..., None], run_cli: Cli, tmp_path: Path
    ) -> None:
        train(tmp_path / "run", 12, "--sim", "kinematic")
        with (tmp_path / "run" / "episodes.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        numbers = [int(row["episode"]) for row in rows]
        assert len(set(numbers)) == 12
        assert max(numbers) < 12 + 3
        assert numbers != sorted(numbers)
        for row in rows:
            assert int(row["world_seed"]) == training_world_seed(0, int(row["episode"]))

    def test_what_the_vehicles_are_is_part_of_the_run(
        self, train: Callable[..., None], run_cli: Cli, tmp_path: Path
    ) -> None:
        train(tmp_path / "run", 3, "--sim", "kinematic")
        config = (tmp_path / "run" / "config.toml").read_text()
        assert "vehicles = 4" in config
        assert 'simulator = "kinematic"' in config
        assert "workers" not in config
        for option in ("--vehicles", "--sim"):
            value = {"--vehicles": 4, "--sim": "kinematic"}[option]
            code, _, err = run_cli("train", "--resume", tmp_path / "run", option, value)
            assert code == 2
            assert option in err

    def test_one_vehicle_is_the_default(
        self, train: Callable[..., None], run_cli: Cli, small_config: Path, tmp_path: Path
    ) -> None:
        train(tmp_path / "said", 3, "--sim", "kinematic", vehicles=1)
        arguments = ("--config", small_config, "--episodes", 3, "--sim", "kinematic", "--out", tmp_path / "unsaid")
        assert run_cli("train", *arguments)[0] == 0
        assert_same_run(tmp_path / "said", tmp_path / "unsaid")

    @pytest.mark.parametrize("option", [("--vehicles", 0), ("--sim", "unity"), ("--vehicles", -1)])
    def test_nonsense_is_refused(
        self, run_cli: Cli, small_config: Path, tmp_path: Path, option: tuple[str, object]
    ) -> None:
        code, _, err = run_cli("train", "--config", small_config, "--out", tmp_path / "run", *option)
        assert code == 2
        assert "Traceback" not in err
        assert not (tmp_path / "run").exists()


# Runs in processes of their own, with two workers, that do not end by themselves

PROGRAM = """
import sys

import nnql_bullet.session
from nnql_bullet.cli import main

if __name__ == "__main__":
    nnql_bullet.session.SAVE_EVERY = 0.05
    sys.exit(main(sys.argv[1:]))
"""


def state(pid: int) -> str:
    """Of a process: R, S, T, Z, ..., or nothing if there is none."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return ""


def children(pid: int) -> list[int]:
    found: list[int] = []
    with suppress(FileNotFoundError, ProcessLookupError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            found += map(int, (task / "children").read_text().split())
    return found


def workers_of(pid: int) -> list[int]:
    """Those children that are workers, in the order in which they were started."""
    found = []
    for child in children(pid):
        with suppress(FileNotFoundError, ProcessLookupError):
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                found.append(child)
    return sorted(found)


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)


@dataclass(frozen=True)
class Ended:
    """A run that did not come to its end."""

    folder: Path
    code: int
    out: str
    err: str
    children: list[int]
    """All that the process had."""
    workers: list[int]

    def copied(self, folder: Path) -> Path:
        return Path(shutil.copytree(self.folder, folder))


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory, small_config: Path) -> Callable[..., Ended]:
    """Starts a run in contact physics with two workers, waits for some episodes, and does something to it."""

    def run(end: Callable[[int, list[int]], None]) -> Ended:
        folder = tmp_path_factory.mktemp("ended")
        program, out = folder / "program.py", folder / "run"
        program.write_text(PROGRAM)
        command = [sys.executable, str(program), "train", "--config", str(small_config), "--episodes", "5000"]
        command += ["--vehicles", "4", "--workers", "2", "--out", str(out)]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        ) as process:
            try:
                wait_for(lambda: process.poll() is not None or (out / "policy.safetensors").exists())
                family, workers = children(process.pid), workers_of(process.pid)
                assert len(workers) == 2
                end(process.pid, workers)
                said, complained = process.communicate(timeout=LIMIT)
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
        return Ended(out, process.returncode, said, complained, family, workers)

    return run


@pytest.fixture(scope="module")
def robbed(ended: Callable[..., Ended]) -> Ended:
    """A run whose second worker was killed."""
    return ended(lambda pid, workers: os.kill(workers[1], signal.SIGKILL))


@pytest.fixture(scope="module")
def interrupted(ended: Callable[..., Ended]) -> Ended:
    """A run that Ctrl-C ended, which every process of a terminal is sent."""
    return ended(lambda pid, workers: os.killpg(pid, signal.SIGINT))


def all_gone(pids: list[int]) -> bool:
    return all(state(pid) in ("", "Z") for pid in pids)


@pytest.mark.slow
class TestKilledWorker:
    def test_it_ends_with_one_line_that_names_the_worker_and_says_how_to_go_on(self, robbed: Ended) -> None:
        assert robbed.code == 1
        lines = [line for line in robbed.err.splitlines() if not line.startswith("training ")]
        assert len(lines) == 1, robbed.err
        who = rf"worker 2 of 2 died \(killed by SIGKILL; process {robbed.workers[1]}, vehicles 1, 3\)"
        then = rf"stopped after episode {count(robbed.folder)} of 5000"
        how = re.escape(f"go on with: nnql-bullet train --resume {robbed.folder}")
        assert re.fullmatch(rf"nnql-bullet: {who}; {then}; {how}", lines[0])

    def test_it_leaves_no_process(self, robbed: Ended) -> None:
        wait_for(lambda: all_gone(robbed.children))

    def test_going_on_is_as_if_nothing_had_happened(
        self, robbed: Ended, train: Callable[..., None], run_cli: Cli, tmp_path: Path
    ) -> None:
        folder = robbed.copied(tmp_path / "robbed")
        total = count(folder) + 6
        assert run_cli("train", "--resume", folder, "--episodes", total, "--workers", 1)[0] == 0
        train(tmp_path / "whole", total, "--workers", 1)
        assert_same_run(folder, tmp_path / "whole")


@pytest.mark.slow
class TestInterrupt:
    def test_it_exits_130_and_says_how_to_go_on(self, interrupted: Ended) -> None:
        assert interrupted.code == 130, interrupted.err
        assert f"train --resume {interrupted.folder}" in interrupted.out

    def test_nothing_is_said_but_that_it_ends(self, interrupted: Ended) -> None:
        lines = [line for line in interrupted.err.splitlines() if not line.startswith("training ")]
        assert len(lines) == 1, interrupted.err
        assert lines[0].startswith("ending after this episode")

    def test_it_leaves_no_process(self, interrupted: Ended) -> None:
        assert len(interrupted.children) >= 2
        wait_for(lambda: all_gone(interrupted.children))

    def test_going_on_is_as_if_it_had_never_stopped(
        self, interrupted: Ended, train: Callable[..., None], run_cli: Cli, tmp_path: Path
    ) -> None:
        folder = interrupted.copied(tmp_path / "interrupted")
        total = count(folder) + 6
        assert run_cli("train", "--resume", folder, "--episodes", total, "--workers", 1)[0] == 0
        train(tmp_path / "whole", total, "--workers", 1)
        assert_same_run(folder, tmp_path / "whole")


@pytest.mark.slow
def test_a_killed_run_leaves_no_worker(ended: Callable[..., Ended]) -> None:
    killed = ended(lambda pid, workers: os.kill(pid, signal.SIGKILL))
    assert killed.code == -signal.SIGKILL
    wait_for(lambda: all_gone(killed.children))
    assert "Traceback" not in killed.err


class TestDeathBeforeTheFirstEpisode:
    def test_there_is_a_checkpoint_to_go_on_from(
        self,
        train: Callable[..., None],
        run_cli: Cli,
        small_config: Path,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        real = Experiment.new_simulator
        arguments = ("--config", small_config, "--episodes", 6, "--vehicles", 4, "--sim", "kinematic")
        with monkeypatch.context() as patch:
            patch.setattr(Experiment, "new_simulator", lambda self, workers: Mortal(real(self, workers), "advance", 2))
            code, _, err = run_cli("train", *arguments, "--out", tmp_path / "run")
        assert code == 1
        assert "worker 1 of 1 died; stopped after episode 0 of 6; go on with: nnql-bullet train --resume" in err
        assert run_cli("train", "--resume", tmp_path / "run")[0] == 0
        train(tmp_path / "whole", 6, "--sim", "kinematic")
        assert_same_run(tmp_path / "run", tmp_path / "whole")

    def test_while_it_drives_up_to_where_it_was(
        self,
        train: Callable[..., None],
        run_cli: Cli,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        train(tmp_path / "run", 6, "--sim", "kinematic")
        before = (tmp_path / "run" / "checkpoint.safetensors").read_bytes()
        real = Experiment.new_simulator
        with monkeypatch.context() as patch:
            patch.setattr(Experiment, "new_simulator", lambda self, workers: Mortal(real(self, workers), "advance", 1))
            code, _, err = run_cli("train", "--resume", tmp_path / "run", "--episodes", 9)
        assert code == 1
        assert "worker 1 of 1 died" in err
        assert (tmp_path / "run" / "checkpoint.safetensors").read_bytes() == before
