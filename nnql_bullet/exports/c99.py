"""Policies in C99: readable source of fixed sizes, in single precision, and the operations of a decision."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import ceil, floor, hypot, pi, radians
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from numpy.typing import ArrayLike

from nnql_bullet import __version__, paper
from nnql_bullet.agents.learning import frames
from nnql_bullet.agents.learning.genetic import GeneticOptions
from nnql_bullet.agents.learning.options import DoubleDqnOptions, NnqlOptions
from nnql_bullet.agents.learning.q_table import QTableOptions
from nnql_bullet.agents.rules import fuzzy
from nnql_bullet.agents.rules.fuzzy import FuzzyOptions
from nnql_bullet.agents.rules.hand_rule import HandRuleOptions
from nnql_bullet.agents.rules.look_ahead import LookAheadOptions
from nnql_bullet.agents.rules.potential_field import CLOSEST, PotentialFieldOptions
from nnql_bullet.agents.rules.straight import StraightOptions
from nnql_bullet.agents.rules.vfh import BINS, VfhOptions
from nnql_bullet.agents.turns import nearest_turns
from nnql_bullet.env import ACTIONS, FARTHEST, LARGEST_TURN, MANOEUVRES, MOST_YAW_RATE, TOWARD_TARGET, speed_scale
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.exports.contract import STOPPED, WIDEST_BEARING, Contract, encoding_of
from nnql_bullet.exports.cost import FRAME, Cost, Operations
from nnql_bullet.exports.names import C_EXAMPLE, C_POLICY, C_POLICY_HEADER
from nnql_bullet.geometry import wrap_angles
from nnql_bullet.mapping import grid_map
from nnql_bullet.mapping.prediction import PREDICTION_STEP
from nnql_bullet.sensing import FRONT, FRONT_LEFT, FRONT_RIGHT, RAYS, nearest_rays
from nnql_bullet.vehicle.scale import length_scale, scaled

MOST_ROWS = 65_536
"""Rows of the largest table that is written as source."""
TEMPLATES = Path(__file__).with_name("templates")
_N = Operations


@dataclass(frozen=True, slots=True)
class Body:
    """The functions of a kind of policies."""

    template: str
    values: dict[str, Any]
    """What the template needs."""
    operations: Operations
    arrays: int = 0
    """Numbers in the arrays of its deepest calls."""
    depth: int = 1
    """Of its calls."""


_TOWARD = _N(additions=1, comparisons=2)
_NEAREST = len(paper.TURNS) * _N(additions=1, comparisons=2) + _N(additions=1, comparisons=1) + _TOWARD
_LARGEST = _N(comparisons=len(paper.TURNS) - 1)


def c_files(contract: Contract, experiment: Experiment) -> tuple[dict[str, str], Cost]:
    """The source files of a policy, by name, and what a decision takes.

    Raises:
        UserError: If the policy cannot be written in C.
    """
    options = experiment.config.agent
    if type(options) not in _BODIES:
        kinds = ", ".join(kind.kind for kind in _BODIES)
        raise UserError(
            f"{contract.policy}: a policy of kind '{options.kind}' cannot be written in C; these can: {kinds}"
        )
    body = _BODIES[type(options)](experiment, options)
    asks = any(signal.name == "safe" for signal in contract.outputs)
    d = contract.distances
    checks = d * _N(comparisons=2) + _N(comparisons=6) + d * _N(comparisons=1)
    operations = checks + body.operations + _TOWARD + (d * _N(comparisons=1) if asks else _N())
    cost = Cost(operations, 4 * (d + body.arrays) + FRAME * (1 + body.depth))
    values = body.values | {
        "contract": contract,
        "version": __version__,
        "body": f"{body.template}.c.j2",
        "asks": asks,
        "uses_nearest": type(options) in (FuzzyOptions, PotentialFieldOptions, VfhOptions),
        "turns": paper.TURNS,
        "thresholds": experiment.task.thresholds,
        "toward_target": TOWARD_TARGET,
        "stopped": STOPPED,
        "statuses": contract.statuses,
        "frames": isinstance(options, DoubleDqnOptions),
        "widest_bearing": WIDEST_BEARING,
        "most_yaw_rate": MOST_YAW_RATE,
        "farthest": FARTHEST,
    }
    return {name: rendered(f"{name}.j2", values) for name in (C_POLICY_HEADER, C_POLICY, C_EXAMPLE)}, cost


def rendered(template: str, values: Mapping[str, Any]) -> str:
    """A template of this folder with values in it."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), undefined=StrictUndefined, autoescape=False, keep_trailing_newline=True
    )
    text = environment.get_template(template).render(f=literal, row=_row, table=_table, **values)
    return "\n".join(line.rstrip() for line in text.rstrip().splitlines()) + "\n"


