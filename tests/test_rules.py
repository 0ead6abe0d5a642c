"""What rules decide, against closed forms, brute force and second implementations of the articles' formulas."""

import sys
from collections.abc import Callable
from contextlib import closing
from importlib.util import find_spec
from math import asin, atan2, cos, degrees, pi, radians, sin

import helpers
import numpy as np
import pytest
import shapely
from helpers import Driving
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.stats import chisquare

from nnql_bullet import paper
from nnql_bullet.agents.rules.look_ahead import LookAhead, LookAheadOptions
from nnql_bullet.agents.rules.potential_field import repulsion
from nnql_bullet.agents.rules.vfh import (
    BINS,
    binary_histograms,
    candidate_directions,
    masked_histograms,
    primary_histograms,
    turning_limits,
)
from nnql_bullet.agents.turns import nearest_actions, nearest_turns, offered_turns
from nnql_bullet.env import ACTIONS, TOWARD_TARGET, Observation, heading_change
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, OrientedBox, Pose, as_rows, moved, wrap_angle
from nnql_bullet.mapping.point_cloud import point_cloud
from nnql_bullet.mapping.prediction import PREDICTION_STEP, scan_clearances
from nnql_bullet.presets import load_config
from nnql_bullet.sensing import RAYS, ray_angles, sector_readings
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import StateProperty
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.profiles import plan_turn, sample_turn
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

STRAIGHT, LEFT_30, LEFT_60, RIGHT_30, RIGHT_60 = range(5)
MIRRORED = {STRAIGHT: STRAIGHT, LEFT_30: RIGHT_30, LEFT_60: RIGHT_60, RIGHT_30: LEFT_30, RIGHT_60: LEFT_60}
DEGREES = -20.0 + 5.0 * np.arange(RAYS)  # of the rays
NOTHING = np.full(RAYS, paper.SENSOR_RANGE)
DRIVE = DriveOptions()

NEEDS_BASELINES = pytest.mark.skipif(
    find_spec("skfuzzy") is None, reason="needs the extra: pip install 'nnql-bullet[baselines]'"
)

Make = Callable[..., Driving]


@pytest.fixture(scope="module")
def make(vehicle: VehicleSpec) -> Make:
    """Makes a rule that has begun with vehicle 0 in world 0."""

    def made(kind: str, **options: object) -> Driving:
        agent = load_config("paper", {"agent": {"kind": kind, **options}}).agent.make_agent(0, vehicle, DRIVE)
        return Driving(agent).reset(0)

    return made


def observed(
    rays: Array = NOTHING, bearing: float = 0.0, yaw_rate: float = 0.0, state: StateProperty = StateProperty.NON_SAFE
) -> Observation:
    """What one vehicle sees."""
    return helpers.observed((sector_readings(rays), 50.0, bearing, yaw_rate, 2.0, state, rays))


def action(agent: Driving, observations: Observation) -> int:
    """Of one vehicle."""
    (chosen,) = agent.act(observations).tolist()
    return int(chosen)


def scan(walls: dict[tuple[float, float], float]) -> Array:
    """Ray distances with something at a distance [m] between two directions [degrees, right to left]."""
    rays = NOTHING.copy()
    for (right, left), distance in walls.items():
        inside = (DEGREES - right) % 360 <= left - right
        rays[inside] = np.minimum(rays[inside], distance)
    return rays


def mirrored(rays: Array) -> Array:
    """The scan as a mirror shows it: ray i is at -20 + 5 i degrees."""
    return rays[(8 - np.arange(RAYS)) % RAYS]


def polygon(box: OrientedBox) -> shapely.Polygon:
    return shapely.Polygon(box.corners())


distances = st.lists(st.floats(0.8, 12.0), min_size=RAYS, max_size=RAYS).map(lambda d: np.minimum(d, 10.0))
bearings = st.floats(-pi, pi)


