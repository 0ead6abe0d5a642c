"""Probes of rolling: acceleration, coasting, straight driving, turns and the trailing caster."""

from math import ceil, copysign, cos, degrees, inf, log, nan, pi, radians, sin, sqrt, tan

import numpy as np
from scipy.integrate import solve_ivp

from nnql_bullet import paper
from nnql_bullet.constants import GRAVITY
from nnql_bullet.fidelity.probe import MIDDLE, Bench, Measurement, Probe, at_most, close_to, open_ground, step_factor
from nnql_bullet.fidelity.probes_vehicles import (
    driven_by,
    gentlest_torque,
    has_swivel_in_front,
    rolling_freely,
    swivels_all,
    turning_within_its_means,
)
from nnql_bullet.geometry import Array, Pose
from nnql_bullet.sim.base import Sample
from nnql_bullet.sim.contact import ContactEngine, VehicleMotion
from nnql_bullet.vehicle.controller import COMMAND_RATE, own_speed
from nnql_bullet.vehicle.limits import grip_acceleration, quasi_steady, tip_acceleration
from nnql_bullet.vehicle.spec import Limits, VehicleSpec

OUT_OF_REACH = 1e6
"""A wheel speed that keeps the drives at their torque limit [rad/s]."""
FARTHEST_SWING = 1.8
"""Most trails that a vehicle coasts in a physics step: beyond two, a caster that is off swings past and further off."""
MOST_GROWTH = 3.0
"""Exponent by which a deviation may grow while a vehicle coasts that does not keep straight by itself."""
TRAILING_TIME = 0.08
"""Trail over speed of a caster that swings slowly: much longer than a physics step [s]."""


def _acceleration(bench: Bench) -> list[Measurement]:
    vehicle, torque = bench.vehicle, gentlest_torque(bench.vehicle)
    with bench.open_engine(driven_by(rolling_freely(vehicle), torque)) as engine:
        engine.place(open_ground(), MIDDLE, 0.0)
        engine.command_wheels(OUT_OF_REACH, OUT_OF_REACH)
        engine.run(1.0)
        speed, time, tolerance = engine.speed(), engine.time(), 1e-3 * step_factor(engine)
    expected = 2 * torque * time / (vehicle.wheel_radius * vehicle.rolling_mass)
    return [close_to("speed after 1 s", "m/s", expected, speed, relative=tolerance)]


def _coast(bench: Bench) -> list[Measurement]:
    rows = []
    with bench.open_engine(rolling_freely(bench.vehicle)) as engine:
        trails = [its.trail for its in bench.vehicle.casters if its.swivels]
        steady = FARTHEST_SWING * min(trails, default=inf) / engine.time_step
        for speed in (engine.drive.speed, min(4 * engine.drive.speed, steady)):
            engine.place(open_ground(), MIDDLE, speed)
            engine.release_wheels()
            time = min(5.0, MOST_GROWTH / max(growth(bench.vehicle, speed), 1e-9))
            engine.run(time)
            tolerance = 1e-3 * bench.pace
            name = f"{time:.2g} s after {speed:.3g} m/s"
            rows.append(close_to(name, "m/s", speed, engine.speed(), absolute=tolerance))
    return rows


def growth(vehicle: VehicleSpec, speed: float) -> float:
    """Computes how fast a coasting vehicle turns away from straight ahead [1/s]; negative where it comes back.

    It is a Chaplygin sleigh: a centre of mass behind the axle, which goes where the axle points, overtakes it.
    """
    behind = -vehicle.com_ahead
    return vehicle.mass * behind * speed / (vehicle.yaw_inertia + vehicle.mass * behind * behind)


