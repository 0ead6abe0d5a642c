"""Writers of drawn worlds for other programs, one module a format, chosen by the suffix of the file."""

from pathlib import Path

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Pose
from nnql_bullet.worlds.exporters.ros_map import write_ros_map
from nnql_bullet.worlds.exporters.sdf import write_sdf
from nnql_bullet.worlds.spec import WorldSpec

CELL = 0.05
"""Side of a cell of ROS maps by default [m]."""
SUFFIXES = (".toml", ".yaml", ".yml", ".world", ".sdf")
"""Of files that worlds are written to."""


def check_suffix(path: Path) -> None:
    """Checks that a world can be written to a file of this name.

    Raises:
        UserError: If not.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(f"{path}: worlds are written to files that end in one of: {', '.join(SUFFIXES)}")


def write_foreign(world: WorldSpec, frame: Pose, path: Path, cell: float = CELL) -> list[Path]:
    """Writes a world in the frame of its map, without what moves.

    Args:
        world: The world.
        frame: The arena's lower left corner in the frame of the map.
        path: A file that ends in .yaml or .yml (ROS map), .world or .sdf (SDF).
        cell: Side of a cell of a ROS map [m].

    Returns:
        The files that were written.

    Raises:
        UserError: If a map has too many cells.
    """
    if path.suffix.lower() in (".yaml", ".yml"):
        return write_ros_map(world, frame, path, cell)
    return write_sdf(world, frame, path)


__all__ = ["CELL", "SUFFIXES", "check_suffix", "write_foreign"]
