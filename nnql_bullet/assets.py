"""Finds what is shipped by name: robots, worlds and policies, in a checkout and in an installed wheel alike."""

from pathlib import Path

from nnql_bullet.errors import UserError

_PACKAGE = Path(__file__).resolve().parent


def folder(kind: str) -> Path:
    """The folder of the shipped files of a kind ("robots" or "worlds")."""
    in_wheel = _PACKAGE / "_data" / kind
    return in_wheel if in_wheel.is_dir() else _PACKAGE.parent / kind


def find(kind: str, name: str) -> Path:
    """The TOML file that `name` means: an existing path, or the name of a shipped file without its ending.

    Raises:
        UserError: If there is none; the message lists the shipped names.
    """
    shipped = folder(kind) / f"{name}.toml"
    for candidate in (Path(name), shipped):
        if candidate.is_file():
            return candidate
    names = ", ".join(sorted(path.stem for path in folder(kind).glob("*.toml")))
    raise UserError(f"{kind}: there is no file '{name}'; give a path to a TOML file or one of: {names}")


def policies() -> dict[str, Path]:
    """The shipped policies by name: files of weights, with a card of the same name beside each."""
    return {path.stem: path for path in sorted((_PACKAGE / "_data" / "policies").glob("*.safetensors"))}


def card(policy: Path) -> Path:
    """What is known of a shipped policy, as Markdown: a line that says what it is, and then the rest."""
    return policy.with_suffix(".md")
