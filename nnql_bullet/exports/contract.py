"""The observation contract of an exported policy: what goes in and out, in which order, units, ranges and rates."""

import json
from dataclasses import dataclass, replace
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents import foresight
from nnql_bullet.agents.base import Custom, TurnChooser
from nnql_bullet.agents.learning.frames import frame_width
from nnql_bullet.agents.learning.genetic import GeneticOptions
from nnql_bullet.agents.learning.options import DistilledOptions, DoubleDqnOptions, NnqlOptions
from nnql_bullet.agents.rules.hand_rule import HandRuleOptions
from nnql_bullet.agents.rules.look_ahead import LookAheadOptions
from nnql_bullet.agents.rules.potential_field import PotentialFieldOptions
from nnql_bullet.agents.rules.vfh import BINS, VfhOptions
from nnql_bullet.env import ACTIONS, FARTHEST, MANOEUVRES, MOST_YAW_RATE, REVERSE, SLOW, STOP, Observation, as_numbers
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.mapping import grid_map
from nnql_bullet.mapping.foresight import BEARINGS, COLUMNS
from nnql_bullet.runs import LoadedPolicy
from nnql_bullet.shield.lengths import ShieldOptions, lengths_of
from nnql_bullet.shield.setting import FASTEST, Memory, Setting, memory_of, setting_of
from nnql_bullet.vehicle.scale import length_scale

STOPPED = STOP
"""The action on bad input: straight on, while the vehicle brakes to a stand."""
STATUSES = ("OK", "BAD_DISTANCE", "BAD_TARGET_DISTANCE", "BAD_TARGET_BEARING", "BAD_YAW_RATE")
"""What a decision says of its input, by number; on all but the first it stops."""
WIDEST_BEARING = 3.1415928
"""Largest bearing that is taken: pi rounds up in single precision [rad]."""
BY_RAYS = (PotentialFieldOptions, VfhOptions, LookAheadOptions, DoubleDqnOptions, DistilledOptions)
"""Agents that see the rays; the others see the readings of the eight sectors."""


@dataclass(frozen=True, slots=True)
class Signal:
    """A number, or a row of numbers, that goes in or out."""

    name: str
    about: str
    unit: str = ""
    count: int = 1
    """Numbers in it."""
    low: float | None = None
    high: float | None = None
    whole: bool = False
    """Whether it is a whole number."""
    silent: str = ""
    """What to do when what measures it is silent."""
    stored: str = ""
    """Its type in C where it is remembered, if it is neither a `float` nor, for a whole number, an `unsigned char`."""

    def schema(self, rate: float) -> dict[str, Any]:
        """JSON schema of a value at so many decisions per second."""
        bounds = {"minimum": self.low, "maximum": self.high}
        one = {"type": "integer" if self.whole else "number"} | {k: v for k, v in bounds.items() if v is not None}
        row = {"type": "array", "items": one, "minItems": self.count, "maxItems": self.count}
        told = {"description": self.about, "unit": self.unit, "rate_hz": rate, "when_silent": self.silent}
        return (one if self.count == 1 else row) | {name: value for name, value in told.items() if value}


