"""Checks of a tuning as data, and the verdict that follows from them.

A room has one table of `CheckSpec`; `CheckSpec.measured` makes a `Check` of a number. The sentence
that users read, the JSON, the pages and docs/checks.md are made of these.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, NamedTuple

from tunenet_logs.analysis.statistics import TWO_SIDED
from tunenet_logs.episode import BY_CLOCK, MAX_LEFT_OUT, Episode, LeftOut

Verdict = Literal["ok", "suspect", "rejected"]
Sense = Literal["at most", "at least", "within", "true"]

_UNWRITTEN: Mapping[str, Any] = {"key": None}  # of a field that a record's JSON does not hold


@dataclass(frozen=True)
class Check:
    """One comparison with a limit.

    Attributes:
        detail: The measured figure, and its limit.
        fatal: Whether a failure means that no value can be reported at all.
        advice: How to record so that it passes next time, as one short sentence.
        invalidates_interval: Whether a failure puts the model behind the interval in doubt; not so
            if it only leaves less data, which the interval says, or if another check would see it.
        secondary: Whether a failure may follow from that of another check, which is named first.
        value: What was measured, in `unit`; None where it is no number.
        limit: What it is compared with; None where that is no number.
        unit: Of both; "" where they are counts or ratios.
        wanted: The limit in words, as `detail` has it in brackets; "" where it has none.
    """

    name: str
    passed: bool
    detail: str
    fatal: bool = field(default=False, metadata=_UNWRITTEN)
    advice: str = ""
    invalidates_interval: bool = field(default=True, metadata=_UNWRITTEN)
    secondary: bool = field(default=False, metadata=_UNWRITTEN)
    value: float | None = None
    limit: float | None = None
    unit: str = ""
    wanted: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "passed", bool(self.passed))  # NumPy's bool is no JSON

    @property
    def figure(self) -> str:
        """The detail without its limit."""
        return self.detail.replace(f" ({self.wanted})", "", 1) if self.wanted else self.detail


class Limit(NamedTuple):
    """What a measured value is compared with; made by `at_most`, `at_least`, `within`, `TRUE`."""

    sense: Sense
    value: float  # in `unit`; a check whose limit depends on the recording is given its own
    unit: str = ""
    shown: str = ".0f"  # format of value and limit in a sentence; two if they differ
    fatal: float | None = None  # beyond it nothing can be reported; None if never


at_most, at_least = partial(Limit, "at most"), partial(Limit, "at least")
within = partial(Limit, "within")  # to either side of zero
TRUE = Limit("true", 1)  # of a check that has no number
_WANTED = {
    "at most": "at most {limit}",
    "at least": "wanted: {limit} or more",
    "within": "at most {limit} either way",
    "true": "",
}


@dataclass(frozen=True)
class CheckSpec:
    """All of a check but what is measured.

    `seen`, `wanted` and `more` are formats of `{value}`, `{limit}`, `{unit}` and the words that are
    given to `measured`.
    """

    name: str
    limit: Limit
    measures: str  # what it measures, for docs/checks.md
    advice: str  # see `Check`
    seen: str = "{value} {unit}"  # what was seen
    wanted: str | None = None  # the limit, in brackets after it; None for the usual words
    more: str = ""  # what follows the brackets
    passes: str = ""  # what passes, for docs/checks.md; "" for the limit alone
    if_not: str = ""  # what a failure means, for docs/checks.md; "" for what follows from the rest
    invalidates_interval: bool = True  # see `Check`
    secondary: bool = False  # see `Check`

    def measured(
        self,
        value: float,
        limit: float | None = None,
        *,
        detail: str | None = None,
        passed: bool | None = None,
        fatal: bool | None = None,
        unit: str | None = None,
        advice: str | None = None,
        invalidates_interval: bool | None = None,
        secondary: bool | None = None,
        **words: object,
    ) -> Check:
        """Compare a value, in the limit's unit, with the limit; of `TRUE`, whether it passes.

        `detail` stands in place of `seen`, `wanted` and `more`, and what else is given in place of
        what the check or its limit says.
        """
        sense, usual_limit, usual_unit, shown, worst = self.limit
        limit = usual_limit if limit is None else float(limit)
        unit = usual_unit if unit is None else unit
        size = abs(value) if sense == "within" else float(value)
        sign = -1 if sense in ("at least", "true") else 1
        if passed is None:
            passed = sign * size <= sign * limit
        if fatal is None:
            fatal = worst is not None and sign * size > sign * worst
        known: dict[str, object] = {"unit": unit, **words}
        known["value"], known["limit"] = _figures(float(value), limit, shown)
        wanted = ""
        if detail is None:
            wanted = (_WANTED[sense] if self.wanted is None else self.wanted).format(**known)
            brackets = f" ({wanted})" if wanted else ""
            detail = self.seen.format(**known) + brackets + self.more.format(**known)
        has_numbers = sense != "true"
        doubts = self.invalidates_interval if invalidates_interval is None else invalidates_interval
        return Check(
            self.name,
            passed,
            detail,
            bool(fatal),
            self.advice if advice is None else advice,
            doubts,
            self.secondary if secondary is None else secondary,
            float(value) if has_numbers and math.isfinite(value) else None,
            limit if has_numbers and math.isfinite(limit) else None,
            unit,
            wanted,
        )


Table = Mapping[str, CheckSpec]


def table(*specs: CheckSpec) -> Table:
    """Make a room's table of checks, by their names."""
    return {spec.name: spec for spec in specs}


