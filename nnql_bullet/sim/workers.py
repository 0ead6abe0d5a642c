"""Simulates vehicles in several worker processes.

Each process makes its own simulator for some of the vehicles. Pipes carry worlds, commands, motions and samples. A
worker ends when its pipe closes, for any reason, so no worker outlives this process.
"""

import multiprocessing
import signal
import traceback
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.errors import UserError, WorkerDied
from nnql_bullet.geometry import Array
from nnql_bullet.sim.base import Motion, Sample, Simulator, Traces, no_motion
from nnql_bullet.worlds.passages import Point
from nnql_bullet.worlds.spec import WorldSpec

T = TypeVar("T")

EXIT_TIMEOUT = 5.0
"""Time limit for a worker to end by itself [s]."""


class WorkerSimulator:
    """A `Simulator` over processes. Vehicle i lives in process i modulo the number of processes."""

    def __init__(self, make: Callable[[int], Simulator], size: int, workers: int) -> None:
        """Starts the processes. After any error the simulator can only be closed.

        Args:
            make: Makes a simulator of a given size; the processes must be able to import it.
            size: Number of vehicles.
            workers: Number of processes, at most `size`.
        """
        self.size = size
        self._shares = [np.arange(first, size, workers) for first in range(workers)]
        context = multiprocessing.get_context("spawn")  # a fork would copy the locks of threads, and all memory
        self._pipes: list[Connection] = []
        self._processes: list[BaseProcess] = []
        # Ctrl-C and the end of a terminal reach all its processes; only this one should react. Children inherit blocked
        # signals.
        resource_tracker.ensure_running()  # otherwise the first child starts it, which unblocks Ctrl-C
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
        try:
            for share in self._shares:
                mine, theirs = context.Pipe()
                process = context.Process(target=_serve, args=(theirs, make, len(share)), daemon=True)
                process.start()
                theirs.close()  # so that the pipe closes when the process ends
                self._pipes.append(mine)
                self._processes.append(process)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        try:
            self.vehicle, self.drive = self._collect(range(workers))[0]
        except BaseException:
            self.close()
            raise

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        """See `Simulator.reset`."""
        workers, asked = len(self._pipes), self._shared(worlds)
        for worker, share in asked.items():
            self._send(worker, ("reset", share))
        answers = self._collect(asked)
        row = {i: row for row, i in enumerate(worlds)}
        poses, distances = np.empty((len(worlds), 3)), np.empty((len(worlds), self.vehicle.sensor.rays))
        for worker, share in asked.items():
            rows = [row[worker + workers * local] for local in share]
            poses[rows], distances[rows] = answers[worker]
        return poses, distances

    def advance(
        self,
        heading_changes: Array,
        active: NDArray[np.bool_] | None = None,
        speed_scales: Array | None = None,
        traces: Traces | None = None,
    ) -> tuple[Motion, Array]:
        """See `Simulator.advance`; all processes work at once."""
        active = np.ones(self.size, np.bool_) if active is None else active
        speed_scales = np.ones(self.size) if speed_scales is None else speed_scales
        traces = traces or {}
        asked = [worker for worker, share in enumerate(self._shares) if active[share].any()]
        for worker in asked:
            share = self._shares[worker]
            traced = [row for row, i in enumerate(share.tolist()) if i in traces]
            self._send(worker, ("advance", heading_changes[share], active[share], speed_scales[share], traced))
        answers = self._collect(asked)
        motion, ray_distances = no_motion(self.size), np.zeros((self.size, self.vehicle.sensor.rays))
        for worker in asked:
            share = self._shares[worker]
            (part, ray_distances[share]), samples = answers[worker]
            for field in fields(Motion):
                getattr(motion, field.name)[share] = getattr(part, field.name)
            for row, some in samples.items():
                traces[int(share[row])].extend(some)
        return motion, ray_distances

    def retarget(self, targets: Mapping[int, Point]) -> None:
        """See `Simulator.retarget`."""
        asked = self._shared(targets)
        for worker, share in asked.items():
            self._send(worker, ("retarget", share))
        self._collect(asked)

    def close(self) -> None:
        """Ends the processes: closes their pipes, and kills those that do not end."""
        for pipe in self._pipes:
            pipe.close()
        for process in self._processes:
            process.join(EXIT_TIMEOUT)
            if process.is_alive():
                process.kill()
                process.join()

    def _shared(self, given: Mapping[int, T]) -> dict[int, dict[int, T]]:
        """Sorts what is given by vehicle by worker, and by the vehicle's number there."""
        asked: dict[int, dict[int, T]] = {}
        for i, its in given.items():
            asked.setdefault(i % len(self._pipes), {})[i // len(self._pipes)] = its
        return asked

    def _send(self, worker: int, message: Any) -> None:
        try:
            self._pipes[worker].send(message)
        except OSError:
            raise self._death_of(worker) from None

    def _collect(self, workers: Iterable[int]) -> dict[int, Any]:
        """Collects the answers of some workers as they come.

        Raises:
            WorkerDied: As soon as a worker dies.
        """
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


def _serve(pipe: Connection, make: Callable[[int], Simulator], size: int) -> None:
    """Runs in a worker process: answers (result, error) to each message until the pipe ends."""
    try:
        simulator = make(size)
        pipe.send(((simulator.vehicle, simulator.drive), None))
        while True:
            verb, *arguments = pipe.recv()
            if verb == "reset":
                pipe.send((simulator.reset(*arguments), None))
            elif verb == "retarget":
                simulator.retarget(*arguments)
                pipe.send((None, None))
            else:
                heading_changes, active, speed_scales, traced = arguments
                traces: dict[int, list[Sample]] = {row: [] for row in traced}
                pipe.send(((simulator.advance(heading_changes, active, speed_scales, traces), traces), None))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except UserError as error:
        pipe.send((None, error))
    except Exception:
        pipe.send((None, traceback.format_exc()))
