"""Drives along plans between places of maps that are beyond sight, and prints how often a vehicle arrives.

Start and target of a pair are drawn evenly from the places with room to turn round, between which the vehicle passes;
it starts along its plan, at rest. `office`, `maze` and `playground` are maps that this script makes; any other
name is a file or a shipped world.

    python scripts/beyond_sight.py office maze playground --robot jackal_tricycle
    python scripts/beyond_sight.py depot.yaml warehouse.yaml --robot jackal_tricycle --speed 1 --failures failures/
"""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.ndimage import label

import nnql_bullet as nb
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.statistics import proportion
from nnql_bullet.geometry import placed
from nnql_bullet.recording import Recording
from nnql_bullet.reports.tables import text_table
from nnql_bullet.vehicle.scale import turning_radius
from nnql_bullet.worlds.paths import free_cells

CELL = 0.05
"""Side of the cells from which places are drawn [m]."""
SPARE = 0.1
"""Least clearance of both ends beyond the turning radius, and of the way beyond the width [m]."""
FARTHER = 10.0
"""Least distance between start and target, in turning radii."""
RESOLUTIONS = {"office": 0.05, "maze": 0.03, "playground": 0.1}
"""Cells of the maps of this script [m]."""
Box = tuple[float, ...]


def wall(x: float, y: float, u: float, v: float, thickness: float = 0.1) -> Box:
    """A wall between two places [m]."""
    return (x + u) / 2, (y + v) / 2, abs(u - x) + thickness, abs(v - y) + thickness


def maze(rng: np.random.Generator) -> tuple[list[Box], tuple[float, float]]:
    """A maze without islands, of corridors 1 m wide."""
    columns, rows, pitch = 14, 10, 1.1
    closed = {((c, r), (c + 1, r)) for c in range(columns - 1) for r in range(rows)}
    closed |= {((c, r), (c, r + 1)) for c in range(columns) for r in range(rows - 1)}
    trail, seen = [(0, 0)], {(0, 0)}
    while trail:
        c, r = trail[-1]
        others = [its for its in ((c + 1, r), (c - 1, r), (c, r + 1), (c, r - 1)) if its not in seen]
        others = [(i, j) for i, j in others if 0 <= i < columns and 0 <= j < rows]
        if not others:
            trail.pop()
            continue
        there = others[rng.integers(len(others))]
        closed.discard((min((c, r), there), max((c, r), there)))
        trail.append(there)
        seen.add(there)
    walls = []
    for (c, r), (i, _) in sorted(closed):
        walls.append(
            wall((c + 1) * pitch, r * pitch, (c + 1) * pitch, (r + 1) * pitch)
            if i > c
            else wall(c * pitch, (r + 1) * pitch, (c + 1) * pitch, (r + 1) * pitch)
        )
    return walls, (columns * pitch, rows * pitch)


def office(rng: np.random.Generator) -> tuple[list[Box], tuple[float, float]]:
    """Rooms with desks, shelves and chairs on both sides of two corridors, behind doors 0.9 m wide."""
    walls, width, room, corridor, door = [], 28.0, 4.0, 1.8, 0.9
    for base in (0.0, 2 * room + corridor):
        for lower, inner in ((base, base + room), (base + room + corridor, base + room + corridor)):
            for k in range(7):
                left = k * room
                walls.append(wall(left, lower, left, lower + room))
                gap = left + rng.uniform(0.4, room - door - 0.4)
                walls += [wall(left, inner, gap - 0.05, inner), wall(gap + door + 0.05, inner, left + room, inner)]
                middle = lower + room / 2
                walls.append((left + rng.uniform(1.2, 2.8), middle + rng.uniform(-0.4, 0.4), 1.4, 0.7))
                walls.append((left + rng.uniform(0.5, 3.5), middle + rng.uniform(-0.8, 0.8), 0.45, 0.45, 30.0))
                back = lower + 0.25 if inner > lower else lower + room - 0.25
                walls.append((left + 1.0, back, 1.2, 0.4))
    middle = 2 * room + corridor
    opening = rng.uniform(5.0, 20.0)
    walls += [wall(0, middle, opening, middle), wall(opening + 1.2, middle, width, middle)]
    return walls, (width, 4 * room + 2 * corridor)


