"""What a vehicle can follow and how it stops: watched truly, judged rightly, reported as measured."""

import csv
import io
import json
import pickle
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import dropwhile, takewhile
from math import degrees, hypot, radians
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from nnql_bullet.errors import UserError
from nnql_bullet.executors import make_executor
from nnql_bullet.fidelity import envelope, stopping
from nnql_bullet.fidelity.envelope import (
    Case,
    EnvelopeTask,
    Followed,
    Result,
    Slice,
    base_case,
    envelope_slices,
    envelope_tasks,
    measure_turn,
    on_paper,
    vehicle_for,
    worst_of,
)
from nnql_bullet.fidelity.probe import Bench, open_ground
from nnql_bullet.fidelity.stopping import (
    REACTION,
    Stop,
    StopConditions,
    StopTask,
    measure_stop,
    safe_speeds,
    sight,
    stopping_tasks,
)
from nnql_bullet.fidelity.turning import Instant, follow_turn, forces_by_command, largest_slip
from nnql_bullet.geometry import Pose
from nnql_bullet.locks import locked
from nnql_bullet.provenance import made_by
from nnql_bullet.reports import envelope as reports
from nnql_bullet.reports.envelope import draw_envelope, envelope_csv, envelope_markdown, envelope_values
from nnql_bullet.reports.stopping import draw_stopping, stopping_csv, stopping_markdown, stopping_values
from nnql_bullet.reports.tables import NOT_A_CERTIFICATE
from nnql_bullet.sim.base import Sample
from nnql_bullet.sim.bullet import BulletEngine
from nnql_bullet.sim.physics import ContactForce
from nnql_bullet.vehicle.limits import TurnDemand
from nnql_bullet.vehicle.spec import Payload, VehicleSpec

G, MASS, RADIUS = 9.81, 120.0, 0.125

Make = Callable[..., BulletEngine]


@pytest.fixture(scope="module")
def bench(vehicle: VehicleSpec) -> Bench:
    return Bench(vehicle)


def measured(bench: Bench, **changes: float) -> Result:
    return measure_turn(EnvelopeTask(bench, replace(base_case(bench.vehicle), **changes), 0))


# Watching a turn


@pytest.mark.parametrize("period", [0.5, 1.0])
@pytest.mark.parametrize("turn", [0.0, 60.0, -30.0])
def test_watching_a_turn_changes_no_bit_of_it(engine_of: Make, physics: str, turn: float, period: float) -> None:
    start = Pose(100.0, 100.0, 0.26)
    advanced, watched = (engine_of(physics, decision_period=period) for _ in range(2))
    trace: list[Sample] = []
    advanced.reset(open_ground(start=start))
    motion = advanced.advance(radians(turn), trace)
    watched.reset(open_ground(start=start))
    instants = list(follow_turn(watched, radians(turn)))
    assert instants[-1].pose == motion.pose
    assert watched.wheel_speeds() == advanced.wheel_speeds()
    poses = {round(instant.time, 9): instant.pose for instant in instants}
    assert [poses[round(sample.time, 9)] for sample in trace] == [sample.pose for sample in trace]
    assert instants[-1].time == pytest.approx(period)
    assert len(instants) == round(period / watched.time_step)


def test_a_second_turn_is_watched_as_it_is_driven(engine_of: Make) -> None:
    advanced, watched = (engine_of("reference", decision_period=1.0) for _ in range(2))
    for simulator in (advanced, watched):
        simulator.reset(open_ground())
    for turn in (60.0, -60.0):
        motion = advanced.advance(radians(turn))
        *_, last = follow_turn(watched, radians(turn))
        assert last.pose == motion.pose
        assert last.time == pytest.approx(1.0)


@pytest.mark.parametrize(("ahead", "aside"), [(2.0, 0.3), (1.5, 0.0), (1.7, -0.4)])
def test_slip_is_the_speed_of_the_contact_points(engine_of: Make, ahead: float, aside: float) -> None:
    """In the air nothing disturbs a vehicle whose wheels turn for 2 m/s and which is sent along otherwise."""
    simulator = engine_of("reference", decision_period=0.5)
    simulator.place(open_ground(), Pose(100.0, 100.0, 0.0), 2.0, height=50.0, ground=False)
    simulator.set_velocity(ahead, aside)
    instants = list(follow_turn(simulator, 0.0))[:20]
    for instant in instants:
        assert instant.slips == pytest.approx([hypot(2.0 - ahead, aside)] * 2, abs=1e-3)
        assert [force.normal for force in instant.forces] == [0.0, 0.0, 0.0]
    assert largest_slip(instants, 2.0) == pytest.approx(hypot(2.0 - ahead, aside) / 2.0, abs=1e-3)


