"""Everything that is known of some runs as one HTML page: pictures are in it, and it asks nothing from a network."""

import json
import os
import platform
import shlex
from base64 import b64encode
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape
from PIL import Image, UnidentifiedImageError
from pydantic import TypeAdapter

from nnql_bullet import __version__, colours
from nnql_bullet.commands import train_arguments
from nnql_bullet.config import to_values
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.failures import features
from nnql_bullet.evaluation.policies import Policy
from nnql_bullet.evaluation.statistics import Estimate
from nnql_bullet.presets import load_config
from nnql_bullet.recording import Recording, load_recording
from nnql_bullet.reports.document import Report
from nnql_bullet.reports.drawing import DPI
from nnql_bullet.reports.evaluation import FAILURES
from nnql_bullet.reports.failures import draw_sheet, varied
from nnql_bullet.reports.player import player_text
from nnql_bullet.reports.plots import draw_success, draw_trajectory
from nnql_bullet.runs import LEARNING_CURVE, Run
from nnql_bullet.training.base import RECENT

TEMPLATE = "report.html.j2"
PLAYER = "player.js"
PLAYED = 4
"""Most failures of a group that the page shows: each costs it up to 50 kB."""
LIBRARIES = ("numpy", "scipy", "numba", "torch", "gymnasium", "pybullet", "mujoco", "trimesh", "yourdfpy", "matplotlib")
"""That results may depend on."""
CSS_DPI = 96
"""Units of a page to the inch."""

Verb = Literal["evaluate", "gap"]
_FILES: dict[Verb, str] = {"evaluate": "results.json", "gap": "gap.json"}
_REPORT = TypeAdapter(Report)


@dataclass(frozen=True, slots=True)
class Failure:
    """A drive that failed, and was recorded."""

    title: str
    recording: Path
    replay: str
    """The command that drives it again."""
    place: tuple[str, str]
    """Policy and world."""


@dataclass(frozen=True, slots=True)
class FailureGroup:
    """Failures that look alike."""

    name: str
    about: str
    failures: list[Failure]


@dataclass(frozen=True, slots=True)
class FailureGroups:
    """What `failures` left of the policies of a page."""

    command: str
    """That makes it again."""
    most: int
    """Failures of each method in each kind of world that were driven again."""
    groups: list[FailureGroup]


@dataclass(frozen=True, slots=True)
class Results:
    """What `evaluate` or `gap` left of the policies of a page."""

    folder: Path
    version: str
    """Of the program that left it."""
    command: str
    """That makes it again, but for the folder."""
    report: Report
    absent: list[str]
    """The policies of the page that do not drive in it."""
    methods: dict[str, list[str]]
    """Those that do by what they are called in it, if it is an evaluation."""
    success: list[tuple[str, str, Estimate]]
    """Of those that do, if it is an evaluation: method, worlds, share."""
    failures: list[Failure]
    """Of those that do, if it is an evaluation."""
    grouped: FailureGroups | None
    """Likewise, if `failures` sorted them."""


