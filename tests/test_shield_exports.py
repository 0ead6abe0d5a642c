"""Policies in their shield in C, and policies in Structured Text, against the policies themselves."""

import re
import shutil
from dataclasses import fields
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import nnql_bullet as nb
from nnql_bullet.errors import UserError
from nnql_bullet.exports.c99 import c_files
from nnql_bullet.exports.contract import contract_of
from nnql_bullet.exports.names import ST_POLICY, ST_XML
from nnql_bullet.exports.parity import Parity, compare
from nnql_bullet.exports.running import LibraryPolicy, build
from nnql_bullet.exports.shielded import in_shield, shield_files, without_shield
from nnql_bullet.exports.structured_text import st_files, st_units
from nnql_bullet.exports.translation import NotTranslatable, Translator, Var
from nnql_bullet.exports.vectors import Vectors, recorded_drives, vectors_of
from nnql_bullet.runs import LoadedPolicy, load_policy
from tests.structured_text import Running
from tests.test_exports import deepest_stack, run

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no C compiler: gcc")
FLAGS = ("-std=c99", "-O0", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wshadow", "-Wconversion")
CONDITIONS: dict[str, dict[str, Any]] = {
    "usual": {},
    "slippery": {"wheel_friction": 0.3, "payload": 80.0},
    "a dead sensor": {"dead_sector": 0},
}


def compiled(policy: LoadedPolicy, folder: Path, flags: tuple[str, ...] = FLAGS) -> LibraryPolicy:
    """A policy in its shield, from C."""
    contract, alone = contract_of(policy), without_shield(policy)
    files, cost = c_files(contract_of(alone), alone.experiment)
    more, _ = shield_files(contract, policy.experiment, cost)
    for name, text in (files | more).items():
        (folder / name).write_text(text)
    return LibraryPolicy(build(folder, folder / "policy.so", flags), contract)


@pytest.fixture(scope="module", params=["paper", "straight", "double_dqn"])
def shielded(request: pytest.FixtureRequest) -> LoadedPolicy:
    return in_shield(load_policy(request.param))


@pytest.fixture(scope="module")
def vectors(shielded: LoadedPolicy) -> Vectors:
    drives = recorded_drives(shielded.experiment, ("traps", "moving"))
    drives = [type(its)(*(getattr(its, field.name)[:60] for field in fields(its))) for its in drives]
    return vectors_of(contract_of(shielded), shielded.experiment, drives)


def test_c_decides_as_the_shield_in_drives_and_stops_on_bad_input(
    shielded: LoadedPolicy, vectors: Vectors, tmp_path: Path
) -> None:
    exported, v = compiled(shielded, tmp_path, (*FLAGS, "-fsanitize=undefined", "-fno-sanitize-recover")), vectors
    text = (tmp_path / "shield.c").read_text()
    assert set(re.findall(r"#include\s+(\S+)", text)) == {'"policy.h"', '"shield.h"', "<math.h>"}
    state = exported.initial_state(1)
    for k in range(len(v.inputs)):
        if k and v.drives[k] != v.drives[k - 1]:
            state = exported.initial_state(1)
        status, outputs, after = exported.decide(v.inputs[k : k + 1], state)
        if v.statuses[k]:
            assert state is not None and after is not None and (after == state).all()
        state = after
        assert (status[0], outputs["action"][0]) == (v.statuses[k], v.actions[k])
        assert outputs["overridden"][0] == v.overridden[k]
        assert outputs["speed_share"][0] == np.float32(v.shares[k])
    assert v.overridden.sum() > 10 or shielded.name != "straight"  # which avoid obstacles themselves


@pytest.mark.parametrize("name", ["paper", "double_dqn"])
def test_c_runs_under_the_address_sanitizer_within_the_stated_stack(name: str, tmp_path: Path) -> None:
    shielded = in_shield(load_policy(name))
    compiled(shielded, tmp_path)
    program, sources = tmp_path / "example", [tmp_path / name for name in ("example.c", "shield.c", "policy.c")]
    run("gcc", *FLAGS, "-fsanitize=address,undefined", "-fno-sanitize-recover", "-o", program, *sources, "-lm")
    assert run(program).count(b"action") == 5
    alone = without_shield(shielded)
    _, policy_cost = c_files(contract_of(alone), alone.experiment)
    _, cost = shield_files(contract_of(shielded), shielded.experiment, policy_cost)
    taken = deepest_stack(tmp_path, "shield.c", "shield_decide", "-O0")
    assert 0.3 * cost.stack < taken <= cost.stack


@pytest.mark.slow
@pytest.mark.parametrize("conditions", CONDITIONS)
@pytest.mark.parametrize("name", ["paper", "straight", "double_dqn"])
def test_c_decides_as_the_shield_in_many_drives(name: str, conditions: str, tmp_path: Path) -> None:
    policy, total = in_shield(load_policy(name, {"conditions": CONDITIONS[conditions]})), Parity()
    exported = compiled(policy, tmp_path)
    for drive in recorded_drives(policy.experiment, seeds=range(2)):
        total += compare(policy.experiment, exported, drive)
    assert total.states > 1700 and total.unexplained == 0


def test_structured_text_decides_as_the_shield(shielded: LoadedPolicy, vectors: Vectors, tmp_path: Path) -> None:
    if shielded.name == "double_dqn":
        pytest.skip("it is not written in Structured Text")
    files, _ = st_files(contract_of(shielded), shielded.experiment)
    assert_decides(Running(files[ST_POLICY], tmp_path), vectors)


def test_structured_text_decides_as_the_network(tmp_path: Path) -> None:
    policy = load_policy("paper")
    contract = contract_of(policy)
    drives = recorded_drives(policy.experiment, ("traps", "cover_20"))
    files, _ = st_files(contract, policy.experiment)
    assert_decides(Running(files[ST_POLICY], tmp_path), vectors_of(contract, policy.experiment, drives))


def assert_decides(running: Running, v: Vectors) -> None:
    """Whether the block decides as recorded."""
    d = v.contract.distances
    names = [signal.name for signal in v.contract.inputs[1:]]
    for k in range(len(v.inputs)):
        if k and v.drives[k] != v.drives[k - 1]:
            running.reset()
        row = v.inputs[k]
        out = running(distances=row[:d], **dict(zip(names, row[d:], strict=True)))
        assert int(out["status"]) == v.statuses[k]
        assert int(out["decision"]) == v.actions[k] or abs(out["heading_change"] - v.turns[k]) < 1e-6
        assert abs(out["speed_share"] - v.shares[k]) < 1e-6
        if "values" in (out.dtype.names or ()) and not v.statuses[k]:
            assert np.abs(out["values"] - v.values[k]).max() <= 1e-5 * np.abs(v.values[k]).max()


def test_xml_has_the_same_declarations() -> None:
    policy = in_shield(load_policy("straight"))
    contract = contract_of(policy)
    files, _ = st_files(contract, policy.experiment)
    units, _ = st_units(contract, policy.experiment)
    project = ElementTree.fromstring(files[ST_XML])
    names = {"p": "http://www.plcopen.org/xml/tc6_0201"}
    pous = {pou.get("name"): pou for pou in project.iterfind(".//p:pou", names)}
    types = {its.get("name") for its in project.iterfind(".//p:dataType", names)}
    assert [*types, *pous] and types | set(pous) == {unit.name for unit in units}
    for unit in units:
        if unit.kind == "type":
            continue
        body = pous[unit.name].findtext(".//{http://www.w3.org/1999/xhtml}xhtml") or ""
        assert body.strip() and body.strip() in unit.text
        declared = re.findall(r"(\w+) : ", "".join(re.findall(r"^VAR.*?END_VAR", unit.text, re.S | re.M)))
        assert [its.get("name") for its in pous[unit.name].iterfind(".//p:variable", names)] == declared


def test_a_parser_of_structured_text_takes_it() -> None:
    parse = pytest.importorskip("blark.parse")
    policy = load_policy("paper")
    units, _ = st_units(contract_of(policy), policy.experiment)
    for unit in units:
        shortened = re.sub(r":= \[([^,\]]*, [^,\]]*)[^\]]*\]", r":= [\1]", unit.text)  # it is slow
        if unit.kind != "function" or len(shortened) < 900:
            assert parse.parse_source_code(shortened).exception is None, unit.name


@pytest.mark.slow
def test_a_parser_of_structured_text_takes_the_shield() -> None:
    parse, policy = pytest.importorskip("blark.parse"), in_shield(load_policy("straight"))
    units, _ = st_units(contract_of(policy), policy.experiment)
    for unit in units:
        shortened = re.sub(r":= \[([^,\]]*, [^,\]]*)[^\]]*\]", r":= [\1]", unit.text)
        assert parse.parse_source_code(shortened).exception is None, unit.name


@pytest.mark.parametrize(
    ("policy", "to", "with_shield", "named"),
    [
        ("vfh", "c", True, "remembers its own actions"),
        ("distilled", "c", True, "remembers its own actions"),
        ("double_dqn", "st", True, "kind 'double_dqn' cannot be written in Structured Text"),
        ("paper", "onnx", True, "cannot be written in ONNX"),
        ("fuzzy", "st", False, "kind 'fuzzy' cannot be written in Structured Text"),
        (load_policy("straight", {"shield": {}}), "st", False, "--with-shield"),
    ],
)
def test_what_cannot_be_carried_is_refused_by_name(
    policy: Any, to: Any, with_shield: bool, named: str, tmp_path: Path
) -> None:
    pytest.importorskip("onnx")
    with pytest.raises(UserError, match=named):
        nb.export(policy, to=to, with_shield=with_shield, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def _endless(n: int) -> int:
    total = 0
    for k in range(n):
        total += k
    return total


def test_a_loop_without_a_bound_is_not_translated() -> None:
    with pytest.raises(NotTranslatable, match="without a bound"):
        Translator().translate(_endless, Var("n", "int"))
