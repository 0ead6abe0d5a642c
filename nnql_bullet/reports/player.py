"""Writes a recording in a short form, for the player of a page (player.js)."""

import json
from typing import Any

import numpy as np

from nnql_bullet import paper
from nnql_bullet.geometry import Array, Circle, OrientedBox
from nnql_bullet.recording import Recording
from nnql_bullet.worlds.spec import Patrol

RATE = 10
"""Rate of poses [Hz]."""
EVEN = 1e-6
"""Largest change of speed that counts as none [m/s]."""


def player_text(recording: Recording, title: str) -> str:
    """Writes a drive as JSON without characters that have a meaning in HTML.

    Lengths are in metres and angles in radians. Series are differences in hundredths: `x`, `y` and `yaw` of the rear
    axle (at `RATE`, and at the end) and `times` of the decisions. `readings` of each decision and sector are in tenths.
    """
    values = json.dumps(_values(recording, title), separators=(",", ":"))
    return values.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _values(recording: Recording, title: str) -> dict[str, Any]:
    world, end = recording.world, float(recording.state_time[-1])
    times = np.append(np.arange(0.0, end - 1e-6, 1.0 / RATE), end)
    known = np.concatenate([[0.0], recording.sample_time])
    poses = np.concatenate([recording.state_pose[:1], recording.sample_pose])
    x, y, yaw = (np.interp(times, known, series) for series in (*poses[:, :2].T, np.unwrap(poses[:, 2])))
    return {
        "title": title,
        "ending": recording.about["ending"],
        "arena": [world.width, world.depth],
        "target": [*world.target, world.target_radius],
        "boxes": [_box(its) for its in world.obstacles if isinstance(its, OrientedBox)],
        "circles": [_rounded(its.x, its.y, its.radius) for its in world.obstacles if isinstance(its, Circle)],
        "patrols": [_track(patrol, times) for patrol in world.patrols],
        "footprint": _box(recording.footprint),
        "sensor": _rounded(*recording.sensor.position[:2]),
        "range": recording.sensor.range,
        "sectors": paper.SECTORS,
        "rate": RATE,
        "end": round(end, 3),
        "x": _differences(x),
        "y": _differences(y),
        "yaw": _differences(yaw),
        "times": _differences(recording.state_time),
        "readings": np.rint(10 * recording.readings).astype(int).ravel().tolist(),
        "states": "".join(label[0] for label in recording.state_property.tolist()),
    }


def _track(patrol: Patrol, times: Array) -> dict[str, Any]:
    """Returns a moving box, the end of its track, and the times and positions at which its velocity changes."""
    places = np.array([(box.x, box.y) for box in map(patrol.at, times.tolist())])
    speeds = np.diff(places, axis=0) / np.diff(times)[:, None]
    bends = np.flatnonzero(np.abs(np.diff(speeds, axis=0)).max(axis=1) > EVEN) + 1
    kept = np.concatenate([[0], bends, [len(times) - 1]]).tolist()
    return {
        "box": _box(patrol.box),
        "end": _rounded(*patrol.end),
        "places": [_rounded(times[k], *places[k]) for k in kept],
    }


def _box(box: OrientedBox) -> list[float]:
    return _rounded(box.x, box.y, box.half_length, box.half_width, box.yaw)


def _rounded(*numbers: float) -> list[float]:
    return [round(number, 3) for number in numbers]


def _differences(series: Array) -> list[int]:
    """Computes differences of a series (n,) in hundredths, the first from 0; sums are exact to half a hundredth."""
    found: list[int] = np.diff(np.rint(100 * series), prepend=0).astype(int).tolist()
    return found
