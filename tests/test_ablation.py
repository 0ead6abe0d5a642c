"""The ablation: every variant departs in one thing, and what the evidence says follows from the scores."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nnql_bullet.config import merged, to_values
from nnql_bullet.evaluation.ablation import Budget, Counts, entries, task_of
from nnql_bullet.evaluation.studies import STUDIES, Factor, Study, Variant
from nnql_bullet.presets import load_config
from nnql_bullet.reports.ablation import ablation_markdown, decision

RunCli = Callable[..., tuple[int, str, str]]
Snapshot = Callable[[Path], dict[str, bytes]]

BUDGET = Budget("kinematic", 2, 5, 4, 6)
BOOK = STUDIES["paper"]
EVERY = [(study, factor) for study in STUDIES.values() for factor in study.factors]


def configured(study: Study, variant: Variant) -> dict[str, object]:
    return dict(json.loads(task_of(study, variant, 0, BUDGET).config))


class TestBooks:
    @pytest.mark.parametrize("study", STUDIES.values(), ids=STUDIES)
    def test_names_and_labels_are_unique(self, study: Study) -> None:
        assert len({factor.name for factor in study.factors}) == len(study.factors)
        for factor in study.factors:
            assert len({variant.label for variant in factor.variants}) == len(factor.variants) > 1

    @pytest.mark.parametrize(
        ("study", "factor"), EVERY, ids=[f"{study.preset}-{factor.name}" for study, factor in EVERY]
    )
    def test_exactly_one_alternative_is_the_default(self, study: Study, factor: Factor) -> None:
        spent = {"simulator": "kinematic", "vehicles": 4, "episodes": 5}
        default = to_values(load_config(study.preset, merged(spent, study.base)))
        same = [variant for variant in factor.variants if configured(study, variant) == default]
        assert [variant.changes for variant in same] == [{}]

    @pytest.mark.parametrize("study", STUDIES.values(), ids=STUDIES)
    def test_defaults_are_one_and_the_same_training_and_no_other_two_are(self, study: Study) -> None:
        every = [variant for factor in study.factors for variant in factor.variants]
        parts = [task_of(study, variant, 0, BUDGET).part for variant in every if not variant.changes]
        assert len(parts) == len(study.factors)
        assert len(set(parts)) == 1
        everything = {task_of(study, variant, 0, BUDGET).part for variant in every}
        assert len(everything) == len(every) - len(study.factors) + 1

    def test_the_letter_is_the_preset(self) -> None:
        (factor,) = [factor for factor in BOOK.factors if factor.name == "letter"]
        literal = to_values(load_config("literal", {"simulator": "kinematic", "vehicles": 4, "episodes": 5}))
        assert configured(BOOK, factor.variants[1]) == literal

    def test_what_a_book_shares_is_in_every_training(self) -> None:
        study = STUDIES["double_dqn"]
        for factor in study.factors:
            for variant in factor.variants:
                agent = configured(study, variant)["agent"]
                assert isinstance(agent, dict)
                assert agent["schedule_episodes"] == study.episodes

    def test_each_seed_is_another_training(self) -> None:
        parts = {task_of(BOOK, BOOK.factors[0].variants[0], seed, BUDGET).part for seed in (0, 1)}
        assert len(parts) == 2


FACTOR = Factor("c", "which", "I", (Variant("a", {}), Variant("b", {"seed": 1}), Variant("d", {"seed": 2})))


MINE = replace(BOOK, factors=(FACTOR,))


def trainings(*goals: tuple[int, int]) -> list[list[Counts]]:
    """Of 100 worlds in each tier, by seed."""
    return [
        [Counts(world, count, 100 - count, 0) for world, count in zip(BOOK.tiers, pair, strict=True)] for pair in goals
    ]


class TestEntries:
    RESULTS = {  # noqa: RUF012
        ("c", "a"): trainings((90, 70), (92, 74), (88, 60), (91, 71), (90, 75), (89, 72), (91, 70), (90, 73)),
        ("c", "b"): trainings((80, 60), (83, 62), (80, 50), (79, 60), (82, 61), (81, 60), (80, 61), (79, 62)),
        ("c", "d"): trainings((91, 69), (90, 76), (88, 61), (92, 69), (90, 76), (88, 73), (92, 68), (90, 73)),
    }
    BETTER = {  # noqa: RUF012
        **RESULTS,
        ("c", "d"): trainings((95, 90), (96, 88), (97, 90), (95, 85), (94, 88), (95, 86), (96, 87), (95, 89)),
    }

    def test_success_is_the_interquartile_mean_over_seeds(self) -> None:
        found = {entry.variant.label: entry for entry in entries(MINE, self.RESULTS)}
        assert found["a"].success["paper"].value == pytest.approx((90 + 90 + 90 + 91) / 400)
        assert found["a"].by_seed["cover_10"] == (0.7, 0.74, 0.6, 0.71, 0.75, 0.72, 0.7, 0.73)

    def test_differences_are_paired_by_seed_over_both_tiers(self) -> None:
        found = {entry.variant.label: entry.difference for entry in entries(MINE, self.RESULTS)}
        base, its = ([[t.goal for t in one] for one in self.RESULTS["c", label]] for label in "ab")
        paired = [(sum(mine) - sum(other)) / 200 for mine, other in zip(its, base, strict=True)]
        assert found["a"] == (0.0, 0.0, 0.0)
        assert found["b"].value == pytest.approx(np.mean(paired))
        assert min(paired) <= found["b"].low <= found["b"].value <= found["b"].high <= max(paired)

    def test_verdicts_follow_from_the_corrected_p(self) -> None:
        found = entries(MINE, self.RESULTS)
        assert [entry.verdict for entry in found] == ["default", "worse", "undecided"]
        assert (found[1].p_value, found[1].corrected) == (2 / 2**8, 2 * 2 / 2**8)  # all eight seeds agree
        assert 0 < found[1].detectable < 0.05
        assert [entry.verdict for entry in entries(MINE, self.BETTER)] == ["default", "worse", "better"]

    def test_too_few_seeds_for_the_study_carry_no_verdict(self) -> None:
        for seeds, verdict in ((1, "exploratory"), (6, "exploratory"), (7, "better")):  # two comparisons need seven
            few = {key: its[:seeds] for key, its in self.BETTER.items()}
            found = entries(MINE, few)
            assert found[2].verdict == verdict
            said = ablation_markdown(MINE, found, BUDGET) + decision(FACTOR, found)
            if verdict == "exploratory":
                assert "too few seeds for a verdict" in said
                assert " is better than" not in said
                assert found[2].detectable == np.inf
        alone = replace(MINE, factors=(replace(FACTOR, variants=FACTOR.variants[:2]),))
        assert entries(alone, {key: its[:6] for key, its in self.RESULTS.items()})[1].verdict == "worse"

    def test_what_it_decides_is_said_in_words(self) -> None:
        found = entries(MINE, self.RESULTS)
        assert decision(FACTOR, found) == "a; nothing is better, and the evidence does not tell it from d"
        worse = {**self.RESULTS, ("c", "d"): self.RESULTS["c", "b"]}
        assert decision(FACTOR, entries(MINE, worse)) == "a, and every variant is worse"
        assert decision(FACTOR, entries(MINE, self.BETTER)).startswith("d is better than a by +")


SMALL = ("--only", "encoding,reward", "--seeds", 2, "--episodes", 4, "--vehicles", 4, "--worlds", 5)


class TestCommand:
    def test_help_says_what_studies_take(self, run_cli: RunCli) -> None:
        told = " ".join(run_cli("ablate", "--help")[1].replace("│", " ").split())
        for preset, study in STUDIES.items():
            beside = "default {}" if preset == "paper" else f"of {preset} {{}}"
            for number, usual in ((study.seeds, BOOK.seeds), (study.episodes, BOOK.episodes)):
                assert (preset != "paper" and number == usual) or beside.format(number) in told

    def test_it_leaves_a_report_goes_on_and_repeats_itself(
        self, tmp_path: Path, run_cli: RunCli, snapshot: Snapshot, compiled_kernels: None
    ) -> None:
        first, second = tmp_path / "first", tmp_path / "second"
        code, printed, _ = run_cli("ablate", *SMALL, "--executor", "inline", "--out", first)
        assert code == 0
        assert "no obstacle is d = 0: " in printed
        values = json.loads((first / "ablation.json").read_text())
        assert [(e["factor"], e["variant"]) for e in values["entries"]] == [
            (factor.name, variant.label)
            for factor in BOOK.factors
            if factor.name in ("encoding", "reward")
            for variant in factor.variants
        ]
        assert len(list((first / "parts").iterdir())) == 2 * (1 + 1 + 2)  # the default is trained once a seed
        with Image.open(first / "ablation.png") as image:
            assert min(image.size) > 300
        (second / "parts").mkdir(parents=True)
        for part in sorted((first / "parts").iterdir())[:3]:
            (second / "parts" / part.name).write_bytes(part.read_bytes())
        assert run_cli("ablate", *SMALL, "--workers", 2, "--out", second)[0] == 0
        assert snapshot(second) == snapshot(first)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (("--only", "colour"), "only: there is no factor 'colour'; factors: period, front, "),
            (("--only", ""), "--only has an empty value"),
            (("sb3_dqn",), "there is no ablation of 'sb3_dqn'; presets: paper, "),
            (("--seeds", 0), "seeds must be from 1 to 1000, not 0"),
            (("--worlds", 0), "the number of worlds must be from 1 to 1000"),
            (("--episodes", 0), "'episodes': input should be greater than or equal to 1"),
            (("--vehicles", 0), "'vehicles': input should be greater than or equal to 1"),
        ],
    )
    def test_bad_input_is_one_line_and_leaves_nothing(
        self, arguments: tuple[object, ...], message: str, tmp_path: Path, run_cli: RunCli
    ) -> None:
        code, printed, complaint = run_cli("ablate", *arguments, "--out", tmp_path / "out")
        assert (code, printed) == (2, "")
        assert message in complaint
        assert len(complaint.splitlines()) == 1
        assert not (tmp_path / "out").exists()
