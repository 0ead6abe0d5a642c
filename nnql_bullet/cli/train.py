"""`nnql-bullet train`."""

import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated

import torch
import tyro

from nnql_bullet.agents import Trainable
from nnql_bullet.cli.console import complain, err, progress, say
from nnql_bullet.env import Navigation
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.presets import load_config
from nnql_bullet.reports.plots import draw_learning_curve
from nnql_bullet.run_config import SimulatorName
from nnql_bullet.runs import LEARNING_CURVE, POLICY, SELECTION, Run, open_run
from nnql_bullet.sim.base import WorkerDied
from nnql_bullet.sim.engines import PhysicsName
from nnql_bullet.training.base import Trainer
from nnql_bullet.training.selection import SelectionOptions, finalists, keep

SAVE_EVERY = 5.0
"""Seconds from one checkpoint to the next."""
RECENT = 100
"""Episodes that the shown success is over."""


def train(
    config: Annotated[str | None, tyro.conf.arg(metavar="PRESET|FILE", help_behavior_hint="")] = None,
    sim: Annotated[
        SimulatorName | None, tyro.conf.arg(metavar="bullet|mujoco|kinematic", help_behavior_hint="")
    ] = None,
    episodes: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None,
    seed: Annotated[int | None, tyro.conf.arg(metavar="S", help_behavior_hint="")] = None,
    world: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE", help_behavior_hint="")] = None,
    physics: Annotated[PhysicsName | None, tyro.conf.arg(metavar="fast|reference", help_behavior_hint="")] = None,
    vehicles: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None,
    workers: Annotated[int | None, tyro.conf.arg(metavar="W", help_behavior_hint="")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None,
    resume: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None,
    overwrite: Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")] = False,
) -> int:
    """Train the vehicle, headless, and leave a run folder.

    The folder holds config.toml, episodes.csv, policy.safetensors, learning_curve.png and a checkpoint. The result is a
    function of the configuration and the seed. Ctrl-C ends after the present episode, with a checkpoint to go on from.
    With the table training.selection in the configuration, late states of the training are tried in
    validation worlds in the kinematic model, whatever it drove in; the best is the policy, and selection.csv says how
    all did.

    For example:

        nnql-bullet train
        nnql-bullet train --config literal --seed 3 --out runs/mine
        nnql-bullet train --vehicles 64 --out runs/quick
        nnql-bullet train --vehicles 64 --sim kinematic --out runs/quicker
        nnql-bullet train --config genetic --vehicles 200 --sim kinematic
        nnql-bullet train --config tuned
        nnql-bullet train --config double_dqn --seed 1
        nnql-bullet train --resume runs/mine --episodes 2000

    Args:
        config: TOML file or preset: paper (NNQL, the default), literal (the same by the paper's letter), tuned (the
            same with numbers set by evidence; in the kinematic model, 64 vehicles), q_table (a table instead of the
            network), genetic (a search over its weights), double_dqn (which decides every step and keeps a map; in the
            kinematic model, 64 vehicles, a mix of worlds) or sb3_dqn (DQN of stable-baselines3).
        sim: Contact physics (bullet, the default, or mujoco) or the kinematic model (kinematic: no slip, much faster).
        episodes: Training episodes in all; default 1000, with genetic 20000, with double_dqn 12000.
        seed: Of the whole run; default 0.
        world: Shipped world (paper, cover_10, ...) or TOML file; default paper, tuned cover_7.5, double_dqn a mix.
        physics: Solver settings of contact physics; default fast.
        vehicles: One policy learns from so many at once, each in its own world; default 1, as in the paper.
        workers: Processes (kinematic: threads) to share them among; default one a core. The result does not depend on
            it.
        out: Run folder; default runs/CONFIG-SEED.
        resume: Go on with the run in this folder, bit for bit as if it had never stopped; sb3_dqn redoes it first.
        overwrite: Start anew in a folder that holds a run already.
    """
    if resume is not None:
        fixed = {"--config": config, "--sim": sim, "--seed": seed, "--world": world, "--physics": physics, "--out": out}
        fixed["--vehicles"] = vehicles
        given = [flag for flag, value in fixed.items() if value is not None] + ["--overwrite"] * overwrite
        if given:
            raise UserError(f"{given[0]} cannot go with --resume: a run goes on as it was configured")
        run, state = open_run(resume, episodes)
        if run.is_over:
            say(f"{run.folder} has its {run.config.episodes} episodes already; give more with --episodes")
            return 0
        experiment = Experiment(run.config)
    else:
        name = config or "paper"
        changes = {"simulator": sim, "episodes": episodes, "seed": seed, "world": world, "physics": physics}
        mix: dict[str, list[str]] | None = None if world is None else {"worlds": []}
        resolved = load_config(name, {**changes, "vehicles": vehicles, "training": mix})
        experiment, state = Experiment(resolved), None
        experiment.trainable  # noqa: B018 (refuses rules)
        # What is wrong with worlds or robot shows before anything is written.
        experiment.training_world(0)
        experiment.selection_worlds  # noqa: B018
        run = Run(out or Path("runs") / f"{Path(name).stem}-{resolved.seed}", resolved, [])
    c = run.config
    torch.set_num_threads(1)  # the networks here are too small for threads not to wait for each other
    with closing(experiment.new_training_simulator(workers)) as simulator:
        agent = experiment.trainable
        training = experiment.trainer(Navigation(simulator, c.task))
        where = "the kinematic model" if c.simulator == "kinematic" else f"{c.physics} contact physics"
        several = "" if c.vehicles == 1 else f", {c.vehicles} vehicles in lockstep"
        try:
            if state:
                agent.load_state_dict(state.learned)
                training.load_state_dict(state.under_way)
            if resume is None:
                run.create(overwrite)
            else:
                run.save_config()
            worlds = ", ".join(f"'{name}'" for name in dict.fromkeys(c.training.worlds or (c.world,)))
            say(f"training {c.agent.kind} in {where}, world {worlds}{several}")
            finished, died = len(run.episodes) == c.episodes or _run(run, agent, training), None
        except WorkerDied as error:
            finished, died = False, error
    if run.episodes:
        draw_learning_curve(run.episodes, run.folder / LEARNING_CURVE)
        say(f"learning curve: {run.folder / LEARNING_CURVE}")
    if finished:
        if c.training.selection:
            _select(run, experiment, c.training.selection, workers)
        say(f"policy: {run.folder / POLICY}; drive it with: nnql-bullet drive {run.folder}")
        return 0
    stopped = f"stopped after episode {len(run.episodes)} of {c.episodes}"
    go_on = f"go on with: nnql-bullet train --resume {run.folder}"
    if died:
        complain(f"{died}; {stopped}; {go_on}")
        return 1
    say(f"{stopped}; {go_on}")
    return 130


def _run(run: Run, agent: Trainable, training: Trainer) -> bool:
    """Trains to the end or to an interrupt, with checkpoints; whether it came to the end.

    Raises:
        WorkerDied: If a worker process is gone; a checkpoint is written before.
    """
    total, begin = run.config.episodes, time.monotonic()
    recent = deque((e.summary.ending == "goal" for e in run.episodes[-RECENT:]), maxlen=RECENT)
    steps, saved, selection = 0, begin, run.config.training.selection
    with _interrupts() as interrupted, progress("training", total, len(run.episodes)) as show:
        try:
            for episode in training.episodes():
                run.episodes.append(episode)
                if selection:
                    keep(run.candidates, len(run.episodes), agent, selection)
                recent.append(episode.summary.ending == "goal")
                steps += episode.summary.steps
                done, now = len(run.episodes), time.monotonic()
                success, rate = sum(recent) / len(recent), steps / (now - begin)
                show(done, f"success {success:4.0%} of last {len(recent)}  {rate:.0f} steps/s")
                if interrupted() or done == total or now - saved >= SAVE_EVERY:
                    run.save(agent, training)
                    saved = now
                if interrupted() or done == total:
                    break
        except WorkerDied:
            run.save(agent, training)
            if not interrupted():  # else whatever interrupted this process reached that one too
                raise
    return len(run.episodes) == total


def _select(run: Run, experiment: Experiment, selection: SelectionOptions, workers: int | None) -> None:
    """Makes the candidate that does best in validation worlds the policy."""
    candidates = finalists(run.candidates, len(run.episodes), experiment.trainable, selection)
    worlds = len(experiment.selection_worlds)
    say(f"trying {len(candidates)} candidates in {worlds} validation worlds, in the kinematic model")
    goals = experiment.try_out(candidates, workers)
    best = run.save_selected(candidates, goals, worlds)
    others = f"the {len(goals)} came to {min(goals.values())} to {max(goals.values())}; all: {run.folder / SELECTION}"
    say(f"selected: what was learned after {best} episodes, with {goals[best]} goals of {worlds}; {others}")


@contextmanager
def _interrupts() -> Iterator[Callable[[], bool]]:
    """Holds Ctrl-C and SIGTERM back until the present episode is over; a second one ends at once."""
    asked = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        err.print("ending after this episode (once more: at once, from the last checkpoint)", markup=False)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
