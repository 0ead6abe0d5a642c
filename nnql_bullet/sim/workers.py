"""A fleet that is spread over worker processes.

Each process holds a fleet of its own, which it is told how to make; what travels are worlds, commands and motions. A
worker ends when its pipe does, however that comes about, so none outlives this process.
"""

import multiprocessing
import signal
import traceback
from collections.abc import Callable, Iterable, Mapping
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.sensing import RAYS
from nnql_bullet.sim.base import Fleet, Motions, WorkerDied
from nnql_bullet.worlds.spec import WorldSpec

EXIT_TIMEOUT = 5.0
"""How long a worker may take to end by itself [s]."""


class WorkerFleet:
    """Vehicle i lives in process i modulo the number of processes. See `sim.base.Fleet` for the contract."""

    def __init__(self, make: Callable[[int], Fleet], size: int, workers: int) -> None:
        """Starts the processes. After any error the fleet can only be closed.

        Args:
            make: Makes a fleet of a given size; it is sent to the processes, so it has to be importable there.
            size: Vehicles in all.
            workers: Processes, at most `size`.
        """
        self.size = size
        self._shares = [np.arange(first, size, workers) for first in range(workers)]
        context = multiprocessing.get_context("spawn")  # a fork would copy threads' locks, and all memory
        self._pipes: list[Connection] = []
        self._processes: list[BaseProcess] = []
        # Ctrl-C reaches every process of a terminal, but it is for this one to decide what it means. Its children take
        # over what it blocks.
        resource_tracker.ensure_running()  # else the first child starts it, and that unblocks Ctrl-C again
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            for share in self._shares:
                mine, theirs = context.Pipe()
                process = context.Process(target=_serve, args=(theirs, make, len(share)), daemon=True)
                process.start()
                theirs.close()  # so that the end of the process is the end of the pipe
                self._pipes.append(mine)
                self._processes.append(process)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        try:
            self._collect(range(workers))
        except BaseException:
            self.close()
            raise

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        """Puts some vehicles on the start of a world each."""
        workers = len(self._pipes)
        asked: dict[int, dict[int, WorldSpec]] = {}
        for i, world in worlds.items():
            asked.setdefault(i % workers, {})[i // workers] = world
        for worker, share in asked.items():
            self._send(worker, ("reset", share))
        answers = self._collect(asked)
        row = {i: row for row, i in enumerate(worlds)}
        poses, distances = np.empty((len(worlds), 3)), np.empty((len(worlds), RAYS))
        for worker, share in asked.items():
            rows = [row[worker + workers * local] for local in share]
            poses[rows], distances[rows] = answers[worker]
        return poses, distances

    def advance(
        self, heading_changes: Array, active: NDArray[np.bool_], speed_scales: Array | None = None
    ) -> tuple[Motions, Array]:
        """Drives one control period, in all processes at once."""
        speed_scales = np.ones(self.size) if speed_scales is None else speed_scales
        asked = [worker for worker, share in enumerate(self._shares) if active[share].any()]
        for worker in asked:
            share = self._shares[worker]
            self._send(worker, ("advance", heading_changes[share], active[share], speed_scales[share]))
        answers = self._collect(asked)
        distances = np.zeros((self.size, RAYS))
        pose, numbers, events = np.zeros((self.size, 3)), np.zeros((5, self.size)), np.zeros((2, self.size), np.bool_)
        for worker in asked:
            share = self._shares[worker]
            m, distances[share] = answers[worker]
            pose[share] = m.pose
            numbers[:, share] = m.yaw_rate, m.duration, m.path_length, m.clearance, m.heading_error
            events[:, share] = m.touching, m.at_target
        return Motions(pose, *numbers, *events), distances

    def close(self) -> None:
        """Ends the processes: by closing their pipes, and by force where that is not enough."""
        for pipe in self._pipes:
            pipe.close()
        for process in self._processes:
            process.join(EXIT_TIMEOUT)
            if process.is_alive():
                process.kill()
                process.join()

    def _send(self, worker: int, message: Any) -> None:
        try:
            self._pipes[worker].send(message)
        except OSError:
            raise self._death_of(worker) from None

    def _collect(self, workers: Iterable[int]) -> dict[int, Any]:
        """The answers of some workers, in whatever order they come; one that died is noticed at once."""
        waiting = {self._pipes[worker]: worker for worker in workers}
        answers = {}
        while waiting:
            for pipe in wait(list(waiting)):
                worker = waiting.pop(cast(Connection, pipe))
                try:
                    answers[worker], error = self._pipes[worker].recv()
                except (EOFError, OSError):
                    raise self._death_of(worker) from None
                if isinstance(error, UserError):
                    raise error
                if error:
                    raise RuntimeError(f"in worker {worker + 1} of {len(self._pipes)}:\n{error}")
        return answers

    def _death_of(self, worker: int) -> WorkerDied:
        process = self._processes[worker]
        process.join(EXIT_TIMEOUT)
        code = process.exitcode
        how = f"killed by {signal.Signals(-code).name}" if code is not None and code < 0 else f"exit code {code}"
        vehicles = ", ".join(str(i) for i in self._shares[worker][:8])
        more = ", ..." if len(self._shares[worker]) > 8 else ""
        return WorkerDied(
            f"worker {worker + 1} of {len(self._pipes)} died ({how}; process {process.pid}, vehicles {vehicles}{more})"
        )


def _serve(pipe: Connection, make: Callable[[int], Fleet], size: int) -> None:
    """What a worker process does: answers (result, error) to each message until the pipe ends."""
    try:
        fleet = make(size)
        pipe.send((None, None))
        while True:
            verb, *arguments = pipe.recv()
            pipe.send((getattr(fleet, verb)(*arguments), None))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except UserError as error:
        pipe.send((None, error))
    except Exception:
        pipe.send((None, traceback.format_exc()))
