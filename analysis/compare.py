"""Compare tunings: group those that are comparable, and test which parameters differ.

Restitutions are first converted to one impact speed. A pair of values is tested by their own 95 %
intervals (MOVER: Zou and Donner 2008). Probabilities are corrected by Holm (1979) over all pairs of
one parameter: if nothing differs, it shows a difference in at most 5 % of comparisons.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

from tunenet_logs.analysis.checks import Verdict
from tunenet_logs.analysis.record import Interval, Record
from tunenet_logs.analysis.statistics import TWO_SIDED
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.ball import MIN_SPEED_M_S

if TYPE_CHECKING:
    import pandas as pd


# ---- Impact speed: convert a restitution to another one by the power law.

_SAME_RATIO = 1.02  # of two speeds: a ball's restitution changes by a thousandth between them


@dataclass(frozen=True)
class ComparedValue:
    """One log's value of one scalar."""

    label: str  # of the log
    value: float  # in the quantity's unit
    interval95: Interval | None  # None if no valid one exists
    verdict: Verdict  # of the log
    sha256: str = ""  # of the recording; "" if unknown
    is_restitution: bool = False  # whether it holds at one speed only
    speed_m_s: float | None = None  # impact speed that it holds for; None if unknown
    slowest_m_s: float | None = None  # least impact speed in this log; None if unknown
    slope: float | None = None  # p of e(v) = e (v / speed)^-p; None if unknown
    slope_half: float | None = None  # half of its 95 % interval; None if it has none


def restitution_value(value: ComparedValue, record: Record) -> ComparedValue:
    """Add the record's impact speeds and slope to a restitution.

    The restitution is that of the impact nearest to the window's: a record may show other bounces
    of the same ball before and after it.
    """
    value = replace(value, is_restitution=True)
    if rebounds := record.rebounds:
        at_s = (record.window or {}).get("impact_s", rebounds[0].impact_s)
        own = min(rebounds, key=lambda rebound: abs(rebound.impact_s - at_s)).impact_speed_m_s or 0
        known = [speed for one in rebounds if (speed := one.impact_speed_m_s or 0) > 0]
        if own > 0:
            value = replace(value, speed_m_s=own, slowest_m_s=min(known))
    slope = record.estimate("restitution_slope")
    if slope is not None and isinstance(slope.value, float) and abs(slope.value) <= 1:
        value = replace(value, slope=slope.value)
        if (ends := slope.components[0].interval95) is not None:
            value = replace(value, slope_half=max(slope.value - ends[0], ends[1] - slope.value))
    return value


def moved(value: ComparedValue, speed_m_s: float) -> ComparedValue:
    """Convert a ball's restitution to another speed by the power law e (v / v_1)^-p.

    The record has no correlation of e and p, so their errors are added as if fully correlated: the
    interval is conservative.
    """
    assert value.speed_m_s is not None
    assert value.slope is not None
    assert value.slope_half is not None
    change = math.log(max(speed_m_s, MIN_SPEED_M_S) / max(value.speed_m_s, MIN_SPEED_M_S))
    factor = math.exp(-value.slope * change)
    middle, ends = value.value * factor, None
    if value.interval95 is not None:
        more = abs(change) * value.slope_half * middle
        low, high = value.interval95
        ends = low * factor - more, high * factor + more
    return replace(value, value=middle, interval95=ends, speed_m_s=speed_m_s)


def at_one_speed(
    first: ComparedValue, second: ComparedValue
) -> tuple[ComparedValue, ComparedValue, float | None, str]:
    """Convert two restitutions to the lower of their speeds, which the faster ball also reaches."""
    if first.speed_m_s is None or second.speed_m_s is None:
        return first, second, None, "no impact speed is known: a difference may be the speed's"
    speed_m_s = min(first.speed_m_s, second.speed_m_s)
    fast = first if first.speed_m_s > speed_m_s else second
    is_far = fast.speed_m_s is not None and fast.speed_m_s > _SAME_RATIO * speed_m_s
    if fast.slope is None or fast.slope_half is None:
        if not is_far:
            return first, second, speed_m_s, ""
        words = f"at {first.speed_m_s:.2f} and {second.speed_m_s:.2f} m/s"
        return first, second, None, f"{words}, slope not known: a difference may be the speed's"
    caution = ""
    if is_far and fast.slowest_m_s is not None and fast.slowest_m_s > _SAME_RATIO * speed_m_s:
        caution = f"no bounce of {fast.label} is so slow: by its law over speed"
    if fast is first:
        return moved(first, speed_m_s), second, speed_m_s, caution
    return first, moved(second, speed_m_s), speed_m_s, caution


# ---- Pair test: whether two values differ significantly.
# The error of a value is the part of its interval that points at the other value. Errors count as
# normal and independent, so that they add in quadrature.