def _rolling_resistance(bench: Bench) -> list[Measurement]:
    vehicle = bench.vehicle
    on_rear = vehicle.mass * GRAVITY * vehicle.rear_share
    force = vehicle.contact.rolling_friction * on_rear / vehicle.wheel_radius
    with bench.open_engine() as engine:
        speed, deceleration = engine.drive.speed, force / vehicle.rolling_mass
        engine.place(open_ground(), MIDDLE, speed)
        engine.release_wheels()
        engine.run(min(1.0, 0.5 * speed / deceleration) if deceleration > 0 else 1.0)
        expected = speed - deceleration * engine.time()
        return [close_to("speed", "m/s", expected, engine.speed(), absolute=5e-3 * bench.pace)]


def _straight(bench: Bench) -> list[Measurement]:
    with bench.open_engine() as engine:
        engine.reset(open_ground())
        periods = round(20.0 / engine.drive.decision_period)
        path_length = sum(engine.advance(0.0).path_length for _ in range(periods))
        expected, pose, tolerance = engine.drive.speed * engine.time(), engine.pose(), 2e-4 * step_factor(engine)
    return [
        close_to("distance in 20 s", "m", expected, pose.x - MIDDLE.x, relative=tolerance),
        close_to("path length", "m", expected, path_length, relative=tolerance),
        at_most("sideways", "mm", 10.0 * bench.size, 1e3 * abs(pose.y - MIDDLE.y)),
        at_most("change of heading", "deg", 0.02, degrees(abs(pose.yaw))),
    ]


def _quickest(turn: float, limits: Limits) -> tuple[float, float]:
    """Computes the peak yaw rate [rad/s] and duration [s] of the quickest turn from straight to straight."""
    peak = min(limits.yaw_rate, sqrt(limits.yaw_acceleration * abs(turn)))
    return peak, peak / limits.yaw_acceleration + abs(turn) / peak if peak > 0 else 0.0


def _unicycle(start: Pose, speed: float, turn: float, limits: Limits, times: Array) -> Array:
    """Computes positions (n, 2) [m] at `times` (n,) [s] of a vehicle with a trapezoidal yaw rate and no slip."""
    peak, end = _quickest(turn, limits)
    slope = limits.yaw_acceleration

    def derivative(time: float, state: Array) -> tuple[float, float, float]:
        rate = max(min(slope * time, peak, slope * (end - time)), 0.0)
        return speed * cos(state[2]), speed * sin(state[2]), copysign(rate, turn)

    begin = (start.x, start.y, start.yaw)
    path = solve_ivp(derivative, (0.0, times[-1]), begin, t_eval=times, rtol=1e-9, atol=1e-9, max_step=0.02)
    return np.asarray(path.y[:2].T)


def _actions(bench: Bench) -> list[Measurement]:
    vehicle, share = turning_within_its_means(bench.vehicle, own_speed(bench.vehicle))
    at_share = "" if share == 1 else f" at {share:.2f} of its yaw rate"
    longest = max(_quickest(turn, vehicle.limits)[1] for turn in paper.TURNS)
    rows, gaps, slips, rates = [], [], [], []
    with bench.open_engine(vehicle, decision_period=ceil(2 * (longest + 0.1)) / 2) as engine:
        speed, world = engine.drive.speed, open_ground()
        for turn in paper.TURNS:
            trace: list[Sample] = []
            engine.reset(world)
            motion = engine.advance(turn, trace)
            wanted, reached = degrees(turn), degrees(motion.pose.yaw)
            rows.append(close_to(f"turn of {wanted:.0f} deg{at_share}", "deg", wanted, reached, absolute=0.1))
            times = np.array([sample.time for sample in trace])
            places = np.array([(sample.pose.x, sample.pose.y) for sample in trace])
            off = places - _unicycle(world.start, speed, turn, vehicle.limits, times)
            gaps.append(float(np.sqrt(np.mean(np.sum(off**2, axis=1)))))
            slips += _slips(vehicle, motion, trace[-1])
            rates.append(abs(motion.yaw_rate))
        gap = 6.0 * bench.pace * step_factor(engine)
    return [
        *rows,
        at_most("RMS distance from the unicycle, largest", "mm", gap, 1e3 * float(np.max(gaps))),
        at_most("slip of the wheels, largest", "%", 0.5, 1e2 * float(np.max(slips))),
        at_most("yaw rate afterwards, largest", "rad/s", 0.01, float(np.max(rates))),
    ]


