"""Probes of contact: braking with locked wheels, skids, and the impact on a wall."""

from collections.abc import Callable
from math import cos, hypot, pi, sin

import numpy as np

from nnql_bullet.constants import GRAVITY
from nnql_bullet.fidelity.probe import MIDDLE, Bench, Measurement, Probe, at_most, close_to, open_ground
from nnql_bullet.fidelity.probes_vehicles import driven_by, has_swivel_in_front, skidding_friction
from nnql_bullet.geometry import OrientedBox
from nnql_bullet.sim.contact import ContactEngine
from nnql_bullet.types import Vector
from nnql_bullet.vehicle.description import describe, parse
from nnql_bullet.vehicle.spec import VehicleSpec

SHORT = 0.55
"""How much shorter a stop may be than mechanics says, over the way in a physics step at first: an engine brakes from
the first step on, which makes half a step; a small vehicle stops within a few."""


def _rear_braking(vehicle: VehicleSpec) -> float:
    """Computes the deceleration with locked drive wheels and a rolling caster, the only one [m/s2].

    The caster takes the load N_front L = m g a + (m h + I_c/r_c) d; the rest brakes the mass and the caster's spin:
    mu (m g - N_front) = (m + I_c/r_c^2) d.
    """
    caster = vehicle.casters[0]
    mu, m, spin = vehicle.contact.wheel_friction, vehicle.mass, caster.spin_inertia / caster.radius
    shifted = mu * (m * vehicle.com_height + spin) / vehicle.wheelbase
    return mu * m * GRAVITY * vehicle.rear_share / (m + spin / caster.radius + shifted)


def _locked_braking(bench: Bench) -> list[Measurement]:
    vehicle = bench.vehicle
    locking = 4 * vehicle.contact.wheel_friction * vehicle.mass * GRAVITY * vehicle.wheel_radius
    with bench.open_engine(driven_by(vehicle, locking)) as engine:
        speed, deceleration = engine.drive.speed, _rear_braking(vehicle)
        engine.place(open_ground(), MIDDLE, speed)
        engine.command_wheels(0.0, 0.0)
        engine.run(2 * speed / deceleration)
        stopped, left = engine.pose().x - MIDDLE.x, abs(engine.speed())
        short, expected = SHORT * speed * engine.time_step, speed**2 / (2 * deceleration)
    return [
        close_to("stopping distance", "m", expected, stopped, absolute=short, relative=2e-2),
        at_most("speed left", "m/s", 1e-3 * bench.pace, left),
    ]


def _skid(engine: ContactEngine, direction: float, until: float, look: Callable[[], None] = lambda: None) -> float:
    """Lets the vehicle skid with all joints locked, from twice the drive's speed.

    Args:
        engine: The engine with the vehicle, which faces along x.
        direction: Direction of the skid [rad].
        until: Share of the initial speed at which the skid ends.
        look: Called after every step.

    Returns:
        The initial speed [m/s].
    """
    speed = 2 * engine.drive.speed
    engine.place(open_ground(), MIDDLE, 0.0)
    engine.run(0.2)
    engine.lock_joints()
    engine.set_velocity(speed * cos(direction), speed * sin(direction))
    while hypot(*engine.velocity()[:2]) > until * speed and engine.time() < 10.0:
        engine.step()
        look()
    return speed


def _skids(bench: Bench) -> list[Measurement]:
    rows = []
    for part in (1.0, 0.5):
        friction = part * skidding_friction(bench.vehicle)
        with bench.open_engine(bench.vehicle.gripping(friction)) as engine:
            for direction, name in ((0.0, "ahead"), (pi / 2, "sideways")):
                speed, pose = _skid(engine, direction, until=2.5e-3), engine.pose()
                expected, slid = speed**2 / (2 * friction * GRAVITY), hypot(pose.x - MIDDLE.x, pose.y - MIDDLE.y)
                short, quantity = SHORT * speed * engine.time_step, f"distance {name}, mu = {friction:.3g}"
                rows.append(close_to(quantity, "m", expected, slid, absolute=short, relative=3e-2))
    return rows


def _friction_cone(bench: Bench) -> list[Measurement]:
    friction = skidding_friction(bench.vehicle)
    used: list[float] = []
    with bench.open_engine(bench.vehicle.gripping(friction)) as engine:

        def look() -> None:
            used.extend(force.friction / (friction * force.normal) for force in engine.wheel_forces() if force.normal)

        for direction in (pi / 6, pi / 4, pi / 3):
            _skid(engine, direction, until=0.5, look=look)
    return [
        at_most("friction over mu N, largest", "", 1.0, float(np.max(used)), slack=1e-3),
        close_to("friction over mu N, mean", "", 1.0, float(np.mean(used)), absolute=0.01),
    ]


