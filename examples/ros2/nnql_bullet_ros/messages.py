"""The node's parameters, and ROS 2 messages in and out of a controller: plain functions, which need no ROS."""

from dataclasses import asdict
from math import atan2, nan
from typing import Any

from nnql_bullet.deploy import Command, Controller, Odometry, Scan, WatchOptions

PARAMETERS = {"policy": "paper", "vehicle": "", "shield": True, "speed": 0.0, "rate": 60.0, **asdict(WatchOptions())}
"""Parameters and their defaults: no vehicle stands for that of the policy, no speed for its own; the rate is that of
commands [1/s]; the others are of `WatchOptions`."""


def seconds(stamp: Any) -> float:
    """A builtin_interfaces/Time as a number [s]."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def scan_of(message: Any) -> Scan:
    """A sensor_msgs/LaserScan as the controller takes it."""
    m = message
    return Scan(
        m.ranges,
        *(m.angle_min, m.angle_max, m.angle_increment, m.range_min, m.range_max),
        seconds(m.header.stamp),
        m.header.frame_id,
    )


def odometry_of(message: Any) -> Odometry:
    """A nav_msgs/Odometry, whose child frame has its origin at the centre of the drive axle."""
    pose, twist = message.pose.pose, message.twist.twist
    header = message.header
    return Odometry(
        x=pose.position.x,
        y=pose.position.y,
        yaw=yaw_of(pose.orientation),
        stamp=seconds(header.stamp),
        speed=twist.linear.x,
        yaw_rate=twist.angular.z,
        frame=header.frame_id,
    )


def yaw_of(q: Any) -> float:
    """Yaw of a geometry_msgs/Quaternion [rad]; NaN if it is no rotation, as one that nobody has set."""
    if not 0.9 < q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w < 1.1:
        return nan
    return atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))


def driven(
    controller: Controller, scan: Any | None, odometry: Any | None, target: tuple[float, float] | None, now: float
) -> Command:
    """What the vehicle is to do now, by the last messages that came; None for none yet."""
    return controller.step(scan and scan_of(scan), odometry and odometry_of(odometry), target, now)


def fill(twist: Any, command: Command) -> Any:
    """A geometry_msgs/Twist with the speeds of a command."""
    twist.linear.x, twist.angular.z = command.speed, command.yaw_rate
    return twist
