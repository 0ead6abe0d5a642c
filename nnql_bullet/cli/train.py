"""`nnql-bullet train`."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

import tyro

from nnql_bullet.api import training as api
from nnql_bullet.cli.console import complain, is_unread, progress, say
from nnql_bullet.cli.flags import KeyFlags
from nnql_bullet.cli.shared import tell_warnings
from nnql_bullet.cli.signals import held_back
from nnql_bullet.commands import flags
from nnql_bullet.errors import UserError, WorkerDied
from nnql_bullet.presets import load_config
from nnql_bullet.runs import LEARNING_CURVE, SELECTION, load_run
from nnql_bullet.text import shell_line
from nnql_bullet.training.checkpoint import POLICY
from nnql_bullet.work import Progress


def train(
    config: Annotated[str | None, tyro.conf.arg(metavar="PRESET|FILE")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    resume: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    overwrite: bool = False,
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    check: bool = True,
    log: Literal["tensorboard"] | None = None,
    keys: Annotated[Mapping[str, Any], KeyFlags()] = MappingProxyType({}),
) -> int:
    """Train the vehicle, headless, and leave a run folder.

    The folder holds config.toml, episodes.csv, policy.safetensors, learning_curve.png and a checkpoint. The result is a
    function of the configuration and the seed. Ctrl-C ends after the present episode, with a checkpoint to resume from;
    SIGTERM and a closed terminal do too.

    Presets: paper (NNQL, the default), literal (the same by the paper's letter), tuned (mirrored steps, the best of
    late states), q_table (a table, no network), genetic (a search over weights), double_dqn (decides every step, keeps
    a map), distilled (learns what a search says), sb3_dqn (DQN of stable-baselines3). tuned, double_dqn and distilled
    train 64 vehicles in the kinematic model.

    Every key of the configuration is a flag, such as --agent.discount, --speed, --conditions.payload or --rays; to list
    them: nnql-bullet keys --config double_dqn

    For example:

        nnql-bullet train --config literal --seed 3 --out runs/mine
        nnql-bullet train --config double_dqn --agent.discount 0.8 --conditions.payload 80
        nnql-bullet train --resume runs/mine --episodes 2000
        nnql-bullet train --config double_dqn --from double_dqn --world aisles --sim mujoco

    Args:
        config: Preset, or TOML file with keys over a preset.
        out: Run folder; default runs/CONFIG-SEED.
        resume: Continue the run in this folder as if it had never stopped (sb3_dqn redoes it first).
        overwrite: Start anew in a folder that holds a run already.
        workers: Processes (kinematic: threads); default one a core. They do not change the result.
        log: Also write returns, success, errors and speed into RUN/tensorboard.
        check: Leave out the check of a robot of your own when it is first driven in contact physics.
        keys: Keys of the configuration.
    """
    if resume is not None:
        given = ["--config"] * (config is not None) + ["--out"] * (out is not None) + ["--overwrite"] * overwrite
        given += flags({key: value for key, value in keys.items() if key != "episodes"})
        if given:
            raise UserError(f"{given[0]} cannot go with --resume: a run goes on as it was configured")
        run = load_run(resume, keys.get("episodes"))
        folder, total = resume, run.config.episodes
        if run.is_over:
            api.resume(folder, total)  # draws the learning curve, which a run that was killed may be without
            early = f"{folder} is over after {len(run.episodes)} episodes: {run.stopped_early}"
            say(early if run.stopped_early else f"{folder} has its {total} episodes already; give more with --episodes")
            return 0
    else:
        # A world that is asked for takes the place of a mix of worlds.
        mix = {"training": {"worlds": [], **keys.get("training", {})}} if "world" in keys else {}
        resolved = load_config(config or "paper", {**keys, **mix})
        tell_warnings([resolved.world], resolved.start, resolved.target)
        tell_warnings(resolved.training.worlds, None, None)
        folder, total = out or Path("runs") / f"{Path(config or 'paper').stem}-{resolved.seed}", resolved.episodes
    died: WorkerDied | None = None
    unread = False
    with held_back() as interrupted, progress() as show:

        def shown(now: Progress) -> None:
            nonlocal unread
            try:
                show(now)
            except OSError as error:
                if not is_unread(error):
                    raise
                unread = True

        def stop() -> bool:
            return unread or interrupted()

        try:
            if resume is not None:
                api.resume(folder, total, workers=workers, log=log, on_progress=shown, stop=stop)
            else:
                api.train(
                    resolved,
                    out=folder,
                    workers=workers,
                    overwrite=overwrite,
                    check=check,
                    log=log,
                    on_progress=shown,
                    stop=stop,
                )
        except WorkerDied as error:
            died = error
    run = load_run(folder)
    if run.episodes:
        say(f"learning curve: {folder / LEARNING_CURVE}")
    if run.is_over and not died:
        if run.config.training.selection:
            say(f"selection: {folder / SELECTION}")
        say(f"policy: {folder / POLICY}; drive it with: {shell_line('nnql-bullet', 'drive', str(folder))}")
        return 0
    again = shell_line("nnql-bullet", "train", "--resume", str(folder))
    stopped = f"stopped after episode {len(run.episodes)} of {total}; go on with: {again}"
    if died:
        complain(f"{died}; {stopped}")
        return 1
    say(stopped)
    return 130
