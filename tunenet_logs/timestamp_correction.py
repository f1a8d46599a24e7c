"""Which of a log's clocks to believe, samples in order, and stamps of late samples corrected.

Late samples are those that were stamped when they arrived, and were held up on their way. A sensor
with an even clock gives no burst. So a pause, and after it as many samples as it would have held,
one close upon the other, are what a stalled network or a busy machine makes of an even clock: no
sample was lost, and each was taken where that clock says.

A camera that lost sight of a thing now and then leaves pauses as well, but its stamps stay on the
grid of its frames. A burst does not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.clock_jumps import sound_part, written_part

_MAX_REVERSED_FRACTION = 0.1
"""Of a channel's samples: a few that overtake each other on a network are sorted; from a tenth on
the header's clock is set back again and again."""

_MIN_DISTINCT_FRACTION = 0.1
"""Of a channel's stamps; below it, its sender hardly ever sets the header's stamp."""

_MOST_SOUND = 0.9
"""Of a channel's stamps before or after a jump: with more of them the others are left out."""

_PAUSE_PERIODS = 1.5
"""A longer step is a pause: half-way between the usual step and that over one missing sample."""

_CLOSE_PERIODS = 0.9
"""A shorter step belongs to a burst that catches up; an even clock's own jitter is smaller."""

_PUNCTUAL_PERIODS = 0.3
"""A sample is no later than that where the burst has made up for the pause."""

_PATIENCE_SAMPLES = 3
"""Samples in a row that are not close, after which what follows a pause is no burst."""

_MIN_SAMPLES = 10
"""Fewer do not tell an even clock's period."""

_SINGLE_FRACTION = 0.1
"""Of the steps: at least so many go to the very next point of a grid that has points left out."""

_MOST_MEDIAN_FRAMES = 3
"""Of the median step on a grid: with more, what looks like its frames is how stamps are rounded."""

_NEAR_PERIODS = 8
"""Longer steps tell nothing of a grid: the error of its period adds up."""

_ROUNDING_NS = 1_100
"""Of a step between two stamps of whole microseconds, or of ..."""

_ROUNDING_FRACTION = 1e-3
"""... a frame."""


def trusts_header(header_ns: NDArray[np.int64]) -> tuple[bool, list[str]]:
    """Whether a channel's header stamps tell the time; if not for a reason to hear of, that too.

    Args:
        header_ns: acquisition stamps of T messages in file order [ns], shape (T,); 0 where not set.
    """
    if not len(header_ns):
        return True, []
    if np.count_nonzero(header_ns == 0) > 1:
        return False, []
    if len(np.unique(header_ns)) <= _MIN_DISTINCT_FRACTION * len(header_ns):
        return False, ["header stamps hardly change, so the log's own times are used"]
    if np.count_nonzero(np.diff(header_ns) < 0) > _MAX_REVERSED_FRACTION * len(header_ns):
        return False, ["header stamps run backwards, so the log's own times are used"]
    return True, []


def jumps_alone(header_ns: NDArray[np.int64], log_ns: NDArray[np.int64]) -> str:
    """Why the log's own times tell more than a header whose clock jumps; "" where they do not.

    A single stamp that is off is no reason: it is left out.

    Args:
        header_ns: acquisition stamps of T messages in file order [ns], shape (T,).
        log_ns: receipt stamps of the same messages [ns], shape (T,).
    """
    jumps = _jumps(header_ns)
    if not jumps or _jumps(log_ns):
        return ""
    return f"{jumps.partition(':')[0]} in header stamps, so the log's own times are used"


def _jumps(stamps_ns: NDArray[np.int64]) -> str:
    """How a clock jumps, in words, where much is lost by it; "" where it does not."""
    for part in (written_part(stamps_ns), sound_part(np.sort(stamps_ns))):
        if len(part.keep) < _MOST_SOUND * len(stamps_ns):
            return part.words[-1]
    return ""


def order_samples(
    header_ns: NDArray[np.int64], log_ns: NDArray[np.int64]
) -> tuple[NDArray[np.intp], NDArray[np.int64], list[str]]:
    """Choose stamps and sort.

    `header.stamp` is used where it is set and, but for a few samples, monotonic; else `log_time`.

    Args:
        header_ns: acquisition stamps of T messages in file order [ns], shape (T,); 0 where not set.
        log_ns: receipt stamps of the same messages [ns], shape (T,).

    Returns:
        Indices of the K samples to keep, shape (K,), their stamps [ns], shape (K,), strictly
        increasing, and what was repaired.
    """
    is_header, notes = trusts_header(header_ns)
    if is_header and (reason := jumps_alone(header_ns, log_ns)):
        is_header, notes = False, [reason]
    order, ordered, repairs = sorted_stamps(header_ns if is_header else log_ns)
    return order, ordered, notes + repairs


