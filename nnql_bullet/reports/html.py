"""Writes an HTML page about some runs; it contains its pictures and needs no network."""

import json
import platform
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
from nnql_bullet.config import dotted, to_values
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.failures import features
from nnql_bullet.evaluation.policies import Policy
from nnql_bullet.evaluation.statistics import Estimate
from nnql_bullet.files import plain_file, read_json
from nnql_bullet.machine import allowed_cores
from nnql_bullet.presets import load_config
from nnql_bullet.recording import Recording, load_recording
from nnql_bullet.reports.document import Report
from nnql_bullet.reports.drawing import DPI
from nnql_bullet.reports.evaluation import FAILURES
from nnql_bullet.reports.failures import draw_sheet, varied
from nnql_bullet.reports.player import player_text
from nnql_bullet.reports.plots import draw_success, draw_trajectory
from nnql_bullet.runs import LEARNING_CURVE, Run
from nnql_bullet.text import shell_line
from nnql_bullet.training.base import RECENT

TEMPLATE = "report.html.j2"
PLAYER = "player.js"
PLAYED = 4
"""Largest number of failures of a group on the page; each makes the file larger."""
LIBRARIES = ("numpy", "scipy", "numba", "torch", "gymnasium", "pybullet", "mujoco", "trimesh", "yourdfpy", "matplotlib")
"""Libraries that results may depend on."""
CSS_DPI = 96
"""CSS pixels per inch."""

Verb = Literal["evaluate", "gap"]
_FILES: dict[Verb, str] = {"evaluate": "results.json", "gap": "gap.json"}
_REPORT = TypeAdapter(Report)


@dataclass(frozen=True, slots=True)
class Failure:
    """A recorded drive that failed."""

    title: str
    recording: Path
    replay: str
    """Command that repeats the drive."""
    place: tuple[str, str]
    """Policy and world."""


@dataclass(frozen=True, slots=True)
class FailureGroup:
    """Failures of one group."""

    name: str
    about: str
    failures: list[Failure]


@dataclass(frozen=True, slots=True)
class FailureGroups:
    """Results of `failures` for the policies of a page."""

    command: str
    """Command that repeats them."""
    most: int
    """Largest number of repeated failures of each method in each kind of world."""
    groups: list[FailureGroup]


@dataclass(frozen=True, slots=True)
class Results:
    """Results of `evaluate` or `gap` for the policies of a page."""

    folder: Path
    version: str
    """Version of the program that wrote them."""
    command: str
    """Command that repeats them, without the folder."""
    report: Report
    absent: list[str]
    """Policies of the page that the results do not contain."""
    methods: dict[str, list[str]]
    """Policies of the page by their method in an evaluation."""
    success: list[tuple[str, str, Estimate]]
    """Method, worlds and success of the page's policies, in an evaluation."""
    failures: list[Failure]
    """Failures of the page's policies, in an evaluation."""
    grouped: FailureGroups | None
    """Groups of these failures, if `failures` made them."""


def open_results(verb: Verb, folder: Path, policies: Sequence[Policy]) -> Results | None:
    """Reads the results of a verb for policies in their present state.

    Returns:
        None if there are no results of these policies.

    Raises:
        UserError: If the results are damaged.
    """
    file = folder / _FILES[verb]
    if not file.is_file():
        return None
    try:
        values = read_json(file)
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
    """Selects the failures of these policies from a list in a file."""
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
    sorted_out = read_json(file)
    groups = [
        FailureGroup(group["name"], group["about"], its)
        for group in sorted_out["groups"]
        if (its := _failures(group["failures"], values, driving, folder))
    ]
    most = sorted_out["most"]
    return FailureGroups(f"{failures_command(folder)} --most {most}", most, groups)


def failures_command(results: Path) -> str:
    """Returns the command that groups the failures of an evaluation."""
    return shell_line("nnql-bullet", "failures", str(results))


def page(
    runs: Sequence[Run], policies: Sequence[Policy], evaluation: Results | None, gap: Results | None, again: str
) -> str:
    """Renders the page.

    Args:
        runs: Training runs.
        policies: Policies of the runs, in the same order.
        evaluation: Results of `evaluate`, if any.
        gap: Results of `gap`, if any.
        again: Command that makes the page.

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
        make={verb: shell_line("nnql-bullet", verb, *paths) for verb in _FILES},
        commands=[
            *(_training_command(run) for run, _ in pairs),
            *(f"{its.command} --out {shell_line(str(its.folder))}" for its in (evaluation, gap) if its),
            *([evaluation.grouped.command] if evaluation and evaluation.grouped else []),
            again,
        ],
        recent=RECENT,
    )


def _run_row(run: Run, policy: Policy) -> dict[str, Any]:
    """Returns the cells of a run."""
    goals = [episode.summary.ending == "goal" for episode in run.episodes[-RECENT:]]
    return {
        "name": policy.name,
        "recipe": policy.method,
        "config": run.config,
        "episodes": len(run.episodes),
        "success": f"{100 * sum(goals) / len(goals):.0f}" if goals else "-",
        "resume": shell_line("nnql-bullet", "train", "--resume", str(run.folder)),
    }


def _settings(pairs: Sequence[tuple[Run, Policy]]) -> dict[str, Any]:
    """Returns every key of the configurations by recipe, beside the preset `paper`."""
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


def _flat(values: Mapping[str, Any]) -> dict[str, str]:
    """Returns nested values under dotted names, as text."""
    return {name: its if isinstance(its, str) else json.dumps(its) for name, its in dotted(values).items()}


def _versions() -> list[tuple[str, str]]:
    """Returns the versions of the program and its libraries, and the kind of machine without its name or paths."""
    machine = f"{platform.system()}, {platform.machine()}, {allowed_cores()} cores"
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
    """Returns the command that repeats a training."""
    preset, flags = train_arguments(run.config)
    return shell_line("nnql-bullet", "train", "--config", preset, *flags, "--out", str(run.folder))


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
    """Returns the contact sheet of a group, and drives for the player."""
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
    """Returns an HTML element with the picture that a function draws, in 256 colours to save space."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "picture.png"
        draw(path)
        with Image.open(path) as picture:
            few = picture.convert("RGB").quantize(256)
        few.save(path, optimize=True)
        return _image(path, alt)


def _image(path: Path, alt: str) -> Markup:
    """Returns an HTML element that holds a picture.

    Args:
        path: Path of a PNG file.
        alt: Description for readers who do not see the picture.

    Raises:
        UserError: If the file is missing or not a PNG.
    """
    try:
        with Image.open(plain_file(path), formats=["PNG"]) as picture:
            width, height = (round(CSS_DPI / DPI * count) for count in picture.size)
    except (OSError, UnidentifiedImageError):
        again = "make it again with the command that left it"
        raise UserError(f"{path}: is missing or not a PNG picture; {again}") from None
    uri = f"data:image/png;base64,{b64encode(path.read_bytes()).decode()}"
    return Markup('<img src="{}" width="{}" height="{}" alt="{}">').format(uri, width, height, alt)


def _inline(text: str) -> Markup:
    """Converts text with code between backticks to HTML."""
    parts = text.split("`")
    return Markup("").join(
        Markup("<code>{}</code>").format(part) if number % 2 else escape(part) for number, part in enumerate(parts)
    )
