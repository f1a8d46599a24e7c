"""Compare tunings: group those that are comparable, and test which parameters differ."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from analysis.checks import Verdict
from analysis.pair_test import PairTest, holm, pair_tests
from analysis.record import Record
from analysis.speed_transport import ComparedValue, restitution_value
from tunenet_logs.errors import UsageError

if TYPE_CHECKING:
    import pandas as pd

MAX_LOGS = 200  # compared at once: with n logs there are n²/2 pairs, and nobody reads more


@dataclass(frozen=True)
class ComparedQuantity:
    """One scalar parameter, or component of one, across the logs that have it.

    Attributes:
        name: The parameter's, with the component for one of several numbers: "payload_com_x".
        unit: "1" if it has none.
        values: One per log that has it, in the logs' order.
        tests: Of each pair of values with intervals.
    """

    name: str
    unit: str
    values: tuple[ComparedValue, ...]
    tests: tuple[PairTest, ...]


@dataclass(frozen=True)
class ComparedGroup:
    """Comparable logs: of one task, one preset, and one engine if the values depend on it.

    Attributes:
        title: What they have in common.
        labels: Of its logs.
        quantities: In the order in which the logs have them.
    """

    title: str
    labels: tuple[str, ...]
    quantities: tuple[ComparedQuantity, ...]


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

        rows = [row for group in self.groups for row in _rows(self, group)]
        rows += [
            {**_of_record(label, record), "reason": record.reason}
            for label, record in self.without_values
        ]
        return pd.DataFrame(rows, columns=list(COLUMNS))

    def pairs_frame(self) -> pd.DataFrame:
        """Return a row for each pairwise test.

        Columns: group, parameter, unit, first, second, difference, low, high, p, p_holm, differs,
        speed_m_s, caution.
        """
        import pandas as pd

        rows = [
            {
                "group": group.title,
                "parameter": quantity.name,
                "unit": quantity.unit,
                "first": test.first,
                "second": test.second,
                "difference": test.difference,
                "low": test.interval95[0],
                "high": test.interval95[1],
                "p": test.probability,
                "p_holm": test.corrected,
                "differs": test.differs,
                "speed_m_s": test.speed_m_s,
                "caution": test.caution,
            }
            for group in self.groups
            for quantity in group.quantities
            for test in quantity.tests
        ]
        return pd.DataFrame(rows, columns=list(PAIR_COLUMNS))


COLUMNS = ("log", "task", "preset", "verdict", "reason", "parameter", "unit", "value", "low")
COLUMNS += ("high", "impact_speed_m_s", "differs_from", "log_sha256")
PAIR_COLUMNS = ("group", "parameter", "unit", "first", "second", "difference", "low", "high", "p")
PAIR_COLUMNS += ("p_holm", "differs", "speed_m_s", "caution")


def compare(records: Sequence[Record], names: Sequence[str] | None = None) -> Comparison:
    """Compare the tunings of several logs.

    Args:
        records: One per log.
        names: Label of each log; None for the logs' own names. Equal ones are numbered.

    Raises:
        UsageError: There are more than `MAX_LOGS`, or not one name per record.
    """
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
    preset = str(simulator.get("preset", "no preset"))
    if record.physical:
        return record.task or "unknown task", preset
    return record.task or "unknown task", preset, f"numbers of {simulator.get('engine', 'unknown')}"


def _group(kind: Sequence[str], labels: list[str], records: list[Record]) -> ComparedGroup:
    values: dict[tuple[str, str], list[ComparedValue]] = {}
    for label, record in zip(labels, records, strict=True):
        for (name, unit), value in _values(label, record):
            values.setdefault((name, unit), []).append(value)
    tests = {key: pair_tests(found) for key, found in values.items()}
    families: dict[tuple[str, str], list[tuple[str, str]]] = {}
    of_parameter = {
        part.name: known.name
        for record in records
        for known in record.estimates
        for part in known.components
    }
    for name, unit in values:
        families.setdefault((of_parameter[name], unit), []).append((name, unit))
    for keys in families.values():  # the components of one parameter are one family
        corrected = iter(holm([test for key in keys for test in tests[key]]))
        for key in keys:
            tests[key] = [next(corrected) for _ in tests[key]]
    quantities = tuple(
        ComparedQuantity(name, unit, tuple(found), tuple(tests[name, unit]))
        for (name, unit), found in values.items()
    )
    return ComparedGroup(", ".join(kind), tuple(labels), quantities)


def _values(label: str, record: Record) -> list[tuple[tuple[str, str], ComparedValue]]:
    """List a log's scalar values by name and unit."""
    sha256 = record.provenance.log_sha256 if record.provenance else ""
    found: list[tuple[tuple[str, str], ComparedValue]] = []
    for known in record.estimates:
        for part in known.components:
            value = ComparedValue(label, part.value, part.interval95, record.verdict, sha256)
            if part.name == "restitution" and record.physical:
                value = restitution_value(value, record)
            found.append(((part.name, known.unit), value))
    return found


def _rows(comparison: Comparison, group: ComparedGroup) -> list[dict[str, Any]]:
    record_of = dict(zip(comparison.labels, comparison.records, strict=True))
    return [
        {
            **_of_record(value.label, record_of[value.label]),
            "parameter": quantity.name,
            "unit": quantity.unit,
            "value": value.value,
            "low": value.interval95[0] if value.interval95 else None,
            "high": value.interval95[1] if value.interval95 else None,
            "impact_speed_m_s": value.speed_m_s,
            "differs_from": "; ".join(told_apart(quantity, value.label)),
        }
        for quantity in group.quantities
        for value in quantity.values
    ]


def _of_record(label: str, record: Record) -> dict[str, Any]:
    verdict: Verdict = record.verdict
    preset = (record.simulator or {}).get("preset")
    sha256 = record.provenance.log_sha256 if record.provenance else ""
    known = {"log": label, "task": record.task, "preset": preset, "verdict": verdict}
    return {**known, "log_sha256": sha256}


def told_apart(quantity: ComparedQuantity, label: str) -> list[str]:
    """Return the labels of the logs whose value differs significantly from this one's."""
    different = [test for test in quantity.tests if test.differs]
    return [
        test.second if test.first == label else test.first
        for test in different
        if label in (test.first, test.second)
    ]
