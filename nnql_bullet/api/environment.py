"""`make_env`: the task as a Gymnasium environment."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

from gymnasium.vector import AutoresetMode

from nnql_bullet.arguments import checked
from nnql_bullet.env import Reward
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.fidelity.first_use import check_at_first_use
from nnql_bullet.gym_env.actions import ActionsName
from nnql_bullet.gym_env.fleet import Fleet
from nnql_bullet.gym_env.observations import ObservationName
from nnql_bullet.gym_env.rewards import RewardName
from nnql_bullet.gym_env.single import TricycleEnv, TricycleGoalEnv
from nnql_bullet.gym_env.vector import TricycleVectorEnv
from nnql_bullet.planning.planner import PlanOptions
from nnql_bullet.presets import load_config
from nnql_bullet.render.camera import CameraName
from nnql_bullet.render.live import SIZE, Live, RenderMode, check_mode
from nnql_bullet.run_config import Conditions, RunConfig, SimulatorName, changed
from nnql_bullet.sim.copying import CopyableSimulator
from nnql_bullet.sim.engines import PhysicsName
from nnql_bullet.task import TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.urdf import robot_name
from nnql_bullet.worlds.source import World
from nnql_bullet.worlds.waypoints import as_waypoints


@checked
def make_env(
    config: str | Path | RunConfig = "paper",
    *,
    n_envs: int | None = None,
    observation: ObservationName = "sectors",
    actions: ActionsName = "six",
    reward: RewardName | Reward = "paper",
    world: str | Path | World | None = None,
    start: Sequence[float] | None = None,
    target: Sequence[float] | None = None,
    waypoints: str | Path | Sequence[Sequence[float]] | None = None,
    plan: bool | PlanOptions | Mapping[str, Any] = False,
    robot: str | Path | VehicleSpec | None = None,
    rays: int | None = None,
    simulator: SimulatorName | None = None,
    physics: PhysicsName | None = None,
    conditions: Conditions | Mapping[str, Any] | None = None,
    drive: DriveOptions | Mapping[str, Any] | None = None,
    task: TaskOptions | Mapping[str, Any] | None = None,
    max_episode_steps: int | None = None,
    allow_impassable: bool | None = None,
    render_mode: RenderMode | None = None,
    camera: CameraName = "chase",
    size: tuple[int, int] = SIZE,
    autoreset_mode: AutoresetMode | Literal["NextStep", "SameStep", "Disabled"] = AutoresetMode.NEXT_STEP,
    workers: int | None = 1,
    check: bool = True,
) -> TricycleEnv | TricycleVectorEnv:
    """Makes a Gymnasium environment of one vehicle, or a vector environment of several.

    `gymnasium.make("nnql_bullet/Tricycle-v0")` and `gymnasium.make_vec` take the same arguments, and add Gymnasium's
    wrappers.

    Example:
        >>> import nnql_bullet as nb
        >>> env = nb.make_env(world="traps", simulator="kinematic")
        >>> observation, info = env.reset(seed=0)
        >>> observation.shape
        (11,)
        >>> env.close()

    Args:
        config: A preset, a TOML file or a configuration. What follows replaces its keys, where it is given.
        n_envs: Number of vehicles of a vector environment; without it the environment has one vehicle.
        observation: `sectors` as in the paper, `rays`, `goal` (a dictionary, for hindsight), or `frames` as
            `double_dqn` sees them.
        actions: `turns` (the paper's five), `six` (and toward the target), `braking` (12: and while braking or on the
            spot), `manoeuvres` (24: and backwards or slowly) or `continuous` (heading change and speed).
        reward: `paper`, `progress` (what `double_dqn` learns from), `sparse`, or one of your own: terms whose sum it is
            (see `task.RewardTerm`), or a function of the transitions of n vehicles that returns n numbers.
        world: A shipped world, a TOML file, a map or world of another program, or a `World`.
        start: x, y [m] and, if given, yaw [rad] of the start in the frame of the world's map, in place of its own.
        target: x, y [m] of the target in that frame, in place of its own.
        waypoints: x, y [m] in that frame of several targets to reach in turn, of which the last is the target; or a
            file of them (see `waypoints.read_waypoints`).
        plan: Whether a plan of the way through the whole world leads the vehicle, or the keys of one; see
            `planning.planner.PlanOptions`.
        robot: A shipped robot, a TOML file or a `Vehicle`.
        rays: Number of the sensor's rays, a multiple of 4.
        simulator: Contact physics in one of two engines, or the kinematic model.
        physics: Solver settings of contact physics.
        conditions: Load, friction, faults of the sensor; see `Conditions`.
        drive: Speed and time between decisions; see `vehicle.controller.DriveOptions`.
        task: States, the paper's rewards and endings; see `task.TaskOptions`.
        max_episode_steps: Decisions after which an episode is truncated, if that is less than `task.max_steps`.
        allow_impassable: Whether to take worlds whose paths are all too narrow for the vehicle.
        render_mode: `rgb_array`, `rgb_array_list` (one of each state since the last call) or `human` (a window).
        camera: Behind the vehicle (chase), above the arena (top), round the vehicle (orbit), or chase and top (split).
        size: Width and height of the pictures, even numbers [pixels].
        autoreset_mode: What becomes of a vehicle of a vector environment whose episode is over.
        workers: Processes (contact physics) or threads (kinematic model) that share the vehicles of a vector
            environment; None takes one a core.
        check: Whether a robot of your own is checked when it is first driven in contact physics (see `RobotWarning`).

    Raises:
        UserError: If a value is wrong, or a window is asked for where none can open.
    """
    n = 1 if n_envs is None else n_envs
    resolved = config if isinstance(config, RunConfig) else load_config(str(config), {})
    resolved = changed(
        resolved,
        vehicles=n,
        world=str(world) if isinstance(world, Path) else world,
        start=None if start is None else list(start),
        target=None if target is None else list(target),
        waypoints=None if waypoints is None else list(as_waypoints(waypoints)),
        plan={} if plan is True else None if plan is False else plan,
        robot=None if robot is None else robot_name(robot),
        simulator=simulator,
        physics=physics,
        conditions=conditions,
        drive=drive,
        task=task,
        allow_impassable=allow_impassable,
    )
    if rays is not None:
        resolved = changed(resolved, conditions={"rays": rays})
    if max_episode_steps is not None and max_episode_steps < resolved.task.max_steps:
        resolved = changed(resolved, task={"max_steps": max_episode_steps})
    if check:
        check_at_first_use(resolved.robot, resolved.simulator, resolved.physics)
    if render_mode is not None:
        check_mode(render_mode, size)
    experiment = Experiment(resolved)
    shown = 0 if render_mode is None else 1 if render_mode == "human" else n
    title = {"policy": "your agent", "simulator": resolved.simulator, "physics": resolved.physics}
    lives = [Live(mode, experiment.vehicle, camera, size, **title) for mode in [render_mode] * shown if mode]
    copyable = CopyableSimulator(partial(experiment.new_simulator, 1 if n_envs is None else workers))
    fleet = Fleet(experiment, copyable, observation, actions, reward, lives)
    if n_envs is None:
        return (TricycleGoalEnv if observation == "goal" else TricycleEnv)(fleet, render_mode)
    return TricycleVectorEnv(fleet, render_mode, AutoresetMode(autoreset_mode))


def make_vector_env(num_envs: int, workers: int | None = None, **options: Any) -> TricycleVectorEnv:
    """Makes a vector environment for `gymnasium.make_vec`, which has a name of its own for the number of vehicles.

    Args:
        num_envs: Number of vehicles.
        workers: See `make_env`.
        **options: Those of `make_env`.

    Raises:
        UserError: See `make_env`.
    """
    made = make_env(n_envs=num_envs, workers=workers, **options)
    if not isinstance(made, TricycleVectorEnv):
        raise UserError("num_envs must be a whole number")
    return made
