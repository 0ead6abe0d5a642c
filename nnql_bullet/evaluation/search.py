"""A search by Optuna, whose trials are kept in an SQLite file. The only module that imports it.

A trial is drawn from what the trials of the rounds before it came to, by a generator that is made of the seed and the
trial's number. So what is drawn does not depend on how many trials run at a time, on which of them ends first, or on
whether the search has been interrupted. It does depend on Optuna, whose sampler may change from version to version.
"""

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.trial import FrozenTrial, TrialState

from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.space import Space, State, Trial
from nnql_bullet.seeding import Stream, rng

_STATES: dict[State, TrialState] = {
    "trained": TrialState.COMPLETE,
    "pruned": TrialState.PRUNED,
    "failed": TrialState.FAIL,
}
_IDENTITY, _REASON = "identity", "reason"


class Search:
    """A search for the largest score, with its file."""

    def __init__(self, file: Path, space: Space[Any], identity: str, seed: int, random: int) -> None:
        """Opens the file, or makes it.

        Args:
            file: SQLite file.
            space: What to search among.
            identity: All that the trials depend on.
            seed: Seed of what is drawn.
            random: First trials that are drawn at random.

        Raises:
            UserError: If the file holds another search, or none.
        """
        self._space, self._seed, self._random, self._file = space, seed, random, file
        with self._study() as study:
            if study.user_attrs.get(_IDENTITY, identity) != identity:
                raise UserError(
                    f"{file}: holds a search among other values, or of another base; give another folder, or the same "
                    "as then"
                )
            study.set_user_attr(_IDENTITY, identity)
            self._frozen: list[FrozenTrial] = study.get_trials()

    @property
    def trials(self) -> list[Trial]:
        """The trials that are over."""
        states = {its: name for name, its in _STATES.items()}
        return [
            Trial(
                number=number,
                values=its.params,
                history=tuple(value for _, value in sorted(its.intermediate_values.items())),
                state=states[its.state],
                reason=its.user_attrs.get(_REASON, ""),
            )
            for number, its in enumerate(self._frozen)
        ]

    def draw(self, number: int, known: int) -> dict[str, Any]:
        """Draws the values of a trial from what so many first trials came to; those of the first are the base's own."""
        if number == 0 and self._space.own is not None:
            return self._space.own
        seed = int(rng(self._seed, Stream.SWEEP, number).integers(2**31))
        sampler = optuna.samplers.TPESampler(seed=seed, n_startup_trials=self._random)
        with _quiet():
            study = optuna.create_study(sampler=sampler, direction="maximize")
            study.add_trials(self._frozen[:known])
            return study.ask(_distributions(self._space)).params

    def add(self, trials: Sequence[Trial]) -> None:
        """Keeps trials that are over, in the order of their numbers."""
        made = [
            optuna.trial.create_trial(
                state=_STATES[its.state],
                value=its.score if its.state == "trained" else None,
                params=dict(its.values),
                distributions=_distributions(self._space),
                intermediate_values=dict(enumerate(its.history)),
                user_attrs={_REASON: its.reason} if its.reason else {},
            )
            for its in trials
        ]
        with self._study() as study:
            for one in made:
                study.add_trial(one)
            self._frozen = study.get_trials()

    @contextmanager
    def _study(self) -> Iterator[optuna.Study]:
        """The study in the file.

        Raises:
            UserError: If the file is not Optuna's.
        """
        connect = partial(sqlite3.connect, self._file, check_same_thread=False)  # a path with any character
        with _quiet():
            try:
                storage = optuna.storages.RDBStorage("sqlite:///study.db", engine_kwargs={"creator": connect})
            except Exception as error:  # of SQLite, SQLAlchemy, Alembic or Optuna
                reason = str(error).partition("\n")[0]
                raise UserError(f"{self._file}: cannot be read as a study of Optuna: {reason}") from None
            try:
                yield optuna.create_study(
                    storage=storage, study_name="sweep", direction="maximize", load_if_exists=True
                )
            finally:
                storage.remove_session()
                storage.engine.dispose()


def _distributions(space: Space[Any]) -> dict[str, BaseDistribution]:
    found: dict[str, BaseDistribution] = {}
    for name, its in space.ranges.items():
        if name in space.whole:
            found[name] = IntDistribution(int(its.low), int(its.high), its.log, int(its.step or 1))
        else:
            found[name] = FloatDistribution(its.low, its.high, its.log, its.step)
    return found | {name: CategoricalDistribution(texts) for name, texts in space.choices.items()}


@contextmanager
def _quiet() -> Iterator[None]:
    """Keeps Optuna from telling of each study and trial."""
    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        yield
    finally:
        optuna.logging.set_verbosity(before)
