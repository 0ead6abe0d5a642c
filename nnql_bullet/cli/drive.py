"""`nnql-bullet drive`."""

from json import dumps
from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet import driving
from nnql_bullet.cli.console import progress, say
from nnql_bullet.cli.kept import drive_folder, keep
from nnql_bullet.cli.shared import PlaceFlags, tell_warnings
from nnql_bullet.setting import Setting

BEST = Path("double_dqn")
"""The best of the shipped policies."""


def drive(
    policy: Annotated[Path, tyro.conf.arg(metavar="POLICY")] = BEST,
    /,
    world: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None,
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    video: bool = False,
    gui: bool = False,
    json: bool = False,
    *,
    drives: PlaceFlags,
) -> int:
    """Drive a policy through a world that it has not seen, and leave a recording and a picture.

    A learned policy takes the action that it values most. Every seed below a million is a world that no training draws.
    A rule has nothing to learn: straight (at the target), random (turns where something is near), hand_rule,
    potential_field, fuzzy, vfh (VFH+), look_ahead, dwa (dynamic window), pure_pursuit (along a plan), mppi, orca, or
    guided_search (plans several manoeuvres on a map of what it saw).

    For example:

        nnql-bullet drive --world traps --video
        nnql-bullet drive runs/paper-0 --world cover_10 --seed 4 --json
        nnql-bullet drive --world office.yaml --start 2,3,0 --waypoints "8,3;8,12" --plan --shield
        nnql-bullet drive vfh --shield --agent.window 6 --conditions.payload 80

    Args:
        policy: Run folder, policy file, shipped policy (see `nnql-bullet policies`), rule, or TOML file that configures
            a rule.
        world: Shipped world (paper, cover_10, traps, aisles, moving, ...), TOML file, ROS map, or other file that
            `nnql-bullet worlds` reads; default that of the training (rules: paper).
        seed: Seed of the world.
        out: Folder for trajectory.npz and .png; films of another drive in it are removed. Default
            RUN/drives/WORLD-SEED or runs/RULE/drives/WORLD-SEED.
        video: Leave trajectory.mp4 as well; `render` draws others from the recording.
        gui: Show the drive in PyBullet's window, in real time. It needs a display.
        json: Print one JSON object instead of text.
        drives: How policies drive.
    """
    asked = drives.asked
    if video:  # what films and shows is loaded where it is asked for
        from nnql_bullet.render.filming import render
        from nnql_bullet.render.video import check_encoder

        check_encoder()
    if gui:
        from nnql_bullet.render.window import check_window, watch

        check_window()
    tell_warnings([world], drives.start, drives.end)
    with progress() as show:
        recording = driving.drive(policy, world=world, seed=seed, on_progress=show, **asked)
    files = keep(recording, out or drive_folder(policy, recording.world.name, seed, Setting.of(asked)))
    if video:
        files["video"] = files["recording"].with_suffix(".mp4")
        with progress() as show:
            render(files["recording"], files["video"], workers=None, on_progress=show)
    if gui:
        watch(recording)
    summary = recording.summary
    result = {
        "ending": summary.ending,
        "steps": summary.steps,
        "time": summary.duration,
        "path_length": summary.path_length,
        "smallest_clearance": summary.clearance,
        "seed": seed,
        "world": recording.world.name,
        **({"waypoint_times": summary.waypoint_times} if recording.world.waypoints else {}),
        "robot": recording.about["vehicle"]["name"],
    }
    if json:
        say(dumps(result | {what: str(path) for what, path in files.items()}))
        return 0
    say(
        f"{summary.ending} in world '{recording.world.name}', seed {seed}: {summary.steps} steps, "
        f"{summary.duration:.1f} s, {summary.path_length:.1f} m, smallest clearance {summary.clearance:.2f} m"
    )
    times = [f"{number} after {time:.1f} s" for number, time in enumerate(summary.waypoint_times, 1)]
    if recording.world.waypoints:
        say(", ".join([f"way points: {len(times)} of {len(recording.world.waypoints)} reached", *times]))
    for what, path in files.items():
        say(f"{what}: {path}")
    return 0
