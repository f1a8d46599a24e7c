"""Compare two sets of answers to the same logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tunenet_logs.arrays import Array

MOVED = 0.1  # share of the half width of an interval by which a value may differ
_EXACT = 1e-9  # largest difference of values in a group without any interval


@dataclass(frozen=True)
class Answer:
    """Answer to one log.

    Attributes:
        group: the line of the table that it counts in.
        sha256: of the log.
        truth: of the first parameter; None where nobody knows.
        values: by parameter, a number or a list of them; none for a rejected log.
        intervals: 95 %, likewise; None where none was given.
        failed: names of the checks that it did not pass.
    """

    group: str
    sha256: str
    truth: float | None
    verdict: str
    reason: str
    values: Mapping[str, float | list[float]]
    intervals: Mapping[str, list | None]
    failed: Sequence[str]

    def half_width(self, name: str) -> Array | None:
        """Return half the width of a parameter's interval, one for each of its numbers."""
        ends = self.intervals[name]
        return None if ends is None else np.ptp(np.reshape(ends, (-1, 2)), axis=1) / 2

    @property
    def error(self) -> float:
        """Absolute error of the first parameter; NaN where that is unknown."""
        if self.truth is None or not self.values:
            return np.nan
        return abs(float(np.ravel(next(iter(self.values.values())))[0]) - self.truth)

    @property
    def covers(self) -> float:
        """Whether its interval holds the truth, 1 or 0; NaN where either is missing."""
        ends = next(iter(self.intervals.values()), None)
        if self.truth is None or ends is None:
            return np.nan
        low, high = np.reshape(ends, (-1, 2))[0]
        return float(low <= self.truth <= high)


Named = Mapping[str, Answer]


def compared(before: Named, after: Named) -> tuple[str, bool]:
    """Tabulate the pairs and the changes, log by log; return whether there are none."""
    groups = list(dict.fromkeys(one.group for one in before.values()))
    changes = [
        (name, text)
        for group in groups
        for name, text in _changes(_of(before, group), _of(after, group))
    ]
    lines = [_HEAD]
    for group in groups:
        first, second = _of(before, group), _of(after, group)
        lines.append(_line(group, first, second, {name for name, _ in changes}))
    lines += ["", *(f"{name}: {text}" for name, text in changes)] if changes else ["", "no change"]
    return "\n".join(lines), not changes


def _of(answers: Named, group: str) -> Named:
    return {name: one for name, one in answers.items() if one.group == group}


def _changes(before: Named, after: Named) -> list[tuple[str, str]]:
    """List what differs in one group: verdicts, failed checks, values."""
    usual = {
        name: float(np.median(widths))
        for name in {name for one in before.values() for name in one.values}
        if (widths := [w for one in before.values() for w in _widths(one, name)])
    }
    found = []
    for log, old in before.items():
        new = after[log]
        if old.verdict != new.verdict:
            found.append((log, f"{old.verdict} is {new.verdict} now: {new.reason or old.reason}"))
        elif list(old.failed) != list(new.failed):
            found.append((log, f"failed {list(old.failed)}, now {list(new.failed)}"))
        for name in old.values.keys() & new.values.keys():
            first, second = (np.ravel(one.values[name]) for one in (old, new))
            limit = old.half_width(name)
            limit = usual.get(name, _EXACT / MOVED) if limit is None else limit
            if len(first) != len(second) or (np.abs(second - first) > MOVED * limit).any():
                found.append((log, f"{name} {_words(first)} is {_words(second)} now"))
        if old.verdict == new.verdict and old.values.keys() != new.values.keys():
            found.append((log, f"told {sorted(old.values)}, now {sorted(new.values)}"))
    return found


def _widths(answer: Answer, name: str) -> Array:
    found = answer.half_width(name) if name in answer.values else None
    return np.zeros(0) if found is None else found


def _words(values: Array) -> str:
    return ", ".join(f"{value:.6g}" for value in values)


_HEAD = (
    f"{'logs':<26}{'':>5}{'changed':>9}   {'mean error before':<20}{'after':<20}"
    f"{'difference':<20}{'interval holds before':<24}after"
)


def _line(group: str, before: Named, after: Named, changed: set[str]) -> str:
    errors, covers = (
        np.array([[getattr(one[log], what) for log in before] for one in (before, after)])
        for what in ("error", "covers")
    )
    paired = errors[:, np.isfinite(errors).all(axis=0)]
    told = [_mean(one) for one in (*paired, paired[1] - paired[0])]
    held = [_mean(one[np.isfinite(one)], 100.0) for one in covers]
    count = len(changed & before.keys())
    return (
        f"{group:<26}{len(before):>5}{count:>9}   {told[0]:<20}{told[1]:<20}{told[2]:<20}"
        f"{held[0]:<24}{held[1]}"
    ).rstrip()


def _mean(values: Array, scale: float = 1.0) -> str:
    """Format a mean with its standard error; in percent for a scale of 100."""
    if len(values) < 2:
        return "-"
    mean, error = values.mean() * scale, values.std(ddof=1) / np.sqrt(len(values)) * scale
    return f"{mean:.1f} ± {error:.1f} %" if scale != 1 else f"{mean:.5f} ± {error:.5f}"
