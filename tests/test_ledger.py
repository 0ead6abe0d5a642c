"""The ledger: every alternative departs in one thing, and what the evidence says follows from the scores."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nnql_bullet.config import merged, to_values
from nnql_bullet.evaluation.books import BOOKS, Alternative, Book, Choice
from nnql_bullet.evaluation.ledger import Budget, Counts, entries, task_of
from nnql_bullet.experiment import PRESETS, load_config
from nnql_bullet.reports.ledger import decision

RunCli = Callable[..., tuple[int, str, str]]
Snapshot = Callable[[Path], dict[str, bytes]]

BUDGET = Budget("twin", 2, 5, 4, 6)
BOOK = BOOKS["paper"]
EVERY = [(book, choice) for book in BOOKS.values() for choice in book.choices]


def configured(book: Book, alternative: Alternative) -> dict[str, object]:
    return dict(json.loads(task_of(book, alternative, 0, BUDGET).config))


class TestBooks:
    @pytest.mark.parametrize("book", BOOKS.values(), ids=BOOKS)
    def test_names_and_labels_are_unique(self, book: Book) -> None:
        assert len({choice.name for choice in book.choices}) == len(book.choices)
        for choice in book.choices:
            assert len({alternative.label for alternative in choice.alternatives}) == len(choice.alternatives) > 1

    @pytest.mark.parametrize(("book", "choice"), EVERY, ids=[f"{book.preset}-{choice.name}" for book, choice in EVERY])
    def test_exactly_one_alternative_is_the_default(self, book: Book, choice: Choice) -> None:
        spent = {"simulator": "twin", "vehicles": 4, "episodes": 5}
        default = to_values(load_config(book.preset, merged(spent, book.base)))
        same = [alternative for alternative in choice.alternatives if configured(book, alternative) == default]
        assert [alternative.changes for alternative in same] == [{}]

    @pytest.mark.parametrize("book", BOOKS.values(), ids=BOOKS)
    def test_defaults_are_one_and_the_same_training_and_no_other_two_are(self, book: Book) -> None:
        every = [alternative for choice in book.choices for alternative in choice.alternatives]
        parts = [task_of(book, alternative, 0, BUDGET).part for alternative in every if not alternative.changes]
        assert len(parts) == len(book.choices)
        assert len(set(parts)) == 1
        everything = {task_of(book, alternative, 0, BUDGET).part for alternative in every}
        assert len(everything) == len(every) - len(book.choices) + 1

    def test_the_letter_is_the_preset(self) -> None:
        (choice,) = [choice for choice in BOOK.choices if choice.name == "letter"]
        literal = to_values(load_config("literal", {"simulator": "twin", "vehicles": 4, "episodes": 5}))
        assert configured(BOOK, choice.alternatives[1]) == literal
        assert choice.alternatives[1].changes == PRESETS["literal"]

    def test_what_a_book_shares_is_in_every_training(self) -> None:
        book = BOOKS["double_dqn"]
        for choice in book.choices:
            for alternative in choice.alternatives:
                agent = configured(book, alternative)["agent"]
                assert isinstance(agent, dict)
                assert agent["schedule_episodes"] == book.episodes

    def test_each_seed_is_another_training(self) -> None:
        parts = {task_of(BOOK, BOOK.choices[0].alternatives[0], seed, BUDGET).part for seed in (0, 1)}
        assert len(parts) == 2


CHOICE = Choice("c", "which", "I", (Alternative("a", {}), Alternative("b", {"seed": 1}), Alternative("d", {"seed": 2})))


MINE = replace(BOOK, choices=(CHOICE,))


def trainings(*goals: tuple[int, int]) -> list[list[Counts]]:
    """Of 100 worlds in each tier, by seed."""
    return [
        [Counts(world, count, 100 - count, 0) for world, count in zip(BOOK.tiers, pair, strict=True)] for pair in goals
    ]


class TestEntries:
    RESULTS = {  # noqa: RUF012
        ("c", "a"): trainings((90, 70), (92, 74), (88, 60), (91, 71), (90, 75)),
        ("c", "b"): trainings((80, 60), (83, 62), (80, 50), (79, 60), (82, 61)),
        ("c", "d"): trainings((91, 69), (90, 76), (88, 61), (92, 69), (90, 76)),
    }

    def test_success_is_the_interquartile_mean_over_seeds(self) -> None:
        found = {entry.alternative.label: entry for entry in entries(MINE, self.RESULTS)}
        success = found["a"].success["paper"]
        assert success is not None
        assert success.value == pytest.approx((90 + 90 + 91) / 300)
        assert found["a"].by_seed["cover_10"] == (0.7, 0.74, 0.6, 0.71, 0.75)

    def test_differences_are_paired_by_seed_over_both_tiers(self) -> None:
        found = {entry.alternative.label: entry.difference for entry in entries(MINE, self.RESULTS)}
        paired = [
            (80 + 60 - 160) / 2,
            (83 + 62 - 166) / 2,
            (80 + 50 - 148) / 2,
            (79 + 60 - 162) / 2,
            (82 + 61 - 165) / 2,
        ]
        assert found["a"] == (0.0, 0.0, 0.0)
        assert found["b"].value == pytest.approx(np.mean(paired) / 100)
        assert min(paired) / 100 <= found["b"].low <= found["b"].value <= found["b"].high <= max(paired) / 100

    def test_verdicts_say_whether_the_interval_leaves_zero_out(self) -> None:
        found = entries(MINE, self.RESULTS)
        assert [entry.verdict for entry in found] == ["default", "worse", "undecided"]
        better = {**self.RESULTS, ("c", "d"): trainings((95, 90), (96, 88), (97, 90), (95, 85), (94, 88))}
        assert [entry.verdict for entry in entries(MINE, better)] == ["default", "worse", "better"]

    def test_what_it_decides_is_said_in_words(self) -> None:
        found = entries(MINE, self.RESULTS)
        assert decision(CHOICE, found) == "a; nothing is better, and the evidence does not tell it from d"
        worse = {**self.RESULTS, ("c", "d"): self.RESULTS["c", "b"]}
        assert decision(CHOICE, entries(MINE, worse)) == "a, and every alternative is worse"
        better = {**self.RESULTS, ("c", "d"): trainings((95, 90), (96, 88), (97, 90), (95, 85), (94, 88))}
        assert decision(CHOICE, entries(MINE, better)).startswith("d is better than a by +")

    def test_a_single_seed_decides_nothing_and_says_so_by_an_interval_of_no_width(self) -> None:
        one = {key: its[:1] for key, its in self.RESULTS.items()}
        for entry in entries(MINE, one):
            assert set(entry.success.values()) == {None}
            assert entry.difference.low == entry.difference.high == entry.difference.value


SMALL = ("--only", "encoding,reward", "--seeds", 2, "--episodes", 4, "--vehicles", 4, "--worlds", 5)


class TestCommand:
    def test_it_leaves_a_report_goes_on_and_repeats_itself(
        self, tmp_path: Path, run_cli: RunCli, snapshot: Snapshot, compiled_twin: None
    ) -> None:
        first, second = tmp_path / "first", tmp_path / "second"
        code, printed, _ = run_cli("ledger", *SMALL, "--executor", "inline", "--out", first)
        assert code == 0
        assert "no obstacle is d = 0: " in printed
        values = json.loads((first / "ledger.json").read_text())
        assert [(e["choice"], e["alternative"]) for e in values["entries"]] == [
            (choice.name, alternative.label)
            for choice in BOOK.choices
            if choice.name in ("encoding", "reward")
            for alternative in choice.alternatives
        ]
        assert len(list((first / "parts").iterdir())) == 2 * (1 + 1 + 2)  # the default is trained once a seed
        with Image.open(first / "ledger.png") as image:
            assert min(image.size) > 300
        (second / "parts").mkdir(parents=True)
        for part in sorted((first / "parts").iterdir())[:3]:
            (second / "parts" / part.name).write_bytes(part.read_bytes())
        assert run_cli("ledger", *SMALL, "--workers", 2, "--out", second)[0] == 0
        assert snapshot(second) == snapshot(first)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (("--only", "colour"), "--only: there is no choice 'colour'; choices: period, front, "),
            (("--only", ""), "--only: there is no choice ''"),
            (("sb3_dqn",), "there is no ledger of 'sb3_dqn'; presets: paper, "),
            (("--seeds", 0), "--seeds must be at least 1, not 0"),
            (("--worlds", 0), "--worlds must be from 1 to 1000"),
            (("--episodes", 0), "'episodes': input should be greater than or equal to 1"),
            (("--vehicles", 0), "'vehicles': input should be greater than or equal to 1"),
        ],
    )
    def test_bad_input_is_one_line_and_leaves_nothing(
        self, arguments: tuple[object, ...], message: str, tmp_path: Path, run_cli: RunCli
    ) -> None:
        code, printed, complaint = run_cli("ledger", *arguments, "--out", tmp_path / "out")
        assert (code, printed) == (2, "")
        assert message in complaint
        assert len(complaint.splitlines()) == 1
        assert not (tmp_path / "out").exists()
