"""The ROS 2 node's conversions on messages from a bag, and a recording as MCAP, read back; ROS is not installed."""

import ast
import re
import sys
from collections.abc import Callable
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from test_rrd import drive as made_up_drive  # noqa: F401 (a fixture)

from nnql_bullet.deploy import Command, Controller, Odometry, Scan, WatchOptions
from nnql_bullet.recording import Recording
from nnql_bullet.sensing import ray_angles

if find_spec("rosbags") is None or find_spec("mcap") is None:
    pytest.skip("needs the extra: pip install 'nnql-bullet[ros]'", allow_module_level=True)

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "ros2"
STORE = get_typestore(Stores.ROS2_HUMBLE)
Cli = Callable[..., tuple[int, str, str]]
Told = tuple[float, Scan, Odometry]


@pytest.fixture(scope="module")
def node() -> Any:
    """The conversions of the node."""
    sys.path.insert(0, str(EXAMPLE))
    try:
        from nnql_bullet_ros import messages
    finally:
        sys.path.remove(str(EXAMPLE))
    return messages


def stamped(time: float, frame: str) -> Any:
    seconds, nanoseconds = divmod(round(1e9 * time), 1_000_000_000)
    return STORE.types["std_msgs/msg/Header"](STORE.types["builtin_interfaces/msg/Time"](seconds, nanoseconds), frame)


def as_messages(scan: Scan, o: Odometry) -> tuple[Any, Any]:
    """The same as messages."""
    make = STORE.types
    ranges, none = np.asarray(scan.ranges, np.float32), np.zeros(0, np.float32)
    angles = scan.angle_min, scan.angle_max, scan.angle_increment
    limits = scan.range_min, scan.range_max
    laser = make["sensor_msgs/msg/LaserScan"](stamped(scan.stamp, scan.frame), *angles, 0.0, 0.1, *limits, ranges, none)
    place = make["geometry_msgs/msg/Point"](o.x, o.y, 0.0)
    turn = make["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(o.yaw / 2), np.cos(o.yaw / 2))
    vector, covariance = make["geometry_msgs/msg/Vector3"], np.zeros(36)
    twist = make["geometry_msgs/msg/Twist"](vector(o.speed, 0.0, 0.0), vector(0.0, 0.0, o.yaw_rate))
    pose = make["geometry_msgs/msg/PoseWithCovariance"](make["geometry_msgs/msg/Pose"](place, turn), covariance)
    moving = make["geometry_msgs/msg/TwistWithCovariance"](twist, covariance)
    return laser, make["nav_msgs/msg/Odometry"](stamped(o.stamp, o.frame), "base_link", pose, moving)


@pytest.fixture(scope="module")
def told() -> list[Told]:
    """Four seconds of a drive past an obstacle, made up: what a lidar of 400 beams and odometry tell."""
    step = 2 * np.pi / 400
    angles = -np.pi + step * np.arange(400)
    ways = []
    for k in range(80):
        time, x = 1_700_000_000 + 0.05 * k, 0.05 * k
        bearing = np.arctan2(1.0, 7.0 - x)
        ranges = np.where(np.abs(angles - bearing) < 0.2, np.hypot(7.0 - x, 1.0), np.inf)
        ranges[:3] = np.nan
        scan = Scan(ranges, angles[0], angles[-1], step, 0.1, 25.0, time)
        ways.append((time, scan, Odometry(x, 0.1 * x, 0.1, time, 1.0, 0.02)))
    return ways


def test_a_bag_drives_as_what_it_was_written_from_does(told: list[Told], node: Any, tmp_path: Path) -> None:
    with Writer(tmp_path / "bag", version=9) as bag:
        kinds = {"scan": "sensor_msgs/msg/LaserScan", "odom": "nav_msgs/msg/Odometry"}
        topics = {name: bag.add_connection(f"/{name}", kind, typestore=STORE) for name, kind in kinds.items()}
        for time, scan, odometry in told:
            for name, message in zip(kinds, as_messages(scan, odometry), strict=True):
                bag.write(topics[name], round(1e9 * time), STORE.serialize_cdr(message, kinds[name]))
    by_bag, directly = Controller("paper", shield=True), Controller("paper", shield=True)
    last: dict[str, Any] = {}
    commands: list[Command] = []
    with Reader(tmp_path / "bag") as bag:
        for connection, stamp, data in bag.messages():
            last[connection.topic] = STORE.deserialize_cdr(data, connection.msgtype)
            if connection.topic == "/odom":
                commands.append(node.driven(by_bag, last["/scan"], last["/odom"], (9.0, 0.0), 1e-9 * stamp))
    expected = [directly.step(scan, odometry, (9.0, 0.0), time) for time, scan, odometry in told]
    assert [its.action for its in commands] == [its.action for its in expected]
    assert any(its.decided for its in commands[1:])
    assert not any(its.reason for its in commands)
    for mine, its in zip(commands, expected, strict=True):
        assert (mine.left, mine.right) == pytest.approx((its.left, its.right), abs=1e-4)  # ranges in single precision
    vector = STORE.types["geometry_msgs/msg/Vector3"]
    twist = STORE.types["geometry_msgs/msg/Twist"](vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0))
    filled = node.fill(twist, commands[-1])
    assert (filled.linear.x, filled.angular.z) == (commands[-1].speed, commands[-1].yaw_rate)


