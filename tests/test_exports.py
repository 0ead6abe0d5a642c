"""Exported policies against the policies themselves, a C compiler, sanitizers, counters and ONNX's own checker."""

import json
import re
import shutil
import subprocess
from ctypes import CDLL, c_long
from dataclasses import dataclass, fields
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import nnql_bullet as nb
from nnql_bullet.cli import main
from nnql_bullet.env import Observation
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.exports.c99 import c_files
from nnql_bullet.exports.contract import Contract, contract_of
from nnql_bullet.exports.cost import Cost, Operations
from nnql_bullet.exports.folder import write_export
from nnql_bullet.exports.maps import map_of
from nnql_bullet.exports.parity import Parity, compare
from nnql_bullet.exports.running import LibraryPolicy, OnnxMapPolicy, OnnxPolicy, build
from nnql_bullet.exports.vectors import Vectors, recorded_drives, vectors_of
from nnql_bullet.mapping import grid_map
from nnql_bullet.presets import load_config
from nnql_bullet.rollout import run_episodes
from nnql_bullet.run_config import changed
from nnql_bullet.runs import LoadedPolicy, load_policy

HERE = Path(__file__).with_name("exports")
KINDS = (
    "paper",
    "genetic",
    "q_table",
    "distance",
    "straight",
    "hand_rule",
    "fuzzy",
    "potential_field",
    "vfh",
    "look_ahead",
)
KINDS += ("paper of another robot", "vfh of another robot", "potential_field of another robot")
NETWORKS = ("paper", "genetic", "q_table", "distance")
FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic")
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no C compiler: gcc")
needs_cpp = pytest.mark.skipif(shutil.which("g++") is None, reason="there is no C++ compiler: g++")


def policy_of(kind: str) -> LoadedPolicy:
    """A shipped policy or a rule; of the other kinds one with random weights, or a random table."""
    if kind.endswith(" of another robot"):
        conditions = {"rays": 180, "sensor_range": 6.0, "blind_arc_degrees": (150.0, 210.0)}
        return load_policy(kind.split()[0], {"robot": "jackal_tricycle", "conditions": conditions})
    if kind in ("paper", "straight", "hand_rule", "fuzzy", "potential_field", "vfh", "look_ahead"):
        return load_policy(kind)
    config = load_config("paper" if kind == "distance" else kind, {})
    if kind == "distance":
        config = changed(config, agent={"encoding": "distance", "hidden_units": 9, "output_weights": 1.0})
    experiment = Experiment(config)
    if kind == "q_table":
        values = np.random.default_rng(1).normal(size=(27, 5))
        experiment.trainable.load_state_dict({"states": np.arange(27), "values": values})
    return LoadedPolicy(kind, experiment, 1)


@dataclass(frozen=True)
class Case:
    """A policy in C, and what it is held against."""

    policy: LoadedPolicy
    contract: Contract
    folder: Path
    cost: Cost
    vectors: Vectors

    @property
    def fed(self) -> bytes:
        """The vectors as the programs beside this test read them."""
        begins = np.diff(self.vectors.drives, prepend=-2) != 0
        return b"".join(
            np.int32(b).tobytes() + row.tobytes() for b, row in zip(begins, self.vectors.inputs, strict=True)
        )

    @property
    def memory(self) -> list[str]:
        return ["-DWITH_MEMORY"] if self.contract.memory else []


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Case]:
    made = {}
    drives = {
        kind: recorded_drives(policy_of(kind).experiment, ("traps", "cover_20"))
        for kind in ("paper", "paper of another robot")
    }
    for kind in KINDS:
        policy, folder = policy_of(kind), tmp_path_factory.mktemp(kind.partition(" ")[0])
        contract = contract_of(policy)
        files, cost = c_files(contract, policy.experiment)
        for name, text in files.items():
            (folder / name).write_text(text)
        seen = drives["paper of another robot" if "robot" in kind else "paper"]
        if contract.memory:  # where another policy drives, its reckoned heading is no longer the vehicle's
            seen = recorded_drives(policy.experiment, ("traps", "cover_20"))
        made[kind] = Case(policy, contract, folder, cost, vectors_of(contract, policy.experiment, seen))
    return made


