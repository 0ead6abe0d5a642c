"""Presets, which are named configurations, and the reading of a preset or TOML file."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

from nnql_bullet import paper
from nnql_bullet.agents import RuleOptions
from nnql_bullet.agents.learning.genetic import GeneticOptions
from nnql_bullet.agents.learning.options import DistilledOptions, DoubleDqnOptions, NnqlOptions, Sb3DqnOptions
from nnql_bullet.agents.learning.q_table import QTableOptions
from nnql_bullet.config import merged, parse, read_toml, to_values
from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file
from nnql_bullet.run_config import RENAMED_KEYS, RENAMED_SIMULATORS, RunConfig, TrainingOptions, outdated_keys
from nnql_bullet.sim.domain_randomization import DomainRandomization
from nnql_bullet.task import TaskOptions
from nnql_bullet.training.selection import SelectionOptions
from nnql_bullet.vehicle.controller import DriveOptions

PRESETS: dict[str, RunConfig] = {
    # Every number that the paper states; where it leaves a choice, the evidence decides. These are the defaults.
    "paper": RunConfig(),
    # The most literal reading of the paper's text wherever it leaves a choice.
    "literal": RunConfig(
        drive=DriveOptions(decision_period=1.0),  # a step long enough for the largest turn
        task=TaskOptions(
            # "a high possibility of collision with some obstacles": near in any direction
            front_distance=4.0,
            front_side_distance=4.0,
            other_distance=4.0,
            reward_non_safe_to_safe=0.2,  # the opposite of safe to non-safe
        ),
        agent=NnqlOptions(
            encoding="distance",  # "if no obstacle is found, then d = 0"
            gradient_step=1.0,  # eq. (2) read literally
        ),
    ),
    # All that the paper states, and what it leaves open set by the ablation `tuned`.
    "tuned": RunConfig(
        simulator="kinematic",
        vehicles=64,
        drive=DriveOptions(decision_period=0.6),
        training=TrainingOptions(selection=SelectionOptions(worlds=("cover_10", "cover_15"))),
        agent=NnqlOptions(mirrored=True),
    ),
    # The paper's update on a table instead of the network.
    "q_table": RunConfig(agent=QTableOptions()),
    # A search learns from whole episodes and the others from steps, so it gets more episodes.
    "genetic": RunConfig(episodes=20 * paper.EPISODES, agent=GeneticOptions()),
    # It needs many steps, so it learns in the kinematic model with many vehicles, in all kinds of worlds.
    "double_dqn": RunConfig(
        episodes=12_000,
        simulator="kinematic",
        vehicles=64,
        agent=DoubleDqnOptions(),
        training=TrainingOptions(
            # the hardest worlds twice
            worlds=("cover_10", "cover_15", "cover_20", "cover_20", "traps", "aisles", "aisles", "moving"),
            domain_randomization=DomainRandomization(
                start_yaw=True, noise=0.05, dead_sector=0.05, turn_scale=0.1, turn_noise_degrees=3.0
            ),
        ),
    ),
    # It learns what a search over several manoeuvres says, mostly where that is not plain: in tight worlds.
    "distilled": RunConfig(
        episodes=1_500,
        simulator="kinematic",
        vehicles=64,
        agent=DistilledOptions(),
        training=TrainingOptions(
            worlds=(
                *("cover_10", "cover_20", "cover_20", "traps", "aisles", "aisles", "moving"),
                *("poles", "poles", "cluttered", "cluttered", "cells", "cells", "rooms", "rooms"),
            ),
            domain_randomization=DomainRandomization(start_yaw=True, noise=0.02, turn_scale=0.05),
        ),
    ),
    # DQN of stable-baselines3 in the paper's task.
    "sb3_dqn": RunConfig(agent=Sb3DqnOptions()),
    # The rules, which do not learn.
    **{options.kind: RunConfig(agent=options()) for options in get_args(RuleOptions)},
}


def load_config(name: str, changes: Mapping[str, Any]) -> RunConfig:
    """Reads a preset or TOML file and applies changes to it.

    Args:
        name: A preset, or a path to a TOML file; the file's key `preset` names its base (default `paper`).
        changes: Nested values (see `config.merged`).

    Raises:
        UserError: If there is no such preset or file, or a key or value is wrong.
    """
    if name in PRESETS:
        return parse(RunConfig, merged(to_values(PRESETS[name]), changes), name)
    if not is_file(name):
        raise UserError(f"there is no preset or file '{name}'; give a TOML file or one of: {', '.join(PRESETS)}")
    return config_of(read_toml(Path(name)), name, changes)


def config_of(given: Mapping[str, Any], name: str, changes: Mapping[str, Any] = MappingProxyType({})) -> RunConfig:
    """Makes a configuration of the values of a TOML file, and applies changes to it.

    Args:
        given: The values; the key `preset` names their base (default `paper`).
        name: The file, for errors.
        changes: Nested values (see `config.merged`).

    Raises:
        UserError: If a key or value is wrong.
    """
    values = dict(given)
    preset = values.pop("preset", "paper")
    if not isinstance(preset, str) or preset not in PRESETS:
        raise UserError(f"{name}: 'preset' must be one of: {', '.join(PRESETS)}")
    for key in outdated_keys(values):
        raise UserError(f"{name}: key '{key}' is now named '{RENAMED_KEYS[key]}'")
    old = values.get("simulator")
    if isinstance(old, str) and old in RENAMED_SIMULATORS:
        raise UserError(f"{name}: simulator '{old}' is now named '{RENAMED_SIMULATORS[old]}'")
    return parse(RunConfig, merged(merged(to_values(PRESETS[preset]), values), changes), name)
