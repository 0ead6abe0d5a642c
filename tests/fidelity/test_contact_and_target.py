"""Contact and target are noticed when they happen, not at the end of the control period."""

from collections.abc import Callable
from math import cos, hypot, pi, radians, sin

import pytest
from shapely.affinity import rotate, translate
from shapely.geometry import Point, Polygon, box
from shapely.ops import unary_union

from nnql_bullet.geometry import OrientedBox, Pose
from nnql_bullet.sim.base import Sample
from nnql_bullet.sim.bullet import BulletEngine
from nnql_bullet.worlds.spec import WorldSpec

SPEED = 2.0  # [m/s]
FRONT, REAR, HALF_WIDTH = 0.90, -0.20, 0.325  # of the chassis from the rear axle [m]
START = Pose(100.0, 100.0, 0.0)

Make = Callable[..., BulletEngine]
WorldOf = Callable[..., WorldSpec]


def footprint(pose: Pose) -> Polygon:
    shape = box(REAR, -HALF_WIDTH, FRONT, HALF_WIDTH)
    return translate(rotate(shape, pose.yaw, origin=(0, 0), use_radians=True), pose.x, pose.y)


def wall_ahead(gap: float, thickness: float = 1.0) -> OrientedBox:
    return OrientedBox(START.x + FRONT + gap + thickness / 2, START.y, thickness / 2, 2.0)


@pytest.mark.parametrize("gap", [0.05, 0.236, 0.5, 0.73, 0.95])
def test_a_head_on_contact_ends_the_step_when_it_happens(
    engine_of: Make, world_of: WorldOf, physics: str, gap: float
) -> None:
    engine = engine_of(physics)
    engine.reset(world_of(wall_ahead(gap)))
    motion = engine.advance(0.0)
    assert motion.touching
    assert motion.clearance == 0.0
    assert motion.duration == pytest.approx(gap / SPEED, abs=2.5 * engine.physics.time_step)
    assert motion.duration == pytest.approx(engine.time(), abs=1e-9)
    # Contact is felt one step after the first overlap at the latest: the nose is no deeper than that.
    assert motion.pose.x + FRONT - (START.x + FRONT + gap) < 2 * SPEED * engine.physics.time_step


def test_a_wall_just_beyond_the_step_is_not_touched(engine_of: Make, world_of: WorldOf, physics: str) -> None:
    engine = engine_of(physics)
    engine.reset(world_of(wall_ahead(1.0 + 0.03)))
    motion = engine.advance(0.0)
    assert not motion.touching
    assert motion.duration == pytest.approx(0.5)
    assert motion.clearance == pytest.approx(0.03, abs=2e-3)
    assert engine.advance(0.0).touching


def test_a_fresh_start_does_not_touch_what_the_last_world_had(
    engine_of: Make, world_of: WorldOf, empty_world: WorldSpec, physics: str
) -> None:
    engine = engine_of(physics)
    engine.reset(world_of(wall_ahead(0.3)))
    assert engine.advance(0.0).touching
    engine.reset(empty_world)
    assert not engine.advance(0.0).touching


@pytest.mark.parametrize("side", [1, -1])
def test_a_post_brushed_in_passing_is_a_contact(engine_of: Make, world_of: WorldOf, physics: str, side: int) -> None:
    # The flank covers 5 mm of a thin post that stands between the vehicle's places at the start and the end.
    post = OrientedBox(START.x + FRONT + 0.1, START.y + side * (HALF_WIDTH - 0.005 + 0.02), 0.02, 0.02)
    end = Pose(START.x + 2.0, START.y, 0.0)
    solid = Polygon(post.corners())
    assert footprint(START).distance(solid) > 0.07
    assert footprint(end).distance(solid) > 0.5
    engine = engine_of(physics, decision_period=1.0)
    engine.reset(world_of(post))
    motion = engine.advance(0.0)
    assert motion.touching
    assert motion.duration == pytest.approx(0.08 / SPEED, abs=2.5 * engine.physics.time_step)