LEVEL = 0.05  # probability, after the correction, under which values count as different
# The test, for readers.
TEST_WORDS = (
    "Two values differ where their difference is more than the logs' own 95 % intervals explain "
    "(errors normal and independent, added by squares), at 5 % after Holm's correction over the "
    "pairs of one parameter. An error that two logs share, such as a camera's or an arm's, is not "
    "in it."
)


@dataclass(frozen=True)
class PairTest:
    """Test of two values of one quantity."""

    first: str  # label of the log whose value is the minuend
    second: str  # label of the log whose value is subtracted
    difference: float  # first less second, in the quantity's unit
    interval95: Interval  # of the difference
    probability: float | None  # two-sided p-value; None if not tested
    corrected: float | None = None  # the same after Holm's correction; None if not tested
    speed_m_s: float | None = None  # at which restitutions were compared; None for other quantities
    caution: str = ""  # one short sentence; "" if nothing

    @property
    def differs(self) -> bool:
        """Whether the difference is significant."""
        return self.corrected is not None and self.corrected < LEVEL


def pair_tests(values: Sequence[ComparedValue]) -> list[PairTest]:
    """Test each pair of values with intervals; p-values are not corrected yet."""
    tests: list[PairTest] = []
    for first, second in combinations([one for one in values if one.interval95 is not None], 2):
        speed_m_s, caution = None, ""
        if first.is_restitution:
            first, second, speed_m_s, caution = at_one_speed(first, second)  # noqa: PLW2901
        (down, up), (other_down, other_up) = _errors(first), _errors(second)
        difference = first.value - second.value
        below, above = math.hypot(down, other_up), math.hypot(up, other_down)
        probability: float | None = None
        if first.sha256 and first.sha256 == second.sha256:
            caution = "the same recording: not compared"
        else:
            # Where both intervals have no width, any difference is one.
            toward_zero = max(below if difference > 0 else above, 1e-300)
            deviations = abs(difference) * TWO_SIDED / toward_zero
            probability = math.erfc(min(deviations, 1e6) / math.sqrt(2))
        ends, labels = (difference - below, difference + above), (first.label, second.label)
        tests.append(PairTest(*labels, difference, ends, probability, None, speed_m_s, caution))
    return tests


def _errors(value: ComparedValue) -> Interval:
    """Return how far the interval reaches down and up.

    One cut at a physical bound, as a drag's at 0, takes its other half for both.
    """
    assert value.interval95 is not None
    low, high = value.interval95
    down, up = max(value.value - low, 0.0), max(high - value.value, 0.0)
    is_cut = not {low, high}.isdisjoint((0.0, 1.0))  # of a restitution; 0 of a drag and a mass
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


# ---- Comparison: comparable logs in groups, and the tests of each.

MAX_LOGS = 200  # compared at once: with n logs there are n²/2 pairs, and nobody reads more


@dataclass(frozen=True)
class ComparedQuantity:
    """One scalar parameter, or component of one, across the logs that have it."""

    name: str  # the parameter's, with the component for one of several numbers: "payload_com_x"
    unit: str  # "1" if it has none
    values: tuple[ComparedValue, ...]  # one per log that has it, in the logs' order
    tests: tuple[PairTest, ...]  # of each pair of values with intervals


@dataclass(frozen=True)
class ComparedGroup:
    """Comparable logs: of one task, one preset, and one engine if the values depend on it."""

    title: str  # what they have in common
    labels: tuple[str, ...]  # of its logs
    quantities: tuple[ComparedQuantity, ...]  # in the order in which the logs have them


COLUMNS = ("log", "task", "preset", "verdict", "reason", "parameter", "unit", "value", "low")
COLUMNS += ("high", "impact_speed_m_s", "differs_from", "log_sha256")
PAIR_COLUMNS = ("group", "parameter", "unit", "first", "second", "difference", "low", "high", "p")
PAIR_COLUMNS += ("p_holm", "differs", "speed_m_s", "caution")


