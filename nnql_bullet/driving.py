"""One drive of a policy, recorded."""

import logging
from dataclasses import asdict
from pathlib import Path

from typing_extensions import Unpack

from nnql_bullet.arguments import checked
from nnql_bullet.config import to_values
from nnql_bullet.env import Reward
from nnql_bullet.fidelity.first_use import check_at_first_use
from nnql_bullet.provenance import made_by
from nnql_bullet.recording import Recorder, Recording
from nnql_bullet.rollout import run_episode
from nnql_bullet.runs import PolicyLike, load_policy, tell_differences
from nnql_bullet.setting import PlaceArguments, Setting
from nnql_bullet.work import OnProgress
from nnql_bullet.worlds.source import World

_log = logging.getLogger(__name__)


@checked
def drive(
    policy: PolicyLike,
    *,
    world: str | Path | World | None = None,
    seed: int = 0,
    reward: Reward | None = None,
    on_progress: OnProgress | None = None,
    **asked: Unpack[PlaceArguments],
) -> Recording:
    """Drives a policy through a world and records it.

    Example:
        >>> import nnql_bullet as nb
        >>> recording = nb.drive("vfh", world="cover_10", seed=1, simulator="kinematic")
        >>> recording.summary.ending
        'goal'

    Args:
        policy: A run folder, a policy file, a shipped policy or rule by name, what `load_policy` returned, or an object
            of your own: `act(observations)` gives the actions (n,) of n vehicles. One with a memory has the methods of
            `rollout.Policy`.
        world: A shipped world, a TOML file, a map or world of another program (see `import_world`), or a `World`; by
            default that of the training.
        seed: Seed of the world.
        reward: A reward in place of the paper's, to record; the policy does not see it.
        on_progress: Receives the progress of the check of a robot.
        **asked: How it drives.

    Raises:
        UserError: If there is no such policy or world, or a value is wrong.
    """
    setting = Setting.of(asked)
    tell_differences(policy, setting.robot, own_world=world is None)
    kind = str(world) if isinstance(world, Path) else world
    loaded = load_policy(policy, {"world": kind, **setting.ends, **setting.changes})
    experiment, config = loaded.experiment, loaded.experiment.config
    if asked.get("check", True):
        check_at_first_use(config.robot, config.simulator, config.physics, on_progress)
    drawn = experiment.world(seed)
    hopeless = experiment.out_of_reach(experiment.worlds)
    if hopeless:
        _log.warning("%s", hopeless)
    recorder = Recorder(experiment.vehicle)
    navigation = experiment.new_navigation(experiment.simulator, reward)
    summary = run_episode(navigation, drawn, experiment.policy, watcher=recorder)
    experiment.simulator.close()
    return recorder.recording(
        policy=loaded.label,
        simulator=config.simulator,
        physics=config.physics,
        conditions=to_values(config.conditions),
        made_by=made_by(),
        summary=asdict(summary),
        plans=[{"time": time, "corners": corners.tolist()} for time, corners in navigation.plans(0)],
    )