class TestTurns:
    NEAREST = ((0, 0), (30, 1), (60, 2), (-30, 3), (-60, 4), (44, 1), (46, 2), (-44, 3), (-46, 4), (180, 2))

    def test_nearest_turns_are_the_papers_turns_closest_by(self) -> None:
        wanted, turns = zip(*self.NEAREST, strict=True)
        assert nearest_turns(np.radians(wanted)).tolist() == list(turns)

    @given(st.lists(st.tuples(bearings, bearings), min_size=1, max_size=5))
    @settings(max_examples=100, deadline=None)
    def test_nearest_actions_are_those_of_least_difference(self, rows: list[tuple[float, float]]) -> None:
        wanted, target = (np.array(column) for column in zip(*rows, strict=True))
        for row, chosen in enumerate(nearest_actions(wanted, target).tolist()):
            turns = [float(heading_change(a, target[row])) for a in range(ACTIONS)]
            assert abs(turns[chosen] - wanted[row]) == min(abs(turn - wanted[row]) for turn in turns)

    def test_toward_the_target_is_on_offer_up_to_the_largest_turn(self) -> None:
        offered = np.degrees(offered_turns(np.radians([12.0, -170.0])))
        assert offered == pytest.approx(np.array([[0, 30, 60, -30, -60, 12], [0, 30, 60, -30, -60, -60]]))
        assert nearest_actions(np.radians([14.0]), np.radians([12.0])).tolist() == [TOWARD_TARGET]


def test_scan_points_are_on_what_the_rays_met(vehicle: VehicleSpec, world_of: Callable[..., WorldSpec]) -> None:
    box, start = OrientedBox(105.0, 102.0, 2.0, 1.0, 0.4), Pose(100.0, 100.0, 0.3)
    with closing(KinematicSimulator(vehicle, DRIVE, 1)) as simulator:
        _, (distances,) = simulator.reset({0: world_of(box, start=start)})
    points = point_cloud(distances, vehicle.sensor)
    assert points.shape == (RAYS, 2)
    assert np.array_equal(np.isnan(points).all(axis=1), distances == paper.SENSOR_RANGE)
    seen = points[distances < paper.SENSOR_RANGE]
    c, s = cos(start.yaw), sin(start.yaw)
    places = shapely.points(seen @ np.array([[c, s], [-s, c]]) + (start.x, start.y))
    assert 3 < len(seen) < RAYS
    assert shapely.distance(places, polygon(box).boundary).max() < 1e-9


class TestRandom:
    def test_safe_states_lead_toward_the_target(self, make: Make) -> None:
        agent = make("random")
        assert {action(agent, observed(state=StateProperty.SAFE)) for _ in range(20)} == {TOWARD_TARGET}

    def test_every_turn_is_as_likely(self, make: Make) -> None:
        agent = make("random")
        counts = np.bincount([action(agent, observed()) for _ in range(5000)], minlength=ACTIONS)
        assert counts[TOWARD_TARGET] == 0
        assert chisquare(counts[:TOWARD_TARGET]).pvalue > 0.01

    def test_chance_is_that_of_the_world(self, make: Make) -> None:
        drives = []
        for world_seed in (7, 7, 8):
            agent = make("random")
            agent.state = agent.policy.reset(agent.state, {0: world_seed})
            drives.append([action(agent, observed()) for _ in range(30)])
        assert drives[0] == drives[1] != drives[2]


