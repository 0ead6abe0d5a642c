"""What happened in one episode, step by step, as one file; everything drawn later is drawn from it.

A recording is a NumPy .npz without pickled objects: a JSON text `about` (format, world, vehicle, ending) and the arrays
of `Recording`. With n decisions, arrays of states have n + 1 rows and arrays of steps have n.
"""

import filecmp
import json
import zipfile
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from math import inf, prod
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from nnql_bullet import paper
from nnql_bullet.arguments import checked
from nnql_bullet.env import MANOEUVRES, Observation, Transition
from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file, parse_json, write_atomically
from nnql_bullet.geometry import Array, Circle, OrientedBox, Pose, Shape
from nnql_bullet.rollout import Decision, EpisodeSummary
from nnql_bullet.sensing import BlindArc, RayCount, Sensor, SensorRange
from nnql_bullet.sim.base import Sample
from nnql_bullet.task import ENDINGS, NO_ENDING, REWARD_TERMS, StateProperty
from nnql_bullet.types import Vector
from nnql_bullet.vehicle.payload import urdf_text
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.passages import Point
from nnql_bullet.worlds.spec import Patrol, WorldSpec

FORMAT = "nnql-bullet recording 1"
DERIVED = (".mp4", ".gif", ".rrd", ".mcap")
"""Suffixes of films and time lines beside a recording."""
RECORDINGS = ("*.npz", *(f"*{suffix}" for suffix in DERIVED))
"""Patterns of recordings, and of their films and time lines."""
TIPPING = 0.05
"""Tilt from which on it is recorded [rad]: a rigid vehicle tilts visibly only when wheels leave the ground."""
MOST_BYTES = 500_000_000
"""Size of the largest recording that is read, unpacked [bytes]."""


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
    """(n + 1, rays) [m]"""
    state_property: NDArray[np.str_]
    """(n + 1,): SS, NS, WS, FS"""
    q_values: Array
    """Of the five turns (n, 5); NaN where the agent did not ask itself."""
    action: NDArray[np.int64]
    """Numbers of manoeuvres (n,): see `env.MANOEUVRES`."""
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
    """(n, number of terms), see `term_names`."""
    sample_time: Array
    """Samples between decisions (m,) [s]."""
    sample_pose: Array
    """(m, 3)"""
    joint_angles: Array
    """Left drive, right drive, and of each caster that swivels its swivel and its roll (m, j) [rad]."""
    wheel_speeds: Array
    """Left, right (m, 2) [rad/s]."""

    @property
    def term_names(self) -> tuple[str, ...]:
        """Names of the reward terms; the file names them only if they are not the paper's."""
        return tuple(self.about.get("reward_terms", REWARD_TERMS))

    @cached_property
    def world(self) -> WorldSpec:
        """Where it happened."""
        kept = {key: value for key, value in self.about["world"].items() if key != "digest"}
        patrols = kept.pop("patrols", ())  # older recordings know of none
        return WorldSpec(
            **{
                **kept,
                "obstacles": tuple((Circle if "radius" in its else OrientedBox)(**its) for its in kept["obstacles"]),
                "start": Pose(**kept["start"]),
                "target": tuple(kept["target"]),
                "waypoints": tuple(map(tuple, kept.get("waypoints", ()))),
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
        its = self.about["summary"]
        return EpisodeSummary(**{**its, "waypoint_times": tuple(its.get("waypoint_times", ()))})

    @cached_property
    def aims(self) -> Array:
        """What the vehicle drove at in each state (n + 1, 2) [m].

        That is the target, the way point in turn or, on a plan, the carrot that moves on ahead of the vehicle.
        """
        aims = self.about.get("aims")
        return np.tile(self.world.target, (len(self.state_pose), 1)) if aims is None else np.array(aims)

    @cached_property
    def tilts(self) -> Array:
        """Tilts of the vehicle at the samples (m, 3): see `sim.base.Sample`; 0 where it never tipped."""
        return np.array(self.about.get("tilts", np.zeros((len(self.sample_time), 3))))

    @cached_property
    def plans(self) -> list[tuple[float, Array]]:
        """The plans along which the vehicle was led: when each was made [s], and its corners (k, 2) [m]."""
        return [(plan["time"], np.array(plan["corners"])) for plan in self.about.get("plans", ())]

    @property
    def obstacles(self) -> tuple[Shape, ...]:
        """The world's obstacles that stand still."""
        return self.world.obstacles

    @property
    def patrols(self) -> tuple[Patrol, ...]:
        """The world's boxes that move."""
        return self.world.patrols

    def boxes_at(self, time: float) -> tuple[Shape, ...]:
        """All of them, those that move where they were then [s]."""
        return self.obstacles + tuple(patrol.at(time) for patrol in self.patrols)

    @property
    def footprint(self) -> OrientedBox:
        """The vehicle's footprint in its own frame."""
        return OrientedBox(**self.about["vehicle"]["footprint"])

    @cached_property
    def sensor(self) -> Sensor:
        """The vehicle's sensor, which read the rays."""
        vehicle = self.about["vehicle"]
        arc = vehicle.get("blind_arc_degrees")
        return Sensor(
            position=tuple(vehicle["sensor"]),
            rays=self.ray_distances.shape[1],
            range=vehicle.get("sensor_range", paper.SENSOR_RANGE),  # older recordings know no other
            blind_arc_degrees=arc and tuple(arc),
        )

    @staticmethod
    @checked
    def load(path: Path | str) -> "Recording":
        """Reads a recording.

        Raises:
            UserError: If the file is not one, or is damaged.
        """
        return load_recording(Path(path))

    @checked
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

    @checked
    def save(self, path: Path | str) -> None:
        """Writes the file atomically.

        If it takes the place of another recording, the films and time lines of that one, which have its name and end in
        .mp4, .gif, .rrd or .mcap, are removed.

        Raises:
            OSError: If it cannot be written; then nothing is left under its name.
        """
        file = Path(path)
        arrays = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "about"}
        about = np.array(json.dumps({"format": FORMAT, **self.about}))

        def write(temporary: Path) -> None:
            np.savez_compressed(temporary, about=about, **arrays)
            if file.exists() and not filecmp.cmp(temporary, file, shallow=False):
                _remove_derived(file)

        write_atomically(file, write)


def _remove_derived(file: Path) -> None:
    for suffix in DERIVED:
        file.with_suffix(suffix).unlink(missing_ok=True)


def load_recording(path: Path) -> Recording:
    """Reads a recording.

    Raises:
        UserError: If the file is not one, or is damaged.
    """
    if not is_file(path):
        raise UserError(f"{path}: there is no such recording; record a drive with: nnql-bullet drive")
    try:
        with path.open("rb") as file:
            _check_sizes(file)
            file.seek(0)
            with np.load(file, allow_pickle=False) as stored:  # noqa: TID251
                arrays = {name: stored[name] for name in stored.files}
        about = parse_json(str(arrays.pop("about")), "about")
        if about.pop("format") != FORMAT:
            raise ValueError("another format")
        if "overruled" in arrays:  # the name in version 0.1
            arrays["overridden"] = arrays.pop("overruled")
        arrays.setdefault("overridden", np.zeros(arrays["action"].shape, np.bool_))  # older recordings know no shield
        recording = Recording(about=about, **arrays)
        _check(recording)
        return recording
    except Exception as error:  # zipfile, zlib and NumPy raise whatever a damaged file leads them into
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"{path}: not a whole recording of this program ({reason}); record it again") from None


