"""How long a step of `nnql_bullet.deploy` takes, with Numba and without: processor time on one core.

    python scripts/deploy_times.py paper double_dqn --shield

Each policy drives one world in the kinematic model. What it saw is told to a controller in a process of its own, at
each decision and at wheel commands between, with a new scan every tenth of a second.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from contextlib import suppress
from math import pi
from pathlib import Path
from time import process_time_ns

COMMANDS = 12
"""Calls from one scan to the next: 120 a second."""
WITHOUT = "numba", "torch", "scipy", "pybullet", "mujoco"


def main() -> None:
    """Drives, and times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policies", nargs="+")
    parser.add_argument("--shield", action="store_true", help="put them into a shield")
    parser.add_argument("--world", default="cover_20")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--replay", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--plain", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--library", type=Path, help=argparse.SUPPRESS)
    a = parser.parse_args()
    if a.replay:
        replay(a.policies[0], a.shield, a.replay, a.plain, a.library)
        return
    import nnql_bullet as nb
    from nnql_bullet.exports.running import build

    threads = {name: "1" for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS")}
    with tempfile.TemporaryDirectory() as folder:
        for policy in a.policies:
            drive = Path(folder) / "drive.npz"
            nb.drive(policy, world=a.world, seed=a.seed, shield=a.shield, simulator="kinematic").save(drive)
            ways = [[], ["--plain"]]
            with suppress(nb.UserError):  # not every policy is exported to C
                exported = nb.export(policy, to="c", with_shield=a.shield, out=Path(folder) / policy)
                library = build(exported.folder, Path(folder) / f"{policy}.so")
                ways.append(["--plain", "--library", str(library)])
            for way in ways:
                asked = [policy, "--replay", str(drive), *(["--shield"] if a.shield else []), *way]
                subprocess.run([sys.executable, __file__, *asked], check=True, env=os.environ | threads)


def replay(policy: str, shield: bool, drive: Path, plain: bool, library: Path | None) -> None:
    """Tells a controller what was seen in a drive, and prints how long its steps took."""
    if plain:
        sys.modules.update(dict.fromkeys(WITHOUT))  # type: ignore[arg-type]  # None stands for what is not there
    import numpy as np

    from nnql_bullet.deploy import Controller, Odometry, Scan, WatchOptions
    from nnql_bullet.recording import load_recording

    recording = load_recording(drive)
    sensor, first = recording.sensor, recording.sensor.angles
    watch = WatchOptions(target_radius=0.1, most_jump=5.0, most_yaw_jump=pi)  # poses are those of the decisions
    controller = Controller(policy, shield=shield, watch=watch, library=library)
    deciding, following = list[float](), list[float]()
    for time, (x, y, yaw), distances in zip(
        recording.state_time[:-1].tolist(),
        recording.state_pose[:-1].tolist(),
        recording.ray_distances[:-1],
        strict=True,
    ):
        for k in range(5 * COMMANDS):
            now, scanned = time + k / 120, time + k // COMMANDS / 10
            ranges = np.where(sensor.met(distances), distances, np.inf)
            scan = Scan(ranges, first[0], first[-1], first[1] - first[0], 0.05, 30.0, scanned)
            began = process_time_ns()
            command = controller.step(scan, Odometry(x, y, yaw, now), recording.world.target, now)
            (deciding if command.decided else following).append((process_time_ns() - began) / 1e3)
    how = "in C, without Numba" if library else "without Numba" if plain else "with Numba"
    name = f"{policy}{' + shield' if shield else ''}, {how}"
    for what, times in (("decision", deciding), ("command between", following), ("all calls", deciding + following)):
        low, middle, high = np.percentile(times, [10, 50, 90])
        rest = f"mean {np.mean(times):.0f}, most {max(times):.0f}"
        print(f"{name}: {what}: median {middle:.0f} us ({low:.0f} to {high:.0f}), {rest}")


if __name__ == "__main__":
    main()
