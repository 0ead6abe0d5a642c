"""What the rules that engineers use decide, against closed forms, brute force and geometry."""

from collections.abc import Callable
from math import ceil

import helpers
import numpy as np
import pytest
from helpers import Driving

from nnql_bullet import paper
from nnql_bullet.agents.rules.mppi import Mppi, best_manoeuvre, sample_cost
from nnql_bullet.agents.rules.orca import half_planes, nearest_permitted
from nnql_bullet.agents.rules.pure_pursuit import PurePursuit
from nnql_bullet.env import ACTIONS, MANOEUVRES, SLOW, STOP, TOWARD_TARGET, Observation
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.presets import load_config
from nnql_bullet.sensing import RAYS, sector_readings
from nnql_bullet.task import StateProperty
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec

RIVALS = ("dwa", "pure_pursuit", "mppi", "orca")
DRIVE = DriveOptions()
DEGREES = -20.0 + 5.0 * np.arange(RAYS)
NOTHING = np.full(RAYS, paper.SENSOR_RANGE)
SAMPLES, DECISIONS = 40, 4

Make = Callable[..., Driving]


@pytest.fixture(scope="module")
def make(vehicle: VehicleSpec) -> Make:
    """Makes a rule that has begun with vehicle 0 in world 0."""

    def made(kind: str, **options: object) -> Driving:
        agent = load_config("paper", {"agent": {"kind": kind, **options}}).agent.make_agent(0, vehicle, DRIVE)
        return Driving(agent).reset(0)

    return made


def observed(rays: Array = NOTHING, distance: float = 50.0, bearing: float = 0.0, speed: float = 2.0) -> Observation:
    """What one vehicle sees that drives straight on."""
    return helpers.observed(
        (sector_readings(rays), distance, bearing, 0.0, speed, StateProperty.NON_SAFE, rays),
    )


def wall(vehicle: VehicleSpec, gap: float) -> Array:
    """Rays that meet a wall across the way, so far ahead of the footprint [m]."""
    front = vehicle.footprint.x + vehicle.footprint.half_length + gap - vehicle.sensor.position[0]
    ahead = np.cos(np.radians(DEGREES))
    with np.errstate(divide="ignore"):
        return np.where(ahead > 1e-9, np.minimum(front / ahead, paper.SENSOR_RANGE), paper.SENSOR_RANGE)


def action(agent: Driving, observations: Observation) -> int:
    (chosen,) = agent.act(observations).tolist()
    return int(chosen)


@pytest.mark.parametrize("kind", RIVALS)
class TestEveryRival:
    @pytest.mark.parametrize("bearing", [-0.4, 0.0, 0.4])
    def test_where_nothing_stands_it_drives_ahead_to_the_side_of_the_target(
        self, kind: str, make: Make, bearing: float
    ) -> None:
        cold = {"temperature": 0.01} if kind == "mppi" else {}  # warm, it may put off a turn that costs little
        chosen = action(make(kind, **cold), observed(bearing=bearing))
        assert chosen < ACTIONS
        toward = {0.4: (1, TOWARD_TARGET), 0.0: (0, TOWARD_TARGET), -0.4: (3, TOWARD_TARGET)}
        assert chosen in toward[bearing]

    def test_before_a_wall_it_does_not_drive_on(self, kind: str, make: Make, vehicle: VehicleSpec) -> None:
        assert action(make(kind), observed(wall(vehicle, 1.3))) not in (0, TOWARD_TARGET)

    def test_standing_at_a_wall_it_touches_nothing(self, kind: str, make: Make, vehicle: VehicleSpec) -> None:
        chosen = action(make(kind), observed(wall(vehicle, 0.05), speed=0.0))
        assert STOP <= chosen < SLOW


