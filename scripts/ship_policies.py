"""Puts trained policies, evaluated, and a card of each into nnql_bullet/_data/policies.

python scripts/ship_policies.py double_dqn=runs/ddqn-1 tuned=runs/tuned-0 paper=runs/results/paper-0

Each is driven bare and in a shield through test worlds of seven kinds, in the kinematic model and in contact physics;
with two policies that takes some ten minutes on 2 quiet cores. What is driven is kept in runs/ship, and not driven
again.
"""

import argparse
import shutil
from pathlib import Path
from typing import Any

import nnql_bullet as nb
from nnql_bullet import assets
from nnql_bullet.api.evaluate import EvaluationResults
from nnql_bullet.commands import train_arguments
from nnql_bullet.config import to_values, write_toml
from nnql_bullet.training.checkpoint import POLICY

FOLDER = Path(assets.__file__).parent / "_data" / "policies"
WORK = Path("runs/ship")
KINDS = ("paper", "cover_10", "cover_15", "cover_20", "traps", "aisles", "moving")
SETTINGS: dict[str, dict[str, Any]] = {
    "the kinematic model, 100 test worlds of each kind": {"simulator": "kinematic", "n_worlds": 100},
    "contact physics (PyBullet, `fast`), 25 test worlds of each kind": {"physics": "fast", "n_worlds": 25},
}
WHAT = {
    "distilled": "a network that learned what a search over several manoeuvres says, on a map of what it has seen",
    "double_dqn": "decides every step by a dueling network over 24 readings and a map of what it has seen",
    "paper": "the paper's 8-6-5 network with the numbers that the paper states",
    "literal": "the paper's 8-6-5 network, the text read by the letter",
    "tuned": "the paper's 8-6-5 network with the numbers that it states, and what it leaves open set by evidence",
}
"""Of the presets whose policies may be shipped."""
LIMITS = """\
Made for the vehicle and the kinds of worlds above. Worlds of poles, clutter, rooms and cells, which are harder, were
not driven for this card. Success is a share of drives through random worlds, with its 95 % interval: evidence, never a
statement of safety. Bare, only the policy itself judges what it does. So few drives in a shield cannot show that
collisions are rarer than one in a thousand, and a box that moves makes way for nobody.
"""


def ship(name: str, run: Path) -> None:
    """Copies what a run has learned."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(run / POLICY, FOLDER / f"{name}.safetensors")
    write_card(name, {})


def evaluated(names: list[str]) -> dict[str, EvaluationResults]:
    """Evaluates shipped policies in each setting."""
    return {
        title: nb.evaluate(
            names, worlds=KINDS, split="test", shield=True, workers=None, out=WORK / str(number), **setting
        )
        for number, (title, setting) in enumerate(SETTINGS.items())
    }


def write_card(name: str, results: dict[str, EvaluationResults]) -> None:
    """The card of a policy that lies in its place."""
    policy = nb.load_policy(FOLDER / f"{name}.safetensors")
    config, episodes = policy.experiment.config, policy.episodes
    preset, flags = train_arguments(config)
    if preset not in WHAT:
        raise SystemExit(f"{name}: was not trained by one of these presets: {', '.join(WHAT)}")
    lines = [
        f"# {name}: {WHAT[preset]}; {episodes} episodes, seed {config.seed}",
        "",
        f"Trained by `{' '.join(['nnql-bullet train --config', preset, *flags])}`.",
        "",
        "## How good",
        "",
        *_tables(name, results),
        "## Limits",
        "",
        LIMITS,
        "## Configuration",
        "",
        "```toml",
        write_toml(to_values(config)).strip(),
        "```",
        "",
    ]
    assets.card(FOLDER / f"{name}.safetensors").write_text("\n".join(lines), encoding="utf-8")


def _tables(name: str, results: dict[str, EvaluationResults]) -> list[str]:
    lines: list[str] = []
    for title, found in results.items():
        tiers = {tier.name: tier.title for tier in found.evaluation.tiers}
        lines += [f"Success and collisions in % of drives, with 95 % intervals; {title}:", ""]
        lines += [f"| | {' | '.join(tiers.values())} |", f"|---|{'---|' * len(tiers)}"]
        for method, label in ((name, "bare"), (f"{name}+shield", "in a shield")):
            rows = {row.world: row for row in found.methods if row.method == method}
            for ending, what in (("goal", label), ("collision", "collisions")):
                cells = [str(rows[tier].outcomes[ending]) for tier in tiers]
                lines.append(f"| {what} | {' | '.join(cells)} |")
        lines.append("")
    return lines


def main() -> None:
    """Ships what is named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policies", nargs="+", metavar="NAME=RUN")
    shipped = dict(pair.split("=", 1) for pair in parser.parse_args().policies)
    for name, run in shipped.items():
        ship(name, Path(run))
    results = evaluated(list(shipped))
    for name in shipped:
        write_card(name, results)


if __name__ == "__main__":
    main()