def _check_sizes(file: IO[bytes]) -> None:
    """Checks a .npz before its arrays are read: a few bytes can stand for more than the memory holds.

    Raises:
        ValueError: If it is too large, or an array is not what its header says.
    """
    with zipfile.ZipFile(file) as archive:
        if sum(info.file_size for info in archive.infolist()) > MOST_BYTES:
            raise ValueError(f"it unpacks to more than {MOST_BYTES} bytes")
        for info in archive.infolist():
            with archive.open(info) as member:
                version = np.lib.format.read_magic(member)
                read = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}[version[0]]
                shape, _, dtype = read(member)
            if dtype.hasobject or min(shape, default=0) < 0 or prod(shape) * dtype.itemsize > info.file_size:
                raise ValueError(f"{info.filename} is not what its header says")


def _check(recording: Recording) -> None:
    """Checks that a recording is one of an episode, so that nothing that is drawn from it fails half way.

    Raises:
        ValueError: If it is not.
    """
    about, n, m = recording.about, len(recording.action), len(recording.sample_time)
    _ABOUT.validate_json(json.dumps(about))
    numbers: dict[str, tuple[int, ...]] = {
        "state_time": (n + 1,),
        "state_pose": (n + 1, 3),
        "readings": (n + 1, paper.SECTORS),
        "ray_distances": (n + 1, _RAYS.validate_python(recording.ray_distances.size // (n + 1))),
        "heading_command": (n,),
        "heading_error": (n,),
        "clearance": (n,),
        "reward_terms": (n, len(recording.term_names)),
        "sample_time": (m,),
        "sample_pose": (m, 3),
        "joint_angles": (m, len(about["vehicle"].get("joints", range(4)))),
        "wheel_speeds": (m, 2),
        "action": (n,),
    }
    others = {"state_property": ("U", (n + 1,)), "overridden": ("b", (n,)), "contact": ("b", (n,))}
    for name, shape in {**numbers, "q_values": (n, len(paper.TURNS))}.items():
        array = getattr(recording, name)
        if array.shape != shape or array.dtype.kind not in "fiu":
            raise ValueError(f"{name} must be numbers of shape {shape}")
        if name != "q_values" and not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite")
    for name, (kind, shape) in others.items():
        if getattr(recording, name).shape != shape or getattr(recording, name).dtype.kind != kind:
            raise ValueError(f"{name} must be of shape {shape}")
    actions, labels = recording.action, [one.label for one in StateProperty]
    if n < 1 or m < 1 or actions.dtype.kind not in "iu" or not ((actions >= 0) & (actions < MANOEUVRES)).all():
        raise ValueError("action must be manoeuvres")
    if not np.isin(recording.state_property, labels).all() or about["ending"] not in (None, *ENDINGS):
        raise ValueError("a state or the ending is unknown")
    places = [(recording.aims, (n + 1, 2)), *((plan, (len(plan), 2)) for _, plan in recording.plans)]
    if not all(its.shape == shape and np.isfinite(its).all() for its, shape in [*places, (recording.tilts, (m, 3))]):
        raise ValueError("aims, plans and tilts must be finite, and of each state or sample")
    if (np.diff(recording.state_time) < 0).any() or (np.diff(recording.sample_time) < 0).any():
        raise ValueError("time must not go back")
    world, _, _ = recording.world, recording.footprint, recording.summary if "summary" in about else None
    if not (0 < world.width < inf and 0 < world.depth < inf and np.isfinite(world.solids_at(0.0)).all()):
        raise ValueError("the world must be finite")


@dataclass(frozen=True)
class _Vehicle:
    """What a recording says of the vehicle."""

    footprint: OrientedBox
    sensor: Vector
    sensor_range: SensorRange = paper.SENSOR_RANGE
    blind_arc_degrees: BlindArc | None = None


@dataclass(frozen=True)
class _Plan:
    """A plan along which the vehicle was led."""

    time: float
    corners: tuple[Point, ...]


@dataclass(frozen=True)
class _About:
    """What a recording says once."""

    world: WorldSpec
    vehicle: _Vehicle
    ending: str | None
    summary: EpisodeSummary | None = None
    reward_terms: tuple[str, ...] = REWARD_TERMS
    aims: tuple[Point, ...] | None = None
    plans: tuple[_Plan, ...] = ()
    tilts: tuple[Vector, ...] | None = None


_ABOUT = TypeAdapter(_About)
_RAYS: TypeAdapter[int] = TypeAdapter(RayCount)


_SAMPLED = ("sample_time", "sample_pose", "joint_angles", "wheel_speeds")
_COLUMNS = tuple(field.name for field in fields(Recording) if field.name not in ("about", *_SAMPLED))


class Recorder:
    """Watches an episode and turns it into a `Recording`."""

    def __init__(self, vehicle: VehicleSpec) -> None:
        self.trace: list[Sample] = []
        self._vehicle = vehicle

    @property
    def times(self) -> list[float]:
        """Times of the states since the start of the episode [s]."""
        return [float(time) for time in self._columns["state_time"]]

    def on_reset(self, world: WorldSpec, observation: Observation, vehicle: int) -> None:
        """Starts the recording."""
        self._world, self._ending, self._term_names = world, NO_ENDING, REWARD_TERMS
        self._columns: dict[str, list[Any]] = {name: [] for name in _COLUMNS}
        self._aims: list[list[float]] = []
        self.trace.clear()
        self._note(state_time=0.0, state_pose=(world.start.x, world.start.y, world.start.yaw))
        self._note_state(observation, vehicle)

    def on_step(self, transition: Transition, decision: Decision, vehicle: int) -> None:
        """Records a step."""
        t, m, v = transition, transition.motion, vehicle
        self._ending, self._term_names = int(t.ending[v]), t.term_names
        self._note(
            action=t.a_tm1[v],
            overridden=decision.overridden[v],
            q_values=np.full(len(paper.TURNS), np.nan) if decision.action_values is None else decision.action_values[v],
            heading_command=t.heading_command[v],
            heading_error=m.heading_error[v],
            clearance=m.clearance[v],
            contact=m.touching[v],
            reward_terms=t.terms[v],
            state_time=self._columns["state_time"][-1] + m.duration[v],
            state_pose=m.pose[v],
        )
        self._note_state(t.s_t, v)

    def recording(self, **about: Any) -> Recording:
        """The episode so far; `about` is kept with it."""
        vehicle, columns, samples = self._vehicle, self._columns, self.trace
        if self._term_names != REWARD_TERMS:
            about["reward_terms"] = self._term_names
        if not np.allclose(self._aims, self._world.target):
            about["aims"] = self._aims
        tilts = np.array([sample.tilt for sample in samples]).reshape(-1, 3)
        if (np.abs(tilts[:, 1:]) > TIPPING).any():
            about["tilts"] = tilts.tolist()
        return Recording(
            about={
                **about,
                "world": {**asdict(self._world), "digest": self._world.digest},
                "vehicle": {
                    "name": vehicle.name,
                    "footprint": asdict(vehicle.footprint),
                    "sensor": vehicle.sensor.position,
                    "sensor_range": vehicle.sensor.range,
                    "blind_arc_degrees": vehicle.sensor.blind_arc_degrees,
                    "urdf": urdf_text(vehicle),
                    "joints": vehicle.joints,
                    "wheel_radius": vehicle.wheel_radius,
                },
                "ending": None if self._ending == NO_ENDING else ENDINGS[self._ending],
            },
            **{name: np.array(values) for name, values in columns.items()},
            sample_time=np.array([sample.time for sample in samples]),
            sample_pose=np.array([(sample.pose.x, sample.pose.y, sample.pose.yaw) for sample in samples]),
            joint_angles=np.array([sample.joint_angles for sample in samples]),
            wheel_speeds=np.array([sample.wheel_speeds for sample in samples]),
        )

    def _note_state(self, observation: Observation, vehicle: int) -> None:
        o, v = observation, vehicle
        x, y, yaw = self._columns["state_pose"][-1]
        direction = yaw + o.target_bearing[v]
        aim = x + o.target_distance[v] * np.cos(direction), y + o.target_distance[v] * np.sin(direction)
        self._aims.append([round(float(its), 6) for its in aim])
        label = StateProperty(int(o.state_property[v])).label
        self._note(readings=o.readings[v], ray_distances=o.ray_distances[v], state_property=label)

    def _note(self, **values: Any) -> None:
        """Adds a value to columns of the recording."""
        for name, value in values.items():
            self._columns[name].append(value)
