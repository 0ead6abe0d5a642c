"""Reads maps of the ROS map servers: a YAML file and the picture that it names.

Thresholds, modes and the lower left origin are those of map_server (ROS 1) and nav2_map_server (ROS 2). A cell is
occupied above `occupied_thresh`, free below `free_thresh`, and unknown between them.
"""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image
from PIL.Image import DecompressionBombError, DecompressionBombWarning

from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file, read_text
from nnql_bullet.geometry import Array
from nnql_bullet.types import LARGEST
from nnql_bullet.worlds.importers.base import ForeignWorld, Reading, counted, turned_corner
from nnql_bullet.worlds.importers.cells import check_size, merged_boxes, trimmed

MOST_YAML, MOST_PICTURE = 100_000, 200_000_000
"""Sizes of the largest files that are read [bytes]."""
GREY = 205
"""What map savers write for unknown."""
MODES = ("trinary", "scale", "raw")
FREE, OCCUPIED, UNKNOWN = 0, 1, 2
_DAMAGED = (
    *(DecompressionBombError, DecompressionBombWarning, EOFError, IndexError, OSError, OverflowError, SyntaxError),
    *(TypeError, ValueError, struct.error),
)
"""What Pillow raises for damaged files."""


class _Loader(yaml.SafeLoader):  # type: ignore[misc]  # of a library without types
    """Reads plain values: without aliases, of which few can stand for billions of values."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Refuses an alias."""
        if self.check_event(yaml.events.AliasEvent):
            raise yaml.YAMLError("it has aliases (*name); write out what they stand for")
        return super().compose_node(parent, index)


def read_ros_map(path: Path, reading: Reading) -> ForeignWorld:
    """Reads a map.

    Raises:
        UserError: If one of the two files is missing, too large or malformed, or no cell is free.
    """
    values = _yaml_values(path)
    picture, side = _picture_of(values, path), _number(values, "resolution", path)
    if not 0 < side <= 100:
        raise UserError(f"{path}: 'resolution' is the side of a cell in metres, above 0 and up to 100, not {side:g}")
    low, high = _number(values, "free_thresh", path, 0.196), _number(values, "occupied_thresh", path, 0.65)
    if not 0 <= low <= high <= 1:
        raise UserError(f"{path}: must be 0 <= free_thresh <= occupied_thresh <= 1, not {low:g} and {high:g}")
    mode = values.get("mode", "trinary")
    if mode not in MODES:
        raise UserError(f"{path}: 'mode' must be one of: {', '.join(MODES)}")
    x, y, yaw = _origin(values, path)
    cells, notes = _occupancy(picture, side, mode, _negate(values, path), (low, high), reading)
    turned = yaw != 0
    if turned and reading.yaw == "apply":
        notes.append(f"the origin's yaw of {yaw:g} rad turns the map; Nav2's costmaps ignore it: yaw ignore")
    elif turned:
        notes.append(f"the origin's yaw of {yaw:g} rad is ignored, as Nav2's costmaps do: yaw apply")
    unknown = int((cells == UNKNOWN).sum())
    solid = cells == OCCUPIED
    if reading.unknown == "solid":
        solid |= cells == UNKNOWN
    notes.append(f"{unknown} of {cells.size} cells are unknown and count as {reading.unknown}")
    solid, left, below = trimmed(solid, path)
    boxes = merged_boxes(solid, side, path)
    return ForeignWorld(
        format="ROS map",
        shapes=tuple(boxes),
        width=round(solid.shape[1] * side, 6),
        depth=round(solid.shape[0] * side, 6),
        frame=turned_corner(x, y, yaw if reading.yaw == "apply" else 0.0, left * side, below * side),
        files=(path, picture),
        notes=(f"{int(solid.sum())} solid cells of {side:g} m are {counted(len(boxes), 'box', 'boxes')}", *notes),
    )