def test_wheels_on_the_ground_carry_the_weight_and_hold_the_turn(engine_of: Make, vehicle: VehicleSpec) -> None:
    simulator = engine_of("reference", decision_period=1.0)
    simulator.reset(open_ground())
    forces = forces_by_command(list(follow_turn(simulator, radians(60.0))))
    assert forces.times == pytest.approx(np.arange(1, 121) / 120)
    assert forces.normal[5:].sum(axis=1) == pytest.approx(MASS * G, rel=0.02)
    # Halfway it turns steadily: the outer (right) wheel carries more, and the axle holds m v w sideways at least.
    middle = slice(50, 60)
    assert np.all(forces.normal[middle, 1] > forces.normal[middle, 0] + 150.0)
    held = forces.friction[middle, :2].sum(axis=1)
    assert np.all(held > MASS * 2.0 * vehicle.limits.yaw_rate * 0.97)
    used = held / (0.8 * forces.normal[middle, :2].sum(axis=1))
    assert forces.used_by_axle(vehicle)[middle] == pytest.approx(used)


def made_up_instant(time: float, left: tuple[float, float], right: tuple[float, float]) -> Instant:
    caster = ContactForce(200.0, 3.0)
    return Instant(time, Pose(0.0, 0.0, 0.0), 0.0, (ContactForce(*left), ContactForce(*right), caster), (0.0, 0.0))


@pytest.mark.parametrize("commands", [1, 4])
def test_forces_are_means_over_commands(vehicle: VehicleSpec, commands: int) -> None:
    step, steps = 1 / 240, 2 * commands
    first = [((400.0, 300.0), (600.0, 0.0))] * commands + [((200.0, 60.0), (600.0, 120.0))] * commands
    second = [((20.0, 12.0), (900.0, 720.0))]  # cut short
    instants = [made_up_instant(step * (k + 1), *wheels) for k, wheels in enumerate(first + second)]
    forces = forces_by_command(instants, commands)
    assert forces.times == pytest.approx([steps * step, (steps + 1) * step])
    assert forces.normal == pytest.approx(np.array([[300.0, 600.0, 200.0], [20.0, 900.0, 200.0]]))
    assert forces.friction == pytest.approx(np.array([[180.0, 60.0, 3.0], [12.0, 720.0, 3.0]]))
    # 20 N is less than 5 % of the 483 N that the wheel carries at rest.
    assert forces.used(vehicle) == pytest.approx(np.array([[0.75, 0.125], [0.0, 1.0]]))
    assert forces.used_by_axle(vehicle) == pytest.approx([240.0 / (0.8 * 900.0), 732.0 / (0.8 * 920.0)])


# Cases


def test_turn_of_a_case_lasts_its_period_and_ramps_for_a_third(vehicle: VehicleSpec) -> None:
    case = Case(speed=2.0, period=1.2, heading_change=radians(60), friction=0.5, payload=40.0)
    made = vehicle_for(vehicle, case)
    assert made.limits.yaw_rate / made.limits.yaw_acceleration == pytest.approx(0.4)
    assert made.limits.yaw_rate * 0.8 == pytest.approx(radians(60))  # the trapezoid's area
    assert (made.mass, made.contact.wheel_friction) == (160.0, 0.5)
    assert made.contact.rolling_friction == vehicle.contact.rolling_friction


def test_every_case_is_measured_once(bench: Bench) -> None:
    slices = envelope_slices(bench.vehicle)
    tasks = envelope_tasks(bench, slices)
    wanted = {
        replace(part.base, period=period, **{part.quantity: value})
        for part in slices
        for value in part.values
        for period in part.periods
    }
    assert [part.quantity for part in slices] == ["speed", "heading_change", "friction", "payload"]
    assert {task.case for task in tasks} == wanted
    assert len(tasks) == len(wanted)
    assert [task.seed for task in tasks] == list(range(len(tasks)))
    assert base_case(bench.vehicle) in wanted
    for part in slices:
        assert getattr(part.base, part.quantity) in part.values