@dataclass(frozen=True, eq=False)
class Comparison:
    """Tunings of several logs, grouped and tested pairwise.

    Attributes:
        labels: One per record, all different.
        records: In the order given.
        groups: Of logs with values.
    """

    labels: tuple[str, ...]
    records: tuple[Record, ...]
    groups: tuple[ComparedGroup, ...]

    @property
    def without_values(self) -> tuple[tuple[str, Record], ...]:
        """Logs without a value to compare, such as rejected ones, with their labels."""
        pairs = zip(self.labels, self.records, strict=True)
        return tuple((label, record) for label, record in pairs if not record.estimates)

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each quantity of each log, and one for each log without any.

        Columns: log, task, preset, verdict, reason, parameter, unit, value, low, high,
        impact_speed_m_s, differs_from (labels, with "; " between them), log_sha256.
        """
        import pandas as pd

        known: dict[str, dict[str, Any]] = {}
        for label, record in zip(self.labels, self.records, strict=True):
            sha256 = record.provenance.log_sha256 if record.provenance else ""
            known[label] = {"log": label, "task": record.task, "log_sha256": sha256}
            preset = (record.simulator or {}).get("preset")
            known[label] |= {"preset": preset, "verdict": record.verdict, "reason": None}
        rows: list[dict[str, Any]] = []
        for quantity in (quantity for group in self.groups for quantity in group.quantities):
            for value in quantity.values:
                low, high = value.interval95 or (None, None)
                own = {"parameter": quantity.name, "unit": quantity.unit, "value": value.value}
                own |= {"low": low, "high": high, "impact_speed_m_s": value.speed_m_s}
                own["differs_from"] = "; ".join(told_apart(quantity, value.label))
                rows.append(known[value.label] | own)
        bare = dict.fromkeys(("parameter", "unit", "value", "low", "high", "differs_from"))
        for label, record in self.without_values:
            rows.append(known[label] | bare | {"reason": record.reason, "impact_speed_m_s": None})
        return pd.DataFrame(rows, columns=list(COLUMNS))

    def pairs_frame(self) -> pd.DataFrame:
        """Return a row for each pairwise test.

        Columns: group, parameter, unit, first, second, difference, low, high, p, p_holm, differs,
        speed_m_s, caution.
        """
        import pandas as pd

        rows = [
            (
                group.title,
                quantity.name,
                quantity.unit,
                test.first,
                test.second,
                test.difference,
                *test.interval95,
                test.probability,
                test.corrected,
                test.differs,
                test.speed_m_s,
                test.caution,
            )
            for group in self.groups
            for quantity in group.quantities
            for test in quantity.tests
        ]
        return pd.DataFrame(rows, columns=list(PAIR_COLUMNS))


def compare(records: Sequence[Record], names: Sequence[str] | None = None) -> Comparison:
    """Compare the tunings of several logs."""
    labels = distinct([record.log for record in records] if names is None else names)
    if len(labels) != len(records):
        raise UsageError(f"{len(records)} tunings and {len(labels)} names: give one each")
    if len(records) > MAX_LOGS:
        raise UsageError(f"{len(records)} tunings: compare at most {MAX_LOGS} at once")
    members: dict[tuple[str, ...], list[int]] = {}
    for index, record in enumerate(records):
        if record.estimates:
            members.setdefault(_kind(record), []).append(index)
    groups = tuple(
        _group(kind, [labels[index] for index in found], [records[index] for index in found])
        for kind, found in members.items()
    )
    return Comparison(tuple(labels), tuple(records), groups)


def distinct(names: Sequence[str]) -> list[str]:
    """Number names that occur several times."""
    taken, counts = set(names), Counter(names)
    labels: list[str] = []
    for name in names:
        label, number = name, 0
        while counts[name] > 1 and (label in taken or not number):
            number += 1
            label = f"{name} ({number})"
        taken.add(label)
        labels.append(label)
    return labels


def _kind(record: Record) -> tuple[str, ...]:
    """Return the key that records of comparable values share."""
    simulator = record.simulator or {}
    kind = record.task or "unknown task", str(simulator.get("preset", "no preset"))
    return kind if record.physical else (*kind, f"numbers of {simulator.get('engine', 'unknown')}")


def _group(kind: Sequence[str], labels: list[str], records: list[Record]) -> ComparedGroup:
    """Test the scalars of comparable logs; the components of one parameter are one family."""
    values: dict[tuple[str, str], list[ComparedValue]] = {}
    families: dict[tuple[str, str], dict[tuple[str, str], None]] = {}
    for label, record in zip(labels, records, strict=True):
        sha256 = record.provenance.log_sha256 if record.provenance else ""
        for known in record.estimates:
            for part in known.components:
                value = ComparedValue(label, part.value, part.interval95, record.verdict, sha256)
                if part.name == "restitution" and record.physical:
                    value = restitution_value(value, record)
                key = part.name, known.unit
                values.setdefault(key, []).append(value)
                families.setdefault((known.name, known.unit), {})[key] = None
    tests = {key: pair_tests(found) for key, found in values.items()}
    for keys in families.values():
        corrected = iter(holm([test for key in keys for test in tests[key]]))
        tests |= {key: [next(corrected) for _ in tests[key]] for key in keys}
    quantities = tuple(
        ComparedQuantity(name, unit, tuple(found), tuple(tests[name, unit]))
        for (name, unit), found in values.items()
    )
    return ComparedGroup(", ".join(kind), tuple(labels), quantities)


def told_apart(quantity: ComparedQuantity, label: str) -> list[str]:
    """Return the labels of the logs whose value differs significantly from this one's."""
    pairs = [(test.first, test.second) for test in quantity.tests if test.differs]
    return [
        second if first == label else first for first, second in pairs if label in (first, second)
    ]
