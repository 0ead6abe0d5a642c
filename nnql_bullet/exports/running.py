"""Exported policies in the project's own loop: one compiled from C, and one in ONNX Runtime, are policies as well.

The only module that imports onnxruntime.
"""

import ctypes
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.base import NoMemory
from nnql_bullet.env import Observation
from nnql_bullet.errors import UserError, missing_library
from nnql_bullet.exports.contract import Contract, Signal
from nnql_bullet.exports.maps import MapBeside, Told, forgotten
from nnql_bullet.exports.names import C_POLICY, C_SHIELD
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Actions

FLAGS = ("-std=c99", "-O2")
_STORED = {"double": np.float64, "int": np.int32, "unsigned char": np.uint8}


def build(folder: Path, library: Path, flags: Sequence[str] = FLAGS, compiler: str = "cc") -> Path:
    """Compiles an exported policy to a shared library.

    Raises:
        UserError: If there is no such compiler, or it refuses the source.
    """
    program = shutil.which(compiler)
    if program is None:
        raise UserError(f"there is no C compiler '{compiler}'; install one, or name another")
    sources = [str(folder / name) for name in (C_POLICY, C_SHIELD) if (folder / name).exists()]
    command = [program, *flags, "-shared", "-fPIC", "-o", str(library), *sources, "-lm"]
    answer = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if answer.returncode:
        raise UserError(f"{folder / C_POLICY}: does not compile: {answer.stderr.strip().partition(chr(10))[0]}")
    return library


def _layout(signals: Sequence[Signal], whole: type[np.generic]) -> np.dtype[Any]:
    """How C lays out a structure of these signals."""
    kinds = [_STORED.get(its.stored, whole if its.whole else np.float32) for its in signals]
    shapes = [(its.count,) if its.count > 1 else () for its in signals]
    names = [its.name for its in signals]
    return np.dtype(list(zip(names, kinds, shapes, strict=True)), align=True)


class LibraryPolicy:
    """A policy in a shared library; see `rollout.Policy`. Its state is the memory of n vehicles, None without one."""

    def __init__(self, library: Path, contract: Contract) -> None:
        """Loads it.

        Raises:
            UserError: If there is no such library, or it is of another policy.
        """
        self.contract = contract
        part = "shield" if contract.shielded else "policy"
        try:
            functions = ctypes.CDLL(str(library))
            self._decide = functions[f"{part}_decide"]
            sizes = tuple((ctypes.c_uint * 3).in_dll(functions, f"{part}_sizes"))
        except (OSError, AttributeError, ValueError) as error:
            raise UserError(f"{library}: no shared library of an exported policy ({error})") from None
        self._decide.restype = ctypes.c_int
        self._outputs = _layout(contract.outputs, np.int32)
        self._memory = _layout(contract.memory, np.uint8) if contract.memory else None
        row = 4 * sum(signal.count for signal in contract.inputs)
        if sizes != (row, self._memory.itemsize if self._memory else 0, self._outputs.itemsize):
            other = "it is of another policy, vehicle or version"
            raise UserError(f"{library}: does not fit '{contract.policy}': {other}; export that again")

    def initial_state(self, size: int) -> NDArray[Any] | None:
        """Returns an empty memory of n vehicles."""
        return None if self._memory is None else np.zeros(size, self._memory)

    def reset(self, state: NDArray[Any] | None, world_seeds: Mapping[int, int]) -> NDArray[Any] | None:
        """Empties the memory of these vehicles."""
        if state is not None:
            state = state.copy()
            state[list(world_seeds)] = np.zeros((), state.dtype)
        return state

    def decide(
        self, rows: NDArray[np.float32], state: NDArray[Any] | None
    ) -> tuple[NDArray[np.int64], NDArray[Any], NDArray[Any] | None]:
        """Decides by inputs (n, numbers).

        Returns:
            Statuses (n,), outputs (n,) as the contract names them, and the next state.
        """
        rows, outputs = np.ascontiguousarray(rows, np.float32), np.zeros(len(rows), self._outputs)
        state = None if state is None else state.copy()
        taken = [rows, outputs] if state is None else [rows, state, outputs]
        places = [(its.ctypes.data, its.strides[0]) for its in taken]
        decide, pointer = self._decide, ctypes.c_void_p
        statuses = [decide(*(pointer(start + k * stride) for start, stride in places)) for k in range(len(rows))]
        return np.array(statuses, np.int64), outputs, state

    def act(self, observations: Observation, state: NDArray[Any] | None) -> tuple[Actions, NDArray[Any] | None]:
        """Returns the actions (n,), of bad input a stop, and the next state."""
        _, outputs, state = self.decide(self.contract.rows(observations), state)
        return outputs["action"].astype(np.int64), state

    def action_values(self, observations: Observation, state: NDArray[Any] | None) -> Array:
        """Returns Q-values of the five turns (n, 5); NaN in safe states, and of a rule."""
        _, outputs, _ = self.decide(self.contract.rows(observations), state)
        if not self.contract.has_values:
            return np.full((len(outputs), len(paper.TURNS)), np.nan)
        values = outputs["values"][:, : len(paper.TURNS)].astype(np.float64)
        return (
            np.where(outputs["safe"][:, None] == 0, values, np.nan) if "safe" in (outputs.dtype.names or ()) else values
        )


