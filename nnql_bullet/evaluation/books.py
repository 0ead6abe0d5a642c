"""Books of choices: what each asks, the alternatives, and what they are trained and tested with.

Each alternative departs from a book's preset in one thing.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from nnql_bullet.experiment import PRESETS


@dataclass(frozen=True)
class Alternative:
    """One way to answer a choice."""

    label: str
    changes: Mapping[str, Any]
    """To the preset; none for the default."""


@dataclass(frozen=True)
class Choice:
    """A point that the paper leaves open, a number that it states, or a part of a method."""

    name: str
    question: str
    section: str
    """Of the paper; "-" where it has none about it."""
    alternatives: tuple[Alternative, ...]
    """The default among them is the one without changes."""
    stated: bool = False
    """Whether the paper states the default."""


@dataclass(frozen=True)
class Book:
    """The choices behind a preset."""

    preset: str
    title: str
    tiers: Mapping[str, str]
    """World files that policies are tested in, and how they are called."""
    choices: tuple[Choice, ...]
    """In the order of the table."""
    episodes: int
    """Of a training, unless another number is asked for."""
    seeds: int
    """Trainings of each alternative, likewise."""
    base: Mapping[str, Any] = field(default_factory=dict)
    """Changes to the preset that all trainings share."""
    not_varied: str = ""
    """What it has no choices about, for the report."""


def _drive(**values: Any) -> dict[str, Any]:
    return {"drive": values}


def _task(**values: Any) -> dict[str, Any]:
    return {"task": values}


def _agent(**values: Any) -> dict[str, Any]:
    return {"agent": values}


_DEFAULT: dict[str, Any] = {}


def _alternatives(*pairs: tuple[str, Mapping[str, Any]]) -> tuple[Alternative, ...]:
    return tuple(Alternative(label, changes) for label, changes in pairs)


_PAPER = (
    Choice(
        "period",
        "how long is one step",
        "II.C",
        _alternatives(
            ("0.25 s", _drive(decision_period=0.25)),
            ("0.5 s", _DEFAULT),
            ("0.75 s", _drive(decision_period=0.75)),
            ("1 s", _drive(decision_period=1.0)),
        ),
    ),
    Choice(
        "front",
        "non-safe: front sector below",
        "II.C",
        _alternatives(
            ("3.5 m", _task(front_distance=3.5)),
            ("4.25 m", _task(front_distance=4.25)),
            ("5 m", _DEFAULT),
            ("6 m", _task(front_distance=6.0)),
            ("7 m", _task(front_distance=7.0)),
        ),
    ),
    Choice(
        "front_sides",
        "non-safe: front sides below",
        "II.C",
        _alternatives(
            ("1.75 m", _task(front_side_distance=1.75)),
            ("2.5 m", _task(front_side_distance=2.5)),
            ("3.5 m", _DEFAULT),
            ("4.25 m", _task(front_side_distance=4.25)),
            ("5 m", _task(front_side_distance=5.0)),
        ),
    ),
    Choice(
        "others",
        "non-safe: other sectors below",
        "II.C",
        _alternatives(
            ("not asked", _DEFAULT),
            ("2 m", _task(other_distance=2.0)),
            ("all eight 4 m", _task(front_distance=4.0, front_side_distance=4.0, other_distance=4.0)),
        ),
    ),
    Choice(
        "hysteresis",
        "safe again: farther by",
        "II.C",
        _alternatives(("0 m", _DEFAULT), ("1 m", _task(hysteresis=1.0))),
    ),
    Choice(
        "reading",
        "a sensor reads",
        "II.A",
        _alternatives(("the nearest of 9 rays", _DEFAULT), ("its middle ray", _task(sector_reading="middle"))),
    ),
    Choice(
        "encoding",
        "no obstacle is d = 0",
        "II.B",
        _alternatives(("1 - d/10", _DEFAULT), ("d/10, 0 if none", _agent(encoding="distance"))),
    ),
    Choice(
        "reward",
        "reward, non-safe to safe (illegible)",
        "II.C",
        _alternatives(
            ("0.2", _task(reward_non_safe_to_safe=0.2)),
            ("0.4", _DEFAULT),
            ("1", _task(reward_non_safe_to_safe=1.0)),
        ),
    ),
    Choice(
        "closer",
        "closer to the obstacles: what fell",
        "II.C",
        _alternatives(("the smallest reading", _DEFAULT), ("the mean reading", _task(closer="mean"))),
    ),
    Choice(
        "step",
        "step of gradient descent",
        "III.B",
        _alternatives(
            ("0.1", _agent(gradient_step=0.1)),
            ("0.4", _DEFAULT),
            ("1.5", _agent(gradient_step=1.5)),
            ("5", _agent(gradient_step=5.0)),
            ("15", _agent(gradient_step=15.0)),
        ),
    ),
    Choice(
        "schedule",
        "how the temperature falls",
        "II.E",
        _alternatives(
            ("linearly", _DEFAULT),
            ("linearly, by episode 600", _agent(schedule_episodes=600)),
            ("exponentially", _agent(schedule="exponential")),
        ),
    ),
    Choice(
        "safe_steps",
        "safe steps teach the network",
        "III.C",
        _alternatives(("no", _DEFAULT), ("yes", _agent(learn_in_safe_states=True))),
    ),
    Choice(
        "weights",
        "initial weights: hidden, output",
        "III.B",
        _alternatives(
            ("1, 0.1", _DEFAULT),
            ("0.3, 0.1", _agent(hidden_weights=0.3)),
            ("3, 0.1", _agent(hidden_weights=3.0)),
            ("1, 1", _agent(output_weights=1.0)),
        ),
    ),
    Choice(
        "cover",
        "boxes in training",
        "IV",
        _alternatives(
            ("2.5 % cover", {"world": "cover_2.5"}),
            ("5 % cover", _DEFAULT),
            ("7.5 % cover", {"world": "cover_7.5"}),
            ("10 % cover", {"world": "cover_10"}),
        ),
    ),
    Choice(
        "vehicles",
        "vehicles that learn at once",
        "-",
        _alternatives(("1", {"vehicles": 1}), ("8", {"vehicles": 8}), ("64", _DEFAULT)),
    ),
    Choice(
        "discount",
        "discount",
        "IV",
        _alternatives(
            ("0", _agent(discount=0.0)),
            ("0.15", _DEFAULT),
            ("0.5", _agent(discount=0.5)),
            ("0.9", _agent(discount=0.9)),
        ),
        stated=True,
    ),
    Choice(
        "temperature",
        "temperature",
        "IV",
        _alternatives(
            ("0.8 to 0.01", _DEFAULT),
            (
                "0.2 to 0.03, exponentially, by episode 600",
                _agent(temperature_max=0.2, temperature_min=0.03, schedule="exponential", schedule_episodes=600),
            ),
        ),
        stated=True,
    ),
    Choice(
        "hidden",
        "hidden units",
        "IV",
        _alternatives(("3", _agent(hidden_units=3)), ("6", _DEFAULT), ("12", _agent(hidden_units=12))),
        stated=True,
    ),
    Choice(
        "steps",
        "steps in an episode",
        "IV.A",
        _alternatives(("250", _task(max_steps=250)), ("500", _DEFAULT)),
        stated=True,
    ),
    Choice(
        "letter",
        "all open points at once",
        "-",
        _alternatives(("preset paper", _DEFAULT), ("preset literal", PRESETS["literal"])),
    ),
)


_TUNED = (
    Choice(
        "selection",
        "the policy is",
        "-",
        _alternatives(
            ("the best of 8 late states", _DEFAULT),
            ("the last state", {"training": {"selection": {"candidates": 1}}}),
        ),
    ),
    Choice(
        "temperature",
        "temperature",
        "IV",
        _alternatives(
            ("0.8 to 0.01, as stated", _agent(temperature_max=0.8, temperature_min=0.01)),
            ("0.8 to 0.1", _agent(temperature_max=0.8)),
            ("0.4 to 0.1", _DEFAULT),
        ),
    ),
    Choice(
        "discount",
        "discount",
        "IV",
        _alternatives(("0", _agent(discount=0.0)), ("0.15, as stated", _DEFAULT), ("0.5", _agent(discount=0.5))),
    ),
    Choice(
        "cover",
        "boxes in training",
        "IV",
        _alternatives(
            ("5 % cover, as in the paper", {"world": "paper"}),
            ("7.5 % cover", _DEFAULT),
            ("10 % cover", {"world": "cover_10"}),
        ),
    ),
    Choice(
        "period",
        "how long is one step",
        "II.C",
        _alternatives(
            ("0.5 s", _drive(decision_period=0.5)),
            ("0.6 s", _DEFAULT),
            ("0.75 s", _drive(decision_period=0.75)),
            ("1 s", _drive(decision_period=1.0)),
        ),
    ),
    Choice(
        "front",
        "non-safe: front sector below",
        "II.C",
        _alternatives(("4.5 m", _task(front_distance=4.5)), ("5 m", _DEFAULT), ("5.5 m", _task(front_distance=5.5))),
    ),
    Choice(
        "front_sides",
        "non-safe: front sides below",
        "II.C",
        _alternatives(
            ("3 m", _task(front_side_distance=3.0)),
            ("3.5 m", _DEFAULT),
            ("4 m", _task(front_side_distance=4.0)),
        ),
    ),
    Choice(
        "mirror",
        "a step teaches its mirror image too",
        "-",
        _alternatives(("no", _agent(mirrored=False)), ("yes", _DEFAULT)),
    ),
    Choice(
        "vehicles",
        "vehicles that learn at once",
        "-",
        _alternatives(("1", {"vehicles": 1}), ("64", _DEFAULT)),
    ),
)

_UNDISTURBED = {"start_yaw": False, "noise": 0.0, "dead_sector": 0.0, "turn_scale": 0.0, "turn_noise_degrees": 0.0}

_DOUBLE_DQN = (
    Choice(
        "map",
        "a map of what was seen",
        "-",
        _alternatives(("kept", _DEFAULT), ("none", _agent(seen_map=False))),
    ),
    Choice(
        "rays",
        "readings that the 72 rays are told as",
        "-",
        _alternatives(("8", _agent(rays=8)), ("24", _DEFAULT), ("72", _agent(rays=72))),
    ),
    Choice(
        "frames",
        "moments seen at once",
        "-",
        _alternatives(("1", _agent(frames=1)), ("3", _DEFAULT)),
    ),
    Choice(
        "worlds",
        "worlds of training",
        "-",
        _alternatives(("a mix of all kinds", _DEFAULT), ("10 % cover", {"training": {"worlds": ["cover_10"]}})),
    ),
    Choice(
        "disturbances",
        "noise, dead sectors, turns that miss, any start heading",
        "-",
        _alternatives(("in training", _DEFAULT), ("none", {"training": {"disturbances": _UNDISTURBED}})),
    ),
    Choice(
        "returns",
        "steps of returns",
        "-",
        _alternatives(("1", _agent(steps=1)), ("3", _DEFAULT)),
    ),
    Choice(
        "mirror",
        "left for right in half of what is learned from",
        "-",
        _alternatives(("yes", _DEFAULT), ("no", _agent(mirrored=False))),
    ),
    Choice(
        "reward",
        "reward",
        "-",
        _alternatives(
            ("progress, steps, turns, nearness", _DEFAULT), ("that and the paper's", _agent(paper_share=1.0))
        ),
    ),
)

BOOKS = {
    book.preset: book
    for book in (
        Book(
            preset="paper",
            title="What the paper leaves open",
            tiers={"paper": "5 % cover", "cover_10": "10 % cover"},
            choices=_PAPER,
            episodes=1000,
            seeds=10,
            not_varied=(
                "linear outputs (targets reach -0.6, which no sigmoid does); what belongs to the vehicle and its task, "
                "as the turn toward the target within its limits, its size, the start heading, the target's radius, "
                "and walls that are sensed like obstacles"
            ),
        ),
        Book(
            preset="tuned",
            title="What tuned is made of",
            tiers={"paper": "5 % cover", "cover_10": "10 % cover", "cover_15": "15 % cover"},
            choices=_TUNED,
            episodes=1000,
            seeds=5,
        ),
        Book(
            preset="double_dqn",
            title="What double_dqn is made of",
            tiers={
                "cover_10": "10 % cover",
                "cover_15": "15 % cover",
                "cover_20": "20 % cover",
                "traps": "traps",
                "aisles": "aisles",
                "moving": "moving",
            },
            choices=_DOUBLE_DQN,
            episodes=4000,
            seeds=2,
            base=_agent(schedule_episodes=4000),
        ),
    )
}
"""By their presets."""