@dataclass(frozen=True, slots=True)
class Contract:
    """What an exported policy takes and gives at each decision, in this order."""

    policy: str
    kind: str
    vehicle: str
    decision_period: float
    """Time from one decision to the next [s]."""
    sensor_range: float
    """What a ray reads that meets nothing [m]."""
    by_rays: bool
    """Whether the distances are those of the rays; else they are the readings of the sectors."""
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    memory: tuple[Signal, ...] = ()
    """What it remembers from one decision to the next; all zero when a drive begins."""
    shielded: bool = False
    """Whether it decides in its shield."""

    @property
    def distances(self) -> int:
        """Number of the distances that it sees."""
        return self.inputs[0].count

    @property
    def statuses(self) -> tuple[str, ...]:
        """What a decision says of its input, by number."""
        speed, beside = ("BAD_SPEED",) if self.takes_speed else (), ("BAD_MAP",) if self.map_beside else ()
        return *STATUSES, *speed, *beside

    @property
    def takes_speed(self) -> bool:
        """Whether the measured speed goes in, right after the yaw rate."""
        return any(signal.name == "speed" for signal in self.inputs)

    @property
    def map_beside(self) -> bool:
        """Whether a map beside the policy tells it of ways."""
        return any(signal.name == "way" for signal in self.inputs)

    @property
    def remembers_alone(self) -> bool:
        """Whether its memory is too much to be told: it decides in the order of a drive."""
        return any(signal.stored for signal in self.memory)

    @property
    def has_values(self) -> bool:
        """Whether it tells what it expects of each action."""
        return self.outputs[-1].name == "values"

    def json_schema(self) -> str:
        """JSON schema of one decision: an object with `input` and `output`."""
        rate = round(1 / self.decision_period, 6)
        values: dict[str, Any] = {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "title": f"One decision of the policy '{self.policy}' ({self.kind}) for the vehicle '{self.vehicle}'",
            **_object({"input": _signals(self.inputs, rate), "output": _signals(self.outputs, rate)}),
            "x-memory": {signal.name: signal.schema(rate) for signal in self.memory},
            "x-decision-period-s": self.decision_period,
        }
        return json.dumps(values, indent=1) + "\n"

    def markdown(self) -> str:
        """The same as tables."""
        head = (
            "| | name | numbers | unit | range | meaning | when its sensor is silent |\n|---|---|---|---|---|---|---|"
        )
        parts = [
            f"# Observation contract of '{self.policy}' ({self.kind})",
            f"For the vehicle '{self.vehicle}'. One decision every {self.decision_period:g} s, from inputs that were "
            "measured since the last one.",
        ]
        for title, signals in (("Inputs", self.inputs), ("Outputs", self.outputs), ("Memory", self.memory)):
            rows = [_row(place, signal) for place, signal in enumerate(signals)]
            parts += [f"## {title}, in this order", "\n".join([head, *rows])] if rows else []
        if self.shielded:
            parts += ["## The shield", _SHIELD]
        statuses = ", ".join(f"{number} {name}" for number, name in enumerate(self.statuses))
        parts += [
            "## Bad input",
            f"Status of a decision: {statuses}. What is not a finite number or out of its range gives such a status, "
            f"and the action {STOPPED}: brake to a stand, straight on. The memory is then as it was.",
            "A silent sensor has no value that stands for it. Do not repeat the last one: stop, and decide again when "
            "all sensors speak.",
        ]
        return "\n\n".join(parts) + "\n"

    def rows(self, observations: Observation) -> NDArray[np.float32]:
        """The inputs of n vehicles but for what a map tells, in single precision (n, numbers)."""
        o = observations
        distances = o.ray_distances if self.by_rays else o.readings
        speed = [o.speed.astype(np.float32)[:, None]] if self.takes_speed else []
        return np.concatenate([distances.astype(np.float32), as_numbers(o)[:, -3:], *speed], axis=-1)


def _row(place: int, signal: Signal) -> str:
    ends = "" if signal.low is None else f"{signal.low:g} to {'any' if signal.high is None else f'{signal.high:g}'}"
    return f"| {place} | `{signal.name}` | {signal.count} | {signal.unit} | {ends} | {signal.about} | {signal.silent} |"


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(properties), "additionalProperties": False}


def _signals(signals: tuple[Signal, ...], rate: float) -> dict[str, Any]:
    return _object({signal.name: signal.schema(rate) for signal in signals})


