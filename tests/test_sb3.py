"""DQN of stable-baselines3: the same network without the library, the same steps as the environment, the same again."""

import random
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any

import gymnasium
import helpers
import numpy as np
import pytest
import torch
from helpers import same
from numpy.typing import NDArray

from nnql_bullet.agents.learning.options import Sb3DqnOptions
from nnql_bullet.agents.learning.sb3_dqn import Sb3Dqn, inputs
from nnql_bullet.config import parse
from nnql_bullet.env import Navigation, Observation
from nnql_bullet.errors import UserError, WorkerDied
from nnql_bullet.experiment import Experiment
from nnql_bullet.run_config import RunConfig
from nnql_bullet.seeding import training_world_seed
from nnql_bullet.sensing import RAYS
from nnql_bullet.sim.base import Simulator
from nnql_bullet.task import StateProperty, TaskOptions
from nnql_bullet.training.base import LearningAgent, Trainable, TrainingEpisode

sb3 = pytest.importorskip("nnql_bullet.agents.learning.sb3_training", reason="needs the extra [sb3]")

Cli = Callable[..., tuple[int, str, str]]
Arrays = dict[str, NDArray[Any]]
SMALL = Sb3DqnOptions(hidden=(16, 12), buffer_size=2000, learning_starts=50, exploration_steps=400)
SCALE = [10.0] * 8 + [100.0, np.pi, 1.0]


def observed(rows: NDArray[np.float64]) -> Observation:
    """Vehicles of which the environment tells these numbers (n, 11)."""
    rays = np.full(RAYS, 10.0)
    return helpers.observed(*((r[:8], r[8], r[9], r[10], 2.0, StateProperty.NON_SAFE, rays) for r in rows))


def numbers(count: int) -> NDArray[np.float64]:
    low, high = [0.0] * 9 + [-np.pi, -1.5], [10.0] * 8 + [100.0, np.pi, 1.5]
    return np.random.default_rng(0).uniform(low, high, (count, 11))


@pytest.fixture
def parts(small_world: Path) -> Iterator[Callable[..., tuple[Experiment, Any, Navigation]]]:
    """Makes trainings in the small world, on the kinematic model."""
    fleets: list[Simulator] = []

    def make(vehicles: int = 3, seed: int = 5) -> tuple[Experiment, Any, Navigation]:
        config = RunConfig(
            seed=seed,
            vehicles=vehicles,
            simulator="kinematic",
            world=str(small_world),
            task=TaskOptions(max_steps=40),
            agent=SMALL,
        )
        experiment = Experiment(config)
        fleets.append(experiment.new_simulator(1))
        navigation = Navigation(fleets[-1], config.task)
        return experiment, experiment.trainer(navigation), navigation

    yield make
    for fleet in fleets:
        fleet.close()


