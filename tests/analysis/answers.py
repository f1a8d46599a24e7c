"""What a tuning answers, where there must be an answer."""

from __future__ import annotations

from typing import TypeVar

from tunenet_logs.analysis.estimators.base import Trace
from tunenet_logs.analysis.experiment import Tuning

T = TypeVar("T")


def known(one: T | None) -> T:
    """The same, which must be there."""
    assert one is not None
    return one


def value(tuning: Tuning) -> float:
    """Of its first parameter."""
    assert tuning.estimate is not None, tuning.reason
    return float(tuning.estimate[0])


def ends(tuning: Tuning) -> tuple[float, float]:
    """Of the interval of its first parameter."""
    low, high = known(tuning.interval95)[0].tolist()
    return low, high


def trace_of(tuning: Tuning) -> Trace:
    """Its iterations."""
    assert tuning.trace is not None, tuning.reason
    return tuning.trace


def steps(tuning: Tuning) -> list[list[float]]:
    """The values of each iteration."""
    return [step.values.tolist() for step in trace_of(tuning).steps]
