"""Hashes what the program computes, so that a change of its structure can be shown to change no number.

It hashes short trainings (episodes and weights), drives of every shipped policy and rule in every shipped world, in
every simulator, with and without a shield and conditions, one recording a simulator, steps of the Gymnasium
environments, and the measurements of every fidelity probe. The hashes of one machine are in tests/fingerprint.json;
another processor may round differently, so compare on one machine.

    python scripts/fingerprint.py --check            # everything, some twenty minutes on 2 cores
    python scripts/fingerprint.py --check --quick    # a sample of it, two minutes
    python scripts/fingerprint.py --check --only training
    python scripts/fingerprint.py --update           # after a change that is meant to change numbers
"""

import argparse
import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import asdict, dataclass, fields
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

HASHES = Path(__file__).resolve().parent.parent / "tests" / "fingerprint.json"
WORLDS = ("paper", "cover_2.5", "cover_7.5", "cover_10", "cover_15", "cover_20", "empty", "traps", "aisles", "moving")
RULES = ("straight", "random", "hand_rule", "potential_field", "fuzzy", "vfh", "look_ahead")
POLICIES = ("paper", "tuned", "double_dqn", *RULES)
CONDITIONS: dict[str, dict[str, Any]] = {
    "plain": {},
    "worn": {"wheel_friction": 0.6, "payload": 60.0, "sensor_noise": 0.05, "dead_sector": 1},
}
CONTACT = (("bullet", "fast"), ("mujoco", "fast"))
SETTINGS = (("bullet", "reference"), ("bullet", "fast"), ("mujoco", "reference"), ("mujoco", "fast"))
_SMALL_SEARCH = {"kind": "genetic", "population": 8, "worlds": 2, "elites": 2}
_SMALL_DQN = {"kind": "double_dqn", "learning_starts": 400, "batch_size": 64, "exploration_episodes": 30}
_FEW = {"worlds": ["cover_10"], "candidates": 2, "every": 10, "count": 5}
TRAININGS: dict[str, tuple[str, dict[str, Any]]] = {
    "paper, kinematic, 1": ("paper", {"simulator": "kinematic", "episodes": 40}),
    "paper, kinematic, 16": ("paper", {"simulator": "kinematic", "vehicles": 16, "episodes": 60}),
    "paper, bullet, 1": ("paper", {"simulator": "bullet", "episodes": 5}),
    "paper, bullet, 4": ("paper", {"simulator": "bullet", "vehicles": 4, "episodes": 8}),
    "paper, mujoco, 2": ("paper", {"simulator": "mujoco", "vehicles": 2, "episodes": 4}),
    "literal, kinematic, 16": ("literal", {"simulator": "kinematic", "vehicles": 16, "episodes": 40}),
    "tuned, kinematic, 64": ("tuned", {"episodes": 100, "training": {"selection": _FEW}}),
    "tuned, bullet, 4": (
        "tuned",
        {"simulator": "bullet", "vehicles": 4, "episodes": 8, "training": {"selection": _FEW}},
    ),
    "q_table, kinematic, 1": ("q_table", {"simulator": "kinematic", "episodes": 40}),
    "q_table, kinematic, 16": ("q_table", {"simulator": "kinematic", "vehicles": 16, "episodes": 60}),
    "q_table, bullet, 4": ("q_table", {"simulator": "bullet", "vehicles": 4, "episodes": 8}),
    "genetic, kinematic, 16": (
        "genetic",
        {"simulator": "kinematic", "vehicles": 16, "episodes": 40, "agent": _SMALL_SEARCH},
    ),
    "genetic, bullet, 4": ("genetic", {"simulator": "bullet", "vehicles": 4, "episodes": 16, "agent": _SMALL_SEARCH}),
    "double_dqn, kinematic, 16": ("double_dqn", {"vehicles": 16, "episodes": 32, "agent": _SMALL_DQN}),
    "double_dqn, bullet, 4": (
        "double_dqn",
        {"simulator": "bullet", "vehicles": 4, "episodes": 6, "agent": {**_SMALL_DQN, "learning_starts": 100}},
    ),
    "sb3_dqn, kinematic, 8": ("sb3_dqn", {"simulator": "kinematic", "vehicles": 8, "episodes": 16}),
}


