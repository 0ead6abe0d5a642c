"""Limits on paper against numbers worked out by hand, forward integration, and moments of moving point masses."""

from dataclasses import replace
from math import cos, degrees, hypot, pi, radians, sin, sqrt

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp, trapezoid
from scipy.optimize import brentq

from nnql_bullet.vehicle.limits import (
    MIN_TURNING_BRAKES,
    MIN_YAW_ACCELERATION,
    braking,
    braking_rear_load,
    followed_limits,
    grip_acceleration,
    quasi_steady,
    side_grip,
    static_rear_load,
    tip_acceleration,
    tip_angle,
    turn_demand,
    turning_deceleration,
    worst,
)
from nnql_bullet.vehicle.payload import loaded
from nnql_bullet.vehicle.profiles import Turn, plan_turn
from nnql_bullet.vehicle.spec import Limits, Payload, VehicleSpec

# The shipped vehicle, typed from its drawing.
MASS, A, H, TRACK, WHEELBASE, RADIUS, G = 120.0, 0.1252, 0.2058, 0.60, 0.70, 0.125, 9.81


def at(vehicle: VehicleSpec, speed: float, rate: float, acceleration: float = 0.0) -> tuple[NDArray[np.float64], float]:
    """Wheel loads (3,) [N] and friction needed at one instant."""
    demand = quasi_steady(vehicle, speed, np.array([rate]), np.array([acceleration]))
    return demand.loads[0], float(demand.friction[0])


# Friction and torque of 60 degrees at 2 m/s with cosine ramps of a third of the period, worked out independently. The
# torques there leave out spinning up the wheels, so here they are drive forces times radius.
@pytest.mark.parametrize(("period", "friction", "torque"), [(0.8, 0.89, 45.0), (1.0, 0.62, 30.0), (1.2, 0.47, 22.0)])
def test_cosine_turn_asks_for_the_friction_and_torque_worked_out_before(
    vehicle: VehicleSpec, period: float, friction: float, torque: float
) -> None:
    ramp = period / 3
    peak = radians(60) / (2 * ramp)
    times = np.linspace(0.0, ramp, 400)
    rates = peak * (1 - np.cos(pi * times / ramp)) / 2
    accelerations = peak * pi / ramp * np.sin(pi * times / ramp) / 2
    demand = quasi_steady(vehicle, 2.0, rates, accelerations)
    assert demand.friction.max() == pytest.approx(friction, rel=0.025)
    assert np.abs(demand.drive_forces).max() * RADIUS == pytest.approx(torque, abs=0.5)


def test_straight_asks_for_nothing_and_leaves_the_loads_of_rest(vehicle: VehicleSpec) -> None:
    asked = turn_demand(vehicle, 2.0, plan_turn(0.0, 0.0, vehicle.limits))
    assert (asked.friction, asked.torque, asked.least_load, asked.lateral) == pytest.approx((0, 0, 1, 0))
    loads, _ = at(vehicle, 2.0, 0.0)
    assert loads == pytest.approx((483.3, 483.3, 210.5), abs=0.2)
    assert static_rear_load(vehicle) == pytest.approx(483.3, abs=0.1)


def upright(vehicle: VehicleSpec) -> VehicleSpec:
    """The vehicle with the contact point of its caster under the swivel."""
    return replace(vehicle, casters=(replace(vehicle.casters[0], trail=0.0),))


def test_loads_of_a_steady_turn_typed_by_hand(vehicle: VehicleSpec) -> None:
    plain = replace(upright(vehicle), wheel_spin_inertia=0.0)
    loads, _ = at(plain, 2.0, 1.0)
    outwards = MASS * 2.0 * 1.0 * H / TRACK  # 82.3 N
    forwards = MASS * A * 1.0 * H / WHEELBASE  # 4.4 N
    assert loads == pytest.approx((483.3 - forwards / 2 - outwards, 483.3 - forwards / 2 + outwards, 214.9), abs=0.2)


def test_swivelled_caster_and_spinning_wheels_shift_load_as_measured(vehicle: VehicleSpec) -> None:
    # Means over two seconds of steady turning in contact physics.
    for payload, speed, rate, transfer, front in (
        (0.0, 2.0, 1.0, 80.80, 211.9),
        (0.0, 3.0, 0.8, 99.78, 210.9),
        (80.0, 2.0, 1.0, 218.29, 624.0),
        (80.0, 1.0, 1.5, 144.02, 647.9),
    ):
        loads, _ = at(loaded(vehicle, Payload(payload, vehicle.footprint.x, 0.55)), speed, rate)
        assert (loads[1] - loads[0]) / 2 == pytest.approx(transfer, rel=0.015)
        assert loads[2] == pytest.approx(front, rel=0.015)


