"""Reads mutated files of every class: each is read, or refused in one line, and nothing else happens.

By hand: python tests/fuzz/fuzz.py --inputs 10000 --seed 0 [--only worlds,policies]
"""

import argparse
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from random import Random
from types import FrameType

from mutators import bytes_changed
from targets import Target, targets

from nnql_bullet.errors import UserError

MOST_SECONDS = 10.0
"""Longest time that an input may take [s]."""
MOST_MEMORY = 4_000_000_000
"""Memory beyond what is in use that an input may take [bytes]."""


class Hang(BaseException):
    """An input took too long; no reader catches it."""


@contextmanager
def limited() -> Iterator[None]:
    """Limits memory and time, and makes warnings errors."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise Hang

    before, limits = signal.signal(signal.SIGALRM, stop), resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_MEMORY, limits[1]))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        resource.setrlimit(resource.RLIMIT_AS, limits)


def state_of(folder: Path) -> dict[str, tuple[int, int]]:
    """Size and time of every file of a folder."""
    return {
        str(path.relative_to(folder)): (path.stat().st_size, path.stat().st_mtime_ns)
        for path in folder.rglob("*")
        if path.is_file()
    }


def fault_of(target: Target, folder: Path) -> str:
    """What is wrong with reading a folder; empty if it is read, or refused in one line."""
    before, begin = state_of(folder), time.monotonic()
    signal.setitimer(signal.ITIMER_REAL, MOST_SECONDS)
    try:
        target.read(folder)
        fault = ""
    except UserError as error:
        text = str(error)
        fault = "" if text.strip() and text.isprintable() else f"a message that is not one line: {text!r}"
    except Hang:
        fault = f"more than {MOST_SECONDS:g} s: {traceback.format_exc()[-1500:]}"
    except Exception:
        fault = traceback.format_exc()[-3000:]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    if time.monotonic() - begin > MOST_SECONDS and not fault:
        fault = f"more than {MOST_SECONDS:g} s"
    return fault or ("" if state_of(folder) == before else "files are written by a reader")


def faults(target: Target, name: str, inputs: int, seed: int, scratch: Path) -> Iterator[tuple[int, str]]:
    """Changes one file of a class at a time; yields the number of each input that fails, and what was wrong."""
    folder = scratch / name.replace("/", "_")
    shutil.copytree(target.folder, folder, dirs_exist_ok=True)
    target.read(folder)  # what it compiles and imports is no time of an input
    for number in range(inputs):
        random = Random(f"{name} {seed} {number}")
        file = random.choice(list(target.files))
        valid = (target.folder / file).read_bytes() if (target.folder / file).exists() else b""
        (folder / file).write_bytes(_changed(target, file, valid, random))
        fault = fault_of(target, folder)
        if fault:
            yield number, f"{file}: {fault}"
        (folder / file).write_bytes(valid)


def _changed(target: Target, file: str, valid: bytes, random: Random) -> bytes:
    """The file, changed after its kind, or by its bytes where that makes nothing that can be written."""
    with warnings.catch_warnings(), suppress(Exception):
        warnings.simplefilter("ignore")
        return target.files[file](valid, random)
    return bytes_changed(valid, random)


def main() -> int:
    """Fuzzes by hand."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1000, help="of each class")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="classes, with commas")
    parser.add_argument("--show", type=int, default=5, help="faults of each class that are printed whole")
    given = parser.parse_args()
    failed = 0
    with tempfile.TemporaryDirectory() as home:
        made = targets(Path(home) / "valid")
        for name in given.only.split(",") if given.only else made:
            begin, kinds = time.monotonic(), dict[str, int]()
            with limited():
                for number, fault in faults(made[name], name, given.inputs, given.seed, Path(home) / "scratch"):
                    kind = fault.strip().rpartition("\n")[2][:100]
                    kinds[kind] = kinds.get(kind, 0) + 1
                    if kinds[kind] == 1 and len(kinds) <= given.show:
                        print(f"{name}, seed {given.seed}, input {number}: {fault}", file=sys.stderr)
            failed += sum(kinds.values())
            print(f"{name}: {given.inputs} inputs, {sum(kinds.values())} faults, {time.monotonic() - begin:.0f} s")
            for kind, count in sorted(kinds.items(), key=lambda item: -item[1]):
                print(f"  {count}  {kind}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