class TestHandRule:
    @pytest.mark.parametrize(
        ("left", "right", "bearing", "turn"),
        [
            (2.0, 3.0, 1.0, RIGHT_30),
            (3.0, 2.0, -1.0, LEFT_30),
            (10.0, 9.0, 0.0, LEFT_30),
            (4.0, 4.0, 0.3, LEFT_30),
            (4.0, 4.0, -0.3, RIGHT_30),
            (10.0, 10.0, 0.0, LEFT_30),
        ],
    )
    def test_it_turns_away_from_the_fuller_front_side(
        self, make: Make, left: float, right: float, bearing: float, turn: int
    ) -> None:
        seen = observed(scan({(-20, 20): 3.0, (25, 65): left, (-65, -25): right}), bearing)
        assert action(make("hand_rule"), seen) == turn
        assert action(make("hand_rule", turn_degrees=60), seen) == {LEFT_30: LEFT_60, RIGHT_30: RIGHT_60}[turn]

    def test_in_safe_states_it_goes_toward_the_target(self, make: Make) -> None:
        assert action(make("hand_rule"), observed(scan({(25, 65): 4.0}), state=StateProperty.SAFE)) == TOWARD_TARGET

    def test_what_is_beside_and_behind_does_not_count(self, make: Make) -> None:
        seen = observed(scan({(-65, 65): 3.0, (70, 270): 1.0}), 1.0)
        assert action(make("hand_rule"), seen) == LEFT_30

    def test_other_turns_are_refused(self, make: Make) -> None:
        with pytest.raises(UserError, match="turn_degrees"):
            make("hand_rule", turn_degrees=45)


class TestLookAhead:
    @given(st.lists(st.tuples(st.floats(-6, 6), st.floats(-6, 6), bearings), min_size=1, max_size=4), distances)
    @settings(max_examples=50, deadline=None)
    def test_clearances_are_those_of_polygons(
        self, vehicle: VehicleSpec, poses: list[tuple[float, float, float]], rays: Array
    ) -> None:
        points = point_cloud(rays, vehicle.sensor)
        found = scan_clearances(np.array(poses)[None, None], points[None], as_rows((vehicle.footprint,))[0])
        cloud = shapely.MultiPoint(points[np.isfinite(points[:, 0])])
        expected = [polygon(moved(vehicle.footprint, Pose(*pose))).distance(cloud) for pose in poses]
        if cloud.is_empty:
            assert np.isinf(found).all()
        else:
            assert found[0, 0] == pytest.approx(expected, abs=1e-9)

    @pytest.mark.parametrize("bearing", [0.0, 0.4, -2.0])
    def test_it_foresees_where_the_ideal_vehicle_gets(
        self, vehicle: VehicleSpec, empty_world: WorldSpec, bearing: float
    ) -> None:
        horizon = 2.5
        agent = LookAhead(LookAheadOptions(horizon=horizon), vehicle, DRIVE)
        turns = offered_turns(np.array([bearing]))
        foreseen = agent.predicted_poses(np.zeros(1), turns)
        assert foreseen.shape == (1, ACTIONS, round(horizon / PREDICTION_STEP), 3)
        with closing(KinematicSimulator(vehicle, DriveOptions(decision_period=horizon), ACTIONS)) as simulator:
            start, _ = simulator.reset(dict.fromkeys(range(ACTIONS), empty_world))
            reached = simulator.advance(turns[0])[0].pose - start
        assert foreseen[0, :, -1] == pytest.approx(reached, abs=0.005)

    @given(distances, bearings, st.floats(-1.5, 1.5), st.floats(0.1, 0.8))
    @settings(max_examples=40, deadline=None)
    def test_it_chooses_as_a_brute_force_sweep_does(
        self, vehicle: VehicleSpec, rays: Array, bearing: float, yaw_rate: float, margin: float
    ) -> None:
        horizon, slack = 1.5, 0.03  # what the sweep, ten times as fine, may see between two foreseen poses
        agent = LookAhead(LookAheadOptions(horizon=horizon, margin=margin), vehicle, DRIVE)
        chosen = action(Driving(agent), observed(rays, bearing, yaw_rate))
        points = point_cloud(rays, vehicle.sensor)
        cloud = shapely.MultiPoint(points[np.isfinite(points[:, 0])])
        turns = [float(heading_change(a, bearing)) for a in range(ACTIONS)]
        sweeps = [swept(vehicle, yaw_rate, turn, horizon) for turn in turns]
        rooms = [shapely.union_all(boxes).distance(cloud) if len(cloud.geoms) else 99.0 for boxes in sweeps]
        off = [abs(wrap_angle(bearing - turn)) for turn in turns]
        better = [a for a in range(ACTIONS) if rooms[a] > margin + slack and off[a] < off[chosen] - 1e-9]
        if max(rooms) > margin + slack:
            assert rooms[chosen] > margin - slack
            assert better == []
        elif max(rooms) < margin - slack:
            lasts, surely = (
                [
                    next((k for k, box in enumerate(boxes) if box.buffer(by).intersects(cloud)), len(boxes))
                    for boxes in sweeps
                ]
                for by in (-slack, slack)
            )
            assert lasts[chosen] >= max(surely) - 10
            if lasts[chosen] == len(sweeps[0]):
                free = [room for room, last in zip(rooms, surely, strict=True) if last == len(sweeps[0])]
                assert rooms[chosen] > max(free, default=0.0) - slack

    def test_without_obstacles_it_goes_toward_the_target(self, make: Make) -> None:
        agent = make("look_ahead")
        for bearing in (0.2, -0.7, 1.0):
            turn = float(heading_change(action(agent, observed(bearing=bearing)), bearing))
            assert turn == pytest.approx(bearing)

    def test_the_yaw_rate_decides_where_a_turn_would_come_too_late(self, make: Make) -> None:
        seen = scan({(-10, 10): 2.4})
        assert action(make("look_ahead"), observed(seen, yaw_rate=1.5)) in (LEFT_30, LEFT_60)
        assert action(make("look_ahead"), observed(seen, yaw_rate=-1.5)) in (RIGHT_30, RIGHT_60)

    @pytest.mark.parametrize("options", [{"horizon": 0.0}, {"margin": -0.1}, {"horizon": "far"}])
    def test_senseless_options_are_refused(self, make: Make, options: dict[str, object]) -> None:
        with pytest.raises(UserError, match=next(iter(options))):
            make("look_ahead", **options)


