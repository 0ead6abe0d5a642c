"""A recording as a function of time, interpolated between its samples."""

from dataclasses import dataclass

import numpy as np

from nnql_bullet.geometry import Array, OrientedBox, Pose, wrap_angle, wrap_angles
from nnql_bullet.recording import Recording
from nnql_bullet.sim.base import LEVEL
from nnql_bullet.types import Vector


@dataclass(frozen=True, slots=True)
class Moment:
    """One instant of a recording."""

    time: float
    """Time since the start [s]."""
    pose: Pose
    """Pose of the vehicle."""
    tilt: Vector
    """See `sim.base.Sample`."""
    joint_angles: tuple[float, ...]
    """Angles of the joints, as in the recording [rad]."""
    speed: float
    """Speed of the rear-axle centre [m/s]."""
    step: int
    """Number of the present decision; after the end, that of the last one."""
    over: bool
    """Whether the episode has ended."""
    movers: tuple[OrientedBox, ...]
    """Moving boxes at their positions."""


class Timeline:
    """Interpolates a recording: positions linearly, and angles linearly along the shorter arc."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        start, first = recording.state_pose[0], recording.joint_angles[0]
        self._times = np.concatenate([[0.0], recording.sample_time])
        self._poses = np.concatenate([[start], recording.sample_pose])
        self._poses[:, 2] = np.unwrap(self._poses[:, 2])
        self._joints = np.unwrap(np.concatenate([[first], recording.joint_angles]), axis=0)
        self._tilts = np.concatenate([[LEVEL], recording.tilts])
        distances = np.hypot(*np.diff(self._poses[:, :2], axis=0).T)
        self._speeds = distances / np.diff(self._times)

    @property
    def duration(self) -> float:
        """Duration of the episode [s]."""
        return float(self._times[-1])

    def at(self, time: float) -> Moment:
        """Returns the moment at a time [s]; times after the end give the last moment."""
        r = self.recording
        now = min(max(time, 0.0), self.duration)
        x, y, yaw = (float(np.interp(now, self._times, values)) for values in self._poses.T)
        rise, roll, pitch = (float(np.interp(now, self._times, values)) for values in self._tilts.T)
        angles = tuple(float(np.interp(now, self._times, values)) for values in self._joints.T)
        sample = int(np.searchsorted(self._times[1:-1], now, side="left"))
        step = int(np.searchsorted(r.state_time[1:-1], now, side="right"))
        return Moment(
            time=now,
            pose=Pose(x, y, wrap_angle(yaw)),
            tilt=(rise, roll, pitch),
            joint_angles=angles,
            speed=float(self._speeds[sample]),
            step=step,
            over=time >= self.duration and r.about["ending"] is not None,
            movers=tuple(patrol.at(now) for patrol in r.patrols),
        )

    def yaws(self, times: Array) -> Array:
        """Returns the yaws at times (k,) [s], without jumps (k,) [rad]."""
        return np.unwrap(wrap_angles(np.interp(times, self._times, self._poses[:, 2])))

    def path(self, time: float) -> Array:
        """Returns the path up to a time [s]: positions (k, 2) [m] at the start and at each sample."""
        return self._poses[: int(np.searchsorted(self._times, time, side="right")), :2]

    def safe(self) -> Array:
        """Returns whether the state was safe in each piece of the path between two positions (m,)."""
        r = self.recording
        decision = np.searchsorted(r.state_time, self._times[1:] - 1e-9, side="left") - 1
        return np.asarray(r.state_property[np.clip(decision, 0, None)] != "NS")