@pytest.fixture(params=KINDS)
def case(request: pytest.FixtureRequest, cases: dict[str, Case]) -> Case:
    return cases[request.param]


def run(*command: Any, **options: Any) -> bytes:
    answer = subprocess.run([str(its) for its in command], capture_output=True, **options)
    assert answer.returncode == 0, answer.stderr.decode()
    return answer.stdout


def deepest_stack(folder: Path, source: str, function: str, level: str) -> int:
    """Stack of the deepest calls within a source that begin with a function, by gcc [bytes]."""
    run("gcc", "-std=c99", level, "-fcallgraph-info=su", "-c", source, cwd=folder)
    text = (folder / source).with_suffix(".ci").read_text()
    sizes = {name: int(size) for name, size in re.findall(r'title: "([^"]+)" label: "[^"]*?(\d+) bytes', text)}
    calls = re.findall(r'sourcename: "([^"]+)" targetname: "([^"]+)"', text)

    def deepest(name: str) -> int:
        below = [deepest(callee) for caller, callee in calls if caller == name and callee in sizes]
        return 16 + sizes[name] + max(below, default=0)

    return deepest(function)


def library(case: Case) -> LibraryPolicy:
    file = case.folder / "policy.so"
    return LibraryPolicy(file if file.exists() else build(case.folder, file), case.contract)


def model(case: Case) -> OnnxPolicy:
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from nnql_bullet.exports.onnx_graph import onnx_model

    file = case.folder / "policy.onnx"
    file.write_bytes(onnx_model(case.contract, case.policy.experiment))
    return OnnxPolicy(file, case.contract)


@needs_gcc
class TestC:
    """The generated source."""

    def test_compiles_without_a_warning_and_does_as_recorded_under_sanitizers(self, case: Case) -> None:
        program = case.folder / "feed"
        flags = [*FLAGS, "-Wshadow", "-Wconversion", "-fsanitize=address,undefined", "-fno-sanitize-recover"]
        sources = (HERE / "feed.c", case.folder / "policy.c")
        run("gcc", *flags, "-g", *case.memory, f"-I{case.folder}", "-o", program, *sources, "-lm")
        outputs = LibraryPolicy(build(case.folder, case.folder / "policy.so"), case.contract)._outputs
        layout = np.dtype([("status", np.int32), ("output", outputs)])
        given = np.frombuffer(run(program, input=case.fed), layout)
        v = case.vectors
        assert given["status"].tolist() == v.statuses.tolist()
        out = given["output"]
        same = (out["action"] == v.actions) | (np.abs(out["heading_change"] - v.turns) < 1e-6)
        assert same.all()
        assert out["speed_share"].tolist() == (v.statuses == 0).tolist()
        if "safe" in outputs.fields:
            assert (out["safe"] == v.safe).all()
        if case.contract.has_values:
            assert (np.abs(out["values"] - v.values).max(1) <= 1e-5 * np.abs(v.values).max(1)).all()

    def test_example_runs(self, case: Case) -> None:
        program = case.folder / "example"
        run("gcc", *FLAGS, "-o", program, case.folder / "example.c", case.folder / "policy.c", "-lm")
        assert run(program).count(b"action") == 5

    def test_uses_nothing_but_the_mathematical_library(self, case: Case) -> None:
        text = (case.folder / "policy.c").read_text()
        assert set(re.findall(r"#include\s+(\S+)", text)) == {'"policy.h"', "<math.h>"}
        run("gcc", *FLAGS, "-c", "-o", case.folder / "policy.o", case.folder / "policy.c")
        needed = re.findall(rb" U (\w+)", run("nm", case.folder / "policy.o"))
        mathematical = "exp atan2 cos sin sincos asin sqrt ceil floor fmin fmax"
        assert set(needed) <= {f"{name}f".encode() for name in mathematical.split()} | {b"memset", b"__stack_chk_fail"}

    def test_stated_stack_holds_the_deepest_calls(self, case: Case) -> None:
        for level in ("-O0", "-O2"):
            taken = deepest_stack(case.folder, "policy.c", "policy_decide", level)
            assert 16 < taken <= case.cost.stack
            assert level == "-O2" or taken > 0.3 * case.cost.stack

    @needs_cpp
    def test_stated_operations_are_the_most_that_are_counted(self, case: Case) -> None:
        program, o = case.folder / "count", case.cost.operations
        run("g++", "-w", "-fpermissive", *case.memory, f"-I{case.folder}", "-o", program, HERE / "count.cpp")
        counted = np.array(run(program, input=case.fed).split(), int)
        stated = np.array([o.additions, o.multiplications, o.divisions, o.comparisons, o.functions])
        assert (counted <= stated).all()
        if case.policy.name not in (
            "vfh",
            "potential_field",
            "look_ahead",
            "distance",
        ):  # theirs depend on where obstacles are
            assert (counted >= stated - [1, 0, 0, 3, 0]).all()

    def test_drives_as_the_policy_does(self, case: Case) -> None:
        assert_same_endings(case, library(case))


