"""Makes worlds of other programs' maps and worlds, which say nothing of a start or a target."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees
from pathlib import Path
from typing import Any

from nnql_bullet.config import parse, to_values
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Pose, placed, wrap_angle
from nnql_bullet.worlds.ends import Ends, choose_ends
from nnql_bullet.worlds.importers import ForeignWorld, Reading, read_foreign
from nnql_bullet.worlds.layouts.boxes import boxes_of
from nnql_bullet.worlds.passages import Point
from nnql_bullet.worlds.source import WIDTH, World, check_inside, checked_place, in_frame
from nnql_bullet.worlds.spec import WorldSpec

TARGET_RADIUS = 1.0
"""Distance at which a target of a map is reached [m]."""
CLEARANCE = 0.1
"""How much wider than the vehicle the way between chosen ends is at least [m]."""
PASSAGES = (WIDTH + CLEARANCE, 0.5, 0.3, 0.15, 0.08)
"""Widths of the way between chosen ends that are tried for a vehicle that is not known [m]."""


@dataclass(frozen=True, slots=True)
class Imported:
    """A world of another program."""

    world: World
    format: str
    """What the file is."""
    notes: tuple[str, ...]
    """How it was read where it leaves a choice."""
    skipped: tuple[str, ...]
    """What is in the file and not in the world."""
    chosen: str = ""
    """The start or target that was chosen, in words; empty if the file or the caller had both."""

    @property
    def warnings(self) -> list[str]:
        """What a user should know who drives in it: what was chosen, and that something is left out."""
        more = f" and {len(self.skipped) - 1} more" if len(self.skipped) > 1 else ""
        return [*filter(None, [self.chosen]), *(f"left out: {what}{more}" for what in self.skipped[:1])]


def import_file(
    path: Path,
    reading: Reading | None = None,
    start: Sequence[float] | None = None,
    target: Sequence[float] | None = None,
    passage: float | None = None,
) -> Imported:
    """Reads a map or world of another program.

    Args:
        path: The file.
        reading: How it is read where it leaves a choice.
        start: x, y [m] and, if given, yaw [rad] of the start in the frame of the file.
        target: x, y [m] of the target in the frame of the file.
        passage: Width of the way between ends that are chosen [m]; by default one of `PASSAGES`, the widest that there
            is.

    Raises:
        UserError: If it is malformed, or no two places in it are far apart with a way between them.
    """
    found = read_foreign(path, reading or Reading())
    frame, chosen = found.frame, ""
    if start is None and found.start:
        start = found.start.x, found.start.y, found.start.yaw
    goal = found.target if target is None else target
    begin = None if start is None else in_frame(frame, checked_place("start", start))
    end = None if goal is None else in_frame(frame, checked_place("target", goal))
    for name, point in (("start", begin), ("target", end)):
        if point:
            check_inside(f"{path}: its {name}", point, (found.width, found.depth), frame)
    yaw = start[2] - frame.yaw if start and len(start) > 2 else None
    if begin is None or end is None:
        ends, chosen = _chosen(found, begin, end, passage, path)
        if begin is None:
            yaw = ends.start.yaw
        begin, end = (ends.start.x, ends.start.y), ends.target
    values: dict[str, Any] = {
        "name": path.stem,
        "width": found.width,
        "depth": found.depth,
        "origin": [frame.x, frame.y],
        "origin_yaw_degrees": round(degrees(frame.yaw), 9),
        "start": begin,
        "at_rest": True,
        "target": end,
        "target_radius": TARGET_RADIUS,
        "obstacle_height": found.obstacle_height,
        "layout": to_values(boxes_of(found.shapes)),
    }
    if yaw is not None:
        values["start_yaw_degrees"] = round(degrees(wrap_angle(yaw)), 6)
    return Imported(parse(World, values, str(path)), found.format, found.notes, found.skipped, chosen)


def _chosen(
    found: ForeignWorld, begin: Point | None, end: Point | None, passage: float | None, path: Path
) -> tuple[Ends, str]:
    """Chooses the ends that are not given, in the arena; and says so in the frame of the file."""
    arena = WorldSpec("", 0, found.width, found.depth, found.shapes, Pose(0.0, 0.0, 0.0), (0.0, 0.0), 1.0, 1.0)
    tried = (passage,) if passage else PASSAGES
    for width in tried:
        ends = choose_ends((found.width, found.depth), arena.solids, width, begin, end)
        if ends:
            x, y = placed(found.frame, ends.start.x, ends.start.y)
            u, v = placed(found.frame, *ends.target)
            names = [f"start ({x:.2f}, {y:.2f})"] if begin is None else []
            names += [f"target ({u:.2f}, {v:.2f})"] if end is None else []
            between = f"far apart, with a way at least {width:g} m wide between them"
            return ends, f"chosen: {' and '.join(names)}, {between}; others with --start x,y,yaw --target x,y"
    raise UserError(
        f"{path}: there are no two places far apart in it with a way {tried[-1]:g} m wide between them; give start and "
        "target, or a narrower robot"
    )