def literal(number: float) -> str:
    """A number as C writes it in single precision; it is read back as the nearest one."""
    text = repr(float(f"{np.float32(number):.9g}"))
    return f"{text}f"


def _row(numbers: ArrayLike) -> str:
    return f"{{ {', '.join(map(literal, np.asarray(numbers).tolist()))} }}"


def _table(rows: Iterable[ArrayLike]) -> str:
    return "{\n    " + ",\n    ".join(map(_row, rows)) + "\n}"


def _network(experiment: Experiment, options: NnqlOptions | GeneticOptions) -> Body:
    """The paper's network."""
    w1, b1, w2, b2 = (experiment.trainable.state_dict()[name] for name in ("0.weight", "0.bias", "2.weight", "2.bias"))
    values = {
        **{"w1": w1, "b1": b1, "w2": w2, "b2": b2},
        "encoding": encoding_of(options),
        "full_scale": paper.SENSOR_RANGE * length_scale(experiment.vehicle.footprint),
    }
    hidden, inputs = w1.shape
    proximity = values["encoding"] == "proximity"
    encoded = inputs * _N(additions=int(proximity), divisions=1, comparisons=1)
    sums = (hidden * inputs + len(w2) * hidden) * _N(additions=1, multiplications=1)
    units = hidden * _N(additions=2, divisions=1, functions=1)
    return Body("network", values, encoded + sums + units + _LARGEST, arrays=inputs + hidden)


def _q_table(experiment: Experiment, o: QTableOptions) -> Body:
    """Its table, with zeros where it never was."""
    if not 1 < o.states <= MOST_ROWS:
        raise UserError(f"a table of {o.states} states is not exported; it has to have 2 to {MOST_ROWS}")
    learned = experiment.trainable.state_dict()
    table = np.zeros((o.states, len(paper.TURNS)))
    table[learned["states"]] = learned["values"]
    edges = length_scale(experiment.vehicle.footprint) * np.array(o.edges)
    operations = len(o.edges) * len(o.sectors) * _N(comparisons=1) + _LARGEST
    return Body("q_table", {"edges": edges, "sectors": o.sectors, "values": table}, operations)


def _straight(experiment: Experiment, options: StraightOptions) -> Body:
    return Body("straight", {}, _N())


def _hand_rule(experiment: Experiment, o: HandRuleOptions) -> Body:
    angle = radians(o.turn_degrees)
    left, right = nearest_turns(np.array([angle, -angle])).tolist()
    values = {"left": left, "right": right, "front_left": FRONT_LEFT, "front_right": FRONT_RIGHT}
    return Body("hand_rule", values, _N(comparisons=3))


_FUZZY_TERMS = (("near", "far"), ("near", "far"), ("left", "neither", "right"), ("left", "ahead", "right"))
"""Terms of each of `fuzzy.VARIABLES`, by number."""


