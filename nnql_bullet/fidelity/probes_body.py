"""Probes of the vehicle's body: masses, inertia, standing, falling, turning and tipping."""

from math import cos, degrees, hypot, isnan, nan, sin, tan

import numpy as np

from nnql_bullet.constants import GRAVITY
from nnql_bullet.fidelity.probe import MIDDLE, Bench, Measurement, Probe, at_most, close_to, open_ground, step_factor
from nnql_bullet.fidelity.probes_vehicles import has_swivel_in_front, on_ice, rolling_freely, top_heavy
from nnql_bullet.geometry import Array, Pose
from nnql_bullet.sim.contact import ContactEngine
from nnql_bullet.vehicle.description import parse
from nnql_bullet.vehicle.limits import tip_angle
from nnql_bullet.vehicle.payload import physics_text
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.stances import loads_at_rest

ASKEW = Pose(MIDDLE.x, MIDDLE.y, 0.3)
"""A pose in which no axis of the vehicle is parallel to one of the world."""

SLOP = 0.01
"""Depth to which PyBullet lets any contact sink, whatever the size of the bodies [mm]."""


def _inertials(vehicle: VehicleSpec) -> dict[str, tuple[float, Array]]:
    """Reads the mass [kg] and ascending principal moments of inertia (3,) [kg m2] of every link from the URDF."""
    found = {}
    for link in parse(physics_text(vehicle)).iter("link"):
        mass = float(link.find("inertial/mass").attrib["value"])  # type: ignore[union-attr]
        i = {k: float(v) for k, v in link.find("inertial/inertia").attrib.items()}  # type: ignore[union-attr]
        rows = [[i["ixx"], i["ixy"], i["ixz"]], [i["ixy"], i["iyy"], i["iyz"]], [i["ixz"], i["iyz"], i["izz"]]]
        found[link.attrib["name"]] = mass, np.linalg.eigvalsh(np.array(rows))
    return found


def _read_back(bench: Bench) -> list[Measurement]:
    vehicle = bench.vehicle
    with bench.open_engine() as engine:
        engine.reset(open_ground())
        held = engine.link_dynamics()
    inertials = _inertials(vehicle)
    rows = [at_most("links that only one of the two has", "", 0, len(held.keys() ^ inertials.keys()))]
    for name, (mass, moments) in inertials.items():
        if name in held:
            there = np.sort(held[name].inertia)
            worst = int(np.argmax(np.abs(there / moments - 1)))  # the index of a NaN, if there is one
            rows += [
                close_to(f"mass of {name}", "kg", mass, held[name].mass, relative=1e-6),
                close_to(f"inertia of {name}", "kg m2", moments[worst], there[worst], relative=1e-6),
            ]
    contact, links = vehicle.contact, vehicle.links
    drives = links["left_drive"], links["right_drive"]
    frictions = {name: contact.wheel_friction for name in drives}
    for its in vehicle.casters:
        frictions[its.link] = contact.wheel_friction if its.swivels else contact.ball_friction
    for name, friction in frictions.items():
        rows.append(close_to(f"friction of {name}", "", friction, held[name].friction, relative=1e-6))
    for name in drives:
        rolling, spinning = held[name].rolling_friction, held[name].spinning_friction
        rows += [
            close_to(f"rolling friction of {name}", "m", contact.rolling_friction, rolling, relative=1e-6),
            close_to(f"spinning friction of {name}", "m", contact.spinning_friction, spinning, relative=1e-6),
        ]
    others = [(link.rolling_friction, link.spinning_friction) for name, link in held.items() if name not in drives]
    rows.append(at_most("rolling or spinning friction of the other links", "m", 0, float(np.max(others))))
    return rows


def _settle(bench: Bench) -> list[Measurement]:
    vehicle = bench.vehicle
    with bench.open_engine(rolling_freely(vehicle)) as engine:  # rolling resistance would transmit a moment at rest
        engine.place(open_ground(), ASKEW, 0.0)
        engine.run(2.0)
        heights, loads = engine.wheel_heights(), engine.wheel_loads()
    weight = vehicle.mass * GRAVITY
    if has_swivel_in_front(vehicle):
        rear, front = weight * vehicle.rear_share / 2, weight * vehicle.com_ahead / vehicle.wheelbase
        expectations = [rear, rear, front]
    else:
        expectations = (weight * loads_at_rest(vehicle)).tolist()
    radii = vehicle.wheel_radius, vehicle.wheel_radius, *(its.radius for its in vehicle.casters)
    casters = [f"caster {number}" for number in range(1, len(vehicle.casters) + 1)]
    wheels = "left wheel", "right wheel", *(casters if len(casters) > 1 else ["caster"])
    determined = len(vehicle.casters) == 1
    return [
        *(
            close_to(f"height of {wheel}", "mm", 1e3 * radius, 1e3 * height, absolute=SLOP + 0.04 * bench.size)
            for wheel, radius, height in zip(wheels, radii, heights, strict=True)
        ),
        *(
            close_to(f"load on {wheel}", "N", expected, load, relative=5e-3)
            for wheel, expected, load in zip(wheels, expectations, loads, strict=True)
            if determined
        ),
    ]


