"""Writes a recording as an .rrd file for the Rerun viewer: `rerun FILE` (needs the extra `viz`).

World, vehicle, rays and sectors are shapes in 3D; readings, action values, clearance and other numbers are curves.
There are two time lines: `time` since the reset, and `decision`, the number of decisions before a state. Values of a
step (clearance, heading error, reward) are at its end. Samples between decisions are on `time` only.

The vehicle has the shapes of its URDF, with wheels that turn. In older recordings, which lack the URDF, it is a box
over its footprint, and heights are relative to the rear axle.

The library writes to the file only and sends nothing; only its viewer sends usage statistics.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from nnql_bullet import paper
from nnql_bullet.colours import BOX, COLLISION, INK, LINES, MOVING, NON_SAFE, PLAN, SAFE, TIMEOUT, VEHICLE
from nnql_bullet.env import ACTIONS
from nnql_bullet.files import write_atomically
from nnql_bullet.geometry import Array, Circle, OrientedBox
from nnql_bullet.recording import Recording
from nnql_bullet.render.labels import MANOEUVRES, PROPERTIES, TURNS
from nnql_bullet.reports.events import events_of
from nnql_bullet.vehicle.visuals import Shape, Visuals

TIME, DECISION = "time", "decision"
"""Time lines: time [s], and number of decisions so far."""
BODY_HEIGHT = 0.25
"""Height of the box that replaces a vehicle without shapes [m]."""
ARC_POINTS = 10
"""Points along the edge of a sector."""

SECTORS = ("front", "front left", "left", "rear left", "rear", "rear right", "right", "front right")
DECIDERS = {"agent": SAFE, "shield": NON_SAFE}
"""Deciders and their colours."""


def write_rrd(recording: Recording, path: Path) -> None:
    """Writes an .rrd file atomically, with a layout for the viewer.

    Raises:
        OSError: If the file cannot be written.
    """
    write_atomically(path, lambda temporary: _write(recording, temporary))


def _write(recording: Recording, path: Path) -> None:
    # The default identity and start time would make two files of one recording differ.
    with rr.RecordingStream("nnql-bullet", recording_id=_identity(recording), send_properties=False) as stream:
        stream.save(path, default_blueprint=_layout(recording))
        stream.send_recording_name(_name(recording))
        _log_world(stream, recording)
        _log_vehicle(stream, recording)
        _log_sensors(stream, recording)
        _log_states(stream, recording)
        _log_curves(stream, recording)
        _log_events(stream, recording)


def _identity(recording: Recording) -> str:
    """Hashes the content; the viewer merges files of one identity."""
    found = hashlib.sha256(json.dumps(recording.about, sort_keys=True).encode())
    for field in fields(recording):
        if field.name != "about":
            found.update(np.ascontiguousarray(getattr(recording, field.name)).tobytes())
    return found.hexdigest()[:32]


def _name(recording: Recording) -> str:
    world = recording.about["world"]
    return f"{recording.about.get('policy', 'policy')} in '{world['name']}', seed {world['seed']}"


def _log_world(stream: rr.RecordingStream, recording: Recording) -> None:
    """Logs static bodies, then moving boxes at the samples."""
    world = recording.world
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    boxes = [its for its in world.obstacles if isinstance(its, OrientedBox)]
    stream.log("world/boxes", _boxes(boxes, world.obstacle_height, BOX), static=True)
    circles = [its for its in world.obstacles if isinstance(its, Circle)]
    poles = rr.Cylinders3D(
        lengths=[world.obstacle_height] * len(circles),
        radii=[its.radius for its in circles],
        centers=[(its.x, its.y, world.obstacle_height / 2) for its in circles],
        colors=_rgba(BOX),
        fill_mode="solid",
    )
    if circles:
        stream.log("world/circles", poles, static=True)
    stream.log("world/walls", _boxes(world.walls, world.obstacle_height, TIMEOUT), static=True)
    disc = rr.Cylinders3D(
        lengths=[0.02],
        radii=[world.target_radius],
        centers=[(*world.target, 0.0)],
        colors=_rgba(COLLISION, alpha=0.4),
        fill_mode="solid",
    )
    stream.log("world/target", disc, static=True)
    _log_goals(stream, recording)
    stream.log(
        "world/start", rr.Points3D([(world.start.x, world.start.y, 0.0)], colors=_rgba(INK), radii=0.1), static=True
    )
    times = np.append(0.0, recording.sample_time)
    for number, patrol in enumerate(world.patrols):
        places = np.array([(box.x, box.y, box.yaw) for box in map(patrol.at, times.tolist())])
        shape = OrientedBox(0.0, 0.0, patrol.box.half_length, patrol.box.half_width)
        entity = f"world/patrols/{number}"
        stream.log(entity, _boxes([shape], world.obstacle_height, MOVING), static=True)
        stream.send_columns(entity, [_times(times)], _transforms(places))


def _log_goals(stream: rr.RecordingStream, recording: Recording) -> None:
    """Logs way points with their numbers, plans as they were made, and what the vehicle drove at in each state."""
    world = recording.world
    if world.waypoints:
        numbers = [str(number) for number in range(1, len(world.waypoints) + 1)]
        circles = [_circle(place, world.target_radius) for place in world.waypoints]
        stream.log("world/waypoints", rr.LineStrips3D(circles, colors=_rgba(COLLISION), labels=numbers), static=True)
    for time, corners in recording.plans:
        stream.set_time(TIME, duration=time)
        stream.log("world/plan", rr.LineStrips3D([_on_ground(corners)], colors=_rgba(PLAN), radii=0.03))
    if recording.plans or world.waypoints:
        columns = rr.Points3D.columns(positions=_on_ground(recording.aims))
        stream.log("world/aim", rr.Points3D.from_fields(colors=_rgba(PLAN), radii=0.1), static=True)
        stream.send_columns("world/aim", _at_states(recording), columns)


def _circle(middle: tuple[float, float], radius: float) -> Array:
    """Points around a circle on the ground (n, 3) [m]."""
    angles = np.linspace(0.0, 2 * np.pi, 49)
    return _on_ground(np.array(middle) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1))


def _log_vehicle(stream: rr.RecordingStream, recording: Recording) -> None:
    """Logs the vehicle's poses at samples and states, its shapes, and its whole path."""
    axle, tilts = _axle_height(recording), recording.tilts
    times = np.append(0.0, recording.sample_time)
    at_states = [np.interp(recording.state_time, times, np.append(0.0, column)) for column in tilts.T]
    for index, poses, its in (
        (_at_states(recording), recording.state_pose, np.stack(at_states, axis=-1)),
        ([_times(recording.sample_time)], recording.sample_pose, tilts),
    ):
        stream.send_columns("world/vehicle", index, _transforms(poses, axle, its))
    stream.log(
        "world/vehicle/sensor", rr.Points3D([recording.sensor.position], colors=_rgba(SAFE), radii=0.06), static=True
    )
    if "urdf" in recording.about["vehicle"]:
        _log_looks(stream, recording)
    else:
        stream.log("world/vehicle/body", _boxes([recording.footprint], BODY_HEIGHT, VEHICLE), static=True)
    points = _on_ground(np.concatenate([recording.state_pose[:1, :2], recording.sample_pose[:, :2]]))
    decision = np.searchsorted(recording.state_time, recording.sample_time - 1e-9, side="left") - 1
    non_safe = recording.state_property[np.clip(decision, 0, None)] == "NS"
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    path = rr.LineStrips3D(pieces, colors=np.where(non_safe, _rgba(NON_SAFE), _rgba(SAFE)), radii=0.06)
    stream.log("world/path", path, static=True)


