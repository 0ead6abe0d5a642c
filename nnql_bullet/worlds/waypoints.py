"""Reads way points: places to reach in turn, from a file or from a line of text."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file, read_json, read_text
from nnql_bullet.types import LARGEST
from nnql_bullet.worlds.passages import Point

MOST_WAYPOINTS = 1000
"""Most way points of a drive."""
SUFFIXES = (".csv", ".txt", ".json")
"""Of files of way points."""


def read_waypoints(given: str | Path) -> tuple[Point, ...]:
    """Reads way points x, y [m].

    Args:
        given: "x,y;x,y", or a file. A CSV file has a place a line, two numbers with a comma, semicolon, tab or space
            between them; its first line may name the columns, of which x and y then count. Empty lines and what
            follows a # do not count. A JSON file is a list of places, each [x, y] or {"x": x, "y": y}, or an object
            with such a list as "waypoints".

    Raises:
        UserError: If there is no such file, or a place in it is wrong; it names the line.
    """
    text = str(given)
    if not isinstance(given, Path) and not is_file(text) and Path(text).suffix.lower() not in SUFFIXES:
        parts = text.strip().removesuffix(";").split(";")
        found = [_place(part.split(","), f"waypoints: place {k}") for k, part in enumerate(parts, 1)]
    else:
        file = Path(given)
        found = list(_of_json(file) if file.suffix.lower() == ".json" else _of_lines(file))
    if not 0 < len(found) <= MOST_WAYPOINTS:
        raise UserError(f"waypoints: give 1 to {MOST_WAYPOINTS} places, not {len(found)}")
    return tuple(found)


def as_waypoints(given: str | Path | Sequence[Sequence[float]]) -> tuple[Point, ...]:
    """Way points x, y [m] as a caller gave them: places, or what `read_waypoints` reads.

    Raises:
        UserError: If one is wrong.
    """
    if isinstance(given, str | Path):
        return read_waypoints(given)
    return tuple(_place(its, f"waypoints: place {k}") for k, its in enumerate(given, 1))


def _of_lines(file: Path) -> Iterator[Point]:
    """The places of a CSV file."""
    columns: tuple[int, int] | None = None
    first = True
    for number, line in enumerate(read_text(file).splitlines(), 1):
        told = line.partition("#")[0].strip()
        if not told:
            continue
        words = re.split(r"\s*[,;\t]\s*|\s+", told)
        names = [word.strip("\"'").lower() for word in words]
        if first and "x" in names and "y" in names:
            columns = names.index("x"), names.index("y")
        elif columns and max(columns) < len(words):
            yield _place([words[k] for k in columns], f"{file}: line {number}")
        else:
            yield _place([] if columns else words, f"{file}: line {number}")
        first = False


def _of_json(file: Path) -> Iterator[Point]:
    """The places of a JSON file."""
    values = read_json(file)
    if isinstance(values, dict):
        values = values.get("waypoints")
    if not isinstance(values, list):
        raise UserError(f'{file}: must be a list of places, such as [[1, 2], [3, 4]], or have one as "waypoints"')
    for number, its in enumerate(values, 1):
        pair = [its.get("x"), its.get("y")] if isinstance(its, dict) else its
        yield _place(pair if isinstance(pair, list) else [], f"{file}: way point {number}")


def _place(numbers: Sequence[object], where: str) -> Point:
    """A place of two numbers, which may be text.

    Raises:
        UserError: If they are not two numbers, or too large.
    """
    try:
        if any(isinstance(its, bool) for its in numbers):
            raise ValueError
        x, y = (float(its) for its in numbers)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        raise UserError(f"{where}: must be two numbers, x,y [m]") from None
    if not (abs(x) <= LARGEST and abs(y) <= LARGEST):
        raise UserError(f"{where}: must be finite numbers of metres, not {x:g}, {y:g}")
    return x, y
