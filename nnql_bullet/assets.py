"""Finds the shipped robots, worlds and policies, in a checkout and in an installed wheel."""

from pathlib import Path

from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file, real

_PACKAGE = Path(__file__).resolve().parent


def folder(kind: str) -> Path:
    """Returns the folder of the shipped files of a kind ("robots" or "worlds")."""
    in_wheel = _PACKAGE / "_data" / kind
    return in_wheel if in_wheel.is_dir() else _PACKAGE.parent / kind


def find(kind: str, name: str) -> Path:
    """Returns the path of a TOML file.

    Args:
        kind: "robots" or "worlds".
        name: Path of an existing file, or name of a shipped file without its suffix. An existing file comes first.

    Raises:
        UserError: If there is no such file; the message lists the shipped names.
    """
    shipped = folder(kind) / f"{name}.toml"
    for candidate in (Path(name), shipped):
        if is_file(candidate):
            return candidate
    names = ", ".join(sorted(path.stem for path in folder(kind).glob("*.toml")))
    raise UserError(f"{kind}: there is no file '{name}'; give a path to a TOML file or one of: {names}")


def is_shipped(kind: str, path: Path) -> bool:
    """Whether a file is one of the shipped files of a kind."""
    return real(path).parent == real(folder(kind))


def policies() -> dict[str, Path]:
    """Returns the weight files of the shipped policies by name."""
    return {path.stem: path for path in sorted((_PACKAGE / "_data" / "policies").glob("*.safetensors"))}


def card(policy: Path) -> Path:
    """Returns the Markdown file that describes a shipped policy; its first line is a summary."""
    return policy.with_suffix(".md")
