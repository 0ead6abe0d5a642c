"""Vehicles in worker processes: the same wherever they live, deaths are told at once, and nothing is left running."""

import multiprocessing
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from nnql_bullet.errors import UserError, WorkerDied
from nnql_bullet.geometry import Array, Pose
from nnql_bullet.sensing import RAYS
from nnql_bullet.sim import workers
from nnql_bullet.sim.base import Motion, Sample, Traces, no_motion
from nnql_bullet.sim.workers import WorkerSimulator
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.spec import WorldSpec

LIMIT = 60.0
"""Seconds after which a wait is given up: far more than a noisy machine needs."""
MEGABYTE = 1024
"""In the kilobytes of /proc."""


class FakeSimulator:
    """Vehicles that turn on the spot, in a process that can be made to hang, to fail or to end."""

    def __init__(self, size: int) -> None:
        self.size, self.vehicle, self.drive = size, load_vehicle("tricycle"), DriveOptions()
        self._yaws = np.zeros(size)

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        for i, world in worlds.items():
            self._yaws[i] = world.start.yaw
            _misbehave(world.name)
        chosen = list(worlds)
        poses = np.zeros((len(chosen), 3))
        poses[:, 2] = self._yaws[chosen]
        return poses, self._rays()[chosen]

    def advance(
        self,
        heading_changes: Array,
        active: NDArray[np.bool_] | None = None,
        speed_scales: Array | None = None,
        traces: Traces | None = None,
    ) -> tuple[Motion, Array]:
        active = np.ones(self.size, np.bool_) if active is None else active
        if np.isnan(heading_changes).any():
            _misbehave("hang")
        if np.isinf(heading_changes).any():
            _misbehave("fail")
        self._yaws += np.where(active, heading_changes, 0.0)
        motions = no_motion(self.size)
        for k, field in enumerate(fields(Motion)):
            values = getattr(motions, field.name)
            values[active] = values.dtype.type(1)
            values *= (self._yaws > 0.5 if values.dtype == np.bool_ else k + self._yaws).reshape(
                -1, *[1] * (values.ndim - 1)
            )
        motions.pose[:, 2] = np.where(active, self._yaws, 0.0)
        for i, trace in (traces or {}).items():
            trace.append(Sample(0.0, Pose(0.0, 0.0, float(self._yaws[i])), (0.0,) * 4, (0.0, 0.0)))
        return motions, np.where(active[:, None], self._rays(), 0.0)

    def _rays(self) -> Array:
        """The first is the number of the process."""
        rays = self._yaws[:, None] * np.arange(RAYS)
        rays[:, 0] = os.getpid()
        return rays

    def close(self) -> None:
        pass


def _misbehave(how: str) -> None:
    if how == "hang":
        time.sleep(10 * LIMIT)
    if how == "fail":
        raise ValueError("bad world")
    if how == "end":
        os._exit(3)


def fails_to_begin(size: int) -> FakeSimulator:
    raise ValueError("no such vehicle")


def refuses(size: int) -> FakeSimulator:
    raise UserError(f"no room for {size} vehicles")


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)


