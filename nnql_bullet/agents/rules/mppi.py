"""Model predictive path integral control: many drives in thought about a plan, weighed by what they cost.

Williams, Drews, Goldfain, Rehg and Theodorou, "Information-theoretic model predictive control" (IEEE T-RO 34(6), 2018),
with critics as in Nav2's controller of that name. A control is a heading change and a speed for one decision, as the
drive takes them. The first of each sample is one of the manoeuvres on offer, so that what is weighed is what is driven:
a mean of a turn to the left and one to the right would lead into what both avoid.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from nnql_bullet.agents.base import NoValues
from nnql_bullet.agents.turns import offered_turns, paces
from nnql_bullet.config import options
from nnql_bullet.env import ACTIONS, LARGEST_TURN, MANOEUVRES, TOWARD_TARGET, Observation
from nnql_bullet.geometry import Array, as_rows, wrap_angle
from nnql_bullet.jit import njit
from nnql_bullet.mapping.point_cloud import point_cloud
from nnql_bullet.mapping.prediction import clearance_at
from nnql_bullet.rollout import Actions
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.types import Few, NonNegative, Positive, Reach
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.profiles import profile_at, ramp_at, turn_profile
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec

PER_DECISION = 2
"""Places of a decision at which a sample is looked at."""
COLLISION = 100.0
"""Cost of a sample that is in contact from the start; in proportion to the time in contact."""

KEPT = 0.8
"""Share of the present clearance up to which a nearer obstacle is no contact: a vehicle within the margin gets out."""


@options
class MppiOptions:
    """Options of the samples and weights of the critics; each critic is a mean over a sample, about 1 at most."""

    kind: Literal["mppi"] = "mppi"
    samples: Few = 200
    """Drives in thought."""
    decisions: Annotated[int, Field(ge=1, le=30)] = 7
    """Length of each."""
    turn_degrees: Annotated[float, Field(ge=0, le=180)] = 30.0
    """Standard deviation of the heading changes [degrees]."""
    speed_share: NonNegative = 0.4
    """Standard deviation of the speeds, as a share of the drive's."""
    temperature: Positive = 0.3
    """lambda: a sample that costs so much more weighs e times less."""
    margin: Reach = 0.28
    """Clearance from the last scan below which the footprint counts as in contact [m]."""
    room: Reach = 0.66
    """Clearance from which on there is no cost of obstacles [m]."""
    obstacle_weight: NonNegative = 1.07
    """Of the clearance that lacks, as a share of the room."""
    distance_weight: NonNegative = 4.0
    """Of the distance from what it drives at, less that at present, over what it can drive."""
    heading_weight: NonNegative = 0.46
    """Of the direction of what it drives at, over half a turn."""
    align_weight: NonNegative = 0.5
    """Of the distance from the straight way to what it drives at, where that lies on a longer known way; over what it
    can drive."""
    forward_weight: NonNegative = 0.5
    """Of the speed backwards, over the drive's."""
    twirl_weight: NonNegative = 0.1
    """Of the heading changes, over the largest."""

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "Mppi":
        """Builds the agent."""
        return Mppi(self, vehicle, drive)


@dataclass(frozen=True, slots=True)
class MppiState:
    """Memory of n vehicles."""

    plans: Array
    """Controls about which the next samples are drawn: heading changes [rad], speeds as shares (n, decisions, 2)."""
    actions: Actions
    """Manoeuvres last chosen (n,)."""
    chosen: Array
    """Plans that go with them (n, decisions, 2)."""
    generators: dict[int, np.random.Generator] = field(default_factory=dict)
    """Random generator of each vehicle's drive."""


