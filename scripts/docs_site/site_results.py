"""Figures and tables of the site and of the README, read from results/: no page types a figure that is there."""

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "results"

REPORTS = {
    "covers": ("Contact physics, by cover", "Every method in PyBullet, in worlds of 5 to 20 % cover.", "covers"),
    "hard": ("Contact physics, hard worlds", "Traps, aisles and moving boxes.", "hard"),
    "kinematic": ("Kinematic model, all worlds", "More worlds of every kind, without slip.", "kinematic"),
    "shield": ("Bare and in a shield", "How success and interventions change in a shield.", "shield"),
    "thousand": ("A thousand worlds of each kind", "Shipped policies and rules, kinematic model.", "thousand"),
    "poles-contact": ("Poles in contact physics", "Poles of 2 to 30 cm, bare and in a shield.", "poles-contact"),
    "poles": ("Poles and 360 rays", "The same poles, seen by 360 rays, kinematic model.", "poles"),
    "tight": ("Tight worlds", "Poles, clutter, rooms and cells, by bottleneck, bare and in a shield.", "tight"),
    "conditions": ("Conditions nobody trained with", "Friction, payload, noise and dead sectors.", "conditions"),
    "barn": ("Worlds of the BARN challenge", "Shipped policies and rules by its protocol.", "barn"),
    "barn-contact": ("BARN in contact physics", "Some of them in PyBullet.", "barn"),
    "maps": ("Maps", "Shipped policies and rules through maps of others.", "maps"),
    "ablation": ("Ablation of paper", "The factors that the paper leaves open.", "ablations"),
    "ablation-tuned": ("Ablation of tuned", "What each departure of `tuned` is worth.", "ablations"),
    "ablation-double_dqn": ("Ablation of double_dqn", "What the map and the frames are worth.", "ablations"),
    "learners": ("Learners of others", "DQN, QR-DQN, PPO and recurrent PPO, each tuned.", "learners.py"),
}
"""By folder of results/: title, one sentence, and the script or the part of scripts/results.py that makes it."""
PAGES = {folder: its for folder, its in REPORTS.items() if (RESULTS / folder).is_dir()}
"""Those that have been made."""


COVERS = {"paper": "5 % cover", "cover_10": "10 % cover", "cover_15": "15 % cover", "cover_20": "20 % cover"}


@cache
def values(folder: str, name: str = "results.json") -> dict[str, Any]:
    """The JSON of a folder of results/."""
    found: dict[str, Any] = json.loads((RESULTS / folder / name).read_text(encoding="utf-8"))
    return found


def row(folder: str, method: str, world: str) -> dict[str, Any]:
    """The numbers of one method in one kind of world.

    Raises:
        LookupError: If the results do not hold it.
    """
    for found in values(folder)["rows"]:
        if re.sub(r"-\d+$", "", found["method"]) == method and found["world"] == world:
            return dict(found)
    raise LookupError(f"results/{folder} holds no '{method}' in '{world}'")


def _interval(three: list[float]) -> str:
    value, low, high = (100 * number for number in three)
    return f"{value:.1f} ({low:.1f}-{high:.1f})"


def _success(found: dict[str, Any]) -> str:
    return _interval(found["over_seeds"] or found["outcomes"]["goal"])


def _in_words(three: list[float | None], unit: str, form: str = ".1f", missing: str = "no interval") -> str:
    value, low, high = three
    if low is None or high is None:
        return f"{value:{form}}{unit} ({missing})"
    return f"{value:{form}}{unit} ({low:{form}} to {high:{form}})"


def _percent(three: list[float | None]) -> list[float | None]:
    return [None if number is None else 100 * number for number in three]


def success(folder: str, method: str, world: str) -> str:
    """A success rate with its 95 % interval."""
    found = row(folder, method, world)
    return _in_words(_percent(found["over_seeds"] or found["outcomes"]["goal"]), " %")


def outcome(folder: str, method: str, world: str, name: str) -> str:
    """The share of drives that ended in one way, over all drives, with its 95 % interval."""
    return _in_words(_percent(row(folder, method, world)["outcomes"][name]), " %")


def _quantity(found: dict[str, Any], name: str) -> list[float | None]:
    """A quantity of a row with its interval, which results of version 0.1 lack."""
    return [found[name], *found.get("intervals", {}).get(name, (None, None))]


def share(folder: str, method: str, world: str, name: str) -> str:
    """A share of decisions with its 95 % interval: of a drive's decisions, the mean over drives, if that is known."""
    found = row(folder, method, world)
    by_drive = f"{name}_by_drive" if f"{name}_by_drive" in found else name
    return _in_words(_percent(_quantity(found, by_drive)), " %")


def number(folder: str, method: str, world: str, name: str, digits: str = "1") -> str:
    """A mean over drives with its 95 % interval."""
    return _in_words(_quantity(row(folder, method, world), name), "", f".{digits}f")


def success_table(folder: str, *methods: str) -> str:
    """A table of success by kind of world."""
    found = values(folder)
    tiers = [(tier["name"], tier["title"]) for tier in found["tiers"]]
    rows = []
    for method in methods or dict.fromkeys(one["method"] for one in found["rows"]):
        name = re.sub(r"-\d+$", "", method)
        numbers = [row(folder, name, tier) for tier, _ in tiers]
        cells = map(_success, numbers)
        rows.append([f"`{name}`", str(numbers[0]["policies"]), *cells])
    head = ["method", "seeds", *(title for _, title in tiers)]
    return _table([head, ["---", "--:", *("--:" for _ in tiers)], *rows])


