"""A log of a training for TensorBoard. The only module that imports tensorboardX."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.summary_pb2 import Summary

from nnql_bullet.training.base import TrainingEpisode
from nnql_bullet.training.evaluation import Evaluation
from nnql_bullet.training.log import scalars


class TensorBoardLog:
    """Writes event files: one for each time that the training runs. Every number is on disk when a call returns.

    When a training goes on from a checkpoint, readers are told to forget what was logged after it.
    """

    def __init__(self, folder: Path, finished: Sequence[TrainingEpisode], evaluations: Sequence[Evaluation]) -> None:
        """Opens a file.

        Args:
            folder: The log's, which is made if it is not there.
            finished: Episodes that are finished; a log that begins here begins with these.
            evaluations: That were made between them.
        """
        begins = not folder.is_dir()
        folder.mkdir(parents=True, exist_ok=True)
        self._writer = EventsWriter(str(folder / f"from-{len(finished):09d}"))
        if begins:
            for done in range(1, len(finished) + 1):
                self._add(done, scalars(finished, evaluations, done))
        else:
            start = SessionLog(status=SessionLog.START)
            self._writer.write_event(Event(wall_time=time.time(), step=len(finished) + 1, session_log=start))
        self._writer.flush()

    def __call__(self, done: int, numbers: Mapping[str, float]) -> None:
        """Writes numbers by name after so many episodes."""
        self._add(done, numbers)
        self._writer.flush()

    def close(self) -> None:
        """Closes the file."""
        self._writer.close()

    def _add(self, done: int, numbers: Mapping[str, float]) -> None:
        values = [Summary.Value(tag=name, simple_value=number) for name, number in numbers.items()]
        self._writer.write_event(Event(wall_time=time.time(), step=done, summary=Summary(value=values)))