def _fuzzy(experiment: Experiment, o: FuzzyOptions) -> Body:
    points, turns = fuzzy.UNIVERSE_DEGREES, list(fuzzy.TURNS_DEGREES)
    rules = [
        [-1 if term is None else terms.index(term) for term, terms in zip(antecedent, _FUZZY_TERMS, strict=True)]
        for antecedent, _ in fuzzy.RULE_BASE
    ]
    values = {
        **{"o": o, "scale": length_scale(experiment.vehicle.footprint)},
        **{"variables": fuzzy.VARIABLES, "terms": 3, "rules": rules, "reading_range": paper.SENSOR_RANGE},
        "rule_texts": [(", ".join(term or "any" for term in its), turn) for its, turn in fuzzy.RULE_BASE],
        "rule_turns": [turns.index(turn) for _, turn in fuzzy.RULE_BASE],
        "turns_named": turns,
        "turn_terms": [np.maximum(1 - np.abs(points - at) / 30, 0) for at in fuzzy.TURNS_DEGREES.values()],
        **{"degrees": 180 / pi, "first_point": points[0], "point_step": points[1] - points[0]},
        **{"front": FRONT, "front_left": FRONT_LEFT, "front_right": FRONT_RIGHT},
    }
    readings = 3 * _N(divisions=1, comparisons=1) + 2 * _N(additions=3, divisions=1, comparisons=2)
    sides = 2 * _N(additions=2, divisions=3, comparisons=6) + _N(additions=1, multiplications=1, comparisons=1)
    fires = sum(term >= 0 for rule in rules for term in rule) * _N(comparisons=1) + len(rules) * _N(comparisons=1)
    truths = len(points) * len(turns) * _N(comparisons=2)
    areas = (len(points) - 1) * _N(additions=7, multiplications=4, divisions=1)
    operations = readings + sides + fires + truths + areas + _N(divisions=2, comparisons=1) + _NEAREST
    arrays = len(fuzzy.VARIABLES) * 3 + len(turns)
    return Body("fuzzy", values, operations, arrays, depth=3)


def _potential_field(experiment: Experiment, o: PotentialFieldOptions) -> Body:
    vehicle = experiment.vehicle
    scale, sensor = length_scale(vehicle.footprint), vehicle.sensor
    rays = np.flatnonzero(np.abs(wrap_angles(sensor.angles)) < radians(o.view_degrees) + 1e-9)
    box = scaled(vehicle.footprint, 1 / scale)
    values = {
        **{"scale": scale, "gain": o.gain * (RAYS / sensor.rays), "influence": o.influence, "closest": CLOSEST},
        **{"sensor": sensor.position, "rays": rays.tolist(), "directions": sensor.directions[rays]},
        **{"rear": box.x - box.half_length, "front": box.x + box.half_length},
        **{"right": box.y - box.half_width, "left": box.y + box.half_width},
    }
    each = _N(additions=8, multiplications=9, divisions=5, comparisons=7, functions=1)
    return Body("potential_field", values, len(rays) * each + _N(functions=3) + _NEAREST, depth=3)


def _vfh(experiment: Experiment, o: VfhOptions) -> Body:
    vehicle, drive = experiment.vehicle, experiment.config.drive
    scale, sensor, limits = length_scale(vehicle.footprint), vehicle.sensor, vehicle.limits
    ahead, left = sensor.position[0] / scale, sensor.position[1] / scale
    corners = vehicle.footprint.corners() - sensor.position[:2]
    radius = float(np.hypot(*corners.T).max()) / scale + o.safety_distance
    turning = drive.speed / limits.yaw_rate / scale
    values = {
        **{"o": o, "bins": BINS, "pi": pi, "scale": scale, "radius": radius, "ray_weight": RAYS / sensor.rays},
        **{"wide": radians(o.wide_degrees), "sensor": (ahead, left), "turning_radius": turning},
        "right_reach": hypot(ahead, left + turning) + radius,
        "left_reach": hypot(ahead, left - turning) + radius,
        **{"period": drive.decision_period, "yaw_rate": limits.yaw_rate, "yaw_acceleration": limits.yaw_acceleration},
        **{"bearings": wrap_angles(sensor.angles), "directions": sensor.directions},
    }
    wrap = _N(additions=2, multiplications=2, divisions=1, functions=1)
    widest = floor(BINS / 4) - ceil(-BINS / 4) + 1  # bins of a ray that is enlarged by a right angle to either side
    ray = _N(additions=3, multiplications=0, divisions=4, comparisons=3, functions=3)
    filled = sensor.rays * (ray + widest * _N(additions=3, multiplications=2)) + BINS * _N(multiplications=1)
    limited = sensor.rays * _N(additions=5, multiplications=4, divisions=1, comparisons=6, functions=1)
    masked = BINS * (_N(additions=1, multiplications=1, comparisons=4) + wrap)
    consider = 3 * (_N(additions=1, multiplications=1, comparisons=1) + wrap) + _N(additions=2, comparisons=1)
    opening = _N(additions=5, multiplications=3, divisions=2, comparisons=3) + wrap + 3 * consider
    chosen = BINS // 2 * opening + _N(additions=1, comparisons=1) + wrap
    dense = BINS * (_N(additions=1, multiplications=2, divisions=1, comparisons=5) + wrap)
    turned = _N(additions=18, multiplications=20, divisions=11, comparisons=16, functions=1) + wrap
    operations = filled + limited + masked + chosen + dense + _N(additions=1) + wrap + _NEAREST + turned
    arrays = BINS + BINS // 4 + 5  # density, bytes, candidates
    return Body("vfh", values, operations, arrays, depth=4)


