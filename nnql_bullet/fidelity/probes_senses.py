"""Probes of the sensor's rays and of the engine's determinism."""

from dataclasses import replace
from math import pi

import numpy as np

from nnql_bullet import paper
from nnql_bullet.fidelity.probe import MIDDLE, Bench, Measurement, Probe, at_most, open_ground
from nnql_bullet.geometry import Array, OrientedBox, Pose, placed, ray_distances
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.sensing import Sensor
from nnql_bullet.sim.contact import ContactEngine
from nnql_bullet.worlds.spec import WorldSpec

SIDE = 40.0
"""Side of the worlds with boxes [m]."""
GRAZING = 1e-5
"""Uncertainty of a ray's direction, which matters where a ray passes an edge [rad]."""
SKIN = 1e-3
"""How near a surface Bullet ends a ray, the radius in its `btGjkConvexCast`: along a ray that grazes a face it is more
[m]."""


def _cluttered(seed: int, generator: np.random.Generator) -> WorldSpec:
    """Draws a walled arena with 25 boxes at any position and yaw, which may overlap."""
    rows = np.column_stack(
        [
            generator.uniform(0.0, SIDE, (25, 2)),
            generator.uniform(0.1, 3.0, (25, 2)),
            generator.uniform(-pi, pi, 25),
        ]
    )
    boxes = tuple(OrientedBox(*row) for row in rows.tolist())
    middle = Pose(SIDE / 2, SIDE / 2, 0.0)
    return WorldSpec("boxes anywhere", seed, SIDE, SIDE, boxes, middle, (SIDE - 2.0, SIDE - 2.0), 1.0, 1.5)


def _analytic(sensor: Sensor, eye: tuple[float, float], yaw: float, world: WorldSpec, skin: float = 0.0) -> Array:
    """Computes the distances of the rays to the world's boxes, larger by a skin on all sides [m]."""
    return ray_distances(eye, sensor.angles + yaw, world.solids + np.array([0, 0, skin, skin, 0, 0, 0]), sensor.range)


def _largest_error(bench: Bench) -> Measurement:
    errors, sensor = [], bench.vehicle.sensor
    with bench.open_engine() as engine:
        for seed in range(6):
            generator = rng(seed, Stream.LAYOUT)
            world = _cluttered(seed, generator)
            for x, y, yaw in generator.uniform((1.0, 1.0, -pi), (SIDE - 1.0, SIDE - 1.0, pi), (6, 3)).tolist():
                eye = placed(Pose(x, y, yaw), *sensor.position[:2])
                if _analytic(sensor, eye, yaw, world).min() < 0.05:
                    continue  # an engine does not report a box that contains the origin of a ray
                engine.place(world, Pose(x, y, yaw), 0.0)
                read = engine.scan()
                beside = [yaw + nudge for nudge in (-GRAZING, 0.0, GRAZING)]
                farthest = np.max([_analytic(sensor, eye, it, world) for it in beside], axis=0)
                nearest = np.min([_analytic(sensor, eye, it, world, SKIN) for it in beside], axis=0)
                errors.append(float(np.max(np.maximum(nearest - read, read - farthest))))
    return at_most("error in 25 boxes, largest", "mm", 1.0, 1e3 * max(0.0, *errors))


def _hits(engine: ContactEngine, world: WorldSpec) -> int:
    """Counts the rays that meet anything when the vehicle stands in the middle."""
    engine.place(world, MIDDLE, 0.0)
    return int(np.sum(~(engine.scan() == engine.vehicle.sensor.range)))


def _heights(bench: Bench) -> list[Measurement]:
    """Compares a box that ends just below the rays with one that ends just above them."""
    sensor = bench.vehicle.sensor
    x, y = placed(MIDDLE, *sensor.position[:2])
    box = OrientedBox(x + 4.0, y, 1.0, 1.0)
    seen = int(np.sum(sensor.met(_analytic(sensor, (x, y), 0.0, open_ground(box)))))
    height = bench.vehicle.sensor_height
    margin = min(0.02, height / 2)
    with bench.open_engine() as engine:
        over = _hits(engine, replace(open_ground(box), obstacle_height=height - margin))
        under = _hits(engine, replace(open_ground(box), obstacle_height=height + margin))
    return [
        at_most(f"rays that meet a box {1e3 * margin:.0f} mm lower", "", 0, over),
        at_most(f"rays that miss a box {1e3 * margin:.0f} mm higher", "", 0, abs(seen - under)),
    ]


def _own_body(bench: Bench) -> Measurement:
    """Counts rays that meet the vehicle or the ground, from origins close to both."""
    vehicle = bench.vehicle
    front = vehicle.casters[0]
    behind, axle = vehicle.footprint.x - vehicle.footprint.half_length - 0.3, 0.0
    hits = 0
    for position in (
        vehicle.sensor.position,
        (0.0, vehicle.track / 6, axle),  # between the wheels
        (front.x - 2 * front.radius, 0.0, front.radius - vehicle.wheel_radius),
        (behind, 0.0, axle),
        (behind, 0.0, 1e-3 - vehicle.wheel_radius),  # a millimetre above the ground
    ):
        with bench.open_engine(replace(vehicle, sensor=replace(vehicle.sensor, position=position))) as engine:
            hits += _hits(engine, open_ground())
            engine.advance(paper.TURNS[1])  # the vehicle leans in a turn
            hits += int(np.sum(~(engine.scan() == engine.vehicle.sensor.range)))
    return at_most("rays that meet the vehicle or the ground", "", 0, hits)


def _rays(bench: Bench) -> list[Measurement]:
    return [_largest_error(bench), *_heights(bench), _own_body(bench)]


def _drive(engine: ContactEngine, world: WorldSpec) -> Array:
    """Drives a series of decisions and returns motions, speeds and scans in one row."""
    seen: list[float] = []
    engine.reset(world)
    for turn in (0.0, 0.5, -1.0, 0.3, 0.9, -0.2, 0.0, -0.7):
        motion = engine.advance(turn)
        seen += [motion.pose.x, motion.pose.y, motion.pose.yaw, engine.speed(), motion.yaw_rate, *engine.wheel_speeds()]
        seen += [motion.duration, motion.path_length, motion.clearance, *engine.scan().tolist()]
    return np.array(seen)


def _determinism(bench: Bench) -> list[Measurement]:
    here, there = (_cluttered(seed, rng(seed, Stream.LAYOUT)) for seed in (10, 11))
    with bench.open_engine() as first, bench.open_engine() as second:
        once, twice = _drive(first, here), _drive(second, here)
        _drive(second, there)
        second.command_wheels(50.0, -50.0)
        second.step()
        afterwards = _drive(second, here)
    return [
        at_most("values that differ in another simulator", "", 0, int(np.sum(once != twice))),
        at_most("values that differ after another world", "", 0, int(np.sum(once != afterwards))),
    ]


SENSES = (
    Probe(
        name="rays",
        title="Rays read the distance to boxes, and see nothing else",
        closed_form="slab method: largest entry and smallest exit over the faces of each box",
        source="Kay and Kajiya, Ray tracing complex scenes, SIGGRAPH 1986",
        measure=_rays,
    ),
    Probe(
        name="determinism",
        title="The same calls give the same numbers, bit for bit",
        closed_form="x(calls) = x(calls)",
        source="the contract of a engine: what follows a reset is a function of the calls since then",
        measure=_determinism,
    ),
)
