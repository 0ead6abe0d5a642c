"""`train` and `resume`: an agent learns, and leaves a run folder."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from nnql_bullet import session
from nnql_bullet.arguments import checked
from nnql_bullet.env import Reward
from nnql_bullet.fidelity.first_use import check_at_first_use
from nnql_bullet.presets import load_config
from nnql_bullet.reports.card import write_card
from nnql_bullet.reports.plots import draw_learning_curve
from nnql_bullet.rollout import Policy
from nnql_bullet.run_config import RunConfig, changed
from nnql_bullet.runs import LEARNING_CURVE, Run, load_run
from nnql_bullet.work import OnProgress, silent


def never() -> bool:
    """Never stops a training."""
    return False


@checked
def train(
    config: str | Path | RunConfig = "paper",
    *,
    out: Path | str | None = None,
    agent: Policy | Mapping[str, Any] | None = None,
    reward: Reward | None = None,
    workers: int | None = 1,
    overwrite: bool = False,
    check: bool = True,
    log: session.LogLike | None = None,
    on_progress: OnProgress | None = None,
    stop: Callable[[], bool] = never,
    **changes: Any,
) -> Run:
    """Trains an agent and leaves a run folder; the result depends on the configuration alone.

    Example:
        >>> import nnql_bullet as nb
        >>> run = nb.train("paper", simulator="kinematic", vehicles=4, episodes=8, seed=1, out="runs/first")
        >>> len(run.episodes), run.policy.episodes
        (8, 8)

    Args:
        config: A preset, a TOML file or a configuration.
        out: The run folder; by default runs/CONFIG-SEED.
        agent: An agent of your own (see `training.base.LearningAgent`) in place of the one that the configuration
            describes, which itself learns; or keys of that agent, such as {"kind": "q_table"}.
        reward: A reward of your own: terms whose sum it is (see `task.RewardTerm`), or a function of the transitions of
            n vehicles that returns n numbers. Beside a function, the terms that are logged stay the paper's.
        workers: Processes (contact physics) or threads (kinematic model) that share the vehicles; None takes one a
            core. The result does not depend on it.
        overwrite: Whether to start anew in a folder that holds a run already.
        check: Whether a robot of your own is checked when it is first driven in contact physics (see `RobotWarning`).
        log: "tensorboard" writes a log for TensorBoard into the run folder; a function receives the same: the number of
            finished episodes, and numbers by name. The result does not depend on it.
        on_progress: Receives the progress after every episode.
        stop: Asked after every episode; True ends the training with a checkpoint to resume from.
        **changes: Keys of the configuration, with nested tables as mappings: seed, episodes, start_from, world,
            simulator, physics, vehicles, task={...} and so on.

    Raises:
        UserError: If a key or value is wrong, or the folder holds something; nothing is written then.
        WorkerDied: If a worker process is gone; a checkpoint is written before.
    """
    if isinstance(agent, Mapping):
        changes["agent"], agent = agent, None
    if changes.get("world") is not None:  # takes the place of a mix of worlds
        changes["training"] = {"worlds": [], **changes.get("training", {})}
    asked = {key: str(value) if isinstance(value, Path) else value for key, value in changes.items()}
    resolved = changed(config, **asked) if isinstance(config, RunConfig) else load_config(str(config), asked)
    if check:
        check_at_first_use(resolved.robot, resolved.simulator, resolved.physics, on_progress)
    name = "run" if isinstance(config, RunConfig) else Path(config).stem
    folder = Path("runs") / f"{name}-{resolved.seed}" if out is None else Path(out)
    return _shown(
        session.train(
            resolved,
            folder,
            agent=agent,
            reward=reward,
            workers=workers,
            overwrite=overwrite,
            log=log,
            on_progress=on_progress or silent,
            stop=stop,
        ),
        agent,
        reward,
    )


@checked
def resume(
    folder: Path | str,
    episodes: int | None = None,
    *,
    agent: Policy | None = None,
    reward: Reward | None = None,
    workers: int | None = 1,
    log: session.LogLike | None = None,
    on_progress: OnProgress | None = None,
    stop: Callable[[], bool] = never,
) -> Run:
    """Continues a run from its last checkpoint, bit for bit as if it had never stopped.

    Example:
        >>> import nnql_bullet as nb
        >>> run = nb.train("paper", simulator="kinematic", vehicles=4, episodes=8, seed=2, out="runs/second")
        >>> len(nb.resume("runs/second", episodes=12).episodes)
        12

    Args:
        folder: The run folder.
        episodes: Episodes to train in all; by default as many as the run has been configured for.
        agent: The agent of your own that the run was begun with, if it was.
        reward: The reward of your own, likewise.
        workers: See `train`.
        log: See `train`; a log for TensorBoard that the run has goes on by default.
        on_progress: See `train`.
        stop: See `train`.

    Raises:
        UserError: If the folder holds no run, its files do not fit each other, or it has more episodes already.
        WorkerDied: If a worker process is gone; a checkpoint is written before.
    """
    return _shown(
        session.resume(
            Path(folder),
            episodes,
            agent=agent,
            reward=reward,
            workers=workers,
            log=log,
            on_progress=on_progress or silent,
            stop=stop,
        ),
        agent,
        reward,
    )


def _shown(run: Run, agent: Policy | None, reward: Reward | None) -> Run:
    """Draws the learning curve of a run and writes its card, as soon as it has episodes."""
    if run.episodes:
        draw_learning_curve(run.episodes, run.folder / LEARNING_CURVE, evaluations=run.evaluations)
        own = [name for name, its in (("an agent", agent), ("a reward", reward)) if its is not None]
        write_card(load_run(run.folder), " and ".join(own))  # as its files say
    return run