def test_right_turn_mirrors_the_left_one(vehicle: VehicleSpec) -> None:
    left = quasi_steady(vehicle, 2.0, np.array([1.1]), np.array([3.0]))
    right = quasi_steady(vehicle, 2.0, np.array([-1.1]), np.array([-3.0]))
    assert right.loads[0] == pytest.approx(left.loads[0][[1, 0, 2]])
    assert right.torques[0] == pytest.approx(left.torques[0][::-1])
    assert right.friction == pytest.approx(left.friction)


def test_demanded_forces_drive_the_rigid_body_along_its_profile(vehicle: VehicleSpec) -> None:
    """Forward dynamics of the free body: constant speed at the rear axle, no sliding there, the yaw asked for."""
    speed, begin, acceleration = 2.0, 0.4, 3.0
    end = 0.3
    mass, ahead, inertia, track = vehicle.mass, vehicle.com_ahead, vehicle.yaw_inertia, vehicle.track

    def derivative(time: float, state: NDArray[np.float64]) -> list[float]:
        _, _, yaw, vx, vy, rate = state
        demand = quasi_steady(vehicle, speed, np.array([begin + acceleration * time]), np.array([acceleration]))
        left, right = demand.drive_forces[0]
        along, side = left + right, float(demand.side_force[0])
        force_x, force_y = along * cos(yaw) - side * sin(yaw), along * sin(yaw) + side * cos(yaw)
        moment = (right - left) * track / 2 - side * ahead
        return [vx, vy, rate, force_x / mass, force_y / mass, moment / inertia]

    start = [ahead, 0.0, 0.0, speed, ahead * begin, begin]
    _, _, yaw, vx, vy, rate = solve_ivp(derivative, (0.0, end), start, rtol=1e-10, atol=1e-12).y[:, -1]
    assert rate == pytest.approx(begin + acceleration * end)
    assert yaw == pytest.approx(begin * end + acceleration * end**2 / 2)
    assert vx * cos(yaw) + vy * sin(yaw) == pytest.approx(speed)
    assert vy * cos(yaw) - vx * sin(yaw) - ahead * rate == pytest.approx(0.0, abs=1e-9)


