"""Readers of other programs' maps and worlds, one module a format, chosen by the suffix and the content of a file."""

from pathlib import Path

from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file
from nnql_bullet.worlds.importers.barn import number_of, read_barn
from nnql_bullet.worlds.importers.base import ForeignWorld, Reading
from nnql_bullet.worlds.importers.geojson import read_geojson
from nnql_bullet.worlds.importers.moving_ai import read_moving_ai
from nnql_bullet.worlds.importers.ros_map import read_ros_map
from nnql_bullet.worlds.importers.sdf import read_sdf

READERS = {
    **dict.fromkeys((".yaml", ".yml"), read_ros_map),
    **dict.fromkeys((".world", ".sdf", ".xml"), read_sdf),
    ".map": read_moving_ai,
    **dict.fromkeys((".geojson", ".json"), read_geojson),
}
"""Readers by suffix."""
PICTURES = (".pgm", ".png", ".bmp")
"""Suffixes of pictures, which are not read without the YAML that names them."""


def is_foreign(path: Path) -> bool:
    """Whether a file has a suffix of other programs' maps and worlds."""
    return path.suffix.lower() in (*READERS, *PICTURES)


def read_foreign(path: Path, reading: Reading) -> ForeignWorld:
    """Reads a map or world of another program.

    Raises:
        UserError: If there is no such file, no reader for it, or it is malformed.
    """
    if not is_file(path):
        raise UserError(f"{path}: is a folder, not a file" if path.is_dir() else f"{path}: there is no such file")
    suffix = path.suffix.lower()
    if suffix in PICTURES:
        raise UserError(f"{path}: is a picture; give the YAML file of the map, which has its scale and its origin")
    reader = READERS.get(suffix)
    if reader is None:
        raise UserError(f"{path}: there is no reader for '{suffix}'; there are: {', '.join(READERS)}")
    return read_barn(path, reading) if reader is read_sdf and number_of(path) is not None else reader(path, reading)


__all__ = ["PICTURES", "READERS", "ForeignWorld", "Reading", "is_foreign", "read_foreign"]
