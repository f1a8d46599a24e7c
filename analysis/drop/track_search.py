"""Drop in a recorded track: which way is up, in which units, let go or thrown."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.drop.detection import DropDetection
from analysis.drop.flights import chains_in
from analysis.drop.free_fall import Drop, find_drops, outliers
from analysis.drop.gravity import Gravity, gravity_in
from analysis.drop.launched import launched_drops
from analysis.drop.motion import fit_excess_percent
from analysis.drop.remedies import GOOD_DROP, LET_GO, RIGHT_LENGTHS
from analysis.drop.track_outliers import ball_alone
from analysis.drop.units import (
    Scaled,
    named_units,
    scaled_alone,
    scaled_by_gravity,
    units_words,
)
from analysis.motion import Units
from analysis.statistics import noise_of
from recorders.simulators.balls import Ball
from recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.arrays import Array
from tunenet_logs.episode import UNSTATED, Signal
from tunenet_logs.errors import NotFoundError

# What may be up, the likeliest first.
_AXES = {
    f"{'+' if sign > 0 else '-'}{'xyz'[axis]}": sign * np.eye(3)[axis]
    for axis in (2, 1, 0)
    for sign in (1, -1)
}

_MIN_COUNT = 10  # samples in which a bounce can be
_FARTHEST = 1e6  # a coordinate beyond it is a marker for "none"
# Of the drop height, and of gravity: a drop from rest that is farther off is looked at again.
_MAX_EXCESS_PERCENT, _WITHIN_GRAVITY = 0.5, 0.05

_LOWEST = 0.005  # quantile of a recording's heights that no single bad sample moves
# Of the drop height: beside others, a track that is farther off is no ball's.
_NO_BALL_PERCENT = 5.0

# Of the drop height, and of the noise, below the contact: there it was not the table's.
_SUNK, _SUNK_SDS = 0.03, 6.0

_UNSURE = 0.035  # half width of an interval from which on a bounce of a thrown ball tells nothing


@dataclass(frozen=True, eq=False)
class PositionTrack:
    """Positions of one thing that may be a ball.

    Attributes:
        signal: positions in any unit.
        start_ns: where the drop's clock is 0: the first sample of the log's signal.
        physical: whether the preset simulates the ball itself.
        ball: what was dropped, as far as it is known.
    """

    signal: Signal
    start_ns: int
    physical: bool
    ball: Ball

    def part(self, start_s: float | None, end_s: float | None) -> PositionTrack:
        """Select a part [s since the first sample], without samples that hold no position.

        Raises:
            NotFoundError: nothing is left.
        """
        signal, seconds = self.signal, self.signal.seconds
        keep: NDArray[np.bool_] = np.all(np.abs(signal.values) < _FARTHEST, axis=1)  # NaN is not
        if start_s is not None:
            keep &= seconds >= start_s
        if end_s is not None:
            keep &= seconds <= end_s
        signal = replace(signal, stamps_ns=signal.stamps_ns[keep], values=signal.values[keep])
        if not len(signal.stamps_ns):
            raise NotFoundError("no sample with a position (in the part that was selected)", _PART)
        return replace(self, signal=signal)

    def detect(self) -> DropDetection:
        """Detect the first drop, from rest if the ball moves like that, else the first free bounce.

        Raises:
            NotFoundError: there is none; the message says why.
        """
        signal, usual, reason = self.signal, None, None
        if not signal.counts_frames and signal.unit in ("m", UNSTATED):
            in_metres = replace(self, signal=replace(signal, unit="m"))
            try:
                usual = in_metres.from_rest(named_units(signal), _AXES.items())
            except NotFoundError as why:
                reason = why if signal.unit == "m" else None
            if usual is not None and moves_as_found(usual):
                return usual
        free = self._surely_free()
        if free is not None and (usual is None or moves_as_found(free) or not _may_be(usual)):
            return free
        if usual is None:
            what = "no free flight that ends in an impact is seen"
            raise reason or NotFoundError(what, GOOD_DROP)
        if usual.physical and not _may_be(usual):
            raise _why_not(usual)
        return usual

    def _surely_free(self) -> DropDetection | None:
        """Detect as `_free`; where that does not move as found, without samples of other things."""
        free = self._free()
        if free is not None and moves_as_found(free):
            return free
        ball = ball_alone(self.signal) if self.physical else None
        if ball is None:
            return free
        again = replace(self, signal=ball.signal)._free()
        if again is None or (free is not None and _excess(free) <= _excess(again)):
            return free
        first_s, last_s = again.found.seconds[[0, -1]]
        jumps_s = (ball.jumps_ns - self.start_ns) * 1e-9
        jumps = int(np.count_nonzero((jumps_s > first_s) & (jumps_s < last_s)))
        warnings = (*again.warnings, *ball.words)
        return replace(again, outliers=again.outliers + jumps, warnings=warnings)

    def _free(self) -> DropDetection | None:
        """Detect the drop by the gravity of the recording's own flights; None without any."""
        signal = self.signal
        if not self.physical or len(signal.stamps_ns) < _MIN_COUNT:
            return None
        is_timed = signal.unit in ("m", UNSTATED) and not signal.counts_frames
        shared = gravity_in(signal.seconds, signal.values)
        usual = gravity_in(signal.seconds, signal.values, GRAVITY_M_S2) if is_timed else None
        if shared is None and usual is None and signal.unit == "m" and is_timed:
            usual = self._usual_gravity()
        best: DropDetection | None = None
        for gravity in (shared, usual):
            found = None if gravity is None else self._falling_with(gravity)
            if found is not None and moves_as_found(found):
                return found
            best = best or found
        return best

    def _falling_with(self, gravity: Gravity) -> DropDetection | None:
        """Detect the drop by one gravity of the recording; None where there is none."""
        signal = self.signal
        along = signal.values @ gravity.up
        chains = chains_in(signal.seconds, along, gravity.size, gravity.noise)
        if not chains:
            return None
        first = chains[0]
        depth = float(along[first.first] - along[first.impacts[0]])
        scaled = scaled_by_gravity(signal, gravity, max(depth, 1e-9))
        found = self._scaled_drop(scaled, gravity)
        if scaled.units.length_by == "gravity" and not scaled.units.doubt:
            falls = 0.0 if found is None else found.drop.gravity_m_s2 / GRAVITY_M_S2
            if abs(falls - 1) > _WITHIN_GRAVITY:  # near a unit, and not in it
                return self._scaled_drop(scaled_alone(signal, gravity), gravity) or found
        return found

    def _scaled_drop(self, scaled: Scaled, gravity: Gravity) -> DropDetection | None:
        """Detect the drop in a track of known scale: from rest if it moves so, else launched."""
        track = replace(self, signal=scaled.signal)
        try:
            usual = track.from_rest(scaled.units, [(gravity.up_name, gravity.up)])
            if moves_as_found(usual):
                return usual
        except NotFoundError:
            pass
        return track.launched(scaled.units, gravity, gravity.noise * scaled.size)

    def _usual_gravity(self) -> Gravity:
        """Guess gravity along the axis of most motion, z if in doubt: flights are short."""
        spans = np.ptp(self.signal.values, axis=0) * np.array([0.5, 0.75, 1.0])
        up = np.eye(3)[int(spans.argmax())]
        return Gravity(GRAVITY_M_S2, up, noise_of(self.signal.values @ up))

    def from_rest(self, units: Units, ups: Iterable[tuple[str, Array]]) -> DropDetection:
        """Detect the first drop of a ball that was let go at rest.

        `units` are the log's, this track's metres and seconds; of `ups`, the likeliest comes first.

        Raises:
            NotFoundError: there is none.
        """
        signal = self.signal
        low, high = np.quantile(signal.values, (0.001, 0.999), axis=0)
        first_reason: NotFoundError | None = None
        odd: DropDetection | None = None
        for name, up in ups:
            if float(np.abs(up) @ (high - low)) < 0.5 * (high - low).max():
                continue
            along = signal.values @ up
            keep = np.logical_not(outliers(self._seconds, along))
            kept = replace(signal, stamps_ns=signal.stamps_ns[keep], values=signal.values[keep])
            track = replace(self, signal=kept)
            try:
                drops = find_drops(track._seconds, along[keep])
            except NotFoundError as reason:
                first_reason = first_reason or reason
                continue
            found = track._detection(drops, units, name, up, signal)
            if found.found.is_free:
                return found
            odd = odd or found
        if odd is not None:
            return odd
        raise first_reason or NotFoundError("the ball does not move", GOOD_DROP)

    def launched(self, units: Units, gravity: Gravity, noise_m: float) -> DropDetection | None:
        """Detect the first bounce between free flights that the fit explains; None without any."""
        signal, along = self.signal, self.signal.values @ gravity.up
        drops = launched_drops(self._seconds, along, GRAVITY_M_S2, noise_m)
        best: DropDetection | None = None
        for number, drop in enumerate(drops):
            others = (*drops[:number], *drops[number + 1 :])
            found = self._detection([drop], units, gravity.up_name, gravity.up, signal)
            sunk_m = max(drop.contact_m - float(np.quantile(along, _LOWEST)), 0.0)
            found = replace(found, others=others, sunk_m=sunk_m)
            if found.posterior is None or np.ptp(found.posterior.interval95[0]) > 2 * _UNSURE:
                continue
            if moves_as_found(found):
                return found
            best = best or found
        return best

    @property
    def _seconds(self) -> Array:
        """Seconds since the drop's clock began."""
        return (self.signal.stamps_ns - self.start_ns).astype(np.float64) * 1e-9

    def _detection(
        self, drops: list[Drop], units: Units, name: str, up: Array, whole: Signal
    ) -> DropDetection:
        """Build the detection of the first of some drops, with its warnings."""
        drop = replace(drops[0], scale_known=units.tell_speed)
        window = slice(drop.first, drop.first + len(drop.seconds) + drop.touching)
        warnings = [] if name == "+z" else [f"up is {name} in {whole.name}"]
        if words := units_words(units):
            warnings.append(words)
        if len(drops) > 1:
            spans = ", ".join(f"{one.seconds[0]:.2f} to {one.seconds[-1]:.2f} s" for one in drops)
            warnings.append(f"{len(drops)} drops ({spans}); the first is used (see --start, --end)")
        stamps_s = (whole.stamps_ns - self.start_ns).astype(np.float64) * 1e-9
        first_s, last_s = drop.seconds[[0, -1]]
        between = int(np.count_nonzero((stamps_s >= first_s) & (stamps_s <= last_s)))
        return DropDetection(
            physical=self.physical,
            topic=whole.name,
            start_ns=self.start_ns,
            found=drop,
            outliers=between - len(drop.seconds) - drop.touching,
            sideways_m=_sideways(self.signal.values, up)[window],
            ball=self.ball,
            warnings=tuple(warnings),
            units=units,
        )


