"""Executors: the same outcomes everywhere, errors told by index, and nothing left running."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import pytest

from nnql_bullet.errors import UserError
from nnql_bullet.executors import Executor, Outcome, RayExecutor, make_executor
from nnql_bullet.seeding import Stream, rng

T = TypeVar("T")

LIMIT = 60.0
"""Seconds after which a wait is given up: far more than a noisy machine needs."""


@dataclass(frozen=True)
class Job:
    seed: int
    folder: Path = Path()


class CannotBePickled(Exception):
    def __init__(self) -> None:
        super().__init__("holds a function")
        self.function = lambda: None


class CannotBeUnpickled(Exception):
    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first}\n{second}")


class CannotBeReadBack:
    def __reduce__(self) -> tuple[Any, ...]:
        return raise_value_error, ()


class CannotBeShown(Exception):
    def __str__(self) -> str:
        raise RuntimeError


def raise_value_error() -> None:
    raise ValueError("cannot be read back")


def draw(job: Job) -> list[float]:
    return rng(job.seed, Stream.POLICY).normal(size=3).tolist()


def draw_or_raise(job: Job) -> list[float]:
    errors = {
        1: ValueError("bad world"),
        3: CannotBePickled(),
        4: CannotBeUnpickled("two", "lines"),
        5: CannotBeShown(),
    }
    if job.seed in errors:
        raise errors[job.seed]
    if job.seed == 6:
        sys.exit(3)
    return draw(job)


def draw_or_die(job: Job) -> list[float]:
    (job.folder / f"{job.seed}-{os.getpid()}").touch()
    if job.seed == 1:
        os._exit(3)
    if job.seed == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    if job.seed == 4:
        os._exit(0)
    return draw(job)


def draw_or_sleep(job: Job) -> list[float]:
    """Seed 0 ends when another task sleeps; the names in the folder are process ids."""
    if job.seed == 0:
        wait_for(lambda: any(job.folder.iterdir()))
        return draw(job)
    (job.folder / str(os.getpid())).touch()
    time.sleep(10 * LIMIT)
    return []


def draw_what_cannot_be_sent(job: Job) -> Any:
    return {1: sys.stdout, 2: CannotBeReadBack()}.get(job.seed, job.seed)


def threads_of(text: str) -> tuple[str, str]:
    """Takes and gives what has no seed."""
    return text, os.environ["OMP_NUM_THREADS"]


def meet(job: Job) -> str:
    """The node it ran on, after a task has started on another one too."""
    if job.seed == 2:
        raise ValueError("bad world")
    import ray

    node = str(ray.get_runtime_context().get_node_id())
    (job.folder / node).touch()
    wait_for(lambda: len(list(job.folder.iterdir())) == 2)
    return node


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)


def runs(pid: int) -> bool:
    """Whether there is such a process; one that only waits for the system to take notice of its end is none."""
    try:
        return "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False


def sleepers(folder: Path) -> list[int]:
    return [int(path.name) for path in folder.iterdir()]


def outcomes(executor: Executor, function: Callable[[T], Any], jobs: list[T]) -> list[Outcome[T, Any]]:
    return sorted(executor.map(function, jobs), key=lambda outcome: outcome.index)


@pytest.fixture(scope="module")
def ray() -> Any:
    return pytest.importorskip("ray", reason="needs Ray: pip install 'nnql-bullet[ray]'")


@pytest.fixture(scope="module")
def cluster(ray: Any) -> Iterator[str]:
    """The address of a cluster of two nodes with one CPU each, whose workers can import this module."""
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(Path(__file__).parent))
        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        try:
            cluster.add_node(num_cpus=1)
            yield str(cluster.address)
        finally:
            cluster.shutdown()


@pytest.fixture(params=["inline", "processes", pytest.param("ray", marks=pytest.mark.slow)])
def executor(request: pytest.FixtureRequest) -> Executor:
    """Every executor, with two workers."""
    address = request.getfixturevalue("cluster") if request.param == "ray" else None
    return make_executor(request.param, 2, address)


@pytest.fixture(params=["processes", pytest.param("ray", marks=pytest.mark.slow)])
def outside(request: pytest.FixtureRequest) -> Executor:
    """Every executor that runs tasks in other processes, with two workers."""
    address = request.getfixturevalue("cluster") if request.param == "ray" else None
    return make_executor(request.param, 2, address)


class TestEveryExecutor:
    def test_yields_every_task_once_with_its_value(self, executor: Executor) -> None:
        jobs = [Job(seed) for seed in (5, 3, 5, 0, 8)]
        found = outcomes(executor, draw, jobs)
        assert found == [Outcome(index, job, draw(job), None) for index, job in enumerate(jobs)]

    def test_reports_what_raised_by_its_index_and_finishes_the_others(self, executor: Executor) -> None:
        jobs = [Job(seed) for seed in range(9)]
        found = outcomes(executor, draw_or_raise, jobs)
        assert [outcome.task for outcome in found] == jobs
        assert [outcome.value for outcome in found if not outcome.error] == [draw(Job(seed)) for seed in (0, 2, 7, 8)]
        assert [outcome.index for outcome in found if outcome.error] == [1, 3, 4, 5, 6]
        errors = [outcome.error for outcome in found if outcome.error]
        assert errors[0].message == "ValueError: bad world"
        assert errors[2].message.endswith("CannotBeUnpickled: two lines")
        assert errors[4].message == "SystemExit: 3"
        assert all("in draw_or_raise" in error.traceback for error in errors)
        assert found == outcomes(make_executor("inline", 1), draw_or_raise, jobs)

    def test_has_nothing_to_do_without_tasks(self, executor: Executor) -> None:
        assert outcomes(executor, draw, []) == []

    def test_takes_up_no_more_tasks_than_it_has_workers(self, executor: Executor) -> None:
        taken: list[Job] = []
        tasks = (taken.append(job) or job for job in [Job(seed) for seed in range(10)])
        with closing(executor.map(draw, tasks)) as found:
            next(found)
        assert len(taken) <= 4


class TestOutside:
    def test_a_dying_worker_takes_its_own_task_along_and_no_other(self, outside: Executor, tmp_path: Path) -> None:
        jobs = [Job(seed, tmp_path) for seed in range(6)]
        found = outcomes(outside, draw_or_die, jobs)
        assert [outcome.value for outcome in found if not outcome.error] == [draw(Job(seed)) for seed in (0, 2, 5)]
        errors = {outcome.index: outcome.error.message for outcome in found if outcome.error}
        assert list(errors) == [1, 3, 4]
        assert not any("\n" in message for message in errors.values())
        started = sorted(path.name.partition("-")[0] for path in tmp_path.iterdir())
        assert started == [str(job.seed) for job in jobs], "some task was run twice"

    def test_closing_early_leaves_nothing_running(self, outside: Executor, tmp_path: Path) -> None:
        with closing(outside.map(draw_or_sleep, [Job(seed, tmp_path) for seed in range(5)])) as found:
            assert next(found).index == 0
        # A pool's own thread waits for its process too, and may not yet have taken note that it is gone.
        wait_for(lambda: not multiprocessing.active_children())
        assert sleepers(tmp_path)
        wait_for(lambda: not any(map(runs, sleepers(tmp_path))))

    def test_a_value_that_cannot_be_sent_is_its_tasks_error(self, outside: Executor) -> None:
        found = outcomes(outside, draw_what_cannot_be_sent, [Job(seed) for seed in range(5)])
        assert [outcome.value for outcome in found] == [0, None, None, 3, 4]
        assert found[1].error and "pickle" in found[1].error.traceback
        assert found[2].error

    def test_any_value_is_a_task_and_a_worker_keeps_to_one_core(self, outside: Executor) -> None:
        assert [outcome.value for outcome in outcomes(outside, threads_of, ["a"])] == [("a", "1")]


class TestProcesses:
    @pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
    def test_workers_end_with_their_parent(self, tmp_path: Path, number: signal.Signals) -> None:
        # A shell starts what it puts into the background with Ctrl-C ignored, and children take that over.
        program = f"""
