"""Whether two values differ by more than their intervals allow.

The difference of two values against their errors, each error the part of a log's own 95 % interval
that points at the other value. Both count as normal and as independent, so that they add by
squares: the interval of a difference by Zou and Donner (2008, "MOVER"). Probabilities are
corrected by Holm (1979) over all pairs of one parameter: if nothing differs, a parameter shows a
difference in at most 5 % of comparisons.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from analysis.record import Interval
from analysis.speed_transport import ComparedValue, at_one_speed
from analysis.statistics import TWO_SIDED

LEVEL = 0.05
"""Probability, after the correction, under which values count as different."""

_NOTHING = 1e-300
"""Of an error: where both intervals have no width, any difference is one."""

_BOUNDS = (0.0, 1.0)
"""Ends of what a restitution, a drag and a mass can be."""

TEST_WORDS = (
    "Two values differ where their difference is more than the logs' own 95 % intervals explain "
    "(errors normal and independent, added by squares), at 5 % after Holm's correction over the "
    "pairs of one parameter. An error that two logs share, such as a camera's or an arm's, is not "
    "in it."
)
"""The test, for readers."""


@dataclass(frozen=True)
class PairTest:
    """Two values of one quantity.

    Attributes:
        first: label of the log whose value is taken.
        second: label of the log whose value is taken from it.
        difference: first less second, in the quantity's unit.
        interval95: of the difference.
        probability: of one so large or larger if both are the same, two-sided; None if not tested.
        corrected: the same after Holm's correction; None if not tested.
        speed_m_s: at which restitutions were compared; None for what knows no speed.
        caution: what to bear in mind, as one short sentence; "" if nothing.
    """

    first: str
    second: str
    difference: float
    interval95: Interval
    probability: float | None
    corrected: float | None = None
    speed_m_s: float | None = None
    caution: str = ""

    @property
    def differs(self) -> bool:
        """Whether the two are told apart."""
        return self.corrected is not None and self.corrected < LEVEL


def pair_tests(values: Sequence[ComparedValue]) -> list[PairTest]:
    """A test of each pair of values with intervals, not corrected yet."""
    known = [value for value in values if value.interval95 is not None]
    return [_test(*pair) for pair in combinations(known, 2)]


def _test(first: ComparedValue, second: ComparedValue) -> PairTest:
    if first.is_restitution:
        first, second, speed_m_s, caution = at_one_speed(first, second)
    else:
        speed_m_s, caution = None, ""
    (down, up), (other_down, other_up) = _errors(first), _errors(second)
    difference = first.value - second.value
    below, above = math.hypot(down, other_up), math.hypot(up, other_down)
    probability: float | None = None
    if first.sha256 and first.sha256 == second.sha256:
        caution = "the same recording: not compared"
    else:
        toward_zero = below if difference > 0 else above
        deviations = abs(difference) * TWO_SIDED / max(toward_zero, _NOTHING)
        probability = math.erfc(min(deviations, 1e6) / math.sqrt(2))
    ends = difference - below, difference + above
    labels = first.label, second.label
    return PairTest(*labels, difference, ends, probability, None, speed_m_s, caution)


def _errors(value: ComparedValue) -> Interval:
    """How far the interval reaches down and up.

    One that ends where physics does, as a drag's at 0, is cut: its other part tells the error.
    """
    assert value.interval95 is not None
    low, high = value.interval95
    down, up = max(value.value - low, 0.0), max(high - value.value, 0.0)
    is_cut = low in _BOUNDS or high in _BOUNDS
    return (max(down, up), max(down, up)) if is_cut else (down, up)


def holm(tests: Sequence[PairTest]) -> list[PairTest]:
    """With the probabilities corrected (Holm 1979, "A simple sequentially rejective ...")."""
    order = [index for index, test in enumerate(tests) if test.probability is not None]
    order.sort(key=lambda index: tests[index].probability or 0.0)
    corrected, least = list(tests), 0.0
    for rank, index in enumerate(order):
        least = max(least, min((tests[index].probability or 0.0) * (len(order) - rank), 1.0))
        corrected[index] = replace(tests[index], corrected=least)
    return corrected
