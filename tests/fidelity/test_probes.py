"""The vehicle in every engine against mechanics on paper, and the probes that do it against numbers typed here."""

import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import replace
from math import asin, atan, atan2, cos, degrees, hypot, log, nan, radians, sin, tan
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import pytest
from scipy.integrate import solve_ivp

from nnql_bullet.errors import UserError
from nnql_bullet.fidelity import probes
from nnql_bullet.fidelity.probe import Bench, Measurement, Probe, at_most, close_to
from nnql_bullet.fidelity.probes import PROBES, run_probes
from nnql_bullet.fidelity.probes_rolling import growth
from nnql_bullet.fidelity.probes_vehicles import turning_within_its_means
from nnql_bullet.sim.bullet import PHYSICS
from nnql_bullet.sim.engines import EngineName
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.urdf import load_vehicle

ROOT = Path(__file__).resolve().parents[2]


def check(bench: Bench, name: str) -> None:
    probe = PROBES[name]
    rows = probe.measure(bench)
    assert rows
    wrong = [
        f"{row.quantity}: measured {row.measured:.8g} {row.unit}, expected {row.expected:.8g}, "
        f"accepted from {row.low:.8g} to {row.high:.8g}"
        for row in rows
        if not row.ok
    ]
    assert not wrong, "\n".join([f"{bench.engine}, {bench.physics}: {probe.title}", *wrong])


@pytest.mark.parametrize("name", PROBES)
@pytest.mark.parametrize("engine", ["bullet", "mujoco"])
def test_an_engine_does_what_mechanics_says(vehicle: VehicleSpec, engine: EngineName, name: str) -> None:
    if engine == "mujoco":
        pytest.importorskip("mujoco", reason="pip install 'nnql-bullet[mujoco]'")
    for physics in PHYSICS:
        check(Bench(vehicle, engine, physics), name)


# Another vehicle