def shield_table(*methods: str) -> str:
    """What a shield does to each method: success, decisions overridden, and time to the target."""
    tiers = [(tier["name"], tier["title"]) for tier in values("shield")["tiers"]]
    rows = []
    for method in methods:
        bare = [row("shield", method, tier) for tier, _ in tiers]
        kept = [row("shield", f"{method}+shield", tier) for tier, _ in tiers]
        rows.append([f"`{method}`, success, bare", *map(_success, bare)])
        rows.append(["in a shield", *map(_success, kept)])
        rows.append(["collisions in a shield", *(_interval(r["outcomes"]["collision"]) for r in kept)])
        if "overridden_by_drive" in kept[0]:
            rows.append(
                ["overridden in a drive [%]", *(_cell(_percent(_quantity(r, "overridden_by_drive"))) for r in kept)]
            )
        rows.append(["of all decisions [%]", *(_cell(_percent(_quantity(r, "overridden"))) for r in kept)])
        rows.append(["time to the target [s]", *(_cell(_quantity(r, "time")) for r in kept)])
    head = ["", *(title for _, title in tiers)]
    return _table([head, ["---", *("--:" for _ in tiers)], *rows])


def _cell(three: list[float | None]) -> str:
    value, low, high = three
    return f"{value:.1f}" if low is None or high is None else f"{value:.1f} ({low:.1f}-{high:.1f})"


def conditions_table() -> str:
    """The table of results/conditions."""
    text = (RESULTS / "conditions" / "conditions.md").read_text(encoding="utf-8")
    table = "\n".join(line for line in text.splitlines() if line.startswith("|"))
    for name, title in COVERS.items():
        table = table.replace(f"| {name} |", f"| {title} |", 1)
    return table


def _entry(folder: str, factor: str, label: str) -> dict[str, Any]:
    """A variant of an ablation.

    Raises:
        LookupError: If the results do not hold it.
    """
    for entry in values(folder, "ablation.json")["entries"]:
        if (entry["factor"], entry["variant"]) == (factor, label):
            return dict(entry)
    raise LookupError(f"results/{folder} holds no variant '{label}' of '{factor}'")


def difference(folder: str, factor: str, *variant: str) -> str:
    """What a variant of an ablation changes, in points of success, with its 95 % interval and what it shows."""
    entry, seeds = _entry(folder, factor, " ".join(variant)), values(folder, "ablation.json")["seeds"]
    value, low, high = _percent(entry["difference"])
    interval = f"{seeds} seeds" if low is None or high is None else f"{low:+.1f} to {high:+.1f}"
    return f"{value:+.1f} points ({interval}; {entry['verdict']})"


def ablation_success(folder: str, factor: str, world: str, *variant: str) -> str:
    """The success of a variant of an ablation in one kind of world, with its 95 % interval."""
    entry, seeds = _entry(folder, factor, " ".join(variant)), values(folder, "ablation.json")["seeds"]
    return _in_words(_percent(entry["success"][world]), " %", missing=f"{seeds} seeds")


def ablation_power(folder: str) -> str:
    """Whether an ablation can carry a verdict, and what difference it could have seen."""
    found = values(folder, "ablation.json")
    rivals = [entry for entry in found["entries"] if entry["verdict"] != "default"]
    about = f"This study has {found['seeds']} seeds and {len(rivals)} comparisons"
    if any(entry["verdict"] == "exploratory" for entry in rivals):
        return f"{about}, too few seeds for a verdict: it is exploratory."
    seen = sorted(100 * entry["detectable"] for entry in rivals)
    return f"{about}; it could have seen differences of {seen[0]:.1f} to {seen[-1]:.1f} points, by variant."


def section(folder: str, *title: str) -> str:
    """A section of a generated report, without its heading."""
    name = "ablation.md" if folder.startswith("ablation") else "evaluation.md"
    text = (RESULTS / folder / name).read_text(encoding="utf-8")
    found = re.search(rf"(?ms)^## {re.escape(' '.join(title))}\n+(.*?)(?=^## |\Z)", text)
    if not found:
        raise LookupError(f"results/{folder} has no section '{' '.join(title)}'")
    return found[1].strip()


def results_list() -> str:
    """A table of the generated reports."""
    rows = [
        [f"[{title}]({folder}/index.md)", about, f"`{_script(part)}`"] for folder, (title, about, part) in PAGES.items()
    ]
    return _table([["report", "what it holds", "made by"], ["---"] * 3, *rows])


def _script(part: str) -> str:
    return part if part.endswith(".py") else f"results.py --only {part}"


def narrowed(markdown: str) -> str:
    """Tables with each interval below its value, so that many columns fit."""
    value = r"(?<=\| )([-+]?\d+\.\d+) \(([^()|]*\d[^()|]*)\)(?= \|)"
    lines = markdown.splitlines()
    return "\n".join(re.sub(value, r"\1 <span class=ci>\2</span>", s) if s.startswith("|") else s for s in lines)


def report(folder: str) -> str:
    """A generated report as a page of the site."""
    (path,) = (RESULTS / folder).glob("*.md")
    title, _, part = PAGES[folder]
    body = path.read_text(encoding="utf-8").partition("\n")[2].strip()
    made = f"Generated. `python scripts/{_script(part)}` makes it; it is not edited by hand."
    return f'# {title}\n\n!!! note ""\n    {made}\n\n{body}\n'


def readme_table() -> str:
    """The small table of the README: the paper's network, the best rules, and what goes beyond the paper."""
    methods = ("straight", "hand_rule", "literal", "paper", "tuned", "vfh", "double_dqn", "distilled")
    return success_table("covers", *methods)


def _table(rows: list[list[str]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in rows)
