"""`make_env`: the task as a Gymnasium environment."""

from pathlib import Path
from typing import Any

from nnql_bullet.arguments import checked
from nnql_bullet.env import Reward
from nnql_bullet.fidelity.first_use import check_at_first_use
from nnql_bullet.gym_env import TricycleEnv, TricycleVectorEnv
from nnql_bullet.presets import load_config
from nnql_bullet.run_config import RunConfig, changed


@checked
def make_env(
    config: str | Path | RunConfig = "paper",
    *,
    n_envs: int | None = None,
    reward: Reward | None = None,
    manoeuvres: bool = False,
    workers: int | None = 1,
    check: bool = True,
    **changes: Any,
) -> TricycleEnv | TricycleVectorEnv:
    """Makes a Gymnasium environment of one vehicle, or a vector environment of several.

    `gymnasium.make("nnql_bullet/Tricycle-v0")` and `gymnasium.make_vec` make the same, with Gymnasium's wrappers.

    Example:
        >>> import nnql_bullet as nb
        >>> env = nb.make_env(world="traps", simulator="kinematic")
        >>> observation, info = env.reset(seed=0)
        >>> observation.shape
        (11,)
        >>> env.close()

    Args:
        config: A preset, a TOML file or a configuration.
        n_envs: Number of vehicles of a vector environment; without it the environment has one vehicle.
        reward: A reward of your own: terms whose sum it is (see `task.RewardTerm`), or a function of the transitions of
            n vehicles that returns n numbers.
        manoeuvres: Whether an action may also stop, reverse or drive slowly: 24 actions, see `env.MANOEUVRES`, in place
            of 6.
        workers: Processes (contact physics) or threads (kinematic model) that share the vehicles of a vector
            environment; None takes one a core.
        check: Whether a robot of your own is checked when it is first driven in contact physics (see `RobotWarning`).
        **changes: Keys of the configuration: world, robot, simulator, physics, conditions, task and so on.

    Raises:
        UserError: If a key or value is wrong.
    """
    resolved = changed(config if isinstance(config, RunConfig) else load_config(str(config), {}), **changes)
    if check:
        check_at_first_use(resolved.robot, resolved.simulator, resolved.physics)
    if n_envs is None:
        return TricycleEnv(resolved, reward, manoeuvres)
    return TricycleVectorEnv(n_envs, resolved, workers, reward, manoeuvres)
