"""Holds exported policies against the policies themselves, and prints what differs and how long a decision takes.

Every policy is written as C and compiled, and as ONNX where it can be. First each decides by the same states, which the
first one saw in drives in all kinds of worlds; a difference with the same heading change, or one that rounding of the
inputs explains, is a tie. Then both drive in the same worlds in contact physics.

    python scripts/export_parity.py paper tuned --states 1000000
    python scripts/export_parity.py paper vfh --states 10000 --worlds 100
    python scripts/export_parity.py paper double_dqn --shield --states 10000 --worlds 100 --json parity.json
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, fields
from pathlib import Path
from tempfile import TemporaryDirectory

from nnql_bullet.env import Observation
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.exports.c99 import c_files
from nnql_bullet.exports.contract import contract_of
from nnql_bullet.exports.maps import map_of
from nnql_bullet.exports.onnx_graph import onnx_model
from nnql_bullet.exports.parity import EXACT, Parity, compare
from nnql_bullet.exports.running import LibraryPolicy, OnnxMapPolicy, OnnxPolicy, build
from nnql_bullet.exports.shielded import in_shield, shield_files, without_shield
from nnql_bullet.exports.vectors import recorded_drives
from nnql_bullet.rollout import Policy, run_episodes
from nnql_bullet.run_config import changed
from nnql_bullet.runs import LoadedPolicy, load_policy

SEEDS = 8
"""Worlds of each kind that are driven in before their states are compared."""
WORLDS = ("cover_10", "traps", "rooms", "poles")
"""Kinds of worlds that both drive in, by turns."""
CALLS = 500
"""Decisions that are timed."""


def exported(policy: LoadedPolicy, folder: Path) -> dict[str, LibraryPolicy | OnnxPolicy]:
    """A policy in every form that it can be exported in."""
    contract, experiment = contract_of(policy), policy.experiment
    folder.mkdir()
    found: dict[str, LibraryPolicy | OnnxPolicy] = {}
    print(policy.name)
    try:
        alone = without_shield(policy)
        files, cost = c_files(contract_of(alone), alone.experiment)
        if contract.shielded:
            more, cost = shield_files(contract, experiment, cost)
            files |= more
        for name, text in files.items():
            (folder / name).write_text(text)
        library = build(folder, folder / "policy.so")
        found["c"] = LibraryPolicy(library, contract)
        print(f"  c: {cost.text()}; {sum(map(len, files.values()))} bytes of source, {library.stat().st_size} compiled")
    except UserError as error:
        print(f"  {error}")
    if contract.shielded:
        return found
    try:
        contract = contract_of(policy, graph=True)
        model = onnx_model(contract, experiment)
        (folder / "policy.onnx").write_bytes(model)
        file = folder / "policy.onnx"
        beside = contract.map_beside
        found["onnx"] = OnnxMapPolicy(file, contract, map_of(experiment)) if beside else OnnxPolicy(file, contract)
        print(f"  onnx: {len(model)} bytes")
    except UserError as error:
        print(f"  {error}")
    return found


def batches(experiment: Experiment, states: int) -> Iterator[list[Observation]]:
    """What a policy sees in drives, until it has seen so many states."""
    seed = 0
    while states > 0:
        drives = recorded_drives(experiment, seeds=range(seed, seed + SEEDS))
        states -= sum(len(drive.readings) for drive in drives)
        seed += SEEDS
        yield drives


def microseconds(policy: Policy, drive: Observation) -> float:
    """Processor time of a decision for one vehicle along a drive [us]."""
    steps = range(len(drive.readings))
    seen = [Observation(*(getattr(drive, field.name)[k : k + 1] for field in fields(drive))) for k in steps]
    state = policy.initial_state(1)
    for one in seen[:20]:
        _, state = policy.act(one, state)
    state = policy.initial_state(1)
    start = time.process_time()
    for k in range(CALLS):
        _, state = policy.act(seen[k % len(seen)], state)
    return (time.process_time() - start) / CALLS * 1e6


def endings(policy: LoadedPolicy, agent: Policy, count: int, simulator: str) -> list[tuple[str, int]]:
    """Endings and steps of drives."""
    experiment = Experiment(changed(policy.experiment.config, simulator=simulator, vehicles=min(count, 10)), agent)
    kinds = [experiment.kind(name, own_ends=True) for name in WORLDS]
    worlds = [experiment.draw(kinds[i % len(kinds)], i) for i in range(count)]
    with closing(experiment.new_simulator(1)) as running:
        return [(s.ending, s.steps) for s in run_episodes(experiment.new_navigation(running), worlds, agent)]


def main() -> None:
    """Runs the script."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("policies", nargs="+", metavar="POLICY", help="run folder, shipped policy or rule")
    parser.add_argument("--states", type=int, default=1_000_000, help="states to compare")
    parser.add_argument("--worlds", type=int, default=0, help="worlds to drive in")
    parser.add_argument("--sim", default="bullet", help="simulator to drive in")
    parser.add_argument("--shield", action="store_true", help="put them into the shield that is exported")
    parser.add_argument("--json", type=Path, help="file to write what is found to")
    args = parser.parse_args()
    policies = [load_policy(name) for name in args.policies]
    policies = [in_shield(policy) for policy in policies] if args.shield else policies
    kept: dict[str, dict[str, object]] = {}
    with TemporaryDirectory() as folder:
        forms = [exported(policy, Path(folder) / str(number)) for number, policy in enumerate(policies)]
        totals: dict[tuple[str, str], Parity] = {}
        seen = 0
        for drives in batches(policies[0].experiment, args.states):
            seen += sum(len(drive.readings) for drive in drives)
            print(f"\r{seen} of {args.states} states", end="", file=sys.stderr, flush=True)
            for policy, its in zip(policies, forms, strict=True):
                for form, one in its.items():
                    for drive in drives:
                        total = totals.get((policy.name, form), Parity())
                        totals[policy.name, form] = total + compare(policy.experiment, one, drive)
        print(file=sys.stderr)
        for (name, form), t in totals.items():
            kept[f"{name} {form}"] = asdict(t) | {"unexplained": t.unexplained}
            print(
                f"{name} {form}: {t.states} states, {t.differences} differ: {t.same_turn} by no turn, {t.ties} ties, "
                f"{t.unexplained} unexplained; Q-values of {t.valued}: {t.inexact} farther off than {EXACT:g}, "
                f"{t.value_error:.1e} at most"
            )
        for policy, its in zip(policies, forms, strict=True):
            agent = policy.experiment.policy
            times = {"python": microseconds(agent, drives[0])}
            times |= {form: microseconds(one, drives[0]) for form, one in its.items()}
            for form, us in times.items():
                kept.setdefault(f"{policy.name} {form}", {})["microseconds"] = round(us, 1)
            print(f"{policy.name}: " + ", ".join(f"{form} {us:.1f} us" for form, us in times.items()))
            if args.worlds:
                mine = endings(policy, agent, args.worlds, args.sim)
                for form, one in its.items():
                    theirs = endings(policy, one, args.worlds, args.sim)
                    same = sum(a[0] == b[0] for a, b in zip(mine, theirs, strict=True))
                    steps = sum(a == b for a, b in zip(mine, theirs, strict=True))
                    kept[f"{policy.name} {form}"] |= {"worlds": len(mine), "same_endings": same, "same_steps": steps}
                    print(f"{policy.name} {form}: {same} of {len(mine)} endings equal, {steps} with as many steps")
    if args.json:
        args.json.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
