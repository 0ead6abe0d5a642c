"""Training runs from beginning to end: episodes, checkpoints, selection of the policy."""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import torch

from nnql_bullet.agents import Trainable
from nnql_bullet.env import Navigation, Reward
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.rollout import Policy
from nnql_bullet.run_config import RunConfig
from nnql_bullet.runs import Run, load_run
from nnql_bullet.sim.base import WorkerDied
from nnql_bullet.training.base import RECENT, Trainer
from nnql_bullet.training.selection import SelectionOptions, finalists, keep
from nnql_bullet.work import OnProgress, Progress, silent

SAVE_EVERY = 5.0
"""Time from one checkpoint to the next [s]."""

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
    """Trains an agent and leaves a run folder.

    The result is a function of the configuration alone.

    Args:
        config: The configuration.
        out: Run folder to create.
        agent: An agent in place of the one that the configuration describes.
        reward: A reward in place of the paper's.
        workers: Processes (contact physics) or threads (kinematic model) that share the vehicles; one a core by
            default. The result does not depend on it.
        overwrite: Whether to start anew in a folder that holds a run already.
        on_progress: Called after every episode.
        stop: Asked after every episode; True ends the training with a checkpoint to resume from.

    Returns:
        The run as its folder holds it.

    Raises:
        UserError: If the configuration cannot be trained, or the folder holds something; nothing is written then.
        WorkerDied: If a worker process is gone; a checkpoint is written before.
        OSError: If a file cannot be written; the last checkpoint is then whole.
    """
    return _Session(Run(out, config), agent, reward, workers, on_progress, stop).go(lambda run: run.create(overwrite))


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
    """Continues a run from its last checkpoint, bit for bit as if it had never stopped.

    A run that is over is left as it is.

    Args:
        folder: The run folder.
        episodes: Episodes to train in all; by default as many as the run has been configured for.
        agent: See `train`.
        reward: See `train`.
        workers: See `train`.
        on_progress: See `train`.
        stop: See `train`.

    Returns:
        The run as its folder holds it.

    Raises:
        UserError: If the folder holds no run, its files do not fit each other, or it has more episodes already.
        WorkerDied: If a worker process is gone; a checkpoint is written before.
        OSError: If a file cannot be written; the last checkpoint is then whole.
    """
    run = load_run(folder, episodes)
    return run if run.is_over else _Session(run, agent, reward, workers, on_progress, stop).go(Run.save_config)


@dataclass(frozen=True)
class _Session:
    """A training that goes on until it is over or stopped."""

    run: Run
    agent: Policy | None
    reward: Reward | None
    workers: int | None
    on_progress: OnProgress
    stop: Callable[[], bool]

    def go(self, prepare: Callable[[Run], None]) -> Run:
        """Trains, and selects the policy; `prepare` makes the folder ready when everything has been checked."""
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
            if len(run.episodes) == config.episodes and config.training.selection:
                self._select(experiment, config.training.selection)
        return load_run(run.folder)

    def _train(self, agent: Trainable, trainer: Trainer) -> None:
        """Trains until all episodes are done or a stop is asked for, with checkpoints.

        Raises:
            WorkerDied: If a worker process is gone; a checkpoint is written before.
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
        """Makes the candidate that does best in validation worlds the policy."""
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
    """Has torch use one thread: the networks here are too small for several not to wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