def _slips(vehicle: VehicleSpec, motion: VehicleMotion, end: Sample) -> list[float]:
    """Computes relative errors of path length and heading change against the rotation of the drive wheels."""
    left, right, *_ = (vehicle.wheel_radius * angle for angle in end.joint_angles)
    slips = [abs((left + right) / 2 / motion.path_length - 1)]
    if abs(motion.pose.yaw) > 0.1:
        slips.append(abs((right - left) / (vehicle.track * motion.pose.yaw) - 1))
    return slips


def _turn_steadily(engine: ContactEngine, v: float, w: float) -> Array:
    """Measures means over 1 s of a steady turn (5,): loads of the left, right and caster wheel, speed, yaw rate."""
    vehicle = engine.vehicle
    engine.place(open_ground(), MIDDLE, v)
    for rate in np.linspace(0.0, w, round(0.5 * COMMAND_RATE)):
        half = rate * vehicle.track / 2
        engine.command_wheels((v - half) / vehicle.wheel_radius, (v + half) / vehicle.wheel_radius)
        engine.run(1 / COMMAND_RATE)
    engine.run(2.0)
    seen = []
    for _ in range(round(1.0 / engine.time_step)):
        engine.step()
        seen.append((*engine.wheel_loads(), engine.speed(), engine.yaw_rate()))
    return np.asarray(np.mean(seen, axis=0))


def _steady_turn(bench: Bench) -> list[Measurement]:
    vehicle = bench.vehicle
    with bench.open_engine(rolling_freely(vehicle)) as engine:
        v = engine.drive.speed
        w = min(grip_acceleration(vehicle) / 3 / v, tip_acceleration(vehicle) / 3 / v, vehicle.limits.yaw_rate)
        *loads, speed, yaw_rate = _turn_steadily(engine, v, w).tolist()
        # An engine may state velocities of the pose before the step, which has turned since: by so much it reads fast.
        turned_on = abs(vehicle.com_ahead) * w * w * engine.time_step
    inner, outer, front = quasi_steady(vehicle, v, np.array([w]), np.zeros(1)).loads[0].tolist()
    return [
        close_to("speed", "m/s", v, speed, absolute=2e-3 * v + turned_on),
        close_to("yaw rate", "rad/s", w, yaw_rate, relative=7e-3),
        close_to("load on inner wheel", "N", inner, loads[0], relative=1.5e-2),
        close_to("load on outer wheel", "N", outer, loads[1], relative=1.5e-2),
        close_to("load on caster", "N", front, loads[2], relative=1.5e-2),
    ]


def _swing(engine: ContactEngine, angle: float, speed: float) -> None:
    """Turns the caster to an angle from trailing [rad], rolling at the vehicle's speed straight ahead [m/s].

    One at rest would slide until friction has spun up its fork.
    """
    engine.set_swivel(angle, -speed / engine.vehicle.casters[0].trail * sin(angle))


def _trailing_after(engine: ContactEngine, speed: float, begin: float, end: float, longest: float) -> float:
    """Measures the time [s] after which the caster, released `begin` short of trailing, stays within `end` [rad].

    It trails at 0 at a speed ahead, and at half a turn backwards.
    """
    trailing = 0.0 if speed > 0 else pi
    engine.place(open_ground(), MIDDLE, speed)
    engine.command_wheels(*(speed / engine.vehicle.wheel_radius,) * 2)
    engine.run(0.2)
    _swing(engine, abs(trailing - begin), speed)
    start, before, within = engine.time(), begin, nan
    while (time := engine.time() - start) < longest:
        engine.step()
        angle = abs(engine.sample().joint_angles[2] - trailing)
        if before > end >= angle:
            within = time + engine.time_step * (before - end) / (before - angle)
        elif angle > end:
            within = nan
        before = angle
    return within