def state(pid: int) -> str:
    """Of a process: R, S, T, Z, ..., or nothing if there is none."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return ""


def pids(fleet: WorkerSimulator) -> list[int]:
    return [process.pid or 0 for process in fleet._processes]


def gone(pid: int) -> bool:
    """Whether nothing at all is left of a child: not even its exit code, which somebody took."""
    return state(pid) == ""


@pytest.fixture
def leaves_none() -> Iterator[None]:
    """At its end there are no more children than at its beginning."""
    before = set(multiprocessing.active_children())
    yield
    assert set(multiprocessing.active_children()) <= before


@contextmanager
def killing(pid: int, number: signal.Signals = signal.SIGKILL, after: float = 0.3) -> Iterator[None]:
    """Sends a process a signal while this one waits for something."""
    timer = threading.Timer(after, os.kill, [pid, number])
    timer.start()
    try:
        yield
    finally:
        timer.join()


def worlds_named(world_of: Callable[..., WorldSpec], *names: str) -> dict[int, WorldSpec]:
    made = {}
    for i, name in enumerate(names):
        world = world_of(start=Pose(100.0, 100.0, i / 10))
        made[i] = WorldSpec(
            name, i, world.width, world.depth, (), world.start, world.target, world.target_radius, world.obstacle_height
        )
    return made


@pytest.fixture
def five() -> Iterator[WorkerSimulator]:
    """Five vehicles in two processes: 0, 2, 4 and 1, 3."""
    with closing(WorkerSimulator(FakeSimulator, 5, 2)) as fleet:
        yield fleet


@pytest.fixture(scope="module")
def shared() -> Iterator[WorkerSimulator]:
    """The same, for tests that let them live."""
    with closing(WorkerSimulator(FakeSimulator, 5, 2)) as fleet:
        yield fleet


ALL_FIVE = np.ones(5, np.bool_)


class TestSharing:
    @pytest.mark.parametrize("count", [1, 2, 3])
    def test_the_number_of_workers_makes_no_difference(
        self, shared: WorkerSimulator, world_of: Callable[..., WorldSpec], count: int
    ) -> None:
        worlds = worlds_named(world_of, *"abcde")
        generator = np.random.default_rng(0)
        calls: list[tuple[str, Any]] = [("reset", (worlds,))]
        for active in ([1, 1, 1, 1, 1], [1, 0, 1, 1, 0], [0, 1, 0, 0, 0], [0, 0, 0, 0, 0], [1, 1, 1, 1, 1]):
            calls.append(("advance", (generator.uniform(-1, 1, 5), np.array(active, np.bool_))))
            calls.append(("reset", ({3: worlds[0], 0: worlds[1], 2: worlds[4]},)))
        here = FakeSimulator(5)
        fleet = shared if count == 2 else WorkerSimulator(FakeSimulator, 5, count)
        try:
            for verb, arguments in calls:
                assert numbers(getattr(fleet, verb)(*arguments)) == numbers(getattr(here, verb)(*arguments))
        finally:
            if fleet is not shared:
                fleet.close()

    def test_vehicles_are_dealt_out_in_turn(self, shared: WorkerSimulator, world_of: Callable[..., WorldSpec]) -> None:
        poses, rays = shared.reset(worlds_named(world_of, *"abcde"))
        assert poses[:, 2].tolist() == [0.0, 0.1, 0.2, 0.3, 0.4]
        first, second = pids(shared)
        assert rays[:, 0].tolist() == [first, second, first, second, first]
        assert os.getpid() not in (first, second)

    def test_workers_are_left_in_peace_if_none_of_their_vehicles_is_asked(
        self, shared: WorkerSimulator, world_of: Callable[..., WorldSpec]
    ) -> None:
        os.kill(pids(shared)[1], signal.SIGSTOP)
        worlds = worlds_named(world_of, *"abcde")
        assert shared.reset({4: worlds[4], 0: worlds[0]})[0][:, 2].tolist() == [0.4, 0.0]
        motions, _ = shared.advance(np.full(5, 0.5), np.array([True, False, False, False, True]))
        assert motions.pose[[0, 4], 2].tolist() == [0.5, 0.9]
        os.kill(pids(shared)[1], signal.SIGCONT)

    def test_samples_come_back_to_the_vehicles_they_are_of(
        self, shared: WorkerSimulator, world_of: Callable[..., WorldSpec]
    ) -> None:
        shared.reset(worlds_named(world_of, *"abcde"))
        traces: dict[int, list[Sample]] = {3: [], 0: []}
        for _ in range(2):
            shared.advance(np.full(5, 0.25), traces=traces)
        assert [sample.pose.yaw for sample in traces[0]] == [0.25, 0.5]
        assert [sample.pose.yaw for sample in traces[3]] == pytest.approx([0.55, 0.8])

    @pytest.mark.slow
    def test_a_worker_with_a_vehicle_in_contact_physics_is_small(
        self, vehicle: VehicleSpec, world_of: Callable[..., WorldSpec]
    ) -> None:
        from nnql_bullet.sim.engines import contact_simulator

        make = partial(contact_simulator, "bullet", "fast", vehicle, DriveOptions())
        with closing(WorkerSimulator(make, 1, 1)) as fleet:
            fleet.reset({0: world_of()})
            fleet.advance(np.zeros(1), np.ones(1, np.bool_))
            (resident,) = re.findall(r"VmRSS:\s+(\d+) kB", Path(f"/proc/{pids(fleet)[0]}/status").read_text())
        assert int(resident) < 250 * MEGABYTE


def numbers(answer: tuple[Any, Array]) -> list[Any]:
    """An answer as plain numbers, but for those of processes."""
    first, rays = answer
    parts = [getattr(first, field.name) for field in fields(Motion)] if isinstance(first, Motion) else [first]
    return [part.tolist() for part in (*parts, rays[:, 1:])]


class TestDeath:
    @pytest.mark.parametrize("verb", ["reset", "advance"])
    def test_a_worker_that_was_killed_is_named(
        self, five: WorkerSimulator, world_of: Callable[..., WorldSpec], verb: str
    ) -> None:
        worlds = worlds_named(world_of, *"abcde")
        five.reset(worlds)
        pid = pids(five)[1]
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(WorkerDied) as caught:
            five.reset(worlds) if verb == "reset" else five.advance(np.zeros(5), ALL_FIVE)
        assert str(caught.value) == f"worker 2 of 2 died (killed by SIGKILL; process {pid}, vehicles 1, 3)"
        five.close()
        assert all(gone(pid) for pid in pids(five))

    def test_a_death_is_noticed_while_others_are_still_at_work(self, five: WorkerSimulator) -> None:
        hanging, pid = pids(five)
        with killing(pid), pytest.raises(WorkerDied, match=rf"^worker 2 of 2 died \(killed by SIGKILL; process {pid}"):
            five.advance(np.full(5, np.nan), ALL_FIVE)
        assert state(hanging) == "S"
        os.kill(hanging, signal.SIGKILL)

    @pytest.mark.slow
    def test_one_that_ended_by_itself_is_told_from_one_that_was_killed(
        self, five: WorkerSimulator, world_of: Callable[..., WorldSpec]
    ) -> None:
        with pytest.raises(WorkerDied, match=r"^worker 1 of 2 died \(exit code 3; process \d+, vehicles 0, 2, 4\)$"):
            five.reset(worlds_named(world_of, "a", "b", "end"))

    @pytest.mark.slow
    def test_the_signal_is_named_and_not_all_of_many_vehicles(self) -> None:
        with closing(WorkerSimulator(FakeSimulator, 21, 2)) as fleet:
            os.kill(pids(fleet)[0], signal.SIGTERM)
            wait_for(lambda: state(pids(fleet)[0]) in ("Z", ""))
            expected = r"\(killed by SIGTERM; process \d+, vehicles 0, 2, 4, 6, 8, 10, 12, 14, \.\.\.\)$"
            with pytest.raises(WorkerDied, match=expected):
                fleet.advance(np.zeros(21), np.ones(21, np.bool_))

    def test_an_error_inside_a_worker_arrives_with_its_traceback(
        self, five: WorkerSimulator, world_of: Callable[..., WorldSpec]
    ) -> None:
        worlds = worlds_named(world_of, "a", "b", "c", "fail")
        with pytest.raises(RuntimeError) as caught:
            five.reset({1: worlds[1], 3: worlds[3]})
        message = str(caught.value)
        assert message.startswith("in worker 2 of 2:\nTraceback")
        assert "in _misbehave" in message
        assert message.endswith("ValueError: bad world\n")
        with pytest.raises(RuntimeError, match=r"(?s)^in worker 1 of 2:.*ValueError: bad world"):
            five.advance(np.array([0.0, 0.0, np.inf, 0.0, 0.0]), np.array([True, False, True, False, True]))


@pytest.mark.usefixtures("leaves_none")
class TestBeginning:
    def test_a_refusal_arrives_as_such_and_leaves_no_process(self) -> None:
        with pytest.raises(UserError, match=r"^no room for 2 vehicles$"):
            WorkerSimulator(refuses, 4, 2)

    def test_an_error_arrives_with_its_traceback_and_leaves_no_process(self) -> None:
        with pytest.raises(RuntimeError, match=r"(?s)^in worker \d of 2:.*in fails_to_begin.*no such vehicle"):
            WorkerSimulator(fails_to_begin, 4, 2)

    def test_the_mask_of_signals_is_as_it_was(self) -> None:
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
        with closing(WorkerSimulator(FakeSimulator, 1, 1)):
            assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


@pytest.mark.usefixtures("leaves_none")
class TestEnd:
    def test_close_ends_the_processes_and_takes_notice_of_their_ends(self) -> None:
        fleet = WorkerSimulator(FakeSimulator, 5, 2)
        assert all(state(pid) in ("S", "R") for pid in pids(fleet))
        fleet.close()
        assert all(gone(pid) for pid in pids(fleet))
        assert [process.exitcode for process in fleet._processes] == [0, 0]

    def test_who_does_not_end_by_itself_is_killed(
        self, monkeypatch: pytest.MonkeyPatch, world_of: Callable[..., WorldSpec]
    ) -> None:
        monkeypatch.setattr(workers, "EXIT_TIMEOUT", 0.2)
        fleet = WorkerSimulator(FakeSimulator, 2, 2)
        fleet._send(0, ("reset", worlds_named(world_of, "hang")))
        os.kill(pids(fleet)[1], signal.SIGSTOP)
        fleet.close()
        assert all(gone(pid) for pid in pids(fleet))
        assert [process.exitcode for process in fleet._processes] == [-signal.SIGKILL] * 2


PROGRAM = """
import sys
from test_workers import ALL_FIVE, FakeSimulator, WorkerSimulator, np, pids