def swept(vehicle: VehicleSpec, yaw_rate: float, turn: float, horizon: float) -> list[shapely.Polygon]:
    """The footprint a hundred times a second along a turn, by summing up small steps."""
    step = PREDICTION_STEP / 10
    times = np.arange(1, round(horizon / step) + 1) * step
    _, headings = sample_turn(plan_turn(yaw_rate, turn, vehicle.limits), times)
    x = y = before = 0.0
    boxes = []
    for heading in headings.tolist():
        x += DRIVE.speed * step * cos((before + heading) / 2)
        y += DRIVE.speed * step * sin((before + heading) / 2)
        before = heading
        boxes.append(polygon(moved(vehicle.footprint, Pose(x, y, heading))))
    return boxes


class TestPotentialField:
    GAIN, INFLUENCE = 30.0, 6.0

    def potential(self, footprint: OrientedBox, points: Array, x: float, y: float) -> float:
        """Khatib's repulsive potential of the vehicle shifted by (x, y)."""
        body = polygon(moved(footprint, Pose(x, y, 0.0)))
        rhos = [body.distance(shapely.Point(point)) for point in points]
        return sum(self.GAIN / 2 * (1 / rho - 1 / self.INFLUENCE) ** 2 for rho in rhos if rho < self.INFLUENCE)

    @given(distances)
    @settings(max_examples=50, deadline=None)
    def test_the_force_is_minus_the_gradient_of_the_potential(self, vehicle: VehicleSpec, rays: Array) -> None:
        points = point_cloud(rays, vehicle.sensor)
        seen, footprint, h = points[np.isfinite(points[:, 0])], vehicle.footprint, 1e-6
        away = np.array([polygon(footprint).distance(shapely.Point(point)) for point in seen])
        assume(np.all(np.abs(away - self.INFLUENCE) > 1e-3) and np.all(away > 0.05))
        expected = [
            (self.potential(footprint, seen, -h * x, -h * y) - self.potential(footprint, seen, h * x, h * y)) / (2 * h)
            for x, y in ((1, 0), (0, 1))
        ]
        (force,) = repulsion(points[None], footprint, self.GAIN, self.INFLUENCE)
        assert force == pytest.approx(expected, rel=1e-4, abs=1e-3)

    def test_contact_is_no_division_by_zero(self, vehicle: VehicleSpec) -> None:
        inside = np.array([[[0.35, 0.1], [0.9, 0.0]]])
        assert np.isfinite(repulsion(inside, vehicle.footprint, self.GAIN, self.INFLUENCE)).all()

    @pytest.mark.parametrize("bearing", [0.0, 0.3, -1.0])
    def test_without_obstacles_it_goes_toward_the_target(self, make: Make, bearing: float) -> None:
        chosen = action(make("potential_field"), observed(bearing=bearing))
        assert float(heading_change(chosen, bearing)) == pytest.approx(bearing)

    def test_it_is_pushed_away_from_a_wall_and_mirrored_by_one_on_the_other_side(self, make: Make) -> None:
        agent, wall = make("potential_field"), scan({(5, 60): 3.0})
        assert action(agent, observed(wall)) in (RIGHT_30, RIGHT_60)
        assert action(agent, observed(mirrored(wall))) == MIRRORED[action(agent, observed(wall))]

    def test_what_is_out_of_view_or_of_influence_does_not_count(self, make: Make) -> None:
        agent = make("potential_field", influence=4.0, view_degrees=60.0)
        assert action(agent, observed(scan({(61, 180): 1.0, (-60, 60): 5.0}), 0.2)) == TOWARD_TARGET
        assert action(agent, observed(scan({(60, 180): 1.0, (-60, 60): 5.0}), 0.2)) == RIGHT_60

    @pytest.mark.parametrize("options", [{"gain": 0.0}, {"influence": 11.0}, {"view_degrees": 190.0}])
    def test_senseless_options_are_refused(self, make: Make, options: dict[str, object]) -> None:
        with pytest.raises(UserError, match=next(iter(options))):
            make("potential_field", **options)


