"""The worlds that policies are judged in are the frozen ones, and others are refused."""

from dataclasses import replace
from pathlib import Path

import pytest

from nnql_bullet import assets
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.splits import BLOCK, FROZEN, SPLITS, block_hash, check_frozen, load_frozen, split_seeds
from nnql_bullet.experiment import Experiment
from nnql_bullet.run_config import RunConfig
from nnql_bullet.seeding import TRAINING_WORLDS

SHIPPED = sorted(path.stem for path in Path(assets.folder("worlds")).glob("*.toml"))


def test_every_shipped_world_is_frozen() -> None:
    frozen = load_frozen()
    assert sorted(frozen.hashes) == SHIPPED
    for hashes in frozen.hashes.values():
        assert {split: len(blocks) for split, blocks in hashes.items()} == dict.fromkeys(SPLITS, FROZEN // BLOCK)


def test_the_first_worlds_are_what_they_were() -> None:
    frozen = load_frozen()
    for name in SHIPPED:
        experiment = Experiment(RunConfig(world=name))
        for split in SPLITS:
            assert check_frozen(name, split, 1, experiment.vehicle.width, experiment.world, frozen)


def test_splits_are_disjoint_and_training_draws_from_neither() -> None:
    validation, test = map(set, SPLITS.values())
    assert not validation & test
    assert max(validation | test) < TRAINING_WORLDS.start


def test_a_changed_generator_is_refused() -> None:
    experiment = Experiment(RunConfig(world="paper"))

    def draw(seed: int) -> object:
        world = experiment.world(seed)
        return replace(world, target_radius=2.5) if seed == 30 else world

    frozen = load_frozen()
    assert check_frozen("paper", "validation", BLOCK, experiment.vehicle.width, draw, frozen)  # type: ignore[arg-type]
    with pytest.raises(UserError, match="worlds 25 to 49 are not the frozen ones, so figures would not compare"):
        check_frozen("paper", "validation", BLOCK + 1, experiment.vehicle.width, draw, frozen)  # type: ignore[arg-type]


def test_the_hash_of_a_block_tells_its_worlds_and_their_order() -> None:
    experiment = Experiment(RunConfig(world="paper"))
    first, second = experiment.world(0), experiment.world(1)
    assert len({block_hash(worlds) for worlds in ([first, second], [second, first], [first], [])}) == 4


def test_a_users_world_and_another_vehicle_have_nothing_to_compare_with() -> None:
    experiment = Experiment(RunConfig(world="paper"))
    frozen = load_frozen()
    assert not check_frozen("my/world.toml", "test", 5, experiment.vehicle.width, experiment.world, frozen)
    assert not check_frozen("paper", "test", 5, experiment.vehicle.width + 0.1, experiment.world, frozen)


def test_as_many_worlds_as_are_frozen_can_be_had() -> None:
    assert split_seeds("validation", 3) == range(3)
    assert split_seeds("test", FROZEN) == range(100_000, 100_000 + FROZEN)
    for worlds in (0, -1, FROZEN + 1):
        with pytest.raises(UserError, match=f"the number of worlds must be from 1 to {FROZEN}"):
            split_seeds("test", worlds)
