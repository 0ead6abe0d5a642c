"""What is found block by block is what is found among all shapes, bit for bit."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest

from nnql_bullet.blocks import (
    MANY_SHAPES,
    SHAPES_PER_BLOCK,
    _meet,
    bounds_of,
    by_place,
    cast_rays,
    clearance_among,
)
from nnql_bullet.geometry import Array, Circle, OrientedBox, Pose, Shape, as_rows, clearance_at, ray_distances
from nnql_bullet.sim import kinematic, physics
from nnql_bullet.sim.engines import contact_engine
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.worlds.spec import Patrol, WorldSpec

SIDE = 60.0
FOOTPRINT = as_rows((OrientedBox(0.5, 0.1, 1.0, 0.5),))[0]


def scattered(seed: int, count: int, grid: bool = False) -> tuple[Shape, ...]:
    """Boxes and circles, some of them long, that may overlap; on a grid, rays graze edges and corners."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, SIDE, (count, 2))
    sizes = np.where(rng.random((count, 1)) < 0.05, 4.0, 0.3) * rng.uniform(0.1, 2, (count, 2))
    yaws = rng.uniform(-pi, pi, count)
    if grid:
        places, sizes, yaws = places.round(), np.maximum(sizes.round(), 0.5), np.zeros(count)
    rows = np.column_stack([places, sizes, yaws]).tolist()
    return tuple(Circle(*row[:3]) if k % 3 == 0 else OrientedBox(*row) for k, row in enumerate(rows))


def cast_at_all(x: float, y: float, yaw: float, directions: Array, rows: Array) -> Array:
    """Every ray against every shape."""
    distances = np.full(len(directions), 10.0)
    for row in rows:
        _meet(row, row[0] - x, row[1] - y, np.cos(yaw), np.sin(yaw), directions, distances)
    return np.minimum(distances, 10.0)


def evenly(rays: int, first: float) -> tuple[Array, Array]:
    angles = first + np.arange(rays) * (2 * pi / rays)
    return angles, np.column_stack([np.cos(angles), np.sin(angles)])


@pytest.mark.parametrize("grid", [False, True])
@pytest.mark.parametrize(("seed", "count", "rays"), [(0, 5, 72), (1, 40, 72), (2, 700, 8), (3, 700, 360), (4, 2000, 1)])
def test_rays_and_clearances_are_those_among_all_shapes(seed, count, rays, grid):
    rng, shapes = np.random.default_rng(seed), by_place(scattered(seed, count, grid))
    rows, bounds = as_rows(shapes), bounds_of(as_rows(shapes))
    angles, directions = evenly(rays, rng.uniform(-pi, pi))
    if grid:
        angles, directions = evenly(rays, 0.0)
    for x, y, yaw in rng.uniform((0, 0, -pi), (SIDE, SIDE, pi), (60, 3)).tolist():
        if grid:
            x, y, yaw = round(x), round(y), 0.0
        found = np.empty(rays)
        cast_rays(x, y, yaw, directions, rows, bounds, 10.0, found)
        assert found.tolist() == cast_at_all(x, y, yaw, directions, rows).tolist()
        if not grid:
            assert found == pytest.approx(ray_distances((x, y), angles + yaw, rows, 10.0), abs=1e-9)
        expected = clearance_at(x, y, yaw, FOOTPRINT, rows)
        assert clearance_among(x, y, yaw, FOOTPRINT, rows, bounds) == expected


def test_nothing_is_infinitely_far():
    rows, found = as_rows(()), np.empty(8)
    assert clearance_among(0.0, 0.0, 0.0, FOOTPRINT, rows, bounds_of(rows)) == np.inf
    cast_rays(0.0, 0.0, 0.0, evenly(8, 0.0)[1], rows, bounds_of(rows), 10.0, found)
    assert found.tolist() == [10.0] * 8