def test_loads_balance_the_moments_of_point_masses_on_their_way(vehicle: VehicleSpec) -> None:
    """Two masses and two spinning wheels carried along a turn, their momentum differentiated numerically."""
    payload = Payload(80.0, 0.35, 0.55)
    made = loaded(vehicle, payload)
    v, w, alpha = 2.0, 1.2, 4.0
    masses = np.array([vehicle.mass, payload.mass])
    places = np.array([[vehicle.com_ahead, 0.0, vehicle.com_height], [payload.ahead, 0.0, payload.height]])

    def ways(time: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Where the masses are (2, 3), and the spin of both wheels (3,), near time 0."""
        yaw, rate = w * time + alpha * time**2 / 2, w + alpha * time
        x = v * trapezoid(np.cos(w * (t := np.linspace(0, time, 201)) + alpha * t**2 / 2), t)
        y = v * trapezoid(np.sin(w * t + alpha * t**2 / 2), t)
        turned = np.array([[cos(yaw), -sin(yaw), 0.0], [sin(yaw), cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        speeds = sum((v + side * rate * TRACK / 2) / RADIUS for side in (-1, 1))
        spin = 0.046874 * speeds * np.array([-sin(yaw), cos(yaw), 0.0])
        return places @ turned.T + (x, y, 0.0), spin

    dt = 1e-3
    (p_0, s_0), (p_1, _), (p_2, s_2) = ways(-dt), ways(0.0), ways(dt)
    forces = masses[:, None] * ((p_0 - 2 * p_1 + p_2) / dt**2 + (0.0, 0.0, G))
    moment = np.cross(p_1, forces).sum(axis=0) + (s_2 - s_0) / (2 * dt)

    swivel, trail = 0.74, 0.04

    def across(delta: float) -> float:
        """Speed of the caster's contact point across its wheel, which turns with the chassis."""
        contact = np.array([swivel - trail * cos(delta), -trail * sin(delta)])
        velocity = np.array([v - w * contact[1], w * contact[0]])
        return float(velocity @ (-sin(delta), cos(delta)))

    delta = brentq(across, -1.0, 1.5)
    caster_x, caster_y = swivel - trail * cos(delta), -trail * sin(delta)
    # Vertical forces at (x, y) give moments (y N, -x N) about the point below the rear-axle centre.
    matrix = np.array([[1.0, 1.0, 1.0], [TRACK / 2, -TRACK / 2, caster_y], [0.0, 0.0, -caster_x]])
    expected = np.linalg.solve(matrix, [forces[:, 2].sum(), moment[0], moment[1]])
    loads, _ = at(made, v, w, alpha)
    assert loads == pytest.approx(expected, rel=1e-4)


def test_friction_is_what_both_wheels_need_together(vehicle: VehicleSpec) -> None:
    demand = quasi_steady(vehicle, 2.0, np.array([1.5]), np.array([5.0]))
    (left, right), side = demand.drive_forces[0], demand.side_force[0]
    assert left < 0 < right
    assert demand.friction[0] == pytest.approx(hypot(side, right - left) / demand.loads[0, :2].sum())


def test_a_turn_asks_for_most_where_its_ramp_ends(vehicle: VehicleSpec) -> None:
    turn = Turn(0.0, 1.5, 0.3, 0.4, 0.3)
    asked = turn_demand(vehicle, 2.0, turn)
    corner = worst(vehicle, quasi_steady(vehicle, 2.0, np.array([1.5]), np.array([5.0])))
    assert (asked.friction, asked.torque, asked.lateral) == pytest.approx(
        (corner.friction, corner.torque, corner.lateral)
    )
    # F = m (-a w^2)/2 - (Izz alpha + a m ay)/T on the inner wheel, and its spin
    lateral = 2.0 * 1.5 + A * 5.0
    force = -MASS * A * 1.5**2 / 2 - (13.4 * 5.0 + A * MASS * lateral) / TRACK
    assert asked.torque == pytest.approx(-force * RADIUS + 0.046874 * 5.0 * 0.3 / RADIUS, rel=2e-3)
    assert asked.lateral == pytest.approx(lateral, rel=1e-3)


def test_a_turn_taken_over_at_its_peak_is_looked_at_from_there(vehicle: VehicleSpec) -> None:
    carried_over = turn_demand(vehicle, 2.0, Turn(1.5, 1.5, 0.0, 0.2, 0.3))
    from_straight = turn_demand(vehicle, 2.0, Turn(0.0, 1.5, 0.3, 0.2, 0.3))
    assert carried_over.friction < from_straight.friction
    assert carried_over.lateral == pytest.approx(3.0)


def test_a_heavier_or_higher_load_asks_for_more(vehicle: VehicleSpec) -> None:
    turn = plan_turn(0.0, radians(60), Limits(yaw_rate=1.5708, yaw_acceleration=4.7124, acceleration=2.5))
    heavier = [turn_demand(loaded(vehicle, Payload(mass, 0.35, 0.55)), 2.0, turn) for mass in (0.0, 40.0, 80.0, 120.0)]
    higher = [turn_demand(loaded(vehicle, Payload(80.0, 0.35, height)), 2.0, turn) for height in (0.3, 0.6, 0.9)]
    assert np.all(np.diff([asked.torque for asked in heavier]) > 0)
    assert np.all(np.diff([asked.friction for asked in heavier]) > 0)
    assert np.all(np.diff([asked.least_load for asked in heavier]) < 0)
    assert np.all(np.diff([asked.least_load for asked in higher]) < 0)


def test_tip_angle_is_where_a_slope_takes_the_load_off_a_wheel(vehicle: VehicleSpec) -> None:
    tall = replace(vehicle, com_height=0.55)

    def upper_load(slope: float) -> float:
        down, side = MASS * G * cos(slope), MASS * G * sin(slope)
        matrix = [[1.0, 1.0, 1.0], [TRACK / 2, -TRACK / 2, 0.0], [0.0, 0.0, WHEELBASE]]
        return float(np.linalg.solve(matrix, [down, -side * 0.55, down * vehicle.com_ahead])[0])

    assert tip_angle(tall) == pytest.approx(brentq(upper_load, 0.0, 1.5), rel=1e-6)
    assert degrees(tip_angle(vehicle)) == pytest.approx(50.13, abs=0.05)
    assert tip_acceleration(vehicle) == pytest.approx(11.74, abs=0.01)


def test_inner_wheel_lifts_at_the_tip_acceleration(vehicle: VehicleSpec) -> None:
    plain = replace(upright(vehicle), wheel_spin_inertia=0.0)
    speed = 1e4  # so wide a turn that the centre of mass is hardly drawn back
    loads, _ = at(plain, speed, tip_acceleration(plain) / speed)
    assert loads[0] == pytest.approx(0.0, abs=1e-3)


def test_steady_turn_at_the_grip_limit_needs_all_friction(vehicle: VehicleSpec) -> None:
    assert grip_acceleration(vehicle) == pytest.approx(5.95, abs=0.01)
    speed = 1e4
    _, friction = at(upright(vehicle), speed, grip_acceleration(vehicle) / speed)
    assert friction == pytest.approx(0.8, rel=1e-4)


def test_braking_by_grip_balances_forces_and_moments(vehicle: VehicleSpec) -> None:
    # Unknown: rear load, front load, deceleration.
    matrix = np.array([[1.0, 1.0, 0.0], [0.0, WHEELBASE, -MASS * H], [0.8, 0.0, -MASS]])
    rear, _, deceleration = np.linalg.solve(matrix, [MASS * G, MASS * G * A, 0.0])
    limits = braking(vehicle)
    assert limits.by_grip == pytest.approx(deceleration, rel=1e-3)
    assert braking_rear_load(vehicle, limits.by_grip) == pytest.approx(rear / 2 / 483.3, rel=1e-3)


def test_braking_by_torque_slows_the_wheels_too(vehicle: VehicleSpec) -> None:
    rolling = MASS + 2 * 0.046874 / RADIUS**2 + 0.0025 / 0.05**2
    limits = braking(vehicle)
    assert limits.by_torque == pytest.approx(2 * 40.0 / (RADIUS * rolling), rel=1e-6)
    assert limits.deceleration == limits.by_torque < limits.by_grip
    slippery = replace(vehicle, contact=replace(vehicle.contact, wheel_friction=0.4))
    assert braking(slippery).deceleration == braking(slippery).by_grip


def test_stopping_distance_typed_by_hand(vehicle: VehicleSpec) -> None:
    slippery = braking(replace(vehicle, contact=replace(vehicle.contact, wheel_friction=0.4)))
    deceleration = 0.4 * G * (1 - A / WHEELBASE) / (1 + 0.4 * H / WHEELBASE)
    assert slippery.stopping_distance(3.0) == pytest.approx(9.0 / (2 * deceleration), rel=1e-3)
    assert slippery.stopping_distance(3.0, 0.5) == pytest.approx(1.5 + 9.0 / (2 * deceleration), rel=1e-3)


@pytest.mark.parametrize("reaction", [0.0, 0.5, 2.0])
def test_largest_speed_just_stops_in_time(vehicle: VehicleSpec, reaction: float) -> None:
    limits = braking(vehicle)
    speed = limits.largest_speed(9.45, reaction)
    assert limits.stopping_distance(speed, reaction) == pytest.approx(9.45)
    assert limits.largest_speed(9.45) == pytest.approx(sqrt(2 * limits.deceleration * 9.45))


@pytest.mark.parametrize(("friction", "load"), [(0.8, 80.0), (0.8, 120.0), (0.4, 0.0), (0.5, 40.0)])
@pytest.mark.parametrize("acceleration", [0.0, 1.0])
def test_what_a_vehicle_follows_is_what_a_drive_wheel_can_push(
    vehicle: VehicleSpec, friction: float, load: float, acceleration: float
) -> None:
    """By the demand of a turn at constant speed; slowing down then takes its part of the push on both wheels."""
    carrying = loaded(vehicle.gripping(friction), Payload(load, 0.35, 0.55)) if load else vehicle.gripping(friction)
    followed = followed_limits(carrying, 2.0, acceleration)
    assert followed.yaw_rate == pytest.approx(min(vehicle.limits.yaw_rate, grip_acceleration(carrying) / 2.0))
    assert followed.acceleration == vehicle.limits.acceleration
    pushes = quasi_steady(carrying, 2.0, np.array([followed.yaw_rate]), np.array([followed.yaw_acceleration]))
    apart = float(pushes.drive_forces[0, 1] - pushes.drive_forces[0, 0]) / 2
    most = min(carrying.wheel_torque / RADIUS, friction * static_rear_load(carrying))
    left = most - carrying.rolling_mass * acceleration / 2
    if followed.yaw_acceleration > MIN_YAW_ACCELERATION * vehicle.limits.yaw_acceleration:
        assert apart == pytest.approx(left, rel=1e-6)
    else:
        assert apart >= left - 1e-6


def test_braking_leaves_the_grip_for_a_turn_that_the_friction_ellipse_has(vehicle: VehicleSpec) -> None:
    all_of_it, locked = grip_acceleration(vehicle), braking(vehicle).by_grip
    assert side_grip(vehicle, 0.0) == all_of_it
    for angle in np.linspace(0.1, 1.5, 5):
        assert side_grip(vehicle, locked * sin(angle)) == pytest.approx(all_of_it * cos(angle))
    assert side_grip(vehicle, locked) == side_grip(vehicle, 2 * locked) == 0.0


def test_the_shipped_vehicle_follows_all_that_its_drive_asks_for_at_speed(vehicle: VehicleSpec) -> None:
    assert followed_limits(vehicle, 2.0) == vehicle.limits
    assert turning_deceleration(vehicle, 2.0) > vehicle.limits.acceleration


def test_turning_takes_from_braking_and_never_adds(vehicle: VehicleSpec) -> None:
    straight = braking(vehicle).deceleration
    found = [turning_deceleration(vehicle, speed) for speed in (0.1, 0.5, 1.0, 2.0, 3.0, 6.0)]
    assert found == sorted(found, reverse=True)
    assert found[0] == pytest.approx(straight, rel=0.1)
    assert found[-1] == pytest.approx(MIN_TURNING_BRAKES * straight)