def test_a_post_missed_in_passing_is_not_a_contact(engine_of: Make, world_of: WorldOf, physics: str) -> None:
    post = OrientedBox(START.x + FRONT + 0.5, START.y + HALF_WIDTH + 0.005 + 0.02, 0.02, 0.02)
    engine = engine_of(physics, decision_period=1.0)
    engine.reset(world_of(post))
    motion = engine.advance(0.0)
    assert not motion.touching
    assert motion.clearance == pytest.approx(0.005, abs=1e-3)


@pytest.mark.parametrize(("inside", "touches"), [(0.012, True), (-0.012, False)])
@pytest.mark.parametrize("side", [1, -1])
def test_a_corner_that_swings_out_and_back_is_felt(
    engine_of: Make, world_of: WorldOf, physics: str, side: int, inside: float, touches: bool
) -> None:
    engine = engine_of(physics, decision_period=1.0)
    trace: list[Sample] = []
    engine.reset(world_of())
    end = engine.advance(side * radians(60), trace).pose
    swept = unary_union([footprint(sample.pose) for sample in trace])
    middle = trace[8].pose
    # The outer front corner half way through the turn, with a post on the line outwards from it.
    ahead, out = FRONT, -side * HALF_WIDTH
    corner = Point(
        middle.x + cos(middle.yaw) * ahead - sin(middle.yaw) * out,
        middle.y + sin(middle.yaw) * ahead + cos(middle.yaw) * out,
    )
    outwards = middle.yaw - side * pi / 2
    reach = 0.03 - inside
    post = OrientedBox(corner.x + reach * cos(outwards), corner.y + reach * sin(outwards), 0.03, 0.03, outwards)
    solid = Polygon(post.corners())
    assert (swept.distance(solid) == 0.0) is touches
    assert footprint(START).distance(solid) > 0.05
    assert footprint(end).distance(solid) > 0.05
    engine.reset(world_of(post))
    assert engine.advance(side * radians(60)).touching is touches


@pytest.mark.parametrize("offset", [0.0, 0.15, -0.15])
def test_the_target_is_noticed_within_the_step(engine_of: Make, world_of: WorldOf, physics: str, offset: float) -> None:
    target, radius = (START.x + 0.5, START.y + offset), 0.2  # the step goes on to 1.0 m, well beyond it
    engine = engine_of(physics)
    engine.reset(world_of(target=target, target_radius=radius))
    motion = engine.advance(0.0)
    along = 0.5 - (radius**2 - offset**2) ** 0.5
    assert motion.at_target
    assert not motion.touching
    assert motion.duration == pytest.approx(along / SPEED, abs=1 / 120 + 1e-9)
    assert hypot(motion.pose.x - target[0], motion.pose.y - target[1]) <= radius


def test_a_target_passed_at_a_distance_is_not_reached(engine_of: Make, world_of: WorldOf, physics: str) -> None:
    engine = engine_of(physics)
    engine.reset(world_of(target=(START.x + 0.5, START.y + 0.205), target_radius=0.2))
    motion = engine.advance(0.0)
    assert not motion.at_target
    assert motion.duration == pytest.approx(0.5)


def test_a_contact_before_the_target_is_no_arrival(engine_of: Make, world_of: WorldOf, physics: str) -> None:
    engine = engine_of(physics)
    engine.reset(world_of(wall_ahead(0.2), target=(START.x + 0.6, START.y), target_radius=0.2))
    motion = engine.advance(0.0)
    assert motion.touching
    assert not motion.at_target


def test_the_trace_of_a_step_cut_short_reaches_its_end(engine_of: Make, world_of: WorldOf, physics: str) -> None:
    engine = engine_of(physics)
    trace: list[Sample] = []
    engine.reset(world_of(wall_ahead(0.02)))
    motion = engine.advance(0.0, trace)
    assert motion.touching
    assert trace[-1].pose == motion.pose
