"""One drive of a policy, recorded: what several verbs begin with."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nnql_bullet import __version__
from nnql_bullet.agents import RULES
from nnql_bullet.config import to_values
from nnql_bullet.recording import Recorder, Recording
from nnql_bullet.rollout import EpisodeSummary, run_episode
from nnql_bullet.runs import open_policy

RECORDING = "trajectory.npz"


def drive(policy: Path, seed: int, changes: Mapping[str, Any]) -> tuple[Recording, EpisodeSummary]:
    """Drives a policy through a world.

    Args:
        policy: What `runs.open_policy` takes.
        seed: Of the world.
        changes: Of the policy's configuration, for this drive: nested values; None leaves what is there.

    Raises:
        UserError: If there is no such policy or world.
    """
    experiment, episodes = open_policy(policy, changes)
    config, kind = experiment.config, experiment.config.agent.kind
    recorder = Recorder(experiment.vehicle, experiment.policy)
    summary = run_episode(experiment.navigation, experiment.world(seed), experiment.policy, watcher=recorder)
    label = kind if kind in RULES else f"{kind}, {episodes} episodes"
    recording = recorder.recording(
        policy=f"{label} + shield" if config.shield else label,
        simulator=config.simulator,
        physics=config.physics,
        conditions=to_values(config.conditions),
        version=__version__,
    )
    return recording, summary