def struck(vehicle: VehicleSpec) -> Vector:
    """Finds where a wall ahead strikes the chassis: on its front, nearest to the centre of mass; in its frame [m].

    A chassis that is all above or below the centre of mass is struck at its edge, and the vehicle turns over it.
    """
    chassis = describe(parse(vehicle.description))
    (box,) = chassis.links[chassis.base].solids
    middle, half = box.origin[:3, 3], np.array(box.sizes) / 2
    centre = np.array((np.inf, vehicle.com_left, vehicle.com_height - vehicle.wheel_radius))
    x, y, z = np.clip(centre, middle - half, middle + half).tolist()
    return x, y, z


def _hit(engine: ContactEngine, gap: float) -> tuple[float, float, float, float]:
    """Measures the impact of the flying, locked vehicle on a wall.

    Returns:
        Impulse [N s], speed of the centre of mass afterwards [m/s], speed of what was struck as contact ends [m/s],
        depth of it [m].
    """
    footprint, speed = engine.vehicle.footprint, engine.drive.speed
    front = footprint.x + footprint.half_length
    face = MIDDLE.x + front + gap
    wall = OrientedBox(face + 0.5, MIDDLE.y + footprint.y, 0.5, 2 * footprint.half_width)
    engine.place(open_ground(wall), MIDDLE, 0.0, ground=False)
    engine.set_gravity((0.0, 0.0, 0.0))
    engine.lock_joints()
    engine.set_velocity(speed, 0.0)
    vehicle, forces, depths, rebound = engine.vehicle, [0.0], [0.0], speed
    centre, place = (vehicle.com_ahead, vehicle.com_left, vehicle.com_height - vehicle.wheel_radius), struck(vehicle)
    while engine.time() < 2 * gap / speed:
        engine.step()
        forces.append(engine.obstacle_force())
        at_place = engine.velocity_at(place)[0]
        if at_place > 0:  # afterwards it may turn, if it was not hit at its centre of mass
            depths.append(engine.pose().x + front - face)
        if forces[-1] and (forces[-2] or not any(forces[:-1])):
            rebound = at_place
    return sum(forces) * engine.time_step, engine.velocity_at(centre)[0], rebound, float(np.max(depths))


def _wall(bench: Bench) -> list[Measurement]:
    with bench.open_engine() as engine:
        speed, step = engine.drive.speed, engine.drive.speed * engine.time_step
        # The result depends on the instant of the impact within a physics step.
        hits = [_hit(engine, 0.1 + part * step) for part in (0.0, 0.2, 0.4, 0.6, 0.8)]
    impulses, after, rebounds, depths = np.array(hits).T
    taken = bench.vehicle.mass * (speed - after)
    worst = int(np.argmax(np.abs(impulses - taken)))
    return [
        close_to("impulse, worst of 5 hits", "N s", float(taken[worst]), float(impulses[worst]), relative=1e-2),
        at_most("rebound, largest", "m/s", 0.2 * speed, float(np.max(np.abs(rebounds))), slack=0.1),
        at_most("penetration, largest", "mm", 1e3 * step, 1e3 * float(np.max(depths)), slack=0.1),
    ]


CONTACT = (
    Probe(
        name="locked-braking",
        title="Locked drive wheels brake by grip, which the shift of load to the caster lessens",
        closed_form="v^2/(2 d), d = mu g (1 - a/L) / (1 + mu h/L), and the caster's spin added to the mass",
        source="Gillespie, Fundamentals of Vehicle Dynamics, ch. 3 (rear axle braking)",
        measure=_locked_braking,
        applies=has_swivel_in_front,
    ),
    Probe(
        name="skids",
        title="On locked joints it slides as far as friction lets it, ahead and sideways",
        closed_form="v^2 / (2 mu g)",
        source="Gillespie, Fundamentals of Vehicle Dynamics, ch. 3 (constant deceleration)",
        measure=_skids,
        applies=has_swivel_in_front,
    ),
    Probe(
        name="friction-cone",
        title="Friction in a skid at 30, 45 and 60 degrees is all there is and no more",
        closed_form="sqrt(F_x^2 + F_y^2) = mu N",
        source="Lynch and Park, Modern Robotics, 12.2.1 (Coulomb friction and friction cones)",
        measure=_friction_cone,
        applies=has_swivel_in_front,
    ),
    Probe(
        name="wall",
        title="A wall takes the momentum and gives none back: free flight into it, joints locked",
        closed_form=(
            "impulse = m (v_before - v_after); restitution 0 where it is struck. An engine feels contact up to a step "
            "late, v dt deep, and pushes a fifth of that out again a step: rebound <= 0.2 v"
        ),
        source=(
            "Beer and Johnston, Vector Mechanics for Engineers: Dynamics, ch. 13 (impulse and momentum, impact); "
            "Baumgarte, Stabilization of constraints, Comput. Methods Appl. Mech. Eng. 1 (1972)"
        ),
        measure=_wall,
    ),
)