class OnnxPolicy(NoMemory):
    """A policy in ONNX Runtime; see `rollout.Policy`."""

    def __init__(self, model: Path, contract: Contract) -> None:
        """Loads it.

        Raises:
            UserError: If ONNX Runtime is not installed.
        """
        try:
            import onnxruntime
        except ImportError:
            raise missing_library("ONNX Runtime", "export") from None
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.contract = contract
        self._session: Any = onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])

    def decide(self, rows: NDArray[np.float32], frames: NDArray[np.uint8] | None = None) -> dict[str, NDArray[Any]]:
        """Decides by inputs (n, numbers); the outputs (n, ...) by name, as the contract has them, and `status`.

        With a memory, the frames (n, bytes) go in too, and come out as `next_frames`.
        """
        ends = np.cumsum([signal.count for signal in self.contract.inputs])[:-1]
        parts = zip(self.contract.inputs, np.split(rows, ends, axis=1), strict=True)
        given: dict[str, NDArray[Any]] = {
            signal.name: part if signal.count > 1 else part[:, 0] for signal, part in parts
        }
        if frames is not None:
            given["frames"] = frames
        names = [output.name for output in self._session.get_outputs()]
        return dict(zip(names, self._session.run(names, given), strict=True))

    def act(self, observations: Observation, state: None) -> tuple[Actions, None]:
        """Returns the actions (n,), of bad input a stop."""
        return self.decide(self.contract.rows(observations))["action"], None

    def action_values(self, observations: Observation, state: None) -> Array:
        """Returns Q-values of the five turns (n, 5); NaN in safe states."""
        outputs = self.decide(self.contract.rows(observations))
        return np.where(outputs["safe"][:, None] == 0, outputs["values"].astype(np.float64), np.nan)


class OnnxMapPolicy(OnnxPolicy):
    """A policy in ONNX Runtime whose map is beside the graph; its state is the memory of the map (`exports.maps`)."""

    def __init__(self, model: Path, contract: Contract, beside: MapBeside) -> None:
        super().__init__(model, contract)
        self._map = beside

    def initial_state(self, size: int) -> Any:
        """Returns an empty memory of n vehicles."""
        return self._map.nothing(size)

    def reset(self, state: Any, world_seeds: Mapping[int, int]) -> Any:
        """Forgets these vehicles."""
        return forgotten(state, world_seeds)

    def see(self, observations: Observation, state: Any) -> tuple[NDArray[np.float32], Told]:
        """The inputs (n, numbers), and what the map tells."""
        told = self._map.told(state, observations)
        return np.concatenate([self.contract.rows(observations), told.inputs], axis=1), told

    def act(self, observations: Observation, state: Any) -> tuple[Actions, Any]:
        """Returns the actions (n,), of bad input a stop, and the next memory."""
        rows, told = self.see(observations, state)
        outputs = self.decide(rows, told.frames)
        return outputs["action"], self._map.after(told, observations, outputs)

    def action_values(self, observations: Observation, state: Any) -> Array:
        """Returns Q-values of the five turns (n, 5)."""
        rows, told = self.see(observations, state)
        return self.decide(rows, told.frames)["values"][:, : len(paper.TURNS)].astype(np.float64)

    def values_of(self, policy: Any, state: Any) -> NDArray[Any]:
        """The values (n, m) by which the policy itself made the decision that gave this state."""
        return self._map.values_of(policy, state)
