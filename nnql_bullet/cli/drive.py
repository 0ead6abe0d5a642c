"""`nnql-bullet drive`."""

import json
from pathlib import Path
from typing import Annotated, Any

import tyro

from nnql_bullet.cli import driving
from nnql_bullet.cli.console import say
from nnql_bullet.cli.filming import film_of, shoot, whole
from nnql_bullet.render.window import watch
from nnql_bullet.reports.plots import draw_trajectory
from nnql_bullet.run_config import SimulatorName
from nnql_bullet.runs import drives_folder
from nnql_bullet.sim.engines import PhysicsName

BEST = Path("double_dqn")
"""Of the shipped policies."""


def drive(
    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY", help_behavior_hint="")] = BEST,
    /,
    world: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE", help_behavior_hint="")] = None,
    seed: Annotated[int, tyro.conf.arg(metavar="S", help_behavior_hint="")] = 0,
    sim: Annotated[SimulatorName, tyro.conf.arg(help_behavior_hint="")] = "bullet",
    physics: Annotated[PhysicsName, tyro.conf.arg(help_behavior_hint="")] = "reference",
    shield: Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")] = False,
    friction: Annotated[float | None, tyro.conf.arg(metavar="MU", help_behavior_hint="")] = None,
    payload: Annotated[float | None, tyro.conf.arg(metavar="KG", help_behavior_hint="")] = None,
    noise: Annotated[float | None, tyro.conf.arg(metavar="M", help_behavior_hint="")] = None,
    dead_sector: Annotated[int | None, tyro.conf.arg(metavar="0..7", help_behavior_hint="")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None,
    video: Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")] = False,
    gui: Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")] = False,
    json_output: Annotated[
        bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(name="json", help_behavior_hint="")
    ] = False,
) -> int:
    """Drive a policy through a world that it has not seen, and leave a recording and a picture.

    A learned policy takes what it holds best. Training draws its worlds from seeds of a million and more, so every seed
    below is a world never trained in. A rule has nothing to learn: straight (at the target), random (turns where
    something is near), hand_rule, potential_field, fuzzy, vfh (VFH+) or look_ahead.

    For example:

        nnql-bullet drive --world traps --video
        nnql-bullet drive runs/paper-0
        nnql-bullet drive runs/paper-0 --world cover_10 --seed 4 --json
        nnql-bullet drive vfh --world cover_10 --video
        nnql-bullet drive straight --world cover_20 --shield

    Args:
        run: Run folder, a policy.safetensors, the name of a shipped policy or of a rule, or a TOML file that configures
            a rule; default double_dqn, the best of those that are shipped (`nnql-bullet policies` lists them).
        world: Shipped world (paper, cover_10, traps, aisles, moving, ...) or TOML file; default that of the training
            (rules: paper).
        seed: Of the world; default 0.
        sim: Contact physics (bullet, the default, or mujoco), whatever it was trained in, or the kinematic model
            (kinematic).
        physics: Solver settings of contact physics; default reference, the more exact.
        shield: Of what the policy would do, take the best that leaves room to stop; else brake, and turn on the spot.
        friction: Of the wheels against the ground, instead of the vehicle's own.
        payload: On the middle of the deck [kg].
        noise: Standard deviation of each ray [m].
        dead_sector: A sensor that sees nothing, untold; 0 is the front, counted counter-clockwise.
        out: Where trajectory.npz and trajectory.png go; default RUN/drives/WORLD-SEED, for a rule
            runs/RULE/drives/WORLD-SEED, with the simulator and conditions that were asked for behind it.
        video: Leave trajectory.mp4 as well; `render` draws others from the recording.
        gui: Show the drive in PyBullet's window, at the speed that it happened at. That needs a display.
        json_output: Print one JSON object instead of text.
    """
    conditions = driving.asked_conditions(friction, payload, noise, dead_sector)
    changes: dict[str, Any] = {"world": world, "simulator": sim, "physics": physics, "shield": {} if shield else None}
    changes["conditions"] = conditions
    recording, summary = driving.drive(run, seed, changes)
    name = [recording.world.name, str(seed), *([sim] if sim != "bullet" else []), *(["shield"] if shield else [])]
    name += [
        f"{what.replace('_', '-')}-{value:g}" for what, value in (conditions.changes if conditions else {}).items()
    ]
    folder = out or drives_folder(run) / "-".join(name)
    folder.mkdir(parents=True, exist_ok=True)
    recording.save(folder / driving.RECORDING)
    draw_trajectory(recording, folder / "trajectory.png")
    if video:
        film = film_of(folder / driving.RECORDING)
        shoot(film, whole(film.recording), folder / "trajectory.mp4")
    if gui:
        watch(recording)
    result = {
        "ending": summary.ending,
        "steps": summary.steps,
        "time": summary.duration,
        "path_length": summary.path_length,
        "smallest_clearance": summary.clearance,
        "seed": seed,
        "world": recording.world.name,
        "recording": str(folder / driving.RECORDING),
        "picture": str(folder / "trajectory.png"),
        **({"video": str(folder / "trajectory.mp4")} if video else {}),
    }
    if json_output:
        say(json.dumps(result))
    else:
        say(
            f"{summary.ending} in world '{recording.world.name}', seed {seed}: {summary.steps} steps, "
            f"{summary.duration:.1f} s, {summary.path_length:.1f} m, smallest clearance {summary.clearance:.2f} m"
        )
        say(f"picture: {result['picture']}")
        say(f"recording: {result['recording']}")
        if video:
            say(f"video: {result['video']}")
    return 0
