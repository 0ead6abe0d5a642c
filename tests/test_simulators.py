"""The contract of a simulator: one vehicle, and several of which each does, bit for bit, what it does alone."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, fields, replace
from functools import partial
from importlib.util import find_spec
from itertools import pairwise
from math import cos, hypot, pi, radians, sin
from typing import Any

import numpy as np
import pytest
import shapely
from helpers import Alone, row
from hypothesis import example, given, reject, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon
from shapely.ops import unary_union

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, Circle, OrientedBox, Pose, moved, placed, ray_distances
from nnql_bullet.sensing import ray_angles
from nnql_bullet.sim.base import Motion, Sample, Simulator
from nnql_bullet.sim.engines import contact_simulator
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.sim.workers import WorkerSimulator
from nnql_bullet.vehicle.controller import COMMAND_RATE, DriveOptions
from nnql_bullet.vehicle.profiles import plan_turn, sample_turn
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.source import load_world
from nnql_bullet.worlds.spec import Patrol, WorldSpec

DRIVE, PERIOD = DriveOptions(), DriveOptions().decision_period
SIZE = 6
MAKERS: dict[str, Callable[[VehicleSpec, DriveOptions, int], Simulator]] = {
    "kinematic": KinematicSimulator,
    "bullet, reference": partial(contact_simulator, "bullet", "reference"),
    "bullet, fast": partial(contact_simulator, "bullet", "fast"),
    "mujoco, reference": partial(contact_simulator, "mujoco", "reference"),
    "mujoco, fast": partial(contact_simulator, "mujoco", "fast"),
    "workers": lambda vehicle, drive, size: WorkerSimulator(
        partial(contact_simulator, "bullet", "fast", vehicle, drive), size, min(size, 2)
    ),
}
"""Every simulator; a new one is added here and has to pass the contract below."""
NEEDS_MUJOCO = pytest.mark.skipif(
    find_spec("mujoco") is None, reason="needs the extra: pip install 'nnql-bullet[mujoco]'"
)
NAMES = [pytest.param(name, marks=NEEDS_MUJOCO) if "mujoco" in name else name for name in MAKERS if name != "workers"]
KINDS = ("kinematic", "bullet, fast", pytest.param("mujoco, fast", marks=NEEDS_MUJOCO), "workers")

WorldOf = Callable[..., WorldSpec]


BOXES = (
    OrientedBox(112.0, 103.0, 1.5, 0.5, 0.4),
    OrientedBox(105.0, 96.0, 2.0, 1.0, -0.3),
    OrientedBox(98.0, 106.0, 1.0, 1.0, 0.0),
)
TURNS = (0.4, -0.8, 0.3, 0.0, 1.0, -0.2)


@pytest.fixture(params=NAMES)
def simulator(request: pytest.FixtureRequest, vehicle: VehicleSpec) -> Iterator[Alone]:
    with Alone(MAKERS[request.param](vehicle, DRIVE, 1)) as made:
        yield made


def footprint_at(pose: Pose) -> Polygon:
    c, s = cos(pose.yaw), sin(pose.yaw)
    corners = [(0.90, 0.325), (-0.20, 0.325), (-0.20, -0.325), (0.90, -0.325)]
    return Polygon([(pose.x + c * x - s * y, pose.y + s * x + c * y) for x, y in corners])


class TestOneVehicle:
    def test_reset_puts_the_vehicle_on_the_start(self, simulator: Alone, world_of: WorldOf) -> None:
        start = Pose(50.0, 60.0, -2.5)
        simulator.reset(world_of(start=start))
        pose = simulator.pose
        assert (pose.x, pose.y, pose.yaw) == pytest.approx((start.x, start.y, start.yaw), abs=1e-9)

    def test_it_starts_at_speed(self, simulator: Alone, empty_world: WorldSpec) -> None:
        simulator.reset(empty_world)
        motion = simulator.advance(0.0)
        assert motion.path_length == pytest.approx(2.0 * PERIOD, rel=1e-3)
        assert simulator.end.wheel_speeds == pytest.approx((16.0, 16.0), rel=1e-3)
        assert motion.duration == pytest.approx(PERIOD)

    def test_it_starts_at_rest_where_the_world_says_so(self, simulator: Alone, empty_world: WorldSpec) -> None:
        simulator.reset(replace(empty_world, at_rest=True))
        acceleration = simulator.simulator.vehicle.limits.acceleration
        assert acceleration * PERIOD < 2.0
        motion = simulator.advance(0.0)
        assert motion.speed == pytest.approx(acceleration * PERIOD, rel=1e-2)
        assert motion.path_length == pytest.approx(acceleration * PERIOD**2 / 2, rel=2e-2)
        simulator.reset(empty_world)
        assert simulator.advance(0.0).path_length == pytest.approx(2.0 * PERIOD, rel=1e-3)

    def test_the_speed_is_that_of_the_body_over_the_ground(self, simulator: Alone, empty_world: WorldSpec) -> None:
        simulator.reset(empty_world)
        assert simulator.simulator.drive.speed == 2.0
        for turn, scale in ((0.6, 1.0), (-0.8, 0.5), (0.0, 0.0), (0.3, 0.0)):
            trace: list[Sample] = []
            motion = simulator.advance(turn, trace, scale)
            last, end = trace[-2:]
            along = np.array([cos(end.pose.yaw), sin(end.pose.yaw)])
            way = np.array([end.pose.x - last.pose.x, end.pose.y - last.pose.y]) @ along
            assert motion.speed == pytest.approx(way / (end.time - last.time), abs=0.05 + 2.5 / 60)
        assert motion.speed == pytest.approx(0.0, abs=1e-3)

    def test_a_positive_turn_goes_left(self, simulator: Alone, empty_world: WorldSpec) -> None:
        simulator.reset(empty_world)
        left = simulator.advance(radians(30))
        simulator.reset(empty_world)
        right = simulator.advance(radians(-30))
        assert left.pose.y > 100.0 > right.pose.y
        assert left.pose.yaw > 0.0 > right.pose.yaw
        assert (right.pose.x, 200.0 - right.pose.y) == pytest.approx((left.pose.x, left.pose.y), abs=2e-3)

    def test_motion_tells_where_the_vehicle_is(self, simulator: Alone, empty_world: WorldSpec) -> None:
        simulator.reset(empty_world)
        for turn in TURNS:
            before = simulator.pose
            motion = simulator.advance(turn)
            assert motion.pose == simulator.pose
            assert -pi < motion.pose.yaw <= pi
            straight = hypot(motion.pose.x - before.x, motion.pose.y - before.y)
            assert straight <= motion.path_length <= 1.05 * 2.0 * motion.duration
            left_over = (before.yaw + turn - motion.pose.yaw + pi) % (2 * pi) - pi
            assert motion.heading_error == pytest.approx(left_over, abs=1e-9)

    def test_it_follows_the_same_calls_with_the_same_bits(self, simulator: Alone, world_of: WorldOf) -> None:
        def drive(world: WorldSpec) -> list[Any]:
            simulator.reset(world)
            return [(simulator.advance(turn), simulator.rays.tolist()) for turn in TURNS]

        first = drive(world_of(*BOXES))
        other = drive(world_of(start=Pose(30.0, 30.0, 1.0)))
        assert drive(world_of(*BOXES)) == first != other

    def test_a_trace_changes_nothing_and_runs_through_the_period(
        self, simulator: Alone, empty_world: WorldSpec
    ) -> None:
        simulator.reset(empty_world)
        plain = [simulator.advance(turn) for turn in TURNS]
        trace: list[Sample] = []
        simulator.reset(empty_world)
        assert [simulator.advance(turn, trace) for turn in TURNS] == plain
        times = [sample.time for sample in trace]
        assert all(earlier < later for earlier, later in pairwise(times))
        assert 0.0 < times[0] <= 0.05
        assert times[-1] == pytest.approx(len(TURNS) * PERIOD)
        assert trace[-1].pose == plain[-1].pose
        assert len(trace) >= 20 * len(TURNS) * PERIOD

    def test_rays_meet_boxes_and_see_no_farther_than_10_m(self, simulator: Alone, world_of: WorldOf) -> None:
        simulator.reset(world_of(*BOXES))
        before = simulator.rays
        assert (before.shape, before.dtype) == ((72,), np.float64)
        assert 0.0 <= before.min() < 10.0 == before.max()
        kept = before.copy()
        simulator.advance(0.5)
        assert not np.array_equal(simulator.rays, before)
        assert np.array_equal(before, kept)

    def test_clearance_is_the_smallest_along_the_way(self, simulator: Alone, world_of: WorldOf) -> None:
        posts = [OrientedBox(102.0 + 3 * i, 100.0 + (1.4 if i % 2 else -1.2), 0.3, 0.4, 0.5 * i) for i in range(4)]
        solids = unary_union([Polygon(post.corners()) for post in posts])
        simulator.reset(world_of(*posts))
        for turn in (0.1, -0.1, 0.2, -0.25, 0.1, 0.0, 0.3, -0.2):
            trace: list[Sample] = []
            before = simulator.pose
            motion = simulator.advance(turn, trace)
            assert not motion.touching
            poses = [before, *(sample.pose for sample in trace)]
            expected = min(footprint_at(pose).distance(solids) for pose in poses)
            assert motion.clearance == pytest.approx(expected, abs=0.02)  # samples are 67 mm apart

    def test_contact_and_target_end_the_period(self, simulator: Alone, world_of: WorldOf) -> None:
        simulator.reset(world_of(OrientedBox(101.9, 100.0, 0.5, 1.0)))
        motion = simulator.advance(0.0)
        assert (motion.touching, motion.at_target, motion.clearance) == (True, False, 0.0)
        assert motion.duration == pytest.approx(0.25, abs=0.02)
        simulator.reset(world_of(target=(101.0, 100.0), target_radius=0.5))
        motion = simulator.advance(0.0)
        assert (motion.touching, motion.at_target) == (False, True)
        assert motion.duration == pytest.approx(0.25, abs=0.02)
        assert motion.clearance > 0.0

    def test_poles_are_seen_and_touched_where_they_stand(self, simulator: Alone, world_of: WorldOf) -> None:
        rng = np.random.default_rng(0)
        poles = [Circle(*place, radius) for *place, radius in rng.uniform((90, 90, 0.02), (110, 110, 0.6), (40, 3))]
        world = world_of(*(its for its in poles if hypot(its.x - 100, its.y - 100) > its.radius + 1.5))
        simulator.reset(world)
        eye = placed(simulator.pose, *load_vehicle("tricycle").sensor.position[:2])
        expected = ray_distances(eye, ray_angles() + simulator.pose.yaw, world.solids, 10.0)
        assert simulator.rays == pytest.approx(expected, abs=2e-3)
        simulator.reset(world_of(Circle(101.5, 100.02, 0.02)))
        motion = simulator.advance(0.0)
        assert (motion.touching, motion.clearance) == (True, 0.0)
        assert motion.pose.x == pytest.approx(101.48 - 0.9, abs=0.03)  # the footprint ends 0.9 m ahead of the axle

    @pytest.mark.parametrize("wall", ["left", "right", "top", "bottom"])
    def test_the_arena_is_walled_in(self, simulator: Alone, world_of: WorldOf, wall: str) -> None:
        yaw = {"left": pi, "right": 0.0, "top": pi / 2, "bottom": -pi / 2}[wall]
        simulator.reset(world_of(side=8.0, start=Pose(4.0, 4.0, yaw), target=(7.9, 7.9), target_radius=0.1))
        motions = [simulator.advance(0.0) for _ in range(4)]
        assert [motion.touching for motion in motions] == [False, False, False, True]
        assert sum(motion.duration for motion in motions) == pytest.approx((4.0 - 0.9) / 2.0, abs=0.03)

    def test_a_period_may_be_followed_by_a_reset_after_a_contact(
        self, simulator: Alone, world_of: WorldOf, empty_world: WorldSpec
    ) -> None:
        simulator.reset(empty_world)
        fresh = simulator.advance(0.3)
        simulator.reset(world_of(OrientedBox(101.9, 100.0, 0.5, 1.0)))
        assert simulator.advance(0.0).touching
        simulator.reset(empty_world)
        assert simulator.advance(0.3) == fresh

    @pytest.mark.parametrize("name", NAMES)
    def test_a_period_of_broken_steps_is_refused(self, vehicle: VehicleSpec, name: str) -> None:
        with pytest.raises(UserError, match=r"0\.123 s is not a whole number"):
            MAKERS[name](vehicle, DriveOptions(decision_period=0.123), 1)


@pytest.fixture(scope="module", params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def fleet(kind: str, vehicle: VehicleSpec) -> Iterator[Simulator]:
    """Six vehicles; every test resets those it looks at."""
    with closing(MAKERS[kind](vehicle, DRIVE, SIZE)) as made:
        yield made


@pytest.fixture(scope="module")
def alone(kind: str, vehicle: VehicleSpec) -> Iterator[Alone]:
    """What one of six vehicles is compared with: a vehicle in a simulator of its own, in this process."""
    with Alone(MAKERS["bullet, fast" if kind == "workers" else kind](vehicle, DRIVE, 1)) as simulator:
        yield simulator


@pytest.fixture(scope="module")
def worlds(world_of: Callable[..., WorldSpec]) -> list[WorldSpec]:
    """From none to hundreds of boxes, boxes that move, other starts, a contact and a target in the second period."""
    start = Pose(40.0, 60.0, 2.5)
    ahead = moved(OrientedBox(3.0, 0.1, 0.3, 1.0, 0.4), start)
    crossing = Patrol(OrientedBox(38.0, 58.0, 0.5, 0.4, 0.7), (36.0, 70.0), 0.9, 0.1)
    crossing_back = [Patrol(OrientedBox(12.0 + k, 9.0, 0.3, 0.6, 0.1 * k), (13.0 + k, 12.5), 1.0, 0.2) for k in (3, 4)]
    return [
        load_world("cover_20").draw(3, 0.8),
        world_of(),
        load_world("cover_10").draw(1, 0.8),
        world_of(ahead, start=start),
        world_of(start=start, target=(start.x + 3.5 * cos(start.yaw), start.y + 3.5 * sin(start.yaw))),
        replace(load_world("paper").draw(2, 0.8), start=Pose(10.0, 12.0, -0.3), patrols=(crossing, *crossing_back)),
        load_world("cover_20").draw(4, 0.8),
        load_world("moving").draw(4, 0.8),
        replace(world_of(start=start), patrols=(crossing, *crossing_back)),
    ]


@dataclass
class Diary:
    """What happened to one vehicle: its calls, and what came back."""

    calls: list[WorldSpec | float]
    answers: list[tuple[Any, list[float]]]


def driven(fleet: Simulator, calls: list[dict[int, WorldSpec] | tuple[Array, Array]]) -> list[Diary]:
    """Plays resets and (turns, active) to a fleet."""
    diaries = [Diary([], []) for _ in range(fleet.size)]
    for call in calls:
        if isinstance(call, dict):
            poses, rays = fleet.reset(call)
            for k, (vehicle, world) in enumerate(call.items()):
                diaries[vehicle].calls.append(world)
                diaries[vehicle].answers.append((Pose(*poses[k].tolist()), rays[k].tolist()))
        else:
            turns, active = call
            motions, rays = fleet.advance(turns, active)
            for vehicle in np.flatnonzero(active).tolist():
                diaries[vehicle].calls.append(float(turns[vehicle]))
                diaries[vehicle].answers.append((row(motions, vehicle), rays[vehicle].tolist()))
    return diaries


def answers_alone(simulator: Alone, calls: list[WorldSpec | float]) -> list[tuple[Any, list[float]]]:
    """What a vehicle alone answers to the calls that one of several got."""
    answers: list[tuple[Any, list[float]]] = []
    for call in calls:
        if isinstance(call, WorldSpec):
            simulator.reset(call)
            answers.append((simulator.pose, simulator.rays.tolist()))
        else:
            answers.append((simulator.advance(call), simulator.rays.tolist()))
    return answers


def restless(worlds: list[WorldSpec], size: int, seed: int) -> list[dict[int, WorldSpec] | tuple[Array, Array]]:
    """Turns of all kinds; now and then somebody stands by, and some are put into other worlds in between."""
    generator = np.random.default_rng(seed)
    calls: list[dict[int, WorldSpec] | tuple[Array, Array]] = [{i: worlds[i % len(worlds)] for i in range(size)}]
    for period in range(10):
        if period in (4, 7):
            again = generator.choice(size, 2 if size > 1 else 1, replace=False).tolist()
            calls.append({i: worlds[(i + period) % len(worlds)] for i in again})
        calls.append((generator.uniform(-1.1, 1.1, size), generator.random(size) < (1.0 if period < 3 else 0.75)))
    return calls


class TestSeveralVehicles:
    def test_each_vehicle_does_what_a_simulator_does_alone(
        self, fleet: Simulator, alone: Alone, worlds: list[WorldSpec]
    ) -> None:
        diaries = driven(fleet, restless(worlds, SIZE, seed=1))
        for diary in diaries:
            assert diary.answers == answers_alone(alone, diary.calls)
        for event in ("touching", "at_target"):
            assert any(getattr(what, event, False) for diary in diaries for what, _ in diary.answers), event

    @pytest.mark.parametrize("kind", KINDS[:-1], indirect=True)  # the rest is in test_workers.py
    @pytest.mark.parametrize("size", [1, 3])
    def test_the_number_of_vehicles_makes_no_difference(
        self, kind: str, vehicle: VehicleSpec, alone: Alone, worlds: list[WorldSpec], size: int
    ) -> None:
        with closing(MAKERS[kind](vehicle, DRIVE, size)) as fleet:
            assert fleet.size == size
            for diary in driven(fleet, restless(worlds, size, seed=size)):
                assert diary.answers == answers_alone(alone, diary.calls)

    def test_who_stands_by_is_where_it_was_and_its_neighbours_do_not_notice(
        self, fleet: Simulator, worlds: list[WorldSpec]
    ) -> None:
        turns, everybody = np.linspace(-0.9, 0.9, SIZE), np.ones(SIZE, np.bool_)
        begin = {i: worlds[1 + i % 2] for i in range(SIZE)}
        somebody = everybody.copy()
        somebody[[1, 4]] = False
        nobody = ~everybody
        straight = driven(fleet, [begin, (turns, everybody), (-turns, everybody), (turns, somebody)])
        halting = driven(
            fleet,
            [begin, (turns, everybody), (turns, nobody), (-turns, somebody), (-turns, ~somebody), (turns, somebody)],
        )
        assert halting == straight
        assert [len(diary.answers) for diary in straight] == [4, 3, 4, 4, 3, 4]

    def test_rows_of_a_reset_come_in_the_order_asked_for(
        self, fleet: Simulator, alone: Alone, worlds: list[WorldSpec]
    ) -> None:
        turns, everybody = np.full(SIZE, 0.4), np.ones(SIZE, np.bool_)
        some = {4: worlds[0], 1: worlds[5], 5: worlds[3], 0: worlds[2]}
        before, after = {i: worlds[2] for i in range(SIZE)}, (turns, everybody)
        diaries = driven(fleet, [before, after, some, after])
        poses, rays = fleet.reset(some)
        assert poses.shape == (4, 3)
        assert rays.shape == (4, 72)
        expected = [answers_alone(alone, [world])[0] for world in some.values()]
        assert [Pose(*pose) for pose in poses.tolist()] == [pose for pose, _ in expected]
        assert rays.tolist() == [seen for _, seen in expected]
        for diary in diaries:
            assert diary.answers == answers_alone(alone, diary.calls)

    def test_traces_are_those_of_the_vehicle_alone(
        self, fleet: Simulator, alone: Alone, worlds: list[WorldSpec]
    ) -> None:
        traces: dict[int, list[Sample]] = {4: [], 1: []}
        fleet.reset(dict(enumerate(worlds[:SIZE])))
        for turn in TURNS[:3]:
            fleet.advance(np.full(SIZE, turn), None, None, traces)
        for i, trace in traces.items():
            expected: list[Sample] = []
            alone.reset(worlds[i])
            for turn in TURNS[:3]:
                alone.advance(turn, expected)
            assert trace == expected

    def test_nobody_has_to_be_reset_or_to_drive(self, fleet: Simulator, worlds: list[WorldSpec]) -> None:
        fleet.reset({i: worlds[1] for i in range(SIZE)})
        poses, rays = fleet.reset({})
        assert poses.shape == (0, 3)
        assert rays.shape == (0, 72)
        motions, rays = fleet.advance(np.zeros(SIZE), np.zeros(SIZE, np.bool_))
        assert motions.pose.shape == (SIZE, 3)
        assert rays.shape == (SIZE, 72)

    def test_shapes_and_kinds_of_what_is_returned(self, fleet: Simulator, worlds: list[WorldSpec]) -> None:
        fleet.reset({i: worlds[2] for i in range(SIZE)})
        motions, _ = fleet.advance(np.zeros(SIZE), np.ones(SIZE, np.bool_))
        for field in fields(Motion):
            values = getattr(motions, field.name)
            assert values.shape == ((SIZE, 3) if field.name == "pose" else (SIZE,)), field.name
            kind = np.bool_ if field.name in ("touching", "at_target", "overturned") else np.float64
            assert values.dtype == kind, field.name


class TestManyKinematicVehicles:
    def test_the_number_of_threads_makes_no_difference(self, vehicle: VehicleSpec) -> None:
        size = 100
        sources = [load_world(name) for name in ("paper", "cover_20")]
        worlds = [source.draw(seed, 0.8) for source in sources for seed in range(5)]
        calls = restless(worlds, size, seed=3)
        found = []
        for threads in (1, 2, 3):
            with closing(KinematicSimulator(vehicle, DRIVE, size, threads)) as fleet:
                found.append(driven(fleet, calls))
        assert found[0] == found[1] == found[2]

    def test_room_for_more_boxes_grows_while_others_are_under_way(
        self, vehicle: VehicleSpec, world_of: Callable[..., WorldSpec], worlds: list[WorldSpec]
    ) -> None:
        full, sparse = worlds[0], world_of(OrientedBox(103.0, 100.2, 0.2, 0.2))
        assert len(full.solids) > 30 > len(sparse.solids)
        drive = np.array([0.3, -0.3]), np.ones(2, np.bool_)
        busy = replace(sparse, patrols=load_world("moving").draw(0, 0.8).patrols)
        few = replace(full, patrols=busy.patrols[:2])
        calls = [{0: sparse, 1: world_of()}, drive, {1: few}, drive, {0: full, 1: sparse}, drive, drive]
        calls += [{0: busy}, drive, {1: few}, drive, {0: sparse}, drive, drive, {0: few, 1: busy}, drive]
        with (
            closing(KinematicSimulator(vehicle, DRIVE, 2)) as fleet,
            Alone(KinematicSimulator(vehicle, DRIVE, 1)) as alone,
        ):
            for diary in driven(fleet, calls):
                assert diary.answers == answers_alone(alone, diary.calls)

    def test_its_path_leads_from_the_start_of_the_period_to_where_the_vehicle_is(
        self, vehicle: VehicleSpec, worlds: list[WorldSpec]
    ) -> None:
        with closing(KinematicSimulator(vehicle, DRIVE, 2)) as fleet:
            begin, _ = fleet.reset({0: worlds[3], 1: worlds[1]})
            for _ in range(3):
                motions, _ = fleet.advance(np.array([0.0, 0.5]), np.ones(2, np.bool_))
                for i in range(2):
                    path = fleet.path(i)
                    assert path[0].tolist() == begin[i].tolist()
                    assert path[-1] == pytest.approx(motions.pose[i])
                    assert len(path) - 1 == round(motions.duration[i] * COMMAND_RATE)
                begin = motions.pose.copy()
            assert motions.touching.tolist() == [True, False]


@dataclass(frozen=True)
class Scene:
    """A vehicle at the origin of a plane, what stands around it, and what it is told to do."""

    boxes: tuple[OrientedBox, ...]
    target: tuple[float, float]
    radius: float
    speed: float
    turns: tuple[float, ...]
    patrols: tuple[Patrol, ...] = ()


VEHICLE = load_vehicle("tricycle")
MIDDLE = 100.0
near = st.floats(-5.0, 5.0)
some_boxes = st.lists(
    st.builds(OrientedBox, near, near, st.floats(0.05, 1.5), st.floats(0.05, 1.5), st.floats(-pi, pi)), max_size=6
)
scenes = st.builds(
    Scene,
    some_boxes.map(tuple),
    st.tuples(near, near),
    st.floats(0.1, 2.0),
    st.floats(0.2, 4.0),
    st.lists(st.floats(-1.3, 1.3), min_size=1, max_size=4).map(tuple),
    st.lists(
        st.builds(
            Patrol,
            st.builds(OrientedBox, near, near, st.floats(0.05, 1.0), st.floats(0.05, 1.0), st.floats(-pi, pi)),
            st.tuples(near, near),
            st.floats(0.1, 3.0),
            st.floats(0.0, 1.0),
        ).filter(lambda patrol: hypot(patrol.end[0] - patrol.box.x, patrol.end[1] - patrol.box.y) > 0.1),
        max_size=3,
    ).map(tuple),
)
FAR = (60.0, 60.0)


class Doubtful(Exception):
    """The vehicle begins inside a box, or rounding decides whether it touches something."""


def footprints(poses: Array) -> list[shapely.Polygon]:
    """Of the vehicle at poses (n, 3), as exact polygons."""
    return list(shapely.polygons([moved(VEHICLE.footprint, Pose(*pose)).corners() for pose in poses.tolist()]))


def distances(poses: Array, solids: list[shapely.Polygon]) -> Array:
    """From the footprint at each pose (n, 3) to the nearest solid (n,)."""
    return np.asarray(shapely.distance(np.array(footprints(poses))[:, None], np.array(solids)[None]).min(axis=1))


def distances_to_patrols(poses: Array, commands: int, patrols: tuple[Patrol, ...]) -> Array:
    """From the footprint at each pose (n, 3), a command apart from so many on, to the nearest patrol then (n,)."""
    nearest = []
    for k, footprint in enumerate(footprints(poses), commands):
        gone = [patrol.speed * k / COMMAND_RATE for patrol in patrols]
        nearest.append(min(map(footprint.distance, map(patrol_after, patrols, gone)), default=np.inf))
    return np.array(nearest)


def patrol_after(patrol: Patrol, way: float) -> shapely.Polygon:
    """A patrol that has gone so far [m]: it takes what is left of its way from one end to the other, and so on."""
    ends = np.array([(patrol.box.x, patrol.box.y), patrol.end])
    length = float(np.hypot(*(ends[1] - ends[0])))
    way += 2 * length * patrol.phase
    while way >= length:
        way, ends = way - length, ends[::-1]
    x, y = ends[0] + way / length * (ends[1] - ends[0])
    return shapely.Polygon(replace(patrol.box, x=x, y=y).corners())


def unicycle(pose: Array, turn: Array, stride: float) -> Array:
    """Poses (k + 1, 3) after each command, if the heading since `pose` goes like `turn` (k + 1,)."""
    middles = pose[2] + (turn[1:] + turn[:-1]) / 2
    steps = stride * np.column_stack([np.cos(middles), np.sin(middles)])
    places = pose[:2] + np.concatenate([np.zeros((1, 2)), steps.cumsum(axis=0)])
    return np.column_stack([places, pose[2] + turn])


def follows(scene: Scene, world: WorldSpec) -> Iterator[tuple[Array, int, bool, bool, float, float]]:
    """Brute force: every control period's path, commands, contact, target, smallest clearance and heading error.

    All distances are taken, after every command, by shapely.
    """
    solids = [shapely.Polygon(box.corners()) for box in world.obstacles + world.walls]
    pose, rate, commands = np.array([MIDDLE, MIDDLE, 0.0]), 0.0, 0
    times = np.arange(61) / COMMAND_RATE
    for change in scene.turns:
        rates, headings = sample_turn(plan_turn(rate, change, VEHICLE.limits), times)
        path = unicycle(pose, headings, scene.speed / COMMAND_RATE)
        clear = np.minimum(distances(path, solids), distances_to_patrols(path, commands, world.patrols))
        off = np.hypot(path[:, 0] - world.target[0], path[:, 1] - world.target[1]) - scene.radius
        if clear[0] == 0 or ((clear > 0) & (clear < 1e-9)).any() or (np.abs(off) < 1e-9).any():
            raise Doubtful
        last = next((k for k in range(1, 61) if clear[k] == 0 or off[k] <= 0), 60)
        touching = bool(clear[last] == 0)
        smallest = float(clear[: last + 1].min())
        yield path[: last + 1], last, touching, bool(off[last] <= 0) and not touching, smallest, change - headings[last]
        if touching or off[last] <= 0:
            return
        pose, rate, commands = path[last], float(rates[last]), commands + last


def check(scene: Scene) -> list[str]:
    """Compares the fleet with brute force; gives what ended the scene."""
    boxes = tuple(moved(box, Pose(MIDDLE, MIDDLE, 0.0)) for box in scene.boxes)
    target = (MIDDLE + scene.target[0], MIDDLE + scene.target[1])
    patrols = tuple(
        replace(
            patrol,
            box=moved(patrol.box, Pose(MIDDLE, MIDDLE, 0.0)),
            end=(MIDDLE + patrol.end[0], MIDDLE + patrol.end[1]),
        )
        for patrol in scene.patrols
    )
    world = WorldSpec("scene", 0, 200.0, 200.0, boxes, Pose(MIDDLE, MIDDLE, 0.0), target, scene.radius, 1.5, patrols)
    with closing(KinematicSimulator(VEHICLE, DriveOptions(speed=scene.speed), 1, threads=1)) as fleet:
        fleet.reset({0: world})
        for change, expected in zip(scene.turns, follows(scene, world), strict=False):
            path, last, touching, at_target, smallest, error = expected
            motions, _ = fleet.advance(np.array([change]), np.ones(1, np.bool_))
            found = row(motions, 0)
            assert (found.touching, found.at_target) == (touching, at_target)
            assert found.duration == pytest.approx(last / COMMAND_RATE)
            assert found.path_length == pytest.approx(last * scene.speed / COMMAND_RATE)
            assert found.clearance == pytest.approx(smallest, abs=1e-9)
            assert fleet.path(0)[:, :2] == pytest.approx(path[:, :2], abs=1e-9)
            assert hypot(found.pose.x - path[-1, 0], found.pose.y - path[-1, 1]) < 1e-9
            assert cos(found.pose.yaw - path[-1, 2]) == pytest.approx(1.0)
            assert found.heading_error == pytest.approx(error, abs=1e-9)
    return ["contact"] * touching + ["target"] * at_target


class TestAgainstBruteForce:
    """The kinematic model looks at few poses and few boxes; brute force looks at all of them."""

    @given(scene=scenes)
    @settings(deadline=None, max_examples=150)
    # A target before a contact, a contact before the target, and both at the same command.
    @example(scene=Scene((OrientedBox(3.0, 0.0, 0.5, 0.5),), (1.5, 0.0), 0.7, 2.0, (0.0, 0.0)))
    @example(scene=Scene((OrientedBox(2.0, 0.0, 0.5, 0.5),), (3.0, 0.0), 0.7, 2.0, (0.0, 0.0, 0.0)))
    @example(scene=Scene((OrientedBox(1.9 + 1.0, 0.0, 1.0, 0.5),), (3.0, 0.0), 1.99, 2.0, (0.0, 0.0, 0.0)))
    def test_random_boxes_turns_and_speeds(self, scene: Scene) -> None:
        try:
            check(scene)
        except Doubtful:
            reject()

    def test_many_scenes_that_end_in_every_way(self) -> None:
        generator = np.random.default_rng(0)
        ends: list[str] = []
        for _ in range(150):
            places = generator.uniform(-4, 4, (5, 2)).tolist()
            sides = generator.uniform(0.05, 0.6, (5, 2)).tolist()
            yaws = generator.uniform(-pi, pi, 5).tolist()
            boxes = (OrientedBox(*p, *s, y) for p, s, y in zip(places, sides, yaws, strict=True))
            clear = [b for b in boxes if hypot(b.x - 0.3, b.y) > 0.7 + hypot(b.half_length, b.half_width)]
            turns = tuple(generator.uniform(-1.3, 1.3, 5).tolist())
            target = tuple(generator.uniform(-4, 4, 2).tolist())
            if hypot(*target) > 0.8:
                ends += check(Scene(tuple(clear), target, 0.7, float(generator.uniform(0.5, 3.0)), turns)) or ["none"]
        assert min(ends.count(end) for end in ("contact", "target", "none")) >= 5

    def test_many_scenes_with_boxes_that_move(self) -> None:
        generator = np.random.default_rng(1)
        ends: list[str] = []
        for _ in range(80):
            drawn = generator.uniform((-6, -6, 0.05, 0.05, -pi), (6, 6, 0.6, 0.6, pi), (3, 5)).tolist()
            to = generator.uniform(-6, 6, (3, 2)).tolist()
            fast = generator.uniform((0.1, 0.0), (3.0, 1.0), (3, 2)).tolist()
            patrols = tuple(Patrol(OrientedBox(*b), (x, y), *f) for b, (x, y), f in zip(drawn, to, fast, strict=True))
            turns, target = generator.uniform(-1.3, 1.3, 4).tolist(), generator.uniform(-4, 4, 2).tolist()
            try:
                scene = Scene(
                    (), (target[0], target[1]), 1.0, float(generator.uniform(0.5, 3.0)), tuple(turns), patrols
                )
                ends += check(scene) or ["none"]
            except Doubtful:
                continue
        assert min(ends.count(end) for end in ("contact", "target", "none")) >= 5

    @pytest.mark.parametrize("speed", [0.31, 1.07, 2.9])
    @pytest.mark.parametrize("gap", [1.4, 1.9, 2.4, 2.9, 3.9])
    def test_from_a_box_close_behind_to_one_that_comes(self, gap: float, speed: float) -> None:
        """Each comes nearer to the other."""
        front = VEHICLE.footprint.x + VEHICLE.footprint.half_length
        rear = VEHICLE.footprint.x - VEHICLE.footprint.half_length
        behind = OrientedBox(rear - 0.6, 0.0, 0.5, 0.5)
        comes = Patrol(OrientedBox(front + gap + 0.1, 0.0, 0.1, 3.0), (front + gap - 20.0, 0.0), speed, 0.0)
        ends = check(Scene((behind,), FAR, 1.0, 2.0, (0.0, 0.0, 0.0, 0.0), (comes,)))
        assert ends == ["contact"]

    @pytest.mark.parametrize("gap", [1.21, 1.51, 1.91])
    def test_from_a_box_close_behind_to_one_ahead(self, gap: float) -> None:
        """At first the box behind is nearer. It stays back as the vehicle comes to the other one."""
        front = VEHICLE.footprint.x + VEHICLE.footprint.half_length
        rear = VEHICLE.footprint.x - VEHICLE.footprint.half_length
        behind, ahead = OrientedBox(rear - 0.6, 0.0, 0.5, 0.5), OrientedBox(front + gap + 0.1, 0.0, 0.1, 3.0)
        assert check(Scene((behind, ahead), FAR, 1.0, 2.0, (0.0, 0.0, 0.0))) == ["contact"]