def contract_of(policy: LoadedPolicy, graph: bool = False) -> Contract:
    """The contract of a policy.

    Args:
        policy: The policy.
        graph: Whether it is to be a graph of fixed steps, which has the map of a `double_dqn` beside it.

    Raises:
        UserError: If it cannot be exported in any form.
    """
    experiment = policy.experiment
    config, vehicle, agent = experiment.config, experiment.vehicle, experiment.agent
    options, sensor, shielded = config.agent, vehicle.sensor, config.shield is not None
    if isinstance(agent, Custom):
        raise UserError(f"{policy.name}: an object of your own cannot be exported; export a trained policy or a rule")
    if config.shield is not None and config.shield.recovers:
        raise UserError(
            f"{policy.name}: drives in a shield that leads it through a map, which is not exported; export it with "
            "--with-shield, which leaves that out, or load it without a shield"
        )
    if experiment.task.hysteresis:
        raise UserError(f"{policy.name}: 'task.hysteresis' is not exported; train a policy without it")
    if isinstance(options, DistilledOptions) and options.search.paced:
        raise UserError(f"{policy.name}: 'agent.search.paced' is not exported; load it without")
    by_rays = shielded or isinstance(options, BY_RAYS)
    how = "nearest" if config.task.sector_reading == "nearest" else "middle"
    seen = (
        f"distances of the {sensor.rays} rays, evenly spaced counter-clockwise; ray 0 points to "
        f"{np.degrees(sensor.angles[0]):g} degrees, 0 is ahead"
        if by_rays
        else f"readings of the eight sectors of 45 degrees, the {how} ray of each, counter-clockwise from the one ahead"
    )
    nothing = f"; what meets nothing reads {sensor.range:g}, and more counts as that"
    stop = "stop"
    any_manoeuvre = shielded or isinstance(options, DistilledOptions)
    rule = isinstance(agent, TurnChooser) or isinstance(options, HandRuleOptions)
    thresholds = ", ".join(f"{one:g}" for one in experiment.task.thresholds)
    outputs = [
        Signal("action", _actions(any_manoeuvre), low=0, high=MANOEUVRES - 1 if any_manoeuvre else STOPPED, whole=True),
        Signal("heading_change", "change of heading that is asked for, left is positive", "rad", low=-pi, high=pi),
        Signal("speed_share", "share of the drive's speed: 1, or 0 for a stop", low=0, high=1),
    ]
    if any_manoeuvre:
        outputs[-1] = Signal(
            "speed_share", "share of the drive's speed, negative backwards, 0 for a stop", low=-1, high=1
        )
    if shielded:
        outputs.append(Signal("overridden", "1 if the shield replaced the policy's action", low=0, high=1, whole=True))
    elif rule:
        about = f"1 if no sector reads less than its threshold ({thresholds} m), else 0"
        outputs.append(Signal("safe", about, low=0, high=1, whole=True))
    if isinstance(agent, TurnChooser) and not shielded:
        about = "Q-values of the five turns; the action is the largest if `safe` is 0; 0 on bad input"
        outputs.append(Signal("values", about, count=len(paper.TURNS)))
    memory: tuple[Signal, ...] = ()
    if isinstance(options, VfhOptions):
        memory = (
            Signal("heading", "heading since the drive began, by dead reckoning", "rad"),
            Signal("chosen", "direction chosen last, in the frame that the drive began in", "rad"),
            Signal("blocked", "whether each direction is blocked", count=BINS, low=0, high=1, whole=True),
        )
    mapped: tuple[Signal, ...] = ()
    most_yaw_rate, fastest = MOST_YAW_RATE, FASTEST * config.drive.speed
    about = "measured speed along the vehicle, negative backwards"
    speed = Signal("speed", about, "m/s", low=-fastest, high=fastest, silent=stop)
    if shielded:
        setting, empty = shield_of(experiment)
        most_yaw_rate, memory, mapped = setting.most_yaw_rate, _memory_signals(empty), (speed,)
        if isinstance(options, DoubleDqnOptions):
            memory += tuple(replace(its, name=f"policy_{its.name}") for its in _frame_memory(options))
    elif isinstance(options, DistilledOptions):
        about = "values of the manoeuvres but for a constant; the action is the largest of those that meet nothing"
        outputs.append(Signal("values", about, "m", MANOEUVRES))
        mapped = (speed, *_foreseen(stop))
        seen_before = foresight.SECTORS * (foresight.SCANS - 1)
        memory = (Signal("frames", "scans seen last, as bytes", count=seen_before, low=0, high=255, whole=True),)
    elif isinstance(options, DoubleDqnOptions) and not graph:
        outputs.append(Signal("values", "Q-values of the six actions; the action is the largest", count=ACTIONS))
        mapped, memory = (speed,), _frame_memory(options)
    elif isinstance(options, DoubleDqnOptions):
        outputs.append(Signal("values", "Q-values of the six actions; the action is the largest", count=ACTIONS))
        scale = f"in metres of the shipped vehicle, which are {length_scale(vehicle.footprint):g} of this one's"
        places = len(grid_map.REACHES) * grid_map.BEARINGS if options.grid_map else 0
        away = "; of `agents.learning.frames.FrameMaker.sense`"
        mapped = (
            *((Signal("around", f"ways to places around, {scale}{away}", "m", places, silent=stop),) if places else ()),
            Signal("way", f"length of the way to the target through the map, {scale}{away}", "m", low=0, silent=stop),
            Signal("last_action", "the last action, -1 in the first decision", low=-1, high=ACTIONS - 1),
        )
        bytes_seen = options.frames * frame_width(options.rays, options.grid_map)
        memory = (Signal("frames", "what was seen last, as bytes", count=bytes_seen, low=0, high=255, whole=True),)
    return Contract(
        policy=policy.name,
        kind=options.kind,
        vehicle=vehicle.name,
        decision_period=config.drive.decision_period,
        sensor_range=sensor.range,
        by_rays=by_rays,
        inputs=(
            Signal(
                "distances",
                seen + nothing,
                "m",
                sensor.rays if by_rays else paper.SECTORS,
                0,
                silent=f"{stop}; of a single dead sector, stop too",
            ),
            Signal("target_distance", "distance of what is to be reached next", "m", low=0, high=FARTHEST, silent=stop),
            Signal(
                "target_bearing",
                "its bearing, 0 ahead, left is positive",
                "rad",
                low=-WIDEST_BEARING,
                high=WIDEST_BEARING,
                silent=stop,
            ),
            Signal("yaw_rate", "left is positive", "rad/s", low=-most_yaw_rate, high=most_yaw_rate, silent=stop),
            *mapped,
        ),
        outputs=tuple(outputs),
        memory=memory,
        shielded=shielded,
    )


