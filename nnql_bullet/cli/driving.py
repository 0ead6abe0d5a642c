"""One drive of a policy, recorded: what several verbs begin with."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nnql_bullet import __version__
from nnql_bullet.agents import RULES
from nnql_bullet.config import to_values
from nnql_bullet.recording import Recorder, Recording
from nnql_bullet.rollout import EpisodeSummary, run_episode
from nnql_bullet.run_config import Conditions, RunConfig, changed
from nnql_bullet.runs import open_policy

RECORDING = "trajectory.npz"


def asked_conditions(
    friction: float | None, payload: float | None, noise: float | None, dead_sector: int | None
) -> Conditions | None:
    """The conditions that flags ask for; None if they ask for none."""
    asked = {"wheel_friction": friction, "payload": payload, "sensor_noise": noise, "dead_sector": dead_sector}
    given = {name: value for name, value in asked.items() if value is not None}
    return changed(RunConfig(), conditions=given).conditions if given else None


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
