"""Test whether two values differ significantly, from their confidence intervals.

Each error is the part of a log's own 95 % interval that points at the other value. Errors count as
normal and independent, so that they add in quadrature: the interval of a difference by Zou and
Donner (2008, "MOVER"). Probabilities are corrected by Holm (1979) over all pairs of one parameter:
if nothing differs, a parameter shows a difference in at most 5 % of comparisons.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from analysis.record import Interval
from analysis.speed_transport import ComparedValue, at_one_speed
from analysis.statistics import TWO_SIDED

LEVEL = 0.05  # probability, after the correction, under which values count as different
_NOTHING = 1e-300  # of an error: where both intervals have no width, any difference is one
_BOUNDS = (0.0, 1.0)  # ends of what a restitution, a drag and a mass can be
# The test, for readers.
TEST_WORDS = (
    "Two values differ where their difference is more than the logs' own 95 % intervals explain "
    "(errors normal and independent, added by squares), at 5 % after Holm's correction over the "
    "pairs of one parameter. An error that two logs share, such as a camera's or an arm's, is not "
    "in it."
)


@dataclass(frozen=True)
class PairTest:
    """Test of two values of one quantity.

    Attributes:
        first: Label of the log whose value is the minuend.
        second: Label of the log whose value is subtracted.
        difference: First less second, in the quantity's unit.
        interval95: Of the difference.
        probability: Two-sided p-value; None if not tested.
        corrected: The same after Holm's correction; None if not tested.
        speed_m_s: At which restitutions were compared; None for other quantities.
        caution: One short sentence; "" if nothing.
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
        """Whether the difference is significant."""
        return self.corrected is not None and self.corrected < LEVEL


def pair_tests(values: Sequence[ComparedValue]) -> list[PairTest]:
    """Test each pair of values with intervals; p-values are not corrected yet."""
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
    """Return how far the interval reaches down and up.

    One cut at a physical bound, as a drag's at 0, takes its other half for both.
    """
    assert value.interval95 is not None
    low, high = value.interval95
    down, up = max(value.value - low, 0.0), max(high - value.value, 0.0)
    is_cut = low in _BOUNDS or high in _BOUNDS
    return (max(down, up), max(down, up)) if is_cut else (down, up)


def holm(tests: Sequence[PairTest]) -> list[PairTest]:
    """Correct p-values for multiple tests (Holm 1979, "A simple sequentially rejective ...")."""
    order = [index for index, test in enumerate(tests) if test.probability is not None]
    order.sort(key=lambda index: tests[index].probability or 0.0)
    corrected, least = list(tests), 0.0
    for rank, index in enumerate(order):
        least = max(least, min((tests[index].probability or 0.0) * (len(order) - rank), 1.0))
        corrected[index] = replace(tests[index], corrected=least)
    return corrected
