"""Runs a training from beginning to end: episodes, checkpoints, selection of the policy."""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import torch

from nnql_bullet.agents import Trainable
from nnql_bullet.env import Navigation, Reward
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.locks import locked
from nnql_bullet.rollout import Policy
from nnql_bullet.run_config import RunConfig
from nnql_bullet.runs import Run, load_run
from nnql_bullet.sim.base import WorkerDied
from nnql_bullet.training.base import RECENT, Trainer
from nnql_bullet.training.selection import SelectionOptions, finalists, keep
from nnql_bullet.work import OnProgress, Progress, silent

SAVE_EVERY = 5.0
"""Time between checkpoints [s]."""

_log = logging.getLogger(__name__)


def train(
    config: RunConfig,
    out: Path,
    *,
    agent: Policy | None = None,
    reward: Reward | None = None,
    workers: int | None = None,
    overwrite: bool = False,
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
        on_progress: Called after every episode.
        stop: Called after every episode; True ends the training with a checkpoint to resume from.

    Returns:
        The run, read from its folder.

    Raises:
        UserError: If the configuration cannot be trained, or the folder is in use or not empty; nothing is written
            then.
        WorkerDied: If a worker process died; a checkpoint is written before.
        OSError: If a file cannot be written; the last checkpoint is then complete.
    """
    with ExitStack() as lock:

        def create(run: Run) -> None:
            lock.enter_context(locked(out))
            run.create(overwrite)

        return _Session(Run(out, config), agent, reward, workers, on_progress, stop).go(create)


def resume(
    folder: Path,
    episodes: int | None = None,
    *,
    agent: Policy | None = None,
    reward: Reward | None = None,
    workers: int | None = None,
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
    if load_run(folder, episodes).is_over:  # before anything is written
        with suppress(OSError), locked(folder):  # which removes what a killed process left
            pass
        return load_run(folder, episodes)
    with locked(folder):
        run = load_run(folder, episodes)
        return _Session(run, agent, reward, workers, on_progress, stop).go(Run.save_config)


@dataclass(frozen=True)
class _Session:
    """A training that runs until it is finished or stopped."""

    run: Run
    agent: Policy | None
    reward: Reward | None
    workers: int | None
    on_progress: OnProgress
    stop: Callable[[], bool]

    def go(self, prepare: Callable[[Run], None]) -> Run:
        """Trains and selects the policy; calls `prepare`, which writes the folder, after all checks."""
        run, config = self.run, self.run.config
        experiment = Experiment(config, self.agent)
        agent = experiment.trainable
        experiment.training_world(0)
        experiment.selection_worlds  # noqa: B018 (raises if a world is wrong)
        with _one_thread():
            with closing(experiment.new_training_simulator(self.workers)) as simulator:
                navigation = Navigation(simulator, config.task, self.reward)
                _check_terms(run, navigation)
                trainer = experiment.trainer(navigation)
                if run.state:
                    agent.load_state_dict(run.state.learned)
                    trainer.load_state_dict(run.state.under_way)
                prepare(run)
                _log.info("training %s", _title(config))
                if len(run.episodes) < config.episodes:
                    self._train(agent, trainer)
                elif not config.training.selection:  # the run ended before its last policy was written
                    run.save_policy(agent.state_dict())
            if len(run.episodes) == config.episodes and config.training.selection:
                self._select(experiment, config.training.selection)
        return load_run(run.folder)

    def _train(self, agent: Trainable, trainer: Trainer) -> None:
        """Trains until all episodes are done or `stop` returns True, and writes checkpoints.

        Raises:
            WorkerDied: If a worker process died; a checkpoint is written before.
        """
        run, begin = self.run, time.monotonic()
        total, selection = run.config.episodes, run.config.training.selection
        recent = deque((e.summary.ending == "goal" for e in run.episodes[-RECENT:]), maxlen=RECENT)
        steps, saved = 0, begin
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
                self.on_progress(Progress("training", done, total, note))
                over = done == total or self.stop()
                if over or now - saved >= SAVE_EVERY:
                    run.save(agent, trainer)
                    saved = now
                if over:
                    break
        except WorkerDied:
            run.save(agent, trainer)
            if not self.stop():  # an interrupt may reach the worker processes too
                raise

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
    worlds = ", ".join(f"'{name}'" for name in dict.fromkeys(config.training.worlds or (config.world,)))
    several = "" if config.vehicles == 1 else f", {config.vehicles} vehicles in lockstep"
    return f"{config.agent.kind} in {where}, world {worlds}{several}"


@contextmanager
def _one_thread() -> Iterator[None]:
    """Limits torch to one thread; the networks here are so small that several threads would only wait."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
