"""Kills verbs at every file operation and at random moments: nothing is lost, and what was begun can be ended.

NNQL_KILLS=N strikes every case N times (by default once); NNQL_KILLS=all at every file operation.
"""

import multiprocessing
import os
import random
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import victim
from victim import Blow, Kind

pytestmark = pytest.mark.slow

KILLS = os.environ.get("NNQL_KILLS", "1")
CONFIG = """\
preset = "{preset}"
world = "{world}"
episodes = 3
vehicles = 2
simulator = "{simulator}"

[task]
max_steps = 12
{more}
"""
SELECTION = "[training.selection]\ncandidates = 2\nevery = 1\ncount = 2\n"
KINDS: list[Kind] = ["kill", "term", "int_twice", "term_twice", "hup", "pipe", "full", "read_only"]
INTERRUPTED = 130


@dataclass(frozen=True)
class Case:
    """A verb, and how it is gone on with."""

    first: str
    again: str = ""
    """By default the same."""
    preset: str = "paper"
    simulator: str = "kinematic"
    more: str = ""
    before: tuple[str, ...] = field(default=())
    """What is there when it begins."""


TRAIN = "train --config c.toml --out run --workers 1"
OTHER = "train --config c.toml --out run --workers 1 --seed 5"
CASES = {
    "nnql": Case(TRAIN, "train --resume run"),
    "contact": Case(TRAIN, "train --resume run", simulator="bullet"),
    "workers": Case(TRAIN.replace("1", "2"), "train --resume run", simulator="bullet"),
    "selection": Case(TRAIN, "train --resume run", more=SELECTION),
    "q_table": Case(TRAIN, "train --resume run", preset="q_table"),
    "genetic": Case(TRAIN, "train --resume run", preset="genetic"),
    "double_dqn": Case(TRAIN, "train --resume run", preset="double_dqn"),
    "sb3_dqn": Case(TRAIN, "train --resume run", preset="sb3_dqn"),
    "overwrite": Case(f"{TRAIN} --overwrite", before=(OTHER,)),
    "longer": Case("train --resume run --episodes 5", before=(TRAIN,)),
    "evaluate": Case(
        "evaluate straight vfh --world small.toml --cover 20 --worlds 2 --sim kinematic --executor inline"
    ),
    "ablate": Case("ablate --only hysteresis --seeds 1 --episodes 2 --vehicles 2 --worlds 2 --executor inline"),
    "render": Case(
        "render d/trajectory.npz --size 64x64 --fps 5 --end 2 --workers 1 --out d/film.mp4 --sheet d/sheet.png",
        before=("drive straight --world small.toml --sim kinematic --out d",),
    ),
    "report": Case("report run", before=(TRAIN,)),
    "fidelity": Case("fidelity --physics fast --out fidelity", before=("fidelity --sim bullet --out fidelity",)),
}


