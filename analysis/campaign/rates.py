"""Success rates of a campaign beside the paper's, and restitutions by ball."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from analysis.campaign.attempts import Attempt
from tunenet_logs.outcome import BOUNCE_SHOT

# Standard deviations of a normal distribution to either side that contain 95 % of it.
_Z95 = 1.959963984540054


@dataclass(frozen=True)
class Rate:
    """Success rate of some attempts.

    Attributes:
        name: Of these attempts.
        successes: Number that succeeded.
        count: Number with an outcome.
        published: The paper's fraction; None if it has none.
    """

    name: str
    successes: int
    count: int
    published: float | None = None

    @property
    def fraction(self) -> float:
        """Fraction of successes; NaN without attempts."""
        return self.successes / self.count if self.count else float("nan")

    @property
    def interval95(self) -> tuple[float, float]:
        """Wilson score interval; (0, 1) without attempts."""
        return wilson95(self.successes, self.count)


@dataclass(frozen=True)
class BallRestitutions:
    """Coefficients of restitution tuned for one ball.

    Attributes:
        name: Of the ball.
        values: One per drop, in their order.
        attempts: Numbers of the first attempts with those.
        intervals95: None where one has none.
    """

    name: str
    values: tuple[float, ...]
    attempts: tuple[int, ...]
    intervals95: tuple[tuple[float, float] | None, ...]

    @property
    def mean(self) -> float:
        """Mean of the values."""
        return float(np.mean(self.values))

    @property
    def sd(self) -> float:
        """Standard deviation of the values; NaN for a single one."""
        return float(np.std(self.values, ddof=1)) if len(self.values) > 1 else float("nan")


def wilson95(successes: int, count: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval (1927) of a proportion; (0, 1) without a trial.

    Unlike the normal approximation it stays within 0 and 1, and is valid for few trials.
    """
    if not count:
        return 0.0, 1.0
    fraction, square = successes / count, _Z95**2 / count
    middle = (fraction + square / 2) / (1 + square)
    half = _Z95 / (1 + square) * sqrt(fraction * (1 - fraction) / count + square / (4 * count))
    return max(0.0, middle - half), min(1.0, middle + half)


def overall_rates(attempts: Sequence[Attempt]) -> tuple[Rate, ...]:
    """Rate bounce shots (all, drop accepted, drop rejected), and the other tasks.

    The paper counts by whether a drop left the table (Allevato et al. 2019, experiment 3): 87 % on
    it, 18 % off it. The checks reject such a drop, or one that looks like it. The paper
    has no figure for other tasks.
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
    """Rate attempts by ball, in order, and by task if it is no bounce shot."""
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
    """List the tasks that were tried, in order of appearance."""
    tasks = (attempt.outcome.task for attempt in attempts if attempt.outcome is not None)
    return tuple(dict.fromkeys(tasks))


def restitutions_by_ball(attempts: Sequence[Attempt]) -> tuple[BallRestitutions, ...]:
    """Collect the restitutions of each ball that has one, in order of appearance.

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
    """List the names of the balls, in order of appearance."""
    return tuple(dict.fromkeys(attempt.ball for attempt in attempts))


def _rate(name: str, attempts: Iterable[Attempt], published: float | None) -> Rate:
    ended = [attempt.outcome for attempt in attempts if attempt.outcome is not None]
    return Rate(name, sum(outcome.success for outcome in ended), len(ended), published)
