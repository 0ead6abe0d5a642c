"""`nnql-bullet ablate`."""

from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.api import ablate as api
from nnql_bullet.cli.console import complain, items, progress, say
from nnql_bullet.cli.shared import DrivingFlags, ExecutorFlags
from nnql_bullet.run_config import SimulatorName


def ablate(
    preset: Annotated[str, tyro.conf.arg(metavar="PRESET")] = "paper",
    /,
    seeds: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    sim: SimulatorName = "kinematic",
    only: Annotated[str | None, tyro.conf.arg(metavar="FACTOR,...")] = None,
    world: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE,...")] = None,
    episodes: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    vehicles: Annotated[int, tyro.conf.arg(metavar="N")] = 64,
    worlds: Annotated[int, tyro.conf.arg(metavar="N")] = 300,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    *,
    drives: DrivingFlags,
    pieces: ExecutorFlags,
) -> int:
    """Measure what each factor of a preset is worth.

    Of `paper` these are the factors that the paper leaves open, of `tuned` the ways back to the paper's numbers, of
    `double_dqn` the parts that could be left out. Every variant changes one factor, is trained from several seeds and
    tested on validation worlds. Prints what the evidence decides, and leaves ablation.md, ablation.json, ablation.csv
    and ablation.png. Finished trainings are kept in DIR/parts: after an interrupt the same command goes on.

    For example:

        nnql-bullet ablate
        nnql-bullet ablate --only period,encoding --seeds 3
        nnql-bullet ablate double_dqn
        nnql-bullet ablate tuned --only discount --robot robot.toml --world hall.toml

    Args:
        preset: paper, tuned or double_dqn.
        seeds: Trainings of each variant; default 12, of double_dqn 8.
        sim: Simulator; kinematic takes half an hour on two cores, the others a day.
        only: Some factors, by name; a wrong one has all of them listed.
        world: Worlds in place of the study's, to train and to test in.
        episodes: Episodes of each training; default 1000, of double_dqn 4000.
        vehicles: Vehicles that each training learns from in lockstep.
        worlds: Validation worlds of each kind.
        out: Folder of the report; default runs/ablation, of another preset runs/ablation-PRESET.
        drives: How policies drive.
        pieces: Where pieces of work run.
    """
    folder = out or Path("runs") / ("ablation" if preset == "paper" else f"ablation-{preset}")
    try:
        with progress() as show:
            results = api.ablate(
                preset,
                only=None if only is None else items(only),
                seeds=seeds,
                simulator=sim,
                worlds=items(world) or None,
                episodes=episodes,
                vehicles=vehicles,
                n_worlds=worlds,
                **drives.asked,
                **pieces.asked,
                out=folder,
                on_progress=show,
            )
    except KeyboardInterrupt:
        complain(f"interrupted; trainings that are done are kept in {folder / 'parts'}: the same command goes on")
        return 130
    for question, decision in results.decisions.items():
        say(f"{question}: {decision}")
    say(f"report: {folder / 'ablation.md'}")
    return 0
