"""Vehicles that are not quite what they should be, and the mix of worlds that a training takes its episodes from."""

from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nnql_bullet.env import Navigation
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.presets import load_config
from nnql_bullet.run_config import RunConfig, TrainingOptions
from nnql_bullet.seeding import training_world_seed
from nnql_bullet.sim.domain_randomization import DomainRandomization, RandomizedSimulator, turned
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

VEHICLES = 40


@pytest.fixture(scope="module")
def worlds() -> dict[int, WorldSpec]:
    experiment = Experiment(RunConfig(world="cover_10", simulator="kinematic"))
    return {i: experiment.world(1_000_000 + i) for i in range(VEHICLES)}


@pytest.fixture
def plain(vehicle: VehicleSpec) -> Iterator[KinematicSimulator]:
    with closing(KinematicSimulator(vehicle, DriveOptions(), VEHICLES, threads=1)) as fleet:
        yield fleet


@pytest.fixture
def beneath(vehicle: VehicleSpec) -> Iterator[KinematicSimulator]:
    with closing(KinematicSimulator(vehicle, DriveOptions(), VEHICLES, threads=1)) as fleet:
        yield fleet


def everyone() -> np.ndarray:  # type: ignore[type-arg]
    return np.ones(VEHICLES, np.bool_)


class TestDisturbances:
    def test_by_default_there_are_none(self) -> None:
        assert not DomainRandomization().any
        assert not DomainRandomization(start_yaw=True).any  # which is in the world, not in the vehicle

    def test_rays_are_noisy_or_dead(
        self, plain: KinematicSimulator, beneath: KinematicSimulator, worlds: dict[int, WorldSpec]
    ) -> None:
        fleet = RandomizedSimulator(beneath, DomainRandomization(noise=0.1, dead_sector=0.5))
        _, true = plain.reset(worlds)
        poses, seen = fleet.reset(worlds)
        assert np.array_equal(poses, plain.reset(worlds)[0])
        met, told = (rays.reshape(VEHICLES, 8, 9).min(axis=2) < 10.0 for rays in (true, seen))
        dead = [set(np.flatnonzero(met[i] & ~told[i]).tolist()) for i in range(VEHICLES)]
        assert max(map(len, dead)) == 1
        assert 2 <= sum(map(len, dead)) <= VEHICLES // 2 + 8
        both = (true < 9.5) & (seen < 10.0)
        assert 0.02 < np.abs(seen - true)[both].mean() < 0.1
        spread = [np.std((seen - true)[i][both[i]]) for i in range(VEHICLES) if both[i].sum() > 8]
        assert max(spread) > 2 * min(spread)  # each episode has its own

    def test_turns_come_out_too_large_or_too_small(
        self, beneath: KinematicSimulator, worlds: dict[int, WorldSpec]
    ) -> None:
        """A turn of 0.2 rad that is over within the period: what is left over is what it was off by."""
        fleet = RandomizedSimulator(beneath, DomainRandomization(turn_scale=0.2))
        poses, _ = fleet.reset(worlds)
        start = poses[:, 2].copy()
        motions, _ = fleet.advance(np.full(VEHICLES, 0.2), everyone())
        factors = (motions.pose[:, 2] - start) / 0.2
        assert factors.min() < 0.9
        assert factors.max() > 1.1
        assert (np.abs(factors - 1.0) <= 0.2 + 1e-9).all()
        before = motions.pose[:, 2].copy()
        motions, _ = fleet.advance(np.full(VEHICLES, 0.2), everyone())
        assert (motions.pose[:, 2] - before) / 0.2 == pytest.approx(factors, abs=1e-6)  # all through the episode

    def test_an_episode_is_a_function_of_its_world(
        self, plain: KinematicSimulator, beneath: KinematicSimulator, worlds: dict[int, WorldSpec]
    ) -> None:
        everything = DomainRandomization(noise=0.1, dead_sector=0.3, turn_scale=0.2, turn_noise_degrees=5.0)
        one, other = RandomizedSimulator(plain, everything), RandomizedSimulator(beneath, everything)
        turned_round = {i: worlds[VEHICLES - 1 - i] for i in range(VEHICLES)}
        _, seen = one.reset(worlds)
        _, again = other.reset(turned_round)
        assert np.array_equal(seen, again[::-1])
        only = np.arange(VEHICLES) % 2 == 0
        for _ in range(3):
            moved, seen = one.advance(np.full(VEHICLES, 0.3), only)
            like, again = other.advance(np.full(VEHICLES, 0.3), only[::-1])
            assert np.array_equal(moved.pose[only], like.pose[::-1][only])
            assert np.array_equal(seen[only], again[::-1][only])

    def test_a_start_in_any_direction(self, worlds: dict[int, WorldSpec]) -> None:
        yaws = [turned(world, DomainRandomization(start_yaw=True)).start.yaw for world in worlds.values()]
        assert min(yaws) < -2.0
        assert max(yaws) > 2.0
        assert turned(worlds[0], DomainRandomization()) is worlds[0]
        assert replace(turned(worlds[0], DomainRandomization(start_yaw=True)), start=worlds[0].start) == worlds[0]


class TestTrainingWorlds:
    def test_each_file_has_its_share(self, small_world: Path) -> None:
        mix = TrainingOptions(worlds=(str(small_world), "paper", "traps"))
        experiment = Experiment(RunConfig(seed=4, training=mix))
        drawn = [experiment.training_world(episode) for episode in range(60)]
        count = Counter(world.name for world in drawn)
        assert set(count) == {"small", "paper", "traps"}
        assert min(count.values()) >= 10
        assert [world.seed for world in drawn] == [training_world_seed(4, episode) for episode in range(60)]
        assert experiment.world(3).name == "paper"  # where it is driven is another matter

    def test_without_any_it_is_the_runs_world(self, small_world: Path) -> None:
        experiment = Experiment(RunConfig(seed=4, world=str(small_world)))
        seed = training_world_seed(4, 7)
        assert experiment.training_world(7) == experiment.world(seed)

    def test_a_file_that_is_not_there_is_refused(self) -> None:
        with pytest.raises(UserError, match="nowhere"):
            Experiment(RunConfig(training=TrainingOptions(worlds=("paper", "nowhere")))).training_world(0)

    def test_only_training_is_disturbed(self, small_world: Path) -> None:
        config = load_config("double_dqn", {"world": str(small_world), "vehicles": 2})
        experiment = Experiment(config)
        with closing(experiment.new_simulator(1)) as sound, closing(experiment.new_training_simulator(1)) as disturbed:
            assert isinstance(disturbed, RandomizedSimulator)
            assert not isinstance(sound, RandomizedSimulator)
            navigation = Navigation(disturbed, TaskOptions())
            navigation.reset({i: experiment.world(i) for i in range(2)})
            assert navigation.step(np.zeros(2, np.int64)).active.all()