def _figures(value: float, limit: float, shown: str) -> tuple[str, str]:
    """Format a value and its limit, with more digits where they would print alike."""
    value_format, _, limit_format = shown.partition(" ")
    pairs: list[tuple[str, str]] = []
    for more in range(4):
        formats = [
            re.sub(r"\.(\d+)", lambda digits, more=more: f".{int(digits[1]) + more}", one)
            for one in (value_format, limit_format or value_format)
        ]
        pairs.append((format(value, formats[0]), format(limit, formats[1])))
        if float(pairs[-1][0]) != float(pairs[-1][1]):
            return pairs[-1]
    return pairs[0]


@dataclass(frozen=True)
class CrossCheck:
    """Second estimate that shares nothing with the first but the log.

    Attributes:
        agrees: Whether it is less than `tolerance` from the estimate.
        tolerance: Allowed difference: the second one's noise and the systematic errors of a good
            recording; None in a record of before that was kept.
        noise95: Half of its 95 % interval due to noise alone; None if unknown.
        advice: What to do if the two disagree, as one short sentence.
    """

    method: str
    value: float
    agrees: bool
    tolerance: float | None = None
    noise95: float | None = None
    advice: str = field(default="", metadata=_UNWRITTEN)

    @property
    def tells(self) -> bool:
        """Whether it says something: it disagrees, or would, if it were a tenth of itself off."""
        return not self.agrees or self.tolerance is None or self.tolerance < 0.1 * abs(self.value)

    @classmethod
    def judged(
        cls,
        method: str,
        value: float,
        estimate: float,
        tolerance: float,
        *,
        sd: float | None,
        advice: str,
    ) -> CrossCheck:
        """Compare a second estimate with the first; `sd` is the second's by its noise alone."""
        agrees = bool(abs(value - estimate) < tolerance)
        return cls(method, value, agrees, tolerance, None if sd is None else TWO_SIDED * sd, advice)


LOG = table(
    CheckSpec(
        "samples as they were recorded",
        TRUE,
        measures="samples that the file's checksums say were changed",
        passes="none",
        advice="tune the log as it was before it was damaged",
    ),
    CheckSpec(
        "samples are all there",
        at_most(100 * MAX_LEFT_OUT, "%", ".1f"),
        seen="{what}: {value} %",
        measures="samples left out, a tare's too (a set clock, two values at one stamp, damage, "
        "unreadable rows, a budget)",
        passes="at most {limit} % of all",
        advice="stamp samples by a clock that is not set meanwhile, local time by UTC; else "
        "record, copy or export it whole",
    ),
)


def log_checks(episode: Episode, lacking: Sequence[LeftOut]) -> tuple[Check, ...]:
    """Check the file itself: samples that may have been changed, or are missing."""
    intact, whole = LOG.values()
    detail = episode.tainted or "no sample that was read is known to be damaged"
    recorded = intact.measured(not episode.tainted, detail=detail)
    most = max(lacking, key=lambda one: one.share, default=LeftOut("", 0, {}))
    is_clock = most.by_reason.get(BY_CLOCK, 0) > sum(most.by_reason.values()) / 2
    clock_advice, _, advice = whole.advice.partition("; else ")
    advice = clock_advice if is_clock else advice
    nothing = None if most.share else "none is known to be left out"
    return recorded, whole.measured(100 * most.share, what=most, detail=nothing, advice=advice)


def judge(
    checks: Sequence[Check], cross_check: CrossCheck | None, occasion: str
) -> tuple[Verdict, str | None]:
    """Return the verdict, and the reason in one line, causes first, with the first one's remedy."""
    failed = sorted((check for check in checks if not check.passed), key=lambda one: one.secondary)
    fatal = [check for check in failed if check.fatal]
    named = failed
    if fatal:  # what is fatal, and what it may follow from
        causes = [check for check in failed if not check.secondary]
        named = [*causes[:1], *(check for check in fatal[:1] if check not in causes[:1])]
    reasons = [f"{check.name}: {check.detail}" for check in named]
    remedies = [check.advice for check in named]
    if cross_check is not None and not cross_check.agrees and not fatal:
        reasons.append(f"cross-check: {cross_check.value:.3f} by {cross_check.method}")
        remedies.append(cross_check.advice)
    if not reasons:
        return "ok", None
    advice = f"; at the next {occasion}: {remedies[0]}" if remedies[0] else ""
    return "rejected" if fatal else "suspect", "; ".join(reasons) + advice