class TestDwa:
    def test_it_brakes_where_it_could_not_after_another_decision(self, make: Make, vehicle: VehicleSpec) -> None:
        """With the target's direction alone to choose by, the distance is the article's, to a predicted pose."""
        agent = make("dwa", margin=0.0, distance_weight=0.0, velocity_weight=1e-3)
        braking = DRIVE.speed**2 / (2 * vehicle.limits.acceleration)
        needed = DRIVE.speed * DRIVE.decision_period + braking
        gaps = np.arange(0.5, 4.0, 0.05)
        ahead = [gap for gap in gaps if action(agent, observed(wall(vehicle, gap))) in (0, TOWARD_TARGET)]
        assert needed - 0.25 <= min(ahead) <= needed + 0.05
        assert ahead == pytest.approx(gaps[-len(ahead) :])


class TestPurePursuit:
    @pytest.mark.parametrize(("distance", "bearing"), [(9.0, 0.3), (0.8, -0.7), (2.2, 1.4)])
    def test_its_arc_leads_through_the_point_ahead(self, make: Make, distance: float, bearing: float) -> None:
        agent = make("pure_pursuit", least_look_ahead=1.0, most_look_ahead=3.0, look_ahead_time=1.0).policy
        assert isinstance(agent, PurePursuit)
        (curvature,) = agent.curvatures(observed(distance=distance, bearing=bearing)).tolist()
        point = min(distance, 2.0) * np.array([np.cos(bearing), np.sin(bearing)])
        assert np.hypot(*(point - [0.0, 1 / curvature])) == pytest.approx(1 / abs(curvature))

    def test_it_is_slow_where_it_is_tight(self, make: Make) -> None:
        agent = make("pure_pursuit", least_radius=2.0, proximity=0.5, gain=1.0).policy
        assert isinstance(agent, PurePursuit)
        curvatures, clearances = np.array([0.0, 0.5, 1.0, 1.0]), np.array([1.0, np.inf, 0.6, 0.1])
        assert agent.speeds(curvatures, clearances) / DRIVE.speed == pytest.approx([1.0, 1.0, 0.5, 0.2])

    def test_distances_in_the_wrong_order_are_refused(self, make: Make) -> None:
        with pytest.raises(UserError, match="swap them"):
            make("pure_pursuit", least_look_ahead=5.0)


class TestMppi:
    def test_the_manoeuvre_is_the_one_of_the_heaviest_samples(self, make: Make, vehicle: VehicleSpec) -> None:
        """Weights by NumPy, over all manoeuvres one by one."""
        agent = make("mppi").policy
        assert isinstance(agent, Mppi)
        turns, aim = np.array([*paper.TURNS, 0.2]), np.array([8.0, 1.0])
        points = np.array([[2.5, -0.3], [2.5, 0.0], [2.5, 0.3]])
        controls = np.random.default_rng(0).normal([0.0, 0.8], [0.5, 0.4], (SAMPLES, DECISIONS, 2))
        best, plan = best_manoeuvre(controls, turns, points, aim, False, 2.0, 0.0, agent._setting)
        costs = np.array([sample_cost(one, points, aim, False, 2.0, 0.0, agent._setting) for one in controls])
        weights = np.exp(-(costs - costs.min()) / agent.options.temperature)
        paces = (1.0, 0.0, -DRIVE.reverse_share, DRIVE.reverse_share)
        offered = [(turn, pace) for pace in paces for turn in turns]
        its = [(controls[:, 0] == one).all(axis=-1) for one in offered]
        assert len(offered) == MANOEUVRES and np.sum(its) == SAMPLES
        assert best == np.argmax([weights[one].sum() for one in its])
        mean = np.average(controls[its[best]], axis=0, weights=weights[its[best]])
        assert plan[:-1] == pytest.approx(mean[1:])

    def test_contact_costs_more_the_sooner_it_is(self, make: Make) -> None:
        agent = make("mppi").policy
        assert isinstance(agent, Mppi)
        ahead = np.tile([0.0, 1.0], (6, 1))
        costs = [
            sample_cost(ahead, np.array([[x, 0.0]]), np.array([20.0, 0.0]), False, 2.0, 0.0, agent._setting)
            for x in (1.5, 3.0, 4.5, 30.0)
        ]
        assert costs == sorted(costs, reverse=True) and costs[2] > 5 > costs[3]

    def test_told_of_another_manoeuvre_it_drops_its_plan(self, make: Make) -> None:
        agent = make("mppi")
        fresh = agent.state.plans
        chosen = agent.act(observed(bearing=0.5))
        assert not np.array_equal(agent.state.plans, fresh)
        agent.override((chosen + 1) % MANOEUVRES)
        assert np.array_equal(agent.state.plans, fresh)


