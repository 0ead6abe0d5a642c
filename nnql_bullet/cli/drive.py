"""`nnql-bullet drive`."""

from json import dumps
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import tyro

from nnql_bullet import driving
from nnql_bullet.cli.console import progress, say
from nnql_bullet.cli.flags import DriveKeys, Place, Waypoints, asked_for
from nnql_bullet.cli.worlds import tell_warnings
from nnql_bullet.driving import drive_folder, keep
from nnql_bullet.run_config import SimulatorName
from nnql_bullet.sim.engines import PhysicsName

BEST = Path("double_dqn")
"""The best of the shipped policies."""


def drive(
    policy: Annotated[Path, tyro.conf.arg(metavar="POLICY")] = BEST,
    /,
    world: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None,
    start: Annotated[Place, tyro.conf.arg(metavar="X,Y[,YAW]")] = None,
    target: Annotated[Place, tyro.conf.arg(metavar="X,Y")] = None,
    waypoints: Annotated[Waypoints, tyro.conf.arg(metavar="FILE|X,Y;...")] = None,
    plan: bool = False,
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    sim: SimulatorName = "bullet",
    physics: PhysicsName = "reference",
    shield: bool = False,
    allow_impassable: bool = False,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    video: bool = False,
    gui: bool = False,
    json: bool = False,
    check: bool = True,
    keys: DriveKeys = MappingProxyType({}),
) -> int:
    """Drive a policy through a world that it has not seen, and leave a recording and a picture.

    A learned policy takes the action that it values most. Every seed below a million is a world that no training draws.
    A rule has nothing to learn: straight (at the target), random (turns where something is near), hand_rule,
    potential_field, fuzzy, vfh (VFH+), look_ahead, or guided_search (plans several manoeuvres on a map of what it saw).

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
        start: Start, at rest, in the frame of the world's map [m, radians], in place of its own.
        target: Target in that frame, in place of its own.
        waypoints: Places in that frame to reach in turn; the last is the target. A file is CSV (x,y a line) or JSON.
        plan: Plan the way through the whole world, and lead the policy along it; moving obstacles are not in the plan.
            For goals beyond sight: a policy knows bearing and distance alone. Its lengths: --plan.look-ahead [m],
            --plan.room [m], --plan.caution.
        seed: Seed of the world.
        sim: Simulator; bullet and mujoco are contact physics.
        physics: Solver settings of contact physics.
        shield: Take the best action that leaves room to stop; else brake, and turn on the spot.
        allow_impassable: Drive even if the vehicle is too wide for every path to the target.
        out: Folder for trajectory.npz and .png; films of another drive in it are removed. Default
            RUN/drives/WORLD-SEED or runs/RULE/drives/WORLD-SEED.
        video: Leave trajectory.mp4 as well; `render` draws others from the recording.
        gui: Show the drive in PyBullet's window, in real time. It needs a display.
        json: Print one JSON object instead of text.
        check: Leave out the check of a robot of your own when it is first driven in contact physics.
        keys: Values in place of the policy's own.
    """
    asked, in_shield, planned = asked_for(keys), shield or "shield" in keys, plan or "plan" in keys
    if video:  # what films and shows is loaded where it is asked for
        from nnql_bullet.render.filming import render
        from nnql_bullet.render.video import check_encoder

        check_encoder()
    if gui:
        from nnql_bullet.render.window import check_window, watch

        check_window()
    tell_warnings([world], start, waypoints[-1] if waypoints else target)
    with progress() as show:
        recording = driving.drive(
            policy,
            world=world,
            start=start,
            target=target,
            waypoints=waypoints,
            plan=planned,
            seed=seed,
            simulator=sim,
            physics=physics,
            shield=in_shield,
            allow_impassable=allow_impassable,
            check=check,
            on_progress=show,
            **asked,
        )
    files = keep(recording, out or drive_folder(policy, recording.world.name, seed, sim, in_shield, planned, **asked))
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
