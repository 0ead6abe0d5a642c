"""What happened in one episode, step by step, as one file; everything drawn later is drawn from it.

A recording is a NumPy .npz without pickled objects: a JSON text `about` (format, world, vehicle, ending) and the arrays
of `Recording`. With n decisions, arrays of states have n + 1 rows and arrays of steps have n.
"""

import json
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.env import Observation, Transition, heading_change, stacked
from nnql_bullet.errors import UserError
from nnql_bullet.files import write_atomically
from nnql_bullet.geometry import Array, OrientedBox, Pose
from nnql_bullet.rollout import EpisodeSummary, overridden
from nnql_bullet.sim.base import Sample
from nnql_bullet.task import REWARD_TERMS
from nnql_bullet.vehicle.payload import urdf_text
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import Patrol, WorldSpec

if TYPE_CHECKING:  # agents bring along torch, which those that only read recordings do without
    from nnql_bullet.agents import Agent

FORMAT = "nnql-bullet recording 1"


@dataclass(frozen=True)
class Recording:
    """An episode. Poses are x, y [m], yaw [rad] of the rear-axle centre."""

    about: dict[str, Any]
    """World, vehicle's footprint and sensor, ending, seed and what else is said once."""
    state_time: Array
    """(n + 1,) [s]"""
    state_pose: Array
    """(n + 1, 3)"""
    readings: Array
    """Of the eight sectors (n + 1, 8) [m]."""
    ray_distances: Array
    """(n + 1, 72) [m]"""
    state_property: NDArray[np.str_]
    """(n + 1,): SS, NS, WS, FS"""
    q_values: Array
    """Of the five turns (n, 5); NaN where the agent did not ask itself."""
    action: NDArray[np.int64]
    """(n,), `env.STOP` and more where the vehicle was to stop."""
    overridden: NDArray[np.bool_]
    """Where a shield took the decision in the agent's place (n,)."""
    heading_command: Array
    """Heading change asked for (n,) [rad]."""
    heading_error: Array
    """What was left of it at the end of the step (n,) [rad]."""
    clearance: Array
    """Smallest in the step (n,) [m]."""
    contact: NDArray[np.bool_]
    """(n,)"""
    reward_terms: Array
    """(n, 6) in the order of `task.REWARD_TERMS`."""
    sample_time: Array
    """Samples between decisions (m,) [s]."""
    sample_pose: Array
    """(m, 3)"""
    joint_angles: Array
    """Left drive, right drive, swivel, caster roll (m, 4) [rad]."""
    wheel_speeds: Array
    """Left, right (m, 2) [rad/s]."""

    @cached_property
    def world(self) -> WorldSpec:
        """Where it happened."""
        kept = {key: value for key, value in self.about["world"].items() if key != "digest"}
        patrols = kept.pop("patrols", ())  # older recordings know of none
        return WorldSpec(
            **{
                **kept,
                "obstacles": tuple(OrientedBox(**box) for box in kept["obstacles"]),
                "start": Pose(**kept["start"]),
                "target": tuple(kept["target"]),
            },
            patrols=tuple(Patrol(OrientedBox(**p["box"]), tuple(p["end"]), p["speed"], p["phase"]) for p in patrols),
        )

    @property
    def summary(self) -> EpisodeSummary:
        """What the episode came to.

        Raises:
            UserError: If the recording was written without one, as version 0.1 did.
        """
        if "summary" not in self.about:
            raise UserError("this recording holds no summary; record the drive again")
        return EpisodeSummary(**self.about["summary"])

    @property
    def obstacles(self) -> tuple[OrientedBox, ...]:
        """The world's boxes that stand still."""
        return self.world.obstacles

    @property
    def patrols(self) -> tuple[Patrol, ...]:
        """The world's boxes that move."""
        return self.world.patrols

    def boxes_at(self, time: float) -> tuple[OrientedBox, ...]:
        """All of them, those that move where they were then [s]."""
        return self.obstacles + tuple(patrol.at(time) for patrol in self.patrols)

    @property
    def footprint(self) -> OrientedBox:
        """The vehicle's footprint in its own frame."""
        return OrientedBox(**self.about["vehicle"]["footprint"])

    @staticmethod
    def load(path: Path | str) -> "Recording":
        """Reads a recording.

        Raises:
            UserError: If the file is not one, or is damaged.
        """
        return load_recording(Path(path))

    def plot(self, path: Path | str) -> None:
        """Draws the path through the world and the clearance over time as a picture (.png)."""
        from nnql_bullet.reports.plots import draw_trajectory

        draw_trajectory(self, Path(path))

    def render(self, path: Path | str, **values: Any) -> None:
        """Draws the drive as a video.

        Args:
            path: The file, .mp4 or .gif.
            **values: Further arguments of `render.filming.render`: camera, size, fps, speed, begin, end, workers, ...

        Raises:
            UserError: If an argument is out of range, or a renderer or encoder is missing.
            WorkFailed: If drawing fails.
        """
        from nnql_bullet.render.filming import render

        render(self, path, **values)

    def save(self, path: Path | str) -> None:
        """Writes the file atomically.

        Raises:
            OSError: If it cannot be written; then nothing is left under its name.
        """
        arrays = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "about"}
        about = np.array(json.dumps({"format": FORMAT, **self.about}))
        write_atomically(Path(path), lambda temporary: np.savez_compressed(temporary, about=about, **arrays))