def test_bounds_hold_the_corners_of_boxes_and_the_rims_of_circles():
    shapes = by_place(scattered(0, MANY_SHAPES + 5))
    bounds = bounds_of(as_rows(shapes), moving=3)
    for k, shape in enumerate(shapes[:-3]):
        if isinstance(shape, Circle):
            points = np.array([[shape.x, shape.y]]) + shape.radius * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        else:
            points = shape.corners()
        low, high = bounds[k // SHAPES_PER_BLOCK, :2], bounds[k // SHAPES_PER_BLOCK, 2:]
        assert (points >= low).all() and (points <= high).all()
    assert bounds[-1].tolist() == [-np.inf, -np.inf, np.inf, np.inf]
    assert np.median(np.ptp(bounds[:-1].reshape(-1, 2, 2), axis=1)) < SIDE / 2


def test_many_shapes_are_sorted_by_place_and_few_stay_in_their_order():
    rng = np.random.default_rng(0)
    few = tuple(Circle(*place, 0.1) for place in rng.uniform(0, 100, (200, 2)).tolist())
    assert by_place(few) == few
    many = tuple(Circle(*place, 0.1) for place in rng.uniform(0, 100, (1600, 2)).tolist())
    found = by_place(many)
    assert sorted(found, key=hash) == sorted(many, key=hash)
    # 100 groups of 16 are squares of 10 m, give and take.
    groups = np.array([(its.x, its.y) for its in found]).reshape(100, 16, 2)
    assert np.median(np.ptp(groups, axis=1), axis=0) == pytest.approx([10.0, 10.0], abs=3.0)


def crowded(seed: int, count: int) -> WorldSpec:
    """A world of many shapes with patrols, and room around the start."""
    free = [shape for shape in scattered(seed, count) if np.hypot(shape.x - 30, shape.y - 30) > 6]
    crossing = Patrol(OrientedBox(20.0, 34.0, 0.5, 0.5), (40.0, 34.0), 1.0, 0.2)
    along = Patrol(OrientedBox(34.0, 20.0, 0.5, 0.5), (34.0, 40.0), 0.7, 0.9)
    return WorldSpec("crowded", 0, SIDE, SIDE, tuple(free), Pose(30, 30, 0.5), (59, 59), 0.5, 1.5, (crossing, along))


@pytest.mark.parametrize("seed", range(3))
def test_the_kinematic_model_drives_as_among_all_shapes(vehicle, monkeypatch, seed):
    world, runs = crowded(seed, 900), []
    few = replace(world, obstacles=world.obstacles[:30])
    for everywhere in (False, True):
        if everywhere:
            monkeypatch.setattr(kinematic, "bounds_of", lambda rows, moving: bounds_of(rows, len(rows)))
        simulator, turns = KinematicSimulator(vehicle, DriveOptions(), 3, threads=1), np.random.default_rng(seed)
        run: list[object] = [its.tolist() for its in simulator.reset({0: few, 2: world})]
        run += [its.tolist() for its in simulator.reset({1: world})]  # needs no more room
        for _ in range(25):
            motion, rays = simulator.advance(turns.uniform(-1, 1, 3))
            run += [motion.pose.tolist(), motion.clearance.tolist(), motion.touching.tolist(), rays.tolist()]
        simulator.close()
        runs.append(run)
    assert runs[0] == runs[1]


@pytest.mark.parametrize("engine", ["bullet", "mujoco"])
@pytest.mark.parametrize("turn", [0.0, 0.25])
def test_an_engine_that_holds_what_is_near_drives_as_one_that_holds_everything(vehicle, monkeypatch, engine, turn):
    """Down a lane with a box at its end, and round in a circle, until it touches something."""
    rng, runs = np.random.default_rng(0), []
    places = [its for its in rng.uniform(0, 120, (1500, 2)).tolist() if abs(its[1] - 60) > 2.5 or its[0] > 45]
    shapes = [Circle(x, y, 0.1) if k % 4 == 0 else OrientedBox(x, y, 0.4, 0.1, x) for k, (x, y) in enumerate(places)]
    patrol = Patrol(OrientedBox(20.0, 75.0, 0.5, 0.5), (40.0, 75.0), 1.0, 0.2)
    start = Pose(8.0, 60.0, 0.0)
    world = WorldSpec("lane", 0, 120.0, 120.0, tuple(shapes), start, (119, 119), 0.5, 1.5, (patrol,))
    held: list[int] = []
    for room in (physics.ROOM, 1000.0):
        monkeypatch.setattr(physics, "ROOM", room)
        driver = contact_engine(engine, "fast", vehicle, DriveOptions())
        driver.reset(world)
        held.append(int(driver._near.sum()))
        run: list[object] = [driver.scan().tolist()]
        for _ in range(60):
            motion = driver.advance(turn)
            run += [motion, driver.scan().tolist()]
            if motion.touching:
                break
        assert motion.touching and motion.path_length > 0
        runs.append(run)
        driver.close()
    assert runs[0] == runs[1]
    assert held[0] < held[1] / 4
