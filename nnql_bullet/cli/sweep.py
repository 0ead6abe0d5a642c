"""`nnql-bullet sweep`."""

from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.api import sweep as api
from nnql_bullet.cli.console import complain, progress, say
from nnql_bullet.cli.shared import ExecutorFlags
from nnql_bullet.text import shell_line


def sweep(
    file: Annotated[Path, tyro.conf.arg(metavar="FILE")],
    /,
    trials: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    check: bool = True,
    *,
    pieces: ExecutorFlags,
) -> int:
    """Search for the values of keys with which an agent learns best.

    FILE is a configuration as `train --config` takes it, with a table [sweep]: trials (40), seed (0), random (10: the
    first trials, drawn at random), together (4: trials of a round, which can run at a time), prune (true), and a table
    [sweep.space]. That has, for each key to search, a table of low and high, with log = true or step = X if wanted, or
    a list of values. The keys are those of `nnql-bullet keys`.

    Trials are compared by their last evaluation in validation worlds, so the file needs training.evaluate_every. Optuna
    draws the values (pip install 'nnql-bullet[sweep]'). Leaves best.toml, sweep.csv, sweep.json, sweep.png and, in
    trials/, a run folder of each trial. After an interrupt the same command goes on, to the same result.

    For example:

        my.toml:
          preset = "tuned"
          episodes = 600
          training.evaluate_every = 200
          [sweep.space]
          agent.gradient_step = { low = 0.01, high = 10.0, log = true }
          agent.encoding = ["proximity", "distance"]

        nnql-bullet sweep my.toml
        nnql-bullet sweep my.toml --trials 80
        nnql-bullet train --config runs/sweep-my/best.toml --seed 1

    Args:
        file: TOML file of a configuration with a table sweep.
        trials: Number of trials in place of the file's; a finished sweep goes on with more.
        out: Folder of the study and its trials; default runs/sweep-FILE.
        check: Leave out the check of a robot of your own when it is first driven in contact physics.
        pieces: Where pieces of work run.
    """
    folder = out or Path("runs") / f"sweep-{file.stem}"
    try:
        with progress() as show:
            results = api.sweep(
                file,
                trials=trials,
                **pieces.asked,
                out=folder,
                check=check,
                on_progress=show,
            )
    except KeyboardInterrupt:
        complain(f"interrupted; what is trained so far is kept in {folder}: the same command goes on")
        return 130
    say(results.table())
    say(f"picture: {folder / 'sweep.png'}")
    best = str(folder / "best.toml")
    say(f"best: {best}; train with it: {shell_line('nnql-bullet', 'train', '--config', best)}")
    return 0
