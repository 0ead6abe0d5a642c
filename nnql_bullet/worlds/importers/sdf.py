"""Reads worlds and models in SDF, as Gazebo has them: what collides, seen from above.

Poses are nested: of the model, models in it, the link and the collision; a <state> of the world replaces those of
models, as in Gazebo. An obstacle here is an upright box or circle: what is tilted becomes the rectangle around its
outline, and a sphere the circle of its widest cut below the height that the vehicle may touch.
"""

from collections import Counter
from dataclasses import dataclass, field
from math import atan2, hypot, sqrt
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, Circle, OrientedBox, Shape
from nnql_bullet.markup import parse_xml
from nnql_bullet.types import LARGEST
from nnql_bullet.worlds.importers.base import ForeignWorld, Reading, box_around, counted, in_arena
from nnql_bullet.worlds.layouts.base import MOST_BOXES

MOST_BYTES = 50_000_000
"""Size of the largest file that is read [bytes]."""
SCENERY = ("ground_plane", "sun")
"""Models of Gazebo's library without which no world is written, and which no vehicle runs into."""
UPRIGHT = 1e-6
"""Largest difference of a cosine from 1 of what counts as upright."""
_SIGNS = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=np.float64)


class _Unread(Exception):
    """A part of the file is left out; the text says why."""


@dataclass
class _Found:
    """What a walk through the file has found."""

    height: float
    shapes: list[Shape] = field(default_factory=list)
    skipped: Counter[str] = field(default_factory=Counter)
    tilted: int = 0
    partly: int = 0
    """Shapes that do not reach from the ground up to `height`."""
    looks: int = 0
    """Links that are seen but not touched."""


def read_sdf(path: Path, reading: Reading, ends: tuple[tuple[float, float], ...] = ()) -> ForeignWorld:
    """Reads a world.

    Args:
        path: The file.
        reading: How it is read.
        ends: Points that the arena must hold [m].

    Raises:
        UserError: If it is malformed or too large, or there is no obstacle in it.
    """
    world, found = _world_of(_root(path), path), _Found(reading.height)
    try:
        states = {model.get("name"): model for model in world.findall("state/model")}
        _walk(world, np.eye(4), "", found, states)
    except ValueError as error:
        raise UserError(f"{path}: {error}") from None
    if len(found.shapes) > MOST_BOXES:
        raise UserError(f"{path}: it has {len(found.shapes)} shapes; up to {MOST_BOXES} are taken")
    shapes, width, depth, frame = in_arena(found.shapes, list(ends), reading.margin, path)
    round_ones = sum(isinstance(shape, Circle) for shape in shapes)
    boxes, circles = counted(len(shapes) - round_ones, "box", "boxes"), counted(round_ones, "circle")
    walled = [] if len(shapes) == len(found.shapes) else ["the four boxes around all others are the arena's walls"]
    told = [
        (found.tilted, "are tilted: the rectangle around its outline from above stands for each"),
        (found.partly, f"do not reach from the ground up to {reading.height:g} m; here all obstacles do"),
    ]
    return ForeignWorld(
        format="SDF world",
        shapes=shapes,
        width=width,
        depth=depth,
        frame=frame,
        files=(path,),
        notes=(
            f"{boxes} and {circles}",
            *walled,
            *(f"{number} of {len(found.shapes)} shapes {what}" for number, what in told if number),
            *([f"{counted(found.looks, 'link')} without collision: nothing to run into"] if found.looks else []),
        ),
        skipped=tuple(what if n == 1 else f"{what} ({n} times)" for what, n in sorted(found.skipped.items())),
        obstacle_height=reading.height,
    )


def _root(path: Path) -> Element:
    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise UserError(f"{path}: has {size} bytes; SDF is read up to {MOST_BYTES} bytes")
        root = parse_xml(path.read_bytes())
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise UserError(f"{path}: cannot be read as SDF: {error}") from None
    if root.tag not in ("sdf", "gazebo"):
        raise UserError(f"{path}: is not SDF: its root is <{root.tag}>, not <sdf>")
    return root


def _world_of(root: Element, path: Path) -> Element:
    worlds = root.findall("world")
    if len(worlds) > 1:
        raise UserError(f"{path}: has {len(worlds)} worlds; keep one")
    return worlds[0] if worlds else root


def _walk(parent: Element, placed: Array, above: str, found: _Found, states: dict[str | None, Element]) -> None:
    """Collects what collides in the models of a world or model, whose frame lies in the world by a transform (4, 4)."""
    for kind in ("include", "actor", "population", "road", "heightmap"):
        for element in parent.findall(kind):
            name = (element.findtext("uri") or element.get("name") or "").strip()
            if name.rpartition("/")[2] not in SCENERY:
                found.skipped[f"<{kind}> {name}: only what the file itself describes is read"] += 1
    for model in parent.findall("model"):
        name = f"{above}{model.get('name', '')}"
        try:
            frame = placed @ _pose(states.get(model.get("name"), model))
            _walk(model, frame, f"{name}/", found, {})
            for link in model.findall("link"):
                collisions, its = link.findall("collision"), frame @ _pose(link)
                found.looks += bool(not collisions and link.findall("visual"))
                for collision in collisions:
                    _add(collision, its @ _pose(collision), name, found)
        except _Unread as reason:
            found.skipped[f"model '{name}': {reason}"] += 1