def _caster(bench: Bench) -> list[Measurement]:
    vehicle, begin, end = bench.vehicle, radians(30.0), radians(1.0)
    trail = vehicle.casters[0].trail
    slowly = trail / TRAILING_TIME
    expected = TRAILING_TIME * log(tan(begin / 2) / tan(end / 2))
    with bench.open_engine() as engine:
        tolerance = 0.05 * step_factor(engine)
        trailing = _trailing_after(engine, slowly, begin, end, 3 * expected)
        limit = 6 * trail / engine.drive.speed
        at_speed = _trailing_after(engine, engine.drive.speed, begin, end, 3 * limit)
    return [
        close_to(f"from 30 to 1 deg at {slowly:.3g} m/s", "s", expected, trailing, relative=tolerance),
        at_most(f"from 30 to 1 deg at {engine.drive.speed:.3g} m/s", "s", limit, at_speed),
    ]


def _swivel(vehicle: VehicleSpec, speed: float, turn: float, begin: float, times: Array) -> Array:
    """Computes the angles (n,) [rad] at `times` (n,) [s] of a caster that rolls without slip through a turn."""
    trail = vehicle.casters[0].trail
    ahead = vehicle.wheelbase + trail
    peak, end = _quickest(turn, vehicle.limits)
    slope = vehicle.limits.yaw_acceleration

    def derivative(time: float, angle: Array) -> Array:
        rate = copysign(max(min(slope * time, peak, slope * (end - time)), 0.0), turn)
        return np.asarray((rate * ahead * np.cos(angle) - speed * np.sin(angle)) / trail - rate)

    found = solve_ivp(derivative, (0.0, times[-1]), [begin], t_eval=times, rtol=1e-9, atol=1e-9, max_step=0.02)
    return np.asarray(found.y[0])


def _reversing(bench: Bench) -> list[Measurement]:
    vehicle, _ = turning_within_its_means(bench.vehicle, own_speed(bench.vehicle))
    begin, largest, rows, gaps, swivels = radians(30.0), max(paper.TURNS), [], [], []
    own, trail = own_speed(vehicle), vehicle.casters[0].trail
    slowly = min(trail / TRAILING_TIME, own)
    braking = (own + slowly) / vehicle.limits.acceleration
    longest = max(braking, _quickest(largest, vehicle.limits)[1] + 0.1)
    with bench.open_engine(vehicle, decision_period=ceil(2 * longest) / 2) as engine:
        expected = trail / slowly * log(tan((pi - begin) / 2) / tan(begin / 2))
        tolerance = 0.05 * step_factor(engine)
        swung = _trailing_after(engine, -slowly, pi - begin, begin, 3 * expected)
        rows.append(close_to(f"from 30 to 150 deg at {-slowly:.3g} m/s", "s", expected, swung, relative=tolerance))
        for turn in (0.0, largest, -largest):
            trace: list[Sample] = []
            engine.reset(open_ground())
            start = engine.advance(0.0, speed_scale=-slowly / engine.drive.speed).pose
            _swing(engine, copysign(begin, turn), -slowly)
            since, motion = engine.time(), engine.advance(turn, trace, -slowly / engine.drive.speed)
            wanted, reached = degrees(turn), degrees(motion.pose.yaw - start.yaw)
            rows.append(close_to(f"turn of {wanted:.0f} deg backwards", "deg", wanted, reached, absolute=0.1))
            times = np.array([sample.time - since for sample in trace])
            places = np.array([(sample.pose.x, sample.pose.y) for sample in trace])
            angles = np.array([sample.joint_angles[2] for sample in trace])
            off = places - _unicycle(start, -slowly, turn, vehicle.limits, times)
            gaps.append(float(np.sqrt(np.mean(np.sum(off**2, axis=1)))))
            swivels.append(np.abs(angles - _swivel(vehicle, -slowly, turn, copysign(begin, turn), times)).max())
        gap, lag = 6.0 * bench.pace * step_factor(engine), 3.0 * step_factor(engine)
    return [
        *rows,
        at_most("RMS distance from the unicycle, largest", "mm", gap, 1e3 * float(np.max(gaps))),
        at_most("angle of the caster off its path, largest", "deg", lag, degrees(float(np.max(swivels)))),
    ]


