"""Checks of a tuning, and the verdict that follows from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from tunenet_logs.analysis.statistics import TWO_SIDED
from tunenet_logs.episode import BY_CLOCK, MAX_LEFT_OUT, Episode, LeftOut

Verdict = Literal["ok", "suspect", "rejected"]

# At most this many digits are added so that a figure and its limit differ in print.
_MORE_DIGITS = 3

_EVEN_CLOCK = "stamp samples by a clock that is not set meanwhile, local time by UTC"


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
    """

    name: str
    passed: bool
    detail: str
    fatal: bool = False
    advice: str = ""
    invalidates_interval: bool = True
    secondary: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "passed", bool(self.passed))  # NumPy's bool is no JSON


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
    advice: str = ""

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
        """Compare a second estimate with the first.

        Args:
            method: In words.
            value: The second estimate.
            estimate: The first estimate.
            tolerance: Allowed difference.
            sd: Standard deviation of the second by its noise alone; None if unknown.
            advice: See `CrossCheck`.
        """
        agrees = bool(abs(value - estimate) < tolerance)
        return cls(method, value, agrees, tolerance, None if sd is None else TWO_SIDED * sd, advice)


def log_checks(episode: Episode, lacking: Sequence[LeftOut]) -> tuple[Check, ...]:
    """Check the file itself: samples that may have been changed, or are missing."""
    detail = episode.tainted or "no sample that was read is known to be damaged"
    advice = "tune the log as it was before it was damaged"
    recorded = Check("samples as they were recorded", not episode.tainted, detail, advice=advice)
    most = max(lacking, key=lambda one: one.share, default=LeftOut("", 0, {}))
    share, limit = figures(100 * most.share, 100 * MAX_LEFT_OUT, 1)
    nothing = "none is known to be left out"
    detail = f"{most}: {share} % (at most {limit})" if most.share else nothing
    is_clock = most.by_reason.get(BY_CLOCK, 0) > sum(most.by_reason.values()) / 2
    advice = _EVEN_CLOCK if is_clock else "record, copy or export it whole"
    return (recorded, Check("samples are all there", not most.is_much, detail, advice=advice))


def judge(
    checks: Sequence[Check], cross_check: CrossCheck | None, occasion: str
) -> tuple[Verdict, str | None]:
    """Return the verdict, and its reason in one line, causes first, with the remedy of the first.

    Args:
        checks: All of them.
        cross_check: None if the log allows none.
        occasion: What a user would do again, e.g. "drop".
    """
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


def figures(seen: float, limit: float, digits: int, kind: str = "f") -> tuple[str, str]:
    """Format two numbers with `digits` digits, or more where they would print alike."""
    for more in range(digits, digits + _MORE_DIGITS + 1):
        pair = f"{seen:.{more}{kind}}", f"{limit:.{more}{kind}}"
        if pair[0] != pair[1]:
            return pair
    return f"{seen:.{digits}{kind}}", f"{limit:.{digits}{kind}}"