def _look_ahead(experiment: Experiment, o: LookAheadOptions) -> Body:
    vehicle, drive = experiment.vehicle, experiment.config.drive
    sensor, limits, box = vehicle.sensor, vehicle.limits, vehicle.footprint
    steps = int(o.horizon / PREDICTION_STEP + 1e-9)
    values = {
        **{"steps": steps, "step": PREDICTION_STEP, "stride": drive.speed * PREDICTION_STEP, "pi": pi},
        **{"margin": o.margin * length_scale(box), "sensor": sensor.position, "directions": sensor.directions},
        **{"yaw_rate": limits.yaw_rate, "yaw_acceleration": limits.yaw_acceleration},
        **{"rear": box.x - box.half_length, "front": box.x + box.half_length},
        **{"right": box.y - box.half_width, "left": box.y + box.half_width},
    }
    point = _N(additions=7, multiplications=6, comparisons=6)
    pose = _N(additions=14, multiplications=11, divisions=5, comparisons=11, functions=4) + sensor.rays * point
    action = _N(additions=7, multiplications=11, divisions=6, comparisons=16, functions=2) + _TOWARD + steps * pose
    scanned = sensor.rays * _N(additions=2, multiplications=2, comparisons=1)
    return Body("look_ahead", values, scanned + (len(paper.TURNS) + 1) * action, 2 * sensor.rays + 5, depth=3)