@pytest.mark.parametrize("kind", NETWORKS)
class TestOnnx:
    """The graph."""

    def test_runs_as_recorded(self, kind: str, cases: dict[str, Case]) -> None:
        case, v = cases[kind], cases[kind].vectors
        outputs = model(case).decide(v.inputs)
        for name, expected in (("status", v.statuses), ("action", v.actions), ("safe", v.safe & (v.statuses == 0))):
            assert (outputs[name] == expected).all()
        assert np.abs(outputs["heading_change"] - v.turns).max() < 1e-6
        assert (np.abs(outputs["values"] - v.values).max(1) <= 1e-5 * np.abs(v.values).max(1)).all()

    def test_drives_as_the_policy_does(self, kind: str, cases: dict[str, Case]) -> None:
        assert_same_endings(cases[kind], model(cases[kind]))


@pytest.mark.parametrize("name", ["double_dqn", "distilled"])
def test_a_graph_with_its_map_beside_it_runs_as_recorded_and_drives_as_the_policy_does(
    name: str, tmp_path: Path
) -> None:
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from nnql_bullet.exports.onnx_graph import onnx_model

    policy = load_policy(name)
    contract, e, file = contract_of(policy, graph=True), policy.experiment, tmp_path / "policy.onnx"
    file.write_bytes(onnx_model(contract, e))
    v = vectors_of(contract, e, recorded_drives(e, ("traps",)))
    exported = OnnxMapPolicy(file, contract, map_of(e))
    outputs = exported.decide(v.inputs, v.frames)
    assert (outputs["action"] == v.actions).all() and (outputs["status"] == v.statuses).all()
    assert np.abs(outputs["heading_change"] - v.turns).max() < 1e-6
    assert np.abs(outputs["speed_share"] - v.shares).max() < 1e-6
    steps, bad = (v.drives == 0).sum(), (v.drives < 0).sum()
    assert (outputs["next_frames"][: steps - 1] == v.frames[1:steps]).all()
    assert (outputs["next_frames"][-bad:] == v.frames[-bad:]).all()  # bad input changes no memory
    error, size = np.abs(outputs["values"] - v.values).max(1), np.abs(v.values).max(1)
    assert (error > 1e-5 * size).mean() < 0.05  # a number half-way between two bytes may be rounded to the other one
    assert (error <= 1e-3 * size).all()
    assert_same_endings(Case(policy, contract, tmp_path, Cost(Operations(), 0), v), exported, (7,))


