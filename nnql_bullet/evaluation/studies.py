"""Studies for ablations: the factors of each preset and their variants.

A variant changes one factor of the study's preset.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from nnql_bullet import paper
from nnql_bullet.config import departures, to_values
from nnql_bullet.presets import PRESETS


@dataclass(frozen=True)
class Variant:
    """One value of a factor."""

    label: str
    changes: Mapping[str, Any]
    """Changes to the preset; empty for the default."""


@dataclass(frozen=True)
class Factor:
    """A choice that the paper leaves open, a number that it states, or a part of a method."""

    name: str
    question: str
    section: str
    """Section of the paper; "-" if there is none."""
    variants: tuple[Variant, ...]
    """The variants; the default is the one without changes."""
    stated: bool = False
    """Whether the paper states the default."""


@dataclass(frozen=True)
class Study:
    """The factors of a preset."""

    preset: str
    title: str
    tiers: Mapping[str, str]
    """Titles of the test worlds, by world file."""
    factors: tuple[Factor, ...]
    """The factors in the order of the table."""
    episodes: int
    """Default number of episodes of a training."""
    seeds: int
    """Default number of trainings of each variant."""
    base: Mapping[str, Any] = field(default_factory=dict)
    """Changes to the preset that all trainings share."""
    asked: str = ""
    """What of `base` is asked for beside the study, in words."""
    not_varied: str = ""
    """Sentence for the report about choices without a factor."""


def _drive(**values: Any) -> dict[str, Any]:
    return {"drive": values}


def _task(**values: Any) -> dict[str, Any]:
    return {"task": values}


def _agent(**values: Any) -> dict[str, Any]:
    return {"agent": values}


_DEFAULT: dict[str, Any] = {}
_STATED_TEMPERATURE = f"{paper.TEMPERATURE_MAX:g} to {paper.TEMPERATURE_MIN:g}"
_LAST_STATE = {"training": {"selection": {"candidates": 1}}}
_LITERAL = departures(to_values(PRESETS["literal"]), to_values(PRESETS["paper"]))


def _variants(*pairs: tuple[str, Mapping[str, Any]]) -> tuple[Variant, ...]:
    return tuple(Variant(label, changes) for label, changes in pairs)


_PAPER = (
    Factor(
        "period",
        "how long is one step",
        "II.C",
        _variants(
            ("0.25 s", _drive(decision_period=0.25)),
            ("0.5 s", _DEFAULT),
            ("0.75 s", _drive(decision_period=0.75)),
            ("1 s", _drive(decision_period=1.0)),
        ),
    ),
    Factor(
        "front",
        "non-safe: front sector below",
        "II.C",
        _variants(
            ("3.5 m", _task(front_distance=3.5)),
            ("4.25 m", _task(front_distance=4.25)),
            ("5 m", _DEFAULT),
            ("6 m", _task(front_distance=6.0)),
            ("7 m", _task(front_distance=7.0)),
        ),
    ),
    Factor(
        "front_sides",
        "non-safe: front sides below",
        "II.C",
        _variants(
            ("1.75 m", _task(front_side_distance=1.75)),
            ("2.5 m", _task(front_side_distance=2.5)),
            ("3.5 m", _DEFAULT),
            ("4.25 m", _task(front_side_distance=4.25)),
            ("5 m", _task(front_side_distance=5.0)),
        ),
    ),
    Factor(
        "others",
        "non-safe: other sectors below",
        "II.C",
        _variants(
            ("not asked", _DEFAULT),
            ("2 m", _task(other_distance=2.0)),
            ("all eight 4 m", _task(front_distance=4.0, front_side_distance=4.0, other_distance=4.0)),
        ),
    ),
    Factor(
        "hysteresis",
        "safe again: farther by",
        "II.C",
        _variants(("0 m", _DEFAULT), ("1 m", _task(hysteresis=1.0))),
    ),
    Factor(
        "reading",
        "a sensor reads",
        "II.A",
        _variants(("the nearest of 9 rays", _DEFAULT), ("its middle ray", _task(sector_reading="middle"))),
    ),
    Factor(
        "encoding",
        "no obstacle is d = 0",
        "II.B",
        _variants(("1 - d/10", _DEFAULT), ("d/10, 0 if none", _agent(encoding="distance"))),
    ),
    Factor(
        "reward",
        "reward, non-safe to safe (illegible)",
        "II.C",
        _variants(
            ("0.2", _task(reward_non_safe_to_safe=0.2)),
            ("0.4", _DEFAULT),
            ("1", _task(reward_non_safe_to_safe=1.0)),
        ),
    ),
    Factor(
        "closer",
        "closer to the obstacles: what fell",
        "II.C",
        _variants(("the smallest reading", _DEFAULT), ("the mean reading", _task(closer="mean"))),
    ),
    Factor(
        "step",
        "step of gradient descent",
        "III.B",
        _variants(
            ("0.1", _agent(gradient_step=0.1)),
            ("0.4", _DEFAULT),
            ("1.5", _agent(gradient_step=1.5)),
            ("5", _agent(gradient_step=5.0)),
            ("15", _agent(gradient_step=15.0)),
        ),
    ),
    Factor(
        "schedule",
        "how the temperature falls",
        "II.E",
        _variants(
            ("linearly", _DEFAULT),
            ("linearly, by episode 600", _agent(schedule_episodes=600)),
            ("exponentially", _agent(schedule="exponential")),
        ),
    ),
    Factor(
        "safe_steps",
        "safe steps teach the network",
        "III.C",
        _variants(("no", _DEFAULT), ("yes", _agent(learn_in_safe_states=True))),
    ),
    Factor(
        "weights",
        "initial weights: hidden, output",
        "III.B",
        _variants(
            ("1, 0.1", _DEFAULT),
            ("0.3, 0.1", _agent(hidden_weights=0.3)),
            ("3, 0.1", _agent(hidden_weights=3.0)),
            ("1, 1", _agent(output_weights=1.0)),
        ),
    ),
    Factor(
        "cover",
        "boxes in training",
        "IV",
        _variants(
            ("2.5 % cover", {"world": "cover_2.5"}),
            ("5 % cover", _DEFAULT),
            ("7.5 % cover", {"world": "cover_7.5"}),
            ("10 % cover", {"world": "cover_10"}),
        ),
    ),
    Factor(
        "vehicles",
        "vehicles that learn at once",
        "-",
        _variants(("1", {"vehicles": 1}), ("8", {"vehicles": 8}), ("64", _DEFAULT)),
    ),
    Factor(
        "discount",
        "discount",
        "IV",
        _variants(
            ("0", _agent(discount=0.0)),
            (f"{paper.DISCOUNT:g}", _DEFAULT),
            ("0.5", _agent(discount=0.5)),
            ("0.9", _agent(discount=0.9)),
        ),
        stated=True,
    ),
    Factor(
        "temperature",
        "temperature",
        "IV",
        _variants(
            (_STATED_TEMPERATURE, _DEFAULT),
            (
                "0.2 to 0.03, exponentially, by episode 600",
                _agent(temperature_max=0.2, temperature_min=0.03, schedule="exponential", schedule_episodes=600),
            ),
        ),
        stated=True,
    ),
    Factor(
        "hidden",
        "hidden units",
        "IV",
        _variants(("3", _agent(hidden_units=3)), (f"{paper.HIDDEN_UNITS}", _DEFAULT), ("12", _agent(hidden_units=12))),
        stated=True,
    ),
    Factor(
        "steps",
        "steps in an episode",
        "IV.A",
        _variants(("250", _task(max_steps=250)), (f"{paper.STEPS_PER_EPISODE}", _DEFAULT)),
        stated=True,
    ),
    Factor(
        "letter",
        "all open points at once",
        "-",
        _variants(("preset paper", _DEFAULT), ("preset literal", _LITERAL)),
    ),
)


_TUNED = (
    Factor(
        "selection",
        "the policy is",
        "-",
        _variants(
            ("the best of 8 late states", _DEFAULT),
            ("the last state", _LAST_STATE),
        ),
    ),
    Factor(
        "temperature",
        "temperature",
        "IV",
        _variants(
            (f"{_STATED_TEMPERATURE}, as stated", _DEFAULT),
            (f"{paper.TEMPERATURE_MAX:g} to 0.1", _agent(temperature_min=0.1)),
            ("0.4 to 0.1", _agent(temperature_max=0.4, temperature_min=0.1)),
        ),
        stated=True,
    ),
    Factor(
        "discount",
        "discount",
        "IV",
        _variants(
            ("0", _agent(discount=0.0)), (f"{paper.DISCOUNT:g}, as stated", _DEFAULT), ("0.5", _agent(discount=0.5))
        ),
        stated=True,
    ),
    Factor(
        "cover",
        "boxes in training",
        "IV",
        _variants(
            ("5 % cover, as stated", _DEFAULT),
            ("7.5 % cover", {"world": "cover_7.5"}),
            ("10 % cover", {"world": "cover_10"}),
        ),
        stated=True,
    ),
    Factor(
        "period",
        "how long is one step",
        "II.C",
        _variants(
            ("0.5 s", _drive(decision_period=0.5)),
            ("0.6 s", _DEFAULT),
            ("0.75 s", _drive(decision_period=0.75)),
            ("1 s", _drive(decision_period=1.0)),
        ),
    ),
    Factor(
        "mirror",
        "a step teaches its mirror image too",
        "-",
        _variants(("no", _agent(mirrored=False)), ("yes", _DEFAULT)),
    ),
    Factor(
        "all",
        "all departures at once",
        "-",
        _variants(
            ("preset paper", _drive(decision_period=0.5) | _agent(mirrored=False) | _LAST_STATE),
            ("preset tuned", _DEFAULT),
        ),
    ),
)

_DOUBLE_DQN = (
    Factor(
        "map",
        "a map of what was seen",
        "-",
        _variants(("kept", _DEFAULT), ("none", _agent(grid_map=False))),
    ),
    Factor(
        "frames",
        "moments seen at once",
        "-",
        _variants(("1", _agent(frames=1)), ("3", _DEFAULT)),
    ),
)

STUDIES = {
    study.preset: study
    for study in (
        Study(
            preset="paper",
            title="What the paper leaves open",
            tiers={"paper": "5 % cover", "cover_10": "10 % cover"},
            factors=_PAPER,
            episodes=paper.EPISODES,
            seeds=12,
            not_varied=(
                "linear outputs (targets reach -0.6, which no sigmoid does); what belongs to the vehicle and its task, "
                "as the turn toward the target within its limits, its size, the start heading, the target's radius, "
                "and walls that are sensed like obstacles"
            ),
        ),
        Study(
            preset="tuned",
            title="What tuned is made of",
            tiers={"paper": "5 % cover", "cover_10": "10 % cover", "cover_15": "15 % cover"},
            factors=_TUNED,
            episodes=paper.EPISODES,
            seeds=12,
        ),
        Study(
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
            factors=_DOUBLE_DQN,
            episodes=4000,
            seeds=8,
            base=_agent(schedule_episodes=4000),
        ),
    )
}
"""Studies by the names of their presets."""