def test_an_odd_friction_of_the_vehicle_is_among_those_measured(vehicle: VehicleSpec) -> None:
    odd = replace(vehicle, contact=replace(vehicle.contact, wheel_friction=0.73))
    friction = next(part for part in envelope_slices(odd) if part.quantity == "friction")
    assert 0.73 in friction.values
    assert list(friction.values) == sorted(friction.values)
    assert {task.conditions.friction for task in stopping_tasks(Bench(odd))} == {0.4, 0.6, 0.73, 0.8}


def test_tasks_run_on_an_executor_and_survive_pickling(bench: Bench) -> None:
    turn = envelope_tasks(bench, envelope_slices(bench.vehicle))[9]
    stop = stopping_tasks(bench)[0]
    assert pickle.loads(pickle.dumps((turn, measure_turn))) == (turn, measure_turn)
    assert pickle.loads(pickle.dumps((stop, measure_stop))) == (stop, measure_stop)
    (turned,) = make_executor("inline", 1).map(measure_turn, [turn])
    (stopped,) = make_executor("inline", 1).map(measure_stop, [stop])
    assert turned.error is stopped.error is None
    assert turned.value is not None and turned.value.case == turn.case
    assert pickle.loads(pickle.dumps(turned.value)) == turned.value
    assert stopped.value is not None and stopped.value.speed == stop.speed


def test_ample_time_is_followed_as_on_paper(bench: Bench) -> None:
    result = measured(bench, period=1.2)
    turn, asked = result.measured, result.on_paper
    assert turn.follows and result.allowed
    assert abs(degrees(turn.heading_error)) < 0.05
    assert turn.slip < 0.02
    assert turn.least_load == pytest.approx(asked.least_load, abs=0.03)
    assert turn.friction_used == pytest.approx(asked.friction / 0.8, rel=0.15)
    assert turn.friction_used <= turn.wheel_friction_used <= 1.0 + 1e-9
    # The load transfer ratio of a rigid body is its lateral acceleration over the one that lifts a wheel.
    peak = radians(60) / (2 / 3 * 1.2)
    lateral = 2.0 * peak + 0.1252 * peak / 0.4
    assert turn.tip_margin == pytest.approx(1 - lateral / (9.81 * 0.3 * (1 - 0.1252 / 0.70) / 0.2058), abs=0.03)
    assert degrees(turn.roll) < 0.05


def test_too_little_time_on_too_slippery_ground_is_not_followed(bench: Bench) -> None:
    result = measured(bench, period=0.8, friction=0.5)
    assert not result.measured.follows and not result.allowed
    assert result.measured.slip > 0.05
    assert result.measured.friction_used == pytest.approx(1.0, abs=1e-3)
    assert result.on_paper.friction > 0.5


def test_a_right_turn_is_judged_like_a_left_one(bench: Bench) -> None:
    result = measured(bench, heading_change=radians(-60))
    assert result.measured.follows
    assert result.on_paper == on_paper(bench.vehicle, base_case(bench.vehicle))
    lost = measured(bench, heading_change=radians(-60), payload=80.0)
    assert lost.measured.heading_error < -radians(1.0)
    assert not lost.measured.follows


@pytest.mark.parametrize(
    ("quantity", "values"),
    [
        ("period", (1.2, 0.9, 0.7)),
        ("speed", (1.0, 2.5, 4.0)),
        ("friction", (0.8, 0.6, 0.4)),
        ("payload", (0.0, 40.0, 80.0)),
        ("heading_change", (radians(30), radians(75), radians(110))),
    ],
)
def test_the_harder_the_more_slip(bench: Bench, quantity: str, values: tuple[float, ...]) -> None:
    slips = [measured(bench, **{"period": 0.9, quantity: value}).measured.slip for value in values]
    assert slips == sorted(slips)
    assert slips[0] < 0.03
    assert slips[-1] > 2 * slips[0]


