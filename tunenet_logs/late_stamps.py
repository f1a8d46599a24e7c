"""Restore acquisition times of samples that were stamped on arrival.

A network or a busy machine only delays, and a sensor's clock is uniform. There are two ways to be
late. Now and then: the stamps are even but for a pause, and after it as many samples as it would
have held, one close upon the other. Or each by its own jitter, as pictures over Wi-Fi are: then the
clock behind all arrivals is fitted (`even_clock`).

Stamps that are no arrivals stay what they are: exact ones of which some are missing, those of a
sensor that is not even, or of one that slows down as a camera does in the dark. Which it is, the
stamps show: delays add up to nothing, and what came late is followed by what comes close upon it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.bursts import is_grid, without_bursts
from tunenet_logs.changing_rate import changing_rate
from tunenet_logs.even_clock import LAG, EvenClock, even_clock

# The note of a log's info record that says whose clock a camera's stamps are of.
STAMPS_NOTE = "stamps"

# What it begins with where they were found from the arrivals, which are the log's own times.
BY_ARRIVALS = "even clock"

# What it begins with where the times that are read are arrivals.
ARRIVALS = (BY_ARRIVALS, "arrival")

_MIN_SAMPLES = 10  # fewer do not tell an even clock's period
# Of a period: steps that differ by less are alike. Of the steps: as many are like the next one
# where each sample is stamped when it was taken.
_ALIKE, _MOSTLY = 0.02, 0.5

# Of a period, and at least: standard deviation of delays that are worth a correction.
_LATE, _LATE_MS = 0.02, 0.3

# Standard deviation of delays over that of the steps: delays of one sample each give 0.7, and a
# sensor whose steps differ by themselves drifts far from any even clock.
_ADDS_UP = 1.1

# Of a period, and of the steps: no sensor is so fast so often, but what waited on its way is.
_HURRIED, _OFTEN = 0.25, 0.05

_FEW_LOST = 0.2  # of all ticks: with more missing, an even clock explains whatever comes
_ROUNDED = 1.5  # of what stamps are rounded to: delays that are no more than that are rounding
# Samples whose steps are put in another order, and log likelihood a sample that it must cost.
_COMPARED, _TELLING = 512, 0.4

MAX_SAMPLES = 50_000  # of which a clock is sought: a quarter of an hour of a camera
# Quantile to which single long delays and steps are cut where two spreads are compared.
_UNUSUAL = 0.9


@dataclass(frozen=True, eq=False)
class CorrectedStamps:
    """Recorded stamps, and the same with those of late samples corrected.

    Attributes:
        recorded_ns: shape (T,) [ns].
        stamps_ns: when the samples were taken, increasing, shape (T,) [ns].
        clock: the uniform clock that they are taken from; None where they are not.
        rates: how the rate of the samples changes, in words; "" where it does not.
    """

    recorded_ns: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    clock: EvenClock | None = None
    rates: str = ""

    @property
    def taken_ns(self) -> dict[int, int]:
        """Acquisition time [ns] by recorded stamp [ns], of late samples only."""
        late = self.recorded_ns != self.stamps_ns
        return dict(
            zip(self.recorded_ns[late].tolist(), self.stamps_ns[late].tolist(), strict=True)
        )

    def warnings(self, samples: str) -> list[str]:
        """Return warnings about late samples, which are called `samples`; empty if none is late."""
        said = [f"the rate of the {samples} {self.rates}"] if self.rates else []
        count = len(self.taken_ns)
        if not count:
            return said
        if self.clock is None:
            latest_ms = float(np.max(self.recorded_ns - self.stamps_ns)) * 1e-6
            late = f"{count} {samples} came in bursts, up to {latest_ms:.0f} ms late: their stamps"
            return [*said, f"{late} are taken as even"]
        return [
            *said,
            f"the {samples} came up to {self.clock.lateness.max():.0f} ms late: they are stamped "
            f"by the even clock behind their arrivals ({clock_in_words(self.clock)})",
        ]


def clock_in_words(clock: EvenClock) -> str:
    """Describe a clock and its accuracy: "60.00 Hz, known to 0.1 ms, 2 missing"."""
    words = f"{clock.rate_hz:.2f} Hz, known to {clock.rms_ms:.1f} ms"
    if clock.lost:
        words += f", {clock.lost} missing"
    if unsure := int(np.count_nonzero(clock.unsure)):
        words += f", {unsure} perhaps a place off"
    return words


def correct_late_stamps(
    stamps_ns: NDArray[np.int64], *, are_arrivals: bool = False
) -> CorrectedStamps:
    """Put late samples back on the uniform clock behind them, where the stamps show one.

    A burst that does not make up for its pause is left as it is, and so are stamps on an exact grid
    of which points are left out: no burst hits it.

    Args:
        stamps_ns: not decreasing, shape (T,) [ns].
        are_arrivals: whether it is known that they are, else the stamps themselves have to show it.
    """
    if len(stamps_ns) < _MIN_SAMPLES:
        return CorrectedStamps(stamps_ns, stamps_ns)
    if are_arrivals and (clock := clock_behind(stamps_ns, are_arrivals=True)[0]):
        return CorrectedStamps(stamps_ns, clock.stamps_ns, clock)
    steps = np.diff(stamps_ns).astype(np.float64)
    period, lag = float(np.median(steps)), min(LAG, len(steps) // 2)
    usual = float(np.median(stamps_ns[lag:] - stamps_ns[:-lag])) / lag
    comes_singly = period > usual / 2
    is_exact = comes_singly and np.mean(np.abs(np.diff(steps)) < _ALIKE * period) > _MOSTLY
    if comes_singly and is_grid(steps, period):
        rates = changing_rate(stamps_ns, 1 if is_exact else LAG)
        return CorrectedStamps(stamps_ns, stamps_ns, rates=rates)
    if is_exact or len(stamps_ns) > MAX_SAMPLES:
        even = without_bursts(stamps_ns, steps, period)
        return CorrectedStamps(stamps_ns, even, rates=changing_rate(even))
    clock, rates = clock_behind(stamps_ns)
    if clock is None or not _is_worth(clock):
        return CorrectedStamps(stamps_ns, stamps_ns, rates=rates)
    return CorrectedStamps(stamps_ns, clock.stamps_ns, clock)


def clock_behind(
    arrivals_ns: NDArray[np.int64], *, are_arrivals: bool = False
) -> tuple[EvenClock | None, str]:
    """Fit the uniform clock behind samples each of which has its own delay.

    Args:
        arrivals_ns: not decreasing, shape (T,) [ns].
        are_arrivals: whether it is known that they are.

    Returns:
        The clock, or None where none can be determined, and then how the rate changes, in words; ""
        where it does not.
    """
    if rates := changing_rate(arrivals_ns, LAG):
        return None, rates
    clock = even_clock(arrivals_ns) if len(arrivals_ns) <= MAX_SAMPLES else None
    if clock is None or np.any(np.diff(clock.stamps_ns) <= 0) or not _explains(clock):
        return None, ""
    return (clock if are_arrivals or _is_telling(clock) else None), ""


def _is_worth(clock: EvenClock) -> bool:
    """Check whether delays exceed rounding, and what is as well left alone."""
    late = clock.lateness
    if np.ptp(late) < _ROUNDED * np.gcd.reduce(np.diff(clock.arrivals_ns)) * 1e-6:
        return False
    return _spread(late - np.median(late)) > max(_LATE * float(np.median(clock.periods)), _LATE_MS)


def _explains(clock: EvenClock) -> bool:
    """Check whether a clock's residuals are delays: they add up to nothing, few ticks are lost."""
    stamps_ns, late = clock.arrivals_ns, clock.lateness
    if clock.lost > _FEW_LOST * (clock.lost + len(late)):
        return False
    period, steps = float(np.median(clock.periods)), 1e-6 * np.diff(stamps_ns)
    spread = _spread(late - np.median(late))
    is_hurried = np.mean(steps < _HURRIED * period) > _OFTEN
    own = _spread(steps - period * np.diff(clock.ticks))
    return bool(is_hurried or spread <= max(_ADDS_UP * own, _LATE * period))


def _is_telling(clock: EvenClock) -> bool:
    """Test by permutation whether shuffled steps are much less like a uniform clock.

    They are not where the steps are a sensor's own, that is not even.
    """
    first = clock.arrivals_ns[:_COMPARED]
    shuffled = np.random.default_rng(0).permutation(np.diff(first))
    whole = clock if len(first) == len(clock.arrivals_ns) else even_clock(first)
    other = even_clock(first[0] + np.cumsum(np.append(0, shuffled)))
    assert whole is not None
    assert other is not None
    return other.cost - whole.cost > _TELLING * len(first)


def _spread(values: NDArray[np.float64]) -> float:
    """Return the winsorised root mean square: single large values are cut."""
    size = np.abs(values)
    return float(np.sqrt(np.mean(np.minimum(size, np.quantile(size, _UNUSUAL)) ** 2)))
