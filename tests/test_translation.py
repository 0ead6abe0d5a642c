"""Robots of many kinds are read as they are: geometry by hand, and contact physics against the kinematic model."""

from math import radians
from pathlib import Path

import numpy as np
import pytest

from nnql_bullet.errors import UserError
from nnql_bullet.fidelity.probe import Bench
from nnql_bullet.fidelity.probes import PROBES
from nnql_bullet.fidelity.probes_contact import struck
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


NAMED = [part.replace('"left"', '"left_wheel"').replace('"right"', '"right_wheel"') for part in WHEELS]
STEERED = [
    link("yoke", 0.2, '<box size="0.02 0.02 0.02"/>', 1e-4),
    link("front", 0.5, CYLINDER),
    joint("steer", "yoke", "-0.2 0 0.1", "revolute"),
    joint("front", "front", "0 0 0", "continuous", rpy="1.5708 0 0", on="yoke"),
]
BALLAST = [link("ballast", 10.0, '<box size="0.1 0.1 0.1"/>', 0.05), joint("w", "ballast", "0.4 0 0.2")]
FRONT = [link("front_ball", 0.1, '<sphere radius="0.05"/>', 1e-4), joint("a", "front_ball", "0.4 0 0.05")]
BACK = [link("back_ball", 0.1, '<sphere radius="0.05"/>', 1e-4), joint("b", "back_ball", "0 0 0.05")]
KINDS = {
    "ball ahead, ball behind, weight on the axle": BALLAST + FRONT + BACK,
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


def test_drive_wheels_that_spin_too_easily_get_the_inertia_of_a_motor(tmp_path: Path) -> None:
    placeholders = [part.replace("0.002", "1e-06") for part in WHEELS]
    found = read_robot(written(tmp_path, placeholders + BALL))
    assert found.vehicle.wheel_spin_inertia == pytest.approx(0.015 * 11.1 * 0.1**2)
    assert "1e-06 kg m2, is that of no wheel with a motor; 0.00167 is taken" in found.table()
    again = load_vehicle(found.save(tmp_path / "robot.toml")[0])
    assert again.wheel_spin_inertia == pytest.approx(found.vehicle.wheel_spin_inertia)
    assert read_robot(written(tmp_path, WHEELS + BALL)).vehicle.wheel_spin_inertia == pytest.approx(0.002)


def test_a_robot_whose_weight_is_on_a_ball_is_told_that_it_slips_in_turns(tmp_path: Path) -> None:
    heavy = [link("ballast", 40.0, '<box size="0.1 0.1 0.1"/>', 0.05), joint("w", "ballast", "-0.19 0 0.2")]
    found = read_robot(written(tmp_path, WHEELS + BALL + heavy)).table()
    behind = (10 * 0.2 + 0.1 * 0.4 + 40 * 0.39) / 51.1  # the centre of mass, of 0.4 m to the ball
    share = 1 - behind / 0.4
    held, slides = 0.8 * share * 51.1 * 9.81 / 2 * 0.5, 0.1 * (1 - share) * 51.1 * 9.81 * 0.4
    assert f"carry {100 * share:.0f} % of the weight and hold {held:.3g} N m" in found
    assert f"casters that slide take {slides:.3g};" in found
    assert "slip in turns" not in read_robot(written(tmp_path, WHEELS + BALL)).table()


@pytest.mark.parametrize("engine", ["bullet", "mujoco"])
def test_a_wall_that_strikes_below_or_above_the_centre_of_mass_takes_its_momentum(tmp_path: Path, engine: str) -> None:
    if engine == "mujoco":
        pytest.importorskip("mujoco")
    vehicle = read_robot(written(tmp_path, WHEELS + BALL)).vehicle
    assert struck(vehicle) == pytest.approx((0.1, 0.0, 0.0), abs=1e-5)  # the lower edge, over the centre of mass
    assert all(row.ok for row in PROBES["wall"].measure(Bench(vehicle, engine, "fast")))  # type: ignore[arg-type]


def test_what_is_written_is_read_as_the_same_vehicle(tmp_path: Path) -> None:
    found = read_robot(written(tmp_path, WHEELS + KINDS["two ahead, two behind"]))
    vehicle = load_vehicle(found.save(tmp_path / "robot.toml")[0])
    for field in ("mass", "com_ahead", "com_height", "yaw_inertia", "track", "rear_share", "wheel_torque"):
        assert getattr(vehicle, field) == pytest.approx(getattr(found.vehicle, field), rel=1e-3), field


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (WHEELS, "no caster, and would fall over: only its drive wheels touch the ground$"),
        (
            [*WHEELS, BALL[0], joint("b", "ball", "-0.2 0 0.12")],
            r"only its drive wheels touch the ground; 'ball' ends 0\.07 m above the ground$",
        ),
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
        (
            [part.replace("continuous", "fixed") for part in NAMED] + BALL,
            r"but: 'l', which is fixed, 'r', which is fixed;",
        ),
        (
            [part.replace("continuous", "revolute") for part in NAMED] + BALL,
            r"but: 'l', which is revolute within limits, 'r', which is revolute within limits;",
        ),
        (
            [part.replace("-1.5708", "-1.4") for part in WHEELS] + BALL,
            r"but: 'l', whose axis is 10 degrees off the level",
        ),
        ([*WHEELS, *STEERED], r"mine\.urdf: wheel joint 'front' is steered by 'steer', which turns within limits"),
    ],
)
def test_what_cannot_be_driven_rightly_is_refused_by_its_reason(tmp_path: Path, parts: list[str], message: str) -> None:
    with pytest.raises(UserError, match=message):
        read_robot(written(tmp_path, parts))