@needs_gcc
@pytest.mark.parametrize("with_map", [True, False])
def test_double_dqn_in_c_does_as_recorded_with_its_own_memory(with_map: bool, tmp_path: Path) -> None:
    policy = load_policy("double_dqn")
    if not with_map:
        config = changed(policy.experiment.config, agent={"grid_map": False, "hidden": (9, 5), "frames": 2})
        policy = LoadedPolicy("without_map", Experiment(config), 1)
    contract, e = contract_of(policy), policy.experiment
    files, cost = c_files(contract, e)
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    flags = (*FLAGS, "-Wshadow", "-Wconversion", "-fsanitize=undefined", "-fno-sanitize-recover")
    exported = LibraryPolicy(build(tmp_path, tmp_path / "policy.so", flags), contract)
    v = vectors_of(contract, e, recorded_drives(e, ("traps", "cover_20")))
    for drive in (0, 1):
        state = exported.initial_state(1)
        for k in np.flatnonzero(v.drives == drive):
            status, outputs, state = exported.decide(v.inputs[k : k + 1], state)
            assert (status[0], outputs["action"][0]) == (0, v.actions[k])
            assert np.abs(outputs["values"][0] - v.values[k]).max() <= 1e-5 * np.abs(v.values[k]).max()
            assert outputs["heading_change"][0] == pytest.approx(v.turns[k], abs=1e-6)
    bad = v.drives < 0
    statuses, outputs, after = exported.decide(v.inputs[bad], exported.initial_state(int(bad.sum())))
    assert statuses.tolist() == v.statuses[bad].tolist() and set(outputs["action"].tolist()) == {6}
    assert after is not None and not any(after[name].any() for name in after.dtype.names or ())
    assert deepest_stack(tmp_path, "policy.c", "policy_decide", "-O0") <= cost.stack
    program = tmp_path / "example"
    run("gcc", *FLAGS, "-fsanitize=address", "-o", program, tmp_path / "example.c", tmp_path / "policy.c", "-lm")
    assert run(program).count(b"action") == 5
    assert_same_endings(Case(policy, contract, tmp_path, cost, v), exported, (7,))


@needs_cpp
def test_stated_operations_of_double_dqn_are_at_least_what_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prelude = Path(__file__).parents[1] / "scripts" / "counted.hpp"
    config = changed(load_policy("double_dqn").experiment.config, agent={"hidden": (9, 5), "frames": 2})
    policy = LoadedPolicy("small", Experiment(config), 1)
    monkeypatch.setattr(grid_map, "_MOST_SWEEPS", 1)  # the most of them never come, and would hide the rest
    contract = contract_of(policy)
    files, cost = c_files(contract, policy.experiment)
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    flags = ("-x", "c++", "-std=c++17", "-O1", "-w", "-fpermissive", "-include", str(prelude), f"-I{tmp_path}")
    file = build(tmp_path, tmp_path / "policy.so", flags, "g++")
    exported = LibraryPolicy(file, contract)
    counts = (c_long * 5).in_dll(CDLL(str(file)), "operations")
    generator, state, most = np.random.default_rng(1), exported.initial_state(1), np.zeros(5, int)
    for k in range(40):
        rays = (np.full(72, 9.99), generator.uniform(0, 10, 72), generator.uniform(0, 2, 72))[k % 3]
        row = np.r_[rays, generator.uniform([3, -3, -1.5, -2], [60, 3, 1.5, 2])].astype(np.float32)
        counts[:] = [0] * 5
        status, _, state = exported.decide(row[None], state)
        assert status[0] == 0
        most = np.maximum(most, counts)
    stated = np.array([getattr(cost.operations, its.name) for its in fields(cost.operations)])
    assert (most <= stated).all() and (stated < 4 * most).all()


def assert_same_endings(case: Case, exported: Any, seeds: tuple[int, ...] = (7, 8)) -> None:
    """Both drive in a few worlds, and do the same at every step."""
    ends = []
    for agent in (case.policy.experiment.policy, exported):
        e = Experiment(changed(case.policy.experiment.config, simulator="kinematic", vehicles=4), agent)
        worlds = [e.draw(e.kind(kind, own_ends=True), seed) for kind in ("cover_10", "traps") for seed in seeds]
        simulator = e.new_simulator(1)
        ends.append(run_episodes(e.new_navigation(simulator), worlds, e.policy))
        simulator.close()
    assert [(s.ending, s.steps) for s in ends[0]] == [(s.ending, s.steps) for s in ends[1]]


@needs_gcc
def test_a_tie_is_told_from_a_fault(cases: dict[str, Case]) -> None:
    case = cases["paper"]
    (drive,) = recorded_drives(case.policy.experiment, ("cover_20",))
    assert compare(case.policy.experiment, library(case), drive).unexplained == 0
    other = load_policy("tuned").experiment
    (drive,) = recorded_drives(other, ("cover_20",))
    drive = Observation(*(getattr(drive, its.name)[:20] for its in fields(drive)))
    assert compare(other, library(case), drive).unexplained > 0


