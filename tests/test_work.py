"""Long work in pieces: results in the order of the tasks, a failure named."""

from dataclasses import dataclass

import pytest

from nnql_bullet.cli import parser
from nnql_bullet.cli.console import progress
from nnql_bullet.errors import WorkFailed
from nnql_bullet.executors import make_executor
from nnql_bullet.work import Progress, run_all


@dataclass(frozen=True)
class Piece:
    seed: int


def square(piece: Piece) -> int:
    if piece.seed == 13:
        raise ValueError("bad luck")
    return piece.seed**2


@pytest.mark.parametrize("kind", ["inline", "processes"])
def test_results_come_in_the_order_of_the_tasks(kind: str) -> None:
    pieces = [Piece(seed) for seed in (5, 1, 4, 2)]
    assert run_all(make_executor(kind, 2), "squaring", square, pieces) == [25, 1, 16, 4]  # type: ignore[arg-type]


def test_a_piece_that_fails_is_named() -> None:
    pieces = [Piece(1), Piece(13), Piece(2)]
    with pytest.raises(WorkFailed, match=r"squaring, piece 2 of 3: ValueError: bad luck"):
        run_all(make_executor("inline", 1), "squaring", square, pieces)


def test_the_command_line_says_so_in_one_line(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def verb() -> int:
        """Fails."""
        raise WorkFailed("squaring, piece 2 of 3: bad luck")

    monkeypatch.setattr(parser, "verb_of", lambda name: verb)
    assert parser.run(["doctor"]) == 1
    assert capfd.readouterr().err == "nnql-bullet: squaring, piece 2 of 3: bad luck\n"


def test_progress_counts_the_size_of_pieces(capfd: pytest.CaptureFixture[str]) -> None:
    seen: list[Progress] = []
    pieces = [Piece(3), Piece(4)]
    run_all(make_executor("inline"), "squaring", square, pieces, lambda piece: piece.seed, on_progress=seen.append)
    assert seen == [Progress("squaring", done, 7) for done in (0, 3, 7)]
    assert capfd.readouterr() == ("", "")
    with progress() as show:
        run_all(make_executor("inline"), "squaring", square, pieces, lambda piece: piece.seed, on_progress=show)
    assert "squaring 7/7" in capfd.readouterr().err