class TestOrca:
    @pytest.mark.parametrize("seed", range(30))
    def test_the_velocity_is_the_best_of_a_fine_grid(self, seed: int) -> None:
        chance, most, step = np.random.default_rng(seed), 2.0, 0.02
        angles = chance.uniform(-np.pi, np.pi, chance.integers(1, 9))
        offsets = chance.uniform(-1.5, 0.5 if seed % 2 else 1.5, len(angles))
        normals = np.stack([np.cos(angles), np.sin(angles)], axis=-1)  # permitted: normal . v >= offset
        lines = np.column_stack([normals * offsets[:, None], normals[:, 1], -normals[:, 0]])
        wanted = chance.uniform(-2.0, 2.0, 2)
        found = nearest_permitted(lines, wanted, most)
        axis = step * np.arange(-ceil(most / step), ceil(most / step) + 1)
        grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
        grid = grid[np.hypot(*grid.T) <= most]
        lacks, its_lack = (offsets - grid @ normals.T).max(axis=-1), float((offsets - normals @ found).max())
        assert np.hypot(*found) <= most + 1e-9
        if its_lack > 1e-9:  # none is permitted, and this one is least far from it
            assert its_lack <= lacks.min() + 1e-9
        else:
            away = np.hypot(*(grid[lacks <= 0.0] - wanted).T)
            assert np.hypot(*(found - wanted)) <= away.min(initial=np.inf) + 1e-9

    @pytest.mark.parametrize("seed", range(30))
    def test_what_is_permitted_keeps_clear_of_every_point_for_the_horizon(self, seed: int) -> None:
        """Velocities drawn at random are driven for the horizon past a short wall that moves."""
        chance, radius, horizon = np.random.default_rng(seed), 0.7, 2.0
        middle, along = chance.uniform(1.5, 4.0), chance.uniform(-1.0, 1.0, 2)
        along /= np.hypot(*along)
        points = middle * np.array([1.0, 0.0]) + np.linspace(-0.7, 0.7, 4)[:, None] * along
        points = points[np.argsort(np.arctan2(points[:, 1], points[:, 0]))]
        moving = np.tile(chance.uniform(-0.5, 0.5, 2), (4, 1))
        lines = half_planes(points, moving, chance.uniform(-2.0, 2.0, 2), radius, horizon, DRIVE.decision_period)
        assert len(lines) == 1
        velocities = chance.uniform(-2.0, 2.0, (300, 2))
        (x, y, dx, dy) = lines[0]
        permitted = velocities[dx * (velocities[:, 1] - y) - dy * (velocities[:, 0] - x) >= 0.0]
        assert 0 < len(permitted) < 300
        times = np.linspace(0.0, horizon, 50)
        for point, its in zip(points, moving, strict=True):
            away = point - times[:, None, None] * (permitted - its)
            assert np.hypot(away[..., 0], away[..., 1]).min() >= radius - 0.2 * (np.hypot(*point) > points[:, 0].min())

    def test_what_crosses_bends_the_way_and_what_stands_there_does_not(self) -> None:
        """A point off the way, that stands or comes toward it."""
        now, point = np.array([2.0, 0.0]), np.array([[4.0, -2.0]])
        ways = [
            nearest_permitted(half_planes(point, np.array([its]), now, 0.8, 3.0, DRIVE.decision_period), now, 2.0)
            for its in ([0.0, 0.0], [0.0, 1.0])
        ]
        assert ways[0] == pytest.approx(now)
        assert np.hypot(*(ways[1] - now)) > 0.1
