"""How often attempts succeed, with intervals, beside the paper's; how restitutions spread."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from analysis.campaign.attempts import Attempt
from tunenet_logs.outcome import BOUNCE_SHOT

_Z95 = 1.959963984540054


@dataclass(frozen=True)
class Rate:
    """Successes of some attempts.

    Attributes:
        name: of what.
        published: the paper's share; None where it has none.
    """

    name: str
    successes: int
    count: int
    published: float | None = None

    @property
    def share(self) -> float:
        """Of successes; NaN without attempts."""
        return self.successes / self.count if self.count else float("nan")

    @property
    def interval95(self) -> tuple[float, float]:
        """Wilson's; (0, 1) without attempts."""
        return wilson95(self.successes, self.count)


@dataclass(frozen=True)
class Spread:
    """The restitutions tuned for one ball.

    Attributes:
        values: one a drop, in their order.
        attempts: the numbers of the first attempts with those.
        intervals95: None where one has none.
    """

    ball: str
    values: tuple[float, ...]
    attempts: tuple[int, ...]
    intervals95: tuple[tuple[float, float] | None, ...]

    @property
    def mean(self) -> float:
        """Of the values."""
        return float(np.mean(self.values))

    @property
    def deviation(self) -> float:
        """Standard deviation of the values; NaN for a single one."""
        return float(np.std(self.values, ddof=1)) if len(self.values) > 1 else float("nan")


def wilson95(successes: int, count: int) -> tuple[float, float]:
    """The interval of a share that holds it in 95 % (Wilson 1927); (0, 1) without a trial."""
    if not count:
        return 0.0, 1.0
    share, square = successes / count, _Z95**2 / count
    middle = (share + square / 2) / (1 + square)
    half = _Z95 / (1 + square) * sqrt(share * (1 - share) / count + square / (4 * count))
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
    shots = [one for one in attempts if _task(one) == BOUNCE_SHOT]
    published = [_rate(name, filter(belongs, shots), rate) for name, rate, belongs in kinds]
    others = [
        _rate(f"task {task}", (one for one in attempts if _task(one) == task), None)
        for task in tasks
        if task != BOUNCE_SHOT
    ]
    return (*(published if shots or not others else ()), *others)


def ball_rates(attempts: Sequence[Attempt]) -> tuple[Rate, ...]:
    """By ball, in the order in which they came, and by task where it is no bounce shot."""
    tried = [
        (ball, task, [one for one in attempts if one.ball == ball and _task(one) == task])
        for ball in balls_of(attempts)
        for task in _tasks_of(attempts)
    ]
    return tuple(
        _rate(ball if task == BOUNCE_SHOT else f"{ball}, {task}", those, None)
        for ball, task, those in tried
        if those
    )


def _task(attempt: Attempt) -> str | None:
    return None if attempt.outcome is None else attempt.outcome.task


def _tasks_of(attempts: Iterable[Attempt]) -> tuple[str, ...]:
    """Those that were tried, in the order in which they came."""
    return tuple(dict.fromkeys(one.outcome.task for one in attempts if one.outcome is not None))


def spreads(attempts: Sequence[Attempt]) -> tuple[Spread, ...]:
    """By ball, in the order in which they came; none of one without a value.

    A drop that several shots were planned with is one value.
    """
    first: dict[int, Attempt] = {}
    for one in attempts:
        first.setdefault(id(one.used or one), one)
    found: list[Spread] = []
    for ball in balls_of(attempts):
        tuned = [
            (one, one.value) for one in first.values() if one.ball == ball and one.value is not None
        ]
        if tuned:
            values = tuple(value for _, value in tuned)
            numbers = tuple(one.number for one, _ in tuned)
            found.append(Spread(ball, values, numbers, tuple(one.interval95 for one, _ in tuned)))
    return tuple(found)


def balls_of(attempts: Iterable[Attempt]) -> tuple[str, ...]:
    """The names of the balls, in the order in which they came."""
    return tuple(dict.fromkeys(one.ball for one in attempts))


def _rate(name: str, attempts: Iterable[Attempt], published: float | None) -> Rate:
    ended = [one.outcome for one in attempts if one.outcome is not None]
    return Rate(name, sum(one.success for one in ended), len(ended), published)
