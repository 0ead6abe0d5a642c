"""Cameras: their projections, and their motion around a vehicle."""

from collections.abc import Callable
from dataclasses import dataclass
from math import atan2, cos, radians, sin, tan
from typing import Literal

import numpy as np

from nnql_bullet.geometry import Array
from nnql_bullet.render.timeline import Moment, Timeline
from nnql_bullet.vehicle.scale import length_scale

CameraName = Literal["chase", "top", "orbit", "split"]

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera without roll. If it looks straight down, the world's y axis points up in its picture."""

    eye: tuple[float, float, float]
    """Place of the camera [m]."""
    target: tuple[float, float, float]
    """Point in the middle of the picture [m]."""
    field_of_view: float
    """Vertical field of view [rad]."""
    width: int
    height: int
    near: float
    """Near clipping distance [m]; a larger one gives more exact depths."""
    far: float = 400.0
    """Far clipping distance [m]."""

    @property
    def axes(self) -> Array:
        """Unit vectors to the right, up and ahead, as rows (3, 3)."""
        ahead = np.subtract(self.target, self.eye)
        ahead /= np.linalg.norm(ahead)
        up = UP if abs(ahead @ UP) < 1 - 1e-9 else np.array([0.0, 1.0, 0.0])
        right = np.cross(ahead, up)
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(right, ahead), ahead])

    @property
    def half_extents(self) -> tuple[float, float]:
        """Half width and half height of the picture at distance 1."""
        up = tan(self.field_of_view / 2)
        return up * self.width / self.height, up

    @property
    def view(self) -> Array:
        """OpenGL's view matrix (4, 4): from the world to the camera's frame, which looks along -z."""
        right, up, ahead = self.axes
        matrix = np.eye(4)
        matrix[:3, :3] = right, up, -ahead
        matrix[:3, 3] = -matrix[:3, :3] @ self.eye
        return matrix

    @property
    def projection(self) -> Array:
        """OpenGL's perspective matrix (4, 4): from the camera's frame to clip coordinates."""
        (right, up), n, f = self.half_extents, self.near, self.far
        return np.array(
            [[1 / right, 0, 0, 0], [0, 1 / up, 0, 0], [0, 0, -(f + n) / (f - n), -2 * f * n / (f - n)], [0, 0, -1, 0]]
        )

    def project(self, points: Array) -> tuple[Array, Array]:
        """Projects points into the picture.

        Args:
            points: Points in the world (n, 3) [m].

        Returns:
            Pixels from the upper left corner of the picture, to the right and down (n, 2), and distances ahead of the
            eye (n,) [m]. Pixels of points that are not ahead of the camera are NaN.
        """
        clip = np.column_stack([points, np.ones(len(points))]) @ (self.projection @ self.view).T
        ahead = clip[:, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            device = np.where(ahead[:, None] > self.near, clip[:, :2] / ahead[:, None], np.nan)
        return (device * (1, -1) + 1) / 2 * (self.width, self.height), ahead


Path = Callable[[Moment], Camera]
"""A camera for each moment."""

CHASE_TIME_CONSTANT = 0.7
"""Time constant of the filter through which a chasing camera follows the vehicle's yaw [s]."""
STEP = 1 / 30
"""Time step of that filter [s]."""
LAP = 24.0
"""Period of an orbiting camera [s]."""
CLOSEST = 0.3
"""Smallest factor by which these cameras go closer to a vehicle that is smaller than the shipped one: further off they
show what is around it."""


def _nearness(timeline: Timeline) -> float:
    """Computes the factor on the distances of a camera from a vehicle: its scale, or `CLOSEST`."""
    return max(length_scale(timeline.recording.footprint), CLOSEST)


def chase(timeline: Timeline, width: int, height: int) -> Path:
    """Looks from behind and above; a first-order filter of the yaw turns the camera."""
    times = np.arange(0.0, timeline.duration + STEP, STEP)
    yaws = timeline.yaws(times).tolist()
    followed = yaws[:1]
    for yaw in yaws[1:]:
        followed.append(followed[-1] + (yaw - followed[-1]) * STEP / CHASE_TIME_CONSTANT)
    k = _nearness(timeline)

    def camera(moment: Moment) -> Camera:
        yaw, (x, y) = float(np.interp(moment.time, times, followed)), (moment.pose.x, moment.pose.y)
        c, s = k * cos(yaw), k * sin(yaw)
        eye, target = (x - 5.6 * c, y - 5.6 * s, 3.3 * k), (x + 2.6 * c, y + 2.6 * s, 0.0)
        return Camera(eye, target, radians(52), width, height, 2.4 * k)

    return camera


def orbit(timeline: Timeline, width: int, height: int) -> Path:
    """Circles around the vehicle."""
    k = _nearness(timeline)

    def camera(moment: Moment) -> Camera:
        angle, (x, y) = 2 * np.pi * moment.time / LAP + np.pi * 1.25, (moment.pose.x, moment.pose.y)
        eye = x + 5 * k * cos(angle), y + 5 * k * sin(angle), 3.6 * k
        return Camera(eye, (x, y, 0.2 * k), radians(50), width, height, 2.4 * k)

    return camera


def top(timeline: Timeline, width: int, height: int) -> Path:
    """Looks at the whole arena from high above; the y axis points up."""
    world = timeline.recording.about["world"]
    margin = 1.12
    across, along = world["width"] * margin, world["depth"] * margin
    visible = max(along, across * height / width)
    up = 4 * visible
    x, y = world["width"] / 2, world["depth"] / 2
    still = Camera((x, y, up), (x, y, 0.0), 2 * atan2(visible / 2, up), width, height, up - 5.0, up + 5.0)
    return lambda moment: still


PATHS: dict[str, Callable[[Timeline, int, int], Path]] = {"chase": chase, "orbit": orbit, "top": top}
"""Cameras with one picture; `split` shows two of them side by side."""
