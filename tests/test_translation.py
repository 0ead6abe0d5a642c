"""Robots of many kinds are read as they are: geometry by hand, and contact physics against the kinematic model."""

from math import radians
from pathlib import Path

import numpy as np
import pytest

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Pose
from nnql_bullet.sim.engines import contact_engine
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.vehicle.controller import DriveOptions, own_speed
from nnql_bullet.vehicle.translation import read_robot
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.spec import WorldSpec

OPEN = WorldSpec("open", 0, 200.0, 200.0, (), Pose(100.0, 100.0, 0.0), (190.0, 190.0), 2.0, 1.5)


def link(name: str, mass: float, shape: str, inertia: float = 0.01, at: str = "0 0 0") -> str:
    moments = f'ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"'
    return (
        f'<link name="{name}"><inertial><mass value="{mass}"/><inertia {moments}/></inertial>'
        f'<collision><origin xyz="{at}"/><geometry>{shape}</geometry></collision></link>'
    )


def joint(
    name: str, child: str, at: str, kind: str = "fixed", axis: str = "0 0 1", rpy: str = "0 0 0", on="base"
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{on}"/><child link="{child}"/>'
        f'<origin xyz="{at}" rpy="{rpy}"/><axis xyz="{axis}"/></joint>'
    )


CYLINDER = '<cylinder radius="0.1" length="0.04"/>'
WHEELS = [
    link("left", 0.5, CYLINDER, 0.002),
    link("right", 0.5, CYLINDER, 0.002),
    joint("l", "left", "0.2 0.25 0.1", "continuous", rpy="-1.5708 0 0"),
    joint("r", "right", "0.2 -0.25 0.1", "continuous", "0 0 -1", rpy="-1.5708 0 0"),
]
BASE = link("base", 10.0, '<box size="0.6 0.4 0.2"/>', 0.2, "0 0 0.2")
BALL = [link("ball", 0.1, '<sphere radius="0.05"/>', 1e-4), joint("b", "ball", "-0.2 0 0.05")]


def caster(name: str, x: float, y: float, trail: float = -0.04) -> list[str]:
    wheel = '<cylinder radius="0.05" length="0.02"/>'
    return [
        link(f"{name}_fork", 0.2, '<box size="0.02 0.02 0.02"/>', 1e-4),
        link(f"{name}_wheel", 0.2, wheel, 2e-4),
        joint(f"{name}_swivel", f"{name}_fork", f"{x} {y} 0.1", "continuous"),
        joint(f"{name}_roll", f"{name}_wheel", f"{trail} 0 -0.05", "continuous", rpy="1.5708 0 0", on=f"{name}_fork"),
    ]


KINDS = {
    "ball behind": BALL,
    "swivel behind": caster("c", -0.2, 0.0),
    "swivel behind that points ahead": caster("c", -0.2, 0.0, 0.04),
    "two behind": caster("c", -0.2, 0.15) + caster("d", -0.2, -0.15),
    "two ahead, two behind": caster("c", -0.2, 0.15)
    + caster("d", -0.2, -0.15)
    + caster("e", 0.45, 0.15)
    + caster("f", 0.45, -0.15),
}


def written(tmp_path: Path, parts: list[str], **options: str) -> Path:
    path = tmp_path / "mine.urdf"
    path.write_text(f"<robot name='mine'>{BASE}{''.join(parts)}</robot>", **options)
    return path