def load_recording(path: Path) -> Recording:
    """Reads a recording.

    Raises:
        UserError: If the file is not one, or is damaged.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        about = json.loads(str(arrays.pop("about")))
        if about.pop("format") != FORMAT:
            raise ValueError("another format")
        if "overruled" in arrays:  # the name in version 0.1
            arrays["overridden"] = arrays.pop("overruled")
        arrays.setdefault("overridden", np.zeros(arrays["action"].shape, np.bool_))  # older recordings know no shield
        return Recording(about=about, **arrays)
    except Exception as error:  # zipfile, zlib and NumPy raise whatever a damaged file leads them into
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"{path}: not a whole recording of this program ({reason}); record it again") from None


class Recorder:
    """Watches one episode and turns it into a `Recording`."""

    def __init__(self, vehicle: VehicleSpec, agent: "Agent") -> None:
        self.trace: list[Sample] = []
        self._vehicle = vehicle
        self._agent = agent
        self._steps: list[Transition] = []
        self._values: list[Array] = []
        self._overridden: list[bool] = []

    def on_reset(self, world: WorldSpec, observation: Observation) -> None:
        """The start of the episode."""
        self._world = world
        self._first = observation
        self.trace.clear()
        self._steps.clear()
        self._values = [self._expected(observation)]
        self._overridden.clear()

    def on_step(self, transition: Transition) -> None:
        """One step."""
        self._steps.append(transition)
        self._overridden.append(bool(overridden(self._agent, 1)[0]))
        if transition.ending is None:
            self._values.append(self._expected(transition.s_t))

    def _expected(self, observation: Observation) -> Array:
        """What the agent, before it decides, expects of the five turns (5,)."""
        (values,) = self._agent.action_values(stacked([observation]))
        return np.asarray(values)

    def recording(self, **about: Any) -> Recording:
        """The episode so far; `about` is kept with it."""
        steps, vehicle = self._steps, self._vehicle
        observations = [self._first, *(step.s_t for step in steps)]
        poses = [self._world.start, *(step.motion.pose for step in steps)]
        samples = self.trace
        return Recording(
            about={
                **about,
                "world": {**asdict(self._world), "digest": self._world.digest},
                "vehicle": {
                    "name": vehicle.name,
                    "footprint": asdict(vehicle.footprint),
                    "sensor": vehicle.sensor,
                    "urdf": urdf_text(vehicle),
                    "joints": {field.name: getattr(vehicle.joints, field.name) for field in fields(vehicle.joints)},
                    "wheel_radius": vehicle.wheel_radius,
                },
                "ending": steps[-1].ending,
            },
            state_time=np.cumsum([0.0, *(step.motion.duration for step in steps)]),
            state_pose=_poses(poses),
            readings=np.array([observation.readings for observation in observations]),
            ray_distances=np.array([observation.ray_distances for observation in observations]),
            state_property=np.array([observation.state_property.label for observation in observations]),
            q_values=np.array(self._values[: len(steps)]),
            action=np.array([step.a_tm1 for step in steps]),
            overridden=np.array(self._overridden),
            heading_command=heading_change(
                [step.a_tm1 for step in steps], [step.s_tm1.target_bearing for step in steps]
            ),
            heading_error=np.array([step.motion.heading_error for step in steps]),
            clearance=np.array([step.motion.clearance for step in steps]),
            contact=np.array([step.motion.touching for step in steps]),
            reward_terms=np.array([[step.terms[name] for name in REWARD_TERMS] for step in steps]),
            sample_time=np.array([sample.time for sample in samples]),
            sample_pose=_poses([sample.pose for sample in samples]),
            joint_angles=np.array([sample.joint_angles for sample in samples]),
            wheel_speeds=np.array([sample.wheel_speeds for sample in samples]),
        )


def _poses(poses: list[Pose]) -> Array:
    return np.array([(pose.x, pose.y, pose.yaw) for pose in poses])