class Hash:
    """A running hash of numbers and names."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def add(self, value: object) -> "Hash":
        """Takes in a value: arrays by their bytes, containers by their parts, all else by its text."""
        if isinstance(value, np.ndarray) and value.dtype.kind != "U":
            self._hash.update(f"{value.dtype.kind}{value.shape}".encode())
            self._hash.update(np.ascontiguousarray(value).tobytes())
        elif isinstance(value, dict):
            for key in sorted(value):
                self.add(key).add(value[key])
        elif isinstance(value, list | tuple):
            for part in value:
                self.add(part)
        else:
            self._hash.update(repr(value.tolist() if isinstance(value, np.ndarray) else value).encode() + b"\0")
        return self

    @property
    def text(self) -> str:
        """The hash so far."""
        return self._hash.hexdigest()[:16]


def trainings(quick: bool) -> Iterable[tuple[str, str]]:
    """Each training: its episodes and its weights."""
    for name, (preset, changes) in TRAININGS.items():
        if not quick or "bullet" not in name:
            yield name, _trained(preset, changes)


def _trained(preset: str, changes: dict[str, Any]) -> str:
    from safetensors.numpy import load_file

    from nnql_bullet.presets import load_config
    from nnql_bullet.session import train

    with TemporaryDirectory() as folder:
        train(load_config(preset, changes), Path(folder) / "run", workers=1)
        _, *episodes = (Path(folder) / "run" / "episodes.csv").read_text().splitlines()
        checkpoint = {k: v for k, v in load_file(f"{folder}/run/checkpoint.safetensors").items()}
        sums = sorted(Hash().add(values).text for values in checkpoint.values())
        return Hash().add(episodes).add(load_file(f"{folder}/run/policy.safetensors")).add(sums).text


@dataclass(frozen=True)
class Case:
    """Drives of one policy in some worlds, in one place."""

    policy: str
    worlds: tuple[str, ...]
    seeds: range
    simulator: str = "kinematic"
    physics: str = "fast"
    shield: bool = False
    conditions: str = "plain"

    @property
    def changes(self) -> dict[str, Any]:
        """To the policy's configuration, apart from the world."""
        shield = {"shield": {}} if self.shield else {}
        conditions = CONDITIONS[self.conditions]
        return {"simulator": self.simulator, "physics": self.physics, "conditions": conditions, **shield}

    @property
    def name(self) -> str:
        """In the file of hashes."""
        shield = "shield" if self.shield else "bare"
        return ", ".join(
            (self.policy, self.simulator, self.conditions, shield, self.worlds[0] if len(self.worlds) == 1 else "all")
        )


def drives(quick: bool) -> Iterable[tuple[str, str]]:
    """Every policy in the kinematic model and in contact physics, bare and shielded, as it should be and worn."""
    kinematic = range(3 if quick else 20)
    for policy, conditions, shield in product(POLICIES, CONDITIONS, (False, True)):
        worlds = WORLDS if not quick else ("cover_10", "aisles", "moving")
        case = Case(policy, worlds, kinematic, shield=shield, conditions=conditions)
        yield case.name, _driven(case)


def contact(quick: bool) -> Iterable[tuple[str, str]]:
    """Every policy in contact physics."""
    for (simulator, physics), policy, conditions, shield in product(CONTACT, POLICIES, CONDITIONS, (False, True)):
        if quick and (policy not in ("paper", "double_dqn") or (conditions == "plain") == shield):
            continue
        worlds = WORLDS if not quick else ("moving",)
        case = Case(policy, worlds, range(1 if quick else 3), simulator, physics, shield, conditions)
        yield case.name, _driven(case)


def _driven(case: Case) -> str:
    from nnql_bullet.env import Navigation
    from nnql_bullet.rollout import run_episode, run_episodes
    from nnql_bullet.runs import load_policy

    total = Hash()
    for world in case.worlds:
        changes = {"world": world, "vehicles": len(case.seeds), **case.changes}
        experiment = load_policy(Path(case.policy), changes).experiment
        worlds = [experiment.world(seed) for seed in case.seeds]
        if case.simulator == "kinematic":
            with closing(experiment.new_simulator(1)) as simulator:
                navigation = Navigation(simulator, experiment.config.task)
                summaries = run_episodes(navigation, worlds, experiment.policy)
        else:
            summaries = [run_episode(experiment.navigation, one, experiment.policy) for one in worlds]
            experiment.simulator.close()
        # Renamed since: the hash is of numbers and endings, in the order of the record's fields. `reverse_steps` and
        # `waypoint_times`, the last ones, are newer than the hashes; where a vehicle reverses, the others tell.
        total.add([list(asdict(summary).values())[:-2] for summary in summaries])
    return total.text