class TestNetwork:
    def test_it_is_the_librarys_network(self) -> None:
        from stable_baselines3 import DQN

        class Nowhere(gymnasium.Env[NDArray[np.float32], np.int64]):
            observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (11,), np.float32)
            action_space = gymnasium.spaces.Discrete(6)

        agent = Sb3Dqn(SMALL, 0)
        dqn = DQN("MlpPolicy", Nowhere(), policy_kwargs={"net_arch": [16, 12]}, buffer_size=10, device="cpu")
        agent.load_state_dict({name: value.numpy() for name, value in dqn.q_net.q_net.state_dict().items()})
        rows = numbers(300)
        scaled = (rows / SCALE).astype(np.float32)
        actions, _ = dqn.predict(scaled, deterministic=True)
        assert agent.act(observed(rows), None)[0].tolist() == actions.tolist()
        with torch.no_grad():
            values = dqn.q_net(torch.from_numpy(scaled)).numpy()
        assert agent.action_values(observed(rows), None) == pytest.approx(values[:, :5], abs=1e-5)

    def test_it_sees_the_environments_numbers(self, small_world: Path) -> None:
        with closing(gymnasium.make("nnql_bullet/Tricycle-v0", simulator="kinematic", world=str(small_world))) as env:
            observation, _ = env.reset(seed=3)
            seen = env.unwrapped._fleet.navigation.observation  # type: ignore[attr-defined]
            assert inputs(seen, 1.0)[0] == pytest.approx(observation / np.array(SCALE), abs=1e-6)

    def test_all_six_actions_are_open_in_any_state(self) -> None:
        agent = Sb3Dqn(SMALL, 0)
        weights = agent.state_dict()
        for action in range(6):
            bias = np.zeros(6, np.float32)
            bias[action] = 1e6
            agent.load_state_dict(weights | {"4.bias": bias})
            for state in (StateProperty.SAFE, StateProperty.NON_SAFE):
                seen = helpers.observed((np.full(8, 9.0), 50.0, 0.3, 0.0, 2.0, state, np.full(RAYS, 10.0)))
                assert agent.act(seen, None)[0].tolist() == [action]

    def test_it_is_taught_but_not_step_by_step(self) -> None:
        agent = Sb3Dqn(SMALL, 0)
        assert isinstance(agent, Trainable)
        assert not isinstance(agent, LearningAgent)

    def test_making_one_touches_nobody_elses_chance(self) -> None:
        torch.manual_seed(3)
        expected = float(torch.rand(1))
        torch.manual_seed(3)
        first, again, other = (Sb3Dqn(SMALL, seed).state_dict() for seed in (0, 0, 1))
        assert float(torch.rand(1)) == expected
        assert same(first, again)
        assert not same(first, other)

    @pytest.mark.parametrize(
        "change", [{"4.bias": np.zeros(5)}, {"4.bias": np.full(6, np.nan)}, {"6.bias": np.zeros(6)}]
    )
    def test_what_are_no_such_weights_is_refused(self, change: Arrays) -> None:
        agent = Sb3Dqn(SMALL, 0)
        finite = all(np.isfinite(value).all() for value in change.values())
        with pytest.raises(UserError, match="11-16-12-6" if finite else "is not finite"):
            agent.load_state_dict(agent.state_dict() | change)

    @pytest.mark.parametrize(
        "values", [{"hidden": [0]}, {"discount": 1.1}, {"batch_size": 0}, {"temperature_max": 1.0}]
    )
    def test_options_that_make_no_sense_are_refused(self, values: dict[str, Any]) -> None:
        with pytest.raises(UserError, match=r"agent\."):
            parse(RunConfig, {"agent": {"kind": "sb3_dqn", **values}}, "x")

    def test_exploration_falls_linearly(self) -> None:
        options = Sb3DqnOptions(exploration_steps=100, exploration_final=0.2)
        assert [options.exploration(steps) for steps in (0, 50, 100, 1000)] == pytest.approx([1.0, 0.6, 0.2, 0.2])


class TestVehicles:
    def test_they_do_what_single_environments_do(self, parts: Callable[..., Any], small_world: Path) -> None:
        """Each episode again, in the Gymnasium environment of one vehicle."""
        experiment, _, navigation = parts()
        native = sb3.TrainingVehicles(navigation, experiment.training_world)
        vehicles = sb3.VehiclesVecEnv(native)
        generator = np.random.default_rng(1)
        seen = [[observation] for observation in vehicles.reset()]
        done: list[list[int]] = [[] for _ in range(3)]
        rewards: list[list[float]] = [[] for _ in range(3)]
        stretches = []
        for _ in range(90):
            actions = generator.integers(0, 6, 3)
            vehicles.step_async(actions)
            observations, reward, over, infos = vehicles.step_wait()
            for i in range(3):
                done[i].append(int(actions[i]))
                rewards[i].append(float(reward[i]))
                seen[i].append(infos[i]["terminal_observation"] if over[i] else observations[i])
                if over[i]:
                    number, summary = next(pair for pair in native.finished if pair[1].steps == len(done[i]))
                    native.finished.remove((number, summary))
                    stretches.append((number, summary, done[i], rewards[i], seen[i], infos[i]["TimeLimit.truncated"]))
                    done[i], rewards[i], seen[i] = [], [], [observations[i]]
        assert native.finished == []
        assert len(stretches) > 5
        config = RunConfig(simulator="kinematic", world=str(small_world), task=TaskOptions(max_steps=40))
        with closing(gymnasium.make("nnql_bullet/Tricycle-v0", config=config)) as env:
            for number, summary, actions, reward, observations, timeout in stretches:
                assert summary.world_seed == training_world_seed(5, number)
                observation, _ = env.reset(options={"world_seed": summary.world_seed})
                assert observations[0] == pytest.approx(observation / np.array(SCALE), abs=1e-6)
                for action, expected, after in zip(actions, reward, observations[1:], strict=True):
                    observation, got, terminated, truncated, info = env.step(action)
                    assert got == pytest.approx(expected, abs=1e-6)
                    assert after == pytest.approx(observation / np.array(SCALE), abs=1e-6)
                assert terminated or truncated
                assert truncated == timeout == (summary.ending == "timeout")
                assert info["ending"] == summary.ending


