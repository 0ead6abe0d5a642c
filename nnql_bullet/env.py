"""The task over a simulator: `reset` and `step` only sequence; vehicle, sensing, task and world decide."""

from dataclasses import dataclass

from nnql_bullet import paper
from nnql_bullet.geometry import Array, Pose, bearing, distance
from nnql_bullet.sensing import Scan
from nnql_bullet.sim.base import Motion, Sample, Simulator
from nnql_bullet.task import Ending, Property, TaskOptions, ending, reward_terms, state_property
from nnql_bullet.worlds.spec import WorldSpec

TOWARD_TARGET = len(paper.TURNS)
"""The sixth action: the paper's rule for a safe state, "changes its orientation toward the target location"."""
ACTIONS = len(paper.TURNS) + 1
LARGEST_TURN = max(paper.TURNS)


@dataclass(frozen=True, slots=True)
class Observation:
    """What an agent is told."""

    readings: Array
    """Of the eight sensors (8,) [m]: s_t of eq. (1)."""
    target_distance: float
    """[m]"""
    target_bearing: float
    """In the vehicle frame [rad], positive to the left."""
    yaw_rate: float
    """[rad/s]"""
    property: Property


@dataclass(frozen=True, slots=True)
class Transition:
    """One step. `discount_t` is 0 where the episode ended for good, and 1 otherwise, at a timeout too."""

    s_tm1: Observation
    a_tm1: int
    r_t: float
    discount_t: float
    s_t: Observation
    terms: dict[str, float]
    ending: Ending | None
    motion: Motion
    scan: Scan
    """The rays behind `s_t`."""


def heading_change(action: int, target_bearing: float) -> float:
    """The turn [rad] that an action asks for: one of the paper's five, or toward the target up to the largest."""
    if action == TOWARD_TARGET:
        return min(max(target_bearing, -LARGEST_TURN), LARGEST_TURN)
    return paper.TURNS[action]


class Navigation:
    """One vehicle's episodes in whatever simulator it is given."""

    def __init__(self, simulator: Simulator, task: TaskOptions) -> None:
        self.simulator = simulator
        self.task = task

    def reset(self, world: WorldSpec) -> tuple[Observation, Scan]:
        """Starts an episode in `world`."""
        self._world = world
        self._steps = 0
        self.simulator.reset(world)
        scan = self.simulator.scan()
        self._observation = self._observe(self.simulator.pose(), 0.0, scan, None)
        return self._observation, scan

    def step(self, action: int, trace: list[Sample] | None = None) -> Transition:
        """Carries out one decision."""
        s_tm1 = self._observation
        motion = self.simulator.advance(heading_change(action, s_tm1.target_bearing), trace)
        scan = self.simulator.scan()
        s_t = self._observe(motion.pose, motion.yaw_rate, scan, motion)
        self._steps += 1
        terms = reward_terms(s_tm1.property, s_t.property, s_tm1.readings, s_t.readings, self.task)
        end = ending(s_t.property, self._steps, self.task)
        self._observation = s_t
        return Transition(
            s_tm1=s_tm1,
            a_tm1=action,
            r_t=sum(terms.values()),
            discount_t=0.0 if end in ("goal", "collision") else 1.0,
            s_t=s_t,
            terms=terms,
            ending=end,
            motion=motion,
            scan=scan,
        )

    def _observe(self, pose: Pose, yaw_rate: float, scan: Scan, motion: Motion | None) -> Observation:
        return Observation(
            readings=scan.readings,
            target_distance=distance(pose, *self._world.target),
            target_bearing=bearing(pose, *self._world.target),
            yaw_rate=yaw_rate,
            property=state_property(scan.readings, motion, self.task),
        )
