"""Measures how a policy drives robots that it was not trained on, beside the vehicle that it was.

    python scripts/unseen_robots.py mir100.urdf turtlebot3_burger.urdf
    python scripts/unseen_robots.py mir100.urdf --policy double_dqn --worlds 100

A robot drives in worlds of the same kinds with every length as many times as large as the robot is, at its own speed,
and decides after ways that are as many times as long. Each description is translated as `nnql-bullet robot` does.
Prints success on validation worlds, bare and in a shield, in the kinematic model, and its share of the shipped
vehicle's.
"""

import argparse
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nnql_bullet as nb
from nnql_bullet import paper
from nnql_bullet.errors import UserError
from nnql_bullet.vehicle.controller import COMMAND_RATE, DriveOptions, own_speed
from nnql_bullet.vehicle.scale import length_scale

KINDS = ("cover_20", "traps", "aisles", "moving", "poles", "cluttered", "rooms", "cells")
NO_LENGTHS = ("cover", "fill", "gap_chance", "block_chance", "start_yaw_degrees", "origin_yaw_degrees")
SPEEDS = ("min_speed", "max_speed")


def resized(values: Any, size: float, pace: float) -> Any:
    """A world, or a part of its options, with every length and speed so many times as large."""
    if isinstance(values, tuple):
        return tuple(resized(value, size, pace) for value in values)
    if is_dataclass(values) and not isinstance(values, type):
        kept = {its.name: getattr(values, its.name) for its in fields(values) if its.name not in NO_LENGTHS}
        return replace(
            values, **{name: resized(value, pace if name in SPEEDS else size, pace) for name, value in kept.items()}
        )
    return size * values if isinstance(values, float) else values


def success(policy: str, robot: Path | None, a: argparse.Namespace) -> dict[str, tuple[float, str]]:
    """Success of a policy in all worlds together, as a share and in words, bare and in a shield, by method."""
    size, pace, asked = 1.0, 1.0, {}
    if robot:
        vehicle = nb.Vehicle.from_toml(robot)
        size, pace = length_scale(vehicle.footprint), own_speed(vehicle) / paper.SPEED
        period = round(DriveOptions().decision_period * size / pace * COMMAND_RATE) / COMMAND_RATE
        asked = {"robot": robot, "changes": {"drive": {"decision_period": period}}}
    print(f"{robot.stem if robot else 'tricycle'}: {size:.3f} times as large, {pace:.3f} times as fast", flush=True)
    results = nb.evaluate(
        policy,
        worlds=[resized(nb.World.load(kind), size, pace) for kind in KINDS],
        n_worlds=a.worlds,
        simulator="kinematic",
        shield=True,
        workers=a.workers,
        check=False,
        **asked,
    )
    print(results.table(), flush=True)
    rows = [row for row in results.methods if row.world not in KINDS]
    return {row.method: (row.outcomes["goal"].value, str(row.outcomes["goal"])) for row in rows}


def main() -> None:
    """Drives the shipped vehicle, then each robot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="+", help="descriptions of robots")
    parser.add_argument("--policy", default="distilled", help="a shipped policy or a run")
    parser.add_argument("--worlds", type=int, default=25, help="validation worlds of each kind")
    parser.add_argument("--workers", type=int, default=2, help="pieces of work at a time")
    a = parser.parse_args()
    try:
        own = success(a.policy, None, a)
        for file in map(Path, a.robots):
            with TemporaryDirectory() as folder:
                robot = nb.read_robot(file).save(Path(folder) / f"{file.stem}.toml")[0]
                for method, (share, words) in success(a.policy, robot, a).items():
                    base, base_words = own[method]
                    ratio = f"{100 * share / base:.1f} %" if base else "no share"
                    print(f"{file.stem}, {method}: {words} %, {ratio} of {base_words} %", flush=True)
    except UserError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
