"""What a recording tells in words."""

from typing import Literal, NamedTuple

import numpy as np

from nnql_bullet.recording import Recording
from nnql_bullet.render.labels import MANOEUVRES, PROPERTIES


class Event(NamedTuple):
    """A line of a log."""

    state: int
    """Number of the state in which it happens."""
    text: str
    level: Literal["INFO", "WARN", "ERROR"]


def events_of(recording: Recording) -> list[Event]:
    """Changes of the property, the shield's decisions, contacts and the ending."""
    nearest = recording.readings.min(axis=1)
    labels = [PROPERTIES[letters][0] for letters in recording.state_property.tolist()]
    events = [
        Event(state, f"{labels[state]}: nearest reading {nearest[state]:.2f} m", "INFO")
        for state in range(len(labels))
        if state == 0 or labels[state] != labels[state - 1]
    ]
    for step in np.flatnonzero(recording.overridden).tolist():
        events.append(Event(step, f"shield: {MANOEUVRES[recording.action[step]]}", "WARN"))
    for step in np.flatnonzero(recording.contact).tolist():
        events.append(Event(step + 1, "contact with an obstacle or a wall", "ERROR"))
    ending = f"{recording.about['ending']} after {recording.state_time[-1]:.1f} s"
    return [*events, Event(len(labels) - 1, ending, "INFO")]
