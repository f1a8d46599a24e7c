"""Clock without contacts: a simulator's are far shorter than those of a ball that was heard."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.drop.detection import AnyDetection
from tunenet_logs.arrays import Array

_WHILE_TOUCHING = 1e-3  # of the contacts' time that passes all the same, so that time goes on


@dataclass(frozen=True, eq=False)
class ContactClock:
    """Clock of the log, and one that almost stands still while the ball touches.

    Attributes:
        log_s: when contacts begin and end, one after the other, shape (2 N,); none where they
            last no time.
        free_s: the same on the other clock, shape (2 N,).
    """

    log_s: Array
    free_s: Array

    def to_free(self, seconds: Array) -> Array:
        """Convert times on the log's clock to the contact-free one, shape (T,)."""
        return _moved(seconds, self.log_s, self.free_s)

    def to_log(self, seconds: Array) -> Array:
        """Convert contact-free times to the log's clock, shape (T,)."""
        return _moved(seconds, self.free_s, self.log_s)


def contact_clock(detection: AnyDetection) -> ContactClock:
    """Build the clock of the fitted ball's contacts, as far as it is seen."""
    posterior = detection.posterior if detection.physical else None
    if posterior is None or not posterior.fit.samples.bounce(posterior.fit.unknowns).contact > 0:
        return ContactClock(np.zeros(0), np.zeros(0))
    view = posterior.fit.projection()
    ball, fall_s = view.bounce, view.fall_time_s
    until_s = float(detection.observed.seconds[-1])
    ends, _ = ball.flights(max((until_s - view.impact_s) / fall_s, 0.0))
    lasts_s = ball.contact * fall_s
    ends_s = view.impact_s + fall_s * ends
    log_s = np.column_stack([ends_s - lasts_s, ends_s]).ravel()
    passed = np.ones(len(log_s)) * (1 - _WHILE_TOUCHING) * lasts_s
    passed[::2] = 0.0
    return ContactClock(log_s, log_s - np.cumsum(passed))


def _moved(seconds: Array, known: Array, wanted: Array) -> Array:
    if not len(known):
        return seconds
    before, after = wanted[0] - known[0], wanted[-1] - known[-1]
    inside = np.interp(seconds, known, wanted)
    moved = np.where(seconds < known[0], seconds + before, inside)
    return np.where(seconds > known[-1], seconds + after, moved)