def test_messages_that_nobody_has_filled_in_stop_it_with_a_reason(told: list[Told], node: Any) -> None:
    time, scan, odometry = told[0]
    laser, odom = as_messages(scan, odometry)
    assert node.driven(Controller("paper"), None, None, (9.0, 0.0), time).reason == "no odometry has come"
    odom.pose.pose.orientation.z = odom.pose.pose.orientation.w = 0.0
    assert "'yaw' is nan" in node.driven(Controller("paper"), laser, odom, (9.0, 0.0), time).reason
    laser, odom = as_messages(scan, odometry)
    laser.header.frame_id = ""
    assert "in the frame ''" in node.driven(Controller("paper"), laser, odom, (9.0, 0.0), time).reason


def test_its_parameters_are_those_that_its_readme_names(node: Any) -> None:
    about = (EXAMPLE / "README.md").read_text(encoding="utf-8")
    named = re.findall(r"`(\w+)`", about.partition("Parameters, ")[2].partition("The base")[0])
    assert [*node.PARAMETERS] == ["policy", "vehicle", "shield", "speed", "rate", *asdict(WatchOptions())]
    assert sorted(named) == sorted(node.PARAMETERS)


def test_the_node_uses_nothing_but_ros_and_the_runtime() -> None:
    used = set()
    for path in EXAMPLE.rglob("*.py"):
        for its in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            used |= {alias.name for alias in its.names} if isinstance(its, ast.Import) else set()
            used |= {str(its.module)} if isinstance(its, ast.ImportFrom) else set()
    depends = {its.text for its in ElementTree.parse(EXAMPLE / "package.xml").getroot().iter("exec_depend")}
    ours = {name for name in used if name.startswith("nnql_bullet")}
    assert ours == {"nnql_bullet.deploy", "nnql_bullet_ros.messages"}
    others = {name.partition(".")[0] for name in used - ours} - {
        "dataclasses",
        "math",
        "typing",
        "launch",
        "setuptools",
    }
    assert others == depends


