"""One drive of a policy, recorded."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any

from nnql_bullet.arguments import checked
from nnql_bullet.config import dotted, merged, to_values
from nnql_bullet.env import Reward
from nnql_bullet.fidelity.first_use import check_at_first_use
from nnql_bullet.provenance import made_by
from nnql_bullet.recording import Recorder, Recording
from nnql_bullet.rollout import run_episode
from nnql_bullet.run_config import Conditions, SimulatorName, driving_with, key_texts
from nnql_bullet.runs import PolicyLike, drives_folder, load_policy, tell_differences
from nnql_bullet.sim.engines import PhysicsName
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.work import OnProgress
from nnql_bullet.worlds.source import World
from nnql_bullet.worlds.waypoints import as_waypoints

_log = logging.getLogger(__name__)
RECORDING = "trajectory.npz"
"""File that a drive is kept in."""


@checked
def drive(
    policy: PolicyLike,
    *,
    world: str | Path | World | None = None,
    start: Sequence[float] | None = None,
    target: Sequence[float] | None = None,
    waypoints: str | Path | Sequence[Sequence[float]] | None = None,
    plan: bool = False,
    seed: int = 0,
    simulator: SimulatorName = "bullet",
    physics: PhysicsName = "reference",
    robot: str | Path | VehicleSpec | None = None,
    speed: float | None = None,
    shield: bool = False,
    allow_impassable: bool = False,
    conditions: Conditions | None = None,
    reward: Reward | None = None,
    changes: Mapping[str, Any] = MappingProxyType({}),
    check: bool = True,
    on_progress: OnProgress | None = None,
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
        start: x, y [m] and, if given, yaw [rad] of the start in the frame of the world's map, in place of its own.
        target: x, y [m] of the target in that frame, in place of its own.
        waypoints: x, y [m] in that frame of several targets to reach in turn, of which the last is the target; or a
            file of them (see `waypoints.read_waypoints`).
        plan: Whether a plan of the way through the whole world leads the policy; for its lengths see the keys `plan` in
            `changes`.
        seed: Seed of the world.
        simulator: Where it drives, wherever it was trained.
        physics: Solver settings of contact physics.
        robot: A shipped robot, a TOML file or a `Vehicle`; by default that of the training.
        speed: Speed [m/s]; by default that of the policy, or the robot's own if that is less.
        shield: Whether to put the policy into a shield.
        allow_impassable: Whether to drive even if the vehicle is too wide for every path to the target.
        conditions: Conditions in place of the policy's own.
        reward: A reward in place of the paper's, to record; the policy does not see it.
        changes: Nested values laid over the tables drive, shield, plan, task and agent of the policy's configuration.
        check: Whether a robot of your own is checked when it is first driven in contact physics (see `RobotWarning`).
        on_progress: Receives the progress of this check.

    Raises:
        UserError: If there is no such policy or world, or a value is wrong.
    """
    wanted: dict[str, Any] = {name: {} for name, its in (("shield", shield), ("plan", plan)) if its}
    asked = merged(wanted, driving_with(changes, robot, speed))
    asked |= {"simulator": simulator, "physics": physics, "conditions": conditions}
    asked["allow_impassable"] = allow_impassable
    asked["world"] = str(world) if isinstance(world, Path) else world
    asked |= {"start": start and list(start), "target": target and list(target)}
    asked["waypoints"] = None if waypoints is None else list(as_waypoints(waypoints))
    tell_differences(policy, asked.get("robot"), own_world=world is None)
    loaded = load_policy(policy, asked)
    experiment, config = loaded.experiment, loaded.experiment.config
    if check:
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


def keep(recording: Recording, folder: Path) -> dict[str, Path]:
    """Writes a recording and its picture into a folder, which is made if it is not there; returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    files = {"recording": folder / RECORDING, "picture": (folder / RECORDING).with_suffix(".png")}
    recording.save(files["recording"])
    recording.plot(files["picture"])
    return files


def drive_folder(
    policy: Path,
    world: str,
    seed: int,
    simulator: SimulatorName = "bullet",
    shield: bool = False,
    plan: bool = False,
    conditions: Conditions | None = None,
    changes: Mapping[str, Any] = MappingProxyType({}),
) -> Path:
    """The folder in which a drive is kept: with its run, named for the world and for what was asked for."""
    asked = (conditions.texts if conditions else {}) | key_texts(dotted(changes))
    parts = [world, str(seed), *([simulator] if simulator != "bullet" else []), *(["shield"] if shield else [])]
    parts += ["plan"] if plan else []
    parts += [f"{name.replace('_', '-')}-{text}" for name, text in asked.items()]
    return drives_folder(policy) / "-".join(parts)