class Mppi(NoValues):
    """Takes the manoeuvre whose samples weigh most together; their mean is the plan of the next decision.

    It sees the rays, the speed, the yaw rate and the target's bearing and distance, and knows the drive's own profiles
    and the footprint. It remembers its plan, and where the chance of each drive has come to, which is a function of the
    world's seed. Told of another manoeuvre in place of its own, it drops the plan.
    """

    def __init__(self, options: MppiOptions, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        o, scale = options, length_scale(vehicle.footprint)
        self.options = o
        self._sensor = vehicle.sensor
        self._sigma = np.array([np.radians(o.turn_degrees), o.speed_share])
        self._fresh = np.tile([0.0, 1.0], (o.decisions, 1))
        self._setting = Setting(
            footprint=as_rows((vehicle.footprint,))[0],
            max_rate=vehicle.limits.yaw_rate,
            yaw_acceleration=vehicle.limits.yaw_acceleration,
            acceleration=vehicle.limits.acceleration,
            period=drive.decision_period,
            speed=drive.speed,
            paces=paces(drive) / drive.speed,
            arrived=drive.speed * drive.decision_period / 2,
            temperature=o.temperature,
            margin=o.margin * scale,
            room=max(o.room * scale, 1e-9),
            obstacle=o.obstacle_weight,
            distance=o.distance_weight,
            heading=o.heading_weight,
            align=o.align_weight,
            forward=o.forward_weight,
            twirl=o.twirl_weight,
        )

    def initial_state(self, size: int) -> MppiState:
        """Returns plans to drive straight ahead, and no generators yet."""
        plans = np.tile(self._fresh, (size, 1, 1))
        return MppiState(plans, np.full(size, TOWARD_TARGET), plans)

    def reset(self, state: MppiState, world_seeds: Mapping[int, int]) -> MppiState:
        """Drops the plans of these vehicles, and seeds their generators by their worlds."""
        plans = state.plans.copy()
        plans[list(world_seeds)] = self._fresh
        seeded = {vehicle: rng(seed, Stream.CHANCE) for vehicle, seed in world_seeds.items()}
        return replace(state, plans=plans, generators=state.generators | seeded)

    def act(self, observations: Observation, state: MppiState) -> tuple[Actions, MppiState]:
        """Chooses a manoeuvre for each vehicle that drives; the generators advance."""
        o, shape = observations, (self.options.samples, self.options.decisions, 2)
        actions, chosen = np.full(len(o.speed), TOWARD_TARGET), np.tile(self._fresh, (len(o.speed), 1, 1))
        points = point_cloud(o.ray_distances, self._sensor)
        turns = offered_turns(o.target_bearing)
        aims = o.target_distance * np.stack([np.cos(o.target_bearing), np.sin(o.target_bearing)])
        on_way = o.distance_left > o.target_distance + self._setting.arrived
        for i, generator in state.generators.items():
            controls = state.plans[i] + self._sigma * generator.standard_normal(shape)
            seen = points[i][np.isfinite(points[i, :, 0])]
            here = clearance_at(0.0, 0.0, 0.0, seen, len(seen), self._setting.footprint)
            setting = self._setting._replace(margin=min(self._setting.margin, KEPT * here))
            actions[i], chosen[i] = best_manoeuvre(
                *(controls, turns[i], seen, aims[:, i], bool(on_way[i])),
                *(float(o.speed[i]), float(o.yaw_rate[i]), setting),
            )
        return actions, MppiState(chosen, actions, chosen, state.generators)

    def override(self, state: MppiState, actions: Actions) -> MppiState:
        """Returns the state after these actions in place of those last chosen; plans for others are dropped."""
        plans = np.where((actions == state.actions)[:, None, None], state.chosen, self._fresh)
        return replace(state, plans=plans)


class Setting(NamedTuple):
    """What the kernel knows of the vehicle, its drive and the critics, whose weights are those of `MppiOptions`."""

    footprint: Array
    """A row (7,) of `geometry.as_rows`, in the vehicle's frame."""
    max_rate: float
    """Limit on the yaw rate [rad/s]."""
    yaw_acceleration: float
    """Limit on the yaw acceleration [rad/s2]."""
    acceleration: float
    """Limit on acceleration and deceleration [m/s2]."""
    period: float
    """Time between decisions [s]."""
    speed: float
    """Of the drive [m/s]."""
    paces: Array
    """Speeds on offer, as shares of the drive's (4,)."""
    arrived: float
    """Distance from which on a sample has arrived, and is no longer asked how far away it is [m]."""
    temperature: float
    margin: float
    """[m]"""
    room: float
    """[m]"""
    obstacle: float
    distance: float
    heading: float
    align: float
    forward: float
    twirl: float


@njit(nogil=True)
def best_manoeuvre(
    controls: Array,
    turns: Array,
    points: Array,
    aim: Array,
    on_way: bool,
    speed: float,
    yaw_rate: float,
    setting: Setting,
) -> tuple[int, Array]:
    """The manoeuvre whose samples weigh most together, and the plan after it (decisions, 2).

    Args:
        controls: Heading changes [rad] and shares of the speed (samples, decisions, 2); they are brought into bounds.
        turns: Heading changes on offer (6,) [rad].
        points: Of the scan, in the vehicle frame (r, 2) [m].
        aim: What to drive at, likewise (2,) [m].
        on_way: Whether it lies on a longer known way.
        speed: [m/s]
        yaw_rate: [rad/s]
        setting: The vehicle, its drive and the critics.
    """
    samples = len(controls)
    costs, first = np.empty(samples), np.empty(samples, np.int64)
    for k in range(samples):
        control = controls[k]
        control[:, 0] = np.minimum(np.maximum(control[:, 0], -LARGEST_TURN), LARGEST_TURN)
        control[:, 1] = np.minimum(np.maximum(control[:, 1], setting.paces.min()), 1.0)
        turn, pace = np.abs(turns - control[0, 0]).argmin(), np.abs(setting.paces - control[0, 1]).argmin()
        first[k] = pace * ACTIONS + turn
        control[0, 0], control[0, 1] = turns[turn], setting.paces[pace]
        costs[k] = sample_cost(control, points, aim, on_way, speed, yaw_rate, setting)
    weights = np.exp((costs.min() - costs) / setting.temperature)
    together = np.zeros(MANOEUVRES)
    for k in range(samples):
        together[first[k]] += weights[k]
    best = together.argmax()
    mean = np.zeros(controls.shape[1:])
    for k in range(samples):
        if first[k] == best:
            mean += weights[k] / together[best] * controls[k]
    mean[:-1] = mean[1:]
    mean[-1, 0] = 0.0
    return int(best), mean


@njit(nogil=True)
def sample_cost(
    control: Array, points: Array, aim: Array, on_way: bool, speed: float, yaw_rate: float, setting: Setting
) -> float:
    """Drives one sample (decisions, 2) in thought and adds up its critics; see `best_manoeuvre`."""
    p, count = setting, len(control) * PER_DECISION
    reach, step = setting.speed * setting.period * len(control), setting.period / PER_DECISION
    away_now = np.hypot(aim[0], aim[1])
    x = y = yaw = 0.0
    near = away = off = aside = back = twirl = 0.0
    arrived, rest = False, count
    for decision in range(len(control)):
        change, goal = control[decision, 0], control[decision, 1] * p.speed
        peak, rise, hold, fall = turn_profile(yaw_rate, change, p.max_rate, p.yaw_acceleration)
        before, heading, rate, last = 0.0, 0.0, yaw_rate, speed
        twirl += abs(change) / LARGEST_TURN / len(control)
        for j in range(1, PER_DECISION + 1):
            rate, heading = profile_at(yaw_rate, peak, rise, hold, fall, j * step)
            now = ramp_at(speed, goal, p.acceleration, j * step)
            middle, way = yaw + (before + heading) / 2, (last + now) / 2 * step
            x, y, before, last = x + way * np.cos(middle), y + way * np.sin(middle), heading, now
            room = clearance_at(x, y, yaw + heading, points, len(points), p.footprint)
            if room <= p.margin:
                return float(COLLISION * rest / count + away / count)
            rest -= 1
            dx, dy = aim[0] - x, aim[1] - y
            distance = np.hypot(dx, dy)
            arrived = arrived or distance < p.arrived
            near += max(p.room - room, 0.0) / p.room
            back += max(-now, 0.0) / p.speed
            if not arrived:
                away += p.distance * (distance - away_now) / reach
                off += abs(wrap_angle(np.arctan2(dy, dx) - yaw - heading)) / np.pi
                if on_way:
                    aside += abs(aim[0] * y - aim[1] * x) / max(away_now, p.arrived) / reach
            else:
                away -= p.distance * away_now / reach
        yaw, yaw_rate, speed = yaw + heading, rate, last
    critics = p.obstacle * near + away + p.heading * off + p.align * aside + p.forward * back
    return float(critics / count + p.twirl * twirl)