def moves_as_found(detection: DropDetection) -> bool:
    """Return whether it falls with gravity onto a table, and the fit moves as it does."""
    if not detection.physical:
        return detection.found.is_free
    if not _may_be(detection):
        return False
    apart = fit_excess_percent(detection)
    falls = detection.drop.gravity_m_s2 / GRAVITY_M_S2
    return apart is not None and apart < _MAX_EXCESS_PERCENT and abs(falls - 1) < _WITHIN_GRAVITY


def is_something_else(detection: DropDetection) -> bool:
    """Return whether what was found moves so unlike a ball that it is none."""
    apart = fit_excess_percent(detection) if detection.physical else 0.0
    return apart is None or apart > _NO_BALL_PERCENT


def _excess(detection: DropDetection) -> float:
    """Return how far the fit is off [% of the drop height]; infinite where there is none."""
    apart = fit_excess_percent(detection)
    return np.inf if apart is None else apart


def _may_be(detection: DropDetection) -> bool:
    """Return whether it falls about as bodies do, and never below where it bounced."""
    drop = detection.drop
    after_m = drop.heights_m[drop.seconds > drop.impact_s]
    lowest_m = drop.contact_m - _SUNK * drop.drop_height_m - _SUNK_SDS * drop.noise_m
    return drop.is_free and (not len(after_m) or float(after_m.min()) > lowest_m)


def _why_not(detection: DropDetection) -> NotFoundError:
    """Explain why what falls there is no drop."""
    drop = detection.drop
    if not drop.is_free:
        return NotFoundError(
            f"falls with {drop.gravity_m_s2:.2f} m/s², and not freely on both sides of an impact: "
            "is it carried, or are the lengths in mm or cm?",
            f"{RIGHT_LENGTHS}, or {LET_GO}",
        )
    return NotFoundError(
        "no impact with free flight on both sides is seen, and it goes on below where it fell to: "
        "is it caught by hand?",
        "at the next drop: let the ball fall onto the middle of a large, level surface",
    )


_PART = "give --start and --end of a part in which the ball is seen, or leave them out"


def _sideways(values: Array, up: Array) -> Array:
    """Return the horizontal positions, shape (T, 2)."""
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) == 1.0:
        return np.delete(values, axis, axis=1)
    across = np.linalg.svd(up[None, :])[2][1:]
    return values @ across.T
