"""Robots that would be driven wrongly are refused, and those beside them, which are right, are driven alike."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import astuple, replace
from importlib.util import find_spec
from io import StringIO
from math import cos, sin
from pathlib import Path

import numpy as np
import pytest
import yourdfpy

from nnql_bullet import assets
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import OrientedBox, Pose
from nnql_bullet.sim.bullet import bullet
from nnql_bullet.sim.bullet_scene import BulletScene
from nnql_bullet.sim.bullet_state import LinkState
from nnql_bullet.sim.contact import ContactEngine, VehicleMotion
from nnql_bullet.sim.engines import EngineName, contact_engine
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.description import describe, parse, text_of
from nnql_bullet.vehicle.payload import Payload, loaded, physics_text, urdf_text
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.vehicle.visuals import Visuals
from nnql_bullet.worlds.spec import WorldSpec

ROBOTS = assets.folder("robots")
URDF = (ROBOTS / "tricycle.urdf").read_text(encoding="utf-8")
TOML = (ROBOTS / "tricycle.toml").read_text(encoding="utf-8")
NEEDS_MUJOCO = pytest.mark.skipif(find_spec("mujoco") is None, reason="needs the extra: mujoco")
ENGINES = ["bullet", pytest.param("mujoco", marks=NEEDS_MUJOCO)]

Write = Callable[..., str]
Edits = list[tuple[str, str]]

BOX = '<origin xyz="0.35 0 0.12" rpy="0 0 0" />\n      <geometry>\n        <box size="1.1 0.65 0.28" />'
LEFT = '<origin xyz="0 0.3 0" rpy="0 0 0" />\n    <axis xyz="0 1 0" />'
RIGHT = '<origin xyz="0 -0.3 0" rpy="0 0 0" />\n    <axis xyz="0 1 0" />'
SWIVEL = '<origin xyz="0.74 0 -0.075" rpy="0 0 0" />'
ROLL = '<origin xyz="-0.04 0 0" rpy="0 0 0" />'
COM = '<origin xyz="0.12 0 0.095" rpy="0 0 0" />'
SPHERE = '<origin xyz="0 0 0" rpy="0 0 0" />\n      <geometry>\n        <sphere radius="0.125" />'
FORK = '<link name="fork">'
INERTIA = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1" />'
SHAPE = '<collision><geometry><box size="0.1 0.1 0.1" /></geometry></collision>'
END = "</robot>"


def link(name: str, inside: str = "", mass: float | None = 1.0) -> str:
    inertial = "" if mass is None else f'<inertial><mass value="{mass}" />{INERTIA}</inertial>'
    return f'<link name="{name}">{inertial}{inside}</link>'


def joint(name: str, parent: str, child: str, origin: str = "0 0 0", rpy: str = "0 0 0", kind: str = "fixed") -> str:
    ends = f'<parent link="{parent}" /><child link="{child}" />'
    return f'<joint name="{name}" type="{kind}">{ends}<origin xyz="{origin}" rpy="{rpy}" /><axis xyz="0 1 0" /></joint>'


@pytest.fixture
def robot(tmp_path: Path) -> Write:
    """Writes a robot with some text replaced and gives the path to its TOML."""

    def write(edits: Edits = [], toml: Edits = [], urdf: str | bytes = URDF) -> str:  # noqa: B006
        texts = {"mine.toml": TOML, "tricycle.urdf": urdf}
        for name, pairs in (("mine.toml", toml), ("tricycle.urdf", edits)):
            for old, new in pairs:
                assert old in texts[name]
                texts[name] = texts[name].replace(old, new)
        for name, text in texts.items():
            (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
        return str(tmp_path / "mine.toml")

    return write


def turned(rpy: str, size: str) -> Edits:
    return [(BOX, BOX.replace('rpy="0 0 0"', f'rpy="{rpy}"').replace("1.1 0.65 0.28", size))]


WRONG: dict[str, tuple[Edits, str]] = {
    "box above the obstacles": (
        [(BOX, BOX.replace("0.35 0 0.12", "0.35 0 0.9"))],
        r"between the heights 0\.885 and 1\.165 m, so that obstacles that the sensor sees at 0\.6 m may not touch it",
    ),
    "box under the ground": (
        [(BOX, BOX.replace("0.35 0 0.12", "0.35 0 -0.4"))],
        "between the heights -0.415 and -0.135 m",
    ),
    "second caster": (
        [(END, link("wheel_2", SHAPE) + joint("roll_2", "chassis", "wheel_2", kind="continuous") + END)],
        r"besides its drive wheels it has wheels on fixed axles \('roll_2'\), which skid",
    ),
    "frame on the ground": (
        [(LEFT, LEFT.replace("0 0.3 0", "0 0.3 0.125")), (RIGHT, RIGHT.replace("0 -0.3 0", "0 -0.3 0.125"))],
        r"caster 'caster_wheel' ends 0\.125 m below the ground that the drive wheels of radius 0\.125 m stand on",
    ),
    "drive wheels on two axles": (
        [(LEFT, LEFT.replace("0 0.3 0", "0.1 0.3 0"))],
        r"the drive wheels are not on one axle, but at \(0\.1, 0\.3, 0\.0\) and \(0\.0, -0\.3, 0\.0\)",
    ),
    "drive wheels of two heights": (
        [(LEFT, LEFT.replace("0 0.3 0", "0 0.3 0.01"))],
        "the drive wheels are not on one axle",
    ),
    "caster behind": (
        [(SWIVEL, SWIVEL.replace("0.74", "-0.6"))],
        r"would tip over: its centre of mass is at x = 0\.08608, .* and it stands on x = -0\.64 to 0 m",
    ),
    "caster wheel to the side": (
        [(ROLL, ROLL.replace("-0.04 0 0", "-0.04 0.03 0"))],
        r"not under its swivel 'swivel': the swivel is at \(0\.74, 0\.0, -0\.075\), the wheel at \(0\.7, 0\.03",
    ),
    "caster without trail": (
        [(ROLL, ROLL.replace("-0.04", "0"))],
        r"'caster_roll' \(joints\.caster_roll\) is no wheel that trails the swivel 'swivel'",
    ),
    "caster above the ground": ([(SWIVEL, SWIVEL.replace("-0.075", "-0.055"))], r"ends 0\.02 m above the ground"),
    "caster not below its swivel": (
        [('<parent link="fork" />', '<parent link="chassis" />'), (ROLL, ROLL.replace("-0.04 0 0", "0.7 0 -0.075"))],
        r"'caster_roll' \(joints\.caster_roll\) is no wheel that trails the swivel 'swivel'",
    ),
    "drive wheel on the fork": (
        [
            (
                '<parent link="chassis" />\n    <child link="left_wheel" />',
                '<parent link="fork" />\n    <child link="left_wheel" />',
            )
        ],
        r"drive joint 'left_drive' does not turn about a level axis",
    ),
    "drive axis of the chassis in a turned wheel": (
        [(RIGHT, RIGHT.replace('rpy="0 0 0"', 'rpy="-1.5708 0 0"'))],
        r"drive joint 'right_drive' does not turn about a level axis",
    ),
    "no axis, which is x": ([('<axis xyz="0 0 1" />', "")], r"wheels on fixed axles \('swivel'\)"),
    "sphere off the axle": (
        [(SPHERE, SPHERE.replace("0 0 0", "0 0 0.02", 1))],
        r"the sphere of the wheel on joint 'left_drive' is 0\.02 m off its axle, and its radius is 0\.125 m",
    ),
    "two shapes on a wheel": (
        [('<link name="caster_wheel">', '<link name="caster_wheel">' + SHAPE)],
        r"caster 'caster_wheel' ends 0\.02071 m below the ground",
    ),
    "mass behind the axle": (
        [(COM, COM.replace("0.12", "-0.1"))],
        r"would tip over: its centre of mass is at x = -0\.0\d+, y = 0 m",
    ),
    "mass ahead of the caster": ([(COM, COM.replace("0.12", "0.85"))], "would tip over"),
    "mass under the ground": ([(COM, COM.replace("0.095", "-0.3"))], "centre of mass is under the ground"),
    "massless wheel": (
        [('<inertial>\n      <origin xyz="-0.02 0 0.02" rpy="0 0 0" />\n      <mass value="1.5" />', "<inertial>")],
        r"has no mass and inertia; give it an <inertial>",
    ),
    "nan position": (
        [(SWIVEL, SWIVEL.replace("0.74", "nan"))],
        r'<origin xyz="nan 0 -0\.075"> of joint \'swivel\' must be finite',
    ),
    "infinite box": (
        [("1.1 0.65 0.28", "inf 0.65 0.28")],
        r'<box size="inf 0\.65 0\.28"> of link \'chassis\' must be finite',
    ),
    "huge box": ([("1.1 0.65 0.28", "1e999 0.65 0.28")], "must be finite"),
    "negative box": ([("1.1 0.65 0.28", "1.1 -0.65 0.28")], "must be positive"),
    "two numbers": ([(COM, COM.replace("0.12 0 0.095", "0.12 0"))], r'<origin xyz="0\.12 0"> .* must be 3 numbers'),
    "decimal comma": ([("1.1 0.65 0.28", "1,1 0,65 0,28")], "must be 3 numbers"),
    "number only for Python": ([("1.1 0.65 0.28", "1_1 0.65 0.28")], "must be 3 numbers"),
    "nan inertia": ([('ixx="2.76577"', 'ixx="nan"')], "must be finite"),
    "inertia that no body has": (
        [('ixx="2.76577"', 'ixx="0.1"')],
        r"link 'chassis' has an inertia that no body has: its largest moment, 10\.89 kg m2, is more than both others",
    ),
    "infinite mass": ([('mass value="104.5"', 'mass value="inf"')], r"link 'chassis' has a mass of inf kg"),
    "two links of a name": ([(FORK, '<link name="chassis">')], "two links are named 'chassis'"),
    "link of no name": ([(FORK, "<link>")], "a <link> has no name"),
    "two joints of a name": (
        [('<joint name="right_drive"', '<joint name="left_drive"')],
        "two joints are named 'left_drive'",
    ),
    "two roots": ([(END, link("lonely") + END)], "one link must carry all others; no joint carries: chassis, lonely"),
    "circle": (
        [
            (
                '<parent link="chassis" />\n    <child link="fork" />',
                '<parent link="caster_wheel" />\n    <child link="fork" />',
            )
        ],
        "in a circle",
    ),
    "child of two": ([(END, joint("again", "chassis", "fork") + END)], "link 'fork' is the child of two joints"),
}


@pytest.mark.parametrize(("edits", "message"), WRONG.values(), ids=WRONG)
def test_a_robot_that_would_be_driven_wrongly_is_refused_in_one_line(robot: Write, edits: Edits, message: str) -> None:
    with pytest.raises(UserError, match=message) as refusal:
        load_vehicle(robot(edits))
    assert "tricycle.urdf: " in str(refusal.value)
    assert "\n" not in str(refusal.value)


RIGHT_ONES: dict[str, Edits] = {
    "box turned by a quarter": turned("0 0 1.5707963", "0.65 1.1 0.28"),
    "box turned by a rounded quarter": turned("0 0 1.57", "0.65 1.1 0.28"),
    "box on its side": turned("1.5707963 0 0", "1.1 0.28 0.65"),
    "box head over": turned("0 3.14159265 0", "1.1 0.65 0.28"),
    "wheels with their axes along z, as ROS has them": [
        (LEFT, LEFT.replace('rpy="0 0 0"', 'rpy="-1.57 0 0"').replace('xyz="0 1 0"', 'xyz="0 0 1"')),
        (RIGHT, RIGHT.replace('rpy="0 0 0"', 'rpy="-1.57 0 0"').replace('xyz="0 1 0"', 'xyz="0 0 1"')),
        # the tyre's axis in the turned frame
        (
            'ixx="0.024687" ixy="0" ixz="0" iyy="0.046874" iyz="0" izz="0.024687"',
            'ixx="0.024687" ixy="0" ixz="0" iyy="0.024687" iyz="0" izz="0.046874"',
        ),
    ],
    "wheel turned about its axle": [(LEFT, LEFT.replace('rpy="0 0 0"', 'rpy="0 1.2 0"'))],
    "wheel turned by pi with its axis turned back": [
        (RIGHT, RIGHT.replace('rpy="0 0 0"', 'rpy="0 0 3.14159265"').replace("0 1 0", "0 -1 0"))
    ],
    "massless frames": [
        (
            END,
            link("imu", mass=None)
            + joint("i", "chassis", "imu", "0 0 0.3")
            + link("optical", mass=None)
            + joint("o", "imu", "optical", "0.1 0 0", "-1.57 0 -1.57")
            + END,
        )
    ],
    "frame of mass zero": [(END, link("imu", mass=0) + joint("i", "chassis", "imu", "0 0 0.3") + END)],
    "base_footprint": [
        (END, link("base_footprint", mass=None) + joint("b", "base_footprint", "chassis", "0 0 0.125") + END)
    ],
    "base_footprint and a scanner on it": [
        (
            END,
            link("base_footprint", mass=None)
            + joint("b", "base_footprint", "chassis", "0 0 0.125", "0 0 1")
            + link("scan", mass=None)
            + joint("s", "base_footprint", "scan", "0.2 0 0.6")
            + END,
        )
    ],
    "wheel on a massless mount": [
        (
            '<parent link="chassis" />\n    <child link="left_wheel" />\n    ' + LEFT,
            '<parent link="mount" />\n    <child link="left_wheel" />\n    ' + LEFT.replace("0 0.3 0", "0 0 -0.1"),
        ),
        (END, link("mount", mass=None) + joint("m", "chassis", "mount", "0 0.3 0.1") + END),
    ],
    "textures, other colours and repeated elements": [
        (
            '<color rgba="0.96 0.62 0.07 1" />',
            '<texture filename="/etc/passwd" /><color rgba="300 0.62 -7 1" /><color rgba="0 0 0 0" />',
        ),
        ('<axis xyz="0 0 1" />', '<axis xyz="0 0 1" /><axis xyz="1 0 0" /><mimic joint="left_drive" />'),
    ],
    "transmissions and plugins": [
        (
            END,
            '<transmission name="t"><joint name="left_drive"><hardwareInterface>x</hardwareInterface></joint>'
            "</transmission><gazebo><plugin filename='libx.so'/></gazebo>" + END,
        )
    ],
    "meshes that are nowhere": [('<box size="0.92 0.5 0.2" />', '<mesh filename="package://nowhere/base.stl" />')],
}


ACCEPTED: dict[str, tuple[Edits, dict[str, float]]] = {
    "box askew": (
        turned("0 0 0.3", "1.1 0.65 0.28"),
        dict(half_length=0.55 * cos(0.3) + 0.325 * sin(0.3), half_width=0.55 * sin(0.3) + 0.325 * cos(0.3)),
    ),
    "box pitched": (
        turned("0 0.1 0", "1.1 0.65 0.28"),
        dict(half_length=0.55 * cos(0.1) + 0.14 * sin(0.1), half_width=0.325),
    ),
    "box turned and sides kept": (turned("0 0 1.5708", "1.1 0.65 0.28"), dict(half_width=0.55)),
    "box narrower than the track": ([("1.1 0.65 0.28", "1.1 0.1 0.28")], dict(half_length=0.55, half_width=0.3)),
    "box behind the caster": (
        [("1.1 0.65 0.28", "0.8 0.65 0.28")],
        dict(x=(0.83 - 0.125) / 2, half_length=(0.83 + 0.125) / 2),
    ),
    "two boxes": (
        [(f"<collision>\n      {BOX}", f"{SHAPE}<collision>\n      {BOX}")],
        dict(half_length=0.55, half_width=0.325),
    ),
    "mesh for a box": ([('<box size="1.1 0.65 0.28" />', '<mesh filename="package://a/b.stl" />')], dict()),
    "shape on a fork": ([(FORK, FORK + SHAPE)], dict(half_length=0.55)),
    "shape on a further link": (
        [(END, link("bumper", SHAPE) + joint("b", "chassis", "bumper") + END)],
        dict(half_length=0.55, mass=121.0),
    ),
    "lift": ([(END, link("fork_2") + joint("lift", "chassis", "fork_2", kind="prismatic") + END)], dict(mass=121.0)),
    "frame in the middle": (
        [(LEFT, LEFT.replace("0 0.3 0", "-0.35 0.3 0")), (RIGHT, RIGHT.replace("0 -0.3 0", "-0.35 -0.3 0"))],
        dict(wheelbase=1.05, com_ahead=0.125167 + 0.315),
    ),
    "frame off the middle": ([(RIGHT, RIGHT.replace("-0.3", "-0.25"))], dict(track=0.55, y=-0.025)),
    "caster to the side": ([(SWIVEL, SWIVEL.replace("0.74 0 ", "0.74 0.2 "))], dict(wheelbase=0.7)),
    "drive wheel turned": (
        [(RIGHT, RIGHT.replace('rpy="0 0 0"', 'rpy="0 0 3.14159265"'))],
        dict(track=0.6, wheelbase=0.7),
    ),
    "mass to the side": ([(COM, COM.replace("0.12 0", "0.12 0.05"))], dict(com_left=0.05 * 104.5 / 120)),
}


@pytest.mark.parametrize(("edits", "expected"), ACCEPTED.values(), ids=ACCEPTED)
def test_what_sticks_out_and_where_frames_lie_is_taken_into_account(
    robot: Write, edits: Edits, expected: dict[str, float]
) -> None:
    """By hand: the rectangle around box, wheels and the swept caster; the drive axle is the origin."""
    vehicle = load_vehicle(robot(edits))
    for field, value in expected.items():
        found = getattr(vehicle.footprint if hasattr(vehicle.footprint, field) else vehicle, field)
        assert found == pytest.approx(value, abs=1e-4), field


@contextmanager
def contact_engine_of(name: EngineName, vehicle: VehicleSpec) -> Iterator[ContactEngine]:
    engine = contact_engine(name, "fast", vehicle, DriveOptions())
    engine.reset(WorldSpec("test", 0, 200.0, 200.0, (), Pose(100.0, 100.0, 0.0), (190.0, 190.0), 2.0, 1.5))
    yield engine
    engine.close()


def seen(engine: ContactEngine, world: WorldSpec) -> list[VehicleMotion]:
    """What a drive with turns gives."""
    engine.reset(world)
    return [engine.advance(turn) for turn in (0.0, 0.6, -0.4, 0.0)]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("edits", RIGHT_ONES.values(), ids=RIGHT_ONES)
def test_another_writing_of_the_vehicle_is_driven_like_it(
    robot: Write, vehicle: VehicleSpec, empty_world: WorldSpec, edits: Edits, engine: EngineName
) -> None:
    other = load_vehicle(robot(edits))
    assert Visuals({"urdf": urdf_text(other), "joints": other.joints, "wheel_radius": 0.125}).shapes
    for field in ("mass", "com_ahead", "com_height", "yaw_inertia", "track", "wheelbase"):
        assert getattr(other, field) == pytest.approx(getattr(vehicle, field), abs=1e-6), field
    assert other.wheel_spin_inertia == pytest.approx(vehicle.wheel_spin_inertia, rel=1e-4)
    a, b = other.footprint, vehicle.footprint
    assert (a.x, a.y, a.half_length, a.half_width) == pytest.approx((b.x, b.y, b.half_length, b.half_width), abs=1e-3)
    one, two = (contact_engine(engine, "fast", spec, DriveOptions()) for spec in (other, vehicle))
    for here, there in zip(seen(one, empty_world), seen(two, empty_world), strict=True):
        assert astuple(here.pose) == pytest.approx(astuple(there.pose), abs=2e-3)
    assert sum(its.mass for its in one.link_dynamics().values()) == pytest.approx(120.0)
    one.close()
    two.close()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("simulated_mass", ["products of inertia", "turned inertia", "mass to the side, balanced"])
def test_the_pose_is_that_of_the_axle_however_the_inertia_lies(
    robot: Write, empty_world: WorldSpec, simulated_mass: str, engine: EngineName
) -> None:
    """PyBullet tells the frame of the principal axes of inertia, at the centre of mass of the base link."""
    edits = {
        "products of inertia": [('ixx="2.76577" ixy="0"', 'ixx="2.76577" ixy="0.5"')],
        "turned inertia": [(COM, COM.replace('rpy="0 0 0"', 'rpy="0 0 0.5"'))],
        "mass to the side, balanced": [
            (COM, COM.replace("0.12 0", "0.12 0.05")),
            (END, link("battery", mass=26.125) + joint("b", "chassis", "battery", "0 -0.2 0") + END),
        ],
    }[simulated_mass]
    held = contact_engine(engine, "fast", load_vehicle(robot(edits)), DriveOptions())
    start = Pose(100.0, 100.0, 0.7)
    held.place(empty_world, start, 0.0)
    assert astuple(held.pose()) == pytest.approx(astuple(start), abs=1e-6)
    held.reset(replace(empty_world, start=start))
    for _ in range(4):
        motion = held.advance(0.0)
    ahead = 4 * DriveOptions().decision_period * DriveOptions().speed
    there = (100.0 + ahead * cos(0.7), 100.0 + ahead * sin(0.7), 0.7)
    assert astuple(motion.pose) == pytest.approx(there, abs=0.02)
    held.close()


def test_a_vehicle_is_drawn_at_its_pose_however_its_inertia_lies(robot: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle = load_vehicle(
        robot([('ixx="2.76577" ixy="0"', 'ixx="2.76577" ixy="0.5"'), (COM, COM.replace("12 0", "12 0.01"))])
    )
    monkeypatch.setattr(bullet, "GUI", bullet.DIRECT)
    scene = BulletScene()
    body, joints = scene.add_robot(urdf_text(vehicle))
    scene.place(body, 3.0, 4.0, 0.125, 0.7)
    left = LinkState(
        *bullet.getLinkState(body, joints["left_drive"], computeForwardKinematics=1, physicsClientId=scene.client)
    )
    assert left.position == pytest.approx((3.0 - 0.3 * sin(0.7), 4.0 + 0.3 * cos(0.7), 0.125), abs=1e-6)
    scene.close()


@pytest.mark.parametrize("engine", ENGINES)
def test_a_turned_box_touches_the_wall_where_it_is(
    robot: Write, world_of: Callable[..., WorldSpec], engine: EngineName
) -> None:
    held = contact_engine(engine, "fast", load_vehicle(robot(RIGHT_ONES["box turned by a quarter"])), DriveOptions())
    held.reset(world_of(OrientedBox(105.0, 100.0, 0.5, 5.0, 0.0)))
    motions = [held.advance(0.0) for _ in range(4)]
    assert motions[-1].touching
    assert motions[-1].pose.x + 0.9 == pytest.approx(104.5, abs=0.02)
    held.close()


@pytest.mark.parametrize("engine", ENGINES)
def test_a_vehicle_on_its_roof_has_overturned(vehicle: VehicleSpec, empty_world: WorldSpec, engine: EngineName) -> None:
    held = contact_engine(engine, "fast", vehicle, DriveOptions())
    held.reset(empty_world)
    assert not held.advance(0.0).overturned
    if engine == "bullet":
        bullet.resetBasePositionAndOrientation(held.body, [100.0, 100.0, 0.5], [1.0, 0.0, 0.0, 0.0], held.client)
    else:
        held._position[3:7] = 0.0, 1.0, 0.0, 0.0
    motion = held.advance(0.0)
    assert (motion.overturned, motion.touching, motion.at_target) == (True, False, False)
    assert motion.duration == pytest.approx(1 / 30)
    held.reset(empty_world)
    assert not held.advance(0.0).overturned
    held.close()


def mounted(mass: float | None) -> Edits:
    """A bracket that is turned every way, with or without mass, and what hangs on it: a mast, a scanner, a lamp."""
    look = '<visual><origin xyz="0 0.1 0.2" rpy="0.3 0 0" /><geometry><sphere radius="0.03" /></geometry></visual>'
    parts = link("bracket", look, mass) + joint("b", "chassis", "bracket", "0.2 0.1 0.3", "0.4 -0.5 1.2")
    parts += link("mast", look) + joint("m", "bracket", "mast", "0.1 0.2 -0.3", "-1 1.5707963267948966 0.2")
    parts += link("scanner") + joint("s", "mast", "scanner", "0 0 0.1", "0.7 0.3 0")
    return [(END, parts + END)]


def test_folding_a_massless_frame_moves_nothing() -> None:
    """Against yourdfpy, which folds nothing."""
    text = URDF.replace(*mounted(None)[0])
    theirs = yourdfpy.URDF.load(StringIO(text), load_meshes=False)
    robot = parse(text)
    ours = describe(robot)
    assert "bracket" not in ours.links
    for name in ("mast", "scanner", "caster_wheel", "left_wheel"):
        assert ours.frames[name] == pytest.approx(theirs.get_transform(name), abs=1e-12)
    place = theirs.get_transform("bracket") @ theirs.link_map["bracket"].visuals[0].origin
    again = yourdfpy.URDF.load(StringIO(text_of(robot)), load_meshes=False)
    assert again.link_map["chassis"].visuals[-1].origin == pytest.approx(place, abs=1e-12)


def test_folding_a_massless_root_moves_nothing_relative_to_the_chassis() -> None:
    base = link("base_footprint", mass=None) + joint("b", "base_footprint", "chassis", "0.1 0 0.125", "0.1 0.2 0.3")
    text = URDF.replace(END, base + link("scan") + joint("s", "base_footprint", "scan", "0.2 0 0.6", "0 0 1") + END)
    theirs, ours = yourdfpy.URDF.load(StringIO(text), load_meshes=False), describe(parse(text))
    assert ours.base == "chassis"
    to_chassis = np.linalg.inv(theirs.get_transform("chassis"))
    for name in ("scan", "caster_wheel"):
        assert ours.frames[name] == pytest.approx(to_chassis @ theirs.get_transform(name), abs=1e-12)


def test_a_load_that_tips_the_vehicle_over_is_refused(vehicle: VehicleSpec) -> None:
    assert loaded(vehicle, Payload(5000.0, 0.69, 0.5)).com_ahead < vehicle.wheelbase
    with pytest.raises(UserError, match=r"'tricycle' would tip over under 5000 kg at x = 0\.8 m: the centre of mass"):
        loaded(vehicle, Payload(5000.0, 0.8, 0.5))


def test_a_load_does_not_take_the_name_of_a_part(robot: Write) -> None:
    vehicle = load_vehicle(robot([('"fork"', '"payload"')]))
    assert "payload" in physics_text(vehicle)
    with pytest.raises(UserError, match=r"tricycle\.urdf: has a part named 'payload'; give it another name"):
        physics_text(loaded(vehicle, Payload(20.0, 0.3, 0.5)))


def test_a_link_with_mass_is_no_frame(robot: Write) -> None:
    assert load_vehicle(robot(mounted(2.0))).mass == pytest.approx(124.0)  # with mast and scanner of 1 kg each
    assert load_vehicle(robot(mounted(None))).mass == pytest.approx(122.0)


@pytest.mark.parametrize(
    ("coding", "declared"),
    [("latin-1", "ISO-8859-1"), ("cp1252", "windows-1252"), ("utf-16", "UTF-16"), ("utf-8-sig", "utf-8")],
)
def test_a_urdf_is_read_in_the_encoding_that_it_declares(robot: Write, coding: str, declared: str) -> None:
    text = URDF.replace('<?xml version="1.0"?>', f'<?xml version="1.0" encoding="{declared}"?>')
    text = text.replace("caster_wheel", "r\u00e4dchen")
    vehicle = load_vehicle(robot(urdf=text.encode(coding)))
    assert vehicle.links["caster_roll"] == "r\u00e4dchen"
    with contact_engine_of("bullet", loaded(vehicle, Payload(20.0, 0.3, 0.5))) as engine:
        assert engine.link_dynamics()["r\u00e4dchen"].mass == 2.0


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(URDF.replace("1.0", '1.0" encoding="klingon', 1).encode(), id="unknown encoding"),
        pytest.param(URDF.replace("1.0", '1.0" encoding="shift_jis', 1).encode(), id="encoding that expat lacks"),
        pytest.param(b"<robot>" + b"<a>" * 100_000, id="deep"),
        pytest.param(
            b"<robot name='r'><link name='a'>" + b"<a>" * 300 + b"</a>" * 300 + b"</link></robot>", id="closed"
        ),
        pytest.param(b"\0" * 1000, id="zeros"),
    ],
)
def test_a_urdf_that_is_no_xml_is_refused_in_one_line(robot: Write, text: bytes) -> None:
    with pytest.raises(UserError, match=r"tricycle\.urdf: cannot be read as a URDF: ") as refusal:
        load_vehicle(robot(urdf=text))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    "declared",
    [
        pytest.param('<!ENTITY m "104.5">', id="entity"),
        pytest.param('<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;"><!ENTITY m "&b;&b;&b;">', id="laughs"),
        pytest.param('<!ENTITY m SYSTEM "SECRET">', id="external"),
        pytest.param('<!ENTITY % p SYSTEM "SECRET"> %p;', id="parameter"),
        pytest.param("", id="type alone"),
    ],
)
def test_a_document_type_is_refused_and_no_entity_expanded(robot: Write, tmp_path: Path, declared: str) -> None:
    secret = tmp_path / "secret.txt"
    secret.write_text("104.5")
    start = f"<!DOCTYPE robot [{declared.replace('SECRET', secret.as_uri())}]><robot name"
    text = URDF.replace("<robot name", start).replace('name="tricycle"', 'name="&m;"')
    with pytest.raises(UserError, match=r"it declares a document type \(<!DOCTYPE>\); remove that") as refusal:
        load_vehicle(robot(urdf=text))
    assert "104.5" not in str(refusal.value)
    with pytest.raises(UserError, match=r"the vehicle in this recording .* declares a document type"):
        Visuals({"urdf": text, "joints": {}, "wheel_radius": 0.1})


@pytest.mark.parametrize("place", ["../tricycle.urdf", "below/../../tricycle.urdf", str(ROBOTS / "tricycle.urdf")])
def test_a_robot_does_not_lead_out_of_its_folder(robot: Write, place: str) -> None:
    with pytest.raises(
        UserError, match=r"mine\.toml: 'urdf': '.*' leads out of the folder of this file; put the URDF beside"
    ):
        load_vehicle(robot(toml=[('"tricycle.urdf"', f'"{place}"')]))


def test_a_urdf_below_its_toml_is_read(robot: Write, tmp_path: Path) -> None:
    toml = robot(toml=[('"tricycle.urdf"', '"urdf/tricycle.urdf"')])
    (tmp_path / "urdf").mkdir()
    (tmp_path / "tricycle.urdf").rename(tmp_path / "urdf" / "tricycle.urdf")
    assert load_vehicle(toml).mass == 120.0


@pytest.mark.parametrize("name", ["package://a/b.stl", "../b.stl", "/etc/passwd", "file:///etc/passwd", "b.stl"])
def test_no_mesh_is_opened_and_the_collision_shape_is_drawn_in_its_place(robot: Write, name: str) -> None:
    mesh = f'<mesh filename="{name}" />'
    looks = re.sub(r'<cylinder radius="0.(125|075)" length="0.05." />|<box size="0.16 0.058 0.02" />', mesh, URDF)
    looks = looks.replace('<cylinder radius="0.125" length="0.05" />', mesh)
    vehicle = load_vehicle(robot(urdf=looks.replace('<box size="0.92 0.5 0.2" />', mesh)))
    assert name not in physics_text(vehicle)
    shown = Visuals({"urdf": urdf_text(vehicle), "joints": vehicle.joints, "wheel_radius": 0.125}).shapes
    (wheel,) = [shape for shape in shown if shape.link == "left_wheel"]
    assert (wheel.kind, wheel.half_sizes, wheel.colour) == ("sphere", (0.125,) * 3, (0.10, 0.10, 0.11))
    assert [shape.kind for shape in shown if shape.link == "chassis"] == ["box"] * 5 + ["cylinder"] * 2


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("acceleration = 2.5", "acceleration = nan", "'limits.acceleration'"),
        ("acceleration = 2.5", "acceleration = inf", "'limits.acceleration'"),
        ("acceleration = 2.5", "acceleration = -1.0", "'limits.acceleration'"),
        ("[0.35, 0.0, 0.475]", "[nan, 0.0, 0.475]", "'sensor.position.0'"),
        (
            "[0.35, 0.0, 0.475]",
            "[0.35, 0.0, -0.2]",
            "sensor.position in the TOML is under the ground, at a height of -0.075 m",
        ),
    ],
)
def test_odd_numbers_in_a_robots_toml_are_refused(robot: Write, old: str, new: str, message: str) -> None:
    with pytest.raises(UserError, match=re.escape(message)):
        load_vehicle(robot(toml=[(old, new)]))


def test_byte_order_marks_are_read(robot: Write, tmp_path: Path) -> None:
    toml = Path(robot(urdf=b"\xef\xbb\xbf" + URDF.encode()))
    toml.write_bytes(b"\xef\xbb\xbf" + TOML.encode())
    assert load_vehicle(toml).mass == 120.0