def _add(collision: Element, frame: Array, model: str, found: _Found) -> None:
    """Adds the outline of a collision shape, or the reason why it has none."""
    shape = collision.find("geometry/*")
    try:
        if shape is None or shape.tag == "empty" or (shape.tag == "plane" and frame[2, 2] > 1 - UPRIGHT):
            return
        outline, low, high = _outline(shape, frame, found)
        if high <= 0:
            raise _Unread("below the ground")
        if low >= found.height:
            raise _Unread(f"begins {low:.2f} m above the ground, over a vehicle {found.height:g} m high")
        found.partly += low > 1e-6 or high < found.height - 1e-6
        found.shapes.append(outline)
    except _Unread as reason:
        found.skipped[f"{'shape' if shape is None else shape.tag} of '{model}': {reason}"] += 1


def _outline(shape: Element, frame: Array, found: _Found) -> tuple[Shape, float, float]:
    """The outline of a shape from above, and the heights of its lower and upper end [m]."""
    x, y, z = frame[:3, 3].tolist()
    if shape.tag == "sphere":
        (radius,) = _numbers(shape, "radius", 1)
        beyond = max(-z, z - found.height, 0.0)  # how far its centre lies outside of what the vehicle may touch
        cut = sqrt(max(radius**2 - beyond**2, 0.0)) if beyond < radius else radius
        return Circle(x, y, _extent(cut)), z - radius, z + radius
    if shape.tag == "box":
        half = np.array(_numbers(shape, "size", 3)) / 2
    elif shape.tag in ("cylinder", "capsule"):
        (radius,), (length,) = _numbers(shape, "radius", 1), _numbers(shape, "length", 1)
        half = np.array([radius, radius, length / 2 + (radius if shape.tag == "capsule" else 0.0)])
        if abs(frame[2, 2]) > 1 - UPRIGHT:
            return Circle(x, y, _extent(radius)), z - half[2], z + half[2]
    else:
        uri = (shape.findtext("uri") or "").strip()
        raise _Unread(f"{uri or 'its shape'} is not read; only boxes, cylinders, capsules and spheres are")
    if half.min() <= 0 or half.max() > 500:
        raise ValueError(f"<{shape.tag}> has sides of {2 * half.min():g} to {2 * half.max():g} m, not of 0 to 1000 m")
    rotation = frame[:3, :3]
    upright = abs(rotation[2]) > 1 - UPRIGHT
    corners = (_SIGNS * half) @ rotation.T + frame[:3, 3]
    low, high = float(corners[:, 2].min()), float(corners[:, 2].max())
    along = int(np.argmax(np.where(upright, -1.0, half * np.hypot(rotation[0], rotation[1]))))
    yaw = atan2(rotation[1, along], rotation[0, along])
    if upright.any():
        across = 3 - along - int(np.argmax(upright))
        return OrientedBox(x, y, float(half[along]), float(half[across]), _tidy(yaw)), low, high
    found.tilted += 1
    return box_around(corners[:, :2], _tidy(yaw)), low, high


def _tidy(yaw: float) -> float:
    """A yaw without the noise of turning to and fro."""
    return round(yaw, 9) + 0.0


def _extent(radius: float) -> float:
    if not 0 < radius <= 1000:
        raise ValueError(f"a radius is {radius:g} m; radii are 0 to 1000 m")
    return radius


def _pose(element: Element) -> Array:
    """The transform (4, 4) of the <pose> of an element to its parent."""
    pose, transform = element.find("pose"), np.eye(4)
    if pose is None:
        return transform
    to = (pose.get("relative_to") or pose.get("frame") or "").strip()
    if to not in ("", "world", "__model__"):
        raise _Unread(f"its <pose> is relative to the frame '{to}'; only poses relative to the parent are read")
    from scipy.spatial.transform import Rotation  # takes long to load, and most worlds are no SDF

    turned_as = pose.get("rotation_format", "euler_rpy")
    numbers = _floats(pose.text or "", 7 if turned_as == "quat_xyzw" else 6, "pose")
    if turned_as == "quat_xyzw":
        if hypot(*numbers[3:]) < 1e-9:
            raise ValueError("<pose> has a quaternion without length")
        rotation = Rotation.from_quat(numbers[3:])
    else:
        rotation = Rotation.from_euler("xyz", numbers[3:], degrees=pose.get("degrees") in ("true", "1"))
    transform[:3, :3], transform[:3, 3] = rotation.as_matrix(), numbers[:3]
    return transform


def _numbers(shape: Element, key: str, count: int) -> list[float]:
    return _floats(shape.findtext(key) or "", count, f"{shape.tag}><{key}")


def _floats(text: str, count: int, where: str) -> list[float]:
    """Reads numbers.

    Raises:
        ValueError: If there are not so many, or one is not finite or too large.
    """
    words = text.split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(abs(number) <= LARGEST for number in numbers):
        given = text.strip() if len(text) < 80 else f"{text.strip()[:80]}..."
        raise ValueError(f"<{where}> must be {counted(count, 'finite number')} of at most {LARGEST:g}, not '{given}'")
    return numbers