import signal
from pathlib import Path
from test_executors import Job, draw_or_sleep, make_executor

signal.signal(signal.SIGINT, signal.default_int_handler)
list(make_executor("processes", 2).map(draw_or_sleep, [Job(seed, Path({str(tmp_path)!r})) for seed in (1, 2, 3)]))
"""
        environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
        with subprocess.Popen(
            [sys.executable, "-c", program], env=environment, stderr=subprocess.PIPE, start_new_session=True, text=True
        ) as parent:
            try:
                wait_for(lambda: len(sleepers(tmp_path)) == 2)
                (os.killpg if number == signal.SIGINT else os.kill)(parent.pid, number)
                _, stderr = parent.communicate(timeout=LIMIT)
            finally:
                parent.kill()
        assert stderr.count("Traceback") == (1 if number == signal.SIGINT else 0)
        wait_for(lambda: not any(map(runs, sleepers(tmp_path))))
        assert len(sleepers(tmp_path)) == 2


@pytest.mark.slow
class TestRay:
    def test_tasks_run_on_all_nodes_of_a_cluster_and_one_may_fail(self, cluster: str, tmp_path: Path) -> None:
        found = outcomes(make_executor("ray", 2, cluster), meet, [Job(seed, tmp_path) for seed in range(6)])
        nodes = [outcome.value for outcome in found if outcome.index != 2]
        assert len(set(nodes)) == 2
        assert set(nodes) == {path.name for path in tmp_path.iterdir()}
        assert found[2].error and found[2].error.message == "ValueError: bad world"

    def test_uses_the_ray_that_is_connected_and_leaves_it_so(self, ray: Any, cluster: str) -> None:
        ray.init(cluster, log_to_driver=False, logging_level="ERROR")
        try:
            assert [outcome.value for outcome in make_executor("ray", 1).map(draw, [Job(1)])] == [draw(Job(1))]
            assert ray.is_initialized()
        finally:
            ray.shutdown()

    def test_starts_its_own_quietly_and_ends_it(
        self, ray: Any, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
        assert [outcome.value for outcome in make_executor("ray", 1).map(draw, [Job(1)])] == [draw(Job(1))]
        assert not ray.is_initialized()
        assert capfd.readouterr() == ("", "")


class TestRefusals:
    def test_without_ray_says_how_to_get_it(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "ray", None)
        with pytest.raises(UserError, match=r"^Ray is not installed.* pip install 'nnql-bullet\[ray\]'$"):
            RayExecutor(1)

    @pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere", "host:port", "127.0.0.1:99999"])
    def test_address_without_a_cluster(self, ray: Any, address: str) -> None:
        with pytest.raises(UserError, match=f"^no Ray cluster at '{address}'"):
            make_executor("ray", 1, address)

    def test_address_for_another_executor(self) -> None:
        with pytest.raises(UserError, match="takes no address"):
            make_executor("processes", 1, "127.0.0.1:6379")

    def test_no_workers(self) -> None:
        with pytest.raises(UserError, match="at least 1, not 0"):
            make_executor("processes", 0)
