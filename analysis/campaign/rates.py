"""How often attempts succeed, beside the paper's rates; which restitutions each ball was given."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from analysis.campaign.attempts import Attempt
from tunenet_logs.outcome import BOUNCE_SHOT

_Z95 = 1.959963984540054
"""Standard deviations of a normal distribution to either side that contain 95 % of it."""


@dataclass(frozen=True)
class Rate:
    """Successes of some attempts.

    Attributes:
        name: of these attempts.
        successes: how many of them succeeded.
        count: how many there are that have an outcome.
        published: the paper's fraction; None where it has none.
    """

    name: str
    successes: int
    count: int
    published: float | None = None

    @property
    def fraction(self) -> float:
        """Of successes; NaN without attempts."""
        return self.successes / self.count if self.count else float("nan")

    @property
    def interval95(self) -> tuple[float, float]:
        """Wilson's score interval; (0, 1) without attempts."""
        return wilson95(self.successes, self.count)


@dataclass(frozen=True)
class BallRestitutions:
    """The restitutions tuned for one ball.

    Attributes:
        name: of the ball.
        values: one a drop, in their order.
        attempts: the numbers of the first attempts with those.
        intervals95: None where one has none.
    """

    name: str
    values: tuple[float, ...]
    attempts: tuple[int, ...]
    intervals95: tuple[tuple[float, float] | None, ...]

    @property
    def mean(self) -> float:
        """Of the values."""
        return float(np.mean(self.values))

    @property
    def sd(self) -> float:
        """Standard deviation of the values; NaN for a single one."""
        return float(np.std(self.values, ddof=1)) if len(self.values) > 1 else float("nan")


def wilson95(successes: int, count: int) -> tuple[float, float]:
    """The 95 % score interval of a binomial proportion (Wilson 1927); (0, 1) without a trial.

    Unlike the normal approximation it stays within 0 and 1, and is honest for few trials.
    """
    if not count:
        return 0.0, 1.0
    fraction, square = successes / count, _Z95**2 / count
    middle = (fraction + square / 2) / (1 + square)
    half = _Z95 / (1 + square) * sqrt(fraction * (1 - fraction) / count + square / (4 * count))
    return max(0.0, middle - half), min(1.0, middle + half)


def overall_rates(attempts: Sequence[Attempt]) -> tuple[Rate, ...]:
    """Bounce shots with an outcome, those whose drop passed the checks, and did not; other tasks.

    The paper counts by whether a drop left the table (Allevato et al. 2019, experiment 3): 87 % on
    it, 18 % off it. What the checks reject is that, or what they cannot tell from it. It has no
    figure for other tasks.
    """
    kinds: tuple[tuple[str, float, Callable[[Attempt], bool]], ...] = (
        ("all", 0.62, lambda _: True),
        ("drop accepted", 0.87, lambda one: one.is_accepted is True),
        ("drop rejected", 0.18, lambda one: one.is_accepted is False),
    )
    tasks = _tasks_of(attempts)
    shots = [attempt for attempt in attempts if _task(attempt) == BOUNCE_SHOT]
    published = [_rate(name, filter(belongs, shots), rate) for name, rate, belongs in kinds]
    others = [
        _rate(f"task {task}", (attempt for attempt in attempts if _task(attempt) == task), None)
        for task in tasks
        if task != BOUNCE_SHOT
    ]
    return (*(published if shots or not others else ()), *others)


def ball_rates(attempts: Sequence[Attempt]) -> tuple[Rate, ...]:
    """By ball, in the order in which they came, and by task where it is no bounce shot."""
    tried = [
        (
            ball,
            task,
            [attempt for attempt in attempts if attempt.ball == ball and _task(attempt) == task],
        )
        for ball in _balls_of(attempts)
        for task in _tasks_of(attempts)
    ]
    return tuple(
        _rate(ball if task == BOUNCE_SHOT else f"{ball}, {task}", own, None)
        for ball, task, own in tried
        if own
    )


def _task(attempt: Attempt) -> str | None:
    return None if attempt.outcome is None else attempt.outcome.task


def _tasks_of(attempts: Iterable[Attempt]) -> tuple[str, ...]:
    """Those that were tried, in the order in which they came."""
    tasks = (attempt.outcome.task for attempt in attempts if attempt.outcome is not None)
    return tuple(dict.fromkeys(tasks))


def restitutions_by_ball(attempts: Sequence[Attempt]) -> tuple[BallRestitutions, ...]:
    """By ball, in the order in which they came; none of a ball without a value.

    A drop that several shots were planned with is one value.
    """
    first: dict[int, Attempt] = {}
    for attempt in attempts:
        first.setdefault(id(attempt.used or attempt), attempt)
    found: list[BallRestitutions] = []
    for ball in _balls_of(attempts):
        tuned = [
            (attempt, attempt.value)
            for attempt in first.values()
            if attempt.ball == ball and attempt.value is not None
        ]
        if tuned:
            values = tuple(value for _, value in tuned)
            numbers = tuple(attempt.number for attempt, _ in tuned)
            intervals95 = tuple(attempt.interval95 for attempt, _ in tuned)
            found.append(BallRestitutions(ball, values, numbers, intervals95))
    return tuple(found)


def _balls_of(attempts: Iterable[Attempt]) -> tuple[str, ...]:
    """The names of the balls, in the order in which they came."""
    return tuple(dict.fromkeys(attempt.ball for attempt in attempts))


def _rate(name: str, attempts: Iterable[Attempt], published: float | None) -> Rate:
    ended = [attempt.outcome for attempt in attempts if attempt.outcome is not None]
    return Rate(name, sum(outcome.success for outcome in ended), len(ended), published)
