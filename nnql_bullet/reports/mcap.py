"""Writes a recording as an .mcap file of ROS 2 messages, which Foxglove and ROS 2 open (needs the extra `ros`).

| topic | message | when |
|---|---|---|
| `/scan` | sensor_msgs/LaserScan | at each decision |
| `/odom` | nav_msgs/Odometry | at decisions and samples; the speeds are those between them |
| `/tf`, `/tf_static` | tf2_msgs/TFMessage | `odom` to `base_link`, the drive axle's centre; from there to `laser` |
| `/world` | visualization_msgs/MarkerArray | obstacles, walls, start, target, way points, path and plans |
| `/vehicle`, `/patrols` | visualization_msgs/MarkerArray | the footprint; what moves, at the samples |
| `/wheel_speeds` | geometry_msgs/Vector3Stamped | x left, y right [rad/s], at the samples |
| `/rosout` | rcl_interfaces/Log | properties, the shield's decisions, contacts, the ending |

Times count from the start of the drive.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from nnql_bullet.colours import BOX, COLLISION, INK, MOVING, PLAN, SAFE, TIMEOUT, VEHICLE
from nnql_bullet.files import write_atomically
from nnql_bullet.geometry import Array, Circle, OrientedBox
from nnql_bullet.recording import Recording
from nnql_bullet.reports.events import events_of

WORLD, BASE, LASER = "odom", "base_link", "laser"
"""Frames: the world, the vehicle at the height of its drive axle, its sensor."""
VEHICLE_HEIGHT = 0.25
"""Height of the box that stands for the vehicle [m]."""
_CUBE, _CYLINDER, _LINE = 1, 3, 4
_LEVELS = {"INFO": 20, "WARN": 30, "ERROR": 40}
Timed = tuple[float, str, Any]
"""Time [s], topic and message."""


def write_mcap(recording: Recording, path: Path) -> None:
    """Writes an .mcap file atomically.

    Raises:
        OSError: If the file cannot be written.
    """
    write_atomically(path, lambda temporary: _write(_Messages(recording).all(), temporary))


def _write(messages: Iterable[Timed], path: Path) -> None:
    store, channels = get_typestore(Stores.ROS2_HUMBLE), dict[str, int]()
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="nnql-bullet")
        for sequence, (time, topic, message) in enumerate(sorted(messages, key=lambda its: its[0])):
            kind = message.__msgtype__
            if topic not in channels:
                text, _ = store.generate_msgdef(kind, ros_version=2)
                schema = writer.register_schema(kind, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            at = round(1e9 * time)
            data = bytes(store.serialize_cdr(message, kind))
            writer.add_message(channels[topic], log_time=at, data=data, publish_time=at, sequence=sequence)
        writer.finish()


class _Messages:
    """The messages of a recording."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._types: dict[str, Any] = self._store.types
        times = np.concatenate([recording.state_time, recording.sample_time])
        order = np.unique(times, return_index=True)[1]
        tilts = np.concatenate([[np.zeros(3)], recording.tilts])
        self._times = times[order]
        self._poses = np.concatenate([recording.state_pose, recording.sample_pose])[order]
        at_samples = np.append(0.0, recording.sample_time)
        self._tilts = np.stack([np.interp(self._times, at_samples, its) for its in tilts.T], axis=-1)
        self._axle = float(recording.about["vehicle"].get("wheel_radius", 0.0))

    def all(self) -> Iterator[Timed]:
        """All of them, in no order."""
        yield 0.0, "/tf_static", self._tf([(BASE, LASER, 0.0, self._recording.sensor.position, (0.0, 0.0, 0.0, 1.0))])
        yield 0.0, "/world", self._markers(self._world())
        yield 0.0, "/vehicle", self._markers([self._vehicle()])
        yield from self._scans()
        yield from self._odometry()
        yield from self._patrols()
        yield from self._plans()
        yield from self._wheels()
        for state, text, level in events_of(self._recording):
            time, name = float(self._recording.state_time[state]), "nnql_bullet"
            log = self._new("rcl_interfaces", "Log", stamp=self._stamp(time), level=_LEVELS[level], name=name, msg=text)
            yield time, "/rosout", log

    def _scans(self) -> Iterator[Timed]:
        sensor = self._recording.sensor
        first, last = sensor.angles[[0, -1]].tolist()
        for time, distances in zip(self._recording.state_time.tolist(), self._recording.ray_distances, strict=True):
            beams = np.where(sensor.met(distances), distances, np.inf)
            beams[~sensor.seen] = np.nan
            yield (
                time,
                "/scan",
                self._new(
                    *("sensor_msgs", "LaserScan"),
                    header=self._header(time, LASER),
                    angle_min=first,
                    angle_max=last,
                    angle_increment=(last - first) / (sensor.rays - 1),
                    range_max=sensor.range,
                    ranges=beams.astype(np.float32),
                ),
            )

    def _odometry(self) -> Iterator[Timed]:
        steps, durations = np.diff(self._poses, axis=0, prepend=self._poses[:1]), np.diff(self._times, prepend=-1.0)
        yaws, middles = self._poses[:, 2], self._poses[:, 2] - steps[:, 2] / 2
        speeds = (steps[:, 0] * np.cos(middles) + steps[:, 1] * np.sin(middles)) / durations
        rates = ((steps[:, 2] + np.pi) % (2 * np.pi) - np.pi) / durations
        turns = Rotation.from_euler("ZYX", np.column_stack([yaws, self._tilts[:, 2], self._tilts[:, 1]])).as_quat()
        for k, time in enumerate(self._times.tolist()):
            place = (*self._poses[k, :2].tolist(), self._axle + float(self._tilts[k, 0]))
            yield time, "/tf", self._tf([(WORLD, BASE, time, place, turns[k])])
            twist = self._new("geometry_msgs", "Twist")
            twist.linear.x, twist.angular.z = float(speeds[k]), float(rates[k])
            message = self._new("nav_msgs", "Odometry", header=self._header(time, WORLD), child_frame_id=BASE)
            message.pose.pose, message.twist.twist = self._pose(place, turns[k]), twist
            yield time, "/odom", message

    def _wheels(self) -> Iterator[Timed]:
        for time, (left, right) in zip(
            self._recording.sample_time.tolist(), self._recording.wheel_speeds.tolist(), strict=True
        ):
            message = self._new("geometry_msgs", "Vector3Stamped", header=self._header(time, BASE))
            message.vector.x, message.vector.y = left, right
            yield time, "/wheel_speeds", message

    def _patrols(self) -> Iterator[Timed]:
        patrols, height = self._recording.world.patrols, self._recording.world.obstacle_height
        for time in [0.0, *self._recording.sample_time.tolist()] if patrols else []:
            yield time, "/patrols", self._markers(self._box(its.at(time), height, MOVING, "patrols") for its in patrols)

    def _plans(self) -> Iterator[Timed]:
        for time, corners in self._recording.plans:
            yield time, "/world", self._markers([self._line(corners, PLAN, "plan")])

    def _world(self) -> Iterator[Any]:
        world, height = self._recording.world, self._recording.world.obstacle_height
        for its in world.obstacles:
            yield (
                self._disc((its.x, its.y), its.radius, height, BOX, "obstacles")
                if isinstance(its, Circle)
                else self._box(its, height, BOX, "obstacles")
            )
        for wall in world.walls:
            yield self._box(wall, height, TIMEOUT, "walls")
        yield self._disc((world.start.x, world.start.y), 0.1, 0.02, INK, "start")
        for place in world.targets:
            yield self._disc(place, world.target_radius, 0.02, COLLISION, "targets", alpha=0.4)
        yield self._line(self._poses[:, :2], SAFE, "path")

    def _vehicle(self) -> Any:
        middle = VEHICLE_HEIGHT / 2
        return self._box(self._recording.footprint, VEHICLE_HEIGHT, VEHICLE, "vehicle", frame=BASE, middle=middle)

    def _box(
        self, box: OrientedBox, height: float, colour: str, name: str, frame: str = WORLD, middle: float | None = None
    ) -> Any:
        turn = Rotation.from_euler("z", box.yaw).as_quat()
        pose = self._pose((box.x, box.y, height / 2 if middle is None else middle), turn)
        return self._marker(_CUBE, pose, (2 * box.half_length, 2 * box.half_width, height), colour, name, frame)

    def _disc(
        self, place: Sequence[float], radius: float, height: float, colour: str, name: str, alpha: float = 1.0
    ) -> Any:
        pose = self._pose((*place, height / 2), (0.0, 0.0, 0.0, 1.0))
        return self._marker(_CYLINDER, pose, (2 * radius, 2 * radius, height), colour, name, alpha=alpha)

    def _line(self, places: Array, colour: str, name: str) -> Any:
        pose, point = self._pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), self._types["geometry_msgs/msg/Point"]
        line = self._marker(_LINE, pose, (0.06, 0.0, 0.0), colour, name)
        line.points = [point(x, y, 0.02) for x, y in places.tolist()]
        return line

    def _marker(
        self,
        kind: int,
        pose: Any,
        scale: tuple[float, float, float],
        colour: str,
        name: str,
        frame: str = WORLD,
        alpha: float = 1.0,
    ) -> Any:
        red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
        return self._new(
            *("visualization_msgs", "Marker"),
            header=self._header(0.0, frame),
            ns=name,
            type=kind,
            pose=pose,
            scale=self._types["geometry_msgs/msg/Vector3"](*scale),
            color=self._types["std_msgs/msg/ColorRGBA"](red, green, blue, alpha),
            frame_locked=True,
        )

    def _markers(self, markers: Iterable[Any]) -> Any:
        """All of them in one message; those of a name are numbered."""
        numbered = list(markers)
        for number, marker in enumerate(numbered):
            marker.id = number
        return self._new("visualization_msgs", "MarkerArray", markers=numbered)

    def _tf(self, links: Iterable[tuple[str, str, float, Sequence[float], Sequence[float]]]) -> Any:
        """Transforms from frames to others: names, time [s], place [m] and quaternion."""
        transforms = []
        for parent, child, time, place, turn in links:
            one = self._new(
                "geometry_msgs", "TransformStamped", header=self._header(time, parent), child_frame_id=child
            )
            pose = self._pose(place, turn)
            one.transform.translation.x, one.transform.translation.y, one.transform.translation.z = map(float, place)
            one.transform.rotation = pose.orientation
            transforms.append(one)
        return self._new("tf2_msgs", "TFMessage", transforms=transforms)

    def _pose(self, place: Sequence[float], turn: Sequence[float] | Array) -> Any:
        """A pose at a place [m] with a quaternion."""
        pose = self._new("geometry_msgs", "Pose")
        pose.position.x, pose.position.y, pose.position.z = map(float, place)
        pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = map(float, turn)
        return pose

    def _header(self, time: float, frame: str) -> Any:
        return self._types["std_msgs/msg/Header"](self._stamp(time), frame)

    def _stamp(self, time: float) -> Any:
        seconds, nanoseconds = divmod(round(1e9 * time), 1_000_000_000)
        return self._types["builtin_interfaces/msg/Time"](seconds, nanoseconds)

    def _new(self, package: str, kind: str, /, **values: Any) -> Any:
        """A message with some values, and zero, empty text or nothing for the others."""
        full = f"{package}/msg/{kind}"
        _, fields = self._store.fielddefs[full]
        return self._types[full](**{field: values.get(field, self._blank(its)) for field, its in fields})

    def _blank(self, definition: Any) -> Any:
        """An empty value of a field."""
        node, detail = definition
        if node == Nodetype.NAME:
            return self._new(*detail.split("/msg/"))
        if node == Nodetype.BASE:
            return {"string": "", "bool": False}.get(detail[0], 0)
        (element, (name, *_)), count = detail
        return np.zeros(count, name) if element == Nodetype.BASE and name != "string" else []
