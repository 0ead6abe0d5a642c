"""Installs a wheel of the package on every other Python of this machine, and tries it there.

PyTorch is left out: from CPython 3.12 on its default build is large. So this also shows what needs no PyTorch.

    python scripts/pythons.py [--keep FOLDER] [3.12 3.13 ...]
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from shutil import which

ROOT = Path(__file__).parents[1]
SUPPORTED = ("3.10", "3.11", "3.12", "3.13", "3.14")
EXTRAS = ("mujoco",)
DRIVE = ("drive", "straight", "--world", "cover_10", "--seed", "4")
SMOKE = (
    ("--version",),
    ("doctor",),
    (*DRIVE, "--sim", "kinematic", "--out", "kinematic"),
    (*DRIVE, "--sim", "mujoco", "--shield", "--out", "mujoco"),
    ("train", "--agent.kind", "q_table", "--sim", "kinematic", "--episodes", "20", "--out", "run"),
    ("render", "mujoco/trajectory.npz", "--size", "320x180", "--fps", "2"),
)
"""What is run on each Python."""
SMOKE_BULLET = (
    (*DRIVE, "--out", "bullet"),
    ("render", "bullet/trajectory.npz", "--size", "320x180", "--fps", "2"),
)
"""What is run where PyBullet has wheels, besides."""


def main() -> int:
    """Tries all Pythons; 0 if all of them are well."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("versions", nargs="*", help="such as 3.12; default: all but the one that runs this")
    parser.add_argument("--keep", type=Path, help="folder for the environments, which stay; default: a temporary one")
    asked = parser.parse_args()
    here = f"{sys.version_info.major}.{sys.version_info.minor}"
    versions = asked.versions or [version for version in SUPPORTED if version != here]
    failed = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = (asked.keep or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT)
        (wheel,) = folder.glob("*.whl")
        for version in versions:
            python = found(version)
            if python is None:
                print(f"{version}  not on this machine", flush=True)
                continue
            try:
                tried(install(python, folder / version, wheel), folder / f"{version}-out", version)
                print(f"{version}  well", flush=True)
            except subprocess.CalledProcessError as error:
                failed.append(version)
                print(f"{version}  FAILED: {' '.join(map(str, error.cmd))}\n{error.stdout}", flush=True)
    return 1 if failed else 0


def found(version: str) -> str | None:
    """The path of a Python that starts: of the search path, or of pyenv's folder."""
    kept = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
    for candidate in [which(f"python{version}"), *map(str, kept)]:
        if candidate and subprocess.run([candidate, "--version"], capture_output=True).returncode == 0:
            return candidate
    return None


def install(python: str, folder: Path, wheel: Path) -> Path:
    """Makes an environment with the package and all that it needs but PyTorch; the path of its Python."""
    run(python, "-m", "venv", "--clear", folder)
    pip = (folder / "bin/python", "-m", "pip", "--disable-pip-version-check")
    constraints = folder / "constraints.txt"
    pins = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    constraints.write_text("\n".join(its for its in pins if not its.startswith("torch==")), encoding="utf-8")
    run(*pip, "install", "--quiet", "--constraint", constraints, "packaging")
    needed = run(folder / "bin/python", "-c", NEEDED, wheel, *EXTRAS).splitlines()
    run(*pip, "install", "--quiet", "--constraint", constraints, *needed)
    run(*pip, "install", "--quiet", "--no-deps", wheel)
    return folder / "bin/python"


NEEDED = """
import sys, zipfile
from email.parser import Parser
from packaging.requirements import Requirement
wheel, *extras = sys.argv[1:]
with zipfile.ZipFile(wheel) as archive:
    (name,) = [its for its in archive.namelist() if its.endswith(".dist-info/METADATA")]
    metadata = Parser().parsestr(archive.read(name).decode())
for text in metadata.get_all("Requires-Dist"):
    its = Requirement(text)
    if its.name != "torch" and any(not its.marker or its.marker.evaluate({"extra": extra}) for extra in ["", *extras]):
        its.marker = None
        print(its)
"""
"""A program that prints what a wheel needs on the Python that runs it."""


def tried(python: Path, folder: Path, version: str) -> None:
    """Runs the smoke test in a folder of its own."""
    folder.mkdir(exist_ok=True)
    for arguments in smoke(version):
        run(python, "-m", "nnql_bullet", *arguments, folder=folder)


def smoke(version: str) -> Iterator[Sequence[str]]:
    """The arguments of each run."""
    yield from SMOKE
    if version != "3.14":
        yield from SMOKE_BULLET


def run(*command: str | Path, folder: Path | None = None) -> str:
    """Runs a command; what it prints.

    Raises:
        CalledProcessError: If it fails.
    """
    done = subprocess.run(
        list(map(str, command)), cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=True
    )
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