def test_a_high_load_on_ground_that_grips_falls_over(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(envelope, "deck_load", lambda vehicle, mass: Payload(mass, vehicle.footprint.x, 2.0))
    strong = replace(bench, vehicle=replace(bench.vehicle, wheel_torque=400.0))
    result = measured(strong, speed=4.0, heading_change=radians(150), friction=2.0, payload=40.0)
    assert result.measured.fell_over and not result.measured.follows
    assert result.measured.least_load == 0.0
    assert result.on_paper.least_load < 0 and not result.allowed


def followed(**changes: float | bool) -> Followed:
    values = {"heading_error": 0.0, "slip": 0.01, "least_load": 0.7, "tip_margin": 0.6, "friction_used": 0.8}
    return Followed(**{**values, "wheel_friction_used": 0.9, "roll": 0.0, "fell_over": False, **changes})  # type: ignore[arg-type]


def test_the_worst_heading_counts() -> None:
    good, bad = (
        followed(),
        followed(heading_error=radians(-2), slip=0.2, least_load=0.4, tip_margin=0.3, fell_over=True),
    )
    mixed = followed(heading_error=radians(1), friction_used=1.0, wheel_friction_used=1.0, roll=0.1)
    worst = worst_of([good, mixed, bad])
    assert worst == followed(
        heading_error=radians(-2), slip=0.2, least_load=0.4, tip_margin=0.3, friction_used=1.0,
        wheel_friction_used=1.0, roll=0.1, fell_over=True,
    )  # fmt: skip
    assert worst_of([bad, mixed, good]) == worst


def test_a_turn_is_as_bad_as_from_its_worst_heading(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    together = measured(bench, period=0.9).measured
    alone = []
    for heading in envelope.HEADINGS:
        monkeypatch.setattr(envelope, "HEADINGS", (heading,))
        alone.append(measured(bench, period=0.9).measured)
    assert together == worst_of(alone)
    assert len({turn.slip for turn in alone}) == 3


@pytest.mark.parametrize(
    ("changes", "follows"),
    [
        ({}, True),
        ({"heading_error": radians(-0.99)}, True),
        ({"heading_error": radians(-1.01)}, False),
        ({"slip": 0.051}, False),
        ({"least_load": 0.0}, False),
        ({"fell_over": True}, False),
    ],
)
def test_following_means_on_course_without_sliding_on_all_wheels(changes: dict[str, float], follows: bool) -> None:
    assert followed(**changes).follows is follows


@pytest.mark.parametrize(
    ("friction", "torque", "least_load", "allowed"),
    [(0.79, 39.0, 0.01, True), (0.81, 39.0, 0.5, False), (0.5, 41.0, 0.5, False), (0.5, 39.0, -0.01, False)],
)
def test_paper_allows_what_needs_no_more_than_there_is(
    vehicle: VehicleSpec, friction: float, torque: float, least_load: float, allowed: bool
) -> None:
    asked = TurnDemand(friction, torque, least_load, lateral=3.0)
    assert Result(base_case(vehicle), followed(), asked, torque_limit=40.0).allowed is allowed


# Stopping


@pytest.mark.parametrize("speed", [2.0, 8.0])
@pytest.mark.parametrize("friction", [0.4, 0.6])
def test_a_grip_limited_stop_takes_v2_over_2d(bench: Bench, speed: float, friction: float) -> None:
    stop = measure_stop(StopTask(bench, StopConditions(0.0, friction), speed, 0))
    deceleration = friction * G * (1 - 0.1252 / 0.70) / (1 + friction * 0.2058 / 0.70)
    assert stop.distance == pytest.approx(speed**2 / (2 * deceleration), rel=0.02)
    assert stop.distance_on_paper == pytest.approx(speed**2 / (2 * deceleration), rel=1e-3)
    assert stop.friction_used == pytest.approx(1.0, abs=1e-3)
    assert abs(degrees(stop.heading_drift)) < 0.1


def test_a_torque_limited_stop_keeps_below_grip(bench: Bench) -> None:
    stop = measure_stop(StopTask(bench, StopConditions(80.0, 0.8), 4.0, 0))
    force = 2 * 40.0 / RADIUS
    rolling = 200.0 + 2 * 0.046874 / RADIUS**2 + 0.0025 / 0.05**2
    assert stop.distance == pytest.approx(16.0 / (2 * force / rolling), rel=0.035)  # rolling resistance helps by 3 %
    assert stop.distance < stop.distance_on_paper
    assert stop.friction_used < 0.9
    assert stop.least_load == pytest.approx(stop.least_load_on_paper, abs=0.03)


def test_more_load_or_speed_takes_a_longer_way(bench: Bench) -> None:
    def way(payload: float, speed: float) -> float:
        return measure_stop(StopTask(bench, StopConditions(payload, 0.8), speed, 0)).distance

    assert way(0.0, 2.0) < way(40.0, 2.0) < way(80.0, 2.0) < way(80.0, 3.0)


def test_a_vehicle_that_does_not_stop_is_an_error(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stopping, "TIME_LIMIT_FACTOR", 0.01)
    with pytest.raises(UserError, match=r"does not stop from 4 m/s on friction 0\.4"):
        measure_stop(StopTask(bench, StopConditions(0.0, 0.4), 4.0, 0))


def made_up_stop(conditions: StopConditions, speed: float, deceleration: float) -> Stop:
    way = speed**2 / (2 * deceleration)
    return Stop(conditions, speed, way, 1.05 * way, radians(0.01), 0.98, 0.8, 0.82)


def test_sight_ends_short_of_the_range_by_what_juts_out_ahead(vehicle: VehicleSpec) -> None:
    assert sight(vehicle) == pytest.approx(10.0 - (0.9 - 0.35))


def test_largest_safe_speed_solves_the_quadratic_of_constant_braking(vehicle: VehicleSpec) -> None:
    slow, quick = StopConditions(80.0, 0.4), StopConditions(0.0, 0.8)
    stops = [made_up_stop(slow, speed, 2.0) for speed in (9.0, 3.0, 6.0)]  # in any order
    stops += [made_up_stop(quick, speed, 5.0) for speed in (2.0, 4.0)]
    first, second = safe_speeds(vehicle, stops)
    # v t + v^2/(2 d) = s
    root = -2.0 * REACTION + np.sqrt((2.0 * REACTION) ** 2 + 2 * 2.0 * 9.45)
    assert (first.conditions, first.measured) == (slow, pytest.approx(root, abs=1e-4))
    assert (second.conditions, second.measured) == (quick, None)
    paper = second.braking.deceleration
    assert second.on_paper * REACTION + second.on_paper**2 / (2 * paper) == pytest.approx(9.45)


# Reports


@pytest.fixture(scope="module")
def small_slices(vehicle: VehicleSpec) -> tuple[Slice, ...]:
    base = base_case(vehicle)
    return (
        Slice("friction", (0.3, 0.8), (0.8, 1.0, 1.2), base),
        Slice("heading_change", (radians(30), radians(60), radians(120)), (0.8, 1.0, 1.2), base),
    )


@pytest.fixture(scope="module")
def results(vehicle: VehicleSpec, bench: Bench, small_slices: tuple[Slice, ...]) -> list[Result]:
    """Made up: the paper's numbers, and a turn that is followed where the paper allows it, or in 1.2 s."""
    made = []
    for task in envelope_tasks(bench, small_slices):
        asked, case = on_paper(vehicle, task.case), task.case
        slip = 0.0123 if case.period > 1.1 or (asked.friction < case.friction and asked.torque < 40.0) else 0.1234
        turn = followed(slip=slip, heading_error=radians(0.25), least_load=max(asked.least_load, 0.01))
        made.append(Result(case, turn, asked, 40.0))
    return made


@pytest.fixture(scope="module")
def stops() -> list[Stop]:
    conditions = [StopConditions(payload, friction) for friction in (0.4, 0.8) for payload in (0.0, 80.0)]
    return [
        made_up_stop(each, speed, 5.0 * each.friction) for each in conditions for speed in (1.0, 4.0, 7.0, 10.0, 13.0)
    ]


def rows_of(markdown: str, heading: str) -> list[dict[str, str]]:
    """The first table after a line that begins like this."""
    lines = markdown[markdown.index(heading) :].splitlines()
    table = dropwhile(lambda line: not line.startswith("|"), lines)
    cells = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in takewhile(lambda line: line.startswith("|"), table)
    ]
    return [dict(zip(cells[0], row, strict=True)) for row in cells[2:]]


def test_csv_holds_every_number_in_full(results: list[Result], stops: list[Stop]) -> None:
    turned = list(csv.DictReader(io.StringIO(envelope_csv(results))))
    stopped = list(csv.DictReader(io.StringIO(stopping_csv(stops))))
    assert (len(turned), len(stopped)) == (len(results), len(stops))
    for row, result in zip(turned, results, strict=True):
        assert float(row["slip"]) == result.measured.slip
        assert float(row["friction"]) == result.case.friction
        assert float(row["torque_on_paper_n_m"]) == result.on_paper.torque
        assert radians(float(row["heading_change_deg"])) == pytest.approx(result.case.heading_change)
        assert row["follows"] == str(result.measured.follows)
    for line, stop in zip(stopped, stops, strict=True):
        assert float(line["distance_m"]) == stop.distance
        assert float(line["payload_kg"]) == stop.conditions.payload


def test_tables_of_turns_say_what_was_measured(
    bench: Bench, small_slices: tuple[Slice, ...], results: list[Result]
) -> None:
    text = envelope_markdown(bench, small_slices, results)
    assert NOT_A_CERTIFICATE in text and "ISO 3691-4" in text
    rows = rows_of(text, "### Friction")
    found = {result.case: result for result in results}
    assert len(rows) == 6
    for row in rows:
        result = found[small_slices[0].case(float(row["friction coefficient"]), float(row["period [s]"]))]
        assert float(row["slip [%]"]) == pytest.approx(100 * result.measured.slip)
        assert float(row["heading error [°]"]) == pytest.approx(0.25)
        assert float(row["friction asked, paper [%]"]) == pytest.approx(
            100 * result.on_paper.friction / result.case.friction, abs=0.51
        )
        assert float(row["torque asked, paper [%]"]) == pytest.approx(result.on_paper.torque / 0.4, abs=0.51)
        assert row["follows"] == ("yes" if result.measured.follows else "no")


def test_shortest_period_is_the_one_from_which_on_all_are_followed(
    bench: Bench, small_slices: tuple[Slice, ...], results: list[Result]
) -> None:
    text = envelope_markdown(bench, small_slices, results)
    measured, paper = rows_of(text, "| friction coefficient | 0.3")
    assert measured == {"friction coefficient": "shortest period followed [s]", "0.3": "1.2", "0.8": "1"}
    assert paper == {"friction coefficient": "on paper [s]", "0.3": "over 1.2", "0.8": "1"}
    # Of what is followed, 1.2 s at friction 0.3 and 120 degrees in 1.2 s are beyond what paper allows.
    yes, no = rows_of(text, "## Measured against paper")
    followed_too = sum(result.measured.follows and not result.allowed for result in results)
    assert yes["not allowed on paper"] == str(followed_too) == "2"
    assert no["allowed on paper"] == "0"


def test_tables_of_stops_say_what_was_measured(bench: Bench, stops: list[Stop]) -> None:
    text = stopping_markdown(bench, stops)
    assert NOT_A_CERTIFICATE in text
    rows = rows_of(text, "## Every stop")
    assert len(rows) == len(stops)
    for row, stop in zip(rows, stops, strict=True):
        assert float(row["distance [m]"]) == pytest.approx(stop.distance, abs=5.1e-4)
        assert float(row["difference [%]"]) == pytest.approx(-4.8)
    safe = {(row["friction"], row["payload [kg]"]): row for row in rows_of(text, "## Largest safe speed")}
    for each in safe_speeds(bench.vehicle, stops):
        row = safe[f"{each.conditions.friction:g}", f"{each.conditions.payload:g}"]
        assert float(row["measured [m/s]"]) == pytest.approx(each.measured, abs=5.1e-3)
        assert float(row["largest safe speed, paper [m/s]"]) == pytest.approx(each.on_paper, abs=5.1e-3)


def test_everything_goes_through_json(bench: Bench, results: list[Result], stops: list[Stop]) -> None:
    turned = json.loads(json.dumps(envelope_values(bench, results), allow_nan=False))
    stopped = json.loads(json.dumps(stopping_values(bench, stops), allow_nan=False))
    assert turned["made_by"] == stopped["made_by"] == made_by()
    for read in (turned, stopped):
        assert (read["vehicle"], read["engine"], read["note"]) == ("tricycle", "bullet", NOT_A_CERTIFICATE)
    assert [case["slip"] for case in turned["cases"]] == [result.measured.slip for result in results]
    assert [stop["distance_m"] for stop in stopped["stops"]] == [stop.distance for stop in stops]
    assert len(stopped["largest_safe_speeds"]) == 4


def test_pictures_are_drawn(
    bench: Bench,
    small_slices: tuple[Slice, ...],
    results: list[Result],
    stops: list[Stop],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(reports, "PAPER_GRID", 8)
    draw_envelope(bench, small_slices, results, tmp_path / "envelope.png")
    draw_stopping(bench, stops, tmp_path / "stopping.png")
    assert {path.name for path in tmp_path.iterdir()} == {"envelope.png", "stopping.png"}
    for path in tmp_path.iterdir():
        picture = imread(path)
        assert picture.shape[1] > 1000
        assert np.ptp(picture[..., :3]) == 1.0


# The command


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two turns and two stops."""
    from nnql_bullet.api import fidelity as command

    slices = lambda vehicle: (Slice("speed", (2.0, 2.5), (0.9, 1.2), base_case(vehicle)),)  # noqa: E731
    stops = lambda bench: [StopTask(bench, StopConditions(0.0, 0.8), v, i) for i, v in enumerate((2.0, 9.0))]  # noqa: E731
    monkeypatch.setattr(command, "envelope_slices", slices)
    monkeypatch.setattr(command, "stopping_tasks", stops)


def test_the_command_leaves_reports_that_say_what_was_measured(
    few: None, bench: Bench, run_cli: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    code, out, _ = run_cli("envelope", "--physics", bench.physics, "--workers", 1, "--out", tmp_path)
    assert code == 0
    assert {path.name for path in tmp_path.iterdir()} == {
        f"{name}.{kind}" for name in ("envelope", "stopping") for kind in ("md", "csv", "json", "png")
    }
    values = json.loads((tmp_path / "envelope.json").read_text())
    assert [(case["speed_m_s"], case["period_s"]) for case in values["cases"]] == [
        (2.0, 0.9), (2.0, 1.2), (2.5, 0.9), (2.5, 1.2)
    ]  # fmt: skip
    again = measured(bench, period=1.2).measured
    assert values["cases"][1]["slip"] == again.slip
    assert f"of {len(values['cases'])} followed" in out
    (safe,) = json.loads((tmp_path / "stopping.json").read_text())["largest_safe_speeds"]
    assert f"{safe['measured_m_s']:.2f} m/s (on paper {safe['on_paper_m_s']:.2f})" in out
    assert 7.0 < safe["measured_m_s"] < 8.2


def test_an_engine_that_is_not_there_is_one_line(
    run_cli: Callable[..., tuple[int, str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.delitem(sys.modules, "nnql_bullet.sim.mujoco", raising=False)
    monkeypatch.delattr("nnql_bullet.sim.mujoco", raising=False)
    code, _, err = run_cli("envelope", "--sim", "mujoco", "--out", tmp_path / "none")
    assert code == 2
    assert "pip install 'nnql-bullet[mujoco]'" in err
    assert not (tmp_path / "none").exists()


def test_a_folder_in_use_is_refused_and_a_failed_save_changes_nothing(
    few: None,
    bench: Bench,
    run_cli: Callable[..., tuple[int, str, str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """So it is in `fidelity`, whose files are written alike."""
    out = tmp_path / "out"
    with locked(out):
        for verb in ("envelope", "fidelity"):
            code, _, complaint = run_cli(verb, "--physics", bench.physics, "--out", out)
            assert (code, f"{out}: is in use by process" in complaint) == (2, True)
    (out / "envelope.json").write_text("old")

    def full(*args: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(reports, "draw_envelope", full)
    assert run_cli("envelope", "--physics", bench.physics, "--workers", 1, "--out", out)[0] == 2
    assert [(path.name, path.read_text()) for path in out.iterdir()] == [("envelope.json", "old")]