def recordings(quick: bool) -> Iterable[tuple[str, str]]:
    """One drive a simulator, step by step."""
    for simulator, shield in product(("kinematic", "bullet", "mujoco"), (False, True)):
        case = Case("tuned", ("moving",), range(1), simulator, "fast", shield, "worn")
        yield case.name, _recorded(case)


def _recorded(case: Case) -> str:
    from nnql_bullet.driving import drive
    from nnql_bullet.run_config import Conditions

    recording = drive(
        case.policy,
        world=case.worlds[0],
        seed=7,
        simulator=case.simulator,  # type: ignore[arg-type]
        physics=case.physics,  # type: ignore[arg-type]
        shield=case.shield,
        conditions=Conditions(**CONDITIONS[case.conditions]),
    )
    kept = [getattr(recording, field.name) for field in fields(recording) if field.name != "about"]
    return Hash().add(kept).text


def environments(quick: bool) -> Iterable[tuple[str, str]]:
    """Steps of the Gymnasium environments under actions drawn at random."""
    import gymnasium

    import nnql_bullet  # noqa: F401 (registers them)

    for simulator in ("kinematic", "bullet"):
        actions = np.random.Generator(np.random.PCG64(0))
        env = gymnasium.make("nnql_bullet/Tricycle-v0", config="paper", simulator=simulator, disable_env_checker=True)
        total = Hash()
        for seed in range(2):
            total.add(env.reset(seed=seed)[0])
            for _ in range(60):
                seen, reward, terminated, truncated, info = env.step(int(actions.integers(6)))
                total.add([seen, float(reward), bool(terminated), bool(truncated), info["heading_error"]])
                if terminated or truncated:
                    break
        env.close()
        yield f"single, {simulator}", total.text
        several = gymnasium.make_vec("nnql_bullet/Tricycle-v0", num_envs=3, config="paper", simulator=simulator)
        total = Hash().add(several.reset(seed=5)[0])
        for _ in range(120):
            seen, reward, terminated, truncated, _ = several.step(actions.integers(6, size=3))
            total.add([seen, reward, terminated, truncated])
        several.close()
        yield f"vector, {simulator}", total.text


def fidelity(quick: bool) -> Iterable[tuple[str, str]]:
    """What every probe measures and expects."""
    from nnql_bullet.fidelity.probe import Bench
    from nnql_bullet.fidelity.probes import run_probes
    from nnql_bullet.vehicle.urdf import load_vehicle

    vehicle = load_vehicle("tricycle")
    for engine, physics in SETTINGS[1:2] if quick else SETTINGS:
        for probe, measured in run_probes(Bench(vehicle, engine, physics)):
            numbers = [(m.expected, m.measured) for m in measured]
            yield f"{engine}, {physics}, {probe.title}", Hash().add(numbers).text


PARTS: dict[str, Callable[[bool], Iterable[tuple[str, str]]]] = {
    "environments": environments,
    "recordings": recordings,
    "training": trainings,
    "drives": drives,
    "fidelity": fidelity,
    "contact": contact,
}


def main() -> int:
    """Hashes, and compares or keeps what comes out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    mode = parser.add_mutually_exclusive_group(required=True)
    mode.add_argument("--check", action="store_true", help="compare with the kept hashes; exit code 1 if one differs")
    mode.add_argument("--update", action="store_true", help="keep the hashes of now")
    parser.add_argument("--quick", action="store_true", help="a sample of everything")
    parser.add_argument("--only", choices=PARTS, action="append", help="one part, or several")
    a = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    kept = json.loads(HASHES.read_text()) if HASHES.exists() else {}
    size = "quick" if a.quick else "whole"
    wrong = []
    for part in a.only or PARTS:
        before = kept.get(size, {}).get(part, {})
        found = {}
        for name, its in PARTS[part](a.quick):
            found[name] = its
            same = before.get(name) == its
            print(f"{part}: {name}: {its}{'' if same or a.update else '  DIFFERS'}", flush=True)
            if not same:
                wrong.append(f"{part}: {name}")
        kept.setdefault(size, {})[part] = found
    if a.update:
        HASHES.write_text(json.dumps(kept, indent=1, sort_keys=True) + "\n")
        return 0
    print(f"{len(wrong)} hashes differ" if wrong else "every hash is as it was")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