if __name__ == "__main__":
    fleet = WorkerSimulator(FakeSimulator, 5, 2)
    print(*pids(fleet), flush=True)
    for line in sys.stdin:
        fleet.advance(np.zeros(5), ALL_FIVE)
        print("done", flush=True)
    fleet.close()
"""


@pytest.fixture
def program(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], list[int]]]:
    """A program of its own, like one that a user runs, with two workers: it, and their process ids.

    Each line that it is sent makes the vehicles drive.
    """
    (tmp_path / "program.py").write_text(PROGRAM)
    path = os.pathsep.join((str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")))
    environment = os.environ | {"PYTHONPATH": path}
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "program.py")],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        children: list[int] = []
        try:
            assert process.stdout
            children += [int(word) for word in process.stdout.readline().split()]
            assert len(children) == 2
            yield process, children
        finally:
            process.kill()
            for child in children:
                with suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)


class TestProgram:
    def test_workers_end_with_a_parent_that_is_killed(self, program: tuple[subprocess.Popen[str], list[int]]) -> None:
        process, children = program
        process.kill()
        process.wait(LIMIT)
        wait_for(lambda: all(state(child) in ("", "Z") for child in children))
        assert process.stderr
        assert process.stderr.read() == ""

    def test_ctrl_c_does_not_end_workers(self, program: tuple[subprocess.Popen[str], list[int]]) -> None:
        process, children = program
        for child in children:
            os.kill(child, signal.SIGINT)
        out, err = process.communicate("drive\ndrive\n", timeout=LIMIT)
        assert err == ""
        assert out == "done\ndone\n"
        assert process.returncode == 0