def test_all_that_is_wrong_is_in_one_list(tmp_path: Path) -> None:
    light = WHEELS[0].replace('mass value="0.5"', 'mass value="0"')
    small = WHEELS[1].replace('radius="0.1"', 'radius="0.09"')
    false = link("mast", 3.0, '<box size="0.1 0.1 0.1"/>', -1.0)
    parts = [light, small, *WHEELS[2:], false, joint("m", "mast", "0 0 0.3"), *caster("c", -0.2, 0.0, -0.3)]
    with pytest.raises(UserError) as told:
        read_robot(written(tmp_path, parts))
    text = str(told.value)
    assert "4 things are wrong: (1) link 'mast' has an inertia that is not positive" in text
    assert "(2) the drive wheels differ in radius: 0.1 and 0.09 m; (3) link 'left', which joint 'l' moves" in text
    assert "(4) the caster wheel of joint 'c_roll' is not under its swivel 'c_swivel'" in text


def as_seen(part: str) -> str:
    return part.replace("collision>", "visual>")


def test_where_nothing_collides_wheels_casters_and_body_are_what_is_seen(tmp_path: Path) -> None:
    path = tmp_path / "seen.urdf"
    seen = [as_seen(part) for part in (BASE, *WHEELS, BALL[0].replace("ball", "caster"))]
    path.write_text(f"<robot name='m'>{''.join(seen)}{joint('b', 'caster', '-0.2 0 0.05')}</robot>")
    vehicle = read_robot(path).vehicle
    assert [(its.x, its.radius) for its in vehicle.casters] == [(pytest.approx(-0.4), 0.05)]
    assert (vehicle.wheel_radius, vehicle.length) == pytest.approx((0.1, 0.6), abs=1e-5)


def test_a_capsule_is_a_cylinder_with_round_ends(tmp_path: Path) -> None:
    path = written(tmp_path, WHEELS + BALL)
    path.write_text(path.read_text().replace('<box size="0.6 0.4 0.2"/>', '<capsule radius="0.3" length="0.1"/>'))
    found = read_robot(path)
    assert (found.vehicle.length, found.vehicle.width) == pytest.approx((0.6, 0.6), abs=1e-6)
    assert 2 * found.mechanism.box[1][2] == pytest.approx(0.7)


def test_latin_1_is_read(tmp_path: Path) -> None:
    parts = [*WHEELS, *(part.replace("ball", "b\u00e4ll") for part in BALL)]
    assert read_robot(written(tmp_path, parts, encoding="latin-1")).vehicle.casters[0].link == "b\u00e4ll"


def test_a_body_that_does_not_collide_covers_what_is_seen_of_it(tmp_path: Path) -> None:
    path = written(tmp_path, WHEELS + BALL)
    path.write_text(path.read_text().replace(BASE, BASE.replace("collision>", "visual>")))
    found = read_robot(path)
    assert 2 * found.vehicle.footprint.half_length == pytest.approx(0.6)
    assert any("covers what is seen of it" in note for note in found.notes)
