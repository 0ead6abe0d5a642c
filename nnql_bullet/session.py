"""Runs a training from beginning to end: episodes, checkpoints, selection of the policy."""

import logging
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from nnql_bullet.agents import Trainable
from nnql_bullet.agents.learning.options import DistilledOptions, DoubleDqnOptions, Sb3DqnOptions
from nnql_bullet.env import Navigation, Reward
from nnql_bullet.errors import UserError, WorkerDied, WorkFailed, missing_library
from nnql_bullet.experiment import Experiment
from nnql_bullet.files import is_file
from nnql_bullet.locks import locked
from nnql_bullet.memory import refuse_beyond
from nnql_bullet.rollout import Policy
from nnql_bullet.run_config import RunConfig
from nnql_bullet.runs import CHECKPOINT, Run, load_run
from nnql_bullet.sources import changed_sources, located
from nnql_bullet.training.base import RECENT, Trainer
from nnql_bullet.training.log import TENSORBOARD, Log, scalars
from nnql_bullet.training.selection import SelectionOptions, finalists, keep
from nnql_bullet.work import OnProgress, Progress, silent

SAVE_EVERY = 5.0
"""Time between checkpoints [s]."""

LogLike = Literal["tensorboard"] | Log
"""A log for TensorBoard in the run folder, or a function."""

_log = logging.getLogger(__name__)


def train(
    config: RunConfig,
    out: Path,
    *,
    agent: Policy | None = None,
    reward: Reward | None = None,
    workers: int | None = None,
    overwrite: bool = False,
    log: LogLike | None = None,
    on_progress: OnProgress = silent,
    stop: Callable[[], bool] = lambda: False,
) -> Run:
    """Trains an agent and writes a run folder.

    The result depends on the configuration alone.

    Args:
        config: The configuration.
        out: Run folder to create.
        agent: Replaces the agent that the configuration describes.
        reward: Replaces the paper's reward.
        workers: Number of processes (contact physics) or threads (kinematic model) that share the vehicles; by default
            one per core. The result does not depend on it.
        overwrite: Whether to start anew in a folder that already contains a run.
        log: Receives the numbers of each episode.
        on_progress: Called after every episode.
        stop: Called after every episode; True ends the training with a checkpoint to resume from.

    Returns:
        The run, read from its folder.

    Raises:
        UserError: If the configuration cannot be trained, or the folder is in use or not empty; nothing is written
            then.
        WorkerDied: If a worker process died; a checkpoint is written before.
        WorkFailed: If the training diverges; the last checkpoint, if there is one, is then from before.
        OSError: If a file cannot be written; the last checkpoint is then complete.
    """
    with ExitStack() as lock:

        def create(run: Run) -> None:
            lock.enter_context(locked(out))
            run.create(overwrite)

        session = _Session(Run(out, config), Experiment(config, agent), reward, workers, log, on_progress, stop)
        return session.go(create)


def resume(
    folder: Path,
    episodes: int | None = None,
    *,
    agent: Policy | None = None,
    reward: Reward | None = None,
    workers: int | None = None,
    log: LogLike | None = None,
    on_progress: OnProgress = silent,
    stop: Callable[[], bool] = lambda: False,
) -> Run:
    """Continues a run from its last checkpoint; the result is bit for bit that of an uninterrupted run.

    A finished run does not change.

    Args:
        folder: The run folder.
        episodes: Total number of episodes; by default the number in the run's configuration.
        agent: See `train`.
        reward: See `train`.
        workers: See `train`.
        log: See `train`; a log for TensorBoard that the run has goes on by default.
        on_progress: See `train`.
        stop: See `train`.

    Returns:
        The run, read from its folder.

    Raises:
        UserError: If the folder contains no run, is in use, its files do not fit each other, or it has more episodes
            already.
        WorkerDied: If a worker process died; a checkpoint is written before.
        OSError: If a file cannot be written; the last checkpoint is then complete.
    """
    run = load_run(folder, episodes)
    changed = changed_sources(folder)
    for name, difference in changed.items():
        _log.warning(
            "%s has changed since this run began (%s); the run goes on with its own copy, as it was then; to train "
            "with what the file says now, begin another run",
            *(name, difference),
        )
    if run.is_over:  # before anything is written
        with suppress(OSError), locked(folder):  # which removes what a killed process left
            pass
        return load_run(folder, episodes)
    with locked(folder):
        run = load_run(folder, episodes)
        experiment = Experiment(located(run.config, folder), agent)
        log = log or (TENSORBOARD if (folder / TENSORBOARD).is_dir() else None)
        run = _Session(run, experiment, reward, workers, log, on_progress, stop).go(Run.go_on)
    for name in changed:  # again, as hours may have passed
        _log.warning("%s had changed: the run went on with its own copy, as it was when the run began", name)
    return run


