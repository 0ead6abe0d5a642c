"""`nnql-bullet train`."""

import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated, Literal

import tyro

from nnql_bullet.agents import Agent
from nnql_bullet.cli.console import err, progress, say
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment, load_config
from nnql_bullet.reports.plots import draw_learning_curve
from nnql_bullet.runs import LEARNING_CURVE, POLICY, Run, create_run, open_run
from nnql_bullet.training import loop

SAVE_EVERY = 10
"""Episodes from one checkpoint to the next."""
RECENT = 100
"""Episodes that the shown success is over."""


def train(
    config: Annotated[str | None, tyro.conf.arg(metavar="PRESET|FILE", help_behavior_hint="")] = None,
    sim: Annotated[
        Literal["bullet", "twin"] | None, tyro.conf.arg(metavar="bullet|twin", help_behavior_hint="")
    ] = None,
    episodes: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None,
    seed: Annotated[int | None, tyro.conf.arg(metavar="S", help_behavior_hint="")] = None,
    world: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE", help_behavior_hint="")] = None,
    physics: Annotated[
        Literal["fast", "reference"] | None, tyro.conf.arg(metavar="fast|reference", help_behavior_hint="")
    ] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None,
    resume: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None,
    overwrite: Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")] = False,
) -> int:
    """Train the vehicle, headless, and leave a run folder.

    The folder holds config.toml, episodes.csv, policy.safetensors, learning_curve.png and a checkpoint. The result is a
    function of the configuration and the seed. Ctrl-C ends after the present episode, with a checkpoint to go on from.

    For example:

        nnql-bullet train
        nnql-bullet train --config literal --seed 3 --out runs/mine
        nnql-bullet train --resume runs/mine --episodes 2000

    Args:
        config: Preset (paper, literal) or TOML file; default paper.
        sim: Contact physics (bullet, the default) or the ideal vehicle (twin: no slip, some ten times faster).
        episodes: Training episodes in all; default 1000.
        seed: Of the whole run; default 0.
        world: Shipped world (paper, cover_10, ...) or TOML file; default paper.
        physics: Solver settings of contact physics; default fast.
        out: Run folder; default runs/CONFIG-SEED.
        resume: Go on with the run in this folder, bit for bit as if it had never stopped.
        overwrite: Start anew in a folder that holds a run already.
    """
    if resume is not None:
        fixed = {"--config": config, "--sim": sim, "--seed": seed, "--world": world, "--physics": physics, "--out": out}
        given = [flag for flag, value in fixed.items() if value is not None] + ["--overwrite"] * overwrite
        if given:
            raise UserError(f"{given[0]} cannot go with --resume: a run goes on as it was configured")
        run, agent = open_run(resume, episodes, lambda c: Experiment(c).agent)
        experiment = Experiment(run.config)
    else:
        name = config or "paper"
        changes = {"simulator": sim, "episodes": episodes, "seed": seed, "world": world, "physics": physics}
        resolved = load_config(name, changes)
        experiment = Experiment(resolved)
        # What is wrong with world, robot or drive shows before anything is written.
        experiment.navigation.reset(experiment.training_world(0))
        agent = experiment.agent
        folder = out or Path("runs") / f"{Path(name).stem}-{resolved.seed}"
        run = create_run(folder, resolved, overwrite)
    total = run.config.episodes
    if len(run.episodes) == total:
        say(f"{run.folder} has its {total} episodes already; give more with --episodes")
        return 0
    where = "the ideal twin" if run.config.simulator == "twin" else f"{run.config.physics} contact physics"
    say(f"training {run.config.agent.kind} in {where}, world '{run.config.world}'")
    finished = _run(run, experiment, agent)
    draw_learning_curve(run.episodes, run.folder / LEARNING_CURVE)
    say(f"learning curve: {run.folder / LEARNING_CURVE}")
    if not finished:
        done = len(run.episodes)
        say(f"stopped after episode {done} of {total}; go on with: nnql-bullet train --resume {run.folder}")
        return 130
    say(f"policy: {run.folder / POLICY}; drive it with: nnql-bullet navigate {run.folder}")
    return 0


def _run(run: Run, experiment: Experiment, agent: Agent) -> bool:
    """Trains to the end or to an interrupt, with checkpoints; whether it came to the end."""
    total, done = run.config.episodes, len(run.episodes)
    episodes = loop.train(agent, experiment.navigation, experiment.training_world, run.config.seed, range(done, total))
    recent = deque((e.summary.ending == "goal" for e in run.episodes[-RECENT:]), maxlen=RECENT)
    steps, begin = 0, time.monotonic()
    with _interrupts() as interrupted, progress("training", total, done) as show:
        for episode in episodes:
            run.episodes.append(episode)
            recent.append(episode.summary.ending == "goal")
            steps += episode.summary.steps
            rate = steps / (time.monotonic() - begin)
            success = sum(recent) / len(recent)
            show(len(run.episodes), f"success {success:4.0%} of last {len(recent)}  {rate:.0f} steps/s")
            if interrupted() or len(run.episodes) % SAVE_EVERY == 0 or len(run.episodes) == total:
                run.save(agent)
            if interrupted():
                break
    return len(run.episodes) == total


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