def _double_dqn(experiment: Experiment, o: DoubleDqnOptions) -> Body:
    """Its map, its frames and its dueling network."""
    vehicle, drive, sensor = experiment.vehicle, experiment.config.drive, experiment.vehicle.sensor
    scale, limits, learned = length_scale(vehicle.footprint), vehicle.limits, experiment.trainable.state_dict()
    taken = nearest_rays(sensor.rays)
    width, places = frames.frame_width(o.rays, o.grid_map), grid_map.SENSE if o.grid_map else 0
    sensor_range, probe_steps = sensor.range / scale, ceil(grid_map.REACHES[-1] / (grid_map.MAP_CELL / 2))
    layers = [
        {name: learned[f"hidden.{3 * i + norm}.{part}"] for name, norm, part in _LAYER} for i in range(len(o.hidden))
    ]
    value, advantage = (
        {"w": learned[f"{head}.weight"], "b": learned[f"{head}.bias"]} for head in ("value", "advantage")
    )
    values = {
        **{"o": o, "grid": grid_map, "taken": taken.tolist(), "places": places, "width": width, "pi": pi},
        **{"scale": scale, "range": sensor_range, "reading_range": paper.SENSOR_RANGE, "far": frames.FAR},
        **{"detour": frames.DETOUR, "origin": [its / scale for its in sensor.position[:2]], "diagonal": 2**0.5},
        **{"angles": sensor.angles[taken].tolist(), "speed": drive.speed / scale, "drive_speed": drive.speed},
        **{"acceleration": limits.acceleration / scale, "yaw_rate": limits.yaw_rate, "instants": 5},
        **{"yaw_acceleration": limits.yaw_acceleration, "period": drive.decision_period},
        **{"largest_turn": LARGEST_TURN, "shares": speed_scale(np.arange(0, MANOEUVRES, ACTIONS), drive).tolist()},
        **{"probe_steps": probe_steps, "norm": 1e-5, "layers": layers, "advantage": advantage},
        "value": {"w": value["w"][0], "b": float(value["b"][0])},
    }
    units = o.frames * width, *o.hidden
    products = sum(a * b for a, b in pairwise(units)) + (1 + ACTIONS) * units[-1]
    network = products * _N(additions=1, multiplications=1) + units[0] * _N(additions=1, divisions=1)
    network += sum(o.hidden) * _N(additions=5, multiplications=2, divisions=1, comparisons=1)
    network += len(o.hidden) * _N(additions=1, divisions=2, functions=1) + ACTIONS * _N(additions=3, comparisons=1)
    frame = width * _N(additions=4, multiplications=4, divisions=2, comparisons=2, functions=2)
    step = 5 * _N(additions=25, multiplications=20, divisions=8, comparisons=14, functions=2)
    step += _N(additions=30, multiplications=30, divisions=15, comparisons=20, functions=10)
    rays = len(taken) * _N(divisions=1, comparisons=3)
    mapped = _mapped(len(taken), int(sensor_range / grid_map.MAP_CELL) + 1, probe_steps) if places else _N()
    cells = grid_map.SIZE**2 if places else 0
    doubles = 3 * len(taken) + places + 3 * grid_map.SIZE + 32
    arrays = 2 * doubles + cells // 2 + max(units) + max(o.hidden)
    return Body("double_dqn", values, network + frame + step + rays + mapped, arrays, depth=6)


_LAYER = (("w", 0, "weight"), ("b", 0, "bias"), ("gain", 1, "weight"), ("shift", 1, "bias"))
"""Names in the template, places and parts of a layer and of the layer norm after it."""


def _mapped(rays: int, cells: int, probe_steps: int) -> Operations:
    """What it takes to enter a scan into the map of a `double_dqn`, and to find ways, at most.

    Args:
        rays: Of a scan.
        cells: That a ray passes through.
        probe_steps: Steps along a probe.
    """
    cell = _N(divisions=1, functions=1)
    entered = _N(additions=2, divisions=1, functions=1)
    entered += (int(grid_map.NEIGHBOURS / (grid_map.MAP_CELL / 2)) + 3) * (
        _N(additions=4, multiplications=2, divisions=1) + 2 * cell
    )
    along = cells * (_N(additions=3, multiplications=3) + 2 * cell)
    pairs = (grid_map._BESIDE + 1) * (_N(additions=2, comparisons=3, functions=1) + entered)
    scan = rays * (_N(additions=6, multiplications=2, divisions=1, functions=2) + along + pairs)
    each = grid_map.SIZE**2
    begin = each * _N(additions=2, multiplications=2, divisions=1, comparisons=4, functions=1)
    sweeps = 2 * grid_map._MOST_SWEEPS * each * _N(additions=11, multiplications=2, comparisons=13)
    asked = _N(additions=12, multiplications=6, divisions=2, comparisons=4)
    steps = probe_steps * (_N(additions=3, multiplications=2, divisions=1) + 2 * cell)
    reaches = len(grid_map.REACHES) * (asked + _N(additions=3, multiplications=2, comparisons=1))
    probes = grid_map.BEARINGS * (_N(additions=1, multiplications=2, divisions=1, functions=2) + steps + reaches)
    return scan + begin + sweeps + asked + probes + 12 * cell


_BODIES: dict[Any, Callable[[Experiment, Any], Body]] = {
    NnqlOptions: _network,
    GeneticOptions: _network,
    QTableOptions: _q_table,
    StraightOptions: _straight,
    HandRuleOptions: _hand_rule,
    FuzzyOptions: _fuzzy,
    PotentialFieldOptions: _potential_field,
    VfhOptions: _vfh,
    LookAheadOptions: _look_ahead,
    DoubleDqnOptions: _double_dqn,
}