_SHIELD = (
    "The policy drives in its shield, which takes its action only where the vehicle can stop after it. That shield "
    "does all that the program's own does with `shield.recovers` off: it leads no vehicle that gets no nearer to its "
    "target through a map of what it has seen, because that search ends when it ends. The target has to stay from the "
    "first decision to the last, because the vehicle localizes itself by it: a point that moves on along a plan is not "
    "such a target. A vehicle has a memory of its own."
)


def shield_of(experiment: Experiment) -> tuple[Setting, Memory]:
    """What the decisions of an experiment's shield depend on, and an empty memory of it."""
    vehicle, drive = experiment.vehicle, experiment.config.drive
    lengths = lengths_of(experiment.config.shield or ShieldOptions(), vehicle, drive)
    setting = setting_of(lengths, vehicle, drive, experiment.task)
    return setting, memory_of(setting)


def _foreseen(silent: str) -> tuple[Signal, ...]:
    """What a map and a search through it tell a `distilled`; see `agents.foresight.Foresight.foreseen`."""
    each = "clearance while it is driven, and then to a stand [m], share until the first contact, how much longer the "
    each += "way is from its end, and from ahead of that [m], share of unseen places, visits"
    rounds = "from each of two distances around, how much longer the way is, and how far all is known to be free"
    return (
        Signal("foreseen", f"of each manoeuvre: {each}", count=MANOEUVRES * COLUMNS, silent=silent),
        Signal("around", rounds, "m", 3 * BEARINGS, silent=silent),
        Signal("way", "cost of the way to the target through the map", "m", low=0, silent=silent),
        Signal("thin", "1 if something thin stands near, else 0", low=0, high=1),
        Signal("first", "1 in the first decision of a drive, else 0", low=0, high=1),
    )


def _frame_memory(o: DoubleDqnOptions) -> tuple[Signal, ...]:
    """What a `double_dqn` in C remembers; lengths are those of the shipped vehicle."""
    bytes_seen, cells = o.frames * frame_width(o.rays, o.grid_map), grid_map.SIZE**2 if o.grid_map else 1
    whole, work = "unsigned char", "room to work in"
    return (
        Signal("pose", "at the last decision, from the target: x, y [m], yaw [rad]", count=3, stored="double"),
        Signal("yaw_rate", "at the last decision", "rad/s", stored="double"),
        Signal("bearing", "of the target at the last decision", "rad", stored="double"),
        Signal("share", "commanded speed at the last decision, as a share of the drive's", stored="double"),
        Signal("left", f"{work}: lengths of ways", "m", cells, stored="double"),
        Signal("cost", f"{work}: of half a cell", "m", cells, stored="double"),
        Signal("begun", "whether there was a decision", stored="int"),
        Signal("manoeuvre", "that was taken last", stored="int"),
        Signal("corner", "first cell of the map", count=2, stored="int"),
        Signal("cells", "of the map; above 0 where something stands", count=cells, stored=whole),
        Signal("frames", "what was seen last, as bytes, the newest first", count=bytes_seen, stored=whole),
    )


def _memory_signals(memory: Memory) -> tuple[Signal, ...]:
    """What is remembered, as the contract tells it."""
    about = {
        "numbers": "whether it has begun; numbers of scans, points remembered, points that move and points; side to "
        "which it turns on the spot, decisions to do so, and whether it backs out",
        "moved": "where it expects to be at the next decision, from here: x, y [m], yaw [rad]",
        "target": "the target at the last decision: x, y",
        "evidence": "evidence against the sensor of each sector",
        "points": "points of the last scan: x, y each",
        "rays": "the last scan; -1 for a blind ray",
        "standing": "points remembered: x, y [m], and scans since each was seen",
        "scans": "recent scans, the newest first",
        "poses": "poses at these scans",
        "strayed": "possible errors of these poses",
        "cloud": "points of obstacles now",
        "closing": "speed at which each may come nearer [m/s]",
        "moving": "whether each ray met something that moves",
    }
    kinds = {"f": "double", "i": "int", "b": "unsigned char"}
    return tuple(
        Signal(name, about.get(name, "room to work in"), count=its.size, stored=kinds[its.dtype.kind])
        for name, its in zip(memory._fields, memory, strict=True)
    )


def _actions(beyond: bool) -> str:
    turns = ", ".join(f"{number} turn by {round(np.degrees(turn))}" for number, turn in enumerate(paper.TURNS))
    told = f"{turns} degrees, {ACTIONS - 1} toward the target by 60 at most"
    if not beyond:
        return f"{told}, {STOPPED} stop"
    return f"{told}; {STOP} more while braking to a stand, {REVERSE} more backwards, {SLOW} more slowly"


def encoding_of(options: NnqlOptions | GeneticOptions) -> str:
    """How the paper's network is given the readings: see `NnqlOptions.encoding`."""
    return options.encoding if isinstance(options, NnqlOptions) else "proximity"
