import importlib.util
import re
import sys
import xml.etree.ElementTree as ET
from math import inf

import numpy as np
import pytest
import trimesh

from nnql_bullet import assets
from nnql_bullet.errors import UserError
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.source import WIDTH

ROBOTS = assets.folder("robots")
URDF = (ROBOTS / "tricycle.urdf").read_text(encoding="utf-8")
TOML = (ROBOTS / "tricycle.toml").read_text(encoding="utf-8")
TREE = ET.fromstring(URDF)
LINKS = ("chassis", "left_wheel", "right_wheel", "fork", "caster_wheel")


@pytest.fixture(scope="module")
def script():
    """scripts/make_tricycle.py as a module."""
    path = ROBOTS.parent / "scripts" / "make_tricycle.py"
    spec = importlib.util.spec_from_file_location("make_tricycle", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["make_tricycle"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["make_tricycle"]


def floats(text):
    return np.array([float(part) for part in text.split()])


def mass_of(link):
    return float(TREE.find(f"link[@name='{link}']/inertial/mass").get("value"))


def centre_of(link):
    return floats(TREE.find(f"link[@name='{link}']/inertial/origin").get("xyz"))


def inertia_of(link):
    i = {key: float(value) for key, value in TREE.find(f"link[@name='{link}']/inertial/inertia").attrib.items()}
    return np.array([[i["ixx"], i["ixy"], i["ixz"]], [i["ixy"], i["iyy"], i["iyz"]], [i["ixz"], i["iyz"], i["izz"]]])


def place_of(joint):
    return floats(TREE.find(f"joint[@name='{joint}']/origin").get("xyz"))


def link_places():
    """Where each link's frame lies in the chassis frame: all joints are drawn without rotation."""
    places = {"chassis": np.zeros(3)}
    for joint in TREE.findall("joint"):
        assert joint.find("origin").get("rpy") == "0 0 0"
        places[joint.find("child").get("link")] = places[joint.find("parent").get("link")] + place_of(joint.get("name"))
    return places


@pytest.mark.parametrize("name", ["tricycle", "jackal_tricycle"])
def test_committed_urdf_is_what_the_script_gives(script, name):
    assert script.urdf(name) == (ROBOTS / f"{name}.urdf").read_text(encoding="utf-8")


def test_the_jackal_sized_vehicle_has_the_sizes_of_the_datasheet():
    """Clearpath's Jackal: 508 x 430 mm, 17 kg, 2 m/s. It stands on its wheels, and nothing sticks out of its body."""
    vehicle = load_vehicle("jackal_tricycle")
    assert (vehicle.length, vehicle.width) == pytest.approx((0.508, 0.430))
    assert (vehicle.mass, vehicle.limits.speed) == (pytest.approx(17.0), 2.0)
    (caster,) = vehicle.casters
    reach = caster.x + 2 * caster.trail + caster.radius  # when it trails ahead
    assert reach < vehicle.footprint.x + vehicle.footprint.half_length
    assert 0 < vehicle.com_ahead < caster.x


def test_script_finds_the_committed_file_up_to_date_and_a_changed_one_not(script, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["make_tricycle.py", "--check"])
    assert script.main() == 0
    monkeypatch.setattr(script, "FOLDER", tmp_path)
    for name in script.VEHICLES:
        (tmp_path / f"{name}.urdf").write_text(script.urdf(name).replace("104.5", "104.6"), encoding="utf-8")
    assert script.main() == 1
    monkeypatch.setattr(sys, "argv", ["make_tricycle.py"])
    assert script.main() == 0
    assert (tmp_path / "tricycle.urdf").read_text(encoding="utf-8") == URDF
    out = capsys.readouterr().out
    assert "tricycle.urdf: 120 kg" in out
    assert "jackal_tricycle.urdf: 17 kg" in out


def test_masses_are_those_of_the_table():
    masses = {"chassis": 104.5, "left_wheel": 6, "right_wheel": 6, "fork": 1.5, "caster_wheel": 2}
    assert {link: mass_of(link) for link in LINKS} == masses


def test_vehicle_is_the_one_of_the_table_within_one_percent(vehicle):
    table = {
        "mass": 120.0,
        "com_ahead": 0.125,
        "com_height": 0.206,
        "yaw_inertia": 13.3,
        "track": 0.60,
        "wheelbase": 0.70,
        "wheel_radius": 0.125,
        "wheel_spin_inertia": 0.0469,
        "wheel_torque": 40.0,
    }
    assert {field: getattr(vehicle, field) for field in table} == pytest.approx(table, rel=0.01)
    (caster,) = vehicle.casters
    assert (caster.radius, caster.trail) == pytest.approx((0.05, 0.04))


def test_chassis_inertia_and_centre_of_mass_are_those_of_the_table():
    assert np.diag(inertia_of("chassis")) == pytest.approx([2.77, 9.30, 10.89], rel=0.01)
    assert centre_of("chassis") == pytest.approx([0.12, 0, 0.22 - 0.125], rel=0.01)


def test_static_wheel_loads_are_those_of_the_table(vehicle):
    front = vehicle.mass * 9.81 * vehicle.com_ahead / vehicle.wheelbase
    assert front == pytest.approx(210, rel=0.01)
    assert (vehicle.mass * 9.81 - front) / 2 == pytest.approx(483, rel=0.01)


def test_composite_is_that_of_point_and_parallel_axis_sums(vehicle):
    places = link_places()
    masses = np.array([mass_of(link) for link in LINKS])
    centres = np.array([places[link] + centre_of(link) for link in LINKS])
    centre = masses @ centres / masses.sum()
    yaw = sum(
        inertia_of(link)[2, 2] + mass * np.hypot(*(at - centre)[:2]) ** 2
        for link, mass, at in zip(LINKS, masses, centres, strict=True)
    )
    assert vehicle.mass == pytest.approx(masses.sum())
    assert (vehicle.com_ahead, vehicle.com_height) == pytest.approx((centre[0], centre[2] + 0.125))
    assert vehicle.yaw_inertia == pytest.approx(yaw)


def test_composite_yaw_inertia_is_that_of_the_solids_together(script, vehicle):
    """Trimesh adds up the parts as one body, an oracle that shares no formula with the package."""
    places = link_places()
    scene = trimesh.Scene()
    for link in script.tricycle()[0]:
        mesh = link.solid.mesh()
        mesh.density = link.mass / mesh.volume
        scene.add_geometry(mesh, transform=trimesh.transformations.translation_matrix(places[link.name]))
    assert vehicle.yaw_inertia == pytest.approx(scene.moment_inertia[2, 2], rel=1e-3)


def test_inertia_is_that_of_the_links_solid(script):
    for part in script.tricycle()[0]:
        if part.solid.shape == "box":
            exact = trimesh.primitives.Box(extents=part.solid.size)
        else:
            turned = trimesh.transformations.euler_matrix(*part.solid.rpy)
            radius, width = part.solid.size
            exact = trimesh.creation.cylinder(radius=radius, height=width, sections=2048, transform=turned)
        expected = exact.moment_inertia * mass_of(part.name) / exact.mass
        assert inertia_of(part.name) == pytest.approx(expected, rel=1e-3, abs=1e-6)
        assert centre_of(part.name) == pytest.approx(np.array(part.solid.at))


def test_inertia_of_a_block_is_the_closed_form():
    for link, size in {"chassis": (1.0, 0.5, 0.26), "fork": (0.06, 0.06, 0.08)}.items():
        x, y, z = np.square(size)
        expected = mass_of(link) / 12 * np.array([y + z, x + z, x + y])
        assert np.diag(inertia_of(link)) == pytest.approx(expected, rel=1e-4)


def test_inertia_of_a_wheel_is_that_of_the_tyre_that_is_seen_and_it_touches_the_ground_there():
    for wheel in ("left_wheel", "right_wheel", "caster_wheel"):
        tyre = TREE.find(f"link[@name='{wheel}']/visual/geometry/cylinder")
        r, width, m = float(tyre.get("radius")), float(tyre.get("length")), mass_of(wheel)
        across = m / 12 * (3 * r**2 + width**2)
        assert np.diag(inertia_of(wheel)) == pytest.approx([across, m * r**2 / 2, across], rel=1e-3)
        assert float(TREE.find(f"link[@name='{wheel}']/collision/geometry/sphere").get("radius")) == r
        assert link_places()[wheel][2] - r == pytest.approx(-0.125)


def test_inertia_is_one_that_mass_within_the_seen_link_can_have(script):
    """What lies between `low` and `high` spreads about `c` by at most (high - c)(c - low): Bhatia and Davis, 2000."""
    assert {part.name for part in script.tricycle()[0]} == set(LINKS)
    for part in script.tricycle()[0]:
        low, high = trimesh.util.concatenate([solid.mesh() for solid in part.visuals]).bounds
        principal = np.linalg.eigvalsh(inertia_of(part.name))
        assert principal[0] > 0
        assert principal[0] + principal[1] >= principal[2] * (1 - 1e-6)
        moments, centre = np.diag(inertia_of(part.name)), centre_of(part.name)
        spread = (moments.sum() / 2 - moments) / mass_of(part.name)
        assert np.all(spread > 0)
        assert np.all(spread <= (high - centre) * (centre - low))


def test_footprint_covers_everything_that_is_seen_within_a_centimetre(script, vehicle):
    places = link_places()
    meshes = []
    for link in script.tricycle()[0]:
        for solid in link.visuals:
            meshes.append(solid.mesh().apply_translation(places[link.name]))
    low, high = trimesh.util.concatenate(meshes).bounds
    box = vehicle.footprint
    assert box.x - box.half_length <= low[0] + 0.01
    assert box.x + box.half_length >= high[0] - 0.01
    assert box.half_width >= max(-low[1], high[1]) - 0.01


def test_footprint_covers_the_true_width_of_the_tyres(vehicle):
    width = float(TREE.find("link[@name='left_wheel']/visual/geometry/cylinder").get("length"))
    assert vehicle.footprint.half_width >= vehicle.track / 2 + width / 2 - 1e-9
    assert vehicle.footprint.x - vehicle.footprint.half_length <= -vehicle.wheel_radius
    assert vehicle.footprint.y == 0


def test_footprint_holds_the_caster_however_it_swivels(vehicle):
    (caster,) = vehicle.casters
    reach = caster.trail + caster.radius
    swivel = place_of("swivel")[0]
    assert swivel + reach <= vehicle.footprint.x + vehicle.footprint.half_length
    assert reach <= vehicle.footprint.half_width


def test_width_is_that_of_the_footprint(vehicle):
    assert vehicle.width == pytest.approx(0.65) == WIDTH


def test_sensor_stands_above_the_chassis_at_the_head_of_the_mast(vehicle):
    head = TREE.findall("link[@name='chassis']/visual")[-1]
    assert vehicle.sensor.position == pytest.approx(tuple(floats(head.find("origin").get("xyz"))))


def test_links_are_those_that_the_joints_move(vehicle):
    assert vehicle.links == {
        "left_drive": "left_wheel",
        "right_drive": "right_wheel",
        "swivel": "fork",
        "caster_roll": "caster_wheel",
    }


def test_limits_stay_below_grip(vehicle):
    """PHYSICS section 1: the grip limit of a rear-driven tricycle with a free caster, at friction 0.8."""
    a, wheelbase, track = vehicle.com_ahead, vehicle.wheelbase, vehicle.track
    grip = vehicle.contact.wheel_friction * 9.81 * (1 - a / wheelbase) / np.sqrt(1 + (2 * a / track) ** 2)
    assert grip == pytest.approx(5.95, rel=0.01)
    assert 2.0 * vehicle.limits.yaw_rate < grip


@pytest.fixture
def robot(tmp_path):
    """Writes a robot and gives the path to its TOML."""

    def write(urdf=URDF, toml=TOML):
        (tmp_path / "mine.toml").write_text(toml, encoding="utf-8")
        if urdf is not None:
            (tmp_path / "tricycle.urdf").write_text(urdf, encoding="utf-8")
        return str(tmp_path / "mine.toml")

    return write


def replaced(text, *pairs):
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    return text


def test_copy_of_the_robot_is_read_like_the_shipped_one(robot, vehicle):
    copy = load_vehicle(robot())
    assert copy.name == "mine"
    assert (copy.mass, copy.footprint, copy.limits) == (vehicle.mass, vehicle.footprint, vehicle.limits)


WHEEL_LIMIT = '<limit effort="40" velocity="100" />'
CASTER_INERTIA = 'ixx="0.0014" ixy="0" ixz="0" iyy="0.0025" iyz="0" izz="0.0014"'
SPHERE = '<sphere radius="0.125" />'


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        pytest.param(
            [('<joint name="swivel"', '<joint name="pivot"')],
            r"trails the swivel 'swivel' \(joints\.swivel\); such casters are: 'pivot' with 'caster_roll'$",
            id="missing joint",
        ),
        pytest.param(
            [('<joint name="left_drive" type="continuous">', '<joint name="left_drive" type="fixed">')],
            r"has no joint 'left_drive' that turns freely; its joints are: left_drive, right_drive",
            id="fixed wheel",
        ),
        pytest.param(
            [('<mass value="6" />', '<mass value="-6" />')],
            r"\(1\) link 'left_wheel' has a mass of -6 kg; give it one above 0; \(2\) link 'right_wheel'",
            id="negative mass",
        ),
        pytest.param([('mass value="2"', 'mass value="0"')], r"link 'caster_wheel', .* has no mass", id="zero mass"),
        pytest.param([('mass value="2"', 'mass value="nan"')], r"link 'caster_wheel' has a mass", id="nan mass"),
        pytest.param([('mass value="2"', 'mass value="two"')], r"cannot be read as a URDF", id="mass in words"),
        pytest.param(
            [(CASTER_INERTIA, re.sub(r'"[\d.]+"', '"0"', CASTER_INERTIA))],
            r"link 'caster_wheel' has an inertia that is not positive: its least moment is 0 kg m2",
            id="zero inertia",
        ),
        pytest.param(
            [('ixx="0.0014"', 'ixx="-0.0014"')],
            r"link 'caster_wheel' has an inertia that is not positive",
            id="negative inertia",
        ),
        pytest.param(
            [(WHEEL_LIMIT, "")],
            r"'left_drive' and 'right_drive' have no <limit effort>; give it in N m, or limits\.wheel_torque in",
            id="no effort limit",
        ),
        pytest.param([(WHEEL_LIMIT, '<limit velocity="9" />')], "have no <limit effort>", id="no effort"),
        pytest.param([('effort="40"', 'effort="0"')], "have no <limit effort>", id="zero effort"),
        pytest.param([('effort="40"', 'effort="inf"')], "have no <limit effort>", id="infinite effort"),
        pytest.param([(SPHERE, '<sphere radius="0" />')], r"wheels of radius 0 m stand on", id="tiny sphere"),
        pytest.param([('<child link="fork" />', '<child link="frok" />')], r"cannot be read as a URDF", id="no child"),
        pytest.param([(URDF[len(URDF) // 2 :], "")], r"cannot be read as a URDF", id="cut short"),
    ],
)
def test_urdf_of_no_such_vehicle_is_refused_in_one_line(robot, pairs, message):
    with pytest.raises(UserError, match=message) as refusal:
        load_vehicle(robot(urdf=replaced(URDF, *pairs)))
    assert "tricycle.urdf: " in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_all_that_is_wrong_is_said_at_once(robot):
    pairs = [
        (WHEEL_LIMIT, '<limit velocity="9" />'),
        ('<joint name="swivel"', '<joint name="pivot"'),
        (CASTER_INERTIA, CASTER_INERTIA.replace("0.0025", "-1")),
    ]
    with pytest.raises(UserError) as refusal:
        load_vehicle(robot(urdf=replaced(URDF, *pairs)))
    told = str(refusal.value)
    for message in ("trails the swivel 'swivel'", "<limit effort>", "not positive"):
        assert message in told
    assert "things are wrong: (1) " in told and "\n" not in told


def test_wheels_of_two_sizes_are_refused(robot):
    with pytest.raises(UserError, match="the drive wheels differ in radius"):
        load_vehicle(robot(urdf=URDF.replace(SPHERE, '<sphere radius="0.126" />', 1)))


def test_link_without_inertial_is_refused(robot):
    bare = re.sub(r"<inertial>.*?</inertial>", "", URDF, count=1, flags=re.DOTALL)
    with pytest.raises(UserError, match="link 'chassis' has no mass and inertia; give it an <inertial>"):
        load_vehicle(robot(urdf=bare))


def test_file_that_is_no_urdf_is_refused_in_one_line(robot):
    for text in ("", "hello", "<robot", "<a/>", "<html><body>404</body></html>"):
        with pytest.raises(UserError, match=r"tricycle\.urdf: ") as refusal:
            load_vehicle(robot(urdf=text))
        assert "\n" not in str(refusal.value)


def test_missing_urdf_is_refused(robot):
    with pytest.raises(UserError, match=r"there is no such URDF; put it beside its TOML, or correct 'urdf' there"):
        load_vehicle(robot(urdf=None))


def test_unknown_robot_lists_the_shipped_ones():
    with pytest.raises(UserError, match=r"robots: there is no file 'rover'; .* one of: jackal_tricycle, tricycle$"):
        load_vehicle("rover")


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ([("yaw_rate = 1.5708", "yaw_rate = 0.0")], "'limits.yaw_rate': input should be greater than 0"),
        ([("[limits]", "[limits]\nspead = 3.0")], "unknown key 'limits.spead'"),
        ([('swivel = "swivel"', "")], "is no wheel that trails the swivel '' (joints.swivel)"),
        ([("wheel_friction = 0.8", "wheel_friction = -0.8")], "'contact.wheel_friction': input should be greater"),
        ([("position = [0.35, 0.0, 0.475]", "position = [0.35, 0.0]")], "'sensor.position"),
    ],
)
def test_mistake_in_a_robots_toml_is_named(robot, pairs, message):
    with pytest.raises(UserError) as refusal:
        load_vehicle(robot(toml=replaced(TOML, *pairs)))
    assert message in str(refusal.value)


@pytest.mark.parametrize(
    ("left", "right", "message"),
    [
        ("right_drive", "left_drive", "the left drive wheel is not to the left of the right one"),
        ("left_drive", "left_drive", r"\[joints\] in the TOML names joint 'left_drive' twice"),
    ],
)
def test_drives_on_the_wrong_side_are_refused(robot, left, right, message):
    toml = re.sub(r'left_drive = "\w+"', f'left_drive = "{left}"', TOML)
    toml = re.sub(r'right_drive = "\w+"', f'right_drive = "{right}"', toml)
    with pytest.raises(UserError, match=message):
        load_vehicle(robot(toml=toml))


def test_weaker_drive_limits_the_torque(robot):
    assert load_vehicle(robot(urdf=URDF.replace('effort="40"', 'effort="35"', 1))).wheel_torque == 35
    assert load_vehicle(robot()).wheel_torque < inf