def _log_looks(stream: rr.RecordingStream, recording: Recording) -> None:
    """Logs the shapes of each link and its frames at the samples; the first frames also hold before them."""
    visuals = Visuals(recording.about["vehicle"])
    all_angles = np.concatenate([recording.joint_angles[:1], recording.joint_angles])
    frames = [visuals.link_frames(angles) for angles in all_angles]
    times = [_times(np.append(0.0, recording.sample_time))]
    for link in dict.fromkeys(shape.link for shape in visuals.shapes):
        entity = f"world/vehicle/{link}"
        shapes = [shape for shape in visuals.shapes if shape.link == link]
        for number, shape in enumerate(shapes):
            stream.log(f"{entity}/{number}", _solid(shape), static=True)
            turn = rr.Quaternion(xyzw=Rotation.from_matrix(shape.origin[:3, :3]).as_quat())
            stream.log(
                f"{entity}/{number}", rr.Transform3D(translation=shape.origin[:3, 3], quaternion=turn), static=True
            )
        placed = np.array([frame[link] for frame in frames])
        turns = Rotation.from_matrix(placed[:, :3, :3]).as_quat()
        columns = rr.Transform3D.columns(translation=placed[:, :3, 3], quaternion=turns)
        stream.send_columns(entity, times, columns)