@needs_gcc
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["paper", "q_table", "vfh"])
def test_same_action_in_many_states_of_all_kinds_of_worlds(kind: str, cases: dict[str, Case]) -> None:
    case, total, seed = cases[kind], Parity(), 0
    while total.states < 100_000:
        for drive in recorded_drives(case.policy.experiment, seeds=range(seed, seed + 8)):
            total += compare(case.policy.experiment, library(case), drive)
        seed += 8
    most = total.states / 500 if kind == "vfh" else 10  # sums of many readings at a threshold, with a memory of them
    assert total.unexplained == 0 and total.ties <= most and total.value_error < 1e-5


class TestContract:
    """The contract and the folder."""

    def test_recorded_decisions_fit_its_schema_and_bad_ones_do_not(self, cases: dict[str, Case]) -> None:
        jsonschema = pytest.importorskip("jsonschema")
        case = cases["hand_rule"]
        schema = json.loads(case.contract.json_schema())
        jsonschema.Draft202012Validator.check_schema(schema)
        validator = jsonschema.Draft202012Validator(schema)
        for row, status in zip(case.vectors.inputs[-20:], case.vectors.statuses[-20:], strict=True):
            numbers: NDArray[Any] = np.nan_to_num(row, nan=-1.0, posinf=-1.0, neginf=-99.0)
            values = dict(zip(("target_distance", "target_bearing", "yaw_rate"), numbers[-3:].tolist(), strict=True))
            decision = {
                "input": {"distances": numbers[:-3].tolist(), **values},
                "output": {"action": 1, "heading_change": 0.5, "speed_share": 1.0, "safe": 0},
            }
            assert validator.is_valid(decision) == (status == 0)

    def test_folder_is_whole_and_says_what_is_in_it(self, tmp_path: Path) -> None:
        exported = write_export(policy_of("q_table"), "c", tmp_path / "out")
        index = json.loads((exported.folder / "export.json").read_text())
        assert {its.name for its in exported.folder.iterdir()} - {"README.md"} == set(exported.files)
        assert set(index["files"]) == set(exported.files) - {"export.json"} | {"README.md"}
        lines = (exported.folder / "vectors.csv").read_text().splitlines()
        assert len(lines) == 1 + exported.decisions and lines[-1].startswith("-1,4,")
        columns = [its for its, _ in groupby(re.sub(r"_\d+", "", name) for name in lines[0].split(","))]
        signals = (*exported.contract.inputs, *exported.contract.outputs)
        assert columns == ["drive", "status", *(signal.name for signal in signals)]

    def test_a_folder_with_files_is_left_alone(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        (tmp_path / "mine").touch()
        assert main(["export", "straight", "--to", "c", "--out", str(tmp_path)]) == 2
        assert "has files in it" in capsys.readouterr().err
        assert [its.name for its in tmp_path.iterdir()] == ["mine"]

    @pytest.mark.parametrize(
        ("policy", "to", "named"),
        [
            ("guided_search", "c", "kind 'guided_search'"),
            ("random", "c", "kind 'random'"),
            *((kind, "c", f"kind '{kind}'") for kind in ("dwa", "pure_pursuit", "mppi", "orca")),
            *(("distilled", form, "kind 'distilled'") for form in ("c", "st")),
            ("vfh", "onnx", "kind 'vfh'"),
            (load_policy("straight", {"shield": {}}), "c", "--with-shield"),
            (load_policy("distilled", {"agent": {"search": {"paced": True}}}), "onnx", "paced"),
            (LoadedPolicy("sb3", Experiment(load_config("sb3_dqn", {})), 1), "onnx", "kind 'sb3_dqn'"),
            (type("Mine", (), {"act": lambda self, observations: None})(), "c", "object of your own"),
        ],
    )
    def test_what_cannot_be_carried_is_refused_by_name(self, policy: Any, to: Any, named: str, tmp_path: Path) -> None:
        pytest.importorskip("onnx")
        with pytest.raises(UserError, match=named):
            nb.export(policy, to=to, out=tmp_path / "out")
        assert not (tmp_path / "out").exists()