@pytest.fixture(scope="module")
def script() -> Iterator[ModuleType]:
    """scripts/make_tricycle.py as a module."""
    spec = importlib.util.spec_from_file_location("make_another", ROOT / "scripts" / "make_tricycle.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules["make_another"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["make_another"]


@pytest.fixture(scope="module")
def another(script: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> VehicleSpec:
    """A larger, slower vehicle with other tyres and a sensor to the left of its middle."""
    sizes = {"TRACK": 0.8, "WHEELBASE": 1.0, "WHEEL_RADIUS": 0.15, "CASTER_RADIUS": 0.07, "CASTER_TRAIL": 0.06}
    sizes |= {"WHEEL_TORQUE": 150.0, "FOOTPRINT_LENGTH": 1.5, "FOOTPRINT_WIDTH": 0.9}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in sizes.items():
            patch.setattr(script, name, value)
        robot = ElementTree.fromstring(script.urdf())
    for link in robot.iter("link"):
        heavier = 3.0 if link.attrib["name"] == "chassis" else 2.0
        for element in (link.find("inertial/mass"), link.find("inertial/inertia")):
            assert element is not None
            for key, value in element.attrib.items():
                element.set(key, repr(heavier * float(value)))
    toml = (ROOT / "robots" / "tricycle.toml").read_text(encoding="utf-8")
    for old, new in (
        ("yaw_rate = 1.5708", "yaw_rate = 1.2"),
        ("yaw_acceleration = 7.4", "yaw_acceleration = 4.0"),
        ("wheel_friction = 0.8", "wheel_friction = 0.7"),
        ("rolling_friction = 0.002", "rolling_friction = 0.003"),
        ("spinning_friction = 0.005", "spinning_friction = 0.004"),
        ("[0.35, 0.0, 0.475]", "[0.5, 0.1, 0.6]"),
    ):
        assert old in toml
        toml = toml.replace(old, new)
    folder = tmp_path_factory.mktemp("another")
    (folder / "tricycle.urdf").write_text(ElementTree.tostring(robot, encoding="unicode"), encoding="utf-8")
    (folder / "another.toml").write_text(toml, encoding="utf-8")
    return load_vehicle(str(folder / "another.toml"))


@pytest.mark.parametrize("name", PROBES)
def test_closed_forms_follow_the_vehicle(another: VehicleSpec, vehicle: VehicleSpec, name: str) -> None:
    assert another.mass > 2 * vehicle.mass
    assert another.track != vehicle.track
    for physics in PHYSICS:
        check(Bench(another, "bullet", physics), name)


def test_a_vehicle_with_too_little_grip_is_compared_with_a_slower_turn(vehicle: VehicleSpec) -> None:
    assert turning_within_its_means(vehicle, 2.0) == (vehicle, 1.0)
    slippery = replace(vehicle, contact=replace(vehicle.contact, wheel_friction=0.4))
    turning, share = turning_within_its_means(slippery, 2.0)
    assert 0.3 < share < 0.8
    assert turning.limits.yaw_rate == pytest.approx(share * vehicle.limits.yaw_rate)
    check(Bench(slippery), "five-actions")


# What is expected of the shipped vehicle, worked out from its design (mass [kg], lengths [m])

G, V = 9.81, 2.0
MASS, TRACK, WHEELBASE, RADIUS, CASTER_RADIUS, TRAIL = 120.0, 0.60, 0.70, 0.125, 0.05, 0.04
MU, ARM, FORWARD = 0.8, 0.002, 0.9
A = (104.5 * 0.12 + 1.5 * 0.72 + 2.0 * 0.70) / MASS  # centre of mass ahead of the rear axle
H = (104.5 * 0.22 + 2 * 6.0 * 0.125 + 1.5 * 0.07 + 2.0 * 0.05) / MASS  # and above the ground
ROLLING_MASS = MASS + 2 * 0.046874 / RADIUS**2 + 0.0025 / CASTER_RADIUS**2  # wheels spin up too
REAR_SHARE = 1 - A / WHEELBASE
REAR, FRONT = MASS * G * REAR_SHARE, MASS * G * A / WHEELBASE
BRAKING = MU * G * REAR_SHARE / (1 + MU * H / WHEELBASE)  # the caster's spin, 1 kg of 120, left out
TOP_HEAVY = H + 0.36  # 120 kg on the deck

# A steady turn: the centripetal force m v w acts at the centre of mass, m a w^2 towards the rear; the wheels' spin is
# turned; the caster trails towards the centre of the turn.
W = MU * G * REAR_SHARE / hypot(1, 2 * A / TRACK) / 3 / V
PIVOT, TURN_RADIUS = WHEELBASE + TRAIL, V / W
ANGLE = atan2(PIVOT, TURN_RADIUS) - asin(TRAIL / hypot(PIVOT, TURN_RADIUS))
IN_TURN = MASS * A * (G + H * W * W) / (PIVOT - TRAIL * cos(ANGLE))
SHIFT = (MASS * H * V * W + 2 * 0.046874 * V / RADIUS * W - IN_TURN * TRAIL * sin(ANGLE)) / TRACK

EXPECTED = {
    "settle": {
        "height of left wheel": 125.0,
        "height of right wheel": 125.0,
        "height of caster": 50.0,
        "load on left wheel": REAR / 2,
        "load on right wheel": REAR / 2,
        "load on caster": FRONT,
    },
    "free-fall": {"time": 1.0, "speed": 9.81},
    "yaw-inertia": {"yaw rate": 1.0},
    "tilt-table": {
        f"slope to the {side}": degrees(atan(TRACK / 2 * REAR_SHARE / TOP_HEAVY)) for side in ("left", "right")
    },
    "acceleration": {"speed after 1 s": 2 * 20.0 / (RADIUS * ROLLING_MASS)},
    "coast": {"5 s after 2 m/s": V, "5 s after 8 m/s": 4 * V},
    "rolling-resistance": {"speed": V - ARM * REAR / (RADIUS * ROLLING_MASS)},
    "straight": {"distance in 20 s": 40.0, "path length": 40.0},
    "five-actions": {f"turn of {turn} deg": turn for turn in (0, 30, 60, -30, -60)},
    "steady-turn": {
        "speed": V,
        "yaw rate": W,
        "load on inner wheel": (MASS * G - IN_TURN) / 2 - SHIFT,
        "load on outer wheel": (MASS * G - IN_TURN) / 2 + SHIFT,
        "load on caster": IN_TURN,
    },
    "caster": {"from 30 to 1 deg at 0.5 m/s": TRAIL / 0.5 * log(tan(radians(15)) / tan(radians(0.5)))},
    "reversing": {
        "from 30 to 150 deg at -0.5 m/s": TRAIL / 0.5 * log(tan(radians(75)) / tan(radians(15))),
        **{f"turn of {turn} deg backwards": turn for turn in (0, 60, -60)},
    },
    "skids": {
        f"distance {direction}, mu = {mu}": (2 * V) ** 2 / (2 * mu * G)
        for direction in ("ahead", "sideways")
        for mu in (0.8, 0.4)
    },
}


@pytest.mark.parametrize("name", EXPECTED)
def test_what_is_expected_is_what_the_design_says(vehicle: VehicleSpec, name: str) -> None:
    rows = {row.quantity: row for row in PROBES[name].measure(Bench(vehicle))}
    for quantity, expected in EXPECTED[name].items():
        assert rows[quantity].expected == pytest.approx(expected, rel=1e-4)
        assert rows[quantity].low <= expected <= rows[quantity].high


def test_stopping_distance_is_that_of_the_textbook_but_for_the_casters_spin(vehicle: VehicleSpec) -> None:
    distance, _ = PROBES["locked-braking"].measure(Bench(vehicle))
    assert V * V / (2 * BRAKING) < distance.expected < 1.01 * V * V / (2 * BRAKING)


def test_a_coasting_vehicle_turns_away_as_chaplygins_sleigh_does(vehicle: VehicleSpec) -> None:
    a, inertia = -0.1, vehicle.yaw_inertia / vehicle.mass  # m (u' - a w^2) = 0 and (I + m a^2) w' = -m a u w
    tail_heavy = replace(vehicle, com_ahead=a)
    found = solve_ivp(
        lambda _, y: (a * y[1] ** 2, -a * y[0] * y[1] / (inertia + a * a)), (0, 2), (2.0, 1e-6), rtol=1e-9, atol=1e-15
    )
    assert growth(tail_heavy, 2.0) == pytest.approx(log(found.y[1, -1] / 1e-6) / 2, rel=1e-5)
    assert growth(vehicle, 2.0) < 0


def test_read_back_expects_what_the_files_say(vehicle: VehicleSpec) -> None:
    rows = {row.quantity: row.expected for row in PROBES["read-back"].measure(Bench(vehicle))}
    masses = {"chassis": 104.5, "left_wheel": 6.0, "right_wheel": 6.0, "fork": 1.5, "caster_wheel": 2.0}
    assert {name: rows[f"mass of {name}"] for name in masses} == masses
    assert rows["inertia of chassis"] in (2.76577, 9.29702, 10.8854)
    assert rows["inertia of caster_wheel"] in (0.0014, 0.0025)
    assert rows["friction of caster_wheel"] == MU
    assert rows["rolling friction of left_wheel"] == ARM
    assert rows["spinning friction of right_wheel"] == 0.005


def test_an_impulse_is_expected_from_the_whole_mass_and_no_deeper_than_a_step(vehicle: VehicleSpec) -> None:
    impulse, rebound, penetration = PROBES["wall"].measure(Bench(vehicle))
    assert MASS * V <= impulse.expected <= MASS * (V + rebound.measured + 1e-9)
    assert rebound.expected == pytest.approx(0.4)
    assert penetration.expected == pytest.approx(1e3 * V / 240)


# Measurements, and how probes are run


@pytest.mark.parametrize(("measured", "ok"), [(9.9, True), (10.1, True), (9.89, False), (10.11, False), (nan, False)])
def test_a_quantity_may_be_off_to_either_side(measured: float, ok: bool) -> None:
    assert close_to("speed", "m/s", 10.0, measured, relative=0.01).ok is ok
    assert close_to("speed", "m/s", -10.0, -measured, relative=0.01).ok is ok
    assert close_to("speed", "m/s", 10.0, measured, absolute=0.1, relative=1e-6).ok is ok


@pytest.mark.parametrize(("measured", "ok"), [(0.0, True), (2.2, True), (2.21, False), (-0.1, False), (nan, False)])
def test_a_limit_may_be_reached_and_exceeded_by_its_slack(measured: float, ok: bool) -> None:
    assert at_most("depth", "m", 2.0, measured, slack=0.1).ok is ok


def test_every_probe_says_what_it_asks_and_where_the_answer_stands() -> None:
    for name, probe in PROBES.items():
        assert probe.name == name
        assert min(map(len, (probe.title, probe.closed_form, probe.source))) > 5


def fell_over(bench: Bench) -> list[Measurement]:
    raise ZeroDivisionError(f"{bench.vehicle.name} fell over\nand lies there")


def is_missing(bench: Bench) -> list[Measurement]:
    raise UserError(f"{bench.engine} is not installed")


def test_probes_come_as_they_end_and_a_broken_one_is_red(vehicle: VehicleSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    fine = replace(PROBES["free-fall"], name="fine")
    broken = Probe("broken", "It breaks", "1/0", "nowhere", fell_over)
    monkeypatch.setattr(probes, "PROBES", {probe.name: probe for probe in (broken, fine)})
    found = run_probes(Bench(vehicle))
    probe, (row,) = next(found)
    assert probe is broken
    assert not row.ok
    assert row.quantity == "broke off: ZeroDivisionError: tricycle fell over"
    probe, rows = next(found)
    assert probe is fine
    assert rows
    assert all(row.ok for row in rows)
    assert next(found, None) is None


def test_an_engine_that_is_not_there_ends_the_suite(vehicle: VehicleSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probes, "PROBES", {"missing": Probe("missing", "None", "none", "none", is_missing)})
    with pytest.raises(UserError, match="not installed"):
        next(run_probes(Bench(vehicle)))