class TestVfh:
    BIN = radians(5.0)

    @given(distances, bearings, st.floats(2.0, 10.0), st.floats(0.3, 1.5))
    @settings(max_examples=60, deadline=None)
    def test_primary_histogram_is_the_articles(self, rays: Array, heading: float, window: float, radius: float) -> None:
        directions = ray_angles() + heading
        found = primary_histograms(rays[None], directions[None], window, radius)[0]
        expected, unsure = np.zeros(BINS), np.zeros(BINS, np.bool_)
        for d, beta in zip(rays.tolist(), directions.tolist(), strict=True):
            if d < window:
                gamma = asin(radius / d) if d > radius else pi / 2
                for k in range(BINS):
                    off = abs(atan2(sin(k * self.BIN - beta), cos(k * self.BIN - beta)))
                    unsure[k] |= abs(off - gamma) < 1e-9
                    if off <= gamma:
                        expected[k] += (1 + window**2) - d**2
        assert found[~unsure] == pytest.approx(expected[~unsure])

    def test_binary_histogram_keeps_what_it_was_between_the_thresholds(self) -> None:
        density = np.array([[1.0, 3.0, 6.0, 3.0]])
        never = np.zeros((1, 4), np.bool_)
        assert binary_histograms(density, never, 2.0, 5.0).tolist() == [[False, False, True, False]]
        assert binary_histograms(density, ~never, 2.0, 5.0).tolist() == [[False, True, True, True]]

    @given(distances, st.floats(2.0, 10.0), st.floats(0.3, 1.0), st.floats(0.5, 2.0))
    @settings(max_examples=60, deadline=None)
    def test_a_cell_that_meets_a_turning_circle_bars_what_is_beyond(
        self, vehicle: VehicleSpec, rays: Array, window: float, radius: float, turning_radius: float
    ) -> None:
        angles = np.arctan2(np.sin(ray_angles()), np.cos(ray_angles()))
        sensor = vehicle.sensor.position[:2]
        (found,) = turning_limits(rays[None], angles, window, radius, sensor, turning_radius)
        for side, limit in ((-1, found[0]), (1, found[1])):
            centre = np.array([0.0, side * turning_radius])
            circle = np.hypot(*(np.array(sensor) - centre))
            barred = [pi]
            for angle, d in zip(angles, rays, strict=True):
                cell = np.array(sensor) + d * np.array([cos(angle), sin(angle)])
                if d < window and side * angle >= 0 and np.hypot(*(cell - centre)) < circle + radius:
                    barred.append(abs(angle))
            assert abs(limit) == min(barred)
            assert np.sign(limit) in (side, 0)

    def test_masked_histogram_is_free_between_the_limits(self) -> None:
        blocked = np.zeros((1, BINS), np.bool_)
        blocked[0, 4] = True
        masked = masked_histograms(blocked, np.array([radians(10.0)]), np.radians([[-22.0, 37.0]]))[0]
        free = {round(degrees(k * self.BIN)) for k in np.flatnonzero(~masked).tolist()}
        assert free == {350, 355, 0, 5, 10, 15, 25, 30, 35, 40, 45}

    @pytest.mark.parametrize(
        ("openings", "target", "expected"),
        [
            ([(0, 355)], 33.0, [33.0]),  # nothing blocked
            ([], 0.0, []),
            ([(10, 20)], 0.0, [15.0]),  # narrow
            ([(345, 380)], 90.0, [2.5]),  # narrow, over the direction where bins are counted from
            ([(30, 30)], 0.0, [30.0]),
            ([(20, 100)], 60.0, [40.0, 80.0, 60.0]),  # wide, the target in it
            ([(20, 100)], 30.0, [40.0, 80.0]),  # wide, the target too near to its border
            ([(320, 400)], -10.0, [340.0, 380.0, 350.0]),
            ([(10, 20), (100, 150)], 120.0, [15.0, 120.0, 130.0, 120.0]),
        ],
    )
    def test_candidates_lead_through_the_openings(
        self, openings: list[tuple[int, int]], target: float, expected: list[float]
    ) -> None:
        masked = np.ones(BINS, np.bool_)
        for right, left in openings:
            masked[np.arange(right // 5, left // 5 + 1) % BINS] = False
        found = np.degrees(candidate_directions(masked, radians(target), radians(40.0)))
        assert sorted(found % 360) == pytest.approx(sorted(np.array(expected) % 360))

    @pytest.mark.parametrize("bearing", [0.0, 0.3, -1.0])
    def test_without_obstacles_it_goes_toward_the_target(self, make: Make, bearing: float) -> None:
        chosen = action(make("vfh"), observed(bearing=bearing))
        assert float(heading_change(chosen, bearing)) == pytest.approx(bearing)

    @pytest.mark.parametrize(
        ("weights", "chosen"),
        [((1.0, 0.0, 0.0), LEFT_60), ((0.0, 1.0, 0.0), RIGHT_30), ((0.0, 0.0, 1.0), RIGHT_30)],
    )
    def test_the_weights_choose_among_the_gaps(
        self, make: Make, weights: tuple[float, float, float], chosen: int
    ) -> None:
        names = ("target_weight", "heading_weight", "previous_weight")
        agent = make("vfh", **dict(zip(names, weights, strict=True)))
        assert action(agent, observed(ring(gaps=(60.0, -30.0)), bearing=radians(70.0))) == chosen

    def test_the_previous_direction_stays_where_it_was_while_the_vehicle_turns(
        self, make: Make, vehicle: VehicleSpec
    ) -> None:
        agent = make("vfh", target_weight=0.0, heading_weight=0.0, previous_weight=1.0)
        assert action(agent, observed(ring(gaps=(60.0, 180.0)))) == LEFT_60
        rates, headings = sample_turn(plan_turn(0.0, radians(60.0), vehicle.limits), np.array([DRIVE.decision_period]))
        turned = 35.0
        assert degrees(headings[0]) == pytest.approx(turned, abs=1.0)
        # Gaps at 60 and 120 degrees of the start. Had the direction turned along, 95 would be the one before.
        seen = ring(gaps=(60.0 - turned, 120.0 - turned))
        assert action(agent, observed(seen, yaw_rate=float(rates[0]))) == LEFT_30

    @given(st.lists(st.tuples(st.integers(0, 4), bearings, st.floats(-0.5, 0.5)), min_size=1, max_size=5), distances)
    @settings(max_examples=60, deadline=None)
    def test_told_what_was_done_it_goes_on_as_one_that_chose_it(
        self, make: Make, past: list[tuple[int, float, float]], rays: Array
    ) -> None:
        """In the open one chooses what leads to the target; another, whose target is elsewhere, is told to do that."""
        one, other = make("vfh"), make("vfh")
        for turn, elsewhere, rate in past:
            action(one, observed(bearing=paper.TURNS[turn], yaw_rate=rate))
            action(other, observed(bearing=elsewhere, yaw_rate=rate))
            other.override(np.array([turn]))
        assert action(one, observed(rays, 0.2)) == action(other, observed(rays, 0.2))

    def test_a_blocked_direction_stays_blocked_until_its_density_is_low(self, make: Make) -> None:
        # One ray at 7.8 m adds 1 + 64 - 60.84 = 4.16, between the thresholds; at 7 m it adds 16. Where the target's
        # direction is blocked, the openings' other side is a right angle away: straight on.
        near, far = (observed(scan({(90, 90): distance}), radians(90.0)) for distance in (7.0, 7.8))
        assert action(make("vfh", wide_degrees=180.0), far) == LEFT_60
        agent = make("vfh", wide_degrees=180.0)
        assert [action(agent, seen) for seen in (near, far, far)] == [STRAIGHT] * 3
        assert action(agent, observed(bearing=radians(90.0))) == LEFT_60

    def test_where_all_is_blocked_it_goes_where_density_is_least(self, make: Make) -> None:
        closed = np.full(RAYS, 2.0)
        closed[np.abs(DEGREES - 330.0) <= 10] = 4.0
        assert action(make("vfh"), observed(closed)) == RIGHT_30
        assert action(make("vfh"), observed(mirrored(closed))) == LEFT_30

    def test_thresholds_in_the_wrong_order_are_refused(self, make: Make) -> None:
        with pytest.raises(UserError, match="low_threshold 6 is above high_threshold 5"):
            make("vfh", low_threshold=6.0)

    @pytest.mark.parametrize("options", [{"window": 0.0}, {"window": 11.0}, {"safety_distance": -1.0}])
    def test_senseless_options_are_refused(self, make: Make, options: dict[str, object]) -> None:
        with pytest.raises(UserError, match=next(iter(options))):
            make("vfh", **options)


def ring(gaps: tuple[float, ...], distance: float = 5.0) -> Array:
    """Ray distances all around but in gaps of 50 degrees about some directions [degrees]."""
    rays = np.full(RAYS, distance)
    for gap in gaps:
        rays[np.abs((DEGREES - gap + 180) % 360 - 180) <= 25] = paper.SENSOR_RANGE
    return rays


@pytest.fixture(scope="module")
def turn(make: Make) -> Callable[..., float]:
    """The crisp turn [degrees] of an agent with round numbers."""
    ends = {"front_near": 4.0, "front_far": 8.0, "side_near": 2.0, "side_far": 6.0}
    agent = make("fuzzy", **ends, freer_by=2.0, aside_degrees=40.0)

    def crisp(front: float = 10.0, left: float = 10.0, right: float = 10.0, bearing: float = 0.0) -> float:
        readings = np.array([[front, left, 10.0, 10.0, 10.0, 10.0, 10.0, right]])
        (value,) = agent.policy.turns_degrees(readings, np.radians([bearing]))  # type: ignore[attr-defined]
        return float(value)

    return crisp


@NEEDS_BASELINES
class TestFuzzy:
    @pytest.mark.parametrize(
        ("seen", "expected"),
        [
            ({}, 0.0),
            ({"bearing": 40.0}, 60.0),  # one term, in full: the centroid of its triangle
            ({"bearing": -140.0}, -60.0),
            ({"front": 3.0, "left": 5.0, "right": 3.0}, 30.0),
            ({"front": 3.0, "left": 3.0, "right": 5.0}, -30.0),
            ({"front": 3.0}, 30.0),
            ({"front": 3.0, "bearing": -50.0}, -30.0),
            ({"left": 1.0, "right": 9.0}, -30.0),
            ({"left": 1.0, "right": 1.0}, 0.0),
            ({"front": 6.0}, 15.0),  # straight and left, half true each: their middle
            ({"bearing": 20.0}, 30.0),  # straight and hard left, half true each
            ({"left": 4.0, "right": 10.0}, -15.0),  # the side is half near
        ],
    )
    def test_simple_cases_are_as_by_hand(
        self, turn: Callable[..., float], seen: dict[str, float], expected: float
    ) -> None:
        assert turn(**seen) == pytest.approx(expected, abs=1e-9)

    @given(st.floats(0, 10), st.floats(0, 10), st.floats(0, 10), st.floats(-180, 180))
    @settings(max_examples=100, deadline=None)
    def test_it_is_the_centroid_of_the_union_of_cut_triangles(
        self, turn: Callable[..., float], front: float, left: float, right: float, bearing: float
    ) -> None:
        near, beside = np.interp(front, [4, 8], [1, 0]), np.interp(min(left, right), [2, 6], [1, 0])
        to_left, to_right = (np.interp(sign * (left - right), [0, 2], [0, 1]) for sign in (1, -1))
        is_left, is_right = (np.interp(sign * bearing, [0, 40], [0, 1]) for sign in (1, -1))
        neither, ahead, far, free = 1 - to_left - to_right, 1 - is_left - is_right, 1 - near, 1 - beside
        truths = [
            (60, min(far, free, is_left)),
            (0, min(far, free, ahead)),
            (-60, min(far, free, is_right)),
            (30, min(near, to_left)),
            (-30, min(near, to_right)),
            (30, min(near, neither, max(is_left, ahead))),
            (-30, min(near, neither, is_right)),
            (30, min(far, beside, to_left)),
            (-30, min(far, beside, to_right)),
            (0, min(far, beside, neither)),
        ]
        cut = [
            shapely.Polygon([(c - 30, 0), (c - 30 + 30 * h, h), (c + 30 - 30 * h, h), (c + 30, 0)])
            for c, h in truths
            if h > 1e-9
        ]
        expected = shapely.union_all(cut).centroid.x
        assert turn(front, left, right, bearing) == pytest.approx(expected, abs=0.3)

    def test_the_mirrored_scan_is_answered_by_the_mirrored_turn(self, make: Make) -> None:
        agent, wall = make("fuzzy"), scan({(-20, 20): 4.0, (25, 65): 3.0, (-65, -25): 5.0})
        chosen = action(agent, observed(wall, 0.5))
        assert chosen in (RIGHT_30, RIGHT_60)
        assert action(agent, observed(mirrored(wall), -0.5)) == MIRRORED[chosen]

    def test_a_near_beyond_far_is_refused(self, make: Make) -> None:
        with pytest.raises(UserError, match="front_near 8 is above front_far 7"):
            make("fuzzy", front_near=8.0)


def test_fuzzy_says_what_to_install(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "skfuzzy", None)
    with pytest.raises(UserError, match=r"pip install 'nnql-bullet\[baselines\]'"):
        make("fuzzy")