def _solid(shape: Shape) -> rr.Boxes3D | rr.Cylinders3D | rr.Ellipsoids3D | rr.Mesh3D:
    x, y, z = shape.half_sizes
    colour = [round(255 * part) for part in shape.colour]
    if shape.kind == "box":
        return rr.Boxes3D(half_sizes=[(x, y, z)], colors=colour, fill_mode="solid")
    if shape.kind == "cylinder":
        return rr.Cylinders3D(radii=[x], lengths=[2 * z], colors=colour, fill_mode="solid")
    if shape.kind == "mesh":
        edges = np.diff(shape.triangles, axis=1)
        normals = np.cross(edges[:, 0], edges[:, 1])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        return rr.Mesh3D(
            vertex_positions=shape.triangles.reshape(-1, 3),
            vertex_normals=np.repeat(normals, 3, axis=0),
            albedo_factor=colour,
        )
    return rr.Ellipsoids3D(half_sizes=[(x, y, z)], colors=colour, fill_mode="solid")


def _axle_height(recording: Recording) -> float:
    """Returns the height of the vehicle's frame over the ground [m]; 0 if it is unknown."""
    return float(recording.about["vehicle"].get("wheel_radius", 0.0))


def _log_sensors(stream: rr.RecordingStream, recording: Recording) -> None:
    """Logs rays and sectors at the states in the world; those that met something are orange."""
    sensor = recording.sensor
    x, y, above = sensor.position
    height = above + _axle_height(recording)
    yaw = recording.state_pose[:, 2]
    c, s = np.cos(yaw), np.sin(yaw)
    origins = recording.state_pose[:, :2] + np.column_stack([c * x - s * y, s * x + c * y])
    ends = _from(origins, yaw[:, None] + sensor.angles, recording.ray_distances, height)
    rays = np.stack([_from(origins, np.zeros_like(ends[..., 0]), np.zeros_like(ends[..., 0]), height), ends], axis=2)
    _log_strips(stream, recording, "world/rays", rays, sensor.met(recording.ray_distances), 0.008)
    centres = np.arange(paper.SECTORS) * paper.SECTOR_ANGLE
    across = np.linspace(-0.5, 0.5, ARC_POINTS) * paper.SECTOR_ANGLE
    angles = (yaw[:, None, None] + centres[:, None] + across).reshape(len(yaw), -1)
    arcs = _from(origins, angles, np.repeat(recording.readings, ARC_POINTS, axis=1), height)
    edges = arcs.reshape(len(yaw), paper.SECTORS, ARC_POINTS, 3)
    _log_strips(stream, recording, "world/sectors", edges, sensor.met(recording.readings), 0.04)


def _from(origins: Array, angles: Array, distances: Array, height: float) -> Array:
    """Computes points (n, m, 3) at distances (n, m) [m] in directions (n, m) [rad] from origins (n, 2) [m]."""
    x = origins[:, :1] + distances * np.cos(angles)
    y = origins[:, 1:] + distances * np.sin(angles)
    return np.stack([x, y, np.full_like(x, height)], axis=2)


def _log_strips(
    stream: rr.RecordingStream, recording: Recording, entity: str, strips: Array, met: NDArray[np.bool_], radius: float
) -> None:
    """Sends lines (n + 1, m, k, 3) [m] at the states, coloured by whether each met something (n + 1, m)."""
    states, lines = met.shape
    colours = np.where(met, _rgba(NON_SAFE), _rgba(BOX, alpha=0.5)).ravel()
    columns = rr.LineStrips3D.columns(strips=strips.reshape(states * lines, -1, 3), colors=colours)
    stream.log(entity, rr.LineStrips3D.from_fields(radii=radius), static=True)
    stream.send_columns(entity, _at_states(recording), columns.partition([lines] * states))


