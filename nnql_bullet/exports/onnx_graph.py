"""Policies as ONNX graphs, from raw distances to action and Q-values. The only module that imports onnx."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nnql_bullet import paper
from nnql_bullet.agents import foresight
from nnql_bullet.agents.foresight import PHI
from nnql_bullet.agents.learning.frames import DETOUR, FAR, frame_width
from nnql_bullet.agents.learning.genetic import GeneticOptions
from nnql_bullet.agents.learning.manoeuvre_driver import MANNERS
from nnql_bullet.agents.learning.options import DistilledOptions, DoubleDqnOptions, NnqlOptions
from nnql_bullet.agents.learning.q_table import QTableOptions
from nnql_bullet.env import ACTIONS, FARTHEST, LARGEST_TURN, MANOEUVRES, MOST_YAW_RATE, TOWARD_TARGET, speed_scale
from nnql_bullet.errors import UserError, missing_library
from nnql_bullet.experiment import Experiment
from nnql_bullet.exports.contract import STATUSES, STOPPED, WIDEST_BEARING, Contract, encoding_of
from nnql_bullet.mapping import foresight as ahead
from nnql_bullet.mapping import grid_map
from nnql_bullet.mapping.body_map import CELLS_ACROSS, FARTHER
from nnql_bullet.mapping.search import KEPT
from nnql_bullet.sensing import RAYS, nearest_rays
from nnql_bullet.vehicle.scale import length_scale

OPSET, IR_VERSION = 17, 8
"""Versions of the operators and of the file, which every ONNX Runtime since 1.14 reads."""
_LARGEST = float(np.finfo(np.float32).max)


class Graph:
    """Collects the nodes of a graph. A value is a name."""

    def __init__(self) -> None:
        try:
            import onnx
        except ImportError:
            raise missing_library("onnx", "export") from None
        self._onnx: Any = onnx
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def constant(self, values: ArrayLike, kind: type[np.generic] = np.float32) -> str:
        """A constant."""
        name = f"c{len(self._constants)}"
        self._constants.append(self._onnx.numpy_helper.from_array(np.asarray(values, kind), name))
        return name

    def add(self, operator: str, *inputs: str, name: str | None = None, **attributes: Any) -> str:
        """The result of an operator, with the name of an output or one of its own."""
        name = name or f"{operator}_{len(self._nodes)}"
        self._nodes.append(self._onnx.helper.make_node(operator, inputs, [name], **attributes))
        return name

    def number(self, values: ArrayLike) -> str:
        """A constant in double precision."""
        return self.constant(values, np.float64)

    def column(self, name: str) -> str:
        """An input (n,) as a column (n, 1) in double precision."""
        return self.add("Unsqueeze", self.to("DOUBLE", name), self.constant([1], np.int64))

    def line(self, value: str, factor: ArrayLike, offset: ArrayLike) -> str:
        """A value in double precision, times a factor, plus an offset."""
        return self.add("Add", self.add("Mul", value, self.number(factor)), self.number(offset))

    def as_bytes(self, numbers: str) -> str:
        """Numbers from -1 to 1 as bytes."""
        clipped = self.line(self.add("Clip", numbers, self.number(-1.0), self.number(1.0)), 1.0, 1.0)
        return self.to("UINT8", self.add("Round", self.add("Mul", clipped, self.number(127.5))))

    def of_bytes(self, seen: str) -> str:
        """Numbers from -1 to 1 of bytes, in single precision."""
        return self.add("Sub", self.add("Div", self.to("FLOAT", seen), self.constant(127.5)), self.constant(1.0))

    def linear(self, x: str, learned: Mapping[str, NDArray[Any]], name: str) -> str:
        """A layer of a network, by its name among the weights."""
        w, b = (self.constant(learned[f"{name}.{part}"]) for part in ("weight", "bias"))
        return self.add("Gemm", x, w, b, transB=1)

    def normed(self, x: str, learned: Mapping[str, NDArray[Any]], name: str) -> str:
        """A layer norm, by its name among the weights, and its rectifier."""
        gain, shift = (self.constant(learned[f"{name}.{part}"]) for part in ("weight", "bias"))
        return self.add("Relu", self.add("LayerNormalization", x, gain, shift, axis=-1, epsilon=1e-5))

    def type(self, kind: str) -> int:
        """The number of a type, such as INT64."""
        number: int = getattr(self._onnx.TensorProto, kind)
        return number

    def to(self, kind: str, value: str) -> str:
        """A value of another type."""
        return self.add("Cast", value, to=self.type(kind))

    def all_true(self, rows: str) -> str:
        """Whether all of each row (n, m) is true (n,)."""
        least = self.add("ReduceMin", self.to("INT32", rows), axes=[1], keepdims=0)
        return self.to("BOOL", least)

    def within(self, value: str, low: float, high: float) -> str:
        """Whether numbers are no less and no more; NaN is not."""
        above = self.add("GreaterOrEqual", value, self.constant(low))
        return self.add("And", above, self.add("LessOrEqual", value, self.constant(high)))

    def model(self, inputs: Mapping[str, tuple[str, int]], outputs: Mapping[str, tuple[str, int]], about: str) -> bytes:
        """The checked model.

        Args:
            inputs: Type, such as INT64, and numbers of each for a vehicle.
            outputs: Likewise.
            about: What it is.
        """
        helper, types = self._onnx.helper, self._onnx.TensorProto

        def info(name: str, kind: str, count: int) -> Any:
            return helper.make_tensor_value_info(name, getattr(types, kind), ["n", count] if count > 1 else ["n"])

        graph = helper.make_graph(
            self._nodes,
            "policy",
            [info(name, kind, count) for name, (kind, count) in inputs.items()],
            [info(name, kind, count) for name, (kind, count) in outputs.items()],
            self._constants,
            about,
        )
        opsets = [helper.make_opsetid("", OPSET)]
        model = helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION, producer_name="nnql-bullet")
        self._onnx.checker.check_model(model, full_check=True)
        text: bytes = model.SerializeToString()
        return text


def onnx_model(contract: Contract, experiment: Experiment) -> bytes:
    """The graph of a policy: inputs and outputs of its contract, and `status`, an index into `contract.STATUSES`.

    Raises:
        UserError: If the policy has no graph, or onnx is not installed.
    """
    options = experiment.config.agent
    if not isinstance(options, NnqlOptions | GeneticOptions | QTableOptions | DoubleDqnOptions | DistilledOptions):
        have = "nnql, genetic, q_table, double_dqn, distilled"
        raise UserError(f"{contract.policy}: a policy of kind '{options.kind}' has no graph; these have one: {have}")
    g = Graph()
    seen = g.within("distances", 0.0, _LARGEST)
    distances = g.add("Where", seen, "distances", g.constant(0.0))
    distances = g.add("Min", distances, g.constant(contract.sensor_range))
    fine = [
        g.all_true(seen),
        g.within("target_distance", 0.0, FARTHEST),
        g.within("target_bearing", -WIDEST_BEARING, WIDEST_BEARING),
        g.within("yaw_rate", -MOST_YAW_RATE, MOST_YAW_RATE),
    ]
    names = {signal.name: signal for signal in contract.inputs}
    if contract.takes_speed:
        fine.append(g.within("speed", names["speed"].low or 0.0, names["speed"].high or 0.0))
    if contract.map_beside:
        way = g.within("way", 0.0, _LARGEST)
        for name in ("around", "foreseen"):
            if name in names:
                way = g.add("And", way, g.all_true(g.within(name, -_LARGEST, _LARGEST)))
        fine.append(way)
    status = g.constant(STATUSES.index("OK"), np.int64)
    for number, is_fine in reversed(tuple(enumerate(fine, 1))):
        status = g.add("Where", is_fine, status, g.constant(number, np.int64))
    status = g.add("Identity", status, name="status")
    good = g.add("Equal", status, g.constant(0, np.int64))
    one = g.constant([1], np.int64)
    good_rows = g.add("Unsqueeze", good, one)
    if isinstance(options, DoubleDqnOptions):
        values = _dueling(g, distances, good_rows, options, experiment)
        chosen = g.add("ArgMax", values, axis=1, keepdims=0)
    elif isinstance(options, DistilledOptions):
        values = _foreseeing(g, distances, good_rows, options, experiment)
        chosen = _of_the_clear(g, values, options, experiment)
    else:
        learned, scale = experiment.trainable.state_dict(), length_scale(experiment.vehicle.footprint)
        if isinstance(options, QTableOptions):
            values = _looked_up(g, distances, options, scale, learned)
        else:
            values = _computed(g, distances, encoding_of(options), scale, learned)
        is_safe = g.all_true(g.add("GreaterOrEqual", distances, g.constant(experiment.task.thresholds)))
        best = g.add("ArgMax", values, axis=1, keepdims=0)
        chosen = g.add("Where", is_safe, g.constant(TOWARD_TARGET, np.int64), best)
        g.add("Cast", g.add("And", good, is_safe), name="safe", to=g.type("INT64"))
    action = g.add("Where", good, chosen, g.constant(STOPPED, np.int64), name="action")
    bearing = g.add("Where", fine[2], "target_bearing", g.constant(0.0))
    toward = g.add("Clip", bearing, g.constant(-LARGEST_TURN), g.constant(LARGEST_TURN))
    turned = g.add("Mod", action, g.constant(ACTIONS, np.int64))
    turn = g.add("Gather", g.constant([*paper.TURNS, 0.0]), turned)
    toward_target = g.add("Equal", turned, g.constant(TOWARD_TARGET, np.int64))
    toward = g.add("Where", g.add("And", good, toward_target), toward, turn)
    g.add("Where", good, toward, g.constant(0.0), name="heading_change")
    shares = speed_scale(np.arange(MANOEUVRES), experiment.config.drive)
    share = g.add("Gather", g.constant(shares), action)
    g.add("Where", good, share, g.constant(0.0), name="speed_share")
    g.add("Where", good_rows, values, g.constant(0.0), name="values")
    kept = {signal.name: ("UINT8", signal.count) for signal in contract.memory}
    outputs = {signal.name: ("INT64" if signal.whole else "FLOAT", signal.count) for signal in contract.outputs}
    outputs |= {"status": ("INT64", 1)} | {f"next_{name}": its for name, its in kept.items()}
    inputs = {signal.name: ("FLOAT", signal.count) for signal in contract.inputs}
    return g.model(inputs | kept, outputs, f"{contract.policy} ({contract.kind}): see contract.md")


def _dueling(g: Graph, distances: str, good: str, options: DoubleDqnOptions, experiment: Experiment) -> str:
    """Q-values (n, 6) of double DQN; the frames are an input and, a frame later, an output. See `frames.FrameMaker`.

    What is rounded to bytes is computed in double precision, as the agent does.
    """
    vehicle, scale = experiment.vehicle, length_scale(experiment.vehicle.footprint)
    one = g.constant([1], np.int64)

    taken = g.add("Gather", distances, g.constant(nearest_rays(vehicle.sensor.rays), np.int64), axis=1)
    rays = g.add("Div", g.to("DOUBLE", taken), g.number(scale))
    met = g.add("Less", rays, g.number(vehicle.sensor.range / scale))
    rays = g.add("Where", met, rays, g.number(paper.SENSOR_RANGE))
    shares = g.add("Reshape", rays, g.constant([-1, options.rays, RAYS // options.rays], np.int64))
    nearness = g.line(g.add("ReduceMin", shares, axes=[2], keepdims=0), -2 / paper.SENSOR_RANGE, 1.0)
    away, bearing = g.add("Div", g.column("target_distance"), g.number(scale)), g.column("target_bearing")
    parts = [nearness]
    if options.grid_map:
        reaches = np.repeat(2 * np.array(grid_map.REACHES), grid_map.BEARINGS)
        parts.append(g.add("Div", g.to("DOUBLE", "around"), g.number(reaches)))
    parts += [
        g.add("Cos", bearing),
        g.line(away, -2 / FAR, 1.0),
        g.line(g.add("Sub", g.column("way"), away), 2 / DETOUR, -1.0),
        g.add("Sin", bearing),
        g.add("Div", g.column("yaw_rate"), g.number(vehicle.limits.yaw_rate)),
        g.line(g.to("DOUBLE", g.add("Equal", g.column("last_action"), g.number(np.arange(ACTIONS)))), 2.0, -1.0),
    ]
    frame = g.as_bytes(g.add("Concat", *parts, axis=1))
    width = frame_width(options.rays, options.grid_map)
    kept = g.add(
        "Slice", "frames", g.constant([0], np.int64), g.constant([(options.frames - 1) * width], np.int64), one
    )
    alike = g.add("Concat", *[frame] * options.frames, axis=1)
    begins = g.add("Less", g.column("last_action"), g.number(0.0))
    stacked = g.add("Where", begins, alike, g.add("Concat", frame, kept, axis=1))
    g.add("Where", good, stacked, "frames", name="next_frames")
    learned = experiment.trainable.state_dict()
    hidden = g.of_bytes(stacked)
    for layer in range(0, 3 * len(options.hidden), 3):
        hidden = g.normed(g.linear(hidden, learned, f"hidden.{layer}"), learned, f"hidden.{layer + 1}")
    value, advantage = (g.linear(hidden, learned, head) for head in ("value", "advantage"))
    mean = g.add("ReduceMean", advantage, axes=[1], keepdims=1)
    return g.add("Add", value, g.add("Sub", advantage, mean))


def _foreseeing(g: Graph, distances: str, good: str, options: DistilledOptions, experiment: Experiment) -> str:
    """Values (n, 24) of a distilled search; earlier scans are an input and, a scan later, an output.

    See `foresight.Foresight`. What is rounded to bytes is computed in double precision, as the agent does.
    """
    vehicle, drive, scale = experiment.vehicle, experiment.config.drive, length_scale(experiment.vehicle.footprint)
    last, most = g.constant([2], np.int64), FARTHER * vehicle.width / CELLS_ACROSS
    one = g.constant([1], np.int64)

    taken = g.add("Gather", distances, g.constant(nearest_rays(vehicle.sensor.rays), np.int64), axis=1)
    rays = g.add("Div", g.to("DOUBLE", taken), g.number(scale))
    shape = g.constant([-1, foresight.SECTORS, RAYS // foresight.SECTORS], np.int64)
    nearest = g.add("ReduceMin", g.add("Reshape", rays, shape), axes=[2], keepdims=0)
    scan = g.as_bytes(g.line(g.add("Div", g.number(2.0), g.line(nearest, 1.0, 1.0)), 1.0, -1.0))
    begins = g.add("Greater", g.column("first"), g.number(0.5))
    alike = g.add("Concat", *[scan] * (foresight.SCANS - 1), axis=1)
    earlier = g.add("Where", begins, alike, "frames")
    kept = g.constant([(foresight.SCANS - 2) * foresight.SECTORS], np.int64)
    moved_on = g.add("Concat", scan, g.add("Slice", earlier, g.constant([0], np.int64), kept, one), axis=1)
    g.add("Where", good, moved_on, "frames", name="next_frames")
    probes = 3 * ahead.BEARINGS
    beyond = np.arange(probes) >= 2 * ahead.BEARINGS
    around = g.add("Div", g.to("DOUBLE", "around"), g.number(np.where(beyond, ahead.SIGHT * scale / 2, most)))
    away, bearing, way = g.column("target_distance"), g.column("target_bearing"), g.column("way")
    parts = [
        g.add("Sub", around, g.number(1.0 * beyond)),
        g.add("Div", g.column("speed"), g.number(drive.speed)),
        g.line(away, -2 / (foresight.FAR * scale), 1.0),
        g.line(g.add("Sub", way, away), 2 / (foresight.DETOUR * scale), -1.0),
        g.line(away, -2 / (foresight.NEAR * scale), 1.0),
        g.add("Add", g.add("Mul", away, g.number(0.0)), g.number(drive.speed / scale / 2 - 1)),
        g.line(g.column("thin"), 2.0, -1.0),
        g.add("Cos", bearing),
        g.add("Sin", bearing),
        g.add("Div", g.column("yaw_rate"), g.number(vehicle.limits.yaw_rate)),
    ]
    rest = g.as_bytes(g.add("Concat", *parts, axis=1))
    factors, offsets = np.ones(ahead.COLUMNS), np.zeros(ahead.COLUMNS)
    factors[[ahead.ROOM, ahead.STOP_ROOM]] = 2 / (ahead.MOST_ROOM * scale)
    factors[[ahead.LASTS, ahead.UNKNOWN]], factors[[ahead.WAY, ahead.WAY_AHEAD]] = 2.0, 1 / most
    factors[ahead.VISITS] = 2 / ahead.MOST_VISITS
    offsets[[ahead.ROOM, ahead.STOP_ROOM, ahead.LASTS, ahead.UNKNOWN, ahead.VISITS]] = -1.0
    phi_shape = g.constant([-1, MANOEUVRES, ahead.COLUMNS], np.int64)
    phi = g.line(g.add("Reshape", g.to("DOUBLE", "foreseen"), phi_shape), factors, offsets)
    toward = g.add("Clip", bearing, g.number(-LARGEST_TURN), g.number(LARGEST_TURN))
    turn_parts = [g.add("Add", g.add("Mul", bearing, g.number(0.0)), g.number(paper.TURNS)), toward]
    turns = g.add("Div", g.add("Concat", *turn_parts * MANNERS, axis=1), g.number(np.pi / 3))
    phi = g.as_bytes(g.add("Concat", phi, g.add("Unsqueeze", turns, last), axis=2))
    learned = experiment.trainable.state_dict()
    x = g.of_bytes(g.add("Concat", scan, earlier, rest, axis=1))
    for layer in range(0, 3 * len(options.hidden), 3):
        x = g.linear(x, learned, f"surroundings.{layer}")
        if layer < 3 * (len(options.hidden) - 1):
            x = g.normed(x, learned, f"surroundings.{layer + 1}")
    weight, bias = learned["foreseen.weight"], learned["foreseen.bias"]
    manners = np.repeat(weight[:, PHI:].T + bias, ACTIONS, axis=0)
    each = g.add("Add", g.add("MatMul", g.of_bytes(phi), g.constant(weight[:, :PHI].T)), g.constant(manners))
    each = g.add("Relu", g.add("Add", each, g.add("Unsqueeze", x, one)))
    each = g.add("MatMul", each, g.constant(learned["value.1.weight"].T))
    each = g.add("Relu", g.add("Add", each, g.constant(learned["value.1.bias"])))
    each = g.add("MatMul", each, g.constant(learned["value.3.weight"].T))
    return g.add("Squeeze", g.add("Add", each, g.constant(learned["value.3.bias"])), last)


def _of_the_clear(g: Graph, values: str, options: DistilledOptions, experiment: Experiment) -> str:
    """The best of the manoeuvres that meet nothing (n,); if all do, the one that does so last: `Foresight.chosen`."""
    scale, last = length_scale(experiment.vehicle.footprint), g.constant([2], np.int64)
    shape = g.constant([-1, MANOEUVRES, ahead.COLUMNS], np.int64)
    foreseen = g.add("Reshape", g.to("DOUBLE", "foreseen"), shape)

    def column(number: int) -> str:
        return g.add("Squeeze", g.add("Gather", foreseen, g.constant([number], np.int64), axis=2), last)

    q = g.to("DOUBLE", values)
    clear, lasts = g.add("Min", column(ahead.ROOM), column(ahead.STOP_ROOM)), column(ahead.LASTS)
    most_clear = g.add("ReduceMax", clear, axes=[1], keepdims=1)
    least = g.add("Min", g.add("Mul", most_clear, g.number(KEPT)), g.number(options.search.margin * scale))
    meets = g.add("Or", g.add("Less", lasts, g.number(1.0)), g.add("Less", clear, least))
    most, smallest = (g.add(f"Reduce{which}", q, axes=[1], keepdims=1) for which in ("Max", "Min"))
    worst = g.add("Add", g.add("Sub", most, smallest), g.number(1.0))
    late = g.add("Add", g.add("Mul", g.add("Sub", g.number(1.0), lasts), g.number(100.0)), g.number(2.0))
    return g.add("ArgMax", g.add("Where", meets, g.add("Sub", q, g.add("Mul", worst, late)), q), axis=1, keepdims=0)


def _computed(g: Graph, distances: str, encoding: str, scale: float, learned: Mapping[str, NDArray[Any]]) -> str:
    """Q-values (n, 5) of the paper's network."""
    full = g.constant(paper.SENSOR_RANGE * scale)
    seen = g.add("Div", g.add("Min", distances, full), full)
    if encoding == "proximity":
        seen = g.add("Sub", g.constant(1.0), seen)
    else:
        seen = g.add("Where", g.add("Less", distances, full), seen, g.constant(0.0))
    w1, b1, w2, b2 = (g.constant(learned[name]) for name in ("0.weight", "0.bias", "2.weight", "2.bias"))
    hidden = g.add("Sigmoid", g.add("Gemm", seen, w1, b1, transB=1))
    return g.add("Gemm", hidden, w2, b2, transB=1)


def _looked_up(
    g: Graph, distances: str, options: QTableOptions, scale: float, learned: Mapping[str, NDArray[Any]]
) -> str:
    """Q-values (n, 5) of a table."""
    table = np.zeros((options.states, len(paper.TURNS)))
    table[learned["states"]] = learned["values"]
    read = g.add("Gather", distances, g.constant(options.sectors, np.int64), axis=1)
    last, one = g.constant([2], np.int64), g.constant([1], np.int64)
    reached = g.add("GreaterOrEqual", g.add("Unsqueeze", read, last), g.constant(scale * np.array(options.edges)))
    levels = g.add("ReduceSum", g.to("INT64", reached), last, keepdims=0)
    steps = (len(options.edges) + 1) ** np.arange(len(options.sectors))
    state = g.add("ReduceSum", g.add("Mul", levels, g.constant(steps, np.int64)), one, keepdims=0)
    return g.add("Gather", g.constant(table), state)