def check(config: RunConfig) -> None:
    """Checks that a training fits into this machine's memory, before anything is allocated.

    Raises:
        UserError: If it does not.
    """
    agent, n = config.agent, config.vehicles
    learning = agent.training_memory(n) if isinstance(agent, DistilledOptions | DoubleDqnOptions | Sb3DqnOptions) else 0
    actions = n * config.task.max_steps * 9  # a byte and a random number for each decision
    remedy = "lower 'vehicles', 'task.max_steps', or sizes of the agent"
    refuse_beyond(learning + actions, "this training", remedy)


@dataclass(frozen=True)
class _Session:
    """A training that runs until it is finished or stopped."""

    run: Run
    experiment: Experiment
    reward: Reward | None
    workers: int | None
    log: LogLike | None
    on_progress: OnProgress
    stop: Callable[[], bool]

    def go(self, prepare: Callable[[Run], None]) -> Run:
        """Trains and selects the policy; calls `prepare`, which writes the folder, after all checks."""
        run, config, experiment = self.run, self.run.config, self.experiment
        check(config)
        agent = experiment.trainable
        experiment.training_world(0)
        for worlds in ("selection_worlds", "evaluation_worlds"):
            getattr(experiment, worlds)  # raises if a world is wrong
        with _one_thread:
            with closing(experiment.new_training_simulator(self.workers)) as simulator:
                navigation = experiment.new_navigation(simulator, self.reward)
                _check_terms(run, navigation)
                open_log = _opener(self.log)
                trainer = experiment.trainer(navigation)
                if run.state:
                    agent.load_state_dict(run.state.learned)
                    trainer.load_state_dict(run.state.under_way)
                prepare(run)
                _log.info("training %s", _title(config))
                if experiment.first_weights and not run.state:
                    _log.info(
                        "it begins with what '%s' learned in %d episodes; schedules of exploration and learning rate "
                        "begin anew",
                        *(config.start_from, experiment.first_weights.episodes),
                    )
                hopeless = next(filter(None, map(experiment.out_of_reach, experiment.training_sources)), "")
                if hopeless:
                    _log.warning("%s", hopeless)
                if not run.is_trained:
                    with (
                        open_log(run) as tell,
                        np.errstate(over="ignore", invalid="ignore", divide="ignore"),  # `_check_finite` says it
                    ):
                        self._train(agent, trainer, tell)
                    if run.stopped_early:
                        done = len(run.episodes)
                        _log.info("over after %d of %d episodes: %s", done, config.episodes, run.stopped_early)
                elif not config.training.selection:  # the run ended before its last policy was written
                    run.save_policy(agent.state_dict())
                enough = hopeless or (run.is_trained and len(run.episodes) >= RECENT)
                if enough and not any(e.summary.ending == "goal" for e in run.episodes):
                    reason = hopeless or "look at the endings in episodes.csv"
                    _log.warning("none of %d episodes reached its target; %s", len(run.episodes), reason)
            if run.is_trained and config.training.selection:
                self._select(experiment, config.training.selection)
        return load_run(run.folder)

    def _train(self, agent: Trainable, trainer: Trainer, tell: Log | None) -> None:
        """Trains until all episodes are done or `stop` returns True, and writes checkpoints.

        Raises:
            WorkerDied: If a worker process died; a checkpoint is written before.
        """
        run, begin = self.run, time.monotonic()
        total, training = run.config.episodes, run.config.training
        selection, every = training.selection, training.evaluate_every
        recent = deque((e.summary.ending == "goal" for e in run.episodes[-RECENT:]), maxlen=RECENT)
        steps, saved = 0, begin
        schedule = getattr(run.config.agent, "schedule_episodes", total)
        self.on_progress(Progress("training", len(run.episodes), total))
        try:
            for episode in trainer.episodes():
                run.episodes.append(episode)
                if selection:
                    keep(run.candidates, len(run.episodes), agent, selection)
                recent.append(episode.summary.ending == "goal")
                steps += episode.summary.steps
                done, now = len(run.episodes), time.monotonic()
                rate = steps / max(now - begin, 1e-9)
                note = f"success {sum(recent) / len(recent):4.0%} of last {len(recent)}  {rate:.0f} steps/s"
                if run.evaluations:
                    note += f"  validation {run.evaluations[-1].success:.0%}"
                self.on_progress(Progress("training", done, total, note))
                if done == schedule < total and not any(recent):
                    _log.warning(
                        "the schedule is over after %d episodes, and none of the last %d reached its target; "
                        "a training seldom recovers from that",
                        done,
                        len(recent),
                    )
                self._check_finite({"td_error": episode.diagnostics.get("td_error", 0.0)})
                if every and done % every == 0:
                    run.evaluations.append(self.experiment.evaluate(done, self.workers))
                    begin += time.monotonic() - now  # the rate is that of the training
                if tell:
                    tell(done, {**scalars(run.episodes, run.evaluations, done), "speed/steps_per_second": rate})
                over = run.is_trained or self.stop()
                if over or now - saved >= SAVE_EVERY:
                    self._check_finite(agent.state_dict())
                    run.save(agent, trainer)
                    saved = now
                if over:
                    break
        except WorkerDied:
            run.save(agent, trainer)
            if not self.stop():  # an interrupt may reach the worker processes too
                raise

    def _check_finite(self, learned: Mapping[str, ArrayLike]) -> None:
        """Checks named numbers of the training.

        Raises:
            WorkFailed: If one is not finite; the last checkpoint is from before.
        """
        for name, values in learned.items():
            if not np.isfinite(values).all():
                kept = (
                    "the last checkpoint is from before"
                    if is_file(self.run.folder / CHECKPOINT)
                    else "it came to no checkpoint, so nothing is kept; begin anew, in the same folder if you like"
                )
                raise WorkFailed(
                    f"{self.run.folder}: the training diverged: after {len(self.run.episodes)} episodes '{name}' is "
                    f"not finite; lower the learning rate or step size; {kept}"
                )

    def _select(self, experiment: Experiment, selection: SelectionOptions) -> None:
        """Selects as the policy the candidate that reaches the most targets in validation worlds."""
        run, worlds = self.run, len(experiment.selection_worlds)
        candidates = finalists(run.candidates, len(run.episodes), experiment.trainable, selection)
        _log.info("trying %d candidates in %d validation worlds, in the kinematic model", len(candidates), worlds)
        goals = experiment.try_out(candidates, self.workers)
        best = run.save_selected(candidates, goals, worlds)
        _log.info(
            "selected: what was learned after %d episodes, with %d goals of %d; the %d came to %d to %d",
            *(best, goals[best], worlds, len(goals), min(goals.values()), max(goals.values())),
        )


