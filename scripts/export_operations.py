"""Counts what decisions of policies exported to C take, and prints it beside what is stated as the most.

Policies, in their shield unless told otherwise, are written as C and compiled with numbers that count
(scripts/counted.hpp). They decide by what was seen in drives in all kinds of worlds.

    python scripts/export_operations.py paper straight --decisions 100000
    python scripts/export_operations.py double_dqn --alone --decisions 2000
"""

import argparse
from ctypes import CDLL, c_long
from dataclasses import astuple
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from nnql_bullet.exports.c99 import c_files
from nnql_bullet.exports.contract import contract_of
from nnql_bullet.exports.running import LibraryPolicy, build
from nnql_bullet.exports.shielded import in_shield, shield_files, without_shield
from nnql_bullet.exports.vectors import recorded_drives
from nnql_bullet.runs import load_policy

PRELUDE = Path(__file__).with_name("counted.hpp")
KINDS = "additions", "multiplications", "divisions", "comparisons", "functions"


def main() -> None:
    """Runs the script."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("policies", nargs="+", metavar="POLICY", help="run folder, shipped policy or rule")
    parser.add_argument("--alone", action="store_true", help="without a shield")
    parser.add_argument("--decisions", type=int, default=100_000)
    args = parser.parse_args()
    for name in args.policies:
        policy = load_policy(name) if args.alone else in_shield(load_policy(name))
        alone, contract = without_shield(policy), contract_of(policy)
        files, cost = c_files(contract_of(alone), alone.experiment)
        if not args.alone:
            more, cost = shield_files(contract, policy.experiment, cost)
            files |= more
        with TemporaryDirectory() as folder:
            for file, text in files.items():
                (Path(folder) / file).write_text(text)
            flags = ("-x", "c++", "-std=c++17", "-O2", "-w", "-fpermissive", "-include", str(PRELUDE), f"-I{folder}")
            library = build(Path(folder), Path(folder) / "policy.so", flags, "g++")
            exported = LibraryPolicy(library, contract)
            counts = (c_long * len(KINDS)).in_dll(CDLL(str(library)), "operations")
            taken: list[list[int]] = []
            seed = 0
            while len(taken) < args.decisions:
                for drive in recorded_drives(policy.experiment, seeds=range(seed, seed + 1)):
                    rows, memory = contract.rows(drive), exported.initial_state(1)
                    for k in range(len(rows)):
                        counts[:] = [0] * len(KINDS)
                        _, _, memory = exported.decide(rows[k : k + 1], memory)
                        taken.append(list(counts))
                seed += 1
        found, stated = np.array(taken), np.array(astuple(cost.operations))
        totals, most = found.sum(axis=1), found.max(axis=0)
        if (most > stated).any():
            raise SystemExit(f"{name}: counted {most.tolist()}, stated {stated.tolist()}")
        print(f"{name}: {len(found)} decisions; stated at most: {cost.text()}")
        print("  counted at most: " + ", ".join(f"{n} {kind}" for n, kind in zip(most, KINDS, strict=True)))
        low, middle, high = np.percentile(totals, [50, 99, 99.9])
        print(f"  together: median {low:.3g}, 99% {middle:.3g}, 99.9% {high:.3g}, most {totals.max():.3g}; ", end="")
        print(f"stated {stated.sum():.3g}, {stated.sum() / totals.max():.0f} times the most")


if __name__ == "__main__":
    main()
