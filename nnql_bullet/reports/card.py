"""The card of a run's policy: Markdown with front matter, in the form that the Hugging Face Hub reads."""

import csv
import io
from pathlib import Path
from typing import Any

import yaml

from nnql_bullet.commands import train_arguments
from nnql_bullet.evaluation.statistics import Estimate, proportion
from nnql_bullet.files import is_file, read_text, write_text
from nnql_bullet.reports.document import Commands, Report, Section
from nnql_bullet.runs import CARD, SELECTION, Run
from nnql_bullet.text import shell_line

LIBRARY = "nnql-bullet"
MARK = "<!-- Written when the training stops; delete this line to keep what you write here. -->"
LIMITS = (
    "Made for the vehicle and the kinds of worlds in `config.toml`. Success is a share of drives through random "
    "worlds: evidence, never a statement of safety. Without a shield, nothing keeps the vehicle from what its policy "
    "does not see."
)


def write_card(run: Run, own: str = "") -> None:
    """Writes the card into the run folder, unless somebody has written another.

    Args:
        run: A run that has a policy.
        own: What of the training the configuration does not say, such as a reward of the caller's.

    Raises:
        OSError: If it cannot be written.
    """
    path = run.folder / CARD
    if not is_file(path) or MARK in read_text(path):
        write_text(path, card_text(run, own))


def card_text(run: Run, own: str = "") -> str:
    """Returns the card; equal runs give equal ones."""
    config, measured = run.config, _measured(run)
    front: dict[str, Any] = {
        "library_name": LIBRARY,
        "tags": ["reinforcement-learning", "robotics", "navigation", "obstacle-avoidance", config.agent.kind],
    }
    if measured:
        name = f"{config.agent.kind}-{config.seed}"
        front["model-index"] = [{"name": name, "results": [_result(*measured)]}]
    preset, flags = train_arguments(config)
    trained = (
        f"Trained in Python, with {own} of the author's own."
        if own
        else Commands((shell_line("nnql-bullet", "train", "--config", preset, *flags),))
    )
    good = f"{measured[1]} % of targets reached in {measured[0]} (95 % interval)." if measured else "Not measured yet."
    use = Commands(("pip install nnql-bullet", "nnql-bullet drive FOLDER", "nnql-bullet evaluate FOLDER"))
    sections = (
        Section(
            "", (f"A policy of `nnql-bullet`: {len(run.episodes)} training episodes, seed {config.seed}.", trained)
        ),
        Section("Use", ("FOLDER is a copy of this one.", use)),
        Section("How good", (good, "`nnql-bullet evaluate` measures it among others, in worlds of your choice.")),
        Section("Limits", (LIMITS,)),
    )
    head = yaml.safe_dump(front, sort_keys=False, allow_unicode=True, width=1000)
    title = f"{config.agent.kind} in {_where(run)}"
    return f"---\n{head}---\n\n{MARK}\n\n{Report(title, sections).markdown()}"


def _where(run: Run) -> str:
    worlds = run.config.training.worlds or (run.config.world,)
    return ", ".join(dict.fromkeys(Path(its).stem if isinstance(its, str) else its.name for its in worlds))


def _measured(run: Run) -> tuple[str, Estimate] | None:
    """Where the policy of a run was measured, and its success; None if it was not."""
    if is_file(run.folder / SELECTION):
        rows = csv.DictReader(io.StringIO(read_text(run.folder / SELECTION)))
        (best,) = [row for row in rows if row["selected"] == "1"]
        where = f"the {best['worlds']} validation worlds that it was selected in, in the kinematic model"
        return where, proportion(int(best["goals"]), int(best["worlds"]))
    last = run.evaluations[-1] if run.evaluations else None
    if last is None or last.episodes != len(run.episodes):
        return None
    return f"{last.worlds} validation worlds, in the kinematic model", proportion(last.goals, last.worlds)


def _result(where: str, success: Estimate) -> dict[str, Any]:
    """A result in the form of the Hub's `model-index`."""
    return {
        "task": {"type": "reinforcement-learning", "name": "reach a target without touching anything"},
        "dataset": {"type": "nnql_bullet/Tricycle-v0", "name": where},
        "metrics": [{"type": "success_rate", "name": "targets reached", "value": round(success.value, 4)}],
    }
