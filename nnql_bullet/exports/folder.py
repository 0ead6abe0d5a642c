"""The folder of an exported policy: artefact, contract, test vectors, example and README."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Literal

from nnql_bullet import __version__
from nnql_bullet.errors import UserError
from nnql_bullet.exports.c99 import c_files, rendered
from nnql_bullet.exports.contract import Contract, contract_of
from nnql_bullet.exports.names import (
    C_EXAMPLE,
    C_POLICY,
    C_POLICY_HEADER,
    C_SHIELD,
    C_SHIELD_HEADER,
    ONNX_EXAMPLE,
    ONNX_MODEL,
    ST_EXAMPLE,
    ST_POLICY,
    ST_XML,
)
from nnql_bullet.exports.onnx_graph import OPSET, onnx_model
from nnql_bullet.exports.shielded import in_shield, shield_files, without_shield
from nnql_bullet.exports.structured_text import block_name, st_files
from nnql_bullet.exports.vectors import recorded_drives, vectors_of
from nnql_bullet.files import staged, write_atomically, write_text
from nnql_bullet.locks import LOCK, locked
from nnql_bullet.runs import LoadedPolicy

Form = Literal["c", "onnx", "st"]
INDEX, SCHEMA, TABLES, VECTORS, README = (
    "export.json",
    "contract.schema.json",
    "contract.md",
    "vectors.csv",
    "README.md",
)
_ABOUT = {
    SCHEMA: "JSON schema of one decision",
    TABLES: "the same as tables: order, units, ranges, rates, what to do when a sensor is silent",
    VECTORS: "inputs and outputs recorded in drives",
    INDEX: "what was exported, and the hash of each file",
}


@dataclass(frozen=True)
class Export:
    """A policy that was exported."""

    folder: Path
    form: Form
    contract: Contract
    files: Mapping[str, str]
    """What each file is, by name."""
    cost: str
    """Operations and stack of a decision in the worst case; empty if they are not known."""
    decisions: int
    """Number of the test vectors."""

    def text(self) -> str:
        """A few lines."""
        lines = [f"{self.folder / name}: {about}" for name, about in self.files.items()]
        return "\n".join([*lines, *([f"a decision: {self.cost}"] if self.cost else []), f"{self.decisions} vectors"])


def write_export(policy: LoadedPolicy, form: Form, folder: Path, with_shield: bool = False) -> Export:
    """Writes a policy into a new folder, or an empty one.

    Args:
        policy: The policy.
        form: What it is written as.
        folder: Where.
        with_shield: Whether it is written in its shield, or in the usual one.

    Raises:
        UserError: If the policy cannot be exported so, or the folder has files in it.
    """
    if with_shield:
        policy = in_shield(policy)
    contract = contract_of(policy, graph=form == "onnx")
    artefact = _FORMS[form](policy, contract)
    with locked(folder):
        if any(its.name != LOCK for its in folder.iterdir()):
            raise UserError(f"{folder}: has files in it; give another folder")
        return _write(policy, contract, form, artefact, folder)


def _write(policy: LoadedPolicy, contract: Contract, form: Form, artefact: "_Artefact", folder: Path) -> Export:
    experiment = policy.experiment
    write, about, title, usage, cost = artefact
    drives = recorded_drives(experiment)
    vectors = vectors_of(contract, experiment, drives)
    files = about | _ABOUT
    values = {
        **{"contract": contract, "version": __version__, "title": title, "files": files, "drives": len(drives)},
        **{"usage": usage, "nearest": experiment.config.task.sector_reading == "nearest"},
        **{"drive": experiment.config.drive, "limits": experiment.vehicle.limits},
    }
    with staged(folder, INDEX) as out:
        write(out)
        write_text(out / SCHEMA, contract.json_schema())
        write_text(out / TABLES, contract.markdown())
        write_text(out / VECTORS, vectors.csv())
        write_text(out / README, rendered("README.md.j2", values))
        hashes = {its.name: sha256(its.read_bytes()).hexdigest() for its in sorted(out.iterdir())}
        index = {"policy": policy.name, "kind": contract.kind, "form": form, "version": __version__, "cost": cost}
        write_text(out / INDEX, json.dumps(index | {"files": hashes}, indent=1) + "\n")
    return Export(folder, form, contract, files, cost, len(vectors.inputs))


_Artefact = tuple[Callable[[Path], None], dict[str, str], str, str, str]
"""Writes the artefact into a folder; what its files are; title, usage, and cost of a decision."""


def _writer(files: Mapping[str, str]) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        for name, text in files.items():
            write_text(folder / name, text)

    return write


def _as_c(policy: LoadedPolicy, contract: Contract) -> _Artefact:
    alone = without_shield(policy)
    files, cost = c_files(contract_of(alone), alone.experiment)
    about = {C_POLICY: "the policy", C_POLICY_HEADER: "its interface", C_EXAMPLE: "a main program that calls it"}
    if contract.shielded:
        more, cost = shield_files(contract, policy.experiment, cost)
        files |= more
        about |= {C_SHIELD: "the shield, which calls the policy", C_SHIELD_HEADER: "the interface of both"}
    sources = " ".join(its for its in files if its.endswith(".c"))
    parts = {"the shield": contract.shielded, "the map": contract.kind == "double_dqn"}
    exact = " and ".join(part for part, there in parts.items() if there)
    precision = f"double precision in {exact}, single in the rest" if exact else "single precision"

    usage = (
        f"    cc -std=c99 -O2 -o example {sources} -lm && ./example\n\n"
        f"No allocation, no recursion, fixed sizes, no library but math.h; {precision}.\n"
        f"A decision takes at most: {cost.text()}.\n"
        "Compile with `-fstack-usage` to see what your compiler makes of that."
    )
    return _writer(files), about, "C99", usage, cost.text()


def _as_st(policy: LoadedPolicy, contract: Contract) -> _Artefact:
    files, cost = st_files(contract, policy.experiment)

    about = {ST_POLICY: "the function block and what it calls", ST_XML: "the same as PLCopen XML"}
    about |= {ST_EXAMPLE: "a program that calls it"}
    usage = (
        f"Import `{ST_XML}` into your development system, or compile `{ST_POLICY}`, and call the function block\n"
        f"`{block_name(contract)}` once every {contract.decision_period:g} s, as `{ST_EXAMPLE}` does.\n"
        "Arrays are fixed, loops are bounded, nothing recurses, and only standard functions are called. It takes the\n"
        "third edition of IEC 61131-3: `CONTINUE`, and functions with outputs. What the contract calls `action` is\n"
        "`decision` there, because ACTION is a keyword.\n"
        f"A decision takes at most: {cost.operations.text()}."
    )
    return _writer(files), about, "Structured Text (IEC 61131-3)", usage, cost.operations.text()


def _as_onnx(policy: LoadedPolicy, contract: Contract) -> _Artefact:
    if contract.shielded:
        raise UserError(f"{policy.name}: a shield cannot be written in ONNX; it can in C and Structured Text")
    model = onnx_model(contract, policy.experiment)
    example = rendered(f"{ONNX_EXAMPLE}.j2", {"contract": contract, "model": ONNX_MODEL})

    def write(folder: Path) -> None:
        write_atomically(folder / ONNX_MODEL, lambda path: path.write_bytes(model))
        write_text(folder / ONNX_EXAMPLE, example)

    about = {ONNX_MODEL: "the policy", ONNX_EXAMPLE: "runs it over the test vectors in ONNX Runtime"}
    usage = (
        f"    pip install onnxruntime && python {ONNX_EXAMPLE}\n\n"
        f"Opset {OPSET}. Every input and output has a leading n: it decides for n vehicles at once. The inputs are\n"
        "single precision. `status` is one output more than the contract's: what is bad about the input, or 0."
    )
    return write, about, "ONNX", usage, ""


_FORMS: dict[Form, Callable[[LoadedPolicy, Contract], _Artefact]] = {
    "c": _as_c,
    "onnx": _as_onnx,
    "st": _as_st,
}