ROLLING = (
    Probe(
        name="acceleration",
        title="The torque limit accelerates mass and wheels from rest",
        closed_form="v = 2 tau t / (r m_eff), m_eff = m + 2 I_wheel/r^2 + I_caster/r_c^2",
        source="Gillespie, Fundamentals of Vehicle Dynamics, ch. 2 (effective mass)",
        measure=_acceleration,
        applies=has_swivel_in_front,
    ),
    Probe(
        name="coast",
        title="Free wheels without rolling resistance keep their speed",
        closed_form="v(t) = v(0)",
        source="Goldstein, Poole and Safko, Classical Mechanics, 1.1 (conservation of momentum)",
        measure=_coast,
        applies=swivels_all,
    ),
    Probe(
        name="rolling-resistance",
        title="Rolling resistance slows free wheels",
        closed_form="v = v(0) - b N_rear t / (r m_eff), b the lever arm of rolling friction",
        source="Beer and Johnston, Vector Mechanics for Engineers: Statics, ch. 8 (rolling resistance)",
        measure=_rolling_resistance,
        applies=has_swivel_in_front,
    ),
    Probe(
        name="straight",
        title="It runs straight",
        closed_form="x = v t, y = 0, yaw = 0",
        source="Siegwart and Nourbakhsh, Introduction to Autonomous Mobile Robots, 3.2 (differential drive)",
        measure=_straight,
    ),
    Probe(
        name="five-actions",
        title="The five turns of the paper follow a unicycle with the same yaw rate",
        closed_form=(
            "x' = v cos(yaw), y' = v sin(yaw), yaw' = trapezoid within the vehicle's limits, "
            "or slower ones if these ask for more than grip and torque"
        ),
        source="Lynch and Park, Modern Robotics, 13.3.1 (unicycle) and 9.2.2 (trapezoid)",
        measure=_actions,
    ),
    Probe(
        name="steady-turn",
        title="A steady turn keeps speed and yaw rate and shifts load outwards",
        closed_form=(
            "N_front = m a (g + h w^2) / x_c; N_outer - N_inner = 2 (m h v w + H w + N_front y_c) / T, "
            "x_c and y_c where the caster touches, H the spin of the wheels"
        ),
        source=(
            "Gillespie, Fundamentals of Vehicle Dynamics, ch. 9 (moments in a turn); "
            "Siegwart and Nourbakhsh, Introduction to Autonomous Mobile Robots, 3.2.3 (castor wheel)"
        ),
        measure=_steady_turn,
        applies=has_swivel_in_front,
    ),
    Probe(
        name="caster",
        title="The caster comes back to trailing",
        closed_form="swivel' = -(v/trail) sin(swivel): t = (trail/v) ln(tan(15 deg) / tan(0.5 deg))",
        source="Siegwart and Nourbakhsh, Introduction to Autonomous Mobile Robots, 3.2.3 (castor wheel)",
        measure=_caster,
        applies=has_swivel_in_front,
    ),
    Probe(
        name="reversing",
        title="It backs up as a unicycle does, and its caster swings round",
        closed_form=(
            "swivel' = (w (L + trail) cos(swivel) - v sin(swivel)) / trail - w; straight back "
            "t = -(trail/v) ln(tan(75 deg) / tan(15 deg))"
        ),
        source=(
            "Siegwart and Nourbakhsh, Introduction to Autonomous Mobile Robots, 3.2.3 (castor wheel); "
            "Lynch and Park, Modern Robotics, 13.3.1 (unicycle)"
        ),
        measure=_reversing,
        applies=has_swivel_in_front,
    ),
)