def open_results(verb: Verb, folder: Path, policies: Sequence[Policy]) -> Results | None:
    """Reads what a verb left of policies as they are now.

    Returns:
        None if there is nothing, or nothing of them.

    Raises:
        UserError: If it is damaged.
    """
    file = folder / _FILES[verb]
    if not file.is_file():
        return None
    try:
        values = json.loads(file.read_text(encoding="utf-8"))
        there = {policy["fingerprint"]: policy for policy in values.get("policies", ())}
        driving = [there[policy.fingerprint] for policy in policies if policy.fingerprint in there]
        if not driving:
            return None
        methods: dict[str, list[str]] = {}
        for policy in policies:
            if "method" in there.get(policy.fingerprint, {}):
                methods.setdefault(there[policy.fingerprint]["method"], []).append(policy.name)
        return Results(
            folder=folder,
            version=values["version"],
            command=values["command"],
            report=_REPORT.validate_python(values["report"]),
            absent=[policy.name for policy in policies if policy.fingerprint not in there],
            methods=methods,
            success=_success(values, methods),
            failures=_failures(values.get("failures", ()), values, driving, folder),
            grouped=_grouped(values, driving, folder),
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise UserError(f"{folder}: results are damaged ({reason}); make them again: nnql-bullet {verb}") from None


def _success(values: Mapping[str, Any], methods: Collection[str]) -> list[tuple[str, str, Estimate]]:
    titles = {tier["name"]: tier["title"] for tier in values.get("tiers", ())}
    found = []
    for row in values.get("rows", ()):
        if row["method"] in methods:
            name = row["method"] if row["policies"] == 1 else f"{row['method']}, {row['policies']} seeds"
            share = Estimate(*(row["over_seeds"] or row["outcomes"]["goal"]))
            found.append((name, titles.get(row["world"], row["world"]), share))
    return found


def _failures(
    failures: Sequence[Mapping[str, Any]],
    values: Mapping[str, Any],
    driving: Sequence[Mapping[str, Any]],
    folder: Path,
) -> list[Failure]:
    """Those of the policies that drive, of some that a file lists."""
    names = {policy.get("name") for policy in driving}
    titles = {tier["name"]: tier["title"] for tier in values.get("tiers", ())}
    return [
        Failure(
            title=f"{one['policy']} in {titles[one['world']]}, seed {one['seed']}",
            recording=folder / one["recording"],
            replay=one["replay"],
            place=(one["policy"], one["world"]),
        )
        for one in failures
        if one["policy"] in names
    ]


def _grouped(values: Mapping[str, Any], driving: Sequence[Mapping[str, Any]], folder: Path) -> FailureGroups | None:
    file = folder / "failures" / "failures.json"
    if not file.is_file():
        return None
    sorted_out = json.loads(file.read_text(encoding="utf-8"))
    groups = [
        FailureGroup(group["name"], group["about"], its)
        for group in sorted_out["groups"]
        if (its := _failures(group["failures"], values, driving, folder))
    ]
    most = sorted_out["most"]
    return FailureGroups(f"{failures_command(folder)} --most {most}", most, groups)


def failures_command(results: Path) -> str:
    """The command that sorts the failures of an evaluation."""
    return shlex.join(["nnql-bullet", "failures", str(results)])


def page(
    runs: Sequence[Run], policies: Sequence[Policy], evaluation: Results | None, gap: Results | None, again: str
) -> str:
    """The page.

    Args:
        runs: What was trained.
        policies: What they learned, in the same order.
        evaluation: What `evaluate` found of them, if anything.
        gap: What `gap` found of them, if anything.
        again: The command that makes the page.

    Raises:
        UserError: If a picture or recording is damaged.
    """
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    pairs = list(zip(runs, policies, strict=True))
    paths = [str(run.folder) for run in runs]
    player = (Path(__file__).parent / PLAYER).read_text(encoding="utf-8")
    return environment.get_template(TEMPLATE).render(
        runs=[_run_row(run, policy) for run, policy in pairs],
        **_settings(pairs),
        versions=_versions(),
        success_curves=_success_curves(pairs),
        curves=[_curve(run, policy) for run, policy in pairs],
        evaluation=evaluation,
        left_out=FAILURES,
        inline=_inline,
        picture=_image,
        palettes={"light": colours.PAGE_LIGHT, "dark": colours.PAGE_DARK, "print": colours.PAGE_PRINT},
        failures=[
            (failure, load_recording(failure.recording)) for failure in (evaluation.failures if evaluation else ())
        ],
        sort_failures=evaluation and failures_command(evaluation.folder),
        trajectory=_trajectory,
        groups=[_group(group) for group in evaluation.grouped.groups] if evaluation and evaluation.grouped else None,
        played=PLAYED,
        player=Markup(player),
        player_hash=b64encode(sha256(player.encode()).digest()).decode(),
        gap=gap,
        make={verb: shlex.join(["nnql-bullet", verb, *paths]) for verb in _FILES},
        commands=[
            *(_training_command(run) for run, _ in pairs),
            *(f"{its.command} --out {shlex.quote(str(its.folder))}" for its in (evaluation, gap) if its),
            *([evaluation.grouped.command] if evaluation and evaluation.grouped else []),
            again,
        ],
        recent=RECENT,
    )


def _run_row(run: Run, policy: Policy) -> dict[str, Any]:
    """What is said of a run in one line."""
    goals = [episode.summary.ending == "goal" for episode in run.episodes[-RECENT:]]
    return {
        "name": policy.name,
        "recipe": policy.method,
        "config": run.config,
        "episodes": len(run.episodes),
        "success": f"{100 * sum(goals) / len(goals):.0f}" if goals else "-",
        "resume": shlex.join(["nnql-bullet", "train", "--resume", str(run.folder)]),
    }


def _settings(pairs: Sequence[tuple[Run, Policy]]) -> dict[str, Any]:
    """Every key of the configurations, recipe by recipe, beside the preset `paper`."""
    recipes: dict[str, list[dict[str, str]]] = {}
    for run, policy in pairs:
        recipes.setdefault(policy.method, []).append(_flat(to_values(run.config)))
    paper = _flat(to_values(load_config("paper", {})))
    keys = dict.fromkeys(key for values in (paper, *(one for its in recipes.values() for one in its)) for key in values)
    unset = "not set"
    return {
        "recipes": list(recipes),
        "settings": [
            (
                key,
                paper.get(key, unset),
                [", ".join(dict.fromkeys(one.get(key, unset) for one in its)) for its in recipes.values()],
            )
            for key in keys
        ],
    }


def _flat(values: Mapping[str, Any], above: str = "") -> dict[str, str]:
    """Nested values under dotted names, as they print."""
    flat: dict[str, str] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{above}{key}.")
        else:
            flat[above + key] = value if isinstance(value, str) else json.dumps(value)
    return flat


def _versions() -> list[tuple[str, str]]:
    """Of what made the page, and the kind of machine: neither its name nor any path of it."""
    machine = f"{platform.system()}, {platform.machine()}, {os.cpu_count()} cores"
    return [
        ("nnql-bullet", __version__),
        ("Python", f"{platform.python_implementation()} {platform.python_version()}"),
        *((name, _version(name)) for name in LIBRARIES),
        ("machine", machine),
    ]


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "not installed"


def _training_command(run: Run) -> str:
    """The command that trains a run again."""
    preset, flags = train_arguments(run.config)
    return shlex.join(["nnql-bullet", "train", "--config", preset, *flags, "--out", str(run.folder)])


def _success_curves(pairs: Sequence[tuple[Run, Policy]]) -> Markup | None:
    recipes: dict[str, dict[str, Any]] = {}
    for run, policy in pairs:
        if run.episodes:
            recipes.setdefault(policy.method, {})[policy.name] = run.episodes
    if not recipes:
        return None
    names = ", ".join(name for its in recipes.values() for name in its)
    return _drawn(lambda path: draw_success(recipes, path), f"Success over training episodes: {names}")


def _curve(run: Run, policy: Policy) -> tuple[str, Markup | None]:
    path = run.folder / LEARNING_CURVE
    alt = f"How the training episodes of {policy.name} ended, their return and path length, over episodes"
    return policy.name, _image(path, alt) if path.is_file() else None


def _group(group: FailureGroup) -> dict[str, Any]:
    """What is shown of a group: its contact sheet, and drives to be played."""
    shown = varied(group.failures, [failure.place for failure in group.failures], PLAYED)
    recordings = [load_recording(failure.recording) for failure in shown]
    drives = [
        (failure.title, recording, features(recording)) for failure, recording in zip(shown, recordings, strict=True)
    ]
    alt = f"{group.name}: paths of {'; '.join(failure.title for failure in shown)}"
    return {
        "name": group.name,
        "about": group.about,
        "count": len(group.failures),
        "sheet": _drawn(lambda path: draw_sheet(drives, path), alt),
        "drives": [
            (failure, recording, Markup(player_text(recording, failure.title)))
            for failure, recording in zip(shown, recordings, strict=True)
        ],
    }


def _trajectory(recording: Recording, title: str) -> Markup:
    return _drawn(lambda path: draw_trajectory(recording, path), f"Path of {title}: {recording.about['ending']}")


def _drawn(draw: Callable[[Path], None], alt: str) -> Markup:
    """What a function draws, as an element; in 256 colours, which are enough and take a third of the room."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "picture.png"
        draw(path)
        with Image.open(path) as picture:
            few = picture.convert("RGB").quantize(256)
        few.save(path, optimize=True)
        return _image(path, alt)


def _image(path: Path, alt: str) -> Markup:
    """A picture as an element that holds it.

    Args:
        path: Of a PNG file.
        alt: What it shows, for those who do not see it.

    Raises:
        UserError: If it is not there, or not a PNG.
    """
    try:
        with Image.open(path, formats=["PNG"]) as picture:
            width, height = (round(CSS_DPI / DPI * count) for count in picture.size)
    except (OSError, UnidentifiedImageError):
        again = "make it again with the command that left it"
        raise UserError(f"{path}: is missing or not a PNG picture; {again}") from None
    uri = f"data:image/png;base64,{b64encode(path.read_bytes()).decode()}"
    return Markup('<img src="{}" width="{}" height="{}" alt="{}">').format(uri, width, height, alt)


def _inline(text: str) -> Markup:
    """Text in which code stands between backticks."""
    parts = text.split("`")
    return Markup("").join(
        Markup("<code>{}</code>").format(part) if number % 2 else escape(part) for number, part in enumerate(parts)
    )