def sorted_stamps(
    stamps: NDArray[np.int64],
) -> tuple[NDArray[np.intp], NDArray[np.int64], list[str]]:
    """Sort; of samples with one stamp the first is kept, and of a clock that is set back one part.

    Args:
        stamps: of T samples in file order [ns], shape (T,).

    Returns:
        Indices of the K samples to keep, shape (K,), their stamps [ns], shape (K,), strictly
        increasing, and what was repaired.
    """
    written, words = written_part(stamps)
    notes = list(words)
    stamps = stamps[written]
    order = np.argsort(stamps, kind="stable")
    reversals = int(np.count_nonzero(np.diff(stamps) < 0))
    ordered = stamps[order]
    fresh = np.diff(ordered, prepend=ordered[:1] - 1) > 0
    duplicates = int(np.count_nonzero(~fresh))
    if reversals:
        notes.append(f"{reversals} samples out of order were sorted")
    if duplicates:
        notes.append(f"{duplicates} samples with a stamp already seen were left out")
    return written[order[fresh]], ordered[fresh], notes


class CorrectedStamps(NamedTuple):
    """Stamps as they were recorded, and with those of late samples corrected.

    Attributes:
        recorded_ns: shape (T,) [ns].
        stamps_ns: when the samples were taken, shape (T,) [ns]; never after `recorded_ns`.
    """

    recorded_ns: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]

    @property
    def taken_ns(self) -> dict[int, int]:
        """When a sample was taken [ns], by its recorded stamp [ns]; late samples only."""
        late = self.recorded_ns != self.stamps_ns
        return dict(
            zip(self.recorded_ns[late].tolist(), self.stamps_ns[late].tolist(), strict=True)
        )

    def warnings(self, samples: str) -> list[str]:
        """What a user should know whose samples came late; empty if none did.

        Args:
            samples: what they are called: "pictures", "samples".
        """
        count = len(self.taken_ns)
        if not count:
            return []
        latest_ms = float(np.max(self.recorded_ns - self.stamps_ns)) * 1e-6
        return [
            f"{count} {samples} came in bursts, up to {latest_ms:.0f} ms late: their stamps are "
            "taken as even"
        ]


def correct_late_stamps(stamps_ns: NDArray[np.int64]) -> CorrectedStamps:
    """Puts samples that arrived in a burst after a pause back on the even clock before the pause.

    The clock's period is the median step. A burst that does not make up for its pause is left as
    it is: then samples were lost, and nothing tells which. So are stamps on an exact grid of which
    points are left out: no burst hits it.

    Args:
        stamps_ns: not decreasing, shape (T,) [ns].
    """
    if len(stamps_ns) < _MIN_SAMPLES:
        return CorrectedStamps(stamps_ns, stamps_ns)
    steps = np.diff(stamps_ns).astype(np.float64)
    period = float(np.median(steps))
    if _is_grid(steps, period):
        return CorrectedStamps(stamps_ns, stamps_ns)
    corrected, after = stamps_ns.copy(), 0
    for pause in np.flatnonzero(steps > _PAUSE_PERIODS * period):
        end = _caught_up(steps, int(pause), period)
        if end is None or pause < after:
            continue
        inside = slice(pause + 1, end)
        even = stamps_ns[pause] + np.round(period * np.arange(1, end - pause)).astype(np.int64)
        corrected[inside] = np.minimum(even, stamps_ns[inside])
        after = end
    return CorrectedStamps(stamps_ns, corrected)


def _is_grid(steps: NDArray[np.float64], period: float) -> bool:
    """Whether all stamps lie on the points of one grid, but for rounding.

    Args:
        steps: between T samples, shape (T - 1,) [ns].
        period: the usual step [ns].
    """
    frame = float(np.quantile(steps, _SINGLE_FRACTION, method="lower"))
    if frame <= 0 or period > (_MOST_MEDIAN_FRAMES + 0.5) * frame:
        return False
    near = steps[steps < _NEAR_PERIODS * period]
    counts = np.round(near / frame)
    if counts.min() < 1:
        return False
    frame = float(near.sum() / counts.sum())
    error = float(np.abs(near - counts * frame).max())
    return error <= max(_ROUNDING_NS, _ROUNDING_FRACTION * frame)


def _caught_up(steps: NDArray[np.float64], pause: int, period: float) -> int | None:
    """The index behind the first step after a pause that ends where an even clock has it, or None.

    Args:
        steps: between T samples, shape (T - 1,) [ns].
        pause: index of the long step.
        period: the usual step [ns].
    """
    lateness, slow = steps[pause] - period, 0
    for at in range(pause + 1, len(steps)):
        slow = 0 if steps[at] < _CLOSE_PERIODS * period else slow + 1
        lateness += steps[at] - period
        if lateness <= _PUNCTUAL_PERIODS * period:
            return at + 1
        if slow == _PATIENCE_SAMPLES:
            return None
    return None