def _creep(bench: Bench) -> list[Measurement]:
    with bench.open_engine() as engine:
        engine.place(open_ground(), ASKEW, 0.0)
        engine.command_wheels(0.0, 0.0)
        engine.run(10.0)
        pose = engine.pose()
        # What the solver leaves of the weight in a step is a speed, to be small beside the vehicle's own or its size.
        limit = 0.5 * max(bench.size, bench.pace) * step_factor(engine)
    way = hypot(pose.x - ASKEW.x, pose.y - ASKEW.y)
    return [at_most("way in 10 s", "mm", limit, 1e3 * way)]


def _free_fall(bench: Bench) -> list[Measurement]:
    with bench.open_engine() as engine:
        engine.place(open_ground(), ASKEW, 0.0, height=50.0, ground=False)
        engine.run(1.0)
        fallen, time = -engine.velocity()[2], engine.time()
    return [
        close_to("time", "s", 1.0, time, relative=1e-6),
        close_to("speed", "m/s", GRAVITY * time, fallen, relative=1e-6),
    ]


def _yaw_inertia(bench: Bench) -> list[Measurement]:
    torque = bench.vehicle.yaw_inertia  # for 1 rad/s2
    with bench.open_engine(on_ice(bench.vehicle)) as engine:
        engine.place(open_ground(), ASKEW, 0.0)
        engine.lock_joints()
        engine.run(0.5)
        before, time = engine.yaw_rate(), engine.time()
        for _ in range(round(1.0 / engine.time_step)):
            engine.twist(torque)
            engine.step()
        gained, time = engine.yaw_rate() - before, engine.time() - time
    return [close_to("yaw rate", "rad/s", torque * time / bench.vehicle.yaw_inertia, gained, relative=5e-3)]


def _tilted_until_it_tips(engine: ContactEngine, side: int, slope: float) -> float:
    """Tilts gravity and measures the slope above which the upper rear wheel carries no load [rad].

    Args:
        engine: The engine with the vehicle.
        side: 1 for a slope down to the left, -1 to the right.
        slope: The expected slope [rad].
    """
    engine.place(open_ground(), MIDDLE, 0.0)
    engine.lock_joints()
    engine.run(0.5)
    upper = 1 if side > 0 else 0
    nothing = 1e-3 * engine.wheel_loads()[upper]
    tilt, lifted = 0.0, nan
    while tilt < 1.1 * slope:
        tilt += slope * engine.time_step * (0.8 if tilt < 0.8 * slope else 0.2)
        engine.set_gravity((0.0, side * GRAVITY * sin(tilt), -GRAVITY * cos(tilt)))
        engine.step()
        if engine.wheel_loads()[upper] > nothing:  # a wheel that is about to lift may touch again
            lifted = nan
        elif isnan(lifted):
            lifted = tilt
    return lifted


def _tilt_table(bench: Bench) -> list[Measurement]:
    vehicle = top_heavy(bench.vehicle)
    slope = tip_angle(vehicle)
    rows = []
    with bench.open_engine(rolling_freely(vehicle).gripping(max(1.0, 3 * tan(slope)))) as engine:
        for side, name in ((1, "left"), (-1, "right")):
            tipped, tolerance = _tilted_until_it_tips(engine, side, slope), 0.25 * step_factor(engine)
            rows.append(close_to(f"slope to the {name}", "deg", degrees(slope), degrees(tipped), absolute=tolerance))
    return rows


BODY = (
    Probe(
        name="read-back",
        title="The engine holds the URDF's masses and inertia, and the TOML's friction",
        closed_form="m, eigenvalues of I, friction: what is read is what was written",
        source="URDF specification, <inertial>; Goldstein, Poole and Safko, Classical Mechanics, 5.4 (principal axes)",
        measure=_read_back,
    ),
    Probe(
        name="settle",
        title="It stands on its wheel radii with the static loads",
        closed_form="z = r; N_rear = m g (1 - a/L) / 2 each, N_front = m g a/L",
        source="Gillespie, Fundamentals of Vehicle Dynamics, ch. 1 (static loads on level ground)",
        measure=_settle,
    ),
    Probe(
        name="creep",
        title="It stays where it stands",
        closed_form="x(t) = x(0)",
        source="Lynch and Park, Modern Robotics, 12.2 (forces within the friction cones balance gravity)",
        measure=_creep,
    ),
    Probe(
        name="free-fall",
        title="It falls without resistance",
        closed_form="v = g t",
        source="Goldstein, Poole and Safko, Classical Mechanics, 1.1 (Newton's second law)",
        measure=_free_fall,
    ),
    Probe(
        name="yaw-inertia",
        title="A torque about the vertical turns it, joints locked, on ice",
        closed_form="w = M t / Izz",
        source="Goldstein, Poole and Safko, Classical Mechanics, 5.3 (moment of inertia, parallel axes)",
        measure=_yaw_inertia,
    ),
    Probe(
        name="tilt-table",
        title="Top-heavy on a slope, it tips when the upper wheel's load is gone",
        closed_form="tan(slope) = (T/2) (1 - a/L) / h",
        source="Gillespie, Fundamentals of Vehicle Dynamics, ch. 9 (quasi-static rollover), with one front wheel",
        measure=_tilt_table,
        applies=has_swivel_in_front,
    ),
)