def _yaml_values(path: Path) -> dict[str, Any]:
    text = read_text(path)
    if len(text) > MOST_YAML:
        raise UserError(f"{path}: has {len(text)} characters; the YAML of a map is read up to {MOST_YAML}")
    try:
        values = yaml.load(text, _Loader)
    except RecursionError:
        raise UserError(f"{path}: its values are nested too deeply") from None
    except (yaml.YAMLError, ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
        raise UserError(f"{path}: cannot be read as YAML: {' '.join(str(error).split())}") from None
    if not isinstance(values, dict) or "image" not in values:
        raise UserError(f"{path}: is not the YAML of a ROS map: it has no key 'image'")
    return values


def _picture_of(values: dict[str, Any], path: Path) -> Path:
    name = values["image"]
    if not isinstance(name, str) or not name or "\0" in name:
        raise UserError(f"{path}: 'image' must be the name of a PGM or PNG file")
    picture = path.parent / name
    if not is_file(picture):
        raise UserError(f"{path}: its image '{name}' is not there; names are relative to the folder of the YAML")
    return picture


def _number(values: dict[str, Any], key: str, path: Path, default: float | None = None) -> float:
    """A number of the map, which YAML 1.1 takes for text where it has an exponent without a point (5e-2).

    Raises:
        UserError: If it is missing, or not a finite number.
    """
    value = values.get(key, default)
    if value is None:
        raise UserError(f"{path}: key '{key}' is missing")
    return _finite(value, key, path)


def _finite(value: object, key: str, path: Path) -> float:
    try:
        number = float(value) if isinstance(value, int | float | str) and not isinstance(value, bool) else None
    except (ValueError, OverflowError):
        number = None
    if number is None or not abs(number) <= LARGEST:
        raise UserError(f"{path}: '{key}' must be a number of at most {LARGEST:g}")
    return number


def _negate(values: dict[str, Any], path: Path) -> bool:
    value = values.get("negate", 0)
    if value not in (0, 1, False, True):
        raise UserError(f"{path}: 'negate' must be 0 or 1")
    return bool(value)


def _origin(values: dict[str, Any], path: Path) -> tuple[float, float, float]:
    """x, y [m] and yaw [rad] of the lower left corner."""
    origin = values.get("origin")
    if not isinstance(origin, list) or len(origin) != 3:
        raise UserError(f"{path}: 'origin' must be three numbers: x, y [m] and yaw [rad] of the lower left corner")
    x, y, yaw = (_finite(value, "origin", path) for value in origin)
    return x, y, yaw


def _occupancy(
    picture: Path, side: float, mode: str, negate: bool, thresholds: tuple[float, float], reading: Reading
) -> tuple[NDArray[np.uint8], list[str]]:
    """Classes of cells (rows from below, columns from the left), and how they were read."""
    grey, opaque, whole_grey = _shades(picture, side, with_alpha=mode == "trinary")
    notes = []
    if mode == "raw":  # the value itself is the probability in percent
        value = np.round(grey)
        share = np.where(value <= 100, value / 100, np.nan)
    else:
        share = (grey if negate else 255.0 - grey) / 255.0
    cells = np.full(grey.shape, UNKNOWN, np.uint8)
    cells[share < thresholds[0]] = FREE
    cells[share > thresholds[1]] = OCCUPIED
    if mode == "scale":
        cells[~opaque] = UNKNOWN
        between = int(((cells == UNKNOWN) & opaque).sum())
        notes += [f"{between} cells lie between the thresholds and count as unknown"] if between else []
    if mode == "raw" and negate:
        notes.append("'negate' does not change values in the mode raw, as in Nav2; ROS 1 subtracts them from 255")
    if mode == "trinary" and not negate:
        meant = (whole_grey == GREY) & (cells == FREE)
        if meant.any():
            said = f"{int(meant.sum())} cells of grey {GREY}, which map savers write for unknown, are "
            if reading.grey == "unknown":
                cells[meant] = UNKNOWN
                notes.append(f"{said}unknown, though free_thresh {thresholds[0]:g} makes them free: grey thresholds")
            else:
                notes.append(f"{said}free, as free_thresh {thresholds[0]:g} has it: grey unknown")
    return cells[::-1], notes


def _shades(picture: Path, side: float, with_alpha: bool) -> tuple[Array, NDArray[np.bool_], Array]:
    """Reads the picture.

    Args:
        picture: Its file.
        side: Side of a cell [m].
        with_alpha: Whether transparency is averaged with the colours, as map servers do in the mode trinary.

    Returns:
        Brightness from 0 to 255, whether each cell is opaque, and brightness without transparency.
    """
    try:
        size = picture.stat().st_size
        if size > MOST_PICTURE:
            raise UserError(f"{picture}: has {size} bytes; pictures are read up to {MOST_PICTURE}")
        with Image.open(picture, formats=("PNG", "PPM", "BMP")) as opened:
            image: Image.Image = opened
            check_size(*image.size, side, picture)
            if image.mode == "F":
                raise ValueError("a brightness that is not a whole number")
            deep = image.mode.startswith("I")
            if not deep and image.mode not in ("L", "RGB", "RGBA"):
                clear = "transparency" in image.info or image.mode in ("LA", "PA")
                image = image.convert("RGBA" if clear else "RGB")
            values = np.asarray(image, dtype=np.float64) / (257.0 if deep else 1.0)
    except _DAMAGED as error:
        raise UserError(f"{picture}: cannot be read as PGM or PNG: {error or type(error).__name__}") from None
    if values.ndim == 2:
        return values, np.ones(values.shape, np.bool_), values
    colour = values[:, :, :3].mean(axis=2)
    if values.shape[2] == 3:
        return colour, np.ones(colour.shape, np.bool_), colour
    return values.mean(axis=2) if with_alpha else colour, values[:, :, 3] == 255, colour