def playground(rng: np.random.Generator) -> tuple[list[Box], tuple[float, float]]:
    """Beams at any angle, hooks, stars and small posts."""
    boxes, width, depth = [], 20.0, 14.0
    for _ in range(26):
        x, y, yaw = rng.uniform(0.5, width - 0.5), rng.uniform(0.5, depth - 0.5), rng.uniform(0, 180)
        long, c, s = rng.uniform(0.4, 2.6), np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
        boxes.append((x, y, long, 0.2, yaw))
        kind = rng.integers(4)
        if kind == 0:  # a hook
            boxes.append((x + long / 2 * c, y + long / 2 * s, 1.2, 0.2, yaw + 90))
        elif kind == 1:  # a star
            boxes += [(x, y, long, 0.2, yaw + 60), (x, y, long, 0.2, yaw + 120)]
    for _ in range(25):
        boxes.append((rng.uniform(0.5, width - 0.5), rng.uniform(0.5, depth - 0.5), 0.25, 0.25, rng.uniform(0, 90)))
    return boxes, (width, depth)


MADE = {"office": office, "maze": maze, "playground": playground}


def load(name: str, seed: int) -> nb.World:
    """Reads a world, or makes one and reads it as a ROS map."""
    if name not in MADE:
        return nb.World.load(name)
    boxes, (width, depth) = MADE[name](np.random.default_rng(seed))
    ends = {"start": (0.5, 0.5), "target": (width - 0.5, depth - 0.5)}
    world = nb.World.from_boxes(boxes, name=name, width=width, depth=depth, target_radius=0.5, **ends)
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"{name}.yaml"
        nb.export_world(world, file, cell=RESOLUTIONS[name])
        return nb.import_world(file, **ends).world


def pairs(world: nb.World, vehicle: nb.Vehicle, count: int, seed: int) -> list[tuple[Sequence[float], ...]]:
    """Draws starts and targets between which the vehicle passes, in the frame of the map [m]."""
    drawn = world.draw(0, allow_impassable=True)
    shape, radius = (int(drawn.depth / CELL), int(drawn.width / CELL)), turning_radius(vehicle.footprint)
    regions, _ = label(free_cells(shape, CELL, drawn.solids, (vehicle.width + SPARE) / 2), np.ones((3, 3)))
    roomy = np.argwhere(free_cells(shape, CELL, drawn.solids, radius + SPARE / 2) & (regions > 0))
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        one, other = roomy[rng.integers(len(roomy), size=2)]
        if regions[tuple(one)] == regions[tuple(other)] and CELL * np.hypot(*(one - other)) > FARTHER * radius:
            (x, y), (u, v) = ((CELL * (cell[::-1] + 0.5)).tolist() for cell in (one, other))
            found.append((placed(world.frame, x, y), placed(world.frame, u, v)))
    return found


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("maps", nargs="+", metavar="MAP", help="office, maze, playground, a file or a shipped world")
    parser.add_argument("--policy", default="double_dqn")
    parser.add_argument("--robot", default="tricycle")
    parser.add_argument("--sim", default="kinematic")
    parser.add_argument("--speed", type=float)
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="seed of the maps that are made, and of the pairs")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=X", help="keys of the plan, such as look_ahead=2")
    parser.add_argument("--failures", type=Path, help="folder for pictures of the drives that did not arrive")
    a = parser.parse_args()
    plan = {key: float(value) for key, _, value in (its.partition("=") for its in a.set)}
    how = {"simulator": a.sim, "robot": a.robot, "speed": a.speed, "changes": {"plan": plan}}
    vehicle, rows = nb.Vehicle.load(a.robot), []
    for name in a.maps:
        world, drives, began = load(name, a.seed), list[Recording](), time.monotonic()
        for number, (start, target) in enumerate(pairs(world, vehicle, a.pairs, a.seed)):
            its = world.between(start, target)
            drive = nb.drive(a.policy, world=its, shield=True, **how)
            drives.append(drive)
            if a.failures and drive.summary.ending != "goal":
                a.failures.mkdir(parents=True, exist_ok=True)
                drive.plot(a.failures / f"{world.name}-{a.seed}-{number}.png")
        endings = Counter(drive.summary.ending for drive in drives)
        arrived = [drive.summary for drive in drives if drive.summary.ending == "goal"]
        others = ", ".join(f"{count} {ending}" for ending, count in endings.items() if ending != "goal")
        duration = f"{np.mean([its.duration for its in arrived]):.0f}" if arrived else "-"
        speed = f"{np.mean([its.path_length / its.duration for its in arrived]):.2f}" if arrived else "-"
        estimate = str(proportion(endings["goal"], len(drives)))
        rows.append((world.name, estimate, others or "-", duration, speed, f"{time.monotonic() - began:.0f}"))
        print(rows[-1], file=sys.stderr, flush=True)
    print(text_table(("map", "arrived %", "others", "time s", "speed m/s", "computed s"), rows))
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except UserError as error:
        sys.exit(f"beyond_sight: {error}")