@pytest.fixture(scope="module")
def strike(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., int]]:
    """Runs a verb in a fork of a process that has imported everything; returns its exit code."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["victim"])
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(Path(__file__).parent), os.getenv("PYTHONPATH")]))

    def run(verb: str, place: Path, blow: Blow, after: float | None = None) -> int:
        for name in ("work", "tmp"):
            (place / name).mkdir(parents=True, exist_ok=True)
        process = context.Process(target=victim.run, args=(verb.split(), place, blow))
        process.start()
        if after is not None:
            time.sleep(after)
            process.kill()
        process.join(300)
        assert process.exitcode is not None, f"{verb}: hangs"
        return process.exitcode

    yield run


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else b"" for path in folder.rglob("*")}


def points(total: int, draw: random.Random) -> list[Blow]:
    """Blows at file operations: every one, or some in equal distances, of each kind in turn."""
    if KILLS == "all":
        return [Blow("kill", number) for number in range(1, total + 1)]
    kinds = [*KINDS, *(["kill"] * len(KINDS))]
    draw.shuffle(kinds)
    count = int(KILLS)
    return [
        Blow(kinds[i % len(kinds)], 1 + int((i + draw.random()) * total / count) % total)  # one in each share
        for i in range(count)
    ]


def went_on(strike: Callable[..., int], case: Case, place: Path, wanted: dict[str, bytes]) -> None:
    """Asserts that the verb ends as if it had never been struck, and is never told to overwrite nothing."""
    begun = (place / "work" / "run" / "config.toml").exists()
    verb = case.again if case.again and begun else case.first
    code = strike(verb, place, Blow("none"))
    assert code == 0, (place / "log").read_text()
    found = files(place / "work")
    assert found.keys() == wanted.keys()
    assert [name for name in wanted if found[name] != wanted[name]] == []


def overwritten_whole_or_not_at_all(
    strike: Callable[..., int], place: Path, old: dict[str, bytes], new: dict[str, bytes]
) -> None:
    """Asserts that after an `--overwrite` that was struck, plain commands give the old or the new run, no mixture."""
    code = strike(TRAIN, place, Blow("none"))
    if code:
        assert "is not empty; resume the run there" in (place / "log").read_text()
        assert strike("train --resume run", place, Blow("none")) == 0, (place / "log").read_text()
    assert files(place / "work") in ([new] if code == 0 else [old, new])


@pytest.mark.parametrize("name", CASES)
def test_whatever_strikes_it_can_be_gone_on_with(
    name: str, strike: Callable[..., int], tmp_path: Path, small_world: Path, record_property: Callable[..., None]
) -> None:
    case, draw = CASES[name], random.Random(name)
    start = tmp_path / "start"
    (start / "work").mkdir(parents=True)
    shutil.copy(small_world, start / "work" / "small.toml")
    text = CONFIG.format(preset=case.preset, world="small.toml", simulator=case.simulator, more=case.more)
    (start / "work" / "c.toml").write_text(text)
    for verb in case.before:
        assert strike(verb, start, Blow("none")) == 0, (start / "log").read_text()
    place = Path(shutil.copytree(start, tmp_path / "whole"))
    begin = time.monotonic()
    assert strike(case.first, place, Blow("none")) == 0, (place / "log").read_text()
    duration = time.monotonic() - begin
    wanted, total = files(place / "work"), int((place / "count").read_text())
    tried = 0
    for blow in points(total, draw):
        place = Path(shutil.copytree(start, tmp_path / f"{blow.operation}-{blow.kind}"))
        code = strike(case.first, place, blow)
        told = (place / "log").read_text()
        tried += 1
        context = f"{name}: {blow} of {total}: exit {code}\n{told}"
        if blow.kind == "kill":
            assert code == -signal.SIGKILL, context
        else:
            assert "Traceback" not in told, context
            expected = {0, 2} if blow.kind in ("full", "read_only") else {0, INTERRUPTED, 128 + signal.SIGPIPE}
            assert code in expected, context
            assert list((place / "tmp").iterdir()) == [], context
            left = [path for path in files(place / "work") if ".writing-" in path or path.endswith(".lock")]
            assert blow.kind == "read_only" or "twice" in blow.kind or left == [], context
        try:
            if name == "overwrite":
                copy = Path(shutil.copytree(place, tmp_path / "copy"))
                overwritten_whole_or_not_at_all(strike, copy, files(start / "work"), wanted)
                shutil.rmtree(copy)
            went_on(strike, case, place, wanted)
        except AssertionError as error:
            raise AssertionError(f"{context}\n{error}") from None
        shutil.rmtree(place)
    for number in range(1 if KILLS == "all" else max(int(KILLS) // 4, 1)):
        place = Path(shutil.copytree(start, tmp_path / f"moment-{number}"))
        strike(case.first, place, Blow("none"), draw.random() * duration)
        tried += 1
        went_on(strike, case, place, wanted)
        shutil.rmtree(place)
    record_property("kills", tried)
    print(f"{name}: {tried} kill points of {total} file operations survived")
