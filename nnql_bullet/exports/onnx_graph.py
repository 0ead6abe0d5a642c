"""Policies as ONNX graphs, from raw distances to action and Q-values. The only module that imports onnx."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nnql_bullet import paper
from nnql_bullet.agents.learning.genetic import GeneticOptions
from nnql_bullet.agents.learning.options import NnqlOptions
from nnql_bullet.agents.learning.q_table import QTableOptions
from nnql_bullet.env import LARGEST_TURN, MOST_YAW_RATE, TOWARD_TARGET
from nnql_bullet.errors import UserError, missing_library
from nnql_bullet.experiment import Experiment
from nnql_bullet.exports.contract import STATUSES, STOPPED, WIDEST_BEARING, Contract, encoding_of
from nnql_bullet.vehicle.scale import length_scale

MODEL, EXAMPLE = "policy.onnx", "example.py"
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

    def to(self, kind: str, value: str) -> str:
        """A value of another type, such as INT64."""
        return self.add("Cast", value, to=getattr(self._onnx.TensorProto, kind))

    def all_true(self, rows: str) -> str:
        """Whether all of each row (n, m) is true (n,)."""
        least = self.add("ReduceMin", self.to("INT32", rows), axes=[1], keepdims=0)
        return self.to("BOOL", least)

    def within(self, value: str, low: float, high: float) -> str:
        """Whether numbers are no less and no more; NaN is not."""
        above = self.add("GreaterOrEqual", value, self.constant(low))
        return self.add("And", above, self.add("LessOrEqual", value, self.constant(high)))

    def model(self, inputs: Mapping[str, int], outputs: Mapping[str, tuple[str, int]], about: str) -> bytes:
        """The checked model.

        Args:
            inputs: Numbers of each for a vehicle, in single precision.
            outputs: Type, such as INT64, and numbers of each.
            about: What it is.
        """
        helper, types = self._onnx.helper, self._onnx.TensorProto

        def info(name: str, kind: str, count: int) -> Any:
            return helper.make_tensor_value_info(name, getattr(types, kind), ["n", count] if count > 1 else ["n"])

        graph = helper.make_graph(
            self._nodes,
            "policy",
            [info(name, "FLOAT", count) for name, count in inputs.items()],
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
    if not isinstance(options, NnqlOptions | GeneticOptions | QTableOptions):
        raise UserError(
            f"{contract.policy}: a policy of kind '{options.kind}' has no network of readings; export it as C"
        )
    g = Graph()
    seen = g.within("distances", 0.0, _LARGEST)
    distances = g.add("Where", seen, "distances", g.constant(0.0))
    distances = g.add("Min", distances, g.constant(contract.sensor_range))
    fine = (
        g.all_true(seen),
        g.within("target_distance", 0.0, _LARGEST),
        g.within("target_bearing", -WIDEST_BEARING, WIDEST_BEARING),
        g.within("yaw_rate", -MOST_YAW_RATE, MOST_YAW_RATE),
    )
    status = g.constant(STATUSES.index("OK"), np.int64)
    for number, is_fine in reversed(tuple(enumerate(fine, 1))):
        status = g.add("Where", is_fine, status, g.constant(number, np.int64))
    status = g.add("Identity", status, name="status")
    good = g.add("Equal", status, g.constant(0, np.int64))
    is_safe = g.all_true(g.add("GreaterOrEqual", distances, g.constant(experiment.task.thresholds)))
    learned = experiment.trainable.state_dict()
    scale = length_scale(experiment.vehicle.footprint)
    if isinstance(options, QTableOptions):
        values = _looked_up(g, distances, options, scale, learned)
    else:
        values = _computed(g, distances, encoding_of(options), scale, learned)
    best = g.add("ArgMax", values, axis=1, keepdims=0)
    chosen = g.add("Where", is_safe, g.constant(TOWARD_TARGET, np.int64), best)
    action = g.add("Where", good, chosen, g.constant(STOPPED, np.int64), name="action")
    bearing = g.add(
        "Where", g.within("target_bearing", -WIDEST_BEARING, WIDEST_BEARING), "target_bearing", g.constant(0.0)
    )
    toward = g.add("Clip", bearing, g.constant(-LARGEST_TURN), g.constant(LARGEST_TURN))
    turn = g.add("Gather", g.constant([*paper.TURNS, 0.0, 0.0]), action)
    toward_target = g.add("Equal", action, g.constant(TOWARD_TARGET, np.int64))
    g.add("Where", toward_target, toward, turn, name="heading_change")
    g.add("Cast", good, name="speed_share", to=1)
    g.add("And", good, is_safe, name="is_safe")
    g.add("Cast", "is_safe", name="safe", to=7)
    rows = g.add("Unsqueeze", good, g.constant([1], np.int64))
    g.add("Where", rows, values, g.constant(0.0), name="values")
    outputs = {s.name: ("INT64" if s.whole else "FLOAT", s.count) for s in contract.outputs}
    inputs = {signal.name: signal.count for signal in contract.inputs}
    return g.model(inputs, outputs | {"status": ("INT64", 1)}, f"{contract.policy} ({contract.kind}): see contract.md")


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