def _log_states(stream: rr.RecordingStream, recording: Recording) -> None:
    """Logs the property of each state, and the manoeuvre chosen in it with its decider."""
    values, (labels, colours) = list(PROPERTIES), zip(*PROPERTIES.values(), strict=True)
    stream.log("property", rr.StateConfiguration(values=values, labels=labels, colors=_rgba(*colours)), static=True)
    stream.send_columns(
        "property", _at_states(recording), rr.StateChange.columns(state=recording.state_property.tolist())
    )
    action_colours = [*LINES[:ACTIONS], *[TIMEOUT] * ACTIONS, *[MOVING] * ACTIONS, *LINES[:ACTIONS]]
    _log_line(stream, recording, "action", MANOEUVRES, action_colours, recording.action)
    _log_line(stream, recording, "decided_by", tuple(DECIDERS), tuple(DECIDERS.values()), recording.overridden)


def _log_line(
    stream: rr.RecordingStream,
    recording: Recording,
    entity: str,
    values: Sequence[str],
    colours: Sequence[str],
    steps: NDArray[np.integer[Any] | np.bool_],
) -> None:
    """Logs the value of each step (n,) by its number."""
    stream.log(entity, rr.StateConfiguration(values=values, colors=_rgba(*colours)), static=True)
    states = [values[step] for step in steps.tolist()]
    stream.send_columns(entity, _at_states(recording), rr.StateChange.columns(state=[*states, ""]))


def _log_curves(stream: rr.RecordingStream, recording: Recording) -> None:
    """Logs all numbers as curves."""
    at_states = _at_states(recording)
    begins, ends = _at_states(recording, slice(None, -1)), _at_states(recording, slice(1, None))
    at_samples = [_times(recording.sample_time)]
    _log_curve(stream, "readings", at_states, recording.readings, SECTORS)
    # Points instead of lines, because values may be missing before and after one.
    dots = rr.SeriesPoints(names=TURNS, colors=_rgba(*LINES[: len(TURNS)]), marker_sizes=[3.0] * len(TURNS))
    stream.log("q_values", dots, static=True)
    _send_numbers(stream, "q_values", begins, recording.q_values)
    _log_curve(stream, "heading_command", begins, recording.heading_command[:, None], ["heading change asked for"])
    _log_curve(stream, "heading_error", ends, recording.heading_error[:, None], ["heading error"])
    _log_curve(stream, "clearance", ends, recording.clearance[:, None], ["clearance"])
    terms = [name.replace("_", " ") for name in recording.term_names]
    _log_curve(stream, "reward", ends, recording.reward_terms, terms)
    _log_curve(stream, "wheel_speeds", at_samples, recording.wheel_speeds, ["left wheel", "right wheel"])


def _log_curve(
    stream: rr.RecordingStream, entity: str, index: list[rr.TimeColumn], values: Array, names: Sequence[str]
) -> None:
    """Logs values (k, m) at k times, as a line for each of m names."""
    stream.log(entity, rr.SeriesLines(names=names, colors=_rgba(*LINES[: len(names)])), static=True)
    _send_numbers(stream, entity, index, values)


def _send_numbers(stream: rr.RecordingStream, entity: str, index: list[rr.TimeColumn], values: Array) -> None:
    """Sends values (k, m) at k times."""
    count, width = values.shape
    stream.send_columns(entity, index, rr.Scalars.columns(scalars=values.ravel()).partition([width] * count))


def _log_events(stream: rr.RecordingStream, recording: Recording) -> None:
    """Logs texts about changes of the property, the shield's decisions, contacts and the ending."""
    states, texts, levels = zip(*events_of(recording), strict=True)
    index = _at_states(recording, list(states))
    stream.send_columns("events", index, rr.TextLog.columns(text=texts, level=levels))
    touching = (np.flatnonzero(recording.contact) + 1).tolist()
    if touching:
        places = _on_ground(recording.state_pose[touching, :2])
        stream.log("world/contacts", rr.Points3D.from_fields(colors=_rgba(COLLISION), radii=0.3), static=True)
        stream.send_columns("world/contacts", _at_states(recording, touching), rr.Points3D.columns(positions=places))