def read_back(path: Path) -> dict[str, list[tuple[float, Any]]]:
    """Times [s] and messages of a file, by topic, in the order of their times."""
    found: dict[str, list[tuple[float, Any]]] = {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            its = STORE.deserialize_cdr(message.data, schema.name)
            found.setdefault(channel.topic, []).append((1e-9 * message.log_time, its))
    return found


@pytest.fixture(scope="module")
def messages(made_up_drive: Recording, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[tuple[float, Any]]]:  # noqa: F811
    from nnql_bullet.reports.mcap import write_mcap

    path = tmp_path_factory.mktemp("mcap") / "drive.mcap"
    write_mcap(made_up_drive, path)
    return read_back(path)


Messages = dict[str, list[tuple[float, Any]]]


class TestMcap:
    def test_scans_are_those_of_the_states(self, made_up_drive: Recording, messages: Messages) -> None:  # noqa: F811
        times, scans = zip(*messages["/scan"], strict=True)
        assert times == pytest.approx(made_up_drive.state_time)
        for scan, time, distances in zip(scans, times, made_up_drive.ray_distances, strict=True):
            assert scan.header.frame_id == "laser"
            assert scan.header.stamp.sec + 1e-9 * scan.header.stamp.nanosec == pytest.approx(time)
            assert np.isinf(scan.ranges).tolist() == (distances >= 10.0).tolist()
            assert np.minimum(scan.ranges, 10.0) == pytest.approx(distances, rel=1e-6)
            assert scan.angle_min + scan.angle_increment * np.arange(72) == pytest.approx(ray_angles(), abs=1e-5)
            assert scan.angle_max == pytest.approx(ray_angles()[-1])

    def test_odometry_and_frames_follow_the_vehicle(self, made_up_drive: Recording, messages: Messages) -> None:  # noqa: F811
        drive = made_up_drive
        odometry = {round(time, 6): its for time, its in messages["/odom"]}
        frames = {round(time, 6): its.transforms[0] for time, its in messages["/tf"]}
        assert odometry.keys() == frames.keys() >= set(np.round(drive.sample_time, 6).tolist())
        for time, (x, y, yaw) in zip(drive.sample_time, drive.sample_pose, strict=True):
            place, frame = odometry[round(float(time), 6)], frames[round(float(time), 6)]
            its = place.pose.pose
            assert (its.position.x, its.position.y) == pytest.approx((x, y))
            assert 2 * np.arctan2(its.orientation.z, its.orientation.w) == pytest.approx(yaw)
            assert (frame.header.frame_id, frame.child_frame_id) == ("odom", "base_link")
            assert (frame.transform.translation.x, frame.transform.rotation.z) == pytest.approx((x, its.orientation.z))
            assert place.twist.twist.linear.x == pytest.approx(4.0 * np.pi / 2 / 3.0, rel=1e-3)  # a quarter circle
            assert place.twist.twist.angular.z == pytest.approx(np.pi / 2 / 3.0, rel=1e-3)
        ((_, still),) = messages["/tf_static"]
        assert still.transforms[0].child_frame_id == "laser"
        assert still.transforms[0].transform.translation.x == pytest.approx(0.35)

    def test_markers_show_the_world_the_vehicle_and_what_moves(
        self,
        made_up_drive: Recording,  # noqa: F811
        messages: Messages,
    ) -> None:
        ((_, world),) = messages["/world"]
        (box,) = [its for its in world.markers if its.ns == "obstacles"]
        assert (box.pose.position.x, box.pose.position.y, box.scale.x, box.scale.y) == (12.0, 6.0, 2.0, 4.0)
        assert len({its.id for its in world.markers}) == len(world.markers)
        assert {its.ns for its in world.markers} == {"obstacles", "walls", "start", "targets", "path"}
        ((_, vehicle),) = messages["/vehicle"]
        assert vehicle.markers[0].header.frame_id == "base_link"
        for time, patrols in messages["/patrols"]:
            there = made_up_drive.world.patrols[0].at(time)
            assert patrols.markers[0].pose.position.y == pytest.approx(there.y, abs=1e-6)

    def test_the_log_tells_contacts_and_the_ending(self, messages: Messages) -> None:
        texts = [its.msg for _, its in messages["/rosout"]]
        assert "contact with an obstacle or a wall" in texts
        assert texts[-1] == "collision after 3.0 s"
        assert sum(text.startswith("shield: ") for text in texts) == 3

    def test_two_files_of_a_recording_are_the_same(self, made_up_drive: Recording, tmp_path: Path) -> None:  # noqa: F811
        from nnql_bullet.reports.mcap import write_mcap

        for name in ("one", "other"):
            write_mcap(made_up_drive, tmp_path / name)
        assert (tmp_path / "one").read_bytes() == (tmp_path / "other").read_bytes()

    def test_the_verb_writes_it_where_it_is_told(self, made_up_drive: Recording, run_cli: Cli, tmp_path: Path) -> None:  # noqa: F811
        made_up_drive.save(tmp_path / "drive.npz")
        code, out, err = run_cli("view", tmp_path / "drive.npz", "--out", tmp_path / "new" / "drive.mcap")
        assert (code, err) == (0, "")
        assert out.splitlines()[0] == f"time line: {tmp_path / 'new' / 'drive.mcap'}"
        assert "/odom" in read_back(tmp_path / "new" / "drive.mcap")