@pytest.mark.parametrize("engine", ["bullet", "mujoco"])
@pytest.mark.parametrize("casters", KINDS.values(), ids=KINDS)
def test_a_robot_of_each_kind_drives_like_the_kinematic_model(tmp_path: Path, casters: list[str], engine: str) -> None:
    if engine == "mujoco":
        pytest.importorskip("mujoco")
    toml, _ = read_robot(written(tmp_path, WHEELS + casters)).save(tmp_path / "robot.toml")
    vehicle = load_vehicle(toml)
    assert (vehicle.track, vehicle.wheel_radius) == pytest.approx((0.5, 0.1), abs=1e-6)
    drive = DriveOptions(speed=own_speed(vehicle))
    one, two = contact_engine(engine, "fast", vehicle, drive), KinematicSimulator(vehicle, drive, 1, threads=1)  # type: ignore[arg-type]
    one.reset(OPEN)
    two.reset({0: OPEN})
    length = 0.0
    for turn in (0.0, radians(60), 0.0, 0.0, radians(-30), 0.0, 0.0):
        here, (there, _) = one.advance(turn), two.advance(np.array([turn]))
        length += here.path_length
    x, y, yaw = there.pose[0]
    assert np.hypot(here.pose.x - x, here.pose.y - y) < 0.03 * length
    assert abs(here.pose.yaw - yaw) < radians(3)
    one.close()
    two.close()


def test_masses_and_footprint_are_those_by_hand(tmp_path: Path) -> None:
    found = read_robot(written(tmp_path, WHEELS + BALL))
    vehicle, total = found.vehicle, 11.1
    assert vehicle.mass == pytest.approx(total)
    assert vehicle.com_ahead == pytest.approx((10 * -0.2 + 0.1 * -0.4) / total)
    assert vehicle.com_height == pytest.approx((0.5 * 0.1 * 2 + 0.1 * 0.05) / total)
    assert vehicle.wheelbase == pytest.approx(-0.4)
    box = vehicle.footprint
    assert (box.x, 2 * box.half_length, 2 * box.half_width) == pytest.approx((-0.2, 0.6, 0.54), abs=1e-5)


def test_what_is_written_is_read_as_the_same_vehicle(tmp_path: Path) -> None:
    found = read_robot(written(tmp_path, WHEELS + KINDS["two ahead, two behind"]))
    vehicle = load_vehicle(found.save(tmp_path / "robot.toml")[0])
    for field in ("mass", "com_ahead", "com_height", "yaw_inertia", "track", "rear_share", "wheel_torque"):
        assert getattr(vehicle, field) == pytest.approx(getattr(found.vehicle, field), rel=1e-3), field


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (WHEELS, "no caster: nothing but its two drive wheels"),
        (WHEELS + caster("c", 0.45, 0.0), r"would tip over: its centre of mass is at x = -0\.1\d+"),
        (
            [
                *WHEELS,
                link("front", 0.5, CYLINDER),
                joint("f", "front", "-0.2 0.25 0.1", "continuous", rpy="-1.57 0 0"),
            ],
            r"3 wheels on fixed axles \('l', 'r', 'f'\), which must skid",
        ),
        (
            [*WHEELS[:3], joint("r", "right", "0.1 -0.25 0.1", "continuous", "0 1 0"), *BALL],
            "not on one axle",
        ),
        (WHEELS + caster("c", -0.2, 0.0, -0.3), "not under its swivel 'c_swivel'"),
        ([part.replace("continuous", "fixed") for part in WHEELS] + BALL, "no two wheels on fixed axles"),
    ],
)
def test_what_cannot_be_driven_rightly_is_refused_by_its_reason(tmp_path: Path, parts: list[str], message: str) -> None:
    with pytest.raises(UserError, match=message):
        read_robot(written(tmp_path, parts))


def test_latin_1_is_read(tmp_path: Path) -> None:
    parts = [*WHEELS, *(part.replace("ball", "b\u00e4ll") for part in BALL)]
    assert read_robot(written(tmp_path, parts, encoding="latin-1")).vehicle.casters[0].link == "b\u00e4ll"


def test_a_body_that_does_not_collide_covers_what_is_seen_of_it(tmp_path: Path) -> None:
    path = written(tmp_path, WHEELS + BALL)
    path.write_text(path.read_text().replace(BASE, BASE.replace("collision>", "visual>")))
    found = read_robot(path)
    assert 2 * found.vehicle.footprint.half_length == pytest.approx(0.6)
    assert any("covers what is seen of it" in note for note in found.notes)