class TestTraining:
    def test_the_seed_decides(self, parts: Callable[..., Any]) -> None:
        found = []
        for seed in (5, 5, 6):
            experiment, training, _ = parts(seed=seed)
            random.seed(len(found))  # nobody else's chance matters
            episodes = list(islice(training.episodes(), 12))
            found.append((episodes, experiment.agent.state_dict()))
        assert found[0][0] == found[1][0] != found[2][0]
        assert same(found[0][1], found[1][1])
        assert not same(found[0][1], Sb3Dqn(SMALL, 5).state_dict())

    def test_nobody_elses_chance_is_touched(self, parts: Callable[..., Any]) -> None:
        _, training, _ = parts()

        def draw() -> tuple[float, float, float]:
            return random.random(), np.random.random(), float(torch.rand(1))  # noqa: NPY002

        def seed() -> None:
            random.seed(1)
            np.random.seed(1)  # noqa: NPY002
            torch.manual_seed(1)

        seed()
        expected = draw()
        seed()
        list(islice(training.episodes(), 6))
        assert draw() == expected

    def test_each_episode_is_in_the_world_of_its_number(self, parts: Callable[..., Any]) -> None:
        _, training, _ = parts()
        episodes = list(islice(training.episodes(), 9))
        assert len({episode.episode for episode in episodes}) == 9
        for episode in episodes:
            assert episode.summary.world_seed == training_world_seed(5, episode.episode)
        shares = [episode.diagnostics["exploration"] for episode in episodes]
        assert shares == sorted(shares, reverse=True)
        assert shares[0] < 1.0


def stops(parts: Callable[..., Any], count: int) -> list[tuple[list[TrainingEpisode], Arrays, Arrays]]:
    experiment, training, _ = parts()
    done: list[TrainingEpisode] = []
    found = []
    for episode in islice(training.episodes(), count):
        done.append(episode)
        found.append((list(done), experiment.agent.state_dict(), training.state_dict()))
    return found


class TestGoingOn:
    def test_it_is_as_if_it_had_never_stopped(self, parts: Callable[..., Any]) -> None:
        whole = stops(parts, 12)
        for done, learned, under_way in whole[0], whole[6]:
            experiment, training, _ = parts()
            experiment.agent.load_state_dict(learned)
            training.load_state_dict(under_way)
            more = list(islice(training.episodes(), 12 - len(done)))
            assert done + more == whole[-1][0]
            assert same(experiment.agent.state_dict(), whole[-1][1])
            assert same(training.state_dict(), whole[-1][2])

    def test_what_dies_while_it_is_redone_loses_nothing(
        self, parts: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        _, learned, under_way = stops(parts, 6)[-1]
        experiment, training, navigation = parts()
        experiment.agent.load_state_dict(learned)
        training.load_state_dict(under_way)

        def step(*args: Any) -> Any:
            raise WorkerDied("worker 1 of 1 died")

        monkeypatch.setattr(navigation, "step", step)
        with pytest.raises(WorkerDied):
            next(training.episodes())
        assert same(experiment.agent.state_dict(), learned)
        assert same(training.state_dict(), under_way)

    def test_another_state_is_refused(self, parts: Callable[..., Any]) -> None:
        _, training, _ = parts()
        for arrays in ({}, {"given": np.array([1, 2])}):
            with pytest.raises(UserError, match="not the state"):
                training.load_state_dict(arrays)


class TestCommandLine:
    def test_without_the_library_it_is_refused_and_nothing_written(
        self, run_cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setitem(sys.modules, "nnql_bullet.agents.learning.sb3_training", None)
        code, _, err = run_cli("train", "--config", "sb3_dqn", "--sim", "kinematic", "--out", tmp_path / "run")
        assert code == 2
        assert "pip install 'nnql-bullet[sb3]'" in err
        assert not (tmp_path / "run").exists()