def _layout(recording: Recording) -> rrb.Blueprint:
    """Returns the layout: the world from above and from behind the vehicle, beside states, action values and curves."""
    world = recording.world
    x, y, far = world.width / 2, world.depth / 2, max(world.width, world.depth)
    whole = rrb.EyeControls3D(position=(x, y - 0.4 * far, 1.15 * far), look_target=(x, y, 0.0))
    behind = rrb.EyeControls3D(position=(-5.6, 0.0, 3.3), look_target=(2.6, 0.0, 0.0))
    scenes = rrb.Vertical(
        rrb.Spatial3DView(origin="world", name="world", eye_controls=whole, line_grid=False),
        rrb.Spatial3DView(
            origin="world/vehicle", contents="/world/**", name="vehicle", eye_controls=behind, line_grid=False
        ),
    )
    curves = rrb.Vertical(
        rrb.StateTimelineView(name="property and action", contents=["property", "action", "decided_by"]),
        rrb.TimeSeriesView(origin="q_values", name="action values"),
        rrb.TimeSeriesView(origin="readings", name="readings [m]"),
        rrb.Tabs(
            rrb.TimeSeriesView(origin="clearance", name="clearance [m]"),
            rrb.TimeSeriesView(name="heading [rad]", contents=["heading_command", "heading_error"]),
            rrb.TimeSeriesView(origin="wheel_speeds", name="wheel speeds [rad/s]"),
            rrb.TimeSeriesView(origin="reward", name="reward"),
        ),
        rrb.TextLogView(origin="events", name="events"),
        row_shares=[4, 6, 5, 4, 4],
    )
    return rrb.Blueprint(
        rrb.Horizontal(scenes, curves, column_shares=[3, 2]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIME),
    )


def _at_states(recording: Recording, which: slice | list[int] = slice(None)) -> list[rr.TimeColumn]:
    """Returns the positions of some states on both time lines."""
    number = np.arange(len(recording.state_time))[which]
    return [_times(recording.state_time[which]), rr.TimeColumn(DECISION, sequence=number)]


def _times(seconds: Array) -> rr.TimeColumn:
    """Converts times [s] to the viewer's unit, nanoseconds."""
    return rr.TimeColumn(TIME, duration=np.round(1e9 * seconds).astype("timedelta64[ns]"))


def _transforms(poses: Array, height: float = 0.0, tilts: Array | None = None) -> rr.ComponentColumnList:
    """Returns transforms to the world from the frames of poses (n, 3) at a height [m], tilted (n, 3)."""
    rise, roll, pitch = np.zeros((3, len(poses))) if tilts is None else tilts.T
    turns = Rotation.from_euler("ZYX", np.column_stack([poses[:, 2], pitch, roll])).as_quat()
    places = np.column_stack([poses[:, :2], height + rise])
    return rr.Transform3D.columns(translation=places, quaternion=turns)


def _on_ground(points: Array) -> Array:
    """Returns points (n, 2) as (n, 3) with z = 0."""
    return np.column_stack([points, np.zeros(len(points))])


def _boxes(boxes: Sequence[OrientedBox], height: float, colour: str) -> rr.Boxes3D:
    """Makes boxes that stand on the ground."""
    return rr.Boxes3D(
        centers=[(box.x, box.y, height / 2) for box in boxes],
        half_sizes=[(box.half_length, box.half_width, height / 2) for box in boxes],
        rotations=[rr.RotationAxisAngle(axis=(0.0, 0.0, 1.0), radians=box.yaw) for box in boxes],
        colors=_rgba(colour),
        fill_mode="solid",
    )


def _rgba(*colours: str, alpha: float = 1.0) -> NDArray[np.uint32]:
    """Converts colours '#rrggbb' to numbers 0xRRGGBBAA."""
    return np.array([int(colour[1:], 16) << 8 | round(255 * alpha) for colour in colours], dtype=np.uint32)
