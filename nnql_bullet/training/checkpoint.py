"""Weights with their configuration, as safetensors: a policy to drive with, or a checkpoint to resume from."""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from nnql_bullet import __version__, assets
from nnql_bullet.errors import UserError
from nnql_bullet.files import is_file, parse_json, write_atomically
from nnql_bullet.geometry import Array

POLICY = "policy.safetensors"
"""What a run folder has to drive with."""
FORMAT = "nnql-bullet weights 1"
_METADATA = "nnql-bullet"
"""The only key of a file's metadata: the library writes several in an order that changes from run to run."""


@dataclass(frozen=True, slots=True)
class Weights:
    """The weights of an agent and the training that they come from."""

    config: dict[str, Any]
    """The run's configuration as plain values."""
    episodes: int
    """Training episodes finished."""
    arrays: dict[str, Array]


def policy_file(policy: str | Path) -> Path:
    """Finds the weights of a run folder, of a policy file or of a shipped policy; an existing file comes first.

    Raises:
        UserError: If there is none of that name; the message lists the shipped ones.
    """
    path, shipped = Path(policy), assets.policies()
    if path.is_dir():
        return path / POLICY
    if not os.path.exists(path) and str(policy) not in shipped:
        raise UserError(f"{policy}: no such run or policy file, and no shipped policy; these are: {', '.join(shipped)}")
    return path if os.path.exists(path) else shipped[str(policy)]


def save_weights(weights: Weights, path: Path) -> None:
    """Writes the file atomically; equal weights give equal bytes.

    Raises:
        OSError: If it cannot be written; an older file of that name is then untouched.
    """
    metadata = {
        "format": FORMAT,
        "version": __version__,
        "episodes": str(weights.episodes),
        "config": json.dumps(weights.config, sort_keys=True),
    }
    sorted_ = {_METADATA: json.dumps(metadata, sort_keys=True)}
    write_atomically(path, lambda temporary: _save(weights.arrays, temporary, sorted_))


def load_weights(path: Path) -> Weights:
    """Reads the file.

    Raises:
        UserError: If it is missing, damaged, or was not written by this program.
    """
    if not is_file(path):
        raise UserError(f"{path}: there is no such file; train first, or give another run")
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = _metadata(file.metadata() or {})
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
    except (SafetensorError, OSError, ValueError, UserError) as error:
        raise UserError(f"{path}: damaged, or not a safetensors file ({error})".replace("\n", " ")) from None
    if metadata.get("format") != FORMAT:
        raise UserError(f"{path}: not written by this program (its format is {metadata.get('format')!r})")
    try:
        config, episodes = parse_json(metadata["config"], f"{path}: its configuration"), int(metadata["episodes"])
    except (KeyError, ValueError):
        raise UserError(f"{path}: its metadata is damaged") from None
    if not isinstance(config, dict) or episodes < 0:
        raise UserError(f"{path}: its metadata is damaged")
    return Weights(config, episodes, arrays)


def _metadata(found: dict[str, str]) -> dict[str, str]:
    """The metadata by their names, which version 0.1 wrote as keys of the file.

    Raises:
        ValueError: If they are damaged.
    """
    metadata = parse_json(found[_METADATA], "its metadata") if _METADATA in found else found
    if not isinstance(metadata, dict) or not all(isinstance(value, str) for value in metadata.values()):
        raise ValueError("its metadata is damaged")
    return metadata


def _save(arrays: dict[str, Array], path: Path, metadata: dict[str, str]) -> None:
    try:
        save_file(arrays, path, metadata)
    except SafetensorError as error:
        raise OSError(str(error)) from None
