"""What a controller demands of what it is told: that it is there, in time, in its frame, and made of numbers."""

from dataclasses import dataclass
from math import hypot, isfinite, pi
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from nnql_bullet.config import options
from nnql_bullet.deploy.scans import Scan, Unusable
from nnql_bullet.env import FARTHEST
from nnql_bullet.geometry import wrap_angle
from nnql_bullet.types import Extent, Period

AT_TARGET = "at the target"
"""Reason of the stop at the end of a drive."""
AHEAD = 0.01
"""Time by which a stamp may be later than now [s]."""
LARGEST = 1e12
"""Largest magnitude of a number that is taken, in its unit; a clock may count from 1970."""


@options
class WatchOptions:
    """What a controller demands of what it is told."""

    most_age: Period = 0.25
    """Age of scan and odometry, and time between two calls, above which the vehicle stops [s]."""
    scan_frame: str = "laser"
    """Frame that scans have to be in. The lidar stands where the vehicle's `sensor.position` says."""
    scan_yaw: Annotated[float, Field(ge=-pi, le=pi)] = 0.0
    """Direction of the lidar's 0 in the vehicle frame, left is positive [rad]."""
    odometry_frame: str = "odom"
    """Frame that odometry, and with it the target, has to be in."""
    most_jump: Extent = 0.5
    """Distance between two poses, beyond what the vehicle can have driven, above which it stops [m]."""
    most_yaw_jump: Annotated[float, Field(gt=0, le=pi)] = 0.5
    """Angle between them, beyond what it can have turned, above which it stops [rad]."""
    target_radius: Extent = 2.0
    """Distance of the drive axle's centre from the target at which the vehicle has arrived, and stops [m]."""


@dataclass(frozen=True, slots=True)
class Odometry:
    """Where the vehicle is: the pose of the centre of its drive axle, and how it moves."""

    x: float
    """[m]"""
    y: float
    """[m]"""
    yaw: float
    """[rad]"""
    stamp: float
    """When it was measured, by the clock that `Controller.step` is told of [s]."""
    speed: float | None = None
    """Along the vehicle, negative backwards [m/s]; None where only a pose is known: then it is the one commanded."""
    yaw_rate: float | None = None
    """Left is positive [rad/s]; None likewise."""
    frame: str = "odom"
    """Frame of the pose."""


class WrongTime(Unusable):
    """A call at a time at which the vehicle cannot be driven on."""

    def __init__(self, now: float, reason: str) -> None:
        """Keeps the time [s] that counts from then on."""
        super().__init__(reason)
        self.now = now


def checked_call(now: float, before: float, watch: WatchOptions) -> float:
    """The time of a call [s] at which the vehicle can be driven on.

    Args:
        now: [s]
        before: Time of the last call [s]; -inf for none.
        watch: What is demanded.

    Raises:
        WrongTime: If the clock has gone back, or the call comes too late.
    """
    if not _is_number(now):
        raise WrongTime(before, f"clock: it shows {now}")
    if now < before:
        raise WrongTime(now, f"clock: it has gone back by {before - now:.2f} s")
    if isfinite(before) and now - before > watch.most_age:
        raise WrongTime(now, f"controller: not called for {now - before:.2f} s; at most {watch.most_age:g} s")
    return float(now)


@dataclass(frozen=True, slots=True)
class Fastest:
    """What no measurement of a vehicle exceeds."""

    speed: float
    """[m/s]"""
    yaw_rate: float
    """[rad/s]"""


def checked_odometry(odometry: Odometry | None, most: Fastest, watch: WatchOptions, now: float) -> Odometry:
    """Odometry that can be driven by, whatever was measured before.

    Raises:
        Unusable: If it is none.
    """
    if odometry is None:
        raise Unusable("no odometry has come")
    checked_age("odometry", odometry.stamp, odometry.frame, watch.odometry_frame, watch, now)
    o = odometry
    for name, value in (("x", o.x), ("y", o.y), ("yaw", o.yaw), ("speed", o.speed), ("yaw_rate", o.yaw_rate)):
        if not _is_number(value) and not (value is None and name in ("speed", "yaw_rate")):
            raise Unusable(f"odometry: '{name}' is {value}")
    for name, value, largest in (("speed", o.speed, most.speed), ("yaw_rate", o.yaw_rate, most.yaw_rate)):
        if abs(value or 0.0) > largest:
            raise Unusable(f"odometry: '{name}' is {value:g}; this vehicle's is at most {largest:g}")
    return odometry


def check_move(before: Odometry, o: Odometry, most: Fastest, watch: WatchOptions) -> None:
    """Refuses a pose that the vehicle cannot have come to, such as one that was set anew.

    Args:
        before: The last odometry.
        o: That of now, not older.
        most: What the vehicle does at most in between.
        watch: What is demanded.

    Raises:
        Unusable: If it cannot.
    """
    time = o.stamp - before.stamp
    way, turn = hypot(o.x - before.x, o.y - before.y), abs(wrap_angle(o.yaw - before.yaw))
    if way > watch.most_jump + most.speed * time:
        raise Unusable(f"odometry: it jumps by {way:.2f} m in {time:.2f} s")
    if turn > watch.most_yaw_jump + most.yaw_rate * time:
        raise Unusable(f"odometry: it jumps by {turn:.2f} rad in {time:.2f} s")


def checked_scan(scan: Scan | None, before: float, watch: WatchOptions, now: float) -> Scan:
    """A scan that comes in time; what it tells is not looked at.

    Args:
        scan: The scan.
        before: Stamp of the last one [s].
        watch: What is demanded.
        now: [s]

    Raises:
        Unusable: If it does not.
    """
    if scan is None:
        raise Unusable("no scan has come")
    checked_age("scan", scan.stamp, scan.frame, watch.scan_frame, watch, now)
    if scan.stamp < before:
        raise Unusable(f"scan: {before - scan.stamp:.2f} s older than the one before it")
    return scan


def checked_age(what: str, stamp: float, frame: str, wanted: str, watch: WatchOptions, now: float) -> None:
    """Refuses what is in another frame, or too old.

    Raises:
        Unusable: If it is.
    """
    if frame != wanted:
        raise Unusable(f"{what}: in the frame '{frame}', not in '{wanted}'")
    if not _is_number(stamp):
        raise Unusable(f"{what}: its stamp is {stamp}")
    if now - stamp > watch.most_age:
        raise Unusable(f"{what}: {now - stamp:.2f} s old; at most {watch.most_age:g} s")
    if stamp - now > AHEAD:
        raise Unusable(f"{what}: its stamp is {stamp - now:.2f} s in the future")


def checked_target(target: tuple[float, float] | None, o: Odometry, watch: WatchOptions) -> tuple[float, float]:
    """A target that is still to be reached.

    Raises:
        Unusable: If it is none, or reached.
    """
    if target is None:
        raise Unusable("no target is given")
    try:
        x, y = target
    except (TypeError, ValueError):
        raise Unusable("the target is no pair x, y") from None
    if not (_is_number(x) and _is_number(y)):
        raise Unusable(f"the target is at {x}, {y}")
    away = hypot(x - o.x, y - o.y)
    if away > FARTHEST:
        raise Unusable(f"the target is {away:g} m away; at most {FARTHEST:g} m")
    if away <= watch.target_radius:
        raise Unusable(AT_TARGET)
    return float(x), float(y)


def _is_number(value: object) -> bool:
    numbers: Any = (int, float, np.floating, np.integer)
    return isinstance(value, numbers) and bool(abs(value) <= LARGEST)