def _opener(log: LogLike | None) -> Callable[[Run], AbstractContextManager[Log | None]]:
    """What opens the log of a run, once its folder is there.

    Raises:
        UserError: If the library that it needs is not installed.
    """
    if log != "tensorboard":
        return lambda run: nullcontext(log)
    try:
        from nnql_bullet.training.tensorboard import TensorBoardLog
    except ImportError:
        raise missing_library("tensorboardX", "log") from None
    return lambda run: closing(TensorBoardLog(run.folder / TENSORBOARD, run.episodes, run.evaluations))


def _check_terms(run: Run, navigation: Navigation) -> None:
    """Checks that a run goes on with the reward terms of its episodes.

    Raises:
        UserError: If it does not.
    """
    for episode in run.episodes[:1]:
        if tuple(episode.summary.terms) != navigation.term_names:
            names = ", ".join(episode.summary.terms)
            raise UserError(f"{run.folder}: was trained with the reward terms {names}; give the same terms")


def _title(config: RunConfig) -> str:
    where = "the kinematic model" if config.simulator == "kinematic" else f"{config.physics} contact physics"
    named = (one if isinstance(one, str) else one.name for one in config.training.worlds or (config.world,))
    worlds = ", ".join(f"'{name}'" for name in dict.fromkeys(named))
    several = "" if config.vehicles == 1 else f", {config.vehicles} vehicles in lockstep"
    return f"{config.agent.kind} in {where}, world {worlds}{several}"


class _OneThread:
    """Limits torch, if it is loaded, to one thread while anything trains: the networks are so small that several wait.

    The limit is that of the process, so the last of several trainings in threads puts back what the first one found.
    """

    def __init__(self) -> None:
        self._lock, self._trainings, self._before = Lock(), 0, 0

    def __enter__(self) -> None:
        torch = sys.modules.get("torch")  # agents that need it have been built, and have loaded it
        with self._lock:
            self._trainings += 1
            if torch:
                self._before = self._before or torch.get_num_threads()
                torch.set_num_threads(1)

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._trainings -= 1
            if self._before and not self._trainings:
                sys.modules["torch"].set_num_threads(self._before)
                self._before = 0


_one_thread = _OneThread()
